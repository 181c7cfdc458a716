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
# Largest number of motions that are compared; of more an even choice is.
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
    if n_motions > _MAX_MOTIONS:
        chosen = np.linspace(0, n_motions - 1, _MAX_MOTIONS).round().astype(np.intp)
        statistics = statistics.chosen(chosen)
    rows: dict[str, list[int]] = {}
    for row, motion in enumerate(statistics.sources):
        rows.setdefault(motion.recording, []).append(row)
    ends = statistics.boundary_states[:, [0, 3]]
    curves = np.concatenate(
        [ends.transpose(0, 2, 1) / np.sqrt(2.0), statistics.shapes / np.sqrt(n_phases)], axis=2
    )
    copies = _copies(curves, [motion.recording for motion in statistics.sources])
    for name in copies:
        del rows[name]
    if len(rows) < _MIN_RECORDINGS:
        return list(copies.items())
    n_ends = 2 * len(statistics.joint_names)
    models = _models(curves.reshape(len(curves), -1), list(rows.values()), _PRIOR / n_ends)
    pairs = list(zip(rows.values(), models, strict=True))
    table = np.array([_distances(curves[own], others) for own, others in pairs])
    times = np.array([np.median(statistics.durations[own]) for own in rows.values()])
    found = list(copies.items())
    for i, (name, (own, others)) in enumerate(zip(rows, pairs, strict=True)):
        usual = np.delete(table, i, axis=0)
        deviations = _deviations(table[i], usual)
        ratios = np.delete(times[i] / times, i)
        if _slowness(ratios) > _most(usual):
            found.append((name, _unusual_time(float(np.median(ratios)))))
        if deviations.max() > _most(usual):
            worst = int(deviations.argmax())
            ratio = float(np.exp(table[i, worst] - np.median(usual[:, worst])))
            cause = _cause(curves[own], others, usual, statistics.joint_names)
            far = f"its motions are {ratio:.1f} times as far from those of the others as is usual"
            found.append((name, far + cause))
    return found


def _copies(curves: FloatArray, recordings: Sequence[str]) -> dict[str, str]:
    """Recordings that hold a motion of another one, but for noise or another rate, and why."""
    points = curves.reshape(len(curves), -1) / np.sqrt(curves.shape[1])
    n_nearest = min(4, len(points))
    apart, nearest = spatial.cKDTree(points).query(
        points, range(1, n_nearest + 1), distance_upper_bound=_COPY
    )
    found: dict[str, str] = {}
    for row, k in np.argwhere(np.isfinite(apart))[::-1].tolist():
        own, other = recordings[row], recordings[nearest[row, k]]
        if own != other and other not in found:
            by = f"{1e3 * apart[row, k]:.2g} mrad (or mm) RMS"
            found[own] = f"a motion of it is {by} from one of '{other}': a copy counts twice"
    return found


def _models(values: FloatArray, groups: list[list[int]], prior: float) -> list[_Others]:
    """For each recording, the Gaussian of the motions of the others."""
    centre = values.mean(axis=0)
    values = values - centre
    every = values[np.concatenate(groups)]
    total, squares = every.sum(axis=0), every.T @ every
    if len(groups) > _MAX_LEFT_OUT:
        return [_gaussian(centre, total, squares, len(every), prior)] * len(groups)
    return [
        _gaussian(
            centre,
            total - values[own].sum(axis=0),
            squares - values[own].T @ values[own],
            len(every) - len(own),
            prior,
        )
        for own in groups
    ]


def _gaussian(
    centre: FloatArray, total: FloatArray, squares: FloatArray, n: int, prior: float
) -> _Others:
    mean = total / n
    covariance = squares / n - np.outer(mean, mean)
    precision = np.linalg.inv(
        covariance + (prior * np.trace(covariance) + 1e-12) * np.eye(len(mean))
    )
    return centre + mean, precision


def _distances(curves: FloatArray, others: _Others) -> FloatArray:
    """Logarithms of the distances of the usual motion and of the mean motion."""
    centre, precision = others
    y = curves.reshape(len(curves), -1) - centre
    single = np.sqrt(np.sum((y @ precision) * y, axis=1))
    mean = y.mean(axis=0)
    of_mean = np.sqrt(mean @ precision @ mean)
    found = np.array([np.median(single), of_mean])
    return np.asarray(np.log(np.maximum(found, 1e-9)))


