import contextlib
import gc
import io
import os
import random
import signal
import subprocess
import sys
from unittest.mock import patch

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from options import command_line, draw_arguments, program

from dirl.cli.start import run_main, start
from dirl.config.conf_schemas import SCHEMAS
from dirl.config.schemas import ConfigError

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
            start(recipe)
        except SystemExit as error:
            return error.code if isinstance(error.code, str) else f"{errors.getvalue().strip()} ({error.code})"
    return None


@settings(max_examples=25, deadline=None)
@given(st.randoms(use_true_random=False), st.sampled_from(RECIPES))
def test_any_options_are_let_go_on_or_refused_with_one_line(tmp_path_factory, rng, recipe):
    files = tmp_path_factory.getbasetemp()
    (files / "room.h5").touch()
    told = started(program(recipe), *command_line(recipe, draw_arguments(rng, recipe), files))
    assert told is None or (told.startswith("error: ") and len(told.splitlines()) == 1)


@pytest.mark.parametrize(("number", "line"), [(signal.SIGINT, "interrupted"), (signal.SIGTERM, "terminated")])
@pytest.mark.parametrize("when", ["start('train')", "start('train'); run_main(lambda: None)"])
def test_a_signal_during_the_imports_of_a_recipe_or_after_its_end_gets_one_line(number, line, when):
    setting = "signal.signal(signal.SIGINT, signal.default_int_handler)"  # a shell's background programs ignore it
    imports, end = "import signal, time; from dirl.cli.start import *", "print('now', flush=True); time.sleep(99)"
    command = [sys.executable, "-c", "; ".join([imports, setting, when, end]), "scene=bathroom_02"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
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
    assert "GOMP_SPINCOUNT" not in os.environ


def test_a_seed_draws_the_same_options():
    first, second = ([draw_arguments(random.Random(3), recipe) for recipe in RECIPES] for _ in range(2))
    assert first == second


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["a=${", "seed=1"], "error: a=${: is not of the form name=value"),
        (["=5"], "error: =5: is not of the form name=value"),
        (["seed=[1"], "error: seed=[1: is not of the form name=value"),
        (["scene=a\nb"], "error: scene=a b: is not of the form name=value"),
        (["nope"], "error: nope: is not of the form name=value"),
        (["~nope"], "error: there is no option 'nope'"),
        (["hydra.nope=1"], "error: Could not override 'hydra.nope'"),
        (["hydra/launcher=nope"], "error: In 'hydra/config': Could not find 'hydra/launcher/nope'"),
        (["seed=${nope}"], "error: seed: Interpolation key 'nope' not found"),
        (["seed=???"], "error: seed must be given: determines everything"),
        (["reward.goal=${oc.decode:'inf'}"], "error: reward.goal=inf: must be between -1000000 and 1000000"),
        (["--nope"], "error: unrecognized arguments: --nope; --hydra-help tells the flags"),
        (["seed=1", "-m", "preset=fast"], "error: unrecognized arguments: preset=fast; flags such as -m come before"),
        (["--cfg=nope"], "error: argument --cfg/-c: invalid choice: 'nope'"),
        (["--config-dir=nope"], "error: --config-dir nope: there is no such folder"),
        (["--experimental-rerun=nope"], "error: --experimental-rerun: reads a pickle"),
        (["scene=" + "x" * 3000], "error: "),
        (["-m", "hydra.nope=1", "seed=1,2"], "error: Could not override 'hydra.nope'"),
        (
            ["-m", "hydra/launcher=slurm", "seed=1,2"],
            "error: -m hydra/launcher=slurm seed=1,2: needs Hydra's 'submitit_slurm', which is not installed: "
            "pip install 'dirl[slurm]'",
        ),
        (["-m", "hydra/launcher=ray", "seed=1,2"], "error: -m hydra/launcher=ray seed=1,2: needs Hydra's 'ray', which"),
    ],
)
def test_what_hydra_would_refuse_in_many_lines_is_one(tmp_path, monkeypatch, arguments, told):
    monkeypatch.chdir(tmp_path)
    said = started("train", *arguments)
    assert said is not None
    assert said.startswith(told)
    assert len(said.splitlines()) == 1


def fails_with(error):
    def main():
        raise error

    return main


def test_the_end_of_a_recipe_is_one_line(capsys, monkeypatch):
    monkeypatch.setenv("HYDRA_FULL_ERROR", "1")
    with pytest.raises(SystemExit, match=r"^error: one two$"):
        run_main(fails_with(ConfigError("one\ntwo")))
    with pytest.raises(SystemExit) as raised:
        run_main(fails_with(OSError(28, "No space left on device", "x.h5")))
    assert raised.value.code == 74
    assert capsys.readouterr().err == "error: x.h5: No space left on device; make room on the disk\n"
    with pytest.raises(KeyError):
        run_main(fails_with(KeyError("a bug")))


def test_a_start_without_a_wrong_value_imports_no_pydantic():
    """Its import takes a quarter of the time in which an option is refused."""
    code = "import sys; from dirl.cli.start import start; start('train'); print('pydantic' in sys.modules)"
    run = subprocess.run(
        [sys.executable, "-c", code, "scene=bathroom_02", "reward.goal=1"], capture_output=True, text=True, check=True
    )
    assert run.stdout == "False\n"
