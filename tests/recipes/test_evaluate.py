"""The recipe that evaluates: how many episodes it walks, what it calls an agent, and what it tells of the stop."""

from types import SimpleNamespace

import evaluate
import pytest
import torch
from refusals import refused
from rooms import grid_scene

from dirl.cli.parsing import parse
from dirl.config.files import group_options
from dirl.envs import SurroundingViews
from dirl.evaluation.episodes import every_start
from dirl.evaluation.protocol import EvaluationProtocol
from dirl.models import LocalisingMemory
from dirl.scenes import make_world
from dirl.training.build import Trained


@pytest.mark.parametrize(("most", "each"), [(10_000, None), (100, 4), (3, 1)])
def test_where_every_start_makes_too_many_episodes_some_are_drawn(monkeypatch, capsys, most, each):
    monkeypatch.setattr(evaluate, "MOST_EPISODES", most)
    world = make_world([grid_scene(3, 2)], range(24))
    protocol = EvaluationProtocol(world, SurroundingViews(world), every_start(world), stop=None, max_steps=9, seed=3)
    goal_index, start = evaluate.few_enough(protocol).starts
    if each is None:
        assert (goal_index, start) == protocol.starts
        assert capsys.readouterr().out == ""
    else:
        assert torch.equal(goal_index.bincount(), torch.full((24,), each))
        assert (start != world.goals[goal_index]).all()
        told = capsys.readouterr().out
        assert told.startswith(f"552 episodes from every start would take long: {each} starts of a goal are sampled")


@pytest.mark.parametrize(
    ("looks", "memory", "given", "plans"),
    [
        (0, "localising", [], True),
        (2, "localising", [], False),
        (0, "planning", [], False),
        (0, "none", [], False),
        (0, "localising", ["recogniser=learned"], False),
        (0, "localising", ["map=2"], False),
        (0, "localising", ["simulator=dump"], False),
    ],
)
def test_where_views_return_an_agent_that_localises_plans_unless_something_is_asked(
    monkeypatch, looks, memory, given, plans
):
    source = {"_target_": "dirl.scenes.catalogue.Rooms"}
    config = SimpleNamespace(episodic_memory=group_options("episodic_memory", memory), source=source, trust=[])
    config.scene = config.split = config.rooms = None
    monkeypatch.setattr(evaluate, "saved_config", lambda *_: config)
    monkeypatch.setattr(evaluate, "load_scenes", lambda *_, **__: [grid_scene(3, 2, looks=looks)])
    monkeypatch.setattr(evaluate, "load_trained", lambda *given: given)
    options = parse(evaluate.Options, ["checkpoint=run", *given])
    (*_, asked, _, scenes), changes = evaluate.loaded({"extractor": "random"}, options, {"seed": 1})
    planning = {"episodic_memory": "planning", "recogniser": "ncc"}
    planning = {name: group_options(name, option) for name, option in planning.items()} | {"stop.threshold": 0.98}
    assert changes == asked == {"seed": 1, **(planning if plans else {})}
    assert (scenes is None) == (memory != "localising" or given != [])  # read once


@pytest.mark.parametrize(
    ("same", "given", "chosen"),
    [
        (True, [], ("ncc", "planning")),
        (False, [], (None, None)),
        (True, ["turn_error=2"], (None, None)),
        (True, ["recogniser=learned"], ("learned", None)),
    ],
)
def test_live_an_agent_that_localises_plans_where_a_pose_shows_the_same_again(monkeypatch, same, given, chosen):
    def load(*given, recogniser, episodic_memory, **other):
        raise LookupError(recogniser, episodic_memory)

    monkeypatch.setattr("dirl.agent.navigator.Navigator.load", load)
    monkeypatch.setattr(evaluate, "packaged_encoder", lambda name: object())
    monkeypatch.setattr(evaluate, "Dumped", lambda scene: None)
    monkeypatch.setattr(evaluate, "repeats", lambda world, pose: same)
    world = make_world([grid_scene(3, 2)])
    protocol = EvaluationProtocol(world, SurroundingViews(world), every_start(world), memory=LocalisingMemory())
    options = parse(evaluate.Options, ["checkpoint=run", "simulator=dump", *given])
    with pytest.raises(LookupError) as asked:
        evaluate.walk_live(Trained(SimpleNamespace(device="cpu"), None, protocol), options)
    assert asked.value.args == chosen


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["last_steps=1"], "last_steps=1: only where a map leads; give map=2 too"),
        (["beside=run"], "beside=run: only the viewer shows two agents; give viewer=true too"),
        (["slip=0.1"], "slip, turn_error: only in a live world; give simulator=dump"),
        (["simulator=dump", "viewer=true"], "simulator: a live world has no viewer and no map"),
        (["arrows=true", "simulator=dump"], "arrows, panorama: a live world shows neither; leave them out"),
    ],
)
def test_options_that_do_not_go_together_are_told_before_anything_is_read(options, told):
    refused(f"^{told}", evaluate.evaluate, parse(evaluate.Options, ["checkpoint=nowhere", *options]))


@pytest.mark.parametrize(
    ("looks", "recogniser", "stop", "told"),
    [(2, "ncc", "match", True), (0, "ncc", "match", False), (2, "ncc", "goal", False), (2, "learned", "match", False)],
)
def test_a_stop_by_correlation_is_told_of_where_no_place_looks_the_same_twice(looks, recogniser, stop, told):
    world = make_world([grid_scene(3, 2, looks=looks)])
    protocol = EvaluationProtocol(world, SurroundingViews(world), every_start(world))
    chosen = group_options("recogniser", recogniser)
    config = SimpleNamespace(recogniser=chosen, trust=[], stop=SimpleNamespace(evaluation=stop))
    assert evaluate.misses_arrivals(Trained(config, None, protocol)) == told
