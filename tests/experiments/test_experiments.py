"""The paper's tables and figures: the grids of runs, what is computed from them, and the reports."""

import csv
import json
import math
import re
import signal
from dataclasses import replace

import numpy as np
import pytest
import torch
from commands import SAVED, TINY, done, room_file, run_recipe, start_recipe, train_config, wait_until
from rooms import grid_scene

from dirl.experiments.any_goal import main_variant, nearest_trained, variant
from dirl.experiments.measures import ambiguous, wrong_goals
from dirl.experiments.new_goals import new_goals
from dirl.experiments.stopping import coefficients, disturb, precision_recall, recommended_threshold, report_stopping
from dirl.perception.backbones.registry import ViewEncoder, encode_all
from dirl.reporting.statistics import bootstrap_interval, iqm, summarised
from dirl.runs.checkpoints import load_checkpoint
from dirl.scenes import load_scenes, make_world, write_dump
from dirl.scenes.collection import Entry, add_entry
from dirl.scenes.goals import choose_goals
from dirl.scenes.io.digest import file_digest
from dirl.scenes.views import encode
from dirl.training.build import load_trained

SMALL = [option for option in TINY if not option.startswith(("seed=", "imitation.fraction="))]

EXPERIMENTS = ("table1", "table2", "fig4", "fig5", "fig6", "fig7", "fig8", "stop")


def rows_of(file):
    """The rows of a CSV file, as texts by column."""
    with file.open(newline="") as lines:
        return list(csv.DictReader(lines))


def summaries(folder):
    """The summary of every run of a grid, by the name of its folder."""
    return {file.parent.name: json.loads(file.read_text()) for file in folder.glob("runs/experiments/*/*/summary.json")}


def have_the_same_weights(*runs):
    ours, theirs = (torch.load(run / "network.pt", weights_only=True)["network"] for run in runs)
    return all(torch.equal(ours[key], theirs[key]) for key in ours)


def add_room(folder, number, split, **scene):
    """Add a room that is called ``room_<number>`` to a collection."""
    file = folder / f"room_{number}.h5"
    write_dump(file, room := grid_scene(name=file.stem, goals=(0,), patches=True, seed=number, **scene))
    add_entry(folder, Entry(file.stem, "bathroom", number, split, len(room), {}, {}, file_digest(file)))


@pytest.fixture(scope="module")
def grid(tmp_path_factory):
    """A folder with the runs of a small grid: every kind of system, and the expert's share."""
    folder = tmp_path_factory.mktemp("grid")
    options = [f"scene={room_file(folder)}", *SMALL, "reinforcement.frames_per_scene=300"]
    for given in (["table2", "system=random,il,td_drl,dirl"], ["fig8", "imitation={fraction:0.0},{fraction:0.5}"]):
        done(folder, "train", "-m", f"experiment={given[0]}", *options, given[1], "seed=0,1")
    return folder


def test_experiments_share_runs_and_what_is_finished_is_not_made_again(grid):
    kinds = ["random_random_0.05", "il_random_0.05", "dirl_random_0.05", "td_drl_random_0.0"]
    kinds += ["dirl_random_0.0", "dirl_random_0.5"]
    assert set(summaries(grid)) == {f"{kind}_{seed}" for kind in kinds for seed in (0, 1)}


