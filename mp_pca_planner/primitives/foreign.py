# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Recordings whose motions are far from those of all others, such as mirrored ones.

Each recording is compared with a Gaussian of the motions of the others: of their ends and shapes.
The distances of the other recordings, each from the rest, show what is usual.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..exceptions import quote_names
from .motion_statistics import MotionStatistics


@dataclass(frozen=True)
class ForeignOptions:
    """Thresholds of the comparison.

    Attributes
    ----------
    min_recordings : int
        Fewer recordings don't show what is usual.
    max_left_out : int
        Of more recordings, each is compared with all, itself included.
    max_motions : int
        Largest number of motions that are compared; of more an even choice is.
    prior : float
        Variance in every direction, as a share of the variance of a joint.
    usual, mean : float
        Robust standard deviations over which a recording is far: of the logarithmic distance of its
        usual motion, and of its mean motion, which varies more.
    few : float
        Few recordings show less of what is usual: these thresholds grow by this over their number.
    fitting : float
        It fits under this share of them.
    least_deviation : float
        Least standard deviation of these logarithms.
    """

    min_recordings: int = 4
    max_left_out: int = 200
    max_motions: int = 10_000
    prior: float = 0.05
    usual: float = 3.5
    mean: float = 5.0
    few: float = 3.0
    fitting: float = 0.8
    least_deviation: float = 0.15


_OPTIONS = ForeignOptions()


@dataclass(frozen=True)
class Foreign:
    """A recording whose motions are far from those of the others, and a sentence on them."""

    recording: str
    reason: str


@dataclass(frozen=True, eq=False)
class _Others:
    """Gaussian of the motions of the other recordings."""

    mean: FloatArray
    precision: FloatArray


def foreign_recordings(statistics: MotionStatistics, n_phases: int) -> tuple[Foreign, ...]:
    """Recordings whose motions are far from those of all others.

    Parameters
    ----------
    statistics :
        Motions of several recordings. Among fewer than four recordings none is far.
    n_phases :
        Number of phases of their shapes.
    """
    n_motions = len(statistics.durations)
    if n_motions > _OPTIONS.max_motions:
        chosen = np.linspace(0, n_motions - 1, _OPTIONS.max_motions).round().astype(np.intp)
        statistics = statistics.chosen(chosen)
    rows: dict[str, list[int]] = {}
    for row, motion in enumerate(statistics.motions):
        rows.setdefault(motion.recording, []).append(row)
    if len(rows) < _OPTIONS.min_recordings:
        return ()
    ends = statistics.boundary_states[:, [0, 3]]
    curves = np.concatenate(
        [ends.transpose(0, 2, 1) / np.sqrt(2.0), statistics.shapes / np.sqrt(n_phases)], axis=2
    )
    n_ends = 2 * len(statistics.joint_names)
    models = _models(curves.reshape(len(curves), -1), list(rows.values()), _OPTIONS.prior / n_ends)
    pairs = list(zip(rows.values(), models, strict=True))
    table = np.array([_distances(curves[own], others) for own, others in pairs])
    found = []
    for i, (name, (own, others)) in enumerate(zip(rows, pairs, strict=True)):
        usual = np.delete(table, i, axis=0)
        deviations = _deviations(table[i], usual)
        if deviations.max() > 1.0 + _OPTIONS.few / len(usual):
            worst = int(deviations.argmax())
            ratio = float(np.exp(table[i, worst] - np.median(usual[:, worst])))
            cause = _cause(curves[own], others, usual, statistics.joint_names)
            far = f"its motions are {ratio:.1f} times as far from those of the others as is usual"
            found.append(Foreign(name, far + cause))
    return tuple(found)


def _models(values: FloatArray, groups: list[list[int]], prior: float) -> list[_Others]:
    """For each recording, the Gaussian of the motions of the others."""
    centre = values.mean(axis=0)
    values = values - centre
    total, squares = values.sum(axis=0), values.T @ values
    if len(groups) > _OPTIONS.max_left_out:
        return [_gaussian(centre, total, squares, len(values), prior)] * len(groups)
    return [
        _gaussian(
            centre,
            total - values[own].sum(axis=0),
            squares - values[own].T @ values[own],
            len(values) - len(own),
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
    return _Others(centre + mean, precision)


def _distances(curves: FloatArray, others: _Others) -> FloatArray:
    """Logarithms of the distances of the usual motion and of the mean motion."""
    y = curves.reshape(len(curves), -1) - others.mean
    single = np.sqrt(np.sum((y @ others.precision) * y, axis=1))
    mean = y.mean(axis=0)
    of_mean = np.sqrt(mean @ others.precision @ mean)
    found = np.array([np.median(single), of_mean])
    return np.asarray(np.log(np.maximum(found, 1e-9)))


def _offsets(curves: FloatArray, others: _Others) -> tuple[FloatArray, FloatArray]:
    """Most likely offset of each joint [rad or m], and how far it is from 0."""
    directions = _directions(curves)
    y = curves.reshape(len(curves), -1).mean(axis=0) - others.mean
    weighted = directions @ others.precision
    products = np.einsum("ij,ij->i", weighted, directions)
    along = weighted @ y
    return along / products, np.abs(along) / np.sqrt(products) * np.sqrt(len(curves))


def _directions(curves: FloatArray) -> FloatArray:
    """Offset of each joint by 1 as curves, shape (n_joints, n_values)."""
    _, n_joints, n_values = curves.shape
    directions = np.zeros((n_joints, n_joints, n_values))
    joints = np.arange(n_joints)
    directions[joints, joints, :2] = 1.0 / np.sqrt(2.0)
    return directions.reshape(n_joints, -1)


def _deviations(own: FloatArray, usual: FloatArray) -> FloatArray:
    """Robust standard deviations of distances from the usual ones, as shares of the thresholds."""
    centre = np.median(usual, axis=0)
    spread = 1.4826 * np.median(np.abs(usual - centre), axis=0)
    deviations = (own - centre) / np.maximum(spread, _OPTIONS.least_deviation)
    return np.asarray(deviations / [_OPTIONS.usual, _OPTIONS.mean])


def _cause(
    curves: FloatArray, others: _Others, usual: FloatArray, joint_names: tuple[str, ...]
) -> str:
    """What makes the motions fit, if it is known."""

    def fits(changed: FloatArray) -> bool:
        return bool(_deviations(_distances(changed, others), usual).max() < _OPTIONS.fitting)

    # The functions of the shapes are alternately even and odd.
    n_functions = curves.shape[2] - 2
    ends, shapes = curves[:, :, [1, 0]], curves[:, :, 2:] * (-1.0) ** np.arange(n_functions)
    if fits(np.concatenate([ends, shapes], axis=2)):
        return "; they fit if they are played backwards"
    offsets, deviations = _offsets(curves, others)
    joint = int(deviations.argmax())
    shift = (offsets[joint] * _directions(curves)[joint]).reshape(curves.shape[1:])
    if fits(curves - shift):
        by = f"{-offsets[joint]:.2g} rad (or m)"
        return f"; they fit if '{joint_names[joint]}' is shifted by {by}"
    signs = np.ones(len(joint_names))
    for _ in joint_names:
        flips: NDArray[np.float64] = signs * (1.0 - 2.0 * np.eye(len(signs)))
        trials = [_distances(curves * flip[:, None], others)[0] for flip in flips]
        signs = flips[int(np.argmin(trials))]
        if fits(curves * signs[:, None]):
            turned = [name for name, sign in zip(joint_names, signs, strict=True) if sign < 0.0]
            return f"; they fit with the opposite sign of {quote_names(turned)}"
    return ""
