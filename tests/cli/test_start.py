"""The start and the end of a recipe: options refused in one line, signals, threads."""

import contextlib
import gc
import io
import os
import signal
import subprocess
import sys
from unittest.mock import patch

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from options import RECIPES as PROGRAMS
from options import SCHEMAS, command_line, draw_arguments, program
from refusals import refused

from dirl.cli.start import new_file, start

RECIPES = sorted(set(SCHEMAS) - {"benchmark"})


@pytest.fixture(autouse=True)
def _as_before():
    """A recipe would collect garbage again after its imports, which these tests do not reach, and then end."""
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    gc.enable()
    for number, handler in handlers.items():
        signal.signal(number, handler)


def started(recipe, *arguments):
    """What the start of a recipe's program ends with; None if it is let go on."""
    errors = io.StringIO()
    with patch.object(sys, "argv", ["program", *arguments]), contextlib.redirect_stderr(errors):
        try:
            start("", getattr(PROGRAMS.get(recipe), "OPTIONS" if recipe == "scenes" else "Options", None))
        except SystemExit as error:
            assert errors.getvalue() in ("", "loading ...\n")
            return error.code if isinstance(error.code, str) else f"({error.code})"
    return None


@settings(max_examples=25, deadline=None)
@given(st.randoms(use_true_random=False), st.sampled_from(RECIPES))
def test_any_options_are_let_go_on_or_refused_with_one_line(tmp_path_factory, rng, recipe):
    files = tmp_path_factory.getbasetemp()
    (files / "room.h5").touch()
    told = started(program(recipe), *command_line(recipe, draw_arguments(rng, recipe), files))
    assert told is None or (told.startswith("error: ") and len(told.splitlines()) == 1)


@pytest.mark.parametrize(
    ("number", "line", "when"),
    [
        (signal.SIGINT, "interrupted; nothing was written", "start('')"),
        (signal.SIGTERM, "terminated", "start(''); run(lambda: None)"),
    ],
    ids=["while it imports", "after its end"],
)
def test_a_signal_while_nothing_is_to_be_saved_gets_one_line(number, line, when):
    setting = "signal.signal(signal.SIGINT, signal.default_int_handler)"  # a shell's background programs ignore it
    imports, end = "import signal, time; from dirl.cli.start import *", "print('now', flush=True); time.sleep(99)"
    command = [sys.executable, "-c", "; ".join([imports, setting, when, end]), "scene=bathroom_02"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr.readline() == "loading ...\n"
        assert process.stdout.readline() == "now\n"
        process.send_signal(number)
        assert process.stderr.read() == f"{line}\n"
    assert process.returncode == 128 + number


@pytest.mark.parametrize("own", [None, "ACTIVE"])
def test_threads_wait_passively_unless_the_user_says_otherwise(monkeypatch, own):
    monkeypatch.setenv("OMP_WAIT_POLICY", own or "")  # what is set below ends with this test
    if own is None:
        monkeypatch.delenv("OMP_WAIT_POLICY")
    assert started("train", "nope") is not None
    assert os.environ["OMP_WAIT_POLICY"] == (own or "PASSIVE")


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["seed=1", "-m", "preset=fast"], "error: unrecognized arguments: preset=fast; flags come before options"),
        (["--cfg=nope"], "error: argument --cfg/-c: invalid choice: 'nope'"),
        (["--experimental-rerun=nope"], "error: --experimental-rerun: a run goes on by resume=<its folder>"),
        (["scene=a\nb"], "error: scene=a b: is not of the form name=value"),
    ],
)
def test_what_hydra_would_refuse_in_many_lines_is_one(tmp_path, monkeypatch, arguments, told):
    monkeypatch.chdir(tmp_path)
    said = started("train", *arguments)
    assert said.startswith(told)
    assert len(said.splitlines()) == 1


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("there.h5", "this file exists already; it is not overwritten"),
        ("there.h5/inside.h5", "cannot be written (Not a directory)"),
        ("x" * 300 + ".h5", "cannot be written (File name too long)"),
        ("other.txt", "the name must end in .h5"),
        ("a/b.h5", None),
    ],
)
def test_a_file_is_new_and_can_be_written_or_is_refused(tmp_path, monkeypatch, name, says):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "there.h5").touch()
    if says is None:
        assert str(new_file(name)) == name
    else:
        assert refused(".", new_file, name).startswith(f"out={name}: {says}")
    assert [file.name for file in tmp_path.iterdir()] == ["there.h5"]
