"""The wheel, built and installed into an empty folder: what a user has who never saw the repository."""

import json
import os
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PIP = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check"]
TINY = ["scene=bathroom_02", "imitation.max_steps=5", "reinforcement.frames_per_scene=400"]
TINY += ["reinforcement.agents_per_scene=20", "evaluation.times=1", "evaluation.max_steps=20", "hydra.run.dir=run"]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    folder = tmp_path_factory.mktemp("wheel")
    subprocess.run([*PIP, "wheel", "--no-deps", "--wheel-dir", folder, ROOT], check=True)
    (file,) = folder.glob("*.whl")
    return file


@pytest.fixture(scope="module")
def dirl(wheel, tmp_path_factory):
    """Run the installed ``dirl``, or a script, in one empty folder where nothing of the repository is found."""
    target, folder = tmp_path_factory.mktemp("site"), tmp_path_factory.mktemp("empty")
    subprocess.run([*PIP, "install", "--no-deps", "--target", target, wheel], check=True)
    environment = os.environ | {"PYTHONPATH": str(target)}

    def run(*arguments, script=target / "bin" / "dirl"):
        command = [sys.executable, str(script), *arguments]
        done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        return done.stdout

    run.folder = folder
    return run


@pytest.fixture(scope="module")
def metadata(wheel):
    archive = zipfile.ZipFile(wheel)
    (file,) = (name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
    return archive.read(file).decode()


def test_the_package_index_shows_the_readme_for_users_of_the_package(metadata):
    assert "Description-Content-Type: text/markdown" in metadata
    assert "pip install dirl\ndirl train scene=bathroom_02" in metadata
    assert [word for word in ("pip install -e", "python recipes/") if word in metadata] == []
    linked = re.findall(r"\]\(((?!https://doi)[^)#]+)[^)]*\)", metadata)
    addresses = [re.sub(r"https://example\.org/dirl/(?:blob|raw)/main/", "", link) for link in linked]
    assert linked
    assert [address for address in addresses if not (ROOT / address).exists() and "github.com" not in address] == []


def test_licences_version_and_address_are_told_everywhere(wheel, metadata):
    assert "License-Expression: MIT AND CC-BY-NC-4.0" in metadata
    told = re.findall(r"^License-File: (.*)$", metadata, re.MULTILINE)
    assert {Path(file).name for file in told} == {"LICENSE", "LICENSE.CC-BY-NC-4.0.txt"}
    names = zipfile.ZipFile(wheel).namelist()
    assert all(any(name.endswith(f"licenses/{file}") for name in names) for file in told)
    (version,) = re.findall(r"^Version: (.*)$", metadata, re.MULTILINE)
    (repository,) = re.findall(r"^Project-URL: Repository, (.*)$", metadata, re.MULTILINE)
    cited = (ROOT / "CITATION.cff").read_text()
    assert f"\nversion: {version}\n" in cited
    assert f'repository-code: "{repository}"' in cited
    assert f"## {version}" in (ROOT / "CHANGELOG.md").read_text()
    assert repository in (ROOT / "SECURITY.md").read_text()


def test_the_wheel_holds_the_package_its_types_configuration_and_recipes(wheel):
    names = set(zipfile.ZipFile(wheel).namelist())
    expected = {f"dirl/{file.relative_to(ROOT)}" for folder in ("conf", "recipes") for file in tracked(folder)}
    expected |= {str(file.relative_to(ROOT / "src")) for file in tracked("src/dirl")}
    assert expected | {"dirl/py.typed", "dirl/recipes/benchmark.py"} <= names
    assert not [name for name in names if "__pycache__" in name or not name.startswith(("dirl", "hydra_plugins/"))]


def tracked(folder):
    return [file for file in (ROOT / folder).rglob("*") if file.is_file() and "__pycache__" not in file.parts]


PROGRAM = """
import runpy, sys
from dirl.cli.main import main
*lines, copied = sys.argv[1:]
for line in lines:
    sys.argv = ["dirl", *line.split()]
    main()
sys.argv = ["mine.py", *copied.split()]
runpy.run_path("mine.py", run_name="__main__")
"""
"""Several commands in one process, as importing torch takes seconds; the last one is a copied recipe."""


def test_an_empty_folder_is_enough_to_train_evaluate_and_inspect_and_to_run_a_copied_recipe(dirl):
    dirl("copy", "train", "mine.py")
    (dirl.folder / "program.py").write_text(PROGRAM)
    lines = [" ".join(["train", *TINY]), "evaluate checkpoint=run max_steps=20", "scenes inspect scene=bathroom_02"]
    copied = " ".join([*TINY[:-1], "hydra.run.dir=copied", "system=random"])
    printed = dirl(*lines, copied, script="program.py")
    for told in ("pictures, metrics and weights: run\n", "| greedy ", "| states        | 180 |"):
        assert told in printed
    assert json.loads((dirl.folder / "run" / "summary.json").read_text())["frames"] == 400
    assert (dirl.folder / "copied" / "summary.json").is_file()


def test_versions_are_told(dirl, wheel):
    version = wheel.name.split("-")[1]
    assert dirl("--version") == f"{version}\n"
    assert f"dirl {version}" in dirl("version")
