import io
import zipfile

import pytest
import torch

from dirl.runs.checkpoints import latest_checkpoint, load_checkpoint, save_checkpoint
from dirl.runs.finding import RunError

STATE = {
    "frames": 7,
    "network": {"w": torch.arange(1000.0)},
    "config": "a: 1",
    "extractor": "random",
    "schema": 2,
    "scenes": ["room"],
    "optimiser": {"state": {0: {"step": torch.tensor(1.0)}}, "param_groups": [{"betas": (0.9, 0.999), "eps": None}]},
}


@pytest.fixture
def file(tmp_path):
    save_checkpoint(tmp_path / "a.pt", STATE)
    return tmp_path / "a.pt"


def test_a_checkpoint_comes_back_as_it_was_and_stays_an_archive_of_torch(file):
    for saved in (load_checkpoint(file), torch.load(file, weights_only=True)):
        assert torch.equal(saved["network"]["w"], STATE["network"]["w"])
        assert saved["optimiser"]["param_groups"] == STATE["optimiser"]["param_groups"]
        assert list(saved["optimiser"]["state"]) == [0]


def test_one_that_fails_to_be_written_leaves_the_old_one(file):
    with pytest.raises(Exception, match=r"pickle|serializ"):
        save_checkpoint(file, {"frames": (number for number in ())})
    assert load_checkpoint(file)["frames"] == 7


