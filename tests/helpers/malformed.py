"""Malformed dumps: what is done to a good file of 24 states.

What the one error says is in docs/howto/malformed_dumps.md; ``python tests/helpers/malformed.py`` writes its table.
"""

import re
import sys
import tempfile
from pathlib import Path

import h5py
import numpy as np
from found import FOUND
from rooms import grid_scene, published_dump
from spoil import (
    attribute,
    cell,
    dangling,
    elsewhere,
    feature_attribute,
    group,
    hollow,
    instead,
    named_type,
    no_states,
    of_states,
    partly_written,
    refused,
    squeezed,
    unknown_filter,
    webp,
    without,
)

PAGE = Path(__file__).parents[2] / "docs" / "howto" / "malformed_dumps.md"
BEGIN = "| file | message |\n|---|---|"
"""Of the table, which is the end of the page."""

HUGE = 2**40
"""More states than any machine can hold; a chunked dataset of that size takes no room on the disk."""

TURN_OF_SIX = np.array([[-1, (i + 1) % 6 + 6 * (i // 6), (i - 1) % 6 + 6 * (i // 6), -1] for i in range(24)])
UNEVEN = np.array([[-1, (i + 1) % 4, (i - 1) % 4, -1] for i in range(4)])
UNEVEN = np.concatenate([UNEVEN, [[-1, 4 + (i + 1) % 20, 4 + (i - 1) % 20, -1] for i in range(20)]])
RING = np.array([[-1, (i + 1) % 400, (i - 1) % 400, -1] for i in range(400)])

SHAPES = {
    "no `graph`": without("graph"),
    "no `location`": without("location"),
    "no `rotation`": without("rotation"),
    "`graph` of six actions": instead("graph", np.zeros((24, 6), int)),
    "`graph` of one dimension": instead("graph", np.zeros(24, int)),
    "`graph` empty": instead("graph", h5py.Empty("i4")),
    "`location` with a height": instead("location", np.zeros((24, 3))),
    "`location` of one state fewer": instead("location", np.zeros((23, 2))),
    "`rotation` of two dimensions": instead("rotation", np.zeros((24, 1))),
    "`resnet_feature` of one state fewer": instead("resnet_feature", np.zeros((23, 8))),
    "`resnet_feature` of one dimension": instead("resnet_feature", np.zeros(24)),
    "`resnet_feature` not pooled": instead("resnet_feature", np.zeros((24, 2, 2, 2))),
    "`resnet_feature` of width 0": instead("resnet_feature", np.zeros((24, 0))),
    "`resnet_feature` of no crops": instead("resnet_feature", np.zeros((24, 0, 8))),
    "distances of some goals only": instead("shortest_path_distance", np.zeros((24, 5))),
    "grey views": instead("observation", np.zeros((24, 3, 4), "u1")),
    "views with an alpha channel": instead("observation", np.zeros((24, 3, 4, 4), "u1")),
    "no states": no_states,
}

TYPES = {
    "`graph` of floats": instead("graph", np.zeros((24, 4))),
    "`graph` of booleans": instead("graph", np.zeros((24, 4), bool)),
    "`graph` of records": instead("graph", np.zeros((24, 4), [("to", "i4")])),
    "`graph` of texts": instead("graph", np.full((24, 4), b"1")),
    "`graph` is a group": group("graph"),
    "`graph` is a type": named_type("graph"),
    "`resnet_feature` is a group": group("resnet_feature"),
    "`location` of texts": instead("location", np.full((24, 2), b"x")),
    "`rotation` of complex numbers": instead("rotation", np.zeros(24, complex)),
    "`resnet_feature` of integers": instead("resnet_feature", np.zeros((24, 8), int)),
    "views of 16 bits": instead("observation", np.zeros((24, 3, 4, 3), "u2")),
    "views of floats": instead("observation", np.zeros((24, 3, 4, 3))),
    "encoded views of fixed length": instead("observation_webp", np.full(24, b"RIFF", "S4")),
    "encoded views as texts": webp(h5py.string_dtype()),
    "encoded views as references": webp(h5py.ref_dtype),
}

VALUES = {
    "a link to a state that is not there": cell("graph", (5, 0), 24),
    "a link of -2": cell("graph", ([20, 9], 3), -2),
    "-1 stored as an unsigned 32-bit number": instead("graph", grid_scene().graph.astype("u4")),
    "-1 stored as an unsigned 64-bit number": instead("graph", grid_scene().graph.astype("u8")),
    "a right turn that is blocked": cell("graph", (6, 1), -1),
    "a right turn that is one-way": cell("graph", (7, 1), 5),
    "a left turn that is blocked": cell("graph", (6, 2), -1),
    "columns in another order, undeclared": instead("graph", grid_scene().graph[:, [0, 3, 2, 1]]),
    "turns of 60 degrees": instead("graph", TURN_OF_SIX),
    "different turns at different places": instead("graph", UNEVEN),
    "a ring of 400 turns": of_states(RING),
    "no moves at all": instead("graph", np.full((24, 4), -1)),
    "a turn that moves the agent": cell("location", (11, 0), 9.0),
    "a location that is infinite": cell("location", (4, 1), np.inf),
    "a location on the moon": cell("location", (4, 1), 4e8),
    "a rotation that is NaN": instead("rotation", np.where(np.arange(24) == 8, np.nan, 0)),
    "a rotation beyond reason": instead("rotation", np.where(np.arange(24) == 8, 1e300, 0)),
    "features with NaN": cell("resnet_feature", ([17, 3], 0, 2), np.nan),
    "features that overflow float32": instead("resnet_feature", np.full((24, 8), 1e300)),
}

ATTRIBUTES = {
    "a goal beyond the states": attribute("goals", [3, 24]),
    "a goal of -1": attribute("goals", [-1]),
    "a goal named twice": attribute("goals", [3, 4, 3]),
    "goals as text": attribute("goals", "abc"),
    "goals as NaN": attribute("goals", np.nan),
    "goals as fractions": attribute("goals", [1.5]),
    "goals as a table": attribute("goals", [[1, 2]]),
    "goals empty": attribute("goals", h5py.Empty("i8")),
    "an unknown action": attribute("actions", ["ahead", "right", "left", "up"]),
    "three actions": attribute("actions", ["ahead", "right", "left"]),
    "an action twice": attribute("actions", ["ahead", "ahead", "left", "back"]),
    "five actions": attribute("actions", ["ahead", "right", "left", "back", "back"]),
    "actions as numbers": attribute("actions", [0, 1, 2, 3]),
    "a name that is not UTF-8": attribute("name", np.bytes_(b"\xff\xfe")),
    "a name that is a number": attribute("name", 7),
    "a name with slashes": attribute("name", "../../etc/room"),
    "a name of a thousand letters": attribute("name", "x" * 1000),
    "a source of two lines": attribute("source", "thor\nrooms"),
    "an extractor that is a list": feature_attribute("extractor", [1, 2]),
}

STORAGE = {
    "`graph` is a soft link": elsewhere("graph", "soft"),
    "`graph` is an external link": elsewhere("graph", "external"),
    "`graph` is a virtual dataset": elsewhere("graph", "virtual"),
    "`graph` is an external link to nothing": dangling("graph"),
    "`location` is a virtual dataset": elsewhere("location", "virtual"),
    "`resnet_feature` is a soft link": elsewhere("resnet_feature", "soft"),
    "`resnet_feature` is an external link": elsewhere("resnet_feature", "external"),
    "`resnet_feature` is a link to itself": instead("resnet_feature", h5py.SoftLink("/resnet_feature")),
    "`resnet_feature` is an external link to nothing": dangling("resnet_feature"),
    "features stored in another file": elsewhere("resnet_feature", "storage"),
    "views behind an external link": elsewhere("observation", "external"),
    "views behind an external link to nothing": dangling("observation"),
    "features never written": hollow("resnet_feature", (24, 8)),
    "features written by half": partly_written("resnet_feature"),
    "encoded views never written": webp(h5py.vlen_dtype(np.uint8)),
    "a compression that is not installed": unknown_filter("graph"),
}

ABSURD = {
    "a trillion states": hollow("graph", (HUGE, 4), "i4"),
    "a trillion locations": hollow("location", (HUGE, 2)),
    "a trillion rotations": hollow("rotation", (HUGE,)),
    "a trillion features": hollow("resnet_feature", (24, HUGE)),
    "a trillion features of two crops": hollow("resnet_feature", (24, 2, HUGE)),
    "features of a trillion states": hollow("resnet_feature", (HUGE, 1, 8)),
    "distances of a trillion states": hollow("shortest_path_distance", (HUGE, HUGE)),
    "views of a trillion states": hollow("observation", (HUGE, 3, 4, 3), "u1"),
    "views a trillion pixels high": hollow("observation", (24, HUGE, 4, 3), "u1"),
    "`graph` in one chunk of two gigabytes": lambda file: (
        file.pop("graph"),
        file.create_dataset("graph", (24, 4), "i8", maxshape=(None, None), chunks=(2**14, 2**14)),
    ),
    "features in one chunk of a gigabyte": lambda file: (
        file.pop("resnet_feature"),
        file.create_dataset("resnet_feature", (24, 8), "f4", maxshape=(None, None), chunks=(2**14, 2**14)),
    ),
    "features that unpack to a thousand times their size": squeezed("resnet_feature", (24, 2**20)),
}

MALFORMED = {**SHAPES, **TYPES, **VALUES, **ATTRIBUTES, **STORAGE, **ABSURD, **FOUND}


def make(path, spoil):
    """A good file of 24 states, spoiled."""
    published_dump(path, grid_scene())
    with h5py.File(path, "a") as file:
        spoil(file)
    return path


def row(what, message):
    """The line of the table about a file."""
    escaped = message.replace("|", "\\|")
    return f"| {what} | {escaped} |"


def page():
    """The page with the table of all malformed files and their messages, Markdown."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for number, (what, spoil) in enumerate(MALFORMED.items()):
            rows.append(row(what, refused(make(Path(folder) / f"{number}.h5", spoil))))
    about = re.sub(r"has \d+ damaged files", f"has {len(rows)} damaged files", PAGE.read_text().partition(BEGIN)[0])
    return "\n".join([about + BEGIN, *rows, ""])


if __name__ == "__main__":
    sys.stdout.write(f"{PAGE}: {PAGE.write_text(page())} characters\n")
