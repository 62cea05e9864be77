import json
import math
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PatchCollection
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.quiver import Quiver
from PIL import Image
from rooms import CELL, grid_scene, renumbered

from dirl.reporting import draw_learning_curve, draw_trajectories, result_table, run_title, summary_table
from dirl.reporting.style import write_figure
from dirl.reporting.trajectories import chosen_steps, path_actions
from dirl.scenes import load_scenes, read_dump
from dirl.scenes.geometry import heading_directions, step_length

MEASURES = {
    "atl": 146.194,
    "atl_success": 9.5,
    "sr": 0.998,
    "spl": 0.9,
    "shortest": 12.66,
    "false_stop_rate": 0.25,
    "missed_stop_rate": 0.0,
    "episodes": 10_000,
}
SHOWN = ["146.2", "0.998", "0.900", "12.66", "0.250", "0.000", "10,000"]

SUMMARY = {
    "scene": "bathroom_02",
    "source": "rooms",
    "system": "td_drl",
    "seed": 3,
    "frames": 200_000,
    "frames_per_second": 2776.2,
    "seconds": 77.66,
    "stable_at_frame": 23_000,
    "peak_memory_mb": 1554.9,
    "shortest_path": MEASURES,
    "random": MEASURES,
    "greedy": {**MEASURES, "scenes": {"bathroom_02": {**MEASURES, "goals": {"26": MEASURES, "37": MEASURES}}}},
    "sampled": MEASURES,
}


def cells(table):
    """The cells of a Markdown table's lines, without the rule under the heading."""
    lines = [[cell.strip() for cell in line.strip("|").split(" | ")] for line in table.splitlines()]
    return [lines[0], *lines[2:]]


def labels(text):
    """The row labels of all tables in a text."""
    lines = [line for line in text.splitlines() if line.startswith("|") and not line.startswith("| -")]
    return [line.split("|")[1].strip() for line in lines]


# Figures


def test_a_png_has_the_pixels_that_matplotlib_itself_would_write(tmp_path):
    figure = Figure((4, 2), layout="constrained")
    axes, _ = figure.subplots(1, 2)
    axes.plot([3, 1, 2], label="a line")
    figure.legend(loc="outside lower center")
    write_figure(figure, tmp_path / "ours.png", dpi=90)
    FigureCanvasAgg(figure).print_figure(tmp_path / "theirs.png", dpi=90)
    ours, theirs = (np.asarray(Image.open(tmp_path / f"{name}.png").convert("RGB")) for name in ("ours", "theirs"))
    assert ours.shape == (180, 360, 3)
    assert np.array_equal(ours, theirs)


# Tables


def test_table_names_its_columns():
    assert cells(result_table({}))[0] == ["", "ATL", "SR", "SPL", "shortest", "false", "missed", "episodes"]
    assert cells(result_table({}, leave_out=["episodes", "SR"]))[0] == ["", "ATL", "SPL", "shortest", "false", "missed"]


def test_a_summary_fits_a_terminal_of_80_columns():
    rooms = {f"{name}_08": {**MEASURES, "goals": {"126": MEASURES}} for name in ("living_room", "bathroom")}
    assert max(map(len, summary_table(SUMMARY).splitlines())) == 80
    several = summary_table({**SUMMARY, "scene": list(rooms), "greedy": {**MEASURES, "scenes": rooms}})
    assert max(map(len, several.splitlines())) <= 80


def test_table_row_is_label_then_measures():
    assert cells(result_table({"greedy": MEASURES, "again": MEASURES}))[1:] == [["greedy", *SHOWN], ["again", *SHOWN]]


@pytest.mark.parametrize("none", [{"sr": None}, {"sr": math.nan}, {}])
def test_table_shows_what_is_unknown_as_a_dash(none):
    known = {key: value for key, value in MEASURES.items() if key != "sr"}
    assert cells(result_table({"random": {**known, **none}}))[1][1:4] == ["146.2", "-", "0.900"]


def test_table_is_aligned_markdown():
    lines = result_table({"short": MEASURES, "a much longer label": {"sr": 1.0}}).splitlines()
    assert len({len(line) for line in lines}) == 1
    bars = [[place for place, letter in enumerate(line) if letter == "|"] for line in lines]
    assert all(row == bars[0] for row in bars)
    rule = [cell.strip() for cell in lines[1].strip("|").split("|")]
    assert rule[0].strip("-") == ""
    assert all(cell.strip("-") == ":" and cell.endswith("--:") for cell in rule[1:])


