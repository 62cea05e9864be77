"""Checkpoints: written whole, and damage, foreign code and other versions are refused in one line."""

import io
import zipfile

import pytest
import torch
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from refusals import refused

from dirl.agent.mapping import ImageGraph, load_graph, save_graph
from dirl.runs.checkpoints import load_checkpoint, save_checkpoint

OPTIMISER = {"state": {0: {"step": torch.tensor(1.0)}}, "param_groups": [{"betas": (0.9, 0.999), "eps": None}]}
STATE = {"frames": 7, "network": {"w": torch.arange(1000.0)}, "config": "a: 1", "extractor": "random", "schema": 2}
STATE |= {"scenes": ["room"], "views": ["ahead"], "optimiser": OPTIMISER}


class Code:
    """What would run when a pickle is read that is not restricted."""

    def __reduce__(self):
        return exec, ("raise SystemExit('it ran')",)


@pytest.fixture
def file(tmp_path):
    save_checkpoint(tmp_path / "a.pt", STATE)
    return tmp_path / "a.pt"


@pytest.fixture
def map_file(tmp_path):
    graph = ImageGraph()
    graph.see(torch.randn(4, 8))
    return save_graph(graph, tmp_path / "map") / "map.pt"


def test_a_checkpoint_comes_back_as_it_was_and_stays_an_archive_of_torch(file):
    for saved in (load_checkpoint(file), torch.load(file, weights_only=True)):
        assert torch.equal(saved["network"]["w"], STATE["network"]["w"])
        assert saved["optimiser"]["param_groups"] == STATE["optimiser"]["param_groups"]
        assert list(saved["optimiser"]["state"]) == [0]


@st.composite
def spoilt(draw, data):
    """Bytes of which a bit, a sector, the end or the order is not what it was."""
    place = draw(st.integers(0, len(data) - 1))
    how = draw(st.sampled_from(["bit", "zeros", "cut", "longer", "swap"]))
    damaged = bytearray(data)
    if how == "bit":
        damaged[place] ^= 1 << draw(st.integers(0, 7))
    elif how == "zeros":
        damaged[place : place + 512] = bytes(len(damaged[place : place + 512]))
    elif how == "cut":
        del damaged[place:]
    elif how == "longer":
        damaged += b"\0"
    else:
        other = draw(st.integers(0, len(data) - 1))
        damaged[place], damaged[other] = damaged[other], damaged[place]
    return bytes(damaged)


@given(drawn=st.data())
@settings(max_examples=200, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_no_damage_is_accepted(file, map_file, drawn):
    read = [(file, load_checkpoint), (map_file, lambda file: load_graph(file.parent))]
    file, load = drawn.draw(st.sampled_from(read))
    whole = file.read_bytes()
    damaged = drawn.draw(spoilt(whole))
    assume(damaged != whole)
    file.write_bytes(damaged)
    assert "delete" not in refused("is damaged", load, file)  # which dirl may not have written
    file.write_bytes(whole)


def test_what_dirl_did_not_write_is_one_line(file, monkeypatch):
    for change, told in (
        ({"schema": 3}, r"was written by another version of dirl \(schema 3, not 2\)"),
        ({"x": Code()}, "is no checkpoint of dirl"),
        ({"views": ...}, "is no checkpoint of dirl: views: is missing"),
        ({"turns": [0]}, r"is no checkpoint of dirl: turns\[0\]: must be greater than or equal to 4, found 0"),
    ):
        save_checkpoint(file, {key: value for key, value in (STATE | change).items() if value is not ...})
        refused(told, load_checkpoint, file)
    save_checkpoint(file, STATE)
    packed = io.BytesIO()
    with zipfile.ZipFile(file) as source, zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as target:
        for entry in source.infolist():
            target.writestr(entry.filename, source.read(entry) + bytes(10**6))
    monkeypatch.setattr("dirl.runs.checkpoints.torch.save", lambda _, stream: stream.write(packed.getvalue()))
    save_checkpoint(file, {})
    refused("its parts are larger than the file", load_checkpoint, file)
