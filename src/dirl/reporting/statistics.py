"""Statistics over several seeds (Agarwal et al. 2021): interquartile means and bootstrap intervals."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

RESAMPLES = 2000

FloatArray = NDArray[np.float64]


def iqm(values: ArrayLike) -> FloatArray:
    """Return the mean of the middle half, without the lowest and highest quarter (each rounded down), float ``[...]``.

    Values are float ``[R, ...]``, of R runs, at least one; infinity counts as the highest value.
    """
    runs = np.sort(np.asarray(values, float), axis=0)
    if len(runs) == 0:
        raise ValueError("the mean of no runs is not defined")
    cut = len(runs) // 4
    return runs[cut : len(runs) - cut].mean(0)


def bootstrap_interval(values: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return the 95 % percentile bootstrap interval of the interquartile mean, by resampling the runs.

    Lower and upper limit, float ``[...]`` each, of values as for `iqm`; of one run both are the value itself.
    """
    runs = np.asarray(values, float)
    drawn = np.random.default_rng(0).integers(len(runs), size=(len(runs), RESAMPLES))
    # Nearest ranks: nothing is interpolated between a number and infinity.
    low, high = np.percentile(iqm(runs[drawn]), [2.5, 97.5], axis=0, method="nearest")
    return low, high


def mean_interval(means: FloatArray, counts: FloatArray) -> tuple[float, float]:
    """Return the 95 % percentile bootstrap interval of the mean of all values, by resampling groups of them.

    Lower and upper limit, of the means of R groups and how many values each has, float ``[R]``.
    """
    drawn = np.random.default_rng(0).integers(len(means), size=(RESAMPLES, len(means)))
    low, high = np.percentile((means * counts)[drawn].sum(1) / counts[drawn].sum(1), [2.5, 97.5])
    return float(low), float(high)


def summarised(values: Sequence[float], form: str) -> str:
    """Return the interquartile mean and its 95 % bootstrap interval as text, "13.51 [13.20, 14.02]".

    Infinity is "never". An interval whose ends round to the mean is left out; one contains no line break.
    """

    def text(number: float) -> str:
        return "never" if np.isinf(number) else format(number, form)

    if len(values) == 0 or np.isnan(values).any():
        return "-"
    middle = text(float(iqm(values)))
    low, high = (text(float(limit)) for limit in bootstrap_interval(values))
    return middle if low == middle == high else f"{middle} [{low},\N{NO-BREAK SPACE}{high}]"
