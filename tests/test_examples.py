"""The examples: what they decide, without the robot."""

import importlib.util
import re
import runpy
import sys
from collections import deque
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from commands import ROOT
from rooms import grid_scene
from tours import grid_truth, tour_of

from dirl.agent.cameras import Decision, Scores
from dirl.cli.parsing import parse
from dirl.models import FeatureTable
from dirl.perception.backbones.patches import coarse
from dirl.scenes import make_world


@pytest.fixture(scope="module")
def ros2():
    """The module of the node; importing it needs no ROS 2."""
    spec = importlib.util.spec_from_file_location("ros2_navigator", ROOT / "examples" / "ros2_navigator.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


class Robot:
    """A fake transport: integrates the velocities that it is sent, and takes images that show where it is."""

    def __init__(self):
        self.now, self.x, self.y, self.angle, self.velocity = 100.0, 0.0, 0.0, 0.0, (0.0, 0.0)
        self.sent = []

    def drive(self, linear, angular):
        self.velocity = (linear, angular)
        self.sent.append((self.now, linear, angular))

    def wait(self, seconds):
        linear, angular = self.velocity
        self.x += linear * np.cos(self.angle) * seconds
        self.y += linear * np.sin(self.angle) * seconds
        self.angle += angular * seconds
        self.now += seconds

    def image(self, quarter=0):
        return np.full((4, 6, 3), round(np.degrees(-self.angle) + 90 * quarter) % 360 // 2, np.uint8)


class Scripted:
    """A navigator that does what it is told, and remembers what it saw."""

    def __init__(self, actions):
        self.actions, self.seen = deque(actions), []

    def act(self, images):
        self.seen.append(images[:, 0, 0, 0].tolist())
        stop = not self.actions
        return Decision(0 if stop else self.actions.popleft(), stop, Scores(1.0, None))


def run(ros2, actions, seconds=60, panorama=False):
    robot, navigator = Robot(), Scripted(actions)
    pilot = ros2.Pilot(navigator, robot.drive)
    for _ in range(10 * seconds):
        if panorama:
            columns = (np.arange(64) * 360 / 64 - 180 - np.degrees(robot.angle)) % 360 / 2
            pilot.see_panorama(np.tile(columns[None, :, None], (32, 1, 3)).astype(np.uint8), robot.now, (8, 8), 60)
        else:
            for quarter, side in enumerate(ros2.SIDES):
                pilot.see(side, robot.image(quarter), robot.now)
        pilot.tick(robot.now)
        robot.wait(0.1)
    return robot, navigator, pilot


def test_it_drives_what_was_decided_and_stops_at_the_goal(ros2):
    robot, navigator, pilot = run(ros2, [0, 1, 0, 2, 3])
    assert pilot.arrived
    assert robot.velocity == (0.0, 0.0)
    assert (robot.x, robot.y) == (pytest.approx(0, abs=0.06), pytest.approx(-0.5, abs=0.06))
    assert robot.angle == pytest.approx(0, abs=0.06)
    assert len(navigator.seen) == 6
    # Clockwise degrees, halved: after the right turn all views have moved on by one.
    assert np.abs(np.array(navigator.seen[0]) - [0, 45, 90, 135]).max() <= 1
    assert np.abs(np.array(navigator.seen[2]) - [45, 90, 135, 0]).max() <= 3


def test_it_only_looks_where_it_stands(ros2):
    robot, navigator = Robot(), Scripted([0, 0])
    pilot = ros2.Pilot(navigator, robot.drive)

    def tick(*sides, after=0.0):
        """Wait, see these sides, decide; how often it has looked, and whether it drives."""
        robot.wait(after)
        for side in sides:
            pilot.see(side, robot.image(), robot.now)
        pilot.tick(robot.now)
        return len(navigator.seen), robot.velocity != (0.0, 0.0)

    assert tick(*ros2.SIDES[:3]) == (0, False)  # three views are not enough
    assert tick("left") == (1, True)
    assert tick(*ros2.SIDES, after=2.4) == (1, True)  # still on its way
    assert tick(after=0.2) == (1, False)
    assert tick(*ros2.SIDES) == (1, False)  # too soon: the robot may still shake
    assert tick(*ros2.SIDES, after=0.4)[0] == 2


def test_a_panoramic_camera_gives_the_four_views(ros2):
    _, navigator, pilot = run(ros2, [1], panorama=True)
    assert pilot.arrived
    assert np.abs(np.array(navigator.seen[0][1:]) - [30, 75, 120]).max() <= 3  # the left edges of the views


def test_messages_of_cameras_become_pixels(ros2):
    rgb = np.arange(2 * 3 * 3, dtype=np.uint8).reshape(2, 3, 3)
    padded = np.concatenate([rgb.reshape(2, 9), np.zeros((2, 3), np.uint8)], 1).tobytes()
    message = SimpleNamespace(encoding="rgb8", height=2, width=3, step=12, data=padded)
    assert (ros2.pixels(message) == rgb).all()
    message.encoding = "bgr8"
    assert (ros2.pixels(message) == rgb[..., ::-1]).all()
    message.encoding = "mono8"
    with pytest.raises(ValueError, match="encoding is mono8"):
        ros2.pixels(message)


WITH_OPTIONS = [file for file in sorted((ROOT / "examples").glob("*.py")) if "class Options" in file.read_text()]


@pytest.mark.parametrize("file", WITH_OPTIONS, ids=lambda file: file.stem)
def test_an_example_tells_its_options(file, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", [file.stem, "--help"])
    with pytest.raises(SystemExit) as ended:
        runpy.run_path(str(file), run_name="__main__")
    assert not ended.value.code
    assert "== Options: name=value ==" in capsys.readouterr().out


def test_pairs_to_train_a_locator_with_say_where_goals_lie(monkeypatch):
    """In a mirror what was to the right is to the left, and a mirror of a mirror shows what there was."""
    monkeypatch.syspath_prepend(ROOT / "examples")
    from train_locator import NEAR, Pairs, read

    torch.manual_seed(0)
    world = make_world([grid_scene(5, 4, patches="fine")])
    visit, goal, right, ahead = Pairs(world).sample(64)
    for state, wanted, aside, along in zip(visit[:, 0], goal[:, 0], right, ahead, strict=True):
        for action, moves in ((0, along), (3, -along)):
            for _ in range(int(moves.round().clamp(min=0))):
                state = world.graph[state, action]
        side = world.graph[state, 1 if aside > 0 else 2]
        for _ in range(int(aside.abs().round())):
            side = world.graph[side, 0]
        assert (world.surrounding[wanted] == side).any()  # the place; the heading is another
    moves, three, one = right.abs() + ahead.abs(), int(64 * NEAR[3]), int(64 * NEAR[1])
    assert moves[:three].max() < 3.5
    assert moves[three : three + one].max() < 1.5
    table = FeatureTable(world.features, patches=coarse(world.patches))
    seen, mirrored = read(world, table, visit, False), read(world, table, visit, True)
    assert not torch.equal(seen[1], mirrored[1])
    torch.testing.assert_close(mirrored[0].norm(), seen[0].norm())
    torch.testing.assert_close(mirrored[1][:, 1].unflatten(1, (6, 8)).flip(2).flatten(1, 2), seen[1][:, 3])


def test_another_camera_sees_the_same_room(monkeypatch):
    """Without a change the view is the same; in the middle of a camera that is tilted up lies what was higher."""
    monkeypatch.syspath_prepend(ROOT / "examples")
    from other_cameras import FIELD_OF_VIEW, covered, seen_through

    view = np.tile(np.arange(0, 240, 4, dtype=np.uint8)[:, None, None], (1, 80, 3))
    assert (seen_through(view) == view).all()
    focal = 40 / np.tan(np.radians(FIELD_OF_VIEW / 2))
    tilted = seen_through(view, tilt=np.degrees(np.arctan(5 / focal)))
    assert abs(int(tilted[30, 40, 0]) - int(view[25, 40, 0])) <= 4
    assert int(seen_through(view, zoom=2.0)[40, 40, 0]) == pytest.approx(int(view[35, 40, 0]), abs=4)
    for seed in range(20):
        hidden = (covered(view, np.random.default_rng(seed)) != view).any(-1).mean()
        assert hidden == pytest.approx(0.2, abs=0.02)


class Walker:
    """A navigator that looks around, then goes ahead where it can, and stops where it sees its goal's views again."""

    turns, points = 8, True

    def __init__(self):
        self.encoder = str

    def reset(self, goal, field_of_view):
        assert field_of_view is None
        self.goal, self.turned = goal, 0

    def act(self, views, possible):
        ahead = self.turned >= self.turns and possible[0, 0]
        self.turned = 0 if ahead else self.turned + 1
        return SimpleNamespace(stop=abs(views[::2].astype(int) - self.goal).mean() < 20, action=0 if ahead else 1)


@pytest.mark.parametrize("changes", ["none", "hard"])
def test_walks_in_a_tour_are_measured_beside_their_controls(changes, monkeypatch, capsys):
    """Three places in a row, of three colours: what goes ahead and turns comes by all of them."""
    monkeypatch.syspath_prepend(ROOT / "examples")
    import tour_walks

    colours = np.random.default_rng(3).integers(60, 200, (3, 64, 128, 3)).astype(np.uint8)
    pictures = iter([colour] for _ in range(2) for colour in colours)
    monkeypatch.setattr(tour_walks, "VIEW", ((12, 16), 75.0))
    monkeypatch.setattr(tour_walks, "read_tour", lambda path: replace(tour_of(grid_truth(3, 1)), name=path))
    monkeypatch.setattr(tour_walks, "read_panorama", lambda *_: next(pictures))
    monkeypatch.setattr(tour_walks.dirl.Navigator, "load", lambda *_, **__: Walker())
    monkeypatch.setattr(
        tour_walks,
        "CHANGES",
        {"none": None, "hard": tour_walks.Changes(people=0.2, width=0.2, heading=0.5, light=0.01)},
    )
    words = [
        "path=[row,line]",
        "goal=views",
        f"changes={changes}",
        "walks_by=[agent,another_goal,random]",
        "episodes=12",
    ]
    tour_walks.main(parse(tour_walks.Options, words))
    rows = dict(re.findall(r"\| (\w+, \w+) +\| (\d\.\d+) ", capsys.readouterr().out))
    assert rows["row, agent"] == rows["line, agent"] == "1.000"
    assert float(rows["row, another_goal"]) < 0.5
    assert rows["row, random"] != "0.000"
