"""Training with every state as a goal, and places held out."""

import json

import pytest
from commands import TINY, done, room_file, summary_of


@pytest.mark.parametrize("policy", ["actor_critic", "shortest_path"])
def test_goals_held_out_are_evaluated_apart(tmp_path, policy):
    asked = [f"scene={room_file(tmp_path)}", "goals=all", "hold_out=0.34", f"policy={policy}", "hydra.run.dir=run"]
    printed = done(tmp_path, "train", *TINY, *asked)
    assert "Goals held out of the training:" in printed
    summary = summary_of(tmp_path / "run")
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
    done(tmp_path, "evaluate", *again)
    evaluated = json.loads((tmp_path / "e.json").read_text())
    assert evaluated["greedy"] == summary["greedy"]
    assert evaluated["held_out"]["greedy"] == summary["held_out"]["greedy"]


ANY_GOAL = ["seed=3", "system=any_goal", "hold_out=0.34", "network.components=8", "encoder.width=32"]
ANY_GOAL += ["encoder.comparison=16", "heads.width=32", "imitation.batch_size=64", "imitation.max_steps=40"]
ANY_GOAL += ["evaluation.max_steps=30", "evaluation.goals=3"]


def test_goal_view_and_memory_are_chosen_at_evaluation(tmp_path):
    printed = done(tmp_path, "train", *ANY_GOAL, f"scene={room_file(tmp_path, patches=True)}", "hydra.run.dir=run")
    assert "Goals held out of the training:" in printed
    found = {}
    asked = {"four": [], "photo": ["goal_view=front"], "alone": ["episodic_memory=none"]}
    for name, options in {**asked, "named": ["goals=[0,1,5,7,13]"]}.items():
        done(tmp_path, "evaluate", "checkpoint=run", f"out={name}.json", *options)
        result = json.loads((tmp_path / f"{name}.json").read_text())["greedy"]
        found[name] = result["atl"]
    goals = {int(goal) for goal in result["scenes"]["grid"]["goals"]}
    assert goals == {0, 1, 5, 7, 13}  # of those that are named all count, though the run drew three
    summary = summary_of(tmp_path / "run")
    assert found["four"] == summary["greedy"]["atl"]
    assert len(set(found.values())) == 4
