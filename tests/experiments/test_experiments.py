"""The paper's tables and figures: the grids of runs, what is computed from them, and the reports."""

import json
import math
import re
import shutil

import numpy as np
import pytest
from commands import TINY, done, have_the_same_weights, room_file, rows_of, run_recipe, summary_of, train_config
from refusals import refused
from report import Options, chosen
from rooms import grid_scene

from dirl.cli.parsing import parse
from dirl.config.files import config_text
from dirl.experiments.efficiency import mean_stable_frames, training_curve
from dirl.experiments.new_goals import new_goals
from dirl.experiments.performance import halfway
from dirl.experiments.results import Result, finished_runs
from dirl.reporting.statistics import bootstrap_interval, iqm, summarised
from dirl.runs.checkpoints import load_checkpoint
from dirl.scenes import make_world, write_dump
from dirl.training.build import load_trained

SMALL = [option for option in TINY if not option.startswith(("seed=", "imitation.", "reinforcement.frames"))]
SMALL += ["imitation.max_steps=5", "reinforcement.frames_per_scene=150"]

COMPARED = ["network.components=8", "encoder.width=32", "heads.width=32", "imitation.batch_size=64"]
"""Of a small network that compares its goals."""


def summaries(folder):
    """The summary of every run of a grid, by the name of its folder."""
    return {file.parent.name: summary_of(file.parent) for file in folder.glob("runs/experiments/*/*/summary.json")}


@pytest.fixture(scope="module")
def grid(tmp_path_factory):
    """A folder with the runs of a small grid: every kind of system, and the expert's share."""
    folder = tmp_path_factory.mktemp("grid")
    options = [f"scene={room_file(folder)}", *SMALL]
    for given in (["table2", "system=random,il,td_drl,dirl"], ["fig8", "imitation={fraction:0.0},{fraction:0.5}"]):
        done(folder, "train", "-m", f"experiment={given[0]}", *options, given[1], "seed=0,1")
    return folder


def test_experiments_share_runs_and_what_is_finished_is_not_made_again(grid):
    kinds = ["random_random_0.05", "il_random_0.05", "dirl_random_0.05", "td_drl_random_0.0"]
    kinds += ["dirl_random_0.0", "dirl_random_0.5"]
    found = summaries(grid)
    assert set(found) == {f"{kind}_{seed}" for kind in kinds for seed in (0, 1)}
    random = found["random_random_0.05_0"]  # which learns nothing
    assert random["system"] == "random"
    assert random["greedy"] == random["sampled"] == random["random"]
    assert random["greedy"]["sr"] < 1


@pytest.mark.parametrize("experiment", ["table1", "table2", "fig4", "fig5", "fig6", "fig7", "fig8"])
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
    columns = {name: list(dict.fromkeys(row[name] for row in rows)) for name in rows[0]}
    if experiment == "table2":
        dirl = [row for row in rows if row["system"] == "DIRL"]
        spl = [runs[f"dirl_random_0.05_{seed}"]["greedy"]["spl"] for seed in (0, 1)]
        assert [float(row["SPL, ours"]) for row in dirl] == pytest.approx(spl)
        assert {row["SPL, paper"] for row in dirl} == {"0.76"}
    elif experiment == "fig7":
        assert columns["setting"] == ["surrounding views", "sequential views"]
        assert columns["frames, paper"] == ["2300000", "6100000"]
    elif experiment == "fig8":
        assert columns["setting"] == ["no expert", "5%, drawn states", "50%, drawn states"]
    elif experiment == "fig5":
        assert columns["system"] == ["random", "TD-DRL", "DIRL"]
    elif experiment == "fig6":
        assert columns["system"] == ["TD-DRL", "DIRL"]
        assert (grid / "fig6" / "fig6_dirl.gif").stat().st_size > 1000


def test_table_1_is_half_of_the_way(tmp_path):
    rows = ["frames,atl,atl_success,sr,spl", "0,50,,0,0", "150,20,12,0.5,0.4", "300,7,7,1,0.9"]
    (tmp_path / "evaluation.csv").write_text("\n".join(rows))
    run = Result(tmp_path, train_config("system=dirl"), {"frames": 300})
    assert halfway(run) == {"atl": 20, "atl_success": 12, "sr": 0.5, "spl": 0.4}


def test_the_mean_over_goals_is_stable_from_the_row_after_the_last_that_is_too_long(tmp_path):
    rows = ["frames,atl,episodes", "10,5,1", "20,30,200", "30,15,250", "40,25,300", "50,19,350", "60,20,400"]
    (tmp_path / "reinforcement.csv").write_text("\n".join(rows))
    summary = {"frames": 60, "greedy": {"scenes": {"room": {"goals": {"3": {}, "5": {}}}}}}
    run = Result(tmp_path, train_config("system=dirl"), summary)
    assert training_curve(run)[0].tolist() == [20, 30, 40, 50, 60]  # from 100 episodes a goal on
    assert mean_stable_frames(run) == 50