@pytest.mark.parametrize("experiment", EXPERIMENTS[:-1])
def test_a_report_has_tables_figures_and_the_papers_numbers(grid, experiment):
    printed = done(grid, "report", f"experiment={experiment}", "scene=grid", "goal=7", "starts=5", f"out={experiment}")
    text = (grid / experiment / "README.md").read_text()
    assert text.strip() in printed
    assert "seeds 0, 1. Of several runs" in text
    title = text.splitlines()[0].removeprefix("# ")
    for shown, figure in re.findall(r"^!\[(.+)\]\((\w+)\.png\)$", text, re.MULTILINE):
        assert not shown.startswith(title)  # but says what is to be seen
        assert all((grid / experiment / f"{figure}.{kind}").stat().st_size > 1000 for kind in ("png", "svg"))
    tables = {file.stem: rows_of(file) for file in (grid / experiment).glob("*.csv")}
    rows = tables.get(experiment) or tables[f"{experiment}_greedy"]
    runs = summaries(grid)
    if experiment == "table2":
        dirl = [row for row in rows if row["system"] == "DIRL"]
        assert [float(row["SPL, ours"]) for row in dirl] == pytest.approx(
            [runs[f"dirl_random_0.05_{seed}"]["greedy"]["spl"] for seed in (0, 1)]
        )
        assert {row["SPL, paper"] for row in dirl} == {"0.76"}
    elif experiment == "fig7":
        assert [row["setting"] for row in rows] == ["surrounding views"] * 2 + ["sequential views"] * 2
        assert [row["frames, paper"] for row in rows] == ["2300000"] * 2 + ["6100000"] * 2
    elif experiment == "fig8":
        assert [row["setting"] for row in rows][::2] == ["no expert", "5%, drawn states", "50%, drawn states"]
    elif experiment == "fig5":
        assert list(dict.fromkeys(row["system"] for row in rows)) == ["random", "TD-DRL", "DIRL"]
    elif experiment == "fig6":
        assert [row["system"] for row in rows] == ["TD-DRL", "TD-DRL", "DIRL", "DIRL"]
        assert (grid / "fig6" / "fig6_dirl.gif").stat().st_size > 1000


def test_table_1_is_half_of_the_way(grid):
    run_recipe(grid, "report", "experiment=table1", "out=half")
    (row, *_) = [row for row in rows_of(grid / "half" / "table1_greedy.csv") if row["system"] == "DIRL"]
    tests = rows_of(grid / "runs/experiments/fast/dirl_random_0.05_0/evaluation.csv")
    (half,) = [test for test in tests if test["frames"] == "150"]
    assert float(row["ATL, ours"]) == pytest.approx(float(half["atl"]))


def test_a_report_of_one_seed_says_so(grid, tmp_path):
    (tmp_path / "fast").mkdir()
    (tmp_path / "fast/dirl").symlink_to(grid / "runs/experiments/fast/dirl_random_0.05_1")
    printed = done(tmp_path, "report", "experiment=fig4", f"runs={tmp_path}")
    assert "Preset `fast`, seed 1 alone.\n" in printed


def test_a_report_without_runs_says_how_to_make_them(tmp_path):
    status, _, errors = run_recipe(tmp_path, "report", "experiment=fig8")
    assert status == 1
    assert "recipes/train.py -m experiment=fig8" in errors


def test_a_grid_that_was_killed_goes_on_to_the_same_result_when_it_is_given_again(tmp_path):
    options = [f"scene={room_file(tmp_path)}", *SMALL, SAVED, "reinforcement.frames_per_scene=1500"]
    options += ["experiment=fig4"]
    command = ["-m", *options, "system=dirl", "seed=0,1"]
    process = start_recipe(tmp_path, "train", *command)
    first, second = (tmp_path / f"runs/experiments/fast/dirl_random_0.05_{seed}" for seed in (0, 1))
    wait_until(lambda: list(second.glob("checkpoints/0*[1-9]???.pt")))
    process.send_signal(signal.SIGKILL)
    assert process.wait().status == -signal.SIGKILL
    assert (first / "summary.json").exists()
    assert not (second / "summary.json").exists(), "it was not killed in time"
    printed = done(tmp_path, "train", *command)
    assert "finished before: runs/experiments/fast/dirl_random_0.05_0" in printed
    whole = [*options, "system=dirl", "seed=1", "hydra.run.dir=whole"]
    done(tmp_path, "train", *whole)
    assert have_the_same_weights(second, tmp_path / "whole")
    status, _, errors = run_recipe(tmp_path, "train", *command, "evaluation.max_steps=49")
    assert status == 1
    assert "evaluation.max_steps=50 instead of 49" in errors


