# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Recordings whose motions are far from those of all others, such as mirrored ones, and copies.

Nobody repeats a motion within millimetres, so motions that are nearly the same are copies of one.
Apart from these, each recording is compared with a Gaussian of the motions of the others: of their
ends and shapes. The distances of the other recordings, each from the rest, show what is usual.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np

from ..arrays import FloatArray
from ..exceptions import quote_names
from ..lazy import LazyModule
from .motion_statistics import MotionStatistics

spatial = LazyModule("scipy.spatial")

# Fewer recordings don't show what is usual.
_MIN_RECORDINGS = 4
# Of more recordings, each is compared with all, itself included.
_MAX_LEFT_OUT = 200
# Most motions that are compared, because the time grows with their square; of more an even choice.
_MAX_MOTIONS = 10_000
# Variance in every direction, as a share of the variance of a joint.
_PRIOR = 0.05
# Robust standard deviations over which a recording is far: of the logarithmic distance of its usual
# motion, and of its mean motion, which varies more; and the least standard deviation of these
# logarithms.
_FAR, _LEAST_DEVIATION = (3.5, 5.0), 0.15
# Few recordings show less of what is usual: these thresholds grow by this over their number.
_FEW = 3.0
# Least difference of the logarithmic distances after two kinds of changes of which one is named.
_CLEARLY = 0.2
# Robust standard deviations of logarithmic durations over which a recording is slow or fast, and
# the least standard deviation of these.
_LONGER, _LEAST_SPREAD = 5.0, 0.2
# RMS distance under which motions are the same [rad or m].
_COPY = 0.005

_Others = tuple[FloatArray, FloatArray]
"""Mean and precision of a Gaussian of the motions of the other recordings."""


def foreign_recordings(statistics: MotionStatistics, n_phases: int) -> list[tuple[str, str]]:
    """Recordings whose motions are far from those of all others, or copies of them.

    Parameters
    ----------
    statistics :
        Motions of recordings. Among fewer than four, none is far.
    n_phases :
        Number of phases of their shapes.

    Returns
    -------
    found :
        The names of these recordings, each with the reason why it is named.
    """
    n_motions = len(statistics.durations)
    chosen = np.linspace(0, n_motions - 1, min(n_motions, _MAX_MOTIONS)).round().astype(np.intp)
    recordings = np.array([statistics.sources[k]["recording"] for k in chosen])
    ends, durations = statistics.boundary_states[chosen][:, [0, 3]], statistics.durations[chosen]
    shapes = statistics.shapes[chosen] / np.sqrt(n_phases)
    curves = np.concatenate([ends.transpose(0, 2, 1) / np.sqrt(2.0), shapes], axis=2)
    copies = _copies(curves, recordings.tolist())
    reasons, names = list(copies.items()), list(dict.fromkeys(recordings.tolist()))
    names = [name for name in names if name not in copies]
    if len(names) < _MIN_RECORDINGS:
        return reasons
    used = np.isin(recordings, names)
    members = [recordings == name for name in names]
    everything = _gaussian(curves[used])
    is_left_out = len(names) <= _MAX_LEFT_OUT
    models = [_gaussian(curves[used & ~x]) if is_left_out else everything for x in members]
    table = np.array(
        [_distances(curves[x], model) for x, model in zip(members, models, strict=True)]
    )
    times = np.log([np.median(durations[x]) for x in members])
    # Few recordings show less of what is usual.
    most = 1.0 + _FEW / (len(names) - 1)
    for i, name in enumerate(names):
        longer, spread = _usual(np.delete(times[i] - times, i), _LEAST_SPREAD)
        if abs(longer) > most * _LONGER * spread:
            word = "long" if longer > 0.0 else "short"
            times_as = f"{np.exp(abs(longer)):.1f} times as {word} as those of the others"
            reasons.append((name, f"its motions are {times_as}: check its clock"))
        centre, deviation = _usual(np.delete(table, i, axis=0), _LEAST_DEVIATION)
        shares = (table[i] - centre) / (most * deviation * _FAR)
        if shares.max() > 1.0:
            ratio = float(np.exp((table[i] - centre)[shares.argmax()]))
            far = f"its motions are {ratio:.1f} times as far from those of the others as is usual"
            limits = centre + most * deviation * _FAR
            reasons.append((name, far + _cause(curves[members[i]], models[i], limits, statistics)))
    return reasons