def test_runs_of_different_scenes_are_not_reported_together_nor_none(tmp_path, monkeypatch):
    for scene in ("attic", "cellar"):
        (tmp_path / scene).mkdir()
        (tmp_path / scene / "config.yaml").write_text(config_text(train_config(f"scene={scene}")))
        (tmp_path / scene / "summary.json").write_text(json.dumps({"scene": scene}))
    refused("holds runs of different scenes, attic and cellar; report them apart$", finished_runs, tmp_path, "")
    monkeypatch.chdir(tmp_path / "attic")
    refused(r"recipes/train\.py -m experiment=fig8", chosen, parse(Options, ["experiment=fig8"]))


def test_a_grid_that_is_given_again_makes_what_is_missing_and_takes_no_other_options(grid, tmp_path):
    shutil.copytree(grid / "runs", tmp_path / "runs")
    options = ["-m", "experiment=fig4", f"scene={grid / 'room.h5'}", *SMALL, "system=dirl"]
    first = tmp_path / "runs/experiments/fast/dirl_random_0.05_0/summary.json"
    before = first.stat().st_mtime_ns
    assert f"finished before: {first.parent.relative_to(tmp_path)}" in done(tmp_path, "train", *options, "seed=0,2")
    assert set(summaries(tmp_path)) == {*summaries(grid), "dirl_random_0.05_2"}
    assert first.stat().st_mtime_ns == before
    status, _, errors = run_recipe(tmp_path, "train", *options, "seed=1", "evaluation.max_steps=49")
    assert status == 1
    assert "evaluation.max_steps=50 instead of 49" in errors


def test_jobs_side_by_side_give_what_they_give_alone_and_a_failed_one_loses_none(grid, tmp_path):
    pytest.importorskip("hydra_plugins.hydra_joblib_launcher")
    sweep = ["-m", "experiment=table2", f"scene={room_file(tmp_path)}", *SMALL, "system=dirl", "seed=0"]
    sweep += ["reinforcement.gamma=1.5,0.95", "hydra.sweep.subdir=${reinforcement.gamma}"]
    status, _, errors = run_recipe(tmp_path, "train", *sweep, "hydra/launcher=cores", "hydra.sweep.dir=together")
    assert status == 1
    assert "failed: together/1.5: reinforcement.gamma=1.5" in errors
    alone = grid / "runs/experiments/fast/dirl_random_0.05_0"
    assert have_the_same_weights(alone, tmp_path / "together" / "0.95")


def test_interquartile_mean_leaves_out_the_lowest_and_the_highest_quarter():
    assert iqm([1, 2, 3, 4, 100]) == 3
    assert iqm([5.0, 7.0]) == 6
    assert iqm([[1, 10], [2, 20], [3, 30], [9, 90]]).tolist() == [2.5, 25]
    assert math.isinf(iqm([1, 2, math.inf, math.inf]))


def test_bootstrap_interval_holds_the_true_mean_about_as_often_as_it_says():
    rng = np.random.default_rng(1)
    intervals = (bootstrap_interval(rng.normal(3, 1, 40)) for _ in range(100))
    assert 88 <= sum(low <= 3 <= high for low, high in intervals) <= 99


def test_numbers_of_several_runs_as_text():
    assert summarised([], ".1f") == "-"
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


def test_dirl_with_compared_goals_is_shown_the_way_to_other_goals_than_its_own(tmp_path):
    """At 12 of 24 states, to every place that is not held out: 16 goals, of which the run has two."""
    options = [f"scene={room_file(tmp_path, patches=True)}", *COMPARED, "hold_out=0.34", "imitation.max_steps=20"]
    options += ["imitation.noise=0.5", "imitation.fraction=0.5", "evaluation.max_steps=30"]
    options += ["reinforcement.frames_per_scene=400", "reinforcement.agents_per_scene=4"]
    line = ["experiment=table2", "system=dirl_compared", *options, "hydra.run.dir=runs/experiments/fast/compared"]
    done(tmp_path, "train", *line)
    assert summaries(tmp_path)["compared"]["demonstrations"] == 12 * 16
    done(tmp_path, "report", "experiment=fig5", "starts=5", "out=fig5")
    assert {row["system"] for row in rows_of(tmp_path / "fig5" / "fig5.csv")} == {"random", "DIRL, compared"}


def test_some_rooms_of_a_collection_are_trained_on_and_others_tested(tmp_path):
    (tmp_path / "rooms").mkdir()
    for seed in (30000, 30001, 10000):  # by which they are of a split
        room = grid_scene(name=f"bathroom_{seed}", goals=(0,), patches=True, seed=seed, feature_width=32)
        write_dump(tmp_path / "rooms" / f"{room.name}.h5", room)
    options = ["scene=collection:rooms", *COMPARED, "rooms=2", "imitation.max_steps=5", "seed=0"]
    done(tmp_path, "train", "-m", "experiment=unseen_rooms", *options)
    (run,) = (file.parent for file in tmp_path.glob("runs/*/*/*_2_comparing_0/network.pt"))
    elsewhere = {"scene": f"collection:{tmp_path / 'rooms'}"}  # the collection has moved; its test rooms stay out
    names = load_trained(load_checkpoint(run), str(run), elsewhere).protocol.world.names
    assert names == ("bathroom_30000", "bathroom_30001")
    printed = done(tmp_path, "evaluate", f"checkpoint={run}", "split=test", "goals=[3]", "rooms=null")
    assert "bathroom_10000" in printed
