"""The protocol of SPTM (Savinov et al., ICLR 2018, arXiv 1803.00653): from a human's walkthrough of a maze to goals.

    python examples/sptm.py folder=SPTM                     # a clone of github nsavinov/SPTM (MIT)
    python examples/sptm.py folder=SPTM validation=true     # the three mazes that settings were chosen in

Mazes, walkthroughs and recordings of goals are those of the clone's folder ``data``. The result is a folder: README.md
with a table, and a CSV file.
"""

import json
import os
import shutil
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from dirl.agent.mapping.frames import FrameMap, find_links, map_recordings
from dirl.agent.mapping.guide import Guidance, Guide
from dirl.cli.start import run, start
from dirl.config.schemas import ConfigError, Positive, option
from dirl.experiments.results import Table, write_tables
from dirl.perception.columns import load_column_net
from dirl.scenes.io.files import read_text, write_json
from dirl.scenes.io.processes import end_with_this_process, in_processes
from dirl.scenes.live import simulator_errors
from dirl.scenes.scene import SceneError

GOALS = ("tall_red_pillar", "candelabra", "tall_blue_torch", "short_green_pillar")
STARTS = ("map02", "map03", "map04", "map05")

REACH = 63
"""Units of the map: so near is at the goal."""

STEPS, REPEAT = 5000, 4
"""Steps of the simulator in an episode, and for each action."""

SKIP = 4
"""Every so many frames of the walkthrough one is kept."""

WAIT = 140
"""Steps before the first episode of a game, as in SPTM's code."""

AHEAD, BACK, LEFT, RIGHT, IDLE, TURN_LEFT, TURN_RIGHT = range(7)
BUTTONS = ("MOVE_FORWARD", "MOVE_BACKWARD", "MOVE_LEFT", "MOVE_RIGHT", None, "TURN_LEFT", "TURN_RIGHT")
"""Doom's button for each action."""

SECOND = 35.0
"""Steps of the simulator."""

CIRCLE = 15
"""Turns before one gives up looking around."""

SAME_VIEW = 1.5
"""Mean difference of grey values between frames, when a move was stopped by a wall."""

MEMORY, BLIND, RANDOM = "memory of the walkthrough", "the memory, to a random frame", "random walk"


@dataclass
class Options:
    """The protocol of SPTM: from a human's walkthrough of a maze to goals."""

    folder: str = option("what github.com/nsavinov/SPTM was cloned to")
    trials: Positive = option("of each start and goal", 6)
    validation: bool = option("its three validation mazes instead of the seven for tests", False)
    workers: Positive | None = option("processes; null = all cores", None)
    out: str = option("a folder for the result; what is finished there is not walked again", "reports/sptm")


Walker = Callable[[NDArray[np.uint8]], int]


class Maze(NamedTuple):
    """A maze of SPTM: where its files are, and where its goals stand."""

    folder: str
    goals: tuple[tuple[float, float], ...]

    @property
    def name(self) -> str:
        """The name of its files."""
        return self.folder.rpartition("/")[2]


TESTS = (
    Maze("Test/deepmind_small", ((-64, -192), (64, 64), (320, -64), (192, 64))),
    Maze("Test/open_space_five", ((1728, 896), (832, 1728), (832, 128), (1728, 1152))),
    Maze("Test/star_maze", ((-448, -992), (-704, -320), (736, -320), (544, 768))),
    Maze("Test/office1", ((320, 192), (192, 192), (960, -64), (832, -576))),
    Maze("Test/columns", ((-672, -480), (-224, 352), (256, 320), (768, -448))),
    Maze("Test/office2", ((-384, -256), (0, 0), (352, -480), (768, 32))),
    Maze("Test/topological_star_easier", ((-832, -384), (-704, -128), (960, -384), (960, 128))),
)
VALIDATION = (
    Maze("Val/open_space_two", ((1728, 1600), (1728, 128), (128, 1728), (128, 128))),
    Maze("Val/branching", ((192, -448), (64, 320), (320, -64), (448, -320))),
    Maze("Val/deepmind_large", ((576, -320), (1088, -576), (320, -192), (704, -832))),
)


