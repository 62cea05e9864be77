"""What follows from a graph: distances against an independent search, surrounding states, places, checks."""

from collections import deque

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from refusals import refused
from rooms import grid_scene, renumbered

from dirl.scenes import Scene
from dirl.scenes.graph import check_graph, places, shortest_distances, turns_per_circle

AHEAD, RIGHT, LEFT, BACK = range(4)


@st.composite
def rooms(draw):
    """A room of up to 4 by 3 places, some walled off, its states in any order."""
    width, depth = draw(st.integers(1, 4)), draw(st.integers(1, 3))
    cells = [(x, z) for x in range(width) for z in range(depth)]
    walls = draw(st.lists(st.sampled_from(cells), unique=True, max_size=len(cells) - 1))
    room = grid_scene(width, depth, goals=(), headings=draw(st.sampled_from([4, 8, 12])), blocked=walls)
    return renumbered(room, draw(st.permutations(range(len(room)))))


def searched(graph, start):
    """The fewest actions from one state to every other: a plain queue, forwards."""
    found = {start: 0}
    queue = deque([start])
    while queue:
        state = queue.popleft()
        for beyond in graph[state].tolist():
            if beyond >= 0 and beyond not in found:
                found[beyond] = found[state] + 1
                queue.append(beyond)
    return [found.get(state, -1) for state in range(len(graph))]


def with_dead_states(graph, count=4):
    """The graph with an isolated block in front: states without any move, as in the published bedroom."""
    moved = np.where(graph >= 0, graph + count, -1)
    return np.concatenate([np.full((count, 4), -1), moved])


@given(room=rooms(), data=st.data())
def test_distances_equal_a_plain_search(room, data):
    graph = with_dead_states(room.graph, data.draw(st.integers(0, 2)))
    closed = st.tuples(st.integers(0, len(graph) - 1), st.sampled_from([AHEAD, BACK]))
    for state, action in data.draw(st.lists(closed, max_size=5)):
        graph[state, action] = -1  # this way only: the link that leads back stays
    distances = shortest_distances(graph)
    assert distances.dtype == np.int32
    assert distances.tolist() == [searched(graph, start) for start in range(len(graph))]


@given(room=rooms())
def test_surrounding_states_are_ahead_right_back_and_left_at_the_same_place(room):
    check_graph(room.graph)
    surrounding = room.surrounding
    assert (surrounding[:, 0] == np.arange(len(room))).all()
    turned = (room.headings[surrounding] - room.headings[:, None]) % 360
    assert turned.tolist() == [[0, 90, 180, 270]] * len(room)
    assert (room.positions[surrounding] == room.positions[:, None]).all()


def test_dead_states_see_themselves_and_are_places_of_their_own():
    room = grid_scene()
    graph = with_dead_states(room.graph)
    check_graph(graph)
    surrounding = Scene("dead", graph, np.zeros((28, 2)), np.zeros(28)).surrounding
    assert surrounding[:4].tolist() == [[state] * 4 for state in range(4)]
    assert (surrounding[4:] == room.surrounding + 4).all()
    assert places(with_dead_states(grid_scene(width=2, depth=1).graph, 2)).tolist() == [0, 1, *[2] * 4, *[3] * 4]
    for headings in (4, 12):
        assert turns_per_circle(with_dead_states(grid_scene(headings=headings).graph)) == headings


@given(room=rooms())
def test_states_share_a_place_where_they_share_a_position(room):
    place = places(room.graph)
    same_position = (room.positions[:, None] == room.positions[None]).all(-1)
    assert ((place[:, None] == place[None]) == same_position).all()
    _, first = np.unique(place, return_index=True)
    assert (np.diff(first) > 0).all()  # numbered in the order of their first states


def ring(length):
    """One place with so many headings and nowhere to go."""
    states = np.arange(length)
    return np.stack([states * 0 - 1, (states + 1) % length, (states - 1) % length, states * 0 - 1], 1)


def changed(state, action, to):
    graph = grid_scene().graph.copy()
    graph[state, action] = to
    return graph


def test_a_graph_no_agent_could_walk_in_is_refused():
    refused(r"state 5: ahead leads to state 24, but states are 0\.\.23", check_graph, changed(5, AHEAD, 24))
    refused("state 6: turning right is blocked", check_graph, changed(6, RIGHT, -1))
    refused("state 5: turning right and back does not return", check_graph, changed(6, LEFT, -1))
    refused("state 0: a full turn to the right passes more than 360 states", check_graph, ring(400))
    refused("state 0: a full turn to the right passes 6 states", check_graph, ring(6))
    both = np.concatenate([ring(4), np.where(ring(8) >= 0, ring(8) + 4, -1)])
    refused(r"state 4: a full turn .* passes 8 states; .* \(4 at state 0\)", check_graph, both)
