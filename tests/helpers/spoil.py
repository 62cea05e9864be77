"""Damage to the bytes of a file."""

from hypothesis import strategies as st


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
