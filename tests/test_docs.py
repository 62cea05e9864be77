"""The documentation: the code on its pages runs, every option is explained, and the site stands on its own.

On a how-to page ```python and ```bash blocks are run, in order, in an empty folder; ```text is output or data. What
cannot be run here is a {code-block} whose caption tells the reader why. A caption that is a file name makes the file.
"""

import os
import re
import runpy
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple
from urllib.parse import unquote

import pytest
import torch
from closet import dim_light
from commands import ROOT, TINY, start_recipe
from filelock import FileLock
from forks import no_pictures
from networks import coarse_networks

from dirl.config.folders import VARIABLE
from dirl.scenes.views import encode

DOCS = ROOT / "docs"
NOTEBOOK = DOCS / "tutorials" / "notebook.ipynb"
PAGES = [ROOT / "README.md", ROOT / "AGENT_GUIDE.md", DOCS / "quickstart.md"]
PAGES += [*sorted((DOCS / "tutorials").glob("*.md")), *sorted((DOCS / "howto").glob("*.md"))]

SMALL = 'imitation={"max_steps": 5}, reinforcement={"frames_per_scene": 240}, evaluation={"times": 1, "max_steps": 9}'
"""Within a training from Python."""

TRAINING = [*TINY, "evaluation.max_steps=10", "imitation.max_steps=5", "reinforcement.frames_per_scene=240"]
TRAINING += ["evaluation.starts=sampled", "evaluation.episodes_per_goal=4"]
QUICK = {"recipes/train.py": TRAINING, "recipes/evaluate.py": ["starts=sampled", "episodes_per_goal=1", "max_steps=20"]}
"""Behind every training and evaluation of a page, but for the options that it gives itself."""

SHORTER = {
    "notebook.ipynb": {"range(60)": "range(6)"},
    "any_goal.md": {"imitation.max_steps=100": "imitation.max_steps=5", "evaluation.goals=20": "evaluation.goals=2"},
    "extend.md": {'("gru", "lstm")': '("lstm",)'},
    "extend_more.md": {"frames_per_scene=20000": "frames_per_scene=240"},
    "many_goals.md": {
        "train.py scene=kitchen_02": "train.py evaluation.goals=2 evaluation.starts=sampled scene=kitchen_02"
    },
    "install.md": {"range(60)": "range(4)"},
    "own_photographs.md": {"height=150 width=200": "height=48 width=64"},
    "own_rooms.md": {"height=60 width=80": "height=24 width=32"},
    "rooms.md": {
        "RoomSettings(height=48, width=64": "RoomSettings(height=24, width=32",
        'bedroom]" seed=3 out=flat': 'bathroom]" seed=3 out=flat height=16',
        '("bathroom", 30000)': '("bathroom", 30004)',
    },
    "gymnasium.md": {"40_960": "1_024", "36_864": "128", "set(range(180))": "set(range(24, 28))"},
    "navigator.md": {
        'reinforcement={"frames_per_scene": 30000}, evaluation={"times": 1}': SMALL,
        "times=10": "times=1",
    },
    "simulators.md": {
        "goals=all simulator=": "goals=every:36 simulator=",
        "out=freedoom_01.h5 places=10": "out=freedoom_01.h5 places=4",
        "goals=every:4 max_steps=12": "goals=every:8 max_steps=4",
        "frames_per_scene=600 evaluation.times=1 evaluation.live_episodes=4 evaluation.max_steps=12": (
            "frames_per_scene=60 evaluation.times=1 evaluation.live_episodes=1 evaluation.max_steps=4"
        ),
    },
    "sweeps.md": {"fraction=0,0.05 seed=0,1": "fraction=0,0.05 seed=0", "fraction=0,0.05\n": "fraction=0\n"},
}
"""What makes the code of a page take seconds; it is otherwise run as it stands."""

NOT_RUN = 41  # the last one is the walk through a drawn building, which takes a minute
"""Blocks that pages declare as not run, each with its reason; more are decided here."""

EXAMPLE_RUN = "runs/dirl_bathroom_02/2026-01-31_12-00-00"
"""The run that pages speak of."""


