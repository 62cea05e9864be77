"""When a policy counts as stable, by the episodes of its training."""

import math

from dirl.evaluation.protocol import WINDOW, EpisodeMeter


def episodes(meter, goal, steps, count, frames=0):
    meter.add([goal] * count, [steps] * count, frames)


def test_atl_is_averaged_over_goals_and_forgets_old_episodes():
    meter = EpisodeMeter([6, 6, 6])
    assert math.isnan(meter.atl)
    episodes(meter, 0, 50, 10)
    episodes(meter, 0, 10, WINDOW)
    episodes(meter, 1, 30, 1)
    assert (meter.atl, meter.worst_atl, meter.episodes) == (20.0, 30.0, WINDOW + 11)
    assert (meter.success_rate(31), meter.success_rate(30), meter.success_rate(10)) == (1.0, 0.5, 0.0)


def test_stable_needs_enough_short_episodes_of_every_goal_and_is_lost_again():
    meter = EpisodeMeter([6, 6])
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
