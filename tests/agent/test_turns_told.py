"""A navigator with turns that its policy was not trained with tells so, once and in one line."""

import pytest

from dirl import Navigator


@pytest.mark.parametrize(("agent", "turns", "told"), [("general", 4, 0), ("general", 8, 1), ("general_turns", 8, 0)])
def test_turns_that_the_training_did_not_have_are_told(capsys, agent, turns, told):
    Navigator.load(agent, "resnet50_small", turns=turns)
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == told
    assert all(line.startswith(f"warning: {agent}: was trained with turns of 90 degrees") for line in lines)
