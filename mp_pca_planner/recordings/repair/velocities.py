# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Comparison of recorded velocities with the derivative of the positions; they are never used."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...arrays import FloatArray
from ...exceptions import quote_names
from ..byte_layout import NS_PER_S
from ..joint_states import IntArray, RawJointStates
from .clock import choose_clock
from .samples import count


@dataclass(frozen=True)
class VelocityCheckOptions:
    """Thresholds of the comparison.

    Attributes
    ----------
    window : float
        Mean velocities over this time are compared [s]; noise hides those over one period.
    max_compared, min_compared : int
        Number of windows; with fewer no verdict is given.
    min_speed, max_speed : float
        Joints are compared between these speeds [rad/s or m/s]: at rest there is only noise, and
        a faster joint has wrapped or jumped.
    max_stretch : float
        A window longer than this share of the median window contains a gap.
    max_scale_error : float
        Accepted relative error of the scale.
    min_correlation : float
        With a lower correlation the velocities do not follow the positions.
    """

    window: float = 0.1
    max_compared: int = 20000
    min_compared: int = 20
    min_speed: float = 0.02
    max_speed: float = 20.0
    max_stretch: float = 2.0
    max_scale_error: float = 0.2
    min_correlation: float = 0.8


OPTIONS = VelocityCheckOptions()


def velocity_notes(
    raw: RawJointStates, joint_names: Sequence[str], options: VelocityCheckOptions = OPTIONS
) -> tuple[str, ...]:
    """Notes on missing and wrong velocities of some joints, one sentence each.

    The messages of the most frequent layout are checked.
    """
    if raw.computed:
        return ()
    fitting = [layout for layout in raw.layouts if set(joint_names) <= set(layout.joint_names)]
    layout = max(fitting, key=lambda layout: layout.messages.size)
    n_messages = layout.messages.size
    columns = [layout.joint_names.index(name) for name in joint_names]
    n_missing = n_messages
    if layout.velocities is not None:
        n_missing -= count(np.asarray(np.isfinite(layout.velocities[:, columns]).all(axis=1)))
    if n_missing == n_messages or layout.velocities is None:
        return (f"velocities are empty or NaN in all {n_messages} messages",)
    notes = []
    if n_missing:
        notes.append(f"velocities are empty or NaN in {n_missing} of {n_messages} messages")
    stamps, _ = choose_clock(raw, layout.messages)
    latest = np.maximum.accumulate(stamps)
    rows = np.flatnonzero(np.append(True, stamps[1:] > latest[:-1]) & (stamps > 0))
    verdicts: dict[str, list[str]] = {}
    if rows.size >= options.min_compared:
        for name, column in zip(joint_names, columns, strict=True):
            values = layout.positions[rows, column], layout.velocities[rows, column]
            verdict = _verdict(*_mean_velocities(stamps[rows], *values, options), options)
            verdicts.setdefault(verdict, []).append(name)
    verdicts.pop("", None)
    notes += [
        f"the velocities of {quote_names(names)} {verdict}: they are not used"
        for verdict, names in verdicts.items()
    ]
    return tuple(notes)


def _mean_velocities(
    stamps: IntArray,
    position: FloatArray,
    velocity: NDArray[np.float32],
    options: VelocityCheckOptions,
) -> tuple[FloatArray, FloatArray]:
    """Mean velocities of a joint over short windows: by its positions, and as recorded."""
    width = max(1, round(options.window * NS_PER_S / float(np.median(np.diff(stamps)))))
    starts = np.arange(0, stamps.size - width, max(1, stamps.size // options.max_compared))
    times = (stamps[starts + width] - stamps[starts]) / NS_PER_S
    true = (position[starts + width] - position[starts]) / times
    # Weights of the trapezoidal rule, so that a window of one period is compared rightly, too.
    recorded = np.zeros(starts.size)
    for offset in range(width + 1):
        recorded += (0.5 if offset in (0, width) else 1.0) * velocity[starts + offset]
    recorded /= width
    usable = times < options.max_stretch * np.median(times) if times.size else times > 0.0
    usable &= np.isfinite(recorded)
    usable &= (np.abs(true) > options.min_speed) & (np.abs(true) < options.max_speed)
    return true[usable], recorded[usable]


def _verdict(true: FloatArray, recorded: FloatArray, options: VelocityCheckOptions) -> str:
    """The defect of the recorded velocities of a joint; '' if there is none."""
    if true.size < options.min_compared:
        return ""
    if not recorded.any():
        return "are zero while the positions change"
    product, true_square, recorded_square = true @ recorded, true @ true, recorded @ recorded
    scale = product / true_square
    if abs(product) < options.min_correlation * np.sqrt(true_square * recorded_square):
        return "do not follow the positions"
    if abs(scale - 1.0) <= options.max_scale_error:
        return ""
    if abs(scale + 1.0) <= options.max_scale_error:
        return "have the opposite sign"
    return f"are {scale:.2g} times the derivative of the positions"
