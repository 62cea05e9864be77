"""The agent of the package."""

import numpy as np
import pytest
import torch
from shown_goals import walk_until_stop

from dirl import Navigator
from dirl.config.schemas import ConfigError
from dirl.evaluation.live_episodes import Remembered
from dirl.models import LocalisingMemory
from dirl.perception.backbones import load_encoder
from dirl.perception.recognition import Learned
from dirl.runs.checkpoints import PRETRAINED, load_checkpoint
from dirl.scenes import load_scenes, make_world
from dirl.training.build import load_trained


def test_it_is_found_by_name_and_has_heads_for_any_room(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    saved = load_checkpoint("general")
    assert all(torch.isfinite(value).all() for value in saved["network"].values())
    assert not any(".scenes." in key and ".shared" not in key for key in saved["network"])
    assert sum(file.stat().st_size for file in PRETRAINED.rglob("*.pt")) < 20e6
    (tmp_path / "general").mkdir()  # a folder of the reader's with this name comes first
    with pytest.raises(ValueError, match="holds no checkpoint"):
        load_checkpoint("general")


def test_turns_that_its_training_did_not_have_are_told(capsys):
    for turns, told in ((12, ""), (16, "warning: general: was trained with turns of 90 and 45 and 30 degrees; with ")):
        Navigator.load("general", turns=turns)
        assert capsys.readouterr().err.startswith(told)


def test_its_evaluation_needs_a_room():
    with pytest.raises(ConfigError, match=r"general: its training rooms, .* are not here; .*: scene=\.\.\."):
        load_trained(load_checkpoint("general"), "general")


@pytest.fixture(scope="module")
def navigator():
    """It; no view is encoded twice."""
    loaded = Navigator.load("general")
    loaded.encoder = Remembered(loaded.encoder)
    return loaded


def test_it_finds_photos_in_a_room_it_was_not_trained_in_and_needs_no_option(navigator):
    """From up to twelve actions away in the built-in bathroom, on raw images; with its own encoder and memory."""
    world = make_world(load_scenes("bathroom_02"))
    views = world.scenes[0].views

    def act(state):
        return navigator.act(np.stack([views[seen] for seen in world.surrounding[state]]))

    assert isinstance(navigator.recogniser, Learned)
    assert isinstance(navigator.memory, LocalisingMemory)
    for goal in range(8, len(world), 32):
        navigator.reset(views[goal])
        state, rng = goal, np.random.default_rng(goal)
        for _ in range(12):
            state = int(world.graph[state, rng.integers(4)])
        walked, stopped = walk_until_stop(act, world, state, 20)
        assert (walked[-1], stopped) == (goal, True)


def test_an_encoder_without_fine_patches_gives_photos_another_score_but_the_policy_sees_the_same():
    views = np.stack(list(load_scenes("bathroom_02")[0].views)[:8])
    seen = []
    for encoder in (None, load_encoder("efficientnet_lite0", patches=True)):
        navigator = Navigator.load("general", encoder, episodic_memory="none")
        navigator.reset(views[0])
        seen.append(navigator.act(views[4:]).scores)
    assert seen[0].matching != seen[1].matching
    torch.testing.assert_close(seen[0].probabilities, seen[1].probabilities)