class Game:
    """A maze of SPTM's folder ``data`` in VizDoom, with SPTM's settings.

    Raises:
        SceneError: there is no such maze, or VizDoom is not installed or does not start.
    """

    def __init__(self, data: Path, maze: Maze, seed: int = 0) -> None:
        try:
            import vizdoom
        except ImportError as error:
            raise SceneError(f"VizDoom is not installed ({error}): pip install 'dirl[vizdoom]'") from None
        self.files, self.maze = data / maze.folder, maze
        wad = check_files(data, maze)
        # VizDoom replays recordings of short paths only.
        self._folder = tempfile.TemporaryDirectory(prefix="dirl")
        copied = Path(self._folder.name) / "m.wad"
        shutil.copy(wad, copied)
        game: Any = vizdoom.DoomGame()
        self._game = game
        with simulator_errors("VizDoom"):
            game.load_config(str(data / "default.cfg"))
            game.set_doom_config_path(str(Path(self._folder.name) / "settings.ini"))
            game.set_doom_game_path(str(Path(vizdoom.__file__).parent / "freedoom2.wad"))
            game.set_doom_scenario_path(str(copied))
            game.set_window_visible(False)
            game.set_screen_format(vizdoom.ScreenFormat.RGB24)
            game.set_seed(seed)
            end_with_this_process(self, game)
            game.init()
            self._buttons = [button.name for button in game.get_available_buttons()]
            self.act(IDLE, WAIT)

    def replay(self, name: str) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
        """Return the frames of a recording, ``[T, 120, 160, 3]``, and the positions, ``[T, 2]``."""
        copied = Path(self._folder.name) / "m.lmp"
        shutil.copy(self.files / f"{name}.lmp", copied)
        frames, places = [], []
        with simulator_errors("VizDoom"):
            self._game.replay_episode(str(copied))
            while not self._game.is_episode_finished():
                state = self._game.get_state()
                frames.append(state.screen_buffer.copy())
                places.append(state.game_variables[:2].copy())
                self._game.advance_action()
        return np.stack(frames), np.stack(places)

    def start(self, name: str) -> None:
        """Begin an episode at one of `STARTS`."""
        with simulator_errors("VizDoom"):
            self._game.set_doom_map(name)
            self._game.new_episode()

    def act(self, action: int, steps: int = REPEAT) -> None:
        """Do something for some steps."""
        with simulator_errors("VizDoom"):
            self._game.make_action([int(name == BUTTONS[action]) for name in self._buttons], steps)

    def see(self) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
        """Return the present frame and position."""
        with simulator_errors("VizDoom"):
            state = self._game.get_state()
            return state.screen_buffer.copy(), state.game_variables[:2].copy()

    def close(self) -> None:
        """End the game."""
        self._game.close()
        self._folder.cleanup()


def check_files(data: Path, maze: Maze) -> Path:
    """Return where the maps of a maze are; raise `SceneError` if they, or the settings, are not there."""
    wad = data / maze.folder / f"{maze.name}.wad_manymaps_test.wad"
    for file in (wad, data / "default.cfg"):
        if not file.is_file():
            raise SceneError(f"folder={data.parent}: is no copy of github nsavinov/SPTM ({file} is missing)")
    return wad


def walk(game: Game, start: str, goal: tuple[float, float], walker: Walker) -> tuple[bool, int]:
    """Walk an episode; return whether the goal was reached, and after how many steps of the simulator."""
    game.start(start)
    for steps in range(0, STEPS + 1, REPEAT):
        frame, place = game.see()
        if np.hypot(*(place - goal)) <= REACH:
            return True, steps
        if steps + REPEAT <= STEPS:
            game.act(walker(frame))
    return False, STEPS


def random_walker(seed: int) -> Walker:
    """Make a walker that takes one of the actions at random, as SPTM's control."""
    draw = np.random.default_rng(seed)
    return lambda frame: int(draw.integers(len(BUTTONS)))


