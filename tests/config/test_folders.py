import pytest

from dirl.config.folders import CONF, HOME, VARIABLE, command


def test_the_repository_holds_recipes_and_configuration():
    assert (HOME / "recipes" / "train.py").is_file()
    assert (CONF / "train.yaml").is_file()


@pytest.mark.parametrize(
    ("script", "running", "told"),
    [
        ("recipes/train.py", True, "python recipes/train.py"),
        ("my_train.py", True, "python my_train.py"),
        ("my_train.py", False, "python recipes/train.py"),
        ("/elsewhere/train.py", True, "python recipes/train.py"),
    ],
)
def test_messages_name_the_program_that_was_started(monkeypatch, script, running, told):
    monkeypatch.delenv(VARIABLE, raising=False)
    monkeypatch.setattr("sys.argv", [script])
    assert command("train", running=running) == told


def test_messages_name_the_command_where_it_was_used(monkeypatch):
    monkeypatch.setenv(VARIABLE, "dirl")
    assert command("train", running=True) == "dirl train"
