import math

import pytest
import torch
from torch import nn

from dirl.envs import NavigationEnv
from dirl.runs.finding import RunError
from dirl.runs.states import check_agents, check_fits, check_optimiser, check_random_state, check_state
from dirl.scenes import make_world


@pytest.fixture
def optimiser():
    network = nn.Linear(3, 2)
    optimiser = torch.optim.Adam(network.parameters(), lr=0.1)
    network(torch.ones(3)).sum().backward()
    optimiser.step()
    return optimiser, torch.optim.Adam(nn.Linear(3, 2).parameters(), lr=0.1)


def test_a_saved_optimiser_fits_a_fresh_one(optimiser):
    used, fresh = optimiser
    check_optimiser(used.state_dict(), fresh, "a", 2)
    check_optimiser(fresh.state_dict(), fresh, "a", 0)
    fresh.load_state_dict(used.state_dict())


@pytest.mark.parametrize(
    ("spoil", "told"),
    [
        (lambda state: state["state"].update({2: {}}), "state: expected 2 of 2 parameters, found 3"),
        (lambda state: state["state"].pop(1), "state: expected 2 of 2 parameters, found 1"),
        (lambda state: state["state"].update({1: 3}), r"state\.1: expected float32"),
        (lambda state: state["state"][0].update(step=torch.zeros(4)), r"state\.0: expected float32 \[2, 3\]"),
        (
            lambda state: state["state"][0].update(exp_avg=torch.zeros(2, 3).half()),
            r"state\.0: expected float32 \[2, 3",
        ),
        (lambda state: state["state"][0].update(step=torch.tensor(-3.0)), r"state\.0\.step: expected a count of steps"),
        (lambda state: state["state"][1].update(step=torch.tensor(0.5)), r"state\.1\.step: expected a count of steps"),
        (lambda state: state["state"][1].update(step=torch.tensor(math.nan)), r"state\.1\.step: expected a count"),
        (lambda state: state["state"][1].pop("exp_avg"), r"state\.1: has other entries"),
        (lambda state: state["param_groups"].append({}), "expected a list of 1, found a list of 2"),
        (lambda state: state["param_groups"][0].update(params=[0, 0]), "params cannot have been so"),
        (lambda state: state["param_groups"][0].update(eps=1.0), "eps cannot have been so"),
        (lambda state: state["param_groups"][0].update(lr=-1.0), "lr cannot have been so"),
        (lambda state: state["param_groups"][0].update(lr=2**70), "lr cannot have been so"),
        (lambda state: state["param_groups"][0].update(lr="fast"), "lr: expected float 0.1, found str 'fast'"),
        (lambda state: state.pop("param_groups"), "expected 2 entries"),
    ],
)
def test_an_optimiser_that_does_not_fit_is_told(optimiser, spoil, told):
    used, fresh = optimiser
    state = used.state_dict()
    spoil(state)
    with pytest.raises(RunError, match=told):
        check_optimiser(state, fresh, "a", 2)


@pytest.mark.parametrize(
    ("saved", "fresh"),
    [
        (torch.zeros(2), torch.zeros(3)),
        (torch.zeros(2).double(), torch.zeros(2)),
        ([0, 0], torch.zeros(2)),
        ({"a": 1}, {"b": 1}),
        ([1], [1, 2]),
        ([1, -1], []),
        ("1", 1),
        (-1, 1),
        (True, 1),
        (1, True),
        (1.5, None),
        ("x", 1.0),
    ],
)
def test_a_state_that_does_not_fit_is_told_where(saved, fresh):
    with pytest.raises(RunError, match=r"^file: meter\.x\[0\](\[1\])?: expected "):
        check_fits({"x": [saved]}, {"x": [fresh]}, "file: meter")


def test_a_state_that_fits_is_taken():
    fresh = {"a": [], "b": None, "c": {}, "d": torch.zeros(2), "e": 0, "f": 0.5, "g": (1, "x")}
    saved = {"a": [3, 4], "b": 7, "c": {"x": 1}, "d": torch.ones(2), "e": 5, "f": 1, "g": [2, "y"]}
    check_fits(saved, fresh, "a")


def test_counts_have_a_limit():
    for saved, fresh in ((11, None), (11, 0), ([3, 11], [])):
        with pytest.raises(RunError):
            check_fits({"x": saved}, {"x": fresh}, "a", most=10)
        check_fits({"x": saved}, {"x": fresh}, "a", most=11)


def test_agents_must_stand_where_there_are_states(scene):
    env = NavigationEnv(make_world([scene]), 3)
    agents = env.reset().to_dict()
    check_agents(agents, env, "a")
    agents["state"][1] = 24
    with pytest.raises(RunError, match=r"a\.state: holds values that the environment does not have"):
        check_agents(agents, env, "a")


def test_a_training_that_has_begun_has_a_used_optimiser(scene, optimiser):
    used, fresh = optimiser
    env = NavigationEnv(make_world([scene]), 3)
    random = {"env": env.generator.get_state(), "cpu": torch.get_rng_state()}
    state = {
        "frames": 9,
        "agents": env.reset().to_dict(),
        "random": random,
        "optimiser": used.state_dict(),
        "trained": 2,
        "meter": {"steps": [[3, 4], []], "totals": [7, 0]},
    }
    check_state(state, {**state, "frames": 0, "trained": 0}, fresh, "a", 9, env)
    for change in ({"optimiser": fresh.state_dict()}, {"random": {}}, {"agents": {}}, {"frames": -1}):
        with pytest.raises(RunError, match=r"^a: "):
            check_state(state | change, state, fresh, "a", 9, env)
    for steps in ([[], []], [[3, 5], []], [[], [3, 4]]):
        spoilt = state | {"meter": state["meter"] | {"steps": steps}}
        with pytest.raises(RunError, match=r"^a: meter: the lengths of the latest episodes do not add up"):
            check_state(spoilt, state | {"meter": {}}, fresh, "a", 9, env)
    with pytest.raises(RunError, match="it lacks agents, meter, random, trained"):
        check_state({"frames": 9, "optimiser": {}}, state, fresh, "a", 9, env)


def test_random_states_are_tried():
    check_random_state(torch.get_rng_state(), "cpu", "a")
    for wrong in (torch.zeros(3, dtype=torch.uint8), torch.zeros(5056), None, torch.zeros(5056, dtype=torch.uint8)):
        with pytest.raises(RunError, match="is no state of a random number generator"):
            check_random_state(wrong, "cpu", "a")