def test_table_keeps_a_bar_in_a_label_from_being_a_column():
    assert r"| a\|b " in result_table({"a|b": MEASURES})


def test_summary_begins_with_what_was_run():
    assert summary_table(SUMMARY).splitlines()[:3] == [
        "TD-DRL, bathroom_02 (source: rooms, synthetic), seed 3: 200,000 frames, 2,776",
        "frames/s, 77.7 s in all, stable at 23,000 frames, peak memory 1,555 MB",
        "",
    ]


def test_summary_says_that_a_policy_was_never_stable():
    assert "never stable" in " ".join(summary_table({**SUMMARY, "stable_at_frame": None}).split())


def test_summary_of_an_evaluation_says_nothing_of_training():
    training = ("frames_per_second", "seconds", "stable_at_frame", "peak_memory_mb")
    evaluated = {key: value for key, value in SUMMARY.items() if key not in training}
    assert summary_table(evaluated).splitlines()[0].endswith("seed 3: 200,000 frames")


@pytest.mark.parametrize(
    ("seconds", "shown"),
    [(0.04, "0.0 s"), (119.9, "119.9 s"), (120, "2 min"), (3599, "1 h 0 min"), (5430, "1 h 30 min")],
)
def test_summary_shows_seconds_as_people_say_them(seconds, shown):
    assert f" {shown} in all" in " ".join(summary_table({**SUMMARY, "seconds": seconds}).split())


def test_summary_of_one_scene_lists_policies_and_goals():
    assert labels(summary_table(SUMMARY)) == [
        "",
        "shortest path",
        "random",
        "greedy",
        "sampled",
        "",
        "goal 26",
        "goal 37",
    ]


def test_summary_of_several_scenes_lists_each_before_its_goals():
    scenes = {"a": {**MEASURES, "goals": {"1": MEASURES}}, "b": {**MEASURES, "goals": {"1": MEASURES}}}
    text = summary_table({**SUMMARY, "scene": ["a", "b"], "greedy": {**MEASURES, "scenes": scenes}})
    assert labels(text)[6:] == ["a", "a, goal 1", "b", "b, goal 1"]
    assert text.startswith("TD-DRL, a, b (source")


def test_summary_rows_hold_the_measures_of_their_own():
    sections = ("shortest_path", "random", "greedy", "sampled")
    own = {key: {**SUMMARY[key], "episodes": number} for number, key in enumerate(sections, 1)}
    goals = {"26": {**MEASURES, "atl": 5}, "37": {**MEASURES, "atl": 6}}
    own["greedy"]["scenes"] = {"bathroom_02": {**MEASURES, "goals": goals}}
    tables = summary_table({**SUMMARY, **own}).split("\n\n")
    assert [row[-1] for row in cells(tables[1])[1:]] == ["1", "2", "3", "4"]
    assert [row[1] for row in cells(tables[3])[1:]] == ["5.00", "6.00"]


def test_summary_leaves_out_policies_that_were_not_evaluated():
    partial = {key: value for key, value in SUMMARY.items() if key not in ("random", "sampled")}
    assert labels(summary_table(partial))[:3] == ["", "shortest path", "greedy"]


@pytest.mark.parametrize(
    ("source", "shown"), [("rooms", "rooms, synthetic"), ("thor", "thor"), ("rooms+thor", "rooms, synthetic + thor")]
)
def test_title_tells_synthetic_rooms_from_published_scenes(source, shown):
    assert run_title({**SUMMARY, "source": source}) == f"TD-DRL, bathroom_02 (source: {shown}), seed 3"


def test_a_title_names_the_first_and_the_last_of_many_scenes():
    names = [f"room_{number}" for number in range(5)]
    assert "room_0, room_1, room_2, room_3 (" in run_title({**SUMMARY, "scene": names[:4]})
    assert "5 scenes, room_0 to room_4 (" in run_title({**SUMMARY, "scene": names})


# Pictures


