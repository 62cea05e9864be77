"""Which moments of a training are due, and when it is done."""

from dirl.config.schemas import TrainConfig, Until
from dirl.evaluation.stability import EpisodeMeter


def due(before: int, now: int, total: int, times: int) -> bool:
    """Whether one of ``times`` moments, evenly spread over ``total`` frames, lies between two counts of frames."""
    return before * times // total < now * times // total


def is_done(config: TrainConfig, meter: EpisodeMeter, frames: int, total: int) -> bool:
    """Whether a training is over: all frames are done, or every goal is stable and has been evaluated since.

    Args:
        config: of the run; the latter counts with ``reinforcement.until=stable`` only.
        meter: of its episodes.
        frames: walked so far.
        total: to be walked at most.
    """
    stable = meter.stable_at if config.reinforcement.until == Until.stable else None
    return frames >= total or (stable is not None and due(stable, frames, total, config.evaluation.times))
