"""The start and the end of a recipe: options refused in one line, signals, threads."""

import contextlib
import gc
import io
import os
import signal
import subprocess
import sys
from dataclasses import dataclass
from typing import Annotated, Any
from unittest.mock import patch

import pytest
from annotated_types import Interval
from hypothesis import given, settings
from hypothesis import strategies as st
from options import RECIPES as PROGRAMS
from options import SCHEMAS, command_line, draw_arguments, program
from refusals import refused

from dirl.cli.parsing import compose_training, parse, prepare
from dirl.cli.start import new_file, start
from dirl.config.files import typed
from dirl.config.schemas import Device, option

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


def test_threads_wait_passively_unless_the_user_says_otherwise(monkeypatch):
    monkeypatch.setenv("OMP_WAIT_POLICY", "ACTIVE")
    assert started("train", "nope") is not None
    assert os.environ["OMP_WAIT_POLICY"] == "ACTIVE"
    monkeypatch.delenv("OMP_WAIT_POLICY")
    assert started("train", "nope") is not None
    assert os.environ["OMP_WAIT_POLICY"] == "PASSIVE"


def test_what_hydra_would_refuse_in_many_lines_is_one(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for arguments, told in (
        (["seed=1", "-m", "preset=fast"], "error: unrecognized arguments: preset=fast; flags come before options"),
        (["--cfg=nope"], "error: argument --cfg/-c: invalid choice: 'nope'"),
        (["--experimental-rerun=nope"], "error: --experimental-rerun: a run goes on by resume=<its folder>"),
        (["scene=a\nb"], "error: scene=a b: is not of the form name=value"),
    ):
        said = started("train", *arguments)
        assert said.startswith(told)
        assert len(said.splitlines()) == 1


def test_a_file_is_new_and_can_be_written_or_is_refused(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "there.h5").touch()
    refused("^out=there.h5: this file exists already; it is not overwritten", new_file, "there.h5")
    refused(r": cannot be written \(Not a directory\)", new_file, "there.h5/inside.h5")
    refused(r": cannot be written \(File name too long\)", new_file, "x" * 300 + ".h5")
    refused("^out=other.txt: the name must end in .h5", new_file, "other.txt")
    assert str(new_file("a/b.h5")) == "a/b.h5"
    assert [file.name for file in tmp_path.iterdir()] == ["there.h5"]


@dataclass
class Inner:
    """A group."""

    size: float = option("metres", 0.5)


@dataclass
class Options:
    """What a command takes."""

    file: str = option("the file to read")
    count: Annotated[int, Interval(ge=1, le=9)] | None = option("how many", None)
    device: Device = option("", Device.cpu)
    axes: list[str] = option("", ["x"])
    anything: Any = option("", None)
    inner: Inner = option("by how much", Inner)


def test_a_command_line_is_a_dataclass():
    options = parse(Options, ["file=a b.h5", "count=9", "device=cuda", "axes=[z]", "anything={a:[1]}", "inner.size=1"])
    assert options == Options("a b.h5", 9, Device.cuda, ["z"], {"a": [1]}, Inner(1.0))
    assert parse(Options, ["file=a"]) == Options("a")


def command(argument):
    return parse(Options, ["file=a", argument])


def training(argument):
    return typed(compose_training([argument]))


@pytest.mark.parametrize(
    ("read", "argument", "told"),
    [
        (command, "fiel=a", "there is no option 'fiel'; did you mean file?"),
        (command, "count=x", "count=x: Value 'x' of type 'str' could not be converted to Integer"),
        (command, "count=0", "count=0: must be greater than or equal to 1"),
        (command, "device=gpu", "device=gpu: Invalid value 'gpu', expected one of [cpu, cuda]"),
        (command, "inner=3", "inner=3: inner is a group of options"),
        (command, "count=1,2", "count=1,2: must be one value; a list is written as 'count=[a,b]'"),
        (command, "file=[a", "file=[a: is not of the form name=value"),
        (command, "file=???", "file must be given: the file to read"),
        (command, "anything=${nope}", "anything: Interpolation key 'nope' not found"),
        (training, "gamma=1", "there is no option 'gamma'; did you mean reinforcement.gamma?"),
        (training, "seed=x", "seed=x: Value 'x' of type 'str' could not be converted to Integer"),
        (training, "encoder=siamesse", "In 'train': Could not find 'encoder/siamesse' Available options in 'encoder'"),
        (training, "logger=[]", "logger=[]: must name a choice of logger"),
        (training, "hydra.nope=1", "Could not override 'hydra.nope'"),
    ],
)
def test_what_cannot_be_read_is_one_line(read, argument, told):
    assert refused(".", read, argument).startswith(told)


@pytest.mark.parametrize(
    ("argument", "prepared"),
    [
        ("imitation.bc_coef=0,0.5", "imitation.bc_coef={start:0,end:0},{start:0.5,end:0.5}"),
        ("imitation.bc_coef={start:1,end:0}", "imitation.bc_coef={start:1,end:0}"),
        ("encoder.width=8", "++encoder.width=8"),
        ("~heads.width", "~heads.width"),
        ("losses=[imitation,gail]", "losses=[imitation,gail]"),
        ("hydra.run.dir=x", "hydra.run.dir=x"),
    ],
)
def test_a_number_is_a_constant_schedule_and_options_of_components_may_be_added(argument, prepared):
    assert prepare(["-m", "--config-dir", "x", argument]) == ["-m", "--config-dir", "x", prepared]
