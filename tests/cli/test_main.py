"""The command dirl, which imports no torch for what is asked here; its wheel is tested in test_wheel.py."""

import subprocess
import sys

PROGRAM = "import atexit, sys; atexit.register(lambda: print('torch' in sys.modules, file=sys.stderr)); "
PROGRAM += "from dirl.cli.main import main; main()"


def dirl(folder, *arguments):
    """Run ``dirl``, which must not import torch; what it printed, and its message."""
    command = [sys.executable, "-c", PROGRAM, *arguments]
    done = subprocess.run(command, capture_output=True, text=True, cwd=folder, check=False)
    *lines, imported = done.stderr.removeprefix("loading ...\n").splitlines()
    assert imported == "False"
    return done.stdout, "\n".join(lines)


def test_help_names_the_command_and_needs_no_torch(tmp_path):
    for arguments, *told in (
        ("--help", "  train      train an agent"),
        (
            "train --help preset=paper encoder.width=77",
            "dirl train scene=kitchen_02 preset=paper system=td_drl",
            "heads: scene, shared\n",
            "  clip_per_variable: true             # false: the norm of all variables",
            "scene: null                           # a name, a list of names",
            "  threshold: 0.9                      # match above this correlation",
            "width: 77",
        ),
        ("scenes inspect --help", "dirl scenes inspect scene=bathroom_02"),
        ("scenes --help", "  inspect    Look at a scene and check it"),
        ("train --cfg job seed=7", "seed: 7"),
    ):
        printed, errors = dirl(tmp_path, *arguments.split())
        assert [words for words in told if words not in printed] == []
        assert "python recipes/" not in printed
        assert errors == ""


def test_a_wrong_command_line_is_one_line(tmp_path):
    for arguments, told in (
        ("trian", "there is no command 'trian'; did you mean train?"),
        ("evaluate", "checkpoint must be given: the folder of a run, or a .pt file in one"),
        ("copy benchmark mine.py", "say which recipe to copy"),
        ("copy train mine.txt", "mine.txt: the name must end in .py"),
        ("copy train nowhere/mine.py", "nowhere/mine.py: No such file or directory"),
    ):
        printed, errors = dirl(tmp_path, *arguments.split())
        assert errors.startswith(f"error: {told}")
        assert "\n" not in errors
        assert printed == ""
    assert list(tmp_path.iterdir()) == []


def test_the_shell_completes_commands_and_options(tmp_path, monkeypatch):
    for line, offered in (
        ("dirl scenes in", "inspect"),
        ("dirl train seed=1 system=d", "system=dagger system=dirl system=dirl_compared system=dirl_ppo"),
        ("dirl scenes inspect thre", "threshold="),
    ):
        monkeypatch.setenv("COMP_LINE", line)
        assert dirl(tmp_path, "-sc", "query=bash")[0].split() == offered.split()


def test_a_copy_is_not_written_over_a_file(tmp_path):
    assert dirl(tmp_path, "copy", "train", "mine.py")[0] == "copied: mine.py; run it with: python mine.py\n"
    assert "python mine.py scene=bathroom_02" in (tmp_path / "mine.py").read_text()
    _, errors = dirl(tmp_path, "copy", "evaluate", "mine.py")
    assert errors == "error: mine.py: this file exists already; it is not overwritten"