class Player:
    """Presses the buttons of Doom as a guide says, and moves aside where it does not get on.

    Args:
        guide: to a photo.
        seed: of what it does when it is stuck.
    """

    def __init__(self, guide: Guide, seed: int = 0) -> None:
        self.guide = guide
        self._random = np.random.default_rng(seed)
        self._last = IDLE
        self._seen: NDArray[np.int64] | None = None
        self._moves: list[int] = []
        self._stopped = 0
        self._lost = 0

    def act(self, frame: NDArray[np.uint8]) -> int:
        """Return what to do next, one of `BUTTONS`, where a frame is seen, RGB, uint8 ``[H, W, 3]``."""
        self._notice_walls(frame)
        if self._moves:
            self.guide.localise(frame)
            action = self._moves.pop()
        else:
            action = self._obey(self.guide.see(frame))
        if {action, self._last} == {TURN_LEFT, TURN_RIGHT} and self._random.random() < 0.5:
            action = AHEAD  # else it would turn to and fro
        self._last = action
        return action

    def _obey(self, advice: Guidance) -> int:
        """Return the button for an advice; look around where the guide is lost."""
        self._lost = self._lost + 1 if advice.say == "lost" else 0
        if advice.say == "stuck" or (self._lost and self._lost % CIRCLE == 0):
            return self._wander()
        if advice.say == "lost":
            return TURN_RIGHT
        # A turn that follows a turn is one of 28 degrees, any other one of 7.
        if abs(advice.turn) > (18 if self._last in (TURN_LEFT, TURN_RIGHT) else 10):
            return TURN_LEFT if advice.turn > 0 else TURN_RIGHT
        if abs(advice.right) > 25 and abs(advice.right) > 0.8 * abs(advice.ahead):
            return RIGHT if advice.right > 0 else LEFT
        back = advice.backwards or advice.ahead < -40
        return BACK if back and not advice.to_photo else AHEAD  # what shows the goal is walked past

    def _notice_walls(self, frame: NDArray[np.uint8]) -> None:
        """Step aside where the view stayed the same."""
        small = frame[::2, ::2].astype(int)
        same = self._seen is not None and bool(np.abs(small - self._seen).mean() < SAME_VIEW)
        self._seen = small
        self._stopped = self._stopped + (self._last < IDLE) if same else 0
        if self._stopped >= 2:
            self._stopped = 0
            self._moves = [int(self._random.choice([LEFT, RIGHT, BACK]))] * int(self._random.integers(1, 4))

    def _wander(self) -> int:
        """Go some steps at random."""
        self._lost = 0
        self.guide.forget()
        side = int(self._random.choice([TURN_LEFT, TURN_RIGHT]))
        self._moves = [AHEAD] * int(self._random.integers(2, 8)) + [side] * int(self._random.integers(1, 6))
        return BACK


def map_walkthrough(frames: NDArray[np.uint8]) -> FrameMap:
    """Return the map of a player's frames, RGB, uint8 ``[N, H, W, 3]``, recorded at every step of the simulator."""
    net = load_column_net()
    recording = [(frame, step / SECOND, None) for step, frame in enumerate(frames)][::SKIP]
    return find_links(map_recordings([recording], net, 90.0, len(recording)), net)


def walk_maze(data: Path, maze: Maze, name: str, trials: int) -> list[tuple[bool, int]]:
    """Walk so many trials from every start to every goal of a maze; return success and steps of each.

    ``data`` is SPTM's folder of this name; ``name`` says what walks: `MEMORY`, `BLIND` or `RANDOM`.
    """
    graph, net = None, load_column_net()
    if name != RANDOM:
        recordings = Game(data, maze)
        frames, _ = recordings.replay(maze.name)
        photos = [recordings.replay(f"{maze.name}_{goal}")[0][-1] for goal in GOALS]
        recordings.close()
        graph = map_walkthrough(frames)
    game, episodes = Game(data, maze), []
    for trial, begin, goal in product(range(trials), STARTS, range(len(GOALS))):
        seed = 1000 * trial + 10 * STARTS.index(begin) + goal
        if graph is None:
            walker = random_walker(seed)
        else:
            anywhere = frames[::SKIP][np.random.default_rng(seed).integers(len(graph))]
            walker = Player(Guide(graph, [photos[goal] if name == MEMORY else anywhere], net), seed).act
        episodes.append(walk(game, begin, maze.goals[goal], walker))
    game.close()
    return episodes


