"""Random mazes: every cell is reached, and a WAD holds what was written."""

import struct

import numpy as np
from mazes import CELL, draw_maze, read_lumps, write_mazes


def reached(maze):
    """The cells that can be reached from the first."""
    found, new = {(0, 0)}, [(0, 0)]
    while new:
        x, y = new.pop()
        ways = [(x + 1, y, maze.right[x, y]), (x, y + 1, maze.up[x, y])]
        ways += [(x - 1, y, maze.right[x - 1, y])] if x else []
        ways += [(x, y - 1, maze.up[x, y - 1])] if y else []
        for i, j, wall in ways:
            if not wall and (i, j) not in found:
                found.add((i, j))
                new.append((i, j))
    return found


def test_every_cell_of_a_maze_is_reached_and_none_outside():
    random = np.random.default_rng(0)
    for _ in range(20):
        maze = draw_maze(random)
        width, height = maze.right.shape
        assert reached(maze) == {(x, y) for x in range(width) for y in range(height)}


def textures(tmp_path):
    """A WAD with two walls, one too low, and a floor."""
    entries = b"".join(
        name.ljust(8, b"\0") + bytes(4) + struct.pack("<hh", 64, height)
        for name, height in ((b"BRICK", 128), (b"STEP", 16), (b"WOOD", 128))
    )
    table = struct.pack("<4i", 3, 16, 32, 48) + entries
    lumps = [("TEXTURE1", table), ("F_START", b""), ("FLAT", bytes(4096)), ("F_END", b"")]
    body = b"".join(content for _, content in lumps)
    folder, start = b"", 12
    for name, content in lumps:
        folder += struct.pack("<ii8s", start, len(content), name.encode())
        start += len(content)
    file = tmp_path / "textures.wad"
    file.write_bytes(struct.pack("<4sii", b"IWAD", len(lumps), start) + body + folder)
    return file


def test_a_wad_has_each_maze_as_a_map_with_walls_of_the_given_textures(tmp_path):
    random = np.random.default_rng(1)
    plans = [draw_maze(random) for _ in range(2)]
    file = tmp_path / "mazes.wad"
    write_mazes(file, plans, textures(tmp_path), random)
    lumps = read_lumps(file)
    assert [name for name, _ in lumps] == ["MAP01", "TEXTMAP", "ENDMAP", "MAP02", "TEXTMAP", "ENDMAP"]
    for plan, (_, text) in zip(plans, lumps[1::3], strict=True):
        text = text.decode()
        width, height = plan.right.shape
        inside = plan.right[:-1].sum() + plan.up[:, :-1].sum()
        assert text.count("linedef") == inside + 2 * (width + height)
        assert f"x = {width * CELL}; y = {height * CELL};" in text
        assert text.count('texturemiddle = "BRICK"') == 2 * inside + 2 * (width + height)  # STEP is low, WOOD left out