def _offsets(curves: FloatArray, others: _Others) -> FloatArray:
    """Most likely offset of each joint [rad or m]."""
    directions, (centre, precision) = _directions(curves), others
    weighted = directions @ precision
    y = curves.reshape(len(curves), -1).mean(axis=0) - centre
    return np.asarray(weighted @ y / np.einsum("ij,ij->i", weighted, directions))


def _directions(curves: FloatArray) -> FloatArray:
    """Offset of each joint by 1 as curves, shape (n_joints, n_values)."""
    _, n_joints, n_values = curves.shape
    directions = np.zeros((n_joints, n_joints, n_values))
    joints = np.arange(n_joints)
    directions[joints, joints, :2] = 1.0 / np.sqrt(2.0)
    return directions.reshape(n_joints, -1)


def _most(usual: FloatArray) -> float:
    """Deviation over which a recording is far, as a share of the thresholds."""
    return 1.0 + _FEW / len(usual)


def _slowness(ratios: FloatArray) -> float:
    """Deviation of a duration, given its ratios to the others, as a share of the threshold."""
    logs = np.log(ratios)
    centre = np.median(logs)
    spread = max(1.4826 * float(np.median(np.abs(logs - centre))), _LEAST_SPREAD)
    return float(abs(centre) / spread / _LONGER)


def _unusual_time(ratio: float) -> str:
    longer = ratio > 1.0
    word, times = ("long", ratio) if longer else ("short", 1.0 / ratio)
    return f"its motions are {times:.1f} times as {word} as those of the others: check its clock"


def _deviations(own: FloatArray, usual: FloatArray) -> FloatArray:
    """Robust standard deviations of distances from the usual ones, as shares of the thresholds."""
    centre = np.median(usual, axis=0)
    spread = 1.4826 * np.median(np.abs(usual - centre), axis=0)
    deviations = (own - centre) / np.maximum(spread, _LEAST_DEVIATION)
    return np.asarray(deviations / _FAR)


def _cause(
    curves: FloatArray, others: _Others, usual: FloatArray, joint_names: tuple[str, ...]
) -> str:
    """What makes the motions fit, if one kind of change does so clearly better than all others."""
    best: dict[str, tuple[float, str]] = {}
    for kind, text, changed in _changes(curves, others, joint_names):
        distances = _distances(changed, others)
        if _deviations(distances, usual).max() < _most(usual):
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
    directions = _directions(curves).reshape(n_joints, *curves.shape[1:])
    for name, offset, direction in zip(
        joint_names, _offsets(curves, others), directions, strict=True
    ):
        text = f"; they fit if '{name}' is shifted by {-offset:.2g} rad (or m)"
        yield "offset", text, curves - offset * direction
    for i, j in combinations(range(n_joints), 2):
        order = np.arange(n_joints)
        order[[i, j]] = j, i
        text = f"; they fit if '{joint_names[i]}' and '{joint_names[j]}' are exchanged"
        yield "names", text, curves[:, order]
    for factor in (0.5, 2.0):
        for name, row in zip(joint_names, np.eye(n_joints), strict=True):
            text = f"; they fit if '{name}' is multiplied by {factor:g}"
            yield "scale", text, curves * (1.0 + (factor - 1.0) * row)[:, None]
        start = np.zeros_like(curves)
        start[:, :, :2] = curves[:, :, :1]
        text = f"; they fit if they are {factor:g} times as large"
        yield "size", text, start + factor * (curves - start)
    signs = np.ones(n_joints)
    for _ in joint_names:
        flips = signs * (1.0 - 2.0 * np.eye(n_joints))
        flips = flips[flips.sum(axis=1) < signs.sum()]
        trials = [_distances(curves * flip[:, None], others)[0] for flip in flips]
        signs = flips[int(np.argmin(trials))]
        turned = [name for name, sign in zip(joint_names, signs, strict=True) if sign < 0.0]
        text = f"; they fit with the opposite sign of {quote_names(turned)}"
        yield "signs", text, curves * signs[:, None]
