"""From a configuration to the parts of a run; what does not fit together is one line."""

from collections import Counter

import pytest
import torch
from commands import room_file, train_config
from parts import make_parts
from refusals import refused
from rooms import grid_scene
from shown_goals import trained

from dirl.agent.decisions import observe
from dirl.envs import SurroundingViews
from dirl.envs.transforms import front_only
from dirl.evaluation.experts import ShortestPathExpert, label
from dirl.models import FeatureTable, ObservationTable
from dirl.models.build import build_policy
from dirl.runs.checkpoints import load_checkpoint
from dirl.scenes import make_world, write_dump
from dirl.training.build import build_goals, build_world, learning_policy, load_trained
from dirl.training.pairs import DrawnPairs, with_labels

SMALL = ["encoder.width=8", "heads.width=8"]


def test_a_policys_first_weights_are_decided_by_the_seed_alone():
    made = []
    for torchs_seed, seed in ((0, 7), (1, 7), (1, 8)):
        torch.manual_seed(torchs_seed)
        policy = build_policy(train_config(f"seed={seed}", *SMALL), FeatureTable(torch.rand(5, 3)), ["a", "b"])
        made.append(policy.state_dict())
        drawn = torch.rand(1)
        torch.manual_seed(torchs_seed)
        torch.rand(5, 3)
        assert torch.rand(1) == drawn, "making a network disturbed torch's own generator"
    assert all(torch.equal(made[0][key], made[1][key]) for key in made[0])
    assert not torch.equal(made[0]["encoder.embedding.weight"], made[2]["encoder.embedding.weight"])


@pytest.mark.parametrize(
    ("option", "width", "principal"),
    [
        ("observation=surrounding", 32, True),
        ("observation=sequential", 32, True),
        ("observation=surrounding", 16, False),
        ("network.axes=features", 32, False),
    ],
)
def test_principal_axes_are_used_where_there_are_no_more_states_than_features(tmp_path, option, width, principal):
    write_dump(tmp_path / "room.h5", grid_scene(feature_width=width))
    policy = make_parts(f"scene={tmp_path / 'room.h5'}", *SMALL, option).policy
    assert isinstance(policy.features, ObservationTable) == principal
    assert (policy.cached.surrounding is not None) == ("sequential" not in option)


def test_the_expert_may_walk_to_other_goals_than_the_run_has(tmp_path):
    options = [f"scene={room_file(tmp_path)}", *SMALL, "hold_out=0.3", "imitation.fraction=1"]
    parts = make_parts(*options, "imitation.sampled=true", "imitation.goals=all")
    torch.manual_seed(0)
    shown = set(parts.demos.draw(2000)["goal"].tolist())
    held_out = set(build_goals(parts.config, parts.world.scenes).held_out["grid"])
    assert held_out
    assert shown == set(range(24)) - held_out
    assert parts.world.goals.tolist() == [0, 13]  # where reinforcement is
    refused(r"imitation\.goals: applies to sampled pairs only", make_parts, *options, "imitation.goals=all")
    told = r"^imitation\.goals: grid: goals=some: must be states, or one of all"
    refused(told, make_parts, *options, "imitation.sampled=true", "imitation.goals=some")


def test_a_policy_of_more_than_the_present_views_cannot_plan_nor_one_without_patches_compare_them(tmp_path):
    options = [f"scene={room_file(tmp_path)}", *SMALL]
    told = "^episodic_memory: PlanningMemory asks .*use episodic_memory=none$"
    refused(told, make_parts, *options, "episodic_memory=planning", "memory=gru")
    refused("grid has none; encode it again by scenes.py encode", make_parts, *options, "system=any_goal")


def test_a_policy_of_two_scenes_decides_by_the_layers_of_the_one_it_is_in(tmp_path):
    rooms = [grid_scene(3, 2, name="left", feature_width=64), grid_scene(2, 3, name="right", feature_width=64, seed=1)]
    files = [str(tmp_path / f"{room.name}.h5") for room in rooms]
    for file, room in zip(files, rooms, strict=True):
        write_dump(file, room)
    trained(tmp_path / "run", make_world(rooms), f"scene=[{','.join(files)}]")
    saved = load_checkpoint(tmp_path / "run")
    _, both, protocol = load_trained(saved, "run")
    whole = protocol.run(both)
    for number, file in enumerate(files):
        _, one, alone = load_trained(saved, "run", {"scene": file})
        inside, part = whole.select(protocol.world.scene_of[whole.start] == number), alone.run(one)
        for field in ("steps", "success", "shortest"):
            assert torch.equal(getattr(inside, field), getattr(part, field))


