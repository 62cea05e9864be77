"""Tables, of sweeps too, learning curves, maps of a policy, and paths on the map."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
import yaml
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.quiver import Quiver
from omegaconf import OmegaConf
from PIL import Image
from rooms import CELL, grid_scene, renumbered

from dirl.reporting import draw_learning_curve, draw_trajectories, result_table, run_title, summary_table, write_gif
from dirl.reporting.curves import common_frames
from dirl.reporting.maps import never_arrives
from dirl.reporting.pictures import MAX_FRAMES
from dirl.reporting.statistics import mean_interval
from dirl.reporting.style import write_figure
from dirl.reporting.sweeps import SweepTable, seed_table
from dirl.reporting.tables import read_columns
from dirl.reporting.trajectories import path_actions
from dirl.scenes import read_dump
from dirl.scenes.graph import AHEAD, RIGHT

MEASURES = {"atl": 146.194, "atl_success": 9.5, "sr": 0.998, "spl": 0.9, "shortest": 12.66}
MEASURES |= {"false_stop_rate": 0.25, "missed_stop_rate": 0.0, "episodes": 10_000}
SHOWN = ["146.2", "0.998", "0.900", "12.66", "0.250", "0.000", "10,000"]

GREEDY = {**MEASURES, "scenes": {"bathroom_02": {**MEASURES, "goals": {"26": MEASURES, "37": MEASURES}}}}
SUMMARY = {"scene": "bathroom_02", "source": "rooms", "system": "td_drl", "seed": 3, "frames": 200_000}
SUMMARY |= {"frames_per_second": 2776.2, "seconds": 77.66, "stable_at_frame": 23_000, "peak_memory_mb": 1554.9}
SUMMARY |= {"shortest_path": MEASURES, "random": MEASURES, "greedy": GREEDY, "sampled": MEASURES}


def cells(table):
    """The cells of a Markdown table's lines, without the rule under the heading."""
    lines = [[cell.strip() for cell in line.strip("|").split(" | ")] for line in table.splitlines()]
    return [lines[0], *lines[2:]]


def test_columns_of_a_table_have_nan_for_empty_cells_and_a_file_that_is_no_table_is_refused(tmp_path):
    file = tmp_path / "a.csv"
    assert read_columns(file, "a")["a"].tolist() == []
    file.write_bytes(b"a,b\r\n1,\r\n2,3\r\n")
    columns = read_columns(file, "b", "a")
    assert (columns["a"].tolist(), columns["b"][1]) == ([1, 2], 3)
    assert math.isnan(columns["b"][0])
    file.write_bytes(b"a,b\n" + b"\0" * 200_000)
    with pytest.raises(ValueError, match=r"a\.csv: is no table"):
        read_columns(file, "a")


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


def test_a_table_is_aligned_markdown_of_labels_and_measures():
    unknown = {**MEASURES, "sr": None, "spl": math.nan}
    table = result_table({"greedy": MEASURES, "a|b": MEASURES, "a much longer label": unknown})
    heading, *rows = cells(table)
    assert heading == ["", "ATL", "SR", "SPL", "shortest", "false", "missed", "episodes"]
    assert rows[0] == ["greedy", *SHOWN]
    assert rows[1][0] == r"a\|b"
    assert rows[2][1:4] == ["146.2", "-", "-"]
    lines = table.splitlines()
    assert len({len(line) for line in lines}) == 1
    assert lines[1].strip("|").split(" | ")[1].endswith("--:")
    assert cells(result_table({}, leave_out=["episodes", "SR"])) == [["", "ATL", "SPL", "shortest", "false", "missed"]]


def test_a_summary_is_a_heading_and_tables_of_policies_and_goals():
    sections = ("shortest_path", "random", "greedy", "sampled")
    own = {key: {**SUMMARY[key], "episodes": number} for number, key in enumerate(sections, 1)}
    goals = {"26": {**MEASURES, "atl": 5}, "37": {**MEASURES, "atl": 6}}
    own["greedy"]["scenes"] = {"bathroom_02": {**MEASURES, "goals": goals}}
    heading, policies, _, by_goal = summary_table({**SUMMARY, **own}).split("\n\n")
    assert heading.splitlines() == [
        "TD-DRL, bathroom_02 (source: rooms, synthetic), seed 3: 200,000 frames, 2,776",
        "frames/s, 77.7 s in all, stable at 23,000 frames, peak memory 1,555 MB",
    ]
    assert [(row[0], row[-1]) for row in cells(policies)[1:]] == [
        ("shortest path", "1"), ("random", "2"), ("greedy", "3"), ("sampled", "4"),
    ]  # fmt: skip
    assert [(row[0], row[1]) for row in cells(by_goal)[1:]] == [("goal 26", "5.00"), ("goal 37", "6.00")]
    assert max(map(len, summary_table(SUMMARY).splitlines())) == 80  # a terminal's columns
    apart = {"greedy": {**MEASURES, "episodes": 7}}
    _, _, told, held_out, *_ = summary_table({**SUMMARY, "held_out": apart}).split("\n\n")
    assert (told, [row[-1] for row in cells(held_out)[1:]]) == ("Goals held out of the training:", ["7"])
    scenes = {name: {**MEASURES, "goals": {"1": MEASURES}} for name in ("living_room_08", "bathroom_08")}
    *_, table = summary_table({**SUMMARY, "greedy": {**MEASURES, "scenes": scenes}}).split("\n\n")
    rows = [row[0] for row in cells(table)[1:]]  # each scene before its goals
    assert rows == ["living_room_08", "living_room_08, goal 1", "bathroom_08", "bathroom_08, goal 1"]