def test_jobs_side_by_side_give_what_they_give_one_after_the_other_and_a_failed_one_loses_none(tmp_path, monkeypatch):
    pytest.importorskip("hydra_plugins.hydra_joblib_launcher")
    monkeypatch.setenv("OMP_NUM_THREADS", "1")  # sums depend on the number of threads
    options = ["-m", "experiment=table2", f"scene={room_file(tmp_path)}", *SMALL, "system=dirl", "seed=0"]
    options += ["reinforcement.gamma=1.5,0.9", "hydra.sweep.subdir=${reinforcement.gamma}"]
    for folder, launcher in (("alone", "basic"), ("together", "cores")):
        status, _, errors = run_recipe(
            tmp_path, "train", *options, f"hydra/launcher={launcher}", f"hydra.sweep.dir={folder}"
        )
        assert status == 1
        assert f"failed: {folder}/1.5: reinforcement.gamma=1.5" in errors
    assert have_the_same_weights(*(tmp_path / folder / "0.9" for folder in ("alone", "together")))


def test_interquartile_mean_leaves_out_the_lowest_and_the_highest_quarter():
    assert iqm([1, 2, 3, 4, 100]) == 3
    assert iqm([5.0, 7.0]) == 6
    assert iqm([[1, 10], [2, 20], [3, 30], [9, 90]]).tolist() == [2.5, 25]
    assert iqm([1, 2, 3, math.inf]) == 2.5
    assert math.isinf(iqm([1, 2, math.inf, math.inf]))


def test_bootstrap_interval_holds_the_true_mean_about_as_often_as_it_says():
    rng = np.random.default_rng(1)
    held = 0
    for number in range(100):
        low, high = bootstrap_interval(rng.normal(3, 1, 40), seed=number)
        held += low <= 3 <= high
    assert 88 <= held <= 99


def test_numbers_of_several_rooms_or_runs_as_text():
    rates = [1.0, 1.0, 1.0, 0.9, 0.2]
    assert summarised(rates, ".2f", min) == "0.82 [0.50,\N{NO-BREAK SPACE}1.00], worst 0.20"
    assert summarised(rates, ".2f", max).endswith("worst 1.00")
    assert summarised([1.0, 1.0], ".2f", min) == "1.00"
    assert summarised([], ".2f", min) == summarised([], ".1f") == "-"
    assert summarised([2.0], ".1f") == summarised([2.0, 2.0, 2.0], ".1f") == "2.0"
    assert summarised([1.0, 3.0, math.inf], ".0f") == "never [1,\N{NO-BREAK SPACE}never]"
    assert summarised([math.inf, math.inf], ".1f") == "never"


def test_new_goals_are_as_far_from_the_nearest_trained_one_as_is_asked():
    scene = grid_scene(width=5, depth=4, goals=(0, 30))
    for distance in (1, 2, 4):
        chosen = new_goals(make_world([scene]), distance)
        assert len(chosen["grid"]) == 2
        for goal in chosen["grid"]:
            assert min(scene.distances[goal, trained] for trained in scene.goals) == distance


def test_a_disturbance_does_what_its_strength_says():
    view = np.full((30, 40, 3), 100, np.uint8)
    view[:, :20] = 200

    def seen(kind, strength):
        return disturb(view, kind, strength, np.random.default_rng(0)).astype(float)

    assert abs((seen("noise", 30) - view)[:, 20:].std() - 30) < 1.5
    assert seen("darkness", 0.5).mean() == pytest.approx(75, abs=0.5)
    blurred = seen("blur", 3) - view
    assert np.abs(blurred[:, [0, 39]]).max() <= 1
    assert 0 < blurred[:, 20].mean() < 50
    assert (seen("occlusion", 0.3) == 128).all(-1).mean() == pytest.approx(0.3, abs=0.03)


def test_precision_and_recall_of_thresholds():
    precision, recall = precision_recall(torch.tensor([0.95, 0.65]), torch.tensor([0.75, 0.1, 0.2]))
    at = {threshold: round((threshold - 0.3) * 100) for threshold in (0.5, 0.7, 0.9, 0.99)}
    assert [precision[at[one]] for one in at] == pytest.approx([2 / 3, 1 / 2, 1, 1])
    assert [recall[at[one]] for one in at] == pytest.approx([1, 1 / 2, 1 / 2, 0])
    clear, blurred = ((torch.tensor([0.8]), torch.tensor([highest])) for highest in (0.545, 0.645))
    assert recommended_threshold([precision_recall(*clear)]) == 0.55
    assert recommended_threshold([precision_recall(*clear), precision_recall(*blurred)]) == 0.65
    assert recommended_threshold([precision_recall(torch.tensor([0.1]), torch.tensor([0.1]))]) == 0.3