@pytest.fixture
def drawn(monkeypatch):
    """The figures that were written to files."""
    figures = []
    draw = FigureCanvasAgg.draw

    def record(canvas):
        draw(canvas)
        figures.append(canvas.figure)

    monkeypatch.setattr(FigureCanvasAgg, "draw", record)
    return figures


def assert_is_image(file):
    with Image.open(file) as image:
        image.load()
        assert image.format == "PNG"
        assert min(image.size) > 250
        assert len(set(image.convert("L").resize((64, 64)).tobytes())) > 3
    assert file.stat().st_size < 600_000


def assert_nothing_is_cut_or_covered(figure):
    """Titles, legends, and axes with their labels lie within the figure, none on another."""
    renderer = figure.canvas.get_renderer()
    parts = [figure, *figure.subfigs]
    boxes = [axes.get_tightbbox(renderer) for axes in figure.axes]
    boxes += [legend.get_window_extent(renderer) for part in parts for legend in part.legends]
    boxes += [part._suptitle.get_window_extent(renderer) for part in parts if part._suptitle is not None]
    for box in boxes:
        assert min(box.x0, box.y0) >= 0
        assert box.x1 <= figure.bbox.x1
        assert box.y1 <= figure.bbox.y1
    assert not any(box.overlaps(other) for number, box in enumerate(boxes) for other in boxes[:number])


# Learning curves

REINFORCEMENT = [(1000, "", ""), (2000, 150, 180), (3000, "", 170), (4000, 8.5, 12)]
EVALUATION = [(0, 197.5, 0.01, 0.005), (2000, 40, 0.8, 0.6), (4000, 7, 1, 0.9)]
IMITATION = [(1, 1.39, 0.15), (2, 0.8, 0.75), (3, 0.1, 1)]
HEADINGS = {
    "reinforcement": "frames,atl,atl_worst_goal",
    "evaluation": "frames,atl,sr,spl",
    "imitation": "step,loss,accuracy",
}


@pytest.fixture
def run(tmp_path, drawn):
    """Writes a run's folder, draws it, and returns the figure."""

    def draw(summary=(), **tables):
        facts = {"scene": "room", "source": "rooms", "system": "dirl", "seed": 7, "frames": 4000}
        facts |= {"stable_at_frame": 3500, "greedy": {"shortest": 6.13}} | dict(summary)
        (tmp_path / "summary.json").write_text(json.dumps(facts))
        for stage, rows in tables.items():
            lines = [HEADINGS[stage], *(",".join(map(str, row)) for row in rows)]
            (tmp_path / f"{stage}.csv").write_text("\n".join(lines) + "\n")
        draw_learning_curve(tmp_path, tmp_path / "curve.png")
        assert_is_image(tmp_path / "curve.png")
        assert_nothing_is_cut_or_covered(drawn[0])
        return drawn[0]

    return draw


def lines(axes):
    """What the lines of a panel go through, by their labels."""
    return {line.get_label(): [list(map(float, values)) for values in line.get_data()] for line in axes.lines}


def starting(lines, label):
    """The one line whose label starts so."""
    (found,) = [points for name, points in lines.items() if name.startswith(label)]
    return found


def test_curve_shows_training_and_greedy_evaluation(run):
    upper, lower = run(reinforcement=REINFORCEMENT, evaluation=EVALUATION, imitation=IMITATION).axes
    atl, shares = lines(upper), lines(lower)
    assert starting(atl, "training, mean") == [[2000, 4000], [150, 8.5]]
    assert starting(atl, "training, worst") == [[2000, 3000, 4000], [180, 170, 12]]
    assert starting(atl, "greedy") == [[0, 2000, 4000], [197.5, 40, 7]]
    assert starting(shares, "SR") == [[0, 2000, 4000], [0.01, 0.8, 1]]
    assert starting(shares, "SPL") == [[0, 2000, 4000], [0.005, 0.6, 0.9]]
    assert upper.get_yscale() == "log"
    assert upper.get_xlim() == lower.get_xlim()


def test_curve_marks_shortest_path_stability_limit_and_where_the_policy_is_stable(run):
    upper, lower = run(reinforcement=REINFORCEMENT, evaluation=EVALUATION).axes
    atl = lines(upper)
    assert starting(atl, "shortest path of the evaluation, 6.13;")[1] == [6.13, 6.13]
    assert atl["stability limit, 20"][1] == [20, 20]
    assert atl["stable at 3,500 frames"][0] == [3500, 3500]
    assert [3500, 3500] in [points[0] for points in lines(lower).values()]