class Block(NamedTuple):
    language: str
    caption: str
    text: str


def blocks(page):
    """The fenced code of a page."""
    fence = r'^```(?:\{code-block\} )?(\w+)\n(?::caption: "?([^\n"]*)"?\n)?(.*?)^```$'
    return [Block(*match) for match in re.findall(fence, page.read_text(), re.DOTALL | re.MULTILINE)]


def is_file(caption):
    """Whether a block is a file of the reader's, rather than code to run."""
    return Path(caption).suffix in (".toml", ".yaml", ".py")


def shell_words(text):
    """The words of each command of a shell block, as bash expands them; nothing is run.

    With ``failglob`` an unquoted ``goals=[3]`` is an error, as it is in zsh.
    """
    show = 'show() { printf "%s\\0" "$@"; printf "\\n"; }; shopt -s failglob\n'
    lines = [f"show {line}" for line in text.replace("\\\n", "").splitlines() if line.split("#")[0].strip()]
    done = subprocess.run(["bash", "-c", show + "\n".join(lines)], capture_output=True, text=True, check=False)
    assert not done.stderr, done.stderr
    return [line.split("\0")[:-1] for line in done.stdout.splitlines()]


def run_command(words, monkeypatch):
    """Run a command in this process, which saves the seconds that imports take."""
    if words[0] == "PYTHONPATH=.":
        monkeypatch.syspath_prepend(Path.cwd())
        words = words[1:]
    if words[:2] == ["python", "-m"]:
        monkeypatch.setattr(sys, "argv", words[2:])
        runpy.run_module(words[2], run_name="__main__")
        return
    if words[0] == "dirl" and words[1] != "version":
        words = ["python", f"recipes/{words[1]}.py", *words[2:]]
    if words == ["dirl", "version"]:
        return  # see tests/test_wheel.py
    assert words[0] == "python", f"how is this tested? {words}"
    if not any(word.startswith("resume=") for word in words):
        given = {word.partition("=")[0] for word in words}
        words += [option for option in QUICK.get(words[1], ()) if option.partition("=")[0] not in given]
        words += ["hydra.sweeper.n_trials=1"] if "hydra/sweeper" in given else []
    monkeypatch.setattr(sys, "argv", words[1:])
    with monkeypatch.context() as patch:
        if words[1] in QUICK:  # their pictures are looked at in test_platforms.py
            no_pictures(patch.setattr)
        runpy.run_path(str(ROOT / words[1]), run_name="__main__")


@pytest.fixture(scope="module")
def example_run(tmp_path_factory):
    """A folder of a finished run in the bathroom."""
    folder = tmp_path_factory.mktemp("example") / "run"
    with pytest.MonkeyPatch.context() as patch:
        run_command(["python", "recipes/train.py", "scene=bathroom_02", f"hydra.run.dir={folder}"], patch)
    return folder


@pytest.fixture(scope="module")
def coarse(tmp_path_factory):
    """Networks read coarse views, and what they make of them is not kept where other tests would find it.

    Views are encoded quickly, not small.
    """
    with pytest.MonkeyPatch.context() as patch:
        coarse_networks(patch)
        patch.setattr(encode, "__defaults__", (85, 0))
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("coarse")))
        yield


@pytest.mark.usefixtures("coarse")
def test_the_notebook_runs(tmp_path, monkeypatch):
    """Each cell, in the shell that a kernel has."""
    nbformat, interactiveshell = pytest.importorskip("nbformat"), pytest.importorskip("IPython.core.interactiveshell")
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path))
    shell, shown = interactiveshell.InteractiveShell.instance(), []
    shell.display_trap.hook = lambda result: shown.extend(shell.display_formatter.format(result)[0])
    for cell in notebook.cells:
        if cell.cell_type == "code":
            shell.run_cell(shorter(NOTEBOOK, cell.source)).raise_error()
    interactiveshell.InteractiveShell.clear_instance()
    assert shown.count("text/markdown") == 2  # the run, and an evaluation, as tables
    assert shown.count("image/png") == 2


