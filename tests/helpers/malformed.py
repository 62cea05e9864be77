"""Malformed dumps: what is done to a good file of 24 states, and what the one error says after the file's name.

``python tests/helpers/malformed.py`` writes the table of them into docs/howto/malformed_dumps.md.
"""

import sys
import tempfile
from pathlib import Path

import h5py
import numpy as np
from found import CANNOT_BE_CALLED, FOUND
from rooms import grid_scene, published_dump, read_here
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
    squeezed,
    unknown_filter,
    webp,
    without,
)

from dirl.scenes import SceneError

PAGE = Path(__file__).parents[2] / "docs" / "howto" / "malformed_dumps.md"

HUGE = 2**40
"""More states than any machine can hold; a chunked dataset of that size takes no room on the disk."""

RANGE = "states are 0..23"
TURN_OF_SIX = np.array([[-1, (i + 1) % 6 + 6 * (i // 6), (i - 1) % 6 + 6 * (i // 6), -1] for i in range(24)])
UNEVEN = np.array([[-1, (i + 1) % 4, (i - 1) % 4, -1] for i in range(4)])
UNEVEN = np.concatenate([UNEVEN, [[-1, 4 + (i + 1) % 20, 4 + (i - 1) % 20, -1] for i in range(20)]])
RING = np.array([[-1, (i + 1) % 400, (i - 1) % 400, -1] for i in range(400)])

SHAPES = {
    "no `graph`": (without("graph"), "the dataset 'graph' is missing; the file holds ['location', 'observation'"),
    "no `location`": (without("location"), "the dataset 'location' is missing"),
    "no `rotation`": (without("rotation"), "the dataset 'rotation' is missing"),
    "`graph` of six actions": (
        instead("graph", np.zeros((24, 6), int)),
        "graph: expected shape (any, 4), found (24, 6)",
    ),
    "`graph` of one dimension": (instead("graph", np.zeros(24, int)), "graph: expected shape (any, 4), found (24,)"),
    "`graph` empty": (instead("graph", h5py.Empty("i4")), "graph: expected shape (any, 4), found ()"),
    "`location` with a height": (
        instead("location", np.zeros((24, 3))),
        "location: expected shape (24, 2), found (24, 3)",
    ),
    "`location` of one state fewer": (
        instead("location", np.zeros((23, 2))),
        "location: expected shape (24, 2), found (23, 2)",
    ),
    "`rotation` of two dimensions": (
        instead("rotation", np.zeros((24, 1))),
        "rotation: expected shape (24), found (24, 1)",
    ),
    "`resnet_feature` of one state fewer": (
        instead("resnet_feature", np.zeros((23, 8))),
        "resnet_feature: expected shape (24, any), found (23, 8)",
    ),
    "`resnet_feature` of one dimension": (
        instead("resnet_feature", np.zeros(24)),
        "resnet_feature: expected shape (24, any), found (24,)",
    ),
    "`resnet_feature` not pooled": (
        instead("resnet_feature", np.zeros((24, 2, 2, 2))),
        "resnet_feature: expected shape (24, any), found (24, 2, 2",
    ),
    "`resnet_feature` of width 0": (
        instead("resnet_feature", np.zeros((24, 0))),
        "resnet_feature: expected at least one feature a state, and 134217728 of all at most, found shape (24, 0)",
    ),
    "`resnet_feature` of no crops": (
        instead("resnet_feature", np.zeros((24, 0, 8))),
        "resnet_feature: expected at least one feature a state, and 134217728 of all at most, found shape (24, 0, 8",
    ),
    "distances of some goals only": (
        instead("shortest_path_distance", np.zeros((24, 5))),
        "shortest_path_distance: expected shape (24, 24), found (24, 5)",
    ),
    "grey views": (
        instead("observation", np.zeros((24, 3, 4), "u1")),
        "observation: expected shape (24, any, any, 3), found (24, 3, 4)",
    ),
    "views with an alpha channel": (
        instead("observation", np.zeros((24, 3, 4, 4), "u1")),
        "observation: expected shape (24, any, any, 3), found (24, 3, 4, 4)",
    ),
    "no states": (no_states, "graph: there are no states"),
}

TYPES = {
    "`graph` of floats": (
        instead("graph", np.zeros((24, 4))),
        "graph: expected integer or unsigned integer values, found float64",
    ),
    "`graph` of booleans": (
        instead("graph", np.zeros((24, 4), bool)),
        "graph: expected integer or unsigned integer values, found bool",
    ),
    "`graph` of records": (
        instead("graph", np.zeros((24, 4), [("to", "i4")])),
        "graph: expected integer or unsigned integer values, found [('to', '<i4')]",
    ),
    "`graph` of texts": (
        instead("graph", np.full((24, 4), b"1")),
        "graph: expected integer or unsigned integer values, found |S1",
    ),
    "`graph` is a group": (group("graph"), "graph: is a group; expected a dataset"),
    "`graph` is a type": (named_type("graph"), "graph: is a datatype; expected a dataset"),
    "`resnet_feature` is a group": (group("resnet_feature"), "resnet_feature: is a group; expected a dataset"),
    "`location` of texts": (
        instead("location", np.full((24, 2), b"x")),
        "location: expected integer or unsigned integer or float values",
    ),
    "`rotation` of complex numbers": (
        instead("rotation", np.zeros(24, complex)),
        "rotation: expected integer or unsigned integer or float values",
    ),
    "`resnet_feature` of integers": (
        instead("resnet_feature", np.zeros((24, 8), int)),
        "resnet_feature: expected float values, found int64",
    ),
    "views of 16 bits": (
        instead("observation", np.zeros((24, 3, 4, 3), "u2")),
        "observation: expected uint8 pixels, found uint16",
    ),
    "views of floats": (
        instead("observation", np.zeros((24, 3, 4, 3))),
        "observation: expected unsigned integer values, found float64",
    ),
    "encoded views of fixed length": (
        instead("observation_webp", np.full(24, b"RIFF", "S4")),
        "observation_webp: expected byte string values, found",
    ),
    "encoded views as texts": (webp(h5py.string_dtype()), "observation_webp: expected byte strings"),
    "encoded views as references": (webp(h5py.ref_dtype), "observation_webp: expected byte strings"),
}

VALUES = {
    "a link to a state that is not there": (
        cell("graph", (5, 0), 24),
        f"graph: state 5: ahead leads to state 24, but {RANGE}",
    ),
    "a link of -2": (cell("graph", ([20, 9], 3), -2), f"graph: state 9: back leads to state -2, but {RANGE}"),
    "-1 stored as an unsigned 32-bit number": (
        instead("graph", grid_scene().graph.astype("u4")),
        "graph: state 0: back leads to state 4294967295",
    ),
    "-1 stored as an unsigned 64-bit number": (
        instead("graph", grid_scene().graph.astype("u8")),
        "graph: state 0: back leads to state 9223372036854775807",
    ),
    "a right turn that is blocked": (cell("graph", (6, 1), -1), "graph: state 6: turning right is blocked"),
    "a right turn that is one-way": (
        cell("graph", (7, 1), 5),
        "graph: state 7: turning right and back does not return to it",
    ),
    "a left turn that is blocked": (
        cell("graph", (6, 2), -1),
        "graph: state 5: turning right and back does not return to it",
    ),
    "columns in another order, undeclared": (
        instead("graph", grid_scene().graph[:, [0, 3, 2, 1]]),
        "graph: state 0: turning right is blocked",
    ),
    "turns of 60 degrees": (
        instead("graph", TURN_OF_SIX),
        "graph: state 0: a full turn to the right passes 6 states",
    ),
    "different turns at different places": (
        instead("graph", UNEVEN),
        "graph: state 4: a full turn to the right passes 20 states; expected the same",
    ),
    "a ring of 400 turns": (of_states(RING), "graph: state 0: a full turn to the right passes more than 360 states"),
    "no moves at all": (instead("graph", np.full((24, 4), -1)), "graph: state 0: no state has any move"),
    "a turn that moves the agent": (
        cell("location", (11, 0), 9.0),
        "location: state 10 is at [1.0, 0.0] but the state to its right, 11,",
    ),
    "a location that is infinite": (
        cell("location", (4, 1), np.inf),
        "location: state 4 holds a value that is not finite",
    ),
    "a location on the moon": (
        cell("location", (4, 1), 4e8),
        "location: state 4 holds [0.5, 400000000.0]; expected at most 1,000,000 met",
    ),
    "a rotation that is NaN": (
        instead("rotation", np.where(np.arange(24) == 8, np.nan, 0)),
        "rotation: state 8 holds a value that is not finite",
    ),
    "a rotation beyond reason": (
        instead("rotation", np.where(np.arange(24) == 8, 1e300, 0)),
        "rotation: state 8 holds 1e+300; expected at most 1,000,000 degrees",
    ),
    "features with NaN": (
        cell("resnet_feature", ([17, 3], 0, 2), np.nan),
        "resnet_feature: state 3 holds a value that is not finite",
    ),
    "features that overflow float32": (
        instead("resnet_feature", np.full((24, 8), 1e300)),
        "resnet_feature: state 0 holds a value that is not finite",
    ),
}

ATTRIBUTES = {
    "a goal beyond the states": (attribute("goals", [3, 24]), f"goal 24 is not a state; {RANGE}"),
    "a goal of -1": (attribute("goals", [-1]), "goal -1 is not a state"),
    "a goal named twice": (attribute("goals", [3, 4, 3]), "attribute 'goals': names state 3 twice"),
    "goals as text": (attribute("goals", "abc"), "attribute 'goals': expected a list of states"),
    "goals as NaN": (attribute("goals", np.nan), "attribute 'goals': expected a list of states"),
    "goals as fractions": (attribute("goals", [1.5]), "attribute 'goals': expected a list of states"),
    "goals as a table": (attribute("goals", [[1, 2]]), "attribute 'goals': expected a list of states"),
    "goals empty": (attribute("goals", h5py.Empty("i8")), "attribute 'goals': expected a list of states"),
    "an unknown action": (
        attribute("actions", ["ahead", "right", "left", "up"]),
        "attribute 'actions': expected ['ahead', 'right', 'left', 'back'] in the order of graph's columns, found",
    ),
    "three actions": (attribute("actions", ["ahead", "right", "left"]), "attribute 'actions': expected"),
    "an action twice": (attribute("actions", ["ahead", "ahead", "left", "back"]), "attribute 'actions': expected"),
    "five actions": (attribute("actions", ["ahead", "right", "left", "back", "back"]), "attribute 'actions': expected"),
    "actions as numbers": (attribute("actions", [0, 1, 2, 3]), "attribute 'actions': expected"),
    "a name that is not UTF-8": (attribute("name", np.bytes_(b"\xff\xfe")), "attribute 'name': expected text, found"),
    "a name that is a number": (attribute("name", 7), "attribute 'name': expected text, found"),
    "a name with slashes": (
        attribute("name", "../../etc/room"),
        f"{CANNOT_BE_CALLED}'../../etc/room'",
    ),
    "a name of a thousand letters": (attribute("name", "x" * 1000), f"{CANNOT_BE_CALLED}'xxx"),
    "a source of two lines": (
        attribute("source", "thor\nrooms"),
        "attribute 'source': expected one line of text, found 'thor\\nrooms'",
    ),
    "an extractor that is a list": (
        feature_attribute("extractor", [1, 2]),
        "attribute 'extractor': expected text, found",
    ),
}

STORAGE = {
    "`graph` is a soft link": (elsewhere("graph", "soft"), "graph: is a link to elsewhere"),
    "`graph` is an external link": (elsewhere("graph", "external"), "graph: is a link to elsewhere"),
    "`graph` is a virtual dataset": (elsewhere("graph", "virtual"), "graph: its data lies in other files"),
    "`graph` is an external link to nothing": (dangling("graph"), "graph: is a link to elsewhere"),
    "`location` is a virtual dataset": (elsewhere("location", "virtual"), "location: its data lies in other files"),
    "`resnet_feature` is a soft link": (elsewhere("resnet_feature", "soft"), "resnet_feature: is a link to elsewhere"),
    "`resnet_feature` is an external link": (
        elsewhere("resnet_feature", "external"),
        "resnet_feature: is a link to elsewhere",
    ),
    "`resnet_feature` is a link to itself": (
        instead("resnet_feature", h5py.SoftLink("/resnet_feature")),
        "resnet_feature: is a link to elsewhere",
    ),
    "`resnet_feature` is an external link to nothing": (
        dangling("resnet_feature"),
        "resnet_feature: is a link to elsewhere",
    ),
    "features stored in another file": (
        elsewhere("resnet_feature", "storage"),
        "resnet_feature: its data lies in other files",
    ),
    "views behind an external link": (elsewhere("observation", "external"), "observation: is a link to elsewhere"),
    "views behind an external link to nothing": (dangling("observation"), "observation: is a link to elsewhere"),
    "features never written": (hollow("resnet_feature", (24, 8)), "resnet_feature: some of its values were never writ"),
    "features written by half": (partly_written("resnet_feature"), "resnet_feature: some of its values were never wr"),
    "encoded views never written": (
        lambda file: file.create_dataset("observation_webp", (24,), h5py.vlen_dtype(np.uint8)),
        "observation_webp: some of its values were never written",
    ),
    "a compression that is not installed": (
        unknown_filter("graph"),
        "graph: is compressed in a way that is not installed here (HDF5 filter 32123",
    ),
}

ABSURD = {
    "a trillion states": (hollow("graph", (HUGE, 4), "i4"), f"graph: {HUGE} states are more than the 50000"),
    "a trillion locations": (hollow("location", (HUGE, 2)), "location: expected shape (24, 2)"),
    "a trillion rotations": (hollow("rotation", (HUGE,)), "rotation: expected shape (24)"),
    "a trillion features": (
        hollow("resnet_feature", (24, HUGE)),
        "resnet_feature: expected at least one feature a state",
    ),
    "a trillion features of two crops": (
        hollow("resnet_feature", (24, 2, HUGE)),
        "resnet_feature: expected at least one feature a state",
    ),
    "features of a trillion states": (
        hollow("resnet_feature", (HUGE, 1, 8)),
        "resnet_feature: expected shape (24, any, any)",
    ),
    "distances of a trillion states": (
        hollow("shortest_path_distance", (HUGE, HUGE)),
        "shortest_path_distance: expected shape (24, 24)",
    ),
    "views of a trillion states": (
        hollow("observation", (HUGE, 3, 4, 3), "u1"),
        "observation: expected shape (24, any, any, 3)",
    ),
    "views a trillion pixels high": (
        hollow("observation", (24, HUGE, 4, 3), "u1"),
        "observation: expected 1 to 16777216 pixels a view, found shape",
    ),
    "`graph` in one chunk of two gigabytes": (
        lambda file: (
            file.pop("graph"),
            file.create_dataset("graph", (24, 4), "i8", maxshape=(None, None), chunks=(2**14, 2**14)),
        ),
        "graph: is stored in chunks of (16384, 16384), 2147483648 bytes each; at most 268435456",
    ),
    "features in one chunk of a gigabyte": (
        lambda file: (
            file.pop("resnet_feature"),
            file.create_dataset("resnet_feature", (24, 8), "f4", maxshape=(None, None), chunks=(2**14, 2**14)),
        ),
        "resnet_feature: is stored in chunks of (16384, 16384), 1073741824 bytes each; at most 268435456",
    ),
    "features that unpack to a thousand times their size": (
        squeezed("resnet_feature", (24, 2**20)),
        "resnet_feature: 99008 bytes would unpack to 100663296",
    ),
}

MALFORMED = {**SHAPES, **TYPES, **VALUES, **ATTRIBUTES, **STORAGE, **ABSURD, **FOUND}


def make(path, spoil):
    """A good file of 24 states, spoiled."""
    published_dump(path, grid_scene())
    with h5py.File(path, "a") as file:
        spoil(file)
    return path


def page():
    """The table of all malformed files with their messages, Markdown."""
    lines = []
    with tempfile.TemporaryDirectory() as folder:
        for number, (what, (spoil, _)) in enumerate(MALFORMED.items()):
            path = make(Path(folder) / f"{number}.h5", spoil)
            try:
                read_here(path)
            except SceneError as error:
                message = str(error).removeprefix(f"{path}: ").replace(folder, "...").replace("|", "\\|")
                lines.append(f"| {what} | {message} |")
    return f"""# Messages for malformed dumps

An invalid file is refused before any work begins. A `SceneError` of one line names the file, the dataset or
attribute, the first offending state, and what was expected. Nothing is repaired silently, and sizes are
checked before memory is allocated. A file that is truncated or not HDF5 is reported as "not a readable HDF5
file, perhaps a broken download".

The table below has {len(lines)} damaged files and their messages, without the file name at the beginning. Each file
is made from a valid one of 24 states by `tests/helpers/malformed.py` or `found.py`, and read.
`python tests/helpers/malformed.py` writes the table, and a test compares the two.

## What is promised

- *A file that dirl wrote* contains a digest: the SHA-256 of its datasets and of the attributes that are
  read. A file that does not match its digest is refused. The four built-in rooms are verified byte for byte
  by `SHA256SUMS` beside them.
- *A file of another program* has no digest. It is read with the checks below, and all its encoded views are
  decoded once. A changed number that is still plausible cannot be detected.
- *No file can crash the program that reads it*, whatever its bytes. libhdf5 can crash or hang on damaged
  files, so every file except the built-in rooms is read in a separate process. That process may use 30 s of
  processor time, one more second for each megabyte of the file, and 3 GiB of address space. If it ends
  early, the reader reports that in one line.
- *Views* are read later, directly from their position in the file and without libhdf5. If the file is
  changed after the scene was read, a view can be wrong, or one line says that it cannot be read.

Two things are not promised. A digest is not a signature: a malicious file can carry a matching one. And a
separate process is not a sandbox: a malicious file could take over the process that reads it. Windows
supports none of the limits, and macOS not the one on memory. There a time limit, twenty times as long, ends
the process.

`python tests/faults/dumps.py count=10000 seed=7` damages 10,000 files, reads each, and prints a summary.

## The messages

| file | message |
|---|---|
{chr(10).join(lines)}
"""


if __name__ == "__main__":
    sys.stdout.write(f"{PAGE}: {PAGE.write_text(page())} characters\n")