def test_several_scenes_have_an_interval_and_a_worst_one_and_a_row_each_where_goals_are_many():
    goals = {str(goal): MEASURES for goal in range(20)}
    found = {"a": (1.0, 10), "b": (0.5, 30), "c": (0.75, 40)}
    scenes = {name: {**MEASURES, "spl": spl, "episodes": count, "goals": goals} for name, (spl, count) in found.items()}
    *_, over, title, table = summary_table({**SUMMARY, "greedy": {**MEASURES, "scenes": scenes}}).split("\n\n")
    assert "in 3 scenes: 0.688, 95% interval 0.500 to 1.000" in over  # (10 + 15 + 30) / 80
    assert over.endswith("Worst scene: b, SPL 0.500, SR 0.998.")
    low, high = mean_interval(np.repeat([1.0, 0.0], 20), np.repeat([1.0, 9.0], 20))
    assert 0.03 < low < 0.1 < high < 0.2
    assert title == "Greedy policy by scene:"
    assert [(row[0], row[-1]) for row in cells(table)[1:]] == [("a", "10"), ("b", "30"), ("c", "40")]


def test_facts_of_a_run_are_said_as_people_say_them():
    for facts, told in (
        ({"stable_at_frame": None}, "never stable"),
        ({"seconds": 3599}, " 1 h 0 min in all"),
        ({"source": "rooms+thor"}, "(source: rooms, synthetic + thor)"),
        ({"scene": [f"room_{number}" for number in range(5)]}, "5 scenes, room_0 to room_4 ("),
        ({"greedy": {**MEASURES, "false_stop_rate": 0.97}}, "False stops ended 97% of the greedy episodes"),
    ):
        assert told in " ".join(summary_table({**SUMMARY, **facts}).split())
    assert "rooms, synthetic" not in run_title({**SUMMARY, "source": "thor"})


def summary_of_a_seed(seed, spl, stable):
    facts = {"scene": "room", "source": "rooms", "system": "dirl", "preset": "fast", "seed": seed}
    return {**facts, "greedy": {"sr": 1.0, "spl": spl, "atl": 7.0}, "stable_at_frame": stable}


FOUND = ((0.9, 20_000), (0.8, 40_000), (1.0, 30_000), (0.9, None))
RUNS = [summary_of_a_seed(seed, *found) for seed, found in enumerate(FOUND)]


def test_the_spread_is_that_of_the_values_and_runs_that_never_were_stable_are_counted():
    rows = cells(seed_table(RUNS))
    assert ["SPL", "4 of 4", "0.900", "0.071", "0.800", "0.875", "0.900", "0.925", "1.000"] in rows
    assert rows[-1][:3] == ["stable at", "3 of 4", "30,000"]
    assert seed_table([summary_of_a_seed(0, 0.9, None)]).splitlines()[-1].startswith("| stable at | 0 of 1 | - |")


@pytest.mark.parametrize("other", [{}, {"optimiser": {"lr": 0.1}}])
def test_a_sweep_is_a_table_and_one_over_seeds_alone_is_told(other, tmp_path, capsys):
    for run in RUNS:
        folder = tmp_path / str(run["seed"])
        folder.mkdir()
        (folder / "summary.json").write_text(json.dumps(run))
        config = {"seed": run["seed"], "optimiser": {"lr": 0.001}} | (other if run["seed"] == 3 else {})
        (folder / "config.yaml").write_text(yaml.safe_dump(config))
    overrides = {"task": ["seed=1,2", "optimiser.lr=1,2"]}
    swept = {"hydra": {"sweep": {"dir": str(tmp_path)}, "overrides": overrides, "sweeper": {}}}
    SweepTable().on_multirun_end(OmegaConf.create(swept))
    printed = capsys.readouterr().out
    assert ("| 1: lr=0.001, seed=1 " if other else "| 1: seed=1 ") in printed
    assert ("Over the seeds" in printed) is not bool(other)


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


