"""Speed and memory as numbers of agents, scenes and goals grow."""

import multiprocessing
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

from hydra import initialize_config_dir
from ours import CONF, peak_memory_mb, train_config, training
from tqdm import tqdm

from dirl.cli.command_line import register
from dirl.scenes import load_scenes, write_dump
from dirl.training.build import build_world

GROWTH = {
    "agents": [16, 64, 256, 1024, 4096],
    "scenes": [1, 4, 16, 64],
    "goals": [4, 32, 128, 512],
}


def growth(overrides: list[str]) -> list[dict[str, Any]]:
    """Speed and memory over numbers of agents, scenes (copies of one) and goals, each in a process of its own."""
    rows = []
    cases = [(what, number) for what, numbers in GROWTH.items() for number in numbers]
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=spawn, max_tasks_per_child=1) as pool:
        for what, number in tqdm(cases, desc="growth", disable=not sys.stderr.isatty()):
            rows.append(pool.submit(grown, what, number, overrides).result())
    return rows


def grown(what: str, number: int, overrides: list[str], updates: int = 12) -> dict[str, Any]:
    """One row of `growth`: the built-in rooms with so many agents, the bathroom so many times, the kitchen's goals."""
    register()
    with tempfile.TemporaryDirectory() as folder, initialize_config_dir(str(CONF), version_base="1.3"):
        agents, scenes = 80, 1
        if what == "agents":
            scenes, agents = 4, number // 4
            where = ["scene=all"]
        elif what == "scenes":
            scenes, agents = number, max(1, 320 // number)
            (scene,) = load_scenes("bathroom_02")
            copies = [Path(folder) / f"copy_{copy}.h5" for copy in range(number)]
            for copy in copies:
                write_dump(copy, replace(scene, name=copy.stem, views=None))
            where = [f"scene=[{','.join(map(str, copies))}]"]
        else:
            agents = 320
            where = ["scene=kitchen_02", f"goals=[{','.join(map(str, range(number)))}]"]
        frames = updates * agents * 5
        counts = [f"reinforcement.frames_per_scene={frames}", f"reinforcement.agents_per_scene={agents}"]
        config = train_config([*overrides, *where, *counts])
        rate = training(config)
        world = build_world(config)
    shape = {"agents": agents * scenes, "scenes": scenes, "states": len(world), "goals": len(world.goals)}
    return {**shape, "frames_per_second": rate, "peak_memory_mb": peak_memory_mb()}