def kept(file: Path, measure: Callable[[], list[tuple[bool, int]]]) -> list[tuple[bool, int]]:
    """Return what a JSON file holds; if there is none yet, it is measured and written."""
    if not file.exists():
        episodes = measure()
        file.parent.mkdir(parents=True, exist_ok=True)
        write_json(file, episodes)
    return json.loads(read_text(file))


def report_sptm(folder: Path, trials: int, out: Path, *, validation: bool = False, workers: int | None = None) -> str:
    """Write the share of reached goals in SPTM's mazes, beside walks that are blind to the goal.

    ``folder`` is a clone of github nsavinov/SPTM; ``trials`` are of each start and goal, six in the paper. With
    ``validation`` the mazes are those that settings were chosen in, instead of those for tests. Each of the workers, as
    many as cores if left out, has a maze and what walks there. What is finished in ``out`` is not walked again.

    Raises:
        SceneError: the folder is no such clone, VizDoom is not installed or fails, or a process was killed.
    """
    mazes, data = VALIDATION if validation else TESTS, folder / "data"
    for maze in mazes:
        check_files(data, maze)
    walks = [(maze, name) for name in (MEMORY, BLIND, RANDOM) for maze in mazes]
    tasks = []
    for maze, name in walks:
        file = out / "episodes" / f"{maze.name}_{name.replace(', ', '_').replace(' ', '_')}_{trials}.json"
        tasks.append(partial(kept, file, partial(walk_maze, data, maze, name, trials)))
    walking = in_processes(tasks, workers or os.cpu_count() or 1, f"{out}: a process that walked in a maze")
    for _ in tqdm(walking, total=len(tasks), unit=" walks", disable=None):
        pass
    walked = [read() for read in tasks]  # all are kept by now
    table = Table({"maze": "", "walks by": "", "reached": ".2f", "steps, median": ".0f", "episodes": "d"})
    for (maze, name), episodes in zip(walks, walked, strict=True):
        table.add(maze.name, name, *_measures(episodes))
    for name in (MEMORY, BLIND, RANDOM):
        every = [episode for (_, by), episodes in zip(walks, walked, strict=True) if by == name for episode in episodes]
        table.add("all", name, *_measures(every))
    text = (
        f"{len(mazes)} mazes, {len(STARTS)} starts, {len(GOALS)} goals, {trials} of 6 trials. An episode ends "
        f"within {REACH} units of the goal, or after {STEPS:,} steps of the simulator without success; an action takes "
        f"{REPEAT} steps. The memory is the human's walkthrough, its frames alone. Protocol and mazes: Savinov, "
        "Dosovitskiy and Koltun, Semi-parametric topological memory for navigation, ICLR 2018 (arXiv 1803.00653)."
    )
    return write_tables(out, "The protocol of SPTM", text, {"sptm": table}, {})


def _measures(episodes: list[tuple[bool, int]]) -> tuple[float, float | None, int]:
    steps = [count for reached, count in episodes if reached]
    return len(steps) / len(episodes), float(np.median(steps)) if steps else None, len(episodes)


def main(options: Options) -> None:
    """Walk, and print the table."""
    folder = Path(options.folder)
    if not (folder / "data").is_dir():
        raise ConfigError(f"folder={options.folder}: name a folder that github.com/nsavinov/SPTM was cloned to")
    out = Path(options.out)
    print(report_sptm(folder, options.trials, out, validation=options.validation, workers=options.workers))
    print(f"report: {out}")


if __name__ == "__main__":
    options = start(__doc__, Options)
    run(lambda: main(options))
