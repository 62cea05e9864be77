import pytest

from dirl.config.folders import VARIABLE, command


@pytest.mark.parametrize(
    ("script", "variable", "told"),
    [
        ("my_train.py", "", "python my_train.py"),
        ("/elsewhere/train.py", "", "python recipes/train.py"),
        ("recipes/train.py", "dirl", "dirl train"),
    ],
)
def test_messages_name_the_program_that_was_started(monkeypatch, script, variable, told):
    monkeypatch.delenv(VARIABLE, raising=False)
    if variable:
        monkeypatch.setenv(VARIABLE, variable)
    monkeypatch.setattr("sys.argv", [script])
    assert command("train", running=True) == told
