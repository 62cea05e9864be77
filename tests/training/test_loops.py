"""The loops of a training: it goes on from what is saved to the same weights, bit for bit; what it refuses."""

import io

import pytest
import torch
from commands import room_file, train_config
from parts import Loop, make_parts, train_state
from refusals import refused
from train import imitate, learn, reinforce, train

from dirl.runs.checkpoints import training_checkpoints
from dirl.runs.folder import Run
from dirl.training.job import build_components, run_stages
from dirl.training.loops import dagger_rounds

SMALL = ["encoder.width=8", "heads.width=8", "reinforcement.agents_per_scene=6", "reinforcement.max_steps=9"]
KINDS = {
    "surrounding": [],
    "sequential": ["observation=sequential", "preset=paper", "reinforcement.max_steps=9"],
    "gru": ["memory=gru", "memory.hidden_size=8"],
    "ppo": ["objective=ppo", "reinforcement.minibatches=3"],
}


def through_a_file(saved):
    """As a checkpoint holds it."""
    stream = io.BytesIO()
    torch.save(saved, stream)
    stream.seek(0)
    return torch.load(stream, weights_only=True)


@pytest.mark.parametrize("kind", KINDS)
def test_a_training_goes_on_from_its_state_to_the_same_end(tmp_path, kind):
    options = [f"scene={room_file(tmp_path)}", *SMALL, *KINDS[kind]]
    stop = []
    torch.manual_seed(0)
    state = train_state(make_parts(*options))

    def save_once(state):
        if not stop and state.frames >= 120:
            stop.append(through_a_file(state.state_dict()))

    learn(state, Loop(state, 300, save_once))
    torch.manual_seed(99)
    resumed = train_state(make_parts(*options))
    initial = resumed.policy.state_dict()["encoder.embedding.weight"].clone()
    resumed.load_state_dict(stop[0])
    assert resumed.frames == stop[0]["frames"] >= 120
    learn(resumed, Loop(resumed, 300))
    assert (resumed.frames, resumed.meter.state_dict()) == (state.frames, state.meter.state_dict())
    torch.testing.assert_close(resumed.policy.state_dict(), state.policy.state_dict(), atol=0, rtol=0)
    assert (resumed.agents == state.agents).all()
    assert not torch.equal(initial, state.policy.state_dict()["encoder.embedding.weight"])


def test_the_end_of_a_training_is_saved_before_it_is_evaluated(tmp_path):
    run, components = begun(tmp_path, "reinforcement.frames_per_scene=60", "checkpoint.every_seconds=1000")
    told = reinforce(run, components.state, components.protocol)
    run.close()
    assert [int(file.stem) for file in training_checkpoints(run.folder)] == [told["frames"]] == [60]


def test_an_imitation_goes_on_from_its_state_to_the_same_end_and_from_no_other(tmp_path, monkeypatch):
    """Pairs, noise and the falling learning rate included; nothing is done twice."""
    options = [f"scene={room_file(tmp_path)}", *SMALL, "system=any_goal", "encoder=siamese", "episodic_memory=none"]
    options += ["network.components=8", "imitation.max_steps=6", "imitation.batch_size=16", "evaluation.times=0"]
    saved = []
    monkeypatch.setattr(Run, "save", lambda _, state: saved.append(through_a_file(state)))

    def imitated(checkpoint=None):
        """The parts, and a checkpoint of each step."""
        parts = make_parts(*options, "checkpoint.every_seconds=0")
        saved.clear()
        run = Run(tmp_path, parts.config, checkpoint and {**checkpoint, "seconds": 0.0})
        assert imitate([run], parts.policy, [parts.demos]) == 6
        return parts, list(saved)

    whole, states = imitated()
    assert [state["imitation"]["step"] for state in states] == [1, 2, 3, 4, 5, 6]
    for begins in (states[1], states[5]):
        torch.manual_seed(99)
        resumed, after = imitated(begins)
        assert len(after) == 6 - begins["imitation"]["step"]
        torch.testing.assert_close(resumed.policy.state_dict(), whole.policy.state_dict(), atol=0, rtol=0)
    weights = [state["learning"]["encoder.embedding.weight"] for state in states]
    assert not torch.equal(weights[1], weights[5])
    other = {**states[0]["optimiser"], "param_groups": []}
    for change in ({"learning": {}}, {"optimiser": other}, {"random": {}}, {"random": {"cpu": torch.zeros(3)}}):
        refused("its checkpoint does not fit this run", imitated, states[0] | change)


def begun(folder, *options):
    """A run that has begun, and its components."""
    small = ["encoder.width=8", "heads.width=8", "reinforcement.agents_per_scene=6", "evaluation.times=0"]
    run = Run(folder / "run", train_config(f"scene={room_file(folder)}", *small, *options))
    components = build_components(run)
    run.begin(components.world, components.protocol.observation.order)
    return run, components


def test_a_training_that_diverges_ends_in_one_line(tmp_path):
    imitation = begun(tmp_path / "first", "imitation.fraction=1", "imitation.lr=1e20")
    refused("^the imitation has diverged: a loss of nan at step 1; lower", run_stages, *imitation, train)
    options = ["imitation.fraction=0", "optimiser.lr=1e30", "reinforcement.frames_per_scene=2000"]
    refused("^the policy has diverged, its logits are not finite: lower", run_stages, *begun(tmp_path, *options), train)


def test_after_dagger_a_reinforcement_tells_its_own_frames_and_walks_to_all_goals_though_few_are_evaluated(tmp_path):
    options = ["goals=all", "evaluation.goals=2", "reinforcement.frames_per_scene=60"]
    options += ["imitation.rounds=1", "imitation.max_steps=3", "imitation.sampled=true"]
    run, components = begun(tmp_path, *options)
    walked = components.state.env.base_env.world.goals
    assert (len(walked), len(components.protocol.world.goals)) == (len(components.world), 2)
    (labelled, _) = next(dagger_rounds(run, components, components.demos))
    assert len(labelled.visited["goal"].unique()) > 2
    assert train(run, components)["frames"] == components.state.frames == 60
    assert (run.folder / "dagger.csv").read_text().splitlines()[1].split(",")[:2] == ["1", "120"]