def test_no_flipped_bit_and_no_lost_byte_is_accepted(file):
    data = file.read_bytes()
    places = [*range(0, 8 * len(data), 97), *range(8 * (len(data) - 100), 8 * len(data))]
    for place in places:
        spoilt = bytearray(data)
        spoilt[place // 8] ^= 1 << place % 8
        file.write_bytes(spoilt)
        with pytest.raises(RunError, match="is damaged"):
            load_checkpoint(file)
    for size in (0, 1, 3, len(data) // 2, len(data) - 1):
        file.write_bytes(data[:size])
        with pytest.raises(RunError, match="is damaged"):
            load_checkpoint(file)
    file.write_bytes(data + b"\0")
    with pytest.raises(RunError, match="is damaged"):
        load_checkpoint(file)


@pytest.mark.parametrize(
    ("schema", "told"), [(3, "newer version"), (-1, "schema: must be greater"), ([], "schema: must be a")]
)
def test_one_of_another_schema_is_refused(file, schema, told):
    save_checkpoint(file, STATE | {"schema": schema})
    with pytest.raises(RunError, match=told):
        load_checkpoint(file)


def test_nothing_is_advised_to_be_deleted_that_dirl_did_not_write(tmp_path):
    (tmp_path / "thesis.pt").write_bytes(b"PK\3\4 not a checkpoint")
    with pytest.raises(RunError, match=r"is damaged or no checkpoint of this version") as caught:
        load_checkpoint(tmp_path / "thesis.pt")
    assert "delete" not in str(caught.value)


def test_an_unfinished_runs_folder_gives_its_latest_whole_checkpoint(tmp_path, capsys):
    for frames in (10, 20):
        save_checkpoint(tmp_path / "checkpoints" / f"{frames:012d}.pt", STATE | {"frames": frames})
    newest = tmp_path / "checkpoints" / f"{20:012d}.pt"
    (tmp_path / "checkpoints" / ".unfinished-0.pt").touch()
    assert load_checkpoint(tmp_path)["frames"] == 20
    newest.write_bytes(b"")
    assert load_checkpoint(tmp_path)["frames"] == 10
    assert capsys.readouterr().err.endswith(f"going back to the one before, {10:012d}.pt\n")
    assert latest_checkpoint(tmp_path)[1] == [newest]
    with pytest.raises(RunError, match="holds no checkpoint"):
        load_checkpoint(tmp_path / "nowhere")


def repeated(times):
    """A list of lists of lists and so on, each of which holds the one below twice: 2 to that power in all."""
    value = [0]
    for _ in range(times):
        value = [value, value]
    return value


class Code:
    """What would run when a pickle is read that is not restricted."""

    def __reduce__(self):
        return exec, ("raise SystemExit('it ran')",)


WRONG = {
    "no network": ({"network": None}, "network: must be a valid dictionary"),
    "a network of lists": ({"network": {"w": [1, 2]}}, "network: w: must be an instance of Tensor"),
    "a key that is no text": ({"network": {1: torch.zeros(1)}}, r"network: \[1\]: \[key\]: must be a valid string"),
    "configuration that is no text": ({"config": 3}, "config: must be a valid string"),
    "no scenes": ({"scenes": []}, "scenes: List should have at least 1 item"),
    "scenes of numbers": ({"scenes": [1]}, r"scenes: \[0\]: must be a valid string"),
    "negative frames": ({"frames": -1}, "frames: must be greater than or equal to 0"),
    "true frames": ({"frames": True}, "frames: must be a valid integer"),
    "fractional frames": ({"frames": 1.0}, "frames: must be a valid integer"),
    "too many frames": ({"frames": 2**63}, "frames: must be less than or equal to"),
    "negative seconds": ({"seconds": -1.0}, "seconds: must be greater than or equal to 0"),
    "NaN seconds": ({"seconds": float("nan")}, "seconds is nan"),
    "tables elsewhere": ({"tables": {"../a.csv": 1}}, r"tables: \.\./a\.csv: .* must be 'dagger\.csv', "),
    "negative tables": ({"tables": {"dagger.csv": -1}}, r"tables: dagger\.csv: must be greater than or equal to 0"),
    "NaN weights": ({"network": {"w": torch.tensor([1.0, torch.nan])}}, r"network\.w: holds values that are not fin"),
    "infinite state": ({"x": [{"y": torch.tensor(torch.inf)}]}, r"x\[0\]\.y: holds values that are not finite"),
    "complex weights": ({"network": {"w": torch.zeros(2, dtype=torch.complex64)}}, "expected an ordinary tensor"),
    "sparse weights": ({"network": {"w": torch.eye(3).to_sparse()}}, "expected an ordinary tensor"),
    "a huge tensor of one number": ({"network": {"w": torch.zeros(1).expand(2**40)}}, "larger than the file"),
    "a set": ({"x": {1, 2}}, "x is a set"),
    "keys that are tuples": ({"x": {(1, 2): 3}}, "x has keys that are neither"),
    "code": ({"x": Code()}, "is no checkpoint of dirl"),
}


@pytest.mark.parametrize(("change", "told"), WRONG.values(), ids=WRONG)
def test_wrong_contents_get_one_line(file, change, told):
    save_checkpoint(file, STATE | change)
    with pytest.raises(RunError, match=told) as caught:
        load_checkpoint(file)
    assert str(caught.value).startswith(f"{file}: ")
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize("missing", ["network", "config", "extractor", "scenes", "frames"])
def test_what_is_missing_is_named(file, missing):
    save_checkpoint(file, {key: value for key, value in STATE.items() if key != missing})
    with pytest.raises(RunError, match=f"is no checkpoint of dirl: {missing}: is missing"):
        load_checkpoint(file)


def test_nested_garbage_takes_no_time_and_no_memory(file):
    cycle = []
    cycle.append(cycle)
    save_checkpoint(file, STATE | {"x": repeated(60), "y": cycle, "z": [torch.zeros(2**12)] * 1000})
    assert load_checkpoint(file)["frames"] == 7
    views = torch.zeros(2**16)
    save_checkpoint(file, STATE | {"x": [views.view(-1) for _ in range(100)]})
    with pytest.raises(RunError, match="tensors that are much larger than the file"):
        load_checkpoint(file)


def test_an_archive_that_would_unpack_to_more_is_refused(file, monkeypatch):
    packed = io.BytesIO()
    with zipfile.ZipFile(file) as source, zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as target:
        for entry in source.infolist():
            target.writestr(entry.filename, source.read(entry) + bytes(10**6))
    monkeypatch.setattr("dirl.runs.checkpoints.torch.save", lambda _, stream: stream.write(packed.getvalue()))
    save_checkpoint(file, {})
    with pytest.raises(RunError, match="its parts are larger than the file"):
        load_checkpoint(file)