def test_curve_marks_no_place_where_the_policy_was_never_stable(run):
    upper, _ = run({"stable_at_frame": None}, reinforcement=REINFORCEMENT, evaluation=EVALUATION).axes
    assert not any(label.startswith("stable at") for label in lines(upper))


def test_curve_is_titled_with_what_was_run(run):
    figure = run({"system": "td_drl"}, reinforcement=REINFORCEMENT, evaluation=EVALUATION)
    assert figure.get_suptitle() == "TD-DRL, room (source: rooms, synthetic), seed 7"


@pytest.mark.parametrize(
    "reinforcement", [[], [(4000, "", "")], [(2000, "", ""), (4000, "", "")]], ids=["no rows", "one row", "two rows"]
)
def test_curve_without_any_finished_episode_shows_the_first_evaluation(run, reinforcement):
    upper, lower = run({"stable_at_frame": None}, reinforcement=reinforcement, evaluation=EVALUATION[:1]).axes
    assert not any(label.startswith("training") for label in lines(upper))
    assert starting(lines(upper), "greedy") == [[0], [197.5]]
    assert upper.lines[0].get_marker() == "o"  # a line through one point would not show
    assert lower.get_xlim()[1] >= 4000


def test_curve_of_imitation_alone_shows_its_loss_and_accuracy(run):
    upper, lower = run({"frames": 0, "stable_at_frame": None}, imitation=IMITATION, evaluation=EVALUATION[:1]).axes
    assert (upper.get_ylabel(), lower.get_ylabel()) == ("loss", "accuracy")
    assert list(lines(upper).values()) == [[[1, 2, 3], [1.39, 0.8, 0.1]]]
    assert list(lines(lower).values()) == [[[1, 2, 3], [0.15, 0.75, 1]]]


def test_curve_of_an_untrained_policy_shows_its_evaluation(run):
    upper, _ = run({"frames": 0, "stable_at_frame": None}, evaluation=EVALUATION[:1]).axes
    assert starting(lines(upper), "greedy") == [[0], [197.5]]


def test_curve_needs_the_folder_of_a_finished_run(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"summary\.json"):
        draw_learning_curve(tmp_path, tmp_path / "curve.png")


# Directions on the map


def compass(scene, sense=1, zero=0.0):
    """Unit vectors (x, z) of the headings, counted from ``zero`` degrees, clockwise if ``sense`` is 1."""
    angle = np.deg2rad(sense * scene.headings + zero)
    return np.stack([np.sin(angle), np.cos(angle)], 1)


@pytest.mark.parametrize("headings", [4, 12])
def test_headings_of_ai2thor_point_clockwise_from_z(headings):
    scene = grid_scene(3, 2, headings=headings, blocked=[(1, 0)])
    np.testing.assert_allclose(heading_directions(scene), compass(scene), atol=1e-6)


def test_headings_point_where_moving_ahead_leads_however_the_file_counts_them():
    room = grid_scene(3, 2)
    mirrored = replace(room, positions=room.positions * [-1, 1])
    swapped = replace(room, positions=room.positions[:, ::-1].copy())
    from_x = replace(room, headings=(room.headings - 90) % 360)
    shuffled = renumbered(room, np.random.default_rng(0).permutation(len(room)))
    for scene in (room, mirrored, swapped, from_x, shuffled):
        free = np.flatnonzero(scene.graph[:, 0] >= 0)
        moves = scene.positions[scene.graph[free, 0]] - scene.positions[free]
        np.testing.assert_allclose(heading_directions(scene)[free] * CELL, moves, atol=1e-6)
        # In front of a wall too: half a turn on it is the opposite direction.
        around = scene.surrounding[:, 2]
        np.testing.assert_allclose(heading_directions(scene)[around], -heading_directions(scene), atol=1e-6)


def test_headings_are_those_of_ai2thor_where_no_move_tells():
    corridor = grid_scene(3, 1)
    lone = grid_scene(3, 1, blocked=[(0, 0), (2, 0)])
    # One row of places, and every heading called 0: the moves to one end cancel those to the other.
    nameless = replace(corridor, headings=np.zeros(len(corridor)))
    for scene in (corridor, lone, nameless):
        np.testing.assert_allclose(heading_directions(scene), compass(scene), atol=1e-6)