def _copies(curves: FloatArray, recordings: Sequence[str]) -> dict[str, str]:
    """Recordings that hold a motion of another one, but for noise or another rate, and why."""
    points = curves.reshape(len(curves), -1) / np.sqrt(curves.shape[1])
    n_nearest = min(4, len(points))
    apart, nearest = spatial.cKDTree(points).query(
        points, range(1, n_nearest + 1), distance_upper_bound=_COPY
    )
    copies: dict[str, str] = {}
    for row, k in np.argwhere(np.isfinite(apart))[::-1].tolist():
        copy, other = recordings[row], recordings[nearest[row, k]]
        if copy != other and other not in copies:
            by = f"{1e3 * apart[row, k]:.2g} mrad (or mm) RMS"
            copies[copy] = f"a motion of it is {by} from one of '{other}': a copy counts twice"
    return copies


def _gaussian(curves: FloatArray) -> _Others:
    values, n_ends = curves.reshape(len(curves), -1), 2 * curves.shape[1]
    covariance = np.cov(values, rowvar=False, bias=True)
    prior = _PRIOR / n_ends * np.trace(covariance) + 1e-12
    return values.mean(axis=0), np.linalg.inv(covariance + prior * np.eye(len(covariance)))


def _distances(curves: FloatArray, others: _Others) -> FloatArray:
    """Logarithms of the distances of the usual motion and of the mean motion."""
    centre, precision = others
    y = curves.reshape(len(curves), -1) - centre
    single, mean = np.sqrt(np.sum((y @ precision) * y, axis=1)), y.mean(axis=0)
    both = np.array([np.median(single), np.sqrt(mean @ precision @ mean)])
    return np.asarray(np.log(np.maximum(both, 1e-9)))


def _usual(values: FloatArray, least: float) -> tuple[FloatArray, FloatArray]:
    """Median and robust standard deviation, which is at least `least`."""
    centre = np.median(values, axis=0)
    return centre, np.maximum(1.4826 * np.median(np.abs(values - centre), axis=0), least)


def _cause(
    curves: FloatArray, others: _Others, limits: FloatArray, statistics: MotionStatistics
) -> str:
    """What makes the motions fit, if one kind of change does so clearly better than all others."""
    best: dict[str, tuple[float, str]] = {}
    for kind, text, changed in _changes(curves, others, statistics.joint_names):
        distances = _distances(changed, others)
        if np.all(distances < limits):
            best[kind] = min(best.get(kind, (np.inf, "")), (float(distances[0]), text))
    first, *rivals = sorted(best.values()) or [(np.inf, "")]
    is_clear = not rivals or rivals[0][0] - first[0] > _CLEARLY
    return first[1] if is_clear else ""


def _changes(
    curves: FloatArray, others: _Others, joint_names: tuple[str, ...]
) -> Iterator[tuple[str, str, FloatArray]]:
    """Changes of motions that undo a usual defect: the kind, what to say, and the result."""
    n_joints, n_functions = len(joint_names), curves.shape[2] - 2
    # The functions of the shapes are alternately even and odd.
    ends, shapes = curves[:, :, [1, 0]], curves[:, :, 2:] * (-1.0) ** np.arange(n_functions)
    backwards = np.concatenate([ends, shapes], axis=2)
    yield "backwards", "; they fit if they are played backwards", backwards
    centre, precision = others
    off = curves.reshape(len(curves), -1).mean(axis=0) - centre
    for joint, name in enumerate(joint_names):
        by_one = np.zeros(curves.shape[1:])
        by_one[joint, :2] = 1.0 / np.sqrt(2.0)
        weighted = precision @ by_one.ravel()
        offset = weighted @ off / (weighted @ by_one.ravel())  # the most likely one
        text = f"; they fit if '{name}' is shifted by {-offset:.2g} rad (or m)"
        yield "offset", text, curves - offset * by_one
    for i, j in combinations(range(n_joints), 2):
        order = np.arange(n_joints)
        order[[i, j]] = j, i
        text = f"; they fit if '{joint_names[i]}' and '{joint_names[j]}' are exchanged"
        yield "names", text, curves[:, order]
    signs = np.ones(n_joints)
    for _ in joint_names:
        flips = signs * (1.0 - 2.0 * np.eye(n_joints))
        flips = flips[flips.sum(axis=1) < signs.sum()]
        trials = [_distances(curves * flip[:, None], others)[0] for flip in flips]
        signs = flips[int(np.argmin(trials))]
        turned = [name for name, sign in zip(joint_names, signs, strict=True) if sign < 0.0]
        text = f"; they fit with the opposite sign of {quote_names(turned)}"
        yield "signs", text, curves * signs[:, None]
