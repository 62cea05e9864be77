"""What ``torch.save`` writes, of somebody else: no code in it runs, and nothing becomes larger than the file."""

import io
import zipfile
from pathlib import Path
from typing import Any

import torch

from dirl.scenes.io.bounded import MOST_WEIGHTS, read_bytes


def read_tensors(file: Path) -> Any:
    """Return the content of a file, on the CPU; see `unpack_tensors` and `read_bytes` for what is raised."""
    return unpack_tensors(read_bytes(file, MOST_WEIGHTS))


def unpack_tensors(data: bytes) -> Any:
    """Return the content of an archive, on the CPU.

    Raises:
        ValueError: it would unpack to more than it is: torch does not compress, and a view may repeat an element.
        Exception: of torch, whatever it is for what it cannot read.
    """
    archive = io.BytesIO(data)
    if zipfile.is_zipfile(archive) and sum(entry.file_size for entry in zipfile.ZipFile(archive).infolist()) > len(
        data
    ):
        raise ValueError("its parts are larger than the file")
    archive.seek(0)
    stored = torch.load(archive, map_location="cpu", weights_only=True)
    tensors = (
        [value for value in stored.values() if isinstance(value, torch.Tensor)] if isinstance(stored, dict) else []
    )
    if any(tensor.nbytes > len(data) for tensor in tensors):
        raise ValueError("a tensor is larger than the file")
    return stored
