import json
import re

from commands import TINY, done, room_file, rows_of, run_recipe, summary_of


def test_train_leaves_a_whole_run_and_evaluate_repeats_its_result(tmp_path):
    file = room_file(tmp_path)
    printed = done(tmp_path, "train", f"scene={file}", *TINY)
    assert "| greedy " in printed
    (run,) = tmp_path.glob("runs/*/*")
    names = {"config.yaml", "summary.json", "network.pt", "learning_curve.png", "trajectories_grid.png"}
    names |= {"maps_grid.png", "episode_grid.gif", "imitation.csv", "reinforcement.csv", "evaluation.csv"}
    assert {entry.name for entry in run.iterdir()} == names
    summary = summary_of(run)
    facts = {"scene": "grid", "source": "synthetic", "system": "dirl", "preset": "fast", "seed": 3, "frames": 600}
    assert facts.items() <= summary.items()
    assert {"stable_at_frame", "seconds", "frames_per_second", "peak_memory_mb"} <= set(summary)
    measures = {"atl", "atl_success", "sr", "spl", "shortest", "false_stop_rate", "missed_stop_rate", "episodes"}
    for mode in ("greedy", "sampled", "random", "shortest_path"):
        assert measures <= set(summary[mode])
        assert set(summary[mode]["scenes"]["grid"]["goals"]) == {"0", "13"}
    assert [row["frames"] for row in rows_of(run / "evaluation.csv")] == ["0", "300", "600"]

    printed = done(tmp_path, "evaluate", f"checkpoint={run}", "seed=3", "max_steps=50", "out=e.json")
    again = json.loads((tmp_path / "e.json").read_text())
    assert all(again[mode] == summary[mode] for mode in ("greedy", "sampled", "random", "shortest_path"))


def test_train_without_an_expert_by_ppo_and_with_stops_where_views_match(tmp_path):
    options = ["system=td_drl", "objective=ppo", "reinforcement.minibatches=2", "stop.training=match"]
    done(tmp_path, "train", f"scene={room_file(tmp_path)}", *TINY, *options, "hydra.run.dir=run")
    assert summary_of(tmp_path / "run")["frames"] == 600


def test_a_run_until_stable_ends_at_the_first_evaluation_that_finds_every_goal_stable(tmp_path):
    options = [f"scene={room_file(tmp_path)}", *TINY, "imitation.fraction=1", "reinforcement.until=stable"]
    options += ["reinforcement.frames_per_scene=20_000", "evaluation.times=20", "hydra.run.dir=run"]
    done(tmp_path, "train", *options)
    summary = summary_of(tmp_path / "run")
    evaluated = [int(row["frames"]) for row in rows_of(tmp_path / "run" / "evaluation.csv")]
    assert summary["stable_at_frame"] is not None
    assert [frames for frames in evaluated if frames > summary["stable_at_frame"]] == [summary["frames"]]
    assert summary["frames"] < 20_000


def test_benchmark_measures_every_loop(tmp_path):
    room = room_file(tmp_path)
    options = [f"worlds=[{room}]", "frames_per_scene=240", "repeats=1", "out=benchmark.json"]
    small = "encoder.width=32,heads.width=32,reinforcement.agents_per_scene=6"
    small += ",imitation.max_steps=2,reinforcement.frames_per_scene=240"
    train = "train=[" + ",".join(f"'{option}'" for option in small.split(",")) + "]"
    printed = done(tmp_path, "benchmark", *options, train)
    (row,) = json.loads((tmp_path / "benchmark.json").read_text())["rows"]
    assert set(row["frames_per_second"]) == {"training", "rollout", "stock_torchrl"}
    assert all(rate > 0 for rate in row["frames_per_second"].values())
    assert row["operations_per_frame"] > 0
    assert row["stable_at_frame"] is None
    assert "fraction of limit" in printed


def test_bad_input_ends_with_one_clear_message_and_leaves_nothing_behind(tmp_path):
    status, printed, errors = run_recipe(tmp_path, "train", "scene=bathroom_02", "goals=[180]")
    assert (status, printed, errors.count("\n")) == (1, "", 1)
    assert re.match(r"error: .*bathroom_02.*: goal 180 is not a state; states are 0\.\.179$", errors)
    assert not list(tmp_path.iterdir())


def test_an_error_of_the_machine_in_one_job_of_a_sweep_leaves_the_others(tmp_path):
    (tmp_path / "sweep" / "0" / "learning_curve.png").mkdir(parents=True)  # where a file is to be
    options = [f"scene={room_file(tmp_path)}", *TINY[1:], "hydra.sweep.dir=sweep", "seed=3,4"]
    status, _, errors = run_recipe(tmp_path, "train", "-m", *options)
    assert status != 0
    assert "failed: sweep/0: " in errors
    assert (tmp_path / "sweep" / "1" / "learning_curve.png").is_file()
    assert (tmp_path / "sweep" / "1" / "summary.json").is_file()