def test_the_coefficient_is_one_at_the_goal_if_nothing_is_disturbed():
    scene = grid_scene()
    features = torch.tensor(scene.features)
    at_goal, away = coefficients(features, features, scene, "views")
    assert torch.allclose(at_goal, torch.ones(24), atol=1e-5)
    assert len(away) == 24 * 23
    assert away.max() < 0.99
    at_goal, _ = coefficients(features, features + torch.rand(features.shape), scene, "views")
    assert at_goal.max() < 0.99


def test_stopping_is_reported_for_disturbed_views(tmp_path):
    from dirl.experiments.results import finished_runs

    rng = np.random.default_rng(0)
    views = rng.integers(0, 256, (24, 30, 40, 3), np.uint8)
    mixing = torch.from_numpy(rng.normal(size=(3600, 32))).float()
    encoder = ViewEncoder(lambda batch: (batch.flatten(1).float() / 255) @ mixing, {"extractor": "mixed pixels"})
    features = encode_all(encoder, views, 24, "test").features
    scene = replace(grid_scene(goals=(0, 13)), features=features, extractor=encoder.extractor)
    write_dump(tmp_path / "room.h5", scene, [encode(view, quality=None) for view in views])
    options = [f"scene={tmp_path / 'room.h5'}", *SMALL, "experiment=fig4", "system=dirl", "seed=0"]
    done(tmp_path, "train", "-m", *options)
    runs = finished_runs(tmp_path / "runs/experiments/fast", "")
    text = report_stopping(runs, tmp_path, "note", load_scenes(str(tmp_path / "room.h5"))[0].name, encoder)
    assert "Recommended threshold" in text
    rows = {(row["disturbance"], row["strength"]): row for row in rows_of(tmp_path / "stop.csv")}
    clean, noisy = rows["none", "0.0"], rows["noise", "64"]
    assert float(clean["at the goal, mean"]) == pytest.approx(1)
    assert float(clean["precision at 0.9"]) == float(clean["recall at 0.9"]) == 1
    assert float(noisy["at the goal, mean"]) < 0.99
    assert float(rows["darkness", "0.8"]["SR at 0.9"]) <= float(clean["SR at 0.9"])
    other = ViewEncoder(lambda batch: (batch.flatten(1).float() / 255) @ mixing.flip(0), {"extractor": "other"})
    with pytest.raises(ValueError, match="name the same"):
        report_stopping(runs, tmp_path, "note", scene.name, other)
    # Without a name the encoder is that of the built-in rooms, which did not make these features.
    status, _, errors = run_recipe(tmp_path, "report", "experiment=stop", f"scene={scene.name}")
    assert status == 1
    assert errors.startswith(f"error: encoder: gives other features than those of {scene.name}, 'mixed pixels")


@pytest.fixture(scope="module")
def any_goal(tmp_path_factory):
    """Two small runs of experiment=any_goal, of which one embeds its goal, and one of dirl_compared, in one folder."""
    folder = tmp_path_factory.mktemp("any_goal")
    write_dump(folder / "room.h5", grid_scene(goals=(0, 13), feature_width=32, patches=True))
    options = ["scene=room.h5", "network.components=8", "encoder.width=32", "heads.width=32", "hold_out=0.34"]
    options += ["imitation.batch_size=64", "imitation.max_steps=20", "evaluation.max_steps=30", "imitation.noise=0.5"]
    done(folder, "train", "-m", "experiment=any_goal", *options, "seed=0")
    options += ["imitation.fraction=0.5", "reinforcement.frames_per_scene=400", "reinforcement.agents_per_scene=4"]
    line = ["experiment=table2", "system=dirl_compared", *options, "hydra.run.dir=runs/experiments/fast/compared"]
    done(folder, "train", *line)
    return folder


