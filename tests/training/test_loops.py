"""What the loops of the training refuse, and what they leave as it was."""

import pytest
from commands import room_file, train_config
from parts import make_parts, train_in
from train import train

from dirl.config.schemas import ConfigError
from dirl.runs.folder import Run
from dirl.runs.paths import RunError
from dirl.training.job import build_components

SMALL = ["encoder.width=8", "heads.width=8", "reinforcement.agents_per_scene=6", "evaluation.times=0"]
SMALL += ["reinforcement.frames_per_scene=2000"]


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (
            ["imitation.fraction=1", "imitation.lr=1e20"],
            "^the imitation has diverged: a loss of nan at step 1; lower imi",
        ),
        (
            ["imitation.fraction=0", "optimiser.lr=1e30"],
            "^the policy has diverged, its logits are not finite: lower imi",
        ),
    ],
    ids=["imitation", "reinforcement"],
)
def test_a_training_that_diverges_ends_in_one_line(tmp_path, options, says):
    parts = make_parts(f"scene={room_file(tmp_path)}", *SMALL, *options)
    with pytest.raises(RunError, match=says):
        train_in(tmp_path / "run", parts)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["optimiser.betas=[0.9]"], r"^optimiser\.betas=\[0\.9\]: \[1\]: is missing$"),
        (
            ["optimiser.foreach=true"],
            r"^optimiser: Adam refuses its options: `fused` and `foreach` cannot be `True` tog",
        ),
        (
            ["expert._target_=dirl.evaluation.experts.RandomPolicy"],
            r"^expert: RandomPolicy is no expert: it writes no ",
        ),
    ],
    ids=["betas", "foreach", "expert"],
)
def test_a_component_that_cannot_be_made_is_one_line(tmp_path, options, says):
    with pytest.raises(ConfigError, match=says):
        train_in(tmp_path / "run", make_parts(f"scene={room_file(tmp_path)}", *SMALL, *options))


def test_a_reinforcement_after_dagger_tells_its_own_frames(tmp_path):
    options = ["imitation.rounds=1", "imitation.max_steps=3", "reinforcement.frames_per_scene=60"]
    run = Run(tmp_path / "run", train_config(f"scene={room_file(tmp_path)}", *SMALL, *options))
    components = build_components(run)
    run.begin(components.protocol.world, components.protocol.observation.order)
    told = train(run, components)
    assert told["frames"] == components.state.frames == 60
    assert (tmp_path / "run" / "dagger.csv").read_text().splitlines()[1].split(",")[:2] == ["1", "120"]
