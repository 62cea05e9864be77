"""Ways to spoil a good checkpoint: its bytes, or what is in it."""

import copy
import math

import torch

UNUSED = {"views", "x", "extractor", "seconds", "training_seconds"}
"""What may be missing, or have another value, without that a resumed run can know."""


def spoil_bytes(data, rng):
    """One damage of a file's bytes, and what it is in words."""
    what = rng.choice(["bit", "bit", "bit", "zeros", "cut", "longer", "swap"])
    place = rng.randrange(len(data))
    spoilt = bytearray(data)
    if what == "bit":
        spoilt[place] ^= 1 << rng.randrange(8)
    elif what == "zeros":
        spoilt[place : place + 512] = bytes(len(spoilt[place : place + 512]))
    elif what == "cut":
        del spoilt[place:]
    elif what == "longer":
        spoilt += b"\0"
    else:
        other = rng.randrange(len(data))
        spoilt[place], spoilt[other] = spoilt[other], spoilt[place]
    return bytes(spoilt), f"{what} at {place}"


def paths(state, above=()):
    """The places in a nested state, each as the keys that lead there."""
    found = []
    items = state.items() if isinstance(state, dict) else enumerate(state) if isinstance(state, list | tuple) else ()
    for key, value in items:
        found.append((*above, key))
        found += paths(value, (*above, key))
    return found


def wrong_values(value):
    """Values that cannot stand in place of another."""
    wrong = {"a text": "text", "garbage": [[{"x": [None]}]], "minus one": -1, "a huge number": 2**70, "NaN": math.nan}
    wrong |= {"nothing": None, "a list": [], "a dictionary": {}, "infinity": math.inf, "true": True, "bytes": b"x"}
    if isinstance(value, torch.Tensor):
        wrong |= {
            "a longer tensor": torch.zeros((*value.shape, 2), dtype=value.dtype),
            "another dtype": torch.zeros(value.shape, dtype=torch.float16),
            "a huge tensor": torch.zeros(1).expand(2**45),
        }
        if value.is_floating_point():
            wrong["a tensor of NaN"] = torch.full_like(value, math.nan)
        return wrong
    if isinstance(value, bool) or value is None:
        wrong.pop("true" if value is True else "nothing", None)
    if isinstance(value, str):
        del wrong["a text"]
    if isinstance(value, list | tuple) and not value:
        del wrong["a list"]
    if isinstance(value, dict) and not value:
        del wrong["a dictionary"]
    return wrong


def spoil_contents(state, rng):
    """One damage of a checkpoint's contents that must be noticed, and what it is in words."""
    state = copy.deepcopy(state)
    where = rng.choice([path for path in paths(state) if path[0] not in UNUSED])
    holder = state
    for key in where[:-1]:
        holder = holder[key]
    name = ".".join(map(str, where))
    if isinstance(holder, tuple):
        where, holder = where[:-1], state
        for key in where[:-1]:
            holder = holder[key]
    if isinstance(holder, dict) and rng.random() < 0.2:
        del holder[where[-1]]
        return state, f"{name} is missing"
    what, value = rng.choice(sorted(wrong_values(holder[where[-1]]).items(), key=lambda item: item[0]))
    holder[where[-1]] = value
    return state, f"{name} is {what}"