def test_goals_that_were_held_out_are_reported_beside_controls(any_goal):
    assert set(summaries(any_goal)) == {
        "compared",
        *(f"any_goal_0.5_0.5_{encoder}_0" for encoder in ("comparing", "siamese")),
    }
    printed = done(any_goal, "report", "experiment=any_goal", "out=report")
    assert "8 states of places that were sampled and never trained" in printed
    rows = {row["walks by"]: row for row in rows_of(any_goal / "report" / "any_goal.csv")}
    assert float(rows["shortest path"]["SPL"]) == 1.0
    summary = summaries(any_goal)["any_goal_0.5_0.5_comparing_0"]["held_out"]
    assert float(rows["four views of the goal"]["SR"]) == pytest.approx(summary["greedy"]["sr"])
    assert 0 < float(rows["random walk"]["SPL"]) < 0.6
    parts = rows_of(any_goal / "report" / "any_goal_parts.csv")
    assert [row["part of the system"].split(",")[0] for row in parts] == ["goal compared", "goal embedded side by side"]
    assert all(0 < float(row["SPL, one photo"]) < 1 for row in parts)
    for view, way in (("SPL", "four views of the goal"), ("SPL, one photo", "one photo of the goal")):
        assert float(parts[0][f"{view}, no memory"]) == pytest.approx(float(rows[f"{way}, without memory"]["SPL"]))
    assert (any_goal / "report" / "any_goal.svg").stat().st_size > 1000


def test_what_was_added_to_the_system_has_a_row_of_its_own():
    options = {
        "goal compared, noise 0.5, 50% photos": [],
        "goal embedded side by side, no noise, 50% photos": ["encoder=siamese", "imitation.noise=0"],
        "goal compared, noise 0.5, 50% photos, views read at once": ["encoder.pair_width=0"],
        "goal compared, noise 0.5, 50% photos, 2 rounds of DAgger": ["imitation.rounds=2"],
        "goal compared, noise 0.5, 50% photos, GRUModule, then A2C": ["memory=gru", "objective=a2c"],
    }
    names = [variant(train_config("system=any_goal", *chosen)) for chosen in options.values()]
    assert names == list(options)
    assert main_variant({name: [None] for name in names[::-1]}) == names[0]


def test_figure_5_shows_policies_that_know_other_goals_at_goals_that_they_were_not_shown(any_goal):
    done(any_goal, "report", "experiment=fig5", "starts=5", "out=fig5")
    rows = rows_of(any_goal / "fig5" / "fig5.csv")
    assert {row["system"] for row in rows} == {"random", "DIRL, compared", "DIRL, many goals"}


def test_dirl_with_compared_goals_is_shown_the_way_to_other_goals_than_its_own(any_goal):
    """At 12 of 24 states, to every place that is not held out: 16 goals, of which the run has two."""
    assert summaries(any_goal)["compared"]["demonstrations"] == 12 * 16
    done(any_goal, "report", "experiment=fig4", "out=fig4")
    assert [row["setting"] for row in rows_of(any_goal / "fig4" / "fig4.csv")] == ["DIRL, compared"]


def test_another_goal_of_the_same_scene_is_shown_as_a_control():
    world = make_world([grid_scene(goals=(0, 13, 5)), grid_scene(2, 2, name="small", goals=(1, 2), seed=1)])
    shown = wrong_goals(world)
    assert sorted(shown.tolist()) == [0, 1, 2, 3, 4]
    assert (shown != torch.arange(5)).all()
    assert torch.equal(world.scene_of[world.goals[shown]], world.scene_of[world.goals])


def test_a_photo_that_another_view_matches_is_ambiguous():
    scene = grid_scene(goals=(0, 13))
    features = scene.features.copy()
    features[7] = features[13] + 1e-4
    world = make_world([replace(scene, features=features)])
    assert ambiguous(world, 0.95).tolist() == [False, True]


def test_the_nearest_trained_goal_is_of_all_that_were_trained():
    """Whatever the share of goals that the run itself was evaluated on."""
    world = make_world([grid_scene(goals=(0, 13))])
    config = train_config("system=any_goal", "hold_out=0.34", "evaluation.goals=1", "seed=3")
    chosen = choose_goals(world.scenes, "all", 0.34, 3)
    held_out = world.with_goals(chosen.held_out)
    wanted = [
        min(int(world.scenes[0].distances[goal, other]) for other in chosen.trained["grid"])
        for goal in held_out.goals.tolist()
    ]
    assert nearest_trained(config, held_out).tolist() == wanted


