"""Where a goal is believed to be: what visits say, facing any way and wherever they are, adds up in one grid."""

import math
from types import SimpleNamespace

import pytest
import torch

from dirl.agent.agent import Localising
from dirl.models import LocalisingMemory
from dirl.models.belief import CLEAR, REACH, ROOM, GoalBelief, here_odds
from dirl.scenes.graph import AHEAD, BACK, RIGHT

SIDE = 9


def told(right, ahead, sure=8.0):
    """What an agent is told, whose goal lies so many moves to the right and ahead, facing each of its four views."""
    displacement = torch.zeros(1, 4, SIDE, SIDE)
    for view in range(4):
        displacement[0, view, SIDE // 2 + ahead, SIDE // 2 + right] = sure
        right, ahead = -ahead, right  # after a turn to the right what was to the right lies ahead
    return displacement.flatten(2).log_softmax(2).view_as(displacement)


def believed(*goals, sure=8.0):
    """What visits at the start tell, that say to the right and ahead where the goal lies."""
    belief = GoalBelief(1)
    for right, ahead in goals:
        belief.see(told(right, ahead, sure), torch.zeros(1, 2), torch.zeros(1).long(), turns=4)
    return belief


def arrived(memory, *odds, costs=lambda chosen: torch.ones(len(chosen), 4, 4)):
    """One agent at its first place, by the log odds that its views show the goal."""
    return memory.arrive(memory.begin(1), torch.zeros(1, 0, 4), torch.tensor([odds]), costs)


def most_likely(belief):
    """Where the goal is believed to be, to the right of and ahead of the start."""
    axis = torch.arange(-5.0, 6.0)
    places = torch.cartesian_prod(axis, axis)
    return places[belief.odds(places[None]).argmax()].tolist()


@pytest.mark.parametrize(
    ("position", "heading", "right", "ahead", "turns", "lies"),
    [
        ((0, 0), 0, 2, 3, 4, [2, 3]),
        ((1, 2), 2, -1, -1, 4, [2, 3]),
        ((-1, 0), 3, 3, -3, 4, [2, 3]),
        ((0, 0), 1, 0, 3, 8, [2, 2]),  # turns of 45 degrees lead to diagonals
    ],
)
def test_every_visit_tells_of_the_same_place(position, heading, right, ahead, turns, lies):
    belief = GoalBelief(1)
    belief.see(told(right, ahead), torch.tensor([position]).float(), torch.tensor([heading]), turns=turns)
    assert most_likely(belief) == lies


def test_visits_that_agree_make_sure_and_one_that_does_not_leaves_doubt():
    others, goal = ([(-2, -3)], [], [(2, 3)], [(2, 3), (2, 3)]), torch.tensor([[[2.0, 3.0]]])
    sure = [believed((2, 3), *more, sure=3.0).odds(goal).item() for more in others]
    assert sure == sorted(set(sure))
    assert sure[-1] <= CLEAR


def test_far_away_nothing_is_told_but_that_the_goal_is_unlikely():
    belief = GoalBelief(2)
    belief.see(told(1, 1).expand(2, -1, -1, -1), torch.zeros(2, 2), torch.zeros(2).long(), turns=4)
    belief.select(torch.tensor([False, True]))
    far = torch.tensor([[[10_000.0, 0.0], [1.0, 1.0]]])
    assert belief.odds(far)[0, 0] < -3 < 0 < belief.odds(far)[0, 1]


def test_moves_to_the_goal_are_counted_along_the_axes_in_the_mean_of_where_it_may_be():
    belief = GoalBelief(2)
    belief.posterior.zero_()
    belief.posterior[0, REACH + 3, REACH - 2] = 1.0
    belief.posterior[1, REACH, REACH + 1] = belief.posterior[1, REACH + 4, REACH + 1] = 0.5
    places = torch.tensor([[0.0, 0.0], [-2.0, 3.0], [1.0, -1.0]]).expand(2, -1, -1)
    assert belief.moves(places).tolist() == [[5, 0, 7], [3, 5, 3]]


def test_here_is_told_by_all_headings():
    here, beside = here_odds(told(0, 0, sure=20.0)), here_odds(told(0, 1, sure=20.0))
    assert here.item() == pytest.approx(9.0, abs=0.01)
    assert beside.item() == pytest.approx(-9.0, abs=0.01)
    torch.testing.assert_close(here_odds(told(0, 0).roll(1, 1)), here_odds(told(0, 0)))


@pytest.mark.parametrize(("ahead", "action"), [(3, AHEAD), (-3, BACK), (0, AHEAD)])
def test_of_moves_not_tried_one_towards_the_goal_costs_less(ahead, action):
    """The policy prefers the move ahead a little; the costs are those of moves, not of turns."""
    memory = LocalisingMemory()
    costs = torch.tensor([1.0, 9.0, 9.0, 1.1]).expand(1, 4, 4)
    places = arrived(memory, -9.0, -9.0, -9.0, -9.0, costs=lambda chosen: costs)
    assert memory.plan(places, believed((0, ahead))).argmax(1).item() == action


@pytest.mark.parametrize("exact", [False, True])
def test_which_place_it_is_the_locator_tells_and_which_heading_the_recogniser(exact):
    agent, visit = Localising(LocalisingMemory(), 4), torch.zeros(1, 4)
    agent.memory.exact = exact
    now = SimpleNamespace(
        visit=visit,
        inputs=visit,
        arrows=None,
        points=None,
        goal_odds=lambda *_: torch.tensor([[[4.0, 2.0, -1.0, -math.inf]]]),
        confirmed=lambda odds: odds,
        place_odds=lambda: torch.tensor([2.0]),
        displacement=lambda *_: None,
        facing=lambda chosen: torch.zeros(1, 4, 4),
    )
    agent.arrive(now)
    goal = agent.past.goal[0, 0]
    if exact:  # views that return tell the place better
        assert goal.tolist() == [4, 2, -1, -math.inf]
        return
    assert goal[0] == pytest.approx(2 - math.log(1 + math.exp(-2) + math.exp(-5)))
    assert (goal[1] - goal[0]).item() == pytest.approx(-2)
    assert goal[3] == -math.inf  # shows nothing


def test_a_memory_stops_at_a_place_that_looks_little_like_the_goal_where_the_goal_is_believed_to_be():
    memory = LocalisingMemory(neighbour=0.0)
    places = arrived(memory, 1.0, -9.0, -9.0, -9.0, costs=lambda chosen: torch.full((len(chosen), 4, 4), 1.4))
    assert memory.stops(places, believed((0, 0))).item()
    assert not memory.stops(places, believed((0, 1))).item()


def test_where_the_goal_is_believed_to_lie_behind_an_exit_a_place_that_looks_like_it_is_not_certain():
    memory, belief = LocalisingMemory(neighbour=0.0, elsewhere=1.0), GoalBelief(1)
    places = arrived(memory, 9.0, -9.0, -9.0, -9.0)
    belief.posterior[0] = math.exp(-4) / ROOM  # unlikely anywhere, here as well
    assert memory.stops(places, belief).item()
    belief.posterior[0, REACH + 1, REACH] = 1.0  # but a move ahead
    assert not memory.stops(places, belief).item()


def test_more_is_asked_of_a_stop_where_a_belief_is_added():
    """Before anything was seen a belief changes no odds, but the doubt that is left must be less."""
    memory, belief = LocalisingMemory(neighbour=0.0, elsewhere=1 / 5, confidence=0.95), GoalBelief(1)
    belief.posterior[:] = 1 / ROOM  # likelier nowhere
    walls = torch.full((1, 4, 4), math.inf)
    walls[0, 0, AHEAD] = 1.0  # one move was not tried
    for odds, enough in ((2.5, False), (3.5, True)):
        places = arrived(memory, odds, -9.0, -9.0, -9.0, costs=lambda _: walls)
        assert memory.stops(places).item()
        assert memory.stops(places, belief).item() == enough


@pytest.mark.parametrize(("stayed", "places"), [(None, 2), (-5.0, 2), (5.0, 1)])
def test_a_move_that_was_blocked_leads_to_no_new_place(stayed, places):
    """Without what the locator tells, a move ahead leads to a new place where nothing looks alike."""
    memory, odds = LocalisingMemory(), torch.full((1, 4), -9.0)
    walked = arrived(memory, -9.0, -9.0, -9.0, -9.0)
    walked.action = torch.tensor([AHEAD])
    told = None if stayed is None else torch.tensor([stayed])
    costs = torch.ones(1, 4, 4)
    walked = memory.arrive(walked, torch.full((1, 1, 4), -1.0), odds, lambda _: costs, stayed=told)
    assert walked.position.shape[1] == places


def test_views_that_return_leave_no_doubt_whatever_the_locator_tells_of_the_last_move():
    memory, surely = LocalisingMemory(temperature=8.0, blocked=0.01), torch.tensor([50.0])
    walked, odds, costs = arrived(memory, -9.0, -9.0, -9.0, -9.0), torch.full((1, 4), -9.0), torch.ones(1, 4, 4)
    walked.action = torch.tensor([AHEAD])
    for exact, views, stayed, places in ((False, -20.0, surely, 1), (True, -20.0, surely, 2), (True, 20.0, -surely, 1)):
        memory.exact = exact
        alike = torch.tensor([[[views, -20.0, -20.0, -20.0]]])
        assert memory.arrive(walked, alike, odds, lambda _: costs, stayed=stayed).position.shape[1] == places


def step_ago(agent, where, sure):
    """What an agent sees now, of which is told where it was a step ago."""
    return SimpleNamespace(inputs=agent.before, displacement=lambda before: told(*where, sure=sure))


def test_where_an_agent_was_a_step_ago_tells_whether_it_moved():
    agent = Localising(LocalisingMemory(), 4)
    agent.before = torch.zeros(1, 4)
    for action, where, sign in ((AHEAD, (0, -1), -1), (BACK, (0, 1), -1), (BACK, (0, 0), 1), (RIGHT, (0, 0), 0)):
        agent.action = torch.tensor([action])
        assert agent.stayed(step_ago(agent, where, 3.0)).item() == pytest.approx(3.0 * sign)
    agent.before = None  # at the start of an episode
    assert agent.stayed(step_ago(agent, (0, 0), 3.0)) is None


def test_how_long_a_move_is_is_learned_from_moves_and_what_was_told_by_another_length_is_forgotten():
    agent, belief = Localising(LocalisingMemory(), 4), believed((0, 4))
    assert belief.odds(torch.tensor([[[0.0, 4.0], [0.0, 2.0]]]))[0].diff() < 0
    agent.before, agent.action = torch.zeros(1, 4), torch.tensor([AHEAD])
    for where in ((0, -2), (0, 0)):  # the second move is blocked
        assert agent.stayed(step_ago(agent, where, 9.0)).sign().item() == (1 if where == (0, 0) else -1)
        assert agent.lengths.argmax().item() == 1  # two cells
    belief.see(told(0, 2), torch.tensor([[0.0, 1.0]]), torch.zeros(1).long(), turns=4, length=torch.tensor([2]))
    assert most_likely(belief) == [0, 2]
    belief.posterior.zero_()
    belief.posterior[0, REACH + 4, REACH] = 1.0
    assert belief.moves(torch.zeros(1, 1, 2)).item() == 2
