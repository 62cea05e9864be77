"""Ways to spoil the bytes of a good file."""


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
