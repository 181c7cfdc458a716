# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Where on its motion a robot is, by what was measured of it in the last moments.

A robot under speed scaling, or one that is held, lags on its path: then its place on the path says
where it is commanded to be, and the clock does not. Place and rate are estimated together, by least
squares from the measured positions of a short window and what was known before; that prior alone
counts where the motion is slow.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..arrays import FloatArray
from .commanded import CommandedMotion

# Standard deviations of measured positions [rad or m], and of what was known before: the place
# [s], the rate, its change [1/s], and how that changes [1/s²].
_POSITION_NOISE = 0.002
_PRIOR = np.array([1.0, 0.3, 2.0, 40.0])
_ITERATIONS = 6
# Longest step of an iteration [s], cost of a sample up to which a fit is good, and the places that
# are searched where the prior misleads.
_LONGEST_STEP, _GOOD, _N_SEARCHED = 0.2, 1.0, 100
_HIGHEST_RATE = 1.2
# The newest samples, and how far in their mean they are from a good fit [rad or m].
_N_NEWEST, _GOOD_ERROR = 5, 3e-5


@dataclass(frozen=True)
class Progress:
    """Where on a motion a robot is.

    Attributes
    ----------
    time : float
        When that was [s].
    place : float
        How far on the motion it was [s].
    rate : float
        How fast the place advances: 1 for a robot that runs on time, 0 for one that is held.
    change : float
        How fast the rate changes [1/s].
    error : float
        How far the newest samples are from there in their mean [rad or m].
    """

    time: float
    place: float
    rate: float = 1.0
    change: float = 0.0
    error: float = 0.0

    def at(self, time: float) -> float:
        """The place at another time [s]."""
        since = time - self.time
        if self.change < 0.0:
            # A robot that is slowed down stops, and does not turn back.
            since = min(since, -self.rate / self.change)
        return self.place + self.rate * since + 0.5 * self.change * since**2


def locate(
    motion: CommandedMotion,
    times: FloatArray,
    positions: FloatArray,
    prior: Progress,
    now: float,
) -> Progress:
    """Estimate where on a motion a robot is.

    Parameters
    ----------
    motion : CommandedMotion
        The motion.
    times : array, shape (n_samples,)
        When the robot was measured [s].
    positions : array, shape (n_samples, n_joints)
        Where it was measured, less what its load pulls it away [rad or m].
    prior : Progress
        What was known before.
    now : float
        The time that the progress is stated for [s].
    """
    known = Progress(now, prior.at(now), prior.rate)
    if not len(times):
        return known
    cost, found = _fit(motion, times, positions, known, known)
    if cost <= _GOOD * len(times):
        return _refined(motion, times, positions, known, found)
    searched = np.linspace(0.0, motion.duration, _N_SEARCHED)
    away = motion.sample(searched)[0] - positions[-1]
    nearest = float(searched[np.square(away).sum(axis=1).argmin()])
    other_cost, other = _fit(motion, times, positions, known, Progress(now, nearest, known.rate))
    best = other if other_cost < cost else found
    return _refined(motion, times, positions, known, best)


def _refined(
    motion: CommandedMotion,
    times: FloatArray,
    positions: FloatArray,
    prior: Progress,
    found: Progress,
) -> Progress:
    """The better of a fit and one of the last moments alone, where the rate changes fast."""
    newest = slice(-(len(times) // 2), None)
    if found.error <= _GOOD_ERROR or len(times) < 4 * _N_NEWEST:
        return found
    _, other = _fit(motion, times[newest], positions[newest], prior, found)
    # So few samples say little of how the rate changes.
    return replace(other, change=found.change) if other.error < found.error else found


def _fit(
    motion: CommandedMotion,
    times: FloatArray,
    positions: FloatArray,
    prior: Progress,
    start: Progress,
) -> tuple[float, Progress]:
    """Gauss-Newton steps for the place, the rate and its change; the cost and the progress."""
    since = times - prior.time
    powers = np.stack([np.ones_like(since), since, since**2 / 2.0, since**3 / 6.0])
    precision = _PRIOR**-2.0
    known, x = (np.array([one.place, one.rate, 0.0, 0.0]) for one in (prior, start))
    best = float("inf"), start
    for _ in range(_ITERATIONS):
        q, v, _ = motion.sample(x @ powers)
        error = (positions - q) / _POSITION_NOISE
        cost = float(np.square(error).sum() + precision @ (x - known) ** 2)
        if cost < best[0]:
            place, rate, change = (float(value) for value in x[:3])
            best = cost, Progress(prior.time, place, rate, change, _error(positions - q))
        slopes = (powers[:, :, None] * v).reshape(len(x), -1) / _POSITION_NOISE
        gradient = slopes @ error.ravel() + precision * (known - x)
        step = np.linalg.solve(slopes @ slopes.T + np.diag(precision), gradient)
        x = x + step * min(1.0, _LONGEST_STEP / max(abs(step[0]), 1e-9))
        x[:2] = np.clip(x[:2], 0.0, [np.inf, _HIGHEST_RATE])
    return best


def _error(away: FloatArray) -> float:
    """How far the newest samples are away in their mean [rad or m]."""
    return float(np.abs(away[-_N_NEWEST:].mean(axis=0)).max())
