"""The command dirl, forked before any import of torch; the wheel that holds it is tested in test_wheel.py."""

import pytest
from commands import run_recipe


def dirl(folder, *arguments):
    """Run ``dirl``; what it printed, its message, and whether it imported torch."""
    _, printed, errors = run_recipe(folder, "dirl", *arguments)
    *lines, imported = errors.splitlines()
    return printed, "\n".join(lines), imported == "True"


@pytest.mark.parametrize(
    "case",
    [
        ([], "  evaluate   evaluate trained weights"),
        (["--help"], "  train      train an agent"),
        (
            ["train", "--help"],
            "dirl train scene=kitchen_02 preset=paper system=td_drl",
            "heads: scene, shared\n",
            "    start: 0.3                        # at the first frame",
            "  width: 512                          # of the hidden layer",
            "scene: null                           # a name, a list of names",
            "  goal: 10.0                          # stopped at the goal",
            "  threshold: 0.9                      # match above this correlation",
        ),
        (["evaluate", "--help"], "dirl evaluate checkpoint=runs/"),
        (["report", "--help"], "dirl train -m experiment=fig8 && dirl report experiment=fig8"),
        (["scenes", "inspect", "--help"], "dirl scenes inspect scene=bathroom_02"),
        (
            ["train", "--help", "preset=paper"],
            "  clip_per_variable: true             # false: the norm of all variables",
            "  collision: -0.01                    # a blocked move, instead of step",
        ),
        (["evaluate", "--help"], "slip: 0.0                             # live only: the probability that an action"),
        (["train", "--help", "encoder.width=77"], "width: 77"),
        (["scenes", "--help"], "  inspect    Look at a scene and check it"),
        (["train", "--cfg", "job", "seed=7"], "seed: 7"),
        (["--version"], "."),
    ],
)
def test_help_names_the_command_and_needs_no_torch(tmp_path, case):
    arguments, *told = case
    printed, errors, torch = dirl(tmp_path, *arguments)
    assert [words for words in told if words not in printed] == []
    assert "python recipes/" not in printed
    assert (errors, torch) == ("", False)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["trian"], "there is no command 'trian'; did you mean train?"),
        (["train", "sceen=a"], "there is no option 'sceen'; did you mean scene?"),
        (["evaluate"], "checkpoint must be given: the folder of a run, or a .pt file in one"),
        (["scenes", "inpect"], "there is no command 'inpect'; did you mean inspect?"),
        (["scenes", "sample", "kind=bedroom", "out=x", "count=0"], "count=0: must be at least 1"),
        (["copy", "train"], "say which recipe to copy"),
        (["copy", "benchmark", "mine.py"], "say which recipe to copy"),
        (["copy", "train", "mine.txt"], "mine.txt: the name must end in .py"),
        (["copy", "train", "nowhere/mine.py"], "nowhere/mine.py: No such file or directory"),
    ],
)
def test_what_a_command_line_says_wrongly_is_one_line(tmp_path, arguments, told):
    printed, errors, torch = dirl(tmp_path, *arguments)
    assert errors.startswith(f"error: {told}")
    assert "\n" not in errors
    assert (printed, torch) == ("", False)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("dirl ", "train evaluate scenes report map go benchmark copy version"),
        ("dirl ev", "evaluate"),
        ("dirl scenes in", "inspect"),
        ("dirl train seed=1 system=d", "system=dagger system=dirl system=dirl_compared system=dirl_ppo"),
        ("dirl scenes inspect thre", "threshold="),
        ("dirl report exp", "experiment="),
    ],
)
def test_the_shell_completes_commands_and_options(tmp_path, monkeypatch, line, offered):
    monkeypatch.setenv("COMP_LINE", line)
    printed, _, torch = dirl(tmp_path, "-sc", "query=bash")
    assert printed.split() == offered.split()
    assert not torch


@pytest.mark.parametrize("flag", ["-sc", "--shell-completion"])
def test_shell_completion_is_installed(tmp_path, flag):
    printed, _, _ = dirl(tmp_path, flag, "install=bash")
    assert printed.rstrip().endswith("hydra_bash_completion dirl")


def test_a_copy_is_not_written_over_a_file(tmp_path):
    printed, _, _ = dirl(tmp_path, "copy", "train", "mine.py")
    assert printed == "copied: mine.py; run it with: python mine.py\n"
    assert "python mine.py scene=bathroom_02" in (tmp_path / "mine.py").read_text()
    _, errors, _ = dirl(tmp_path, "copy", "evaluate", "mine.py")
    assert errors == "error: mine.py: this file exists already; it is not overwritten"
