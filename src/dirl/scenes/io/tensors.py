"""What ``torch.save`` writes, of somebody else: no code in it runs, and nothing becomes larger than the file."""

import io
import zipfile
from pathlib import Path
from typing import Any

import torch

from dirl.scenes.io.bounded import FREELY_UNPACKED, MOST_WEIGHTS, read_bytes


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
    if zipfile.is_zipfile(archive):  # what older versions of torch wrote is none
        parts = zipfile.ZipFile(archive).infolist()
        if sum(part.file_size for part in parts) > len(data):
            raise ValueError("its parts are larger than the file")
    archive.seek(0)
    stored = torch.load(archive, map_location="cpu", weights_only=True)
    values = stored.values() if isinstance(stored, dict) else ()
    most = max(FREELY_UNPACKED, len(data))
    if any(isinstance(value, torch.Tensor) and value.nbytes > most for value in values):
        raise ValueError("a tensor is larger than the file")
    return stored
