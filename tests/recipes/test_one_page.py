"""The paper on one page beside the package: the same room, the same losses, figures alike."""

import re
from pathlib import Path

import one_page
import pytest
import torch
from parts import make_parts, train_in, train_state

from dirl.evaluation.protocol import metrics
from dirl.models import plain_weights
from dirl.scenes.catalogue import ROOMS
from dirl.training.objectives import bootstrap, make_advantages
from dirl.training.rollout import collect


@pytest.fixture(scope="module")
def parts():
    return make_parts("scene=bathroom_02", "seed=0")


@pytest.fixture(scope="module")
def room():
    return one_page.Room(ROOMS / "bathroom_02.h5")


def test_it_imports_nothing_of_the_package():
    assert not re.search(r"^\s*(from|import) dirl\b", Path(one_page.__file__).read_text(), re.MULTILINE)


def test_its_room_is_the_packages(parts, room):
    world, protocol = parts.world, parts.protocol
    goal, state = world.pairs()
    assert torch.equal(room.graph, world.graph)
    assert torch.equal(room.goals, world.goals)
    assert torch.equal(room.distance[state, goal].long(), world.distances.long())
    assert torch.equal(room.stop[state, goal], protocol.stop)


def test_the_losses_of_an_update_are_the_packages(parts, room):
    state, policy = train_state(parts), one_page.Policy(room)
    weights = plain_weights(parts.policy)
    fusion = torch.cat([weights["encoder.fusion.weight"], weights["encoder.goal_fusion.weight"]], 1)
    own = {"embedding.weight": weights["encoder.embedding.weight"] @ room.axes, "fusion.weight": fusion}
    own |= {f"{name}.bias": weights[f"encoder.{name}.bias"] for name in ("embedding", "fusion")}
    heads = {"hidden": "trunk.scenes.bathroom_02.0", "actor": "policy.scenes.bathroom_02"}
    for name, theirs in {**heads, "critic": "value.scenes.bathroom_02"}.items():
        own |= {f"{name}.{kind}": weights[f"heads.{theirs}.{kind}"] for kind in ("weight", "bias")}
    policy.load_state_dict(own)
    operator, index = parts.policy.operator(), parts.world.goal_index
    rollout, _ = collect(state.env, operator, state.agents, one_page.STEPS)
    with_advantage = make_advantages(one_page.GAMMA, one_page.LAMBDA)(bootstrap(rollout, operator.get_value_operator()))
    expected = state.losses(with_advantage.reshape(-1), 0.7)
    batch = {
        "state": rollout["state"],
        "goal": index[rollout["goal"]],
        "action": rollout["action"],
        "after": rollout["next", "state"],
        **{own: rollout["next", key].squeeze(-1) for own, key in
           {"reward": "reward", "arrived": "terminated", "over": "done"}.items()},
    }  # fmt: skip
    demos = parts.demos
    shown = (demos["state"], index[demos["goal"]], demos["expert_action"])
    found = one_page.losses(policy, {key: rows.T for key, rows in batch.items()}, shown, 0.7)
    for name, value in found.items():
        torch.testing.assert_close(value, expected[f"loss_{name}"], rtol=1e-4, atol=1e-6)


def test_it_learns_what_the_package_learns(tmp_path, monkeypatch):
    monkeypatch.setattr(one_page, "WIDTH", 128)
    frames, options = 30_000, ["scene=bathroom_02", "seed=0", "evaluation.times=0"]
    options += ["encoder.width=128", "heads.width=128"]
    package = make_parts(*options, f"reinforcement.frames_per_scene={frames}")
    train_in(tmp_path / "run", package)
    expected = metrics(package.protocol.run(package.policy))
    found = one_page.train(ROOMS / "bathroom_02.h5", 0, frames)
    assert expected["sr"] > 0.7
    assert found["sr"] == pytest.approx(expected["sr"], abs=0.2)
    assert found["spl"] == pytest.approx(expected["spl"], abs=0.2)