def look_at(file, figure):
    """The file is a picture; titles, legends, and axes with their labels lie within the figure, none on another."""
    with Image.open(file) as image:
        assert image.format == "PNG"
        assert min(image.size) > 250
        assert len(set(image.convert("L").resize((64, 64)).tobytes())) > 3
    assert file.stat().st_size < 600_000
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

TABLES = {
    "reinforcement": "frames,atl,atl_worst_goal\n1000,,\n2000,150,180\n3000,,170\n4000,8.5,12\n",
    "evaluation": "frames,atl,sr,spl\n0,197.5,0.01,0.005\n2000,40,0.8,0.6\n4000,7,1,0.9\n",
    "imitation": "step,loss,accuracy\n1,1.39,0.15\n2,0.8,0.75\n3,0.1,1\n",
}


@pytest.fixture
def run(tmp_path, drawn):
    """Writes a run's folder, draws it, and returns the figure."""

    def draw(*stages, **summary):
        facts = {"scene": "room", "source": "rooms", "system": "dirl", "seed": 7, "frames": 4000}
        facts |= {"stable_at_frame": 3500, "greedy": {"shortest": 6.13}} | summary
        (tmp_path / "summary.json").write_text(json.dumps(facts))
        for stage in stages:
            (tmp_path / f"{stage}.csv").write_text(TABLES[stage])
        draw_learning_curve(tmp_path, tmp_path / "curve.png")
        look_at(tmp_path / "curve.png", drawn[0])
        return drawn[0]

    return draw


def lines(axes):
    """What the lines of a panel go through, by the beginning of their labels."""
    return {line.get_label()[:14]: [list(map(float, values)) for values in line.get_data()] for line in axes.lines}


def test_a_curve_shows_training_and_evaluation_and_where_the_policy_is_stable(run):
    figure = run("reinforcement", "evaluation", "imitation")
    upper, lower = figure.axes
    atl, rates = lines(upper), lines(lower)
    assert figure.get_suptitle() == "DIRL, room (source: rooms, synthetic), seed 7"
    assert atl["training, mean"] == [[2000, 4000], [150, 8.5]]
    assert atl["training, wors"] == [[2000, 3000, 4000], [180, 170, 12]]
    assert atl["greedy evaluat"] == [[0, 2000, 4000], [197.5, 40, 7]]
    assert rates["SR, greedy eva"] == [[0, 2000, 4000], [0.01, 0.8, 1]]
    assert rates["SPL, greedy ev"] == [[0, 2000, 4000], [0.005, 0.6, 0.9]]
    assert atl["shortest path "][1] == [6.13, 6.13]
    assert atl["stability limi"][1] == [20, 20]
    assert atl["stable at 3,50"][0] == [3500, 3500]
    assert [3500, 3500] in [points[0] for points in rates.values()]
    assert upper.get_yscale() == "log"
    assert upper.get_xlim() == lower.get_xlim()


def test_a_curve_of_imitation_alone_shows_its_loss_and_accuracy(run):
    upper, lower = run("imitation", "evaluation", frames=0, stable_at_frame=None).axes
    assert (upper.get_ylabel(), lower.get_ylabel()) == ("loss", "accuracy")
    assert list(lines(upper).values()) == [[[1, 2, 3], [1.39, 0.8, 0.1]]]
    assert list(lines(lower).values()) == [[[1, 2, 3], [0.15, 0.75, 1]]]


def test_runs_are_compared_where_all_of_them_have_values():
    frames, values = common_frames(
        [(np.array([0.0, 10, 20]), np.array([0.0, 1, 2])), (np.array([5.0, 15]), np.ones(2))]
    )
    assert frames.tolist() == [5, 10, 15]
    assert values.tolist() == [[0.5, 1, 1.5], [1, 1, 1]]


# Directions on the map


def compass(scene):
    """Unit vectors (x, z) of the headings, clockwise from +z."""
    angle = np.deg2rad(scene.headings)
    return np.stack([np.sin(angle), np.cos(angle)], 1)