class OnlyAhead(SurroundingViews):
    """A transform of one's own that shows the view ahead, and hides the others."""

    def reset_view_ids(self, picture):
        return front_only(super().reset_view_ids(picture), self.pictures)


def test_a_cached_policy_sees_what_the_observation_shows_and_nothing_else(tmp_path):
    write_dump(tmp_path / "room.h5", grid_scene(3, 2, goals=(0, 5), feature_width=64))
    found = []
    for cache in ("auto", "off"):
        config = train_config(f"scene={tmp_path / 'room.h5'}", f"network.cache={cache}")
        world = build_world(config)
        observation = OnlyAhead(world)
        policy = learning_policy(config, world, observation)
        state, goal = torch.arange(24), torch.zeros(24, dtype=torch.int64)
        found.append(policy(observe(world, observation, state, observation.reset_view_ids(state), goal))["logits"])
    torch.testing.assert_close(*found, atol=1e-5, rtol=0)


def pairs(world, **options):
    shown = torch.ones(len(world), dtype=torch.bool)
    return DrawnPairs(world, ShortestPathExpert(world), SurroundingViews(world), shown, **options)


def test_pairs_are_drawn_by_goal_and_then_among_the_states_of_its_scene(world):
    torch.manual_seed(0)
    drawn = pairs(world).draw(60_000)
    counts = Counter(zip(drawn["goal"].tolist(), drawn["state"].tolist(), strict=True))
    wanted = {(goal, state) for goal in (0, 13) for state in range(24)} | {(33, state) for state in range(24, 40)}
    assert set(counts) == wanted - {(0, 0), (13, 13), (33, 33)}
    assert sum(count for (goal, _), count in counts.items() if goal == 33) == pytest.approx(20_000 * 15 / 16, rel=0.03)
    assert max(counts.values()) < 2 * min(counts[pair] for pair in counts if pair[0] == 33)
    assert torch.equal(drawn["scene"], world.scene_of[drawn["state"]])
    assert torch.equal(drawn["view_ids"], world.surrounding[drawn["state"]])


def test_a_share_of_the_goals_is_shown_by_its_front_view(world):
    drawn = pairs(world, front_only=0.3).draw(5000)
    photo = drawn["goal_view_ids"][:, 1] == len(world)
    assert photo.float().mean() == pytest.approx(0.3, abs=0.03)
    assert torch.equal(drawn["goal_view_ids"][:, 0], drawn["goal"])
    assert (drawn["goal_view_ids"][photo, 1:] == len(world)).all()
    assert torch.equal(drawn["goal_view_ids"][~photo], world.surrounding[drawn["goal"][~photo]])


def test_in_a_world_that_changes_goal_and_state_are_seen_in_two_looks():
    world = make_world([grid_scene(goals=(0, 13), looks=2)])
    states = len(world)
    drawn = pairs(world, front_only=0.5).draw(2000)
    look, goal_look = drawn["view_ids"][:, 0] // states, drawn["goal_view_ids"][:, 0] // states
    assert (look != goal_look).all()
    assert Counter(look.tolist()).keys() == Counter(goal_look.tolist()).keys() == {0, 1, 2}
    assert torch.equal(drawn["view_ids"], world.surrounding[drawn["state"]] + look.unsqueeze(1) * states)
    photo = drawn["goal_view_ids"][:, 1] == 3 * states
    assert photo.float().mean() == pytest.approx(0.5, abs=0.05)


def test_half_of_a_draw_are_states_that_the_learner_came_to(world):
    table = pairs(world)
    visited = label(table.expert, table.draw(3))
    merged = with_labels(with_labels(table, visited[:1]), visited[1:])
    drawn = merged.draw(4000)
    keys = set(zip(visited["state"].tolist(), visited["goal"].tolist(), strict=True))
    found = [pair in keys for pair in zip(drawn["state"].tolist(), drawn["goal"].tolist(), strict=True)]
    assert sum(found[-2000:]) == 2000
    assert sum(found[:1900]) < 1000
