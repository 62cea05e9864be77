"""What is read from a file somebody else may have written never runs code of its choosing."""

import sys
from dataclasses import replace

import pytest
import yaml
from commands import TINY, done, room_file, run_recipe, train_config
from refusals import refused

from dirl.agent.navigator import Navigator
from dirl.runs.checkpoints import load_checkpoint, save_checkpoint
from dirl.runs.folder import open_run
from dirl.training.build import load_trained

CASES = [
    ("observation", "os.system"),
    ("encoder", "trap.Trap"),
    ("policy", "dirl.runs.folder.os.system"),
    ("expert", "builtins.eval"),
    ("losses.a2c", "dirl.training.build.torch.load"),
    ("env", "dirl.runs.folder.Run"),
]
"""A group of components each, and what must not be built for it."""


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """A folder with a finished run and a copy that looks unfinished."""
    folder = tmp_path_factory.mktemp("untrusted")
    file = room_file(folder)
    done(folder, "train", f"scene={file}", *TINY, "hydra.run.dir=run")
    return folder


@pytest.fixture
def trap(tmp_path, monkeypatch):
    """A package on the path that would leave a file when it is imported."""
    (tmp_path / "trap.py").write_text(
        f"import torch\nopen({str(tmp_path / 'sprung')!r}, 'w').close()\n\nclass Trap(torch.nn.Module): pass\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    yield tmp_path / "sprung"
    sys.modules.pop("trap", None)


def poisoned(text, group, target):
    """A configuration whose component names another class, with an argument that would do harm."""
    config = yaml.safe_load(text)
    *above, last = group.split(".")
    inside = config[above[0]] if above else config
    inside[last] = {"_target_": target, "command": "touch sprung"}
    return yaml.safe_dump(config)


@pytest.mark.parametrize(("group", "target"), CASES)
def test_a_configuration_from_a_file_builds_nothing_foreign(trained, trap, tmp_path, group, target):
    composed, saved = train_config(), load_checkpoint(trained / "run")
    text = poisoned(saved["config"], group, target)
    resumed = tmp_path / "resumed"
    resumed.mkdir()
    (resumed / "config.yaml").write_text(text)
    save_checkpoint(tmp_path / "other" / "network.pt", {**saved, "config": text})
    for use in (
        lambda: open_run(replace(composed, resume=str(resumed)), resumed, [f"resume={resumed}"]),
        lambda: open_run(replace(composed, existing="keep"), resumed, []),  # as a grid comes back to it
        lambda: load_trained({**saved, "config": text}, "the checkpoint"),
        lambda: Navigator.load(tmp_path / "other", lambda images: images, extractor=saved["extractor"]),
    ):
        refused("_target_=|there is no option", use)
    assert not trap.exists()
    assert "trap" not in sys.modules


def test_the_recipes_say_it_in_one_line(trained, trap, tmp_path):
    saved = load_checkpoint(trained / "run")
    save_checkpoint(tmp_path / "other" / "network.pt", {**saved, "config": poisoned(saved["config"], *CASES[1])})
    status, _, errors = run_recipe(tmp_path, "evaluate", "checkpoint=other")
    assert (status, errors.count("\n")) == (1, 1)
    assert "a configuration from a file names a class of 'trap'; trust=[trap] allows it" in errors
    assert not trap.exists()


def test_trust_counts_only_where_the_user_gives_it(trained, trap, tmp_path):
    saved = load_checkpoint(trained / "run")
    text = poisoned(saved["config"], *CASES[1])
    config = yaml.safe_dump({**yaml.safe_load(text), "trust": ["trap"]})
    refused("trust=\\[trap\\] allows it", load_trained, {**saved, "config": config}, "the checkpoint")
    assert not trap.exists()
    refused(r"no option 'encoder.command'", load_trained, {**saved, "config": text}, "the checkpoint", trust=["trap"])
    assert trap.exists()
    save_checkpoint(tmp_path / "other" / "network.pt", {**saved, "config": text})
    given = {"encoder": lambda images: images, "extractor": saved["extractor"], "trust": ["trap"]}
    refused(r"no option 'encoder.command'", Navigator.load, tmp_path / "other", **given)