def test_headings_point_where_moving_ahead_leads_however_the_file_counts_them():
    room = grid_scene(3, 2)
    np.testing.assert_allclose(room.directions, compass(room), atol=1e-6)
    mirrored = replace(room, positions=room.positions * [-1, 1])
    swapped = replace(room, positions=room.positions[:, ::-1].copy())
    from_x = replace(room, headings=(room.headings - 90) % 360)
    shuffled = renumbered(room, np.random.default_rng(0).permutation(len(room)))
    for scene in (room, mirrored, swapped, from_x, shuffled):
        free = np.flatnonzero(scene.graph[:, 0] >= 0)
        moves = scene.positions[scene.graph[free, 0]] - scene.positions[free]
        np.testing.assert_allclose(scene.directions[free] * CELL, moves, atol=1e-6)
        # In front of a wall too: half a turn on it is the opposite direction.
        around = scene.surrounding[:, 2]
        np.testing.assert_allclose(scene.directions[around], -scene.directions, atol=1e-6)
    assert replace(room, positions=room.positions * 3).step_length == pytest.approx(3 * CELL)


def test_states_whose_actions_end_in_a_loop_never_arrive():
    scene = grid_scene(3, 2)
    lost = never_arrives(scene, 0, np.full(len(scene), RIGHT))
    assert np.flatnonzero(~lost).tolist() == [0, 1, 2, 3]  # the goal's place, where turning finds its heading
    lost = never_arrives(scene, 12, np.full(len(scene), AHEAD))
    assert np.flatnonzero(~lost).tolist() == [0, 12]
    apart = grid_scene(3, 1, blocked=[(1, 0)])  # from the second place no policy could arrive
    assert not never_arrives(apart, 0, np.full(len(apart), RIGHT)).any()


# Paths


def test_gif_has_a_frame_for_each_state_up_to_a_limit(tmp_path):
    for path, frames in (([7, 4, 5, 6], 4), ([1, 2, 3, 0] * 50, MAX_FRAMES)):
        write_gif(grid_scene(), 0, path, tmp_path / "e.gif", title="an episode", success=False)
        with Image.open(tmp_path / "e.gif") as image:
            assert image.n_frames == frames


def test_path_actions_are_read_off_the_graph(scene):
    # Right, ahead along x, into the wall behind it twice, back, left.
    path = [0, 1, 5, 9, 9, 5, 4]
    assert path_actions(scene, path) == ["right", "ahead", "ahead", "blocked", "back", "left"]
    for path, message in (([], "at least its start"), ([0, 2], "from state 0 to state 2"), ([24], "is not a state")):
        with pytest.raises(ValueError, match=message):
            path_actions(scene, path)


WAYS = ([0, 1, 5, 9, 10, 11, 7], [16, 17, 18, 6, 18, 6])
"""In the room of `scene`; the first arrives at its goal, 7, the second goes to and fro between places 4 and 1."""


@pytest.fixture
def picture(tmp_path, drawn):
    """Draws paths, and returns the figure."""

    def draw(scene, goal, paths, success, title="a title"):
        draw_trajectories(scene, goal, paths, tmp_path / "paths.png", success=success, title=title)
        look_at(tmp_path / "paths.png", drawn[-1])
        return drawn[-1]

    return draw


def test_a_map_shows_paths_apart_headings_and_failed_ones_dashed(scene, picture):
    figure = picture(scene, 7, WAYS, [True, False])
    axes = figure.axes[0]
    arrived, failed = axes.findobj(LineCollection)
    assert arrived.get_linestyle()[0][1] is None
    assert failed.get_linestyle()[0][1] is not None
    assert arrived.get_color().tolist() != failed.get_color().tolist()
    for quiver, states in zip(axes.findobj(Quiver), ([0, 1, 5, 9, 10, 11, 7], [16, 17, 18, 6], [7]), strict=True):
        arrows = np.stack([quiver.U, quiver.V], 1)
        lengths = np.linalg.norm(arrows, axis=1, keepdims=True)
        np.testing.assert_allclose(arrows / lengths, compass(scene)[states], atol=1e-6)
    (legend,) = [legend for part in figure.subfigs for legend in part.legends]
    assert [text.get_text() for text in legend.get_texts()] == [
        "1: from state 0, 6 steps",
        "2: from state 16, 5 steps, failed",
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
    titles = ["step 0: right", "step 1: right", "step 2: ahead", "step 3: ahead", "step 4: failed", "goal"]
    assert [axes.get_title() for axes in shown] == titles
    frames = [to_hex(axes.spines["top"].get_edgecolor()) if axes.spines["top"].get_visible() else "" for axes in shown]
    assert frames == ["", "", "", "", "#0072b2", "#f0e442"]
    figure = picture(scene, 0, [[1, 2, 3] + [0, 1, 2, 3] * 20 + [0]], [True])
    titles = [axes.get_title() for axes in figure.axes if axes.images]
    assert (len(titles), titles[7:]) == (9, ["step 83: goal reached", "goal"])
