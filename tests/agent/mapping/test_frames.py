"""Maps of recordings: where photos are found, what is linked and what is refused; being led to a photo, live."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from hall import look, walk
from refusals import refused

import dirl
from dirl.agent.mapping.frames import SCHEMA, check_memory, find_links, load_frames_map, map_recordings
from dirl.agent.mapping.guide import PATIENCE, spread
from dirl.agent.mapping.moves import moves_along
from dirl.perception.matching import Described, Fit, Motion
from dirl.runs.checkpoints import save_checkpoint

ALONG = [(1 + x, 2.5, 0) for x in range(14)]


def shown(sign, other=0):
    """A view with a sign; what else is in it may change."""
    return np.stack([np.full((4, 4), value, np.uint8) for value in (sign, other, 0)], -1)


def recording(signs):
    """A recording of views with signs."""
    return [(shown(sign), float(time), None) for time, sign in enumerate(signs)]


CORRIDOR = recording(range(18))
"""A recording by `Bricks`."""


@pytest.fixture(scope="module")
def graph(sift):
    """A walk along a hall, a turn to the left, and a walk on aside."""
    turn = [(14.5, 2.5, 20 * part) for part in range(1, 5)]
    return map_recordings([walk(ALONG + turn)], sift, 65.0)


def linked(matcher, *recordings):
    """The pairs of frames that show one place."""
    return find_links(map_recordings(recordings, matcher, 65.0), matcher).links


def test_photos_and_films_are_found_where_they_were_taken_and_those_of_another_hall_are_not(graph, sift):
    found = graph.find(sift, sift.describe([look(6.4, 2.3, 4)]))
    assert abs(found.frame - 5) <= 1
    assert found.answer != "not here"
    assert np.array_equal(graph.described.looks[3], sift.describe([look(*ALONG[3])]).looks[0])
    assert graph.find(sift, sift.describe([look(6.4, 2.3, 4, seed=9)])).answer == "not here"
    film = sift.describe([look(x, 2.6, 0) for x in (4.2, 5.2, 6.2)])
    there, back = graph.find(sift, film), graph.find(sift, film[::-1])
    assert abs(there.frame - 4) <= 1
    assert (back.frame, back.probability) == (there.frame, pytest.approx(there.probability))


def test_a_place_that_is_passed_twice_is_linked_and_not_to_one_that_is_less_alike_than_another(sift):
    """The twin of the hall is recorded before the hall is passed again: nothing better was there to compare with."""
    first, other, twin, again = (
        walk([(begin + x, 2.5, 0) for x in range(14)], seed, size=(180, 320))
        for begin, seed in ((1, 0), (1, 9), (1.2, 0), (1.05, 0))
    )
    twin = [(np.hstack([hall[0][:, :130], own[0][:, 130:]]), *own[1:]) for hall, own in zip(other, twin, strict=True)]
    assert len(linked(sift, first, twin)) > 3
    links = linked(sift, first, twin, again)
    far = [abs(first - (second - 28)) for first, second in links if second >= 28]
    assert len(far) > 3
    assert max(far) <= 3
    assert len(links) - len(far) <= 1  # at the very beginning, where fewer frames are compared


class Bricks:
    """A corridor whose walls repeat after ten frames; ``move`` is what is told of the way from a frame to another."""

    kind, period = "sift", 10

    def __init__(self, move):
        self.move = move

    def describe(self, views):
        signs = np.array([view[0, 0, :1] % self.period for view in views])
        points = np.zeros((len(signs), 1, 2), np.float16)
        return Described(signs.astype(np.float16), points, points.astype(np.int8), np.ones(len(signs), np.int16))

    def likeness(self, seen, frames):
        return -np.abs(frames.looks - seen.looks)[:, 0].astype(float)

    def fit(self, seen, frames, some):
        score = (200 - 70 * np.abs(frames.looks[some] - seen.looks)[:, 0]).clip(min=0).astype(np.float32)
        return Fit(score, *np.zeros((3, len(score)), np.float32))

    def motion(self, seen, frames, frame, size, field_of_view):
        return self.move


@pytest.mark.parametrize("closer", [3, 13])
def test_places_that_fit_alike_are_compared_closely(closer, monkeypatch):
    matcher = Bricks(None)
    matcher.kind = "xfeat"
    compared = []

    def fit_closely(seen, frames, some, size):
        compared.append(some)
        return (140.0 - 30 * np.abs(np.array(some) - closer)).clip(min=0)

    monkeypatch.setattr("dirl.agent.mapping.frames.fit_closely", fit_closely)
    graph = map_recordings([CORRIDOR], matcher, 65.0)
    assert graph.find(matcher, matcher.describe([CORRIDOR[3][0]])).frame == closer
    graph.find(matcher, matcher.describe([CORRIDOR[8][0]]))  # there is one such place
    assert [{3, 13} <= set(some) for some in compared] == [True]


def test_frames_beside_the_best_count_too_if_they_are_of_the_same_recording():
    bricks = Bricks(Motion(0, 0, 0))
    graph = map_recordings([recording((0, 3, 6)), recording((9, 3, 0))], bricks, 65.0)
    scores = graph.score(bricks, bricks.describe([shown(6)]))
    assert scores[2] > scores[1] > 0  # of the frame itself, and of the one before it
    assert scores[[0, 3, 4, 5]].tolist() == [0] * 4  # with the other recording it has nothing in common


class Glances(Bricks):
    """The walker looks to the left and back by turns; ``move`` is by how many degrees."""

    def motion(self, seen, frames, frame, size, field_of_view):
        elsewhere = frames.looks[frame, 0] != seen.looks[0, 0]
        return Motion(0, 0, (self.move if frame % 2 else -self.move) * elsewhere)


@pytest.mark.parametrize(
    ("walker", "leads_back"),
    [
        (Bricks(Motion(0, 0, 0)), False),
        (Bricks(Motion(0, 0, 0, True)), True),
        (Bricks(Motion(0, 0, 36)), True),
        (Bricks(Motion(0, 0, 20, True)), False),
        (Bricks(None), True),
        (Glances(8), False),
        (Glances(30), True),  # who turns far from one frame to the next stays there
    ],
    ids=["straight on", "on the spot", "around", "turned aside", "nothing is known", "glancing", "looking about"],
)
def test_frames_are_linked_where_the_moves_between_them_lead_back(walker, leads_back):
    assert (len(linked(walker, CORRIDOR)) > 0) == leads_back


@pytest.mark.parametrize(("alike", "links"), [([3], []), ([1, 2, 3, 4, 5], [[2, 9], [3, 10], [4, 11]])])
def test_frames_are_linked_where_those_around_them_agree_too(alike, links):
    """Not where two walks look alike for a moment."""
    bricks = Bricks(None)
    bricks.period = 255
    first = [10 * frame for frame in range(7)]
    second = [sign if frame in alike else 100 + sign for frame, sign in enumerate(first)]
    assert linked(bricks, recording(first), recording(second)).tolist() == links


def test_a_path_is_told_as_moves(graph, sift):
    moves = moves_along(graph, sift, graph.path(2, 17))
    assert [str(move).split()[0] for move in moves] == ["ahead", "turn"]
    assert moves[0].ahead == pytest.approx(12, abs=2)
    assert moves[1].turn == pytest.approx(80, abs=12)
    back = moves_along(graph, sift, graph.path(12, 4))
    assert [str(move) for move in back] == ["turn around", "ahead 8 s", "turn around"]


@pytest.mark.parametrize(("frames", "told"), [(6, "turn around"), (9, "turn left 56 degrees"), (10, None)])
def test_who_turned_past_half_a_circle_is_told_the_shorter_way_round(frames, told):
    turning = Bricks(Motion(0, 0, -38))
    graph = map_recordings([CORRIDOR], turning, 65.0)
    assert [str(move) for move in moves_along(graph, turning, range(frames))] == [told] * (told is not None)


def test_a_saved_map_is_the_same_and_a_damaged_one_is_refused(tmp_path, graph, sift):
    file = tmp_path / "walk.pt"
    graph.save(file)
    again = load_frames_map(file)
    assert again.pictures == graph.pictures
    assert again.size == graph.size
    assert np.array_equal(again.described.vectors, graph.described.vectors)
    photo = sift.describe([look(6.4, 2.3, 4)])
    assert np.array_equal(again.find(sift, photo).scores, graph.find(sift, photo).scores)
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 1
    file.write_bytes(data)
    refused("its digest differs from that of its content; make it anew", load_frames_map, file)
    narrow = replace(graph.described, vectors=graph.described.vectors[..., :9])
    refused("are described in another way", replace(graph, described=narrow).find, sift, photo)
    save_checkpoint(file, {"schema": 3})
    refused("another version", load_frames_map, file)
    save_checkpoint(file, {"schema": SCHEMA})
    refused(r"is no map of dirl \(KeyError", load_frames_map, file)
    refused("no such map", load_frames_map, tmp_path / "none.pt")


def test_too_few_frames_other_shapes_and_too_many_frames_are_refused(sift):
    refused("has 1 frames", map_recordings, [walk(ALONG[:1])], sift, 65.0)
    refused("expected RGB", map_recordings, [[(np.zeros((60, 80)), 0.0, None)]], sift, 65.0)
    two = [walk(ALONG[:2]), walk(ALONG[:2], size=(120, 160))]
    refused("recording 2: 160x120 pixels, not 256x144", map_recordings, two, sift, 65.0)
    refused("every=", check_memory, 10**9, 1.0)


def test_odometry_that_begins_late_stands_still_until_then(sift):
    frames = walk(ALONG[:3])
    frames[1:] = [(image, time, (time, 0.0, 90.0)) for image, time, _ in frames[1:]]
    graph = map_recordings([frames], sift, 65.0)
    assert graph.places.tolist() == [[1, 0, 90], [1, 0, 90], [2, 0, 90]]


@pytest.fixture(scope="module")
def corner(sift):
    """A walk along the hall, a turn to the left, and a step towards the wall."""
    along = [(2 + x, 1.5, 0) for x in range(10)]
    turn = [(11, 1.5, 18 * part) for part in range(1, 6)]
    return map_recordings([walk([*along, *turn, (11, 2.2, 90)])], sift, 65.0)


def test_a_walker_who_does_what_a_guide_says_that_was_pickled_arrives(corner, sift):
    guide = pickle.loads(pickle.dumps(dirl.Guide(corner, [look(11, 2.1, 90)], sift)))
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


def test_who_looks_aside_before_a_corner_is_told_of_the_same_corner(corner, sift):
    """What is in sight depends on where one looks; what leads does not."""
    turns = {}
    for aside in (0, -10, -15):
        guide = dirl.Guide(corner, [look(11, 2.1, 90)], sift)
        guide.see(look(10, 1.5, aside))
        turns[aside] = (advice := guide.see(look(11, 1.5, aside))).turn
    assert turns[-10] - turns[0] == pytest.approx(10, abs=4)
    assert turns[-15] - turns[0] == pytest.approx(15, abs=4)
    assert str(advice).startswith("turn left by")
    advice = dirl.Guide(corner, [look(11, 2.1, 90)], sift).see(look(5, 1.5, 15))
    assert (str(advice)[:13], advice.turn) == ("turn right by", pytest.approx(-15, abs=10))


def test_another_hall_is_no_place_to_begin_or_to_go_to(corner, sift):
    refused("was not taken where", dirl.Guide, corner, [look(6, 2, 0, seed=9)], sift)
    guide = dirl.Guide(corner, [look(11, 2.1, 90, size=(288, 576))], sift)  # wider: what is beside is cut off
    rng = np.random.default_rng(0)
    noise = [guide.see(rng.integers(0, 255, (144, 256, 3), np.uint8)).say for _ in range(3)]
    assert noise[-1] == "lost"


class Signs(Bricks):
    """Compares frames by the sign in their first pixel, which says a place along a walk; hundreds are recordings."""

    kind, period = "columns", 255

    def __init__(self, heading):
        self.heading = heading
        """Of a sign, degrees to the left; who looks elsewhere sees nothing in common."""
        self.everywhere = []
        """Of each view, whether it was compared with all frames."""

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


def recorded(matcher, *recordings, links=()):
    graph = map_recordings(list(map(recording, recordings)), matcher, 90.0)
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
