"""The table of a sweep, and the spread of runs that differ in their seed only."""

import json

import pytest
import yaml
from omegaconf import OmegaConf

from dirl.reporting.sweeps import SweepTable, seed_table


def summary(seed, spl, stable):
    facts = {"scene": "room", "source": "rooms", "system": "dirl", "preset": "fast", "seed": seed}
    return {**facts, "greedy": {"sr": 1.0, "spl": spl, "atl": 7.0}, "stable_at_frame": stable}


RUNS = [summary(0, 0.9, 20_000), summary(1, 0.8, 40_000), summary(2, 1.0, 30_000), summary(3, 0.9, None)]


def test_the_spread_is_that_of_the_values_and_runs_that_never_were_stable_are_counted():
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in seed_table(RUNS).splitlines()]
    assert ["SPL", "4 of 4", "0.900", "0.071", "0.800", "0.875", "0.900", "0.925", "1.000"] in rows
    assert rows[-1][:3] == ["stable at", "3 of 4", "30,000"]
    assert seed_table([summary(0, 0.9, None)]).splitlines()[-1].startswith("| stable at | 0 of 1 | - |")


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
