"""Being led to a photo, live, in a hall."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from hall import look, walk
from refusals import refused

import dirl
from dirl.agent.mapping.frames import map_recordings
from dirl.agent.mapping.guide import PATIENCE, spread
from dirl.perception.matching import Described, Fit, Motion


@pytest.fixture(scope="module")
def graph(sift):
    """A walk along the hall, a turn to the left, and a step towards the wall."""
    along = [(2 + x, 1.5, 0) for x in range(10)]
    turn = [(11, 1.5, 18 * part) for part in range(1, 6)]
    return map_recordings([walk([*along, *turn, (11, 2.2, 90)])], sift, 65.0)


def test_a_guide_can_be_pickled(graph, sift):
    guide = dirl.Guide(graph, [look(11, 2.1, 90)], sift)
    again = pickle.loads(pickle.dumps(guide))
    assert again.see(look(3.2, 1.6, -6)) == guide.see(look(3.2, 1.6, -6))


def test_a_walker_who_does_what_is_said_arrives(graph, sift):
    guide = dirl.Guide(graph, [look(11, 2.1, 90)], sift)
    x, z, heading, said = 3.2, 1.6, -6.0, []
    for _ in range(40):
        advice = guide.see(look(x, z, heading))
        said.append(advice.say)
        if advice.say == "arrived":
            break
        heading += advice.turn if advice.say != "lost" else 30
        if advice.say == "ahead":
            x, z = x + 0.7 * np.cos(np.radians(heading)), z + 0.7 * np.sin(np.radians(heading))
    assert said[-1] == "arrived"
    assert np.hypot(x - 11, z - 2.1) < 1.5
    assert "turn" in said


def test_views_that_are_turned_aside_are_turned_back(graph, sift):
    for aside in (-15, 15):
        guide = dirl.Guide(graph, [look(11, 2.1, 90)], sift)
        for _ in range(2):
            advice = guide.see(look(5, 1.5, aside))
        assert advice.turn == pytest.approx(-aside, abs=10)
        assert str(advice).startswith("turn right by" if aside > 0 else "turn left by")


def test_who_looks_aside_before_a_corner_is_told_of_the_same_corner(graph, sift):
    """What is in sight depends on where one looks; what leads does not."""
    turns = {}
    for aside in (0, -10, -15):
        guide = dirl.Guide(graph, [look(11, 2.1, 90)], sift)
        guide.see(look(10, 1.5, aside))
        turns[aside] = guide.see(look(11, 1.5, aside)).turn
    assert turns[-10] - turns[0] == pytest.approx(10, abs=4)
    assert turns[-15] - turns[0] == pytest.approx(15, abs=4)


def test_another_hall_is_no_place_to_begin_or_to_go_to(graph, sift):
    refused("was not taken where", dirl.Guide, graph, [look(6, 2, 0, seed=9)], sift)
    guide = dirl.Guide(graph, [look(11, 2.1, 90, size=(360, 720))], sift)  # wider: what is beside is cut off
    rng = np.random.default_rng(0)
    noise = [guide.see(rng.integers(0, 255, (180, 320, 3), np.uint8)).say for _ in range(3)]
    assert noise[-1] == "lost"


class Signs:
    """Compares frames by the sign in their first pixel, which says a place along a walk; hundreds are recordings."""

    kind = "columns"

    def __init__(self, heading):
        self.heading = heading
        """Of a sign, degrees to the left; who looks elsewhere sees nothing in common."""
        self.everywhere = []
        """Of each view, whether it was compared with all frames."""

    def describe(self, views):
        signs = np.array([view[0, 0, :1] for view in views])
        points = np.zeros((len(signs), 1, 2), np.float16)
        return Described(signs.astype(np.float16), points, points.astype(np.int8), np.ones(len(signs), np.int16))

    def likeness(self, seen, frames, likely=None):
        self.everywhere.append(likely is None)
        return self.fit(seen, frames, range(len(frames))).score.astype(float)

    def fit(self, seen, frames, some):
        here, signs = float(seen.looks[0, 0]), frames.looks[list(some), 0].astype(float)
        turned = np.array([self.heading(sign) - self.heading(here) for sign in signs])
        score = np.maximum(0, 1 - np.abs(signs % 100 - here % 100) / 4) * (np.abs(turned) < 30)
        still = np.zeros(len(signs), np.float32)
        return Fit(score.astype(np.float32), still, still, still)

    def motion(self, seen, frames, frame, size, field_of_view):
        return Motion(0.0, 0.0, self.heading(float(frames.looks[frame, 0])) - self.heading(float(seen.looks[0, 0])))


def shown(sign, other=0):
    """A view with a sign; what else is in it may change."""
    return np.stack([np.full((4, 4), value, np.uint8) for value in (sign, other, 0)], -1)


def recorded(matcher, *recordings, links=()):
    graph = map_recordings(
        [[(shown(sign), float(n), None) for n, sign in enumerate(one)] for one in recordings], matcher, 90.0
    )
    return replace(graph, links=np.array(links, np.int64).reshape(-1, 2))


def test_the_path_that_was_followed_leads_while_it_is_in_sight():
    matcher = Signs(lambda sign: 20.0 if sign >= 100 else 0.0)
    guide = dirl.Guide(recorded(matcher, range(20), range(100, 120), links=[(10, 30)]), [shown(19)], matcher)
    guide.belief = np.eye(40)[5]
    assert guide.see(shown(5)).say == "ahead"
    guide.belief = np.eye(40)[26]  # as if one were in the other recording of the same place
    assert guide.see(shown(6)).say == "ahead"


def test_from_a_frame_one_may_get_to_those_it_is_linked_to():
    here = np.eye(40)
    links, none = np.array([[5, 30]]), np.zeros((0, 2), np.int64)
    for one, other in ((5, 30), (30, 5)):
        assert spread(here[one], links)[other] > 100 * spread(here[one], none)[other] > 0
        assert spread(here[one], links).sum() == pytest.approx(1)


def test_who_gets_no_further_turns_as_the_recording_did_and_then_takes_another_path():
    """The corner is out of sight of whoever stands before it."""
    matcher = Signs(lambda sign: 40.0 * min(max(sign - 5, 0), 2))
    guide = dirl.Guide(recorded(matcher, range(20)), [shown(19)], matcher)
    advice = [guide.see(shown(5, 60 * (view % 2))) for view in range(6 * PATIENCE)]
    assert [one.turn for one in advice[:3]] == [0, 0, pytest.approx(80)]
    assert "stuck" in [one.say for one in advice]
    assert 1 < sum(matcher.everywhere) < len(advice) / 2
