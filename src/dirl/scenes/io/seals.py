"""Digests in JSON over a folder's files, by which later damage is detected."""

import hashlib
import json
from collections.abc import Mapping
from typing import Any

DIGEST = "digest"
"""The key of the digest among the facts."""


def sealed(facts: Mapping[str, Any], *contents: bytes) -> dict[str, Any]:
    """The facts with a digest over them and the contents of other files."""
    return {**facts, DIGEST: _digest(facts, *contents)}


def check_seal(facts: Mapping[str, Any], *contents: bytes) -> None:
    """Check what `sealed` added; folders of older versions have none.

    Raises:
        ValueError: the facts or the contents are others than those that were written.
    """
    if DIGEST in facts and facts[DIGEST] != _digest({key: facts[key] for key in facts if key != DIGEST}, *contents):
        raise ValueError("its files are not those that were written: the digest differs")


def _digest(facts: Mapping[str, Any], *contents: bytes) -> str:
    digest = hashlib.sha256(json.dumps(facts, sort_keys=True).encode())
    for content in contents:
        digest.update(hashlib.sha256(content).digest())
    return digest.hexdigest()
