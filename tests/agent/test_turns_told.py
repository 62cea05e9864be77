"""A navigator with turns that its policy was not trained with tells so, once and in one line."""

import pytest

from dirl import Navigator


@pytest.mark.parametrize(("turns", "told"), [(4, 0), (8, 0), (12, 0), (16, 1)])
def test_turns_that_the_training_did_not_have_are_told(capsys, turns, told):
    Navigator.load("general", turns=turns)
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == told
    known = "warning: general: was trained with turns of 90 and 45 and 30 degrees; with turns of 22.5 degrees"
    assert all(line.startswith(known) for line in lines)