def test_step_length_is_that_of_the_moves():
    room = grid_scene(3, 2)
    assert step_length(room) == pytest.approx(CELL)
    assert step_length(replace(room, positions=room.positions * 3)) == pytest.approx(3 * CELL)


# Paths


def test_path_actions_are_read_off_the_graph(scene):
    # Right, ahead along x, into the wall behind it twice, back, left.
    path = [0, 1, 5, 9, 9, 5, 4]
    assert path_actions(scene, path) == ["right", "ahead", "ahead", "blocked", "back", "left"]
    assert path_actions(scene, [3]) == []


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ([], "at least its start"),
        ([0, 2], "no action leads from state 0 to state 2"),
        ([0, -1], "-1 is not a state"),
        ([24], r"24 is not a state; states are 0\.\.23"),
    ],
)
def test_impossible_paths_are_refused(scene, path, message):
    with pytest.raises(ValueError, match=message):
        path_actions(scene, path)


@pytest.mark.parametrize(
    ("steps", "chosen"),
    [
        (0, [0]),
        (1, [0, 1]),
        (7, list(range(8))),
        (14, list(range(0, 15, 2))),
        (200, [0, 29, 57, 86, 114, 143, 171, 200]),
    ],
)
def test_views_are_of_evenly_spread_steps_with_the_first_and_last(steps, chosen):
    assert chosen_steps(steps) == chosen


WAYS = ([0, 1, 5, 9, 10, 11, 7], [16, 17, 18, 6, 18, 6])
"""In the room of `scene`; the first arrives at its goal, 7, the second goes to and fro between places 4 and 1."""


@pytest.fixture
def picture(tmp_path, drawn):
    """Draws paths, and returns the figure."""

    def draw(scene, goal, paths, success, title="a title"):
        draw_trajectories(scene, goal, paths, tmp_path / "paths.png", success=success, title=title)
        assert_is_image(tmp_path / "paths.png")
        assert_nothing_is_cut_or_covered(drawn[-1])
        return drawn[-1]

    return draw


def of_kind(axes, kind):
    return [artist for artist in axes.get_children() if isinstance(artist, kind)]


def test_map_shows_the_places_an_agent_can_be_at(picture):
    room = grid_scene(3, 2, blocked=[(1, 0)])
    axes = picture(room, 0, [[4, 5]], [False]).axes[0]
    (squares,) = of_kind(axes, PatchCollection)
    middles = {tuple(path.vertices[:4].mean(0).round(3)) for path in squares.get_paths()}
    assert middles == {(0, 0), (1, 0), (0, 0.5), (0.5, 0.5), (1, 0.5)}
    assert {np.ptp(path.vertices[:, 0]).round(6) for path in squares.get_paths()} == {CELL}
    assert axes.get_aspect() == 1
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("x (m)", "z (m)")


def test_map_shows_paths_apart_and_failed_ones_dashed(scene, picture):
    axes = picture(scene, 7, WAYS, [True, False]).axes[0]
    arrived, failed = of_kind(axes, LineCollection)
    assert arrived.get_linestyle()[0][1] is None
    assert failed.get_linestyle()[0][1] is not None
    assert arrived.get_color().tolist() != failed.get_color().tolist()
    # Between the places they go through, once each, where a path goes back and forth as it went last; both shifted.
    shifts = []
    for collection, pairs in ((arrived, [(0, 1), (2, 1)]), (failed, [(4, 1)])):
        ends = np.array([path.vertices for path in collection.get_paths()])
        shift = ends - scene.positions[4 * np.array(pairs)]
        np.testing.assert_allclose(shift, np.broadcast_to(shift[0, 0], shift.shape), atol=1e-9)
        shifts.append(shift[0, 0])
    np.testing.assert_allclose(shifts[0], -shifts[1], atol=1e-9)
    assert 0 < np.abs(shifts[0]).min() < CELL / 4
    (cross,) = [line for line in axes.lines if line.get_marker() == "X"]
    np.testing.assert_allclose(cross.get_xydata()[0], scene.positions[6] + shifts[1])


