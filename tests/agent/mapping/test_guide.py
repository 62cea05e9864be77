"""Being led to a photo, live, in a hall."""

import pickle

import numpy as np
import pytest
from hall import look, walk

import dirl
from dirl.agent.mapping import MapError
from dirl.agent.mapping.frames import map_recordings
from dirl.perception.matching import Matcher

pytest.importorskip("cv2")


@pytest.fixture(scope="module")
def matcher():
    return Matcher("sift")


@pytest.fixture(scope="module")
def graph(matcher):
    """A walk along the hall, a turn to the left, and a step towards the wall."""
    along = [(2 + x, 1.5, 0) for x in range(10)]
    turn = [(11, 1.5, 18 * part) for part in range(1, 6)]
    return map_recordings([walk([*along, *turn, (11, 2.2, 90)])], matcher, 65.0)


def test_a_guide_can_be_pickled(graph, matcher):
    guide = dirl.Guide(graph, [look(11, 2.1, 90)], matcher)
    again = pickle.loads(pickle.dumps(guide))
    assert again.see(look(3.2, 1.6, -6)) == guide.see(look(3.2, 1.6, -6))


def test_a_walker_who_does_what_is_said_arrives(graph, matcher):
    guide = dirl.Guide(graph, [look(11, 2.1, 90)], matcher)
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


def test_views_that_are_turned_aside_are_turned_back(graph, matcher):
    for aside in (-15, 15):
        guide = dirl.Guide(graph, [look(11, 2.1, 90)], matcher)
        for _ in range(2):
            advice = guide.see(look(5, 1.5, aside))
        assert advice.turn == pytest.approx(-aside, abs=10)
        assert str(advice).startswith("turn right by" if aside > 0 else "turn left by")


def test_another_hall_is_no_place_to_begin_or_to_go_to(graph, matcher):
    with pytest.raises(MapError, match="was not taken where"):
        dirl.Guide(graph, [look(6, 2, 0, seed=9)], matcher)
    guide = dirl.Guide(graph, [look(11, 2.1, 90, size=(360, 720))], matcher)  # wider: what is beside is cut off
    rng = np.random.default_rng(0)
    noise = [guide.see(rng.integers(0, 255, (180, 320, 3), np.uint8)).say for _ in range(3)]
    assert noise[-1] == "lost"


def test_who_does_not_move_though_told_to_is_stuck(graph, matcher):
    guide = dirl.Guide(graph, [look(11, 2.1, 90)], matcher)
    said = [guide.see(look(5, 1.5, 0)).say for _ in range(8)]
    assert "ahead" in said
    assert "stuck" in said
    guide = dirl.Guide(graph, [look(11, 2.1, 90)], matcher)
    assert "stuck" not in [guide.see(look(3 + 0.7 * step, 1.5, 0)).say for step in range(8)]
