"""The memory that localises: by motion where views say nothing, by views where motion is open."""

import pytest
import torch

from dirl.models import LocalisingMemory, localising

AHEAD, RIGHT, LEFT, BACK = range(4)


def any_way(chosen):
    return torch.full((len(chosen), 4, 4), 1.4)


def walk(memory, *steps, goal=(), turns=4):
    """One agent that takes actions; of each visit the log odds that it is the place of an earlier one, as it faced."""
    places = memory.begin(1, turns=turns)
    for visit, (action, alike) in enumerate(((-1, {}), *steps)):
        places.action = torch.tensor([action])
        odds = torch.zeros(1, visit, 4)
        for earlier, value in alike.items():
            odds[0, earlier] = torch.tensor([value, -9, -9, -9])
        seen = torch.full((1, 4), -9.0)
        for view, value in dict(goal).get(visit, {}).items():
            seen[0, view] = value
        places = memory.arrive(places, odds, seen, any_way)
    return places


def test_a_square_closes_by_motion_alone():
    ahead_and_right = [(AHEAD, {}), (RIGHT, {})] * 4
    places = walk(LocalisingMemory(), *ahead_and_right)
    assert places.here.item() == 0
    assert places.node[0].tolist()[1:3] == [4, 5]
    assert (places.node[0] // 4).unique().tolist() == [0, 1, 2, 3]


def test_motion_outweighs_a_look_that_errs_and_strong_evidence_a_slip():
    there_and_back = walk(LocalisingMemory(), (AHEAD, {0: -3.0}), (BACK, {0: -2.0, 1: 1.0}))
    assert there_and_back.here.item() == 0
    seen = (AHEAD, {0: -3.0}), (BACK, {0: -9.0, 1: 9.0})
    assert walk(LocalisingMemory(), *seen).here.item() == 4
    assert walk(LocalisingMemory(temperature=10.0), *seen).here.item() == 0


def test_what_is_seen_counts_in_full_with_a_map():
    memory = LocalisingMemory(temperature=10.0)
    places = walk(memory, (AHEAD, {0: -3.0}))
    places.action[:] = -1
    alike = torch.tensor([[[2.0, -3.0, -3.0, -3.0], [-3.0, -3.0, -3.0, -3.0]]])
    found = []
    for mapped in (False, True):
        places.mapped[:] = mapped
        likely = memory.likely(places, alike)[0]
        found.append((likely[0] - likely[4]).item())
    assert found == pytest.approx([0.5, 5.0])


def test_visits_of_a_place_add_up():
    memory = LocalisingMemory(confidence=0.99, correlation=0.0)
    once = walk(memory, goal={0: {0: 3.0}})
    again = walk(memory, (RIGHT, {}), (LEFT, {}), goal={0: {0: 3.0}, 1: {3: 3.0}, 2: {0: 3.0}})
    assert not memory.stops(once).item()
    assert memory.stops(again).item()
    assert not LocalisingMemory(confidence=0.99, correlation=1.0).stops(again).item()


def test_a_view_that_shows_nothing_tells_nothing_of_the_goal():
    """As of a dead camera ahead: a camera aside has seen the goal before the agent turned to it."""
    memory, seen_aside = LocalisingMemory(), {0: {1: 7.0}, 1: {0: -torch.inf}}
    places = walk(memory, (RIGHT, {}), goal=seen_aside)
    assert memory.stops(places).item()
    assert 0 < memory._goal(places)[0, places.here].item() < 7  # but less than before, or the agent would stay for ever
    nothing = walk(memory, goal={0: {0: -torch.inf}})
    assert not memory.stops(nothing).item()
    assert memory._goal(nothing)[0, nothing.here].item() == -torch.inf


def test_what_is_somewhat_like_the_goal_is_left_to_see_its_neighbours_and_returned_to():
    memory = LocalisingMemory(confidence=0.95, neighbour=2.0, correlation=0.0)
    places, facing, seen = memory.begin(1), 0, 0
    position, actions = (0, 0), []
    for visit in range(40):
        odds = torch.full((1, 4), -9.0)
        odds[0, -facing % 4] = 3.0 if position == (0, 0) and not seen else -9.0 if position != (0, 0) else 0.0
        seen += position == (0, 0)
        places = memory.arrive(places, torch.zeros(1, visit, 4), odds, any_way)
        if memory.stops(places).item():
            break
        action = memory.plan(places).argmax().item()
        actions.append(action)
        places.action = torch.tensor([action])
        facing += {RIGHT: 1, LEFT: -1}.get(action, 0)
        step = {AHEAD: 1, BACK: -1}.get(action, 0)
        x, z = ((0, 1), (1, 0), (0, -1), (-1, 0))[facing % 4]
        position = (position[0] + step * x, position[1] + step * z)
    assert position == (0, 0)
    assert facing % 4 == 0
    assert sum(action in (AHEAD, BACK) for action in actions) == 8  # four neighbours, there and back


def test_who_knows_the_whole_place_stops_at_the_most_probable_node():
    memory = LocalisingMemory()
    steps = [step for visit in (0, 2, 4, 6) for step in ((AHEAD, {visit: 9.0}), (RIGHT, {}))][:-1]
    # Like the goal to the left of the start, and less so ahead of it.
    goal = {visit: {(3 - visit // 2) % 4: 0.3, -(visit // 2) % 4: 0.0} for visit in range(8)}
    closed, open_ahead = walk(memory, *steps, goal=goal), walk(memory, *steps[:-1], goal=goal)
    assert (closed.after >= 0)[closed.used].all()
    assert memory.stops(closed).item()
    assert not memory.stops(open_ahead).item()
    assert not LocalisingMemory(settle=0.95).stops(closed).item()


def test_where_all_was_tried_an_uncertain_place_is_seen_again_but_not_for_ever(monkeypatch):
    around = [(AHEAD, {0: -3.0}), (BACK, {})]
    around = [*around, *((RIGHT, {}), *around) * 3]
    goal = {visit: dict.fromkeys(range(4), 0.7) for visit in (0, 2, 3, 5, 6, 8, 9, 11)}
    left = walk(LocalisingMemory(), *around, (AHEAD, {}), goal=goal)
    assert not LocalisingMemory().stops(left).item()
    assert LocalisingMemory().plan(left).argmax().item() == BACK
    assert LocalisingMemory(seek=2.0).plan(left).argmax().item() != BACK
    seen_often = [*around, *[(AHEAD, {}), (BACK, {})] * 4, (AHEAD, {})]
    left = walk(LocalisingMemory(), *seen_often, goal=goal | dict.fromkeys((13, 15, 17, 19), goal[0]))
    monkeypatch.setattr(localising, "LOOKS", 12)
    assert LocalisingMemory().plan(left).argmax().item() == BACK
    monkeypatch.setattr(localising, "_panorama", lambda _: True)
    assert LocalisingMemory().plan(left).argmax().item() != BACK


def test_a_move_that_no_arrow_shows_is_not_tried_and_hides_no_goal():
    """One arrow, to the right; with the place turned around once, all is known, and what is settled suffices."""
    memory = LocalisingMemory(confidence=0.9999, settle=0.5)
    for arrows in ([(1, AHEAD), (3, BACK)], []):
        cost = torch.full((1, 4, 4), torch.inf)
        cost[..., [RIGHT, LEFT]] = 1.0
        for view, action in arrows:
            cost[0, view, action] = 1.0
        odds = torch.tensor([[2.0, -9, -9, -9]])
        places = memory.arrive(memory.begin(1), torch.zeros(1, 0, 4), odds, lambda _, cost=cost: cost)
        assert memory.stops(places).item() == (not arrows)
    assert memory.plan(places)[0, [AHEAD, BACK]].isinf().all()


def passed(turns, actions, last=-5.0):
    """The node where an agent is after actions; nothing looks like anything, but the last visit like the first."""
    memory = LocalisingMemory()
    places = memory.begin(1, turns=turns, views=turns)
    for visit, action in enumerate((-1, *actions)):
        places.action = torch.tensor([action])
        alike = torch.full(places.goal.shape, -5.0)
        if visit == len(actions):
            alike[0, 0, 0] = last
        cost = torch.full((1, turns, 4), 1.4)
        places = memory.arrive(places, alike, torch.full((1, turns), -9.0), lambda _, cost=cost: cost)
    return int(places.here)


@pytest.mark.parametrize(("turns", "by_motion", "by_views"), [(4, True, False), (8, False, True)])
def test_panoramas_stand_anywhere_so_that_their_views_tell_places_and_not_the_motion(turns, by_motion, by_views):
    square = [*[AHEAD, *[RIGHT] * (turns // 4)] * 3, AHEAD]
    assert (passed(turns, square) // turns == 0) == by_motion
    assert (passed(turns, [AHEAD, AHEAD], last=3.0) == 0) == by_views


def at_known_panorama(there, action=AHEAD):
    """Log probabilities of the nodes, after an action at the first of two places, that differ by what arrows show."""
    memory = LocalisingMemory()
    places, turns = memory.begin(1, turns=8, views=8), 8
    arrows = torch.zeros(2, turns, 4, dtype=torch.bool)
    arrows[:, :, [RIGHT, LEFT]] = True
    arrows[0, 0, AHEAD] = arrows[1, 2, AHEAD] = True
    for visit, shown in enumerate(arrows):
        places.action = torch.tensor([-1 if not visit else AHEAD])
        cost = torch.where(shown, 1.0, torch.inf)[None]
        odds = torch.full((1, visit, turns), -5.0)
        places = memory.arrive(places, odds, torch.full((1, turns), -9.0), lambda _, cost=cost: cost, shown[None])
    places.action, places.node = torch.tensor([action]), torch.cat([places.node, torch.zeros(1, 1, dtype=int)], 1)
    places.goal = torch.cat([places.goal, places.goal[:, :1]], 1)
    places.after[:] = torch.where(places.after // turns == torch.arange(16)[:, None] // turns, places.after, -1)
    return memory.likely(places, torch.zeros(1, 3, turns), None if there is None else arrows[there][None])[0]


def test_places_with_other_arrows_are_hardly_taken_for_one():
    told, untold = at_known_panorama(there=1), at_known_panorama(there=None)
    assert told[1] + 4 < untold[1]
    assert (told[6], told[8]) == (untold[6], untold[8])  # turned, the arrows of the first place are those of the second


def test_who_follows_an_arrow_leaves_and_who_does_not_stays():
    followed, other = at_known_panorama(0), at_known_panorama(0, BACK)
    assert followed[0] == -torch.inf < at_known_panorama(None)[0]
    assert (int(followed.argmax()), int(other.argmax())) == (16, 0)
    assert other[16] + 3 < other[0]
