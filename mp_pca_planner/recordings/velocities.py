# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Check of recorded velocities, which are not used: wrong ones show a driver's defects."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..exceptions import quote_names
from .joint_states import NS_PER_S, IntArray, JointStates

# Mean velocities over this time are compared [s]; noise hides those over one period.
_VELOCITY_WINDOW = 0.1
# Number of windows; with fewer no verdict is given.
_VELOCITY_MAX_COMPARED = 20000
_VELOCITY_MIN_COMPARED = 20
# Joints are compared between these speeds [rad/s or m/s]: at rest there is only noise, and a
# faster joint has wrapped or jumped.
_VELOCITY_MIN_SPEED = 0.02
_VELOCITY_MAX_SPEED = 20.0
# A window longer than this share of the median window contains a gap.
_VELOCITY_MAX_STRETCH = 2.0
# Accepted relative error of the scale.
_VELOCITY_MAX_SCALE_ERROR = 0.2
# With a lower correlation the velocities do not follow the positions.
_VELOCITY_MIN_CORRELATION = 0.8


def velocity_notes(
    states: JointStates, names: Sequence[str], rows: IntArray, stamps: IntArray
) -> list[str]:
    """Notes on missing and wrong velocities of some joints, one sentence each.

    Parameters
    ----------
    states :
        The joint states.
    names :
        The joints. If no message lists them all, there are no notes.
    rows, stamps :
        The messages that are taken, and their stamps [ns].
    """
    if states.computed or not states.listing(names).any():
        return []
    columns = states.columns(names)
    none = "the messages hold no velocities: these follow from the positions, which is fine"
    if states.velocities is None:
        return [none]
    velocities = states.velocities[rows][:, columns]
    positions = states.positions[rows][:, columns]
    n_missing = int(np.count_nonzero(~np.isfinite(velocities).all(axis=1)))
    if n_missing == rows.size:
        return [none]
    notes = []
    if n_missing:
        notes.append(f"velocities are empty or NaN in {n_missing} of {rows.size} messages")
    latest = np.maximum.accumulate(stamps)
    ordered = np.append(True, stamps[1:] > latest[:-1]) & (stamps > 0)
    verdicts: dict[str, list[str]] = {}
    if np.count_nonzero(ordered) >= _VELOCITY_MIN_COMPARED:
        for name, *values in zip(names, positions[ordered].T, velocities[ordered].T, strict=True):
            verdict = _verdict(*_mean_velocities(stamps[ordered], *values))
            verdicts.setdefault(verdict, []).append(name)
    verdicts.pop("", None)
    return notes + [
        f"the velocities of {quote_names(several)} {verdict}: they are not used"
        for verdict, several in verdicts.items()
    ]


def _mean_velocities(
    stamps: IntArray, position: FloatArray, velocity: NDArray[np.float32]
) -> tuple[FloatArray, FloatArray]:
    """Mean velocities of a joint over short windows: by its positions, and as recorded."""
    width = max(1, round(_VELOCITY_WINDOW * NS_PER_S / float(np.median(np.diff(stamps)))))
    starts = np.arange(0, stamps.size - width, max(1, stamps.size // _VELOCITY_MAX_COMPARED))
    times = (stamps[starts + width] - stamps[starts]) / NS_PER_S
    true = (position[starts + width] - position[starts]) / times
    # Weights of the trapezoidal rule, so that a window of one period is compared rightly, too.
    recorded = np.zeros(starts.size)
    for offset in range(width + 1):
        recorded += (0.5 if offset in (0, width) else 1.0) * velocity[starts + offset]
    recorded /= width
    usable = times < _VELOCITY_MAX_STRETCH * np.median(times) if times.size else times > 0.0
    usable &= np.isfinite(recorded)
    usable &= (np.abs(true) > _VELOCITY_MIN_SPEED) & (np.abs(true) < _VELOCITY_MAX_SPEED)
    return true[usable], recorded[usable]


def _verdict(true: FloatArray, recorded: FloatArray) -> str:
    """The defect of the recorded velocities of a joint; '' if there is none."""
    if true.size < _VELOCITY_MIN_COMPARED:
        return ""
    if not recorded.any():
        return "are zero while the positions change"
    product, true_square, recorded_square = true @ recorded, true @ true, recorded @ recorded
    scale = product / true_square
    if abs(product) < _VELOCITY_MIN_CORRELATION * np.sqrt(true_square * recorded_square):
        return "do not follow the positions"
    if abs(scale - 1.0) <= _VELOCITY_MAX_SCALE_ERROR:
        return ""
    if abs(scale + 1.0) <= _VELOCITY_MAX_SCALE_ERROR:
        return "have the opposite sign"
    return f"are {scale:.2g} times the derivative of the positions"
