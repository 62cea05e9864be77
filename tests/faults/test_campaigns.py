"""Small samples of the campaigns, of other seeds than full runs have."""

import os
from pathlib import Path

import pytest
from commands import start_recipe


@pytest.mark.skipif(not Path("/proc/self/clear_refs").exists() or not hasattr(os, "fork"), reason="of Linux")
@pytest.mark.parametrize(
    "words", ["declared quick", "dumps count=100 seed=4", "runs kills=1 signals=1 faults=2 early=0"]
)
def test_what_is_promised_holds_in_a_small_sample(words, tmp_path):
    name, *arguments = words.split()
    done = start_recipe(tmp_path, f"../tests/faults/{name}", *arguments).wait(timeout=3600)
    assert done.status == 0, done.printed + done.errors
    assert done.printed.endswith((" 0 failed\n", "\n0 failed\n"))
