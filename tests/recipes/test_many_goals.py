"""Training with every state as a goal, and places held out."""

import json

import pytest
from commands import run_recipe
from rooms import grid_scene

from dirl.scenes import write_dump

OPTIONS = [
    "seed=3",
    "encoder.width=32",
    "heads.width=32",
    "imitation.fraction=0.5",
    "imitation.batch_size=16",
    "imitation.max_steps=5",
    "reinforcement.frames_per_scene=120",
    "reinforcement.agents_per_scene=6",
    "evaluation.times=1",
    "evaluation.max_steps=30",
]


@pytest.mark.parametrize("policy", ["actor_critic", "shortest_path"])
def test_goals_held_out_are_evaluated_apart(tmp_path, policy):
    write_dump(tmp_path / "room.h5", grid_scene(goals=(0, 13), feature_width=32))
    asked = [f"scene={tmp_path / 'room.h5'}", "goals=all", "hold_out=0.34", f"policy={policy}", "hydra.run.dir=run"]
    status, printed, errors = run_recipe(tmp_path, "train", *OPTIONS, *asked)
    assert status == 0, errors
    assert "Goals held out of the training:" in printed
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    goals = [set(part["greedy"]["scenes"]["grid"]["goals"]) for part in (summary, summary["held_out"])]
    assert [len(part) for part in goals] == [16, 8]
    assert not goals[0] & goals[1]
    if policy == "shortest_path":
        greedy = summary["held_out"]["greedy"]
        assert greedy["sr"] + greedy["false_stop_rate"] + greedy["missed_stop_rate"] >= 1
        return
    header = (tmp_path / "run" / "evaluation.csv").read_text().splitlines()[0]
    assert header.endswith("held_out_sr,held_out_spl")
    again = ["checkpoint=run", "seed=7", "out=e.json"]  # another seed draws other actions, but no other goals
    status, _, errors = run_recipe(tmp_path, "evaluate", *again)
    assert status == 0, errors
    evaluated = json.loads((tmp_path / "e.json").read_text())
    assert evaluated["greedy"] == summary["greedy"]
    assert evaluated["held_out"]["greedy"] == summary["held_out"]["greedy"]
