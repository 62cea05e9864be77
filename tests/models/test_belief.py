"""Where a goal is believed to be: what visits say, facing any way and wherever they are, adds up in one grid."""

import pytest
import torch

from dirl.models import LocalisingMemory
from dirl.models.belief import CLEAR, REACH, GoalBelief
from dirl.models.policy import GoalLocator

SIDE = 9


def told(right, ahead, sure=8.0):
    """What an agent is told, whose goal lies so many moves to the right and ahead, facing each of its four views."""
    displacement = torch.zeros(1, 4, SIDE, SIDE)
    for view in range(4):
        displacement[0, view, SIDE // 2 + ahead, SIDE // 2 + right] = sure
        right, ahead = -ahead, right  # after a turn to the right what was to the right lies ahead
    return displacement.flatten(2).log_softmax(2).view_as(displacement)


def most_likely(belief):
    """Where the goal is believed to be, to the right of and ahead of the start."""
    axis = torch.arange(-5.0, 6.0)
    places = torch.cartesian_prod(axis, axis)
    return places[belief.odds(places[None]).argmax()].tolist()


@pytest.mark.parametrize(
    ("position", "heading", "right", "ahead"),
    [((0, 0), 0, 2, 3), ((0, 0), 1, -3, 2), ((1, -1), 0, 1, 4), ((1, 2), 2, -1, -1), ((-1, 0), 3, 3, -3)],
)
def test_every_visit_tells_of_the_same_place(position, heading, right, ahead):
    """The goal is two moves to the right of the start and three ahead."""
    belief = GoalBelief(1)
    belief.see(told(right, ahead), torch.tensor([position]).float(), torch.tensor([heading]), turns=4)
    assert most_likely(belief) == [2, 3]


def test_turns_of_45_degrees_lead_to_diagonals():
    belief = GoalBelief(1)
    belief.see(told(0, 3), torch.zeros(1, 2), torch.tensor([1]), turns=8)
    assert most_likely(belief) == [2, 2]


def test_visits_that_agree_make_sure_and_one_that_does_not_leaves_doubt():
    goal, sure = torch.tensor([[[2.0, 3.0]]]), []
    for others in ([], [(2, 3)], [(2, 3), (2, 3)], [(-2, -3)]):
        belief = GoalBelief(1)
        for right, ahead in [(2, 3), *others]:
            belief.see(told(right, ahead, sure=3.0), torch.zeros(1, 2), torch.zeros(1).long(), turns=4)
        sure.append(belief.odds(goal).item())
    assert sure[3] < sure[0] < sure[1] < sure[2] <= CLEAR
    less = GoalBelief(1, most=sure[0] - 1)
    less.see(told(2, 3, sure=3.0), torch.zeros(1, 2), torch.zeros(1).long(), turns=4)
    assert less.odds(goal).item() == pytest.approx(sure[0] - 1)  # as of a photo, of which it is less sure


def test_far_away_nothing_is_told_but_that_the_goal_is_unlikely():
    belief = GoalBelief(2)
    belief.see(told(1, 1).expand(2, -1, -1, -1), torch.zeros(2, 2), torch.zeros(2).long(), turns=4)
    belief.select(torch.tensor([False, True]))
    far = torch.tensor([[[10_000.0, 0.0], [1.0, 1.0]]])
    assert belief.odds(far)[0, 0] < -3 < 0 < belief.odds(far)[0, 1]


def test_a_memory_stops_at_a_place_that_looks_little_like_the_goal_where_the_goal_is_believed_to_be():
    memory = LocalisingMemory(neighbour=0.0)
    places = memory.begin(1)
    odds = torch.tensor([[1.0, -9.0, -9.0, -9.0]])
    places = memory.arrive(places, torch.zeros(1, 0, 4), odds, lambda chosen: torch.full((len(chosen), 4, 4), 1.4))
    here, elsewhere = GoalBelief(1), GoalBelief(1)
    here.see(told(0, 0), torch.zeros(1, 2), torch.zeros(1).long(), turns=4)
    elsewhere.see(told(0, 1), torch.zeros(1, 2), torch.zeros(1).long(), turns=4)
    assert memory.stops(places, here).item()
    assert not memory.stops(places, elsewhere).item()


def test_where_the_goal_is_believed_to_lie_behind_an_exit_a_place_that_looks_like_it_is_not_certain():
    memory = LocalisingMemory(neighbour=0.0, elsewhere=1.0)
    odds = torch.tensor([[11.0, -9.0, -9.0, -9.0]])
    places = memory.arrive(memory.begin(1), torch.zeros(1, 0, 4), odds, lambda chosen: torch.ones(len(chosen), 4, 4))
    belief = GoalBelief(1)
    belief.told[0] = -4.0  # unlikely anywhere, here as well
    assert memory.stops(places, belief).item()
    belief.told[0, REACH + 1, REACH] = CLEAR  # but a move ahead
    assert not memory.stops(places, belief).item()


@torch.no_grad()
def test_a_locator_gives_probabilities_of_the_cells_around():
    class Nothing(torch.nn.Module):
        def forward(self, observation, goal_observation):
            return observation.mean((1, 2), keepdim=True).expand(-1, -1, 16).squeeze(1)

    located = GoalLocator(Nothing(), 16, 3)(torch.rand(5, 4, 8), torch.rand(5, 4, 8))
    assert located.shape == (5, 7, 7)
    assert located.flatten(1).logsumexp(1).abs().max() < 1e-5