@pytest.mark.usefixtures("coarse")
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_the_code_of_a_page_runs(page, example_run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("WANDB_MODE", "offline")
    monkeypatch.setenv(VARIABLE, "")  # what `python -m dirl` sets on a page ends with this test
    monkeypatch.delenv(VARIABLE)
    monkeypatch.setattr(torch, "set_num_threads", lambda _: None)  # for all of this process
    dim_light(monkeypatch)
    shutil.copytree(example_run, EXAMPLE_RUN)
    if page.stem == "resume":  # as if it had been stopped before its first checkpoint
        for file in Path(EXAMPLE_RUN).iterdir():
            if file.name != "config.yaml":
                file.unlink()
    names = {"__name__": page.stem}
    for block in blocks(page):
        run_block(block, page, names, monkeypatch)


def run_block(block, page, names, monkeypatch):
    """Write a file of the reader's; run code in a page's names, or the lines of a shell."""
    language, caption, text = block
    if is_file(caption):
        Path(caption).parent.mkdir(exist_ok=True)
        Path(caption).write_text(text)
    if caption:
        return
    text = shorter(page, text)
    if language == "python":
        with monkeypatch.context() as patch:
            no_pictures(patch.setattr)
            exec(compile(text, str(page), "exec"), names)
    elif language == "bash":
        for words in shell_words(text):
            if words[:2] != ["pip", "install"]:
                run_command(words, monkeypatch)


def shorter(page, text):
    """The code of a page as it is run."""
    for old, new in SHORTER.get(page.name, {}).items():
        text = text.replace(old, new)
    return re.sub(r'dirl\.train\((scene="\w+", seed=\d)\)', rf"dirl.train(\1, {SMALL})", text)


SHELL_PAGES = [page for page in DOCS.rglob("*.md") if not {"_build", "_cache"} & {*page.parts}]
SHELL_PAGES += [ROOT / name for name in ("README.md", "AGENT_GUIDE.md", "CONTRIBUTING.md")]


def test_a_shell_passes_on_what_the_pages_say():
    """Brackets and braces are quoted, whether or not the commands are run."""
    commands = [block.text for page in SHELL_PAGES for block in blocks(page) if block.language == "bash"]
    for page in SHELL_PAGES:
        commands += re.findall(r"^ {4}((?:python|dirl|pip|pytest) .*)$", page.read_text(), re.MULTILINE)
    lines = [line for text in commands for line in text.replace("\\\n", "").splitlines()]
    alone = [command for line in lines for command in re.split(r" && | > ", line) if command.split("#")[0].strip()]
    assert len(alone) > 200
    assert shell_words("\n".join(alone)) == [shlex.split(command, comments=True) for command in alone]


def test_pages_have_only_code_that_is_run_or_says_why_it_is_not():
    reasons = []
    for page in PAGES:
        outside = re.sub(r"^```.*?^```$", "", page.read_text(), flags=re.DOTALL | re.MULTILINE)
        assert not re.search(r"\n\n    \S", outside), f"{page.name}: indented code is not run; fence it"
        for block in blocks(page):
            assert block.language in ("python", "bash", "toml", "yaml", "text"), f"{page.name}: {block.language}"
            if block.caption and not is_file(block.caption):
                assert re.match(r"Not run by the tests: .*(need|take|download|have|is|make)", block.caption), page.name
                reasons.append(block.caption)
    for page in [*PAGES, NOTEBOOK]:
        for old in SHORTER.get(page.name, {}):
            assert old in page.read_text(), f"{page.name}: there is no '{old}' to make shorter"
    assert len(reasons) <= NOT_RUN


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The built site; a warning fails. One worker of pytest-xdist builds it for all."""
    base = tmp_path_factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "site"
    options = "-W --keep-going -q -t without_demo -D smartquotes=0 -b html"
    with FileLock(f"{folder}.lock"):
        if not (folder / "built").exists():
            done = start_recipe(base, "../tests/helpers/build_site", *options.split(), DOCS, folder).wait(timeout=3600)
            assert done.status == 0, done.errors
            (folder / "built").touch()
    return folder


def test_the_site_asks_no_other_host_for_anything_and_pictures_have_an_alternative_text(site):
    fetched = r"""<(?!a\b)[^>]*?\s(?:src|srcset|href|data|poster)="([^"]+)"|url\(['"]?([^'")]+)|@import ['"]([^'"]+)"""
    asked, pictures = {}, []
    for file in [*site.rglob("*.html"), *site.rglob("*.css")]:
        text = file.read_text()
        asked[file.name] = ["".join(match) for match in re.findall(fetched, text)]
        pictures += [tag for tag in re.findall(r"<img[^>]*>", text) if "_images/" in tag]  # of pages, not of the theme
    assert len(asked["index.html"]) > 5
    elsewhere = [(name, what) for name, found in asked.items() for what in found if re.match(r"\s*(\w+:)?//", what)]
    assert elsewhere == []
    assert len(pictures) > 10
    # A sentence or a title, not the name of a file.
    assert [tag for tag in pictures if not re.search(r'alt="[^"]{10,}"', tag) or re.search(r'alt="\S+"', tag)] == []


def test_every_link_within_the_site_leads_somewhere(site):
    """To a file of the site, and to an anchor that is on its page."""
    pages = {page: page.read_text() for page in site.rglob("*.html")}
    anchors = {page: set(re.findall(r'\bid="([^"]+)"', text)) for page, text in pages.items()}
    links = [(page, link) for page, text in pages.items() for link in re.findall(r'<a [^>]*href="([^"]+)"', text)]
    inside = [(page, unquote(link)) for page, link in links if not re.match(r"\w+:", link)]
    assert len(inside) > 1000
    broken = []
    for page, link in inside:
        path, _, anchor = link.partition("#")
        target = (page.parent / path).resolve() if path else page
        if not target.is_file() or (anchor and target in anchors and anchor not in anchors[target]):
            broken.append((page.name, link))
    assert broken == []


def test_every_option_has_a_meaning(site):
    text = "".join(page.read_text() for page in sorted(site.glob("configuration*.html")))
    cells = re.findall(r"<tr.*?</tr>", text, re.DOTALL)
    rows = [re.findall(r"<td>(.*?)</td>", row, re.DOTALL) for row in cells]
    options = {re.sub(r"<.*?>", "", row[0]).strip(): row[2] for row in rows if len(row) == 3}
    assert "reinforcement.gamma" in " ".join(options)
    assert [name for name, meaning in options.items() if not meaning.strip("<p>/ \n")] == []


LAID_OUT = """pages => Promise.all(pages.map(async page => {
  const frame = document.createElement("iframe");
  frame.style = "position: absolute; visibility: hidden; border: 0; width: 1280px; height: 800px";
  const loaded = new Promise(done => frame.onload = done);
  frame.src = page;
  document.body.append(frame);
  await loaded;
  const inside = frame.contentDocument, title = inside.querySelector("h1").innerText;
  const height = inside.documentElement.scrollHeight;
  frame.style.width = "390px";
  const width = inside.documentElement.scrollWidth;
  frame.remove();
  return [page, title, height, width];
}))"""
"""Each page beside the others, unpainted: painted one after the other they took three times as long."""


def test_the_site_works_in_a_browser_wide_and_narrow(site, watched_tab):
    """The front page leads to pages with a title; none is longer than 12 screens, or wider than a phone."""
    tab = watched_tab((site / "index.html").as_uri(), site.as_uri())
    inside = tab.evaluate("[...document.links].map(link => link.href).filter(href => href.startsWith('file:'))")
    inside = [link.partition("#")[0] for link in inside if "/demo/" not in link]
    pages = sorted({link for link in inside if link.endswith(".html")})
    assert len(pages) > 20
    assert tab.evaluate("[...document.images].every(image => image.complete && image.naturalWidth > 0)")
    laid_out = tab.evaluate(LAID_OUT, pages)
    assert all(title for _, title, _, _ in laid_out)
    assert [page for page, _, height, _ in laid_out if height > 12 * 800] == []
    assert [page for page, _, _, width in laid_out if width > 390] == []