def test_map_shows_the_heading_of_each_state_of_a_path_and_of_the_goal(scene, picture):
    axes = picture(scene, 7, WAYS, [True, False]).axes[0]
    arrows = of_kind(axes, Quiver)
    along = compass(scene)
    for quiver, states in zip(arrows, ([0, 1, 5, 9, 10, 11, 7], [16, 17, 18, 6], [7]), strict=True):
        drawn = np.stack([quiver.U, quiver.V], 1)
        lengths = np.linalg.norm(drawn, axis=1, keepdims=True)
        np.testing.assert_allclose(drawn / lengths, along[states], atol=1e-6)
    (star,) = [line for line in axes.lines if line.get_marker() == "*"]
    assert star.get_xydata()[0].tolist() == scene.positions[7].tolist()


def test_legend_says_where_paths_begin_and_how_they_end(scene, picture):
    figure = picture(scene, 7, [*WAYS, [11, 7]], [True, False, True])
    (legend,) = [legend for part in figure.subfigs for legend in part.legends]
    assert [text.get_text() for text in legend.get_texts()] == [
        "1: from state 0, 6 steps",
        "2: from state 16, 5 steps, failed",
        "3: from state 11, 1 step",
        "start; arrows: heading",
        "end of a failed path",
        "goal, state 7",
        "walls, furniture",
    ]


def test_views_follow_the_first_path_and_end_with_the_goals(dump, picture):
    scene = read_dump(dump)  # every pixel of a view is its state's number
    figure = picture(scene, 0, [[9, 10, 11, 7, 3], [1, 0]], [False, True])
    shown = [axes for axes in figure.axes[:-1] if axes.images]
    assert [int(axes.images[0].get_array().max()) for axes in shown] == [9, 10, 11, 7, 3, 0]
    assert [axes.get_title() for axes in shown] == [
        "step 0: right",
        "step 1: right",
        "step 2: ahead",
        "step 3: ahead",
        "step 4: failed",
        "goal",
    ]
    frames = [to_hex(axes.spines["top"].get_edgecolor()) if axes.spines["top"].get_visible() else "" for axes in shown]
    assert frames == ["", "", "", "", "#0072b2", "#f0e442"]


def test_a_long_path_shows_eight_views_and_its_end(dump, picture):
    scene = read_dump(dump)
    figure = picture(scene, 0, [[1, 2, 3] + [0, 1, 2, 3] * 20 + [0]], [True])
    titles = [axes.get_title() for axes in figure.axes if axes.images]
    assert len(titles) == 9
    assert titles[7:] == ["step 83: goal reached", "goal"]


def test_a_scene_without_views_is_drawn_as_its_map_alone(scene, picture):
    assert len(picture(scene, 7, WAYS, [True, False]).axes) == 1


@pytest.mark.parametrize(("width", "depth"), [(1, 9), (9, 1), (2, 2)])
def test_rooms_of_any_shape_fit_under_a_long_title(width, depth, picture):
    room = grid_scene(width, depth)
    title = "DIRL without imitation, a room of an unusual shape (source: synthetic), goal 0, seed 0"
    figure = picture(room, 0, [[3, 2, 1, 0]] * 7, [True] * 7, title)
    assert figure.get_suptitle().replace("\n", " ") == title


def test_drawing_refuses_what_does_not_go_together_and_writes_nothing(scene, tmp_path):
    file = tmp_path / "paths.png"
    for goal, paths, success in ((7, [], []), (7, WAYS, [True]), (7, [[0, 2]], [True]), (24, WAYS, [True, True])):
        with pytest.raises(ValueError, match=r"successes|no action leads|is not a state"):
            draw_trajectories(scene, goal, paths, file, success=success, title="")
    assert not file.exists()


def test_a_built_in_room_is_drawn_with_its_views(picture):
    room = load_scenes("bathroom_02")[0]
    goal = room.goals[0]
    path = [int(np.argmax(room.distances[:, goal]))]
    while path[-1] != goal:
        nearer = room.graph[path[-1]]
        path.append(int(nearer[np.where(nearer < 0, len(room), room.distances[nearer, goal]).argmin()]))
    figure = picture(room, goal, [path], [True], "DIRL, bathroom_02 (source: rooms, synthetic), goal 26, seed 0")
    first = next(axes for axes in figure.axes if axes.images)
    np.testing.assert_array_equal(first.images[0].get_array(), room.views[path[0]])