def test_some_rooms_of_a_collection_are_trained_on_and_others_tested(tmp_path):
    (tmp_path / "rooms").mkdir()
    for number, split in enumerate(["train", "train", "test"]):
        add_room(tmp_path / "rooms", number, split, feature_width=32)
    options = ["scene=collection:rooms", "network.components=8", "encoder.width=32", "heads.width=32", "rooms=2"]
    options += ["imitation.batch_size=64", "imitation.max_steps=5", "imitation.scenes_at_once=1", "seed=0"]
    done(tmp_path, "train", "-m", "experiment=unseen_rooms", *options)
    (run,) = (file.parent for file in tmp_path.glob("runs/*/*/*_2_comparing_0/network.pt"))
    elsewhere = {"scene": f"collection:{tmp_path / 'rooms'}"}  # the collection has moved; its test rooms stay out
    assert load_trained(load_checkpoint(run), str(run), elsewhere).protocol.world.names == ("room_0", "room_1")
    printed = done(tmp_path, "evaluate", f"checkpoint={run}", "split=test", "goals=[3]", "rooms=null")
    assert "room_2" in printed


@pytest.fixture
def collection(tmp_path):
    """A collection of one test room that the agents of the package can see, as a folder's name."""
    (tmp_path / "rooms").mkdir()
    extractor = load_checkpoint("general")["extractor"]
    add_room(tmp_path / "rooms", 0, "test", width=5, depth=3, feature_width=1280, extractor=extractor)
    return "rooms"


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["image_graph", "collections=[nowhere]"], "nowhere: is no collection; it holds no collection.jsonl"),
        (["image_graph", "agents=[no_run]", "collections=[rooms]"], "no_run: holds no checkpoint"),
        (["other_worlds"], "collections=[]: say where; files of scenes"),
        (["other_worlds", "collections=[rooms]", "agents=[general,general]"], "must be one"),
    ],
)
def test_what_an_agent_cannot_be_measured_in_is_told_in_one_line(tmp_path, collection, arguments, told):
    status, _, errors = run_recipe(tmp_path, "report", f"experiment={arguments[0]}", *arguments[1:])
    assert status == 1
    assert errors.startswith("error: ")
    assert told in errors
    assert errors.count("\n") == 1


def test_an_agent_is_measured_beside_maps(tmp_path, collection):
    printed = done(tmp_path, "report", "experiment=image_graph", f"collections=[{collection}]", "out=report")
    assert "1 rooms of the test split, 60 states" in printed
    rows = {row["led by"]: row for row in rows_of(tmp_path / "report" / "image_graph.csv")}
    led = "graph, last 3 steps by the policy with memory"
    assert {led, f"{led}, one photo of the goal", "policy with episodic memory"} <= set(rows)
    assert float(rows["graph, walk of 2 N steps"]["SR"]) == 1


def test_an_agent_in_another_world_is_measured_beside_controls(tmp_path, collection):
    dump = f"{collection}/room_0.h5"
    printed = done(tmp_path, "report", "experiment=other_worlds", f"collections=[{dump},{dump}]", "out=report")
    assert "# general in other worlds" in printed
    rows = rows_of(tmp_path / "report" / "other_worlds.csv")
    by_size = rows_of(tmp_path / "report" / "other_worlds_by_size.csv")
    told = ["four views of the goal", "the same, told when it has arrived"]
    ways = [*told, "another goal's views", "sweep that ignores the goal", "random walk"]
    assert [row["walks by"] for row in rows] == [row["walks by"] for row in by_size] == [w for w in ways for _ in "ab"]
    assert float(rows[2]["SR"]) >= float(rows[0]["SR"])
    assert float(rows[-1]["SR"]) > float(by_size[-1]["SR"])  # the room has 60 states: fewer steps
    assert all(row["SR"] == other["SR"] for row, other in zip(rows[::2], rows[1::2], strict=True))
    assert 0 < float(rows[-1]["SR"]) < 1
