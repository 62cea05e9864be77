import json
import math

import pytest
from policies import RIGHT, always, run_episodes

from dirl.envs import SurroundingViews
from dirl.evaluation.episodes import every_start
from dirl.evaluation.protocol import WINDOW, EpisodeMeter, report


def test_a_report_covers_each_scene_and_each_goal_by_its_number_in_the_scene(world):
    episodes = run_episodes(always(RIGHT), world, every_start(world), observation=SurroundingViews(world), max_steps=10)
    summary = report(episodes, world)
    goals = {name: list(scene["goals"]) for name, scene in summary["scenes"].items()}
    assert goals == {"room": ["0", "13"], "corner": ["6"], "split": ["1"]}
    # Three starts each are at the goal's own place.
    assert summary["scenes"]["room"]["sr"] == pytest.approx(6 / 46)
    assert summary["scenes"]["room"]["goals"]["13"]["sr"] == pytest.approx(3 / 23)
    assert summary["scenes"]["corner"]["goals"]["6"]["sr"] == pytest.approx(3 / 11)
    assert summary["scenes"]["split"]["sr"] == 1
    json.dumps(summary)


def episodes(meter, goal, steps, count, frames=0):
    meter.add([goal] * count, [steps] * count, frames)


def test_atl_is_averaged_over_goals_and_forgets_old_episodes():
    meter = EpisodeMeter(3)
    assert math.isnan(meter.measures(31)["atl"])
    episodes(meter, 0, 50, 10)
    episodes(meter, 0, 10, WINDOW)
    episodes(meter, 1, 30, 1)
    assert meter.measures(31) == {"atl": 20.0, "atl_worst_goal": 30.0, "episodes": WINDOW + 11, "sr": 1.0}
    assert (meter.measures(30)["sr"], meter.measures(10)["sr"]) == (0.5, 0.0)


def test_stable_needs_enough_short_episodes_of_every_goal_and_is_lost_again():
    meter = EpisodeMeter(2)
    episodes(meter, 0, 20, WINDOW, frames=1)
    episodes(meter, 1, 20, WINDOW - 1, frames=2)
    assert meter.stable_at is None
    episodes(meter, 1, 20, 1, frames=3)
    assert meter.stable_at == 3
    episodes(meter, 0, 5, 1, frames=4)
    assert meter.stable_at == 3
    episodes(meter, 1, 200, 1, frames=5)
    assert meter.stable_at is None
    episodes(meter, 1, 20, WINDOW, frames=6)
    assert meter.stable_at == 6
