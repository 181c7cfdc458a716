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
    prior, offset_prior : float
        Variance in every direction, as a share of the variance of a joint's ends: for distances,
        and for offsets of a joint.
    deviations, fitting : float
        Robust standard deviations of a logarithmic distance over which a recording is far, and
        under which it fits.
    least_deviation : float
        Least standard deviation of these logarithms.
    """

    min_recordings: int = 4
    max_left_out: int = 200
    max_motions: int = 10_000
    prior: float = 0.05
    offset_prior: float = 0.01
    deviations: float = 4.0
    fitting: float = 2.5
    least_deviation: float = 0.15


_OPTIONS = ForeignOptions()


@dataclass(frozen=True)
class Foreign:
    """A recording whose motions are far from those of the others, and a sentence on them."""

    recording: str
    reason: str


@dataclass(frozen=True, eq=False)
class _Others:
    """Gaussian of the motions of the other recordings, with two priors."""

    mean: FloatArray
    precision: FloatArray
    offset_precision: FloatArray


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
    models = _models(curves.reshape(len(curves), -1), list(rows.values()))
    pairs = list(zip(rows.values(), models, strict=True))
    table = np.array([_distances(curves[own], others) for own, others in pairs])
    found = []
    for i, (name, (own, others)) in enumerate(zip(rows, pairs, strict=True)):
        usual = np.delete(table, i, axis=0)
        deviations = _deviations(table[i], usual)
        if deviations.max() > _OPTIONS.deviations:
            worst = int(deviations.argmax())
            ratio = float(np.exp(table[i, worst] - np.median(usual[:, worst])))
            cause = _cause(curves[own], others, usual, statistics.joint_names)
            reason = f"its motions are {ratio:.1f} times as far from those of the others as is usual"
            found.append(Foreign(name, reason + cause))
    return tuple(found)


def _models(values: FloatArray, groups: list[list[int]]) -> list[_Others]:
    """For each recording, the Gaussian of the motions of the others."""
    centre = values.mean(axis=0)
    values = values - centre
    total, squares = values.sum(axis=0), values.T @ values
    if len(groups) > _OPTIONS.max_left_out:
        return [_gaussian(centre, total, squares, len(values))] * len(groups)
    return [
        _gaussian(
            centre,
            total - values[own].sum(axis=0),
            squares - values[own].T @ values[own],
            len(values) - len(own),
        )
        for own in groups
    ]


def _gaussian(centre: FloatArray, total: FloatArray, squares: FloatArray, n: int) -> _Others:
    mean = total / n
    covariance = squares / n - np.outer(mean, mean)
    # The ends of a joint have most of the variance.
    scale = np.trace(covariance) / len(covariance) ** 0.5 + 1e-12
    precisions = [
        np.linalg.inv(covariance + prior * scale * np.eye(len(mean)))
        for prior in (_OPTIONS.prior, _OPTIONS.offset_prior)
    ]
    return _Others(centre + mean, *precisions)


def _distances(curves: FloatArray, others: _Others) -> FloatArray:
    """Logarithms of distances: of the usual motion, of the mean, and of the largest offset."""
    y = curves.reshape(len(curves), -1) - others.mean
    single = np.sqrt(np.sum((y @ others.precision) * y, axis=1))
    mean = y.mean(axis=0)
    of_mean = np.sqrt(mean @ others.precision @ mean)
    _, deviations = _offsets(curves, others)
    found = np.array([np.median(single), of_mean, deviations.max()])
    return np.asarray(np.log(np.maximum(found, 1e-9)))


def _offsets(curves: FloatArray, others: _Others) -> tuple[FloatArray, FloatArray]:
    """Most likely offset of each joint [rad or m], and how far it is from 0."""
    n_joints = curves.shape[1]
    directions = _directions(curves)
    y = curves.reshape(len(curves), -1).mean(axis=0) - others.mean
    weighted = directions @ others.offset_precision
    products = np.einsum("ij,ij->i", weighted, directions)
    along = weighted @ y
    assert along.size == n_joints
    return along / products, np.abs(along) / np.sqrt(products) * np.sqrt(len(curves))


def _directions(curves: FloatArray) -> FloatArray:
    """Offset of each joint by 1 as curves, shape (n_joints, n_values)."""
    _, n_joints, n_values = curves.shape
    directions = np.zeros((n_joints, n_joints, n_values))
    joints = np.arange(n_joints)
    directions[joints, joints, :2] = 1.0 / np.sqrt(2.0)
    return directions.reshape(n_joints, -1)


def _deviations(own: FloatArray, usual: FloatArray) -> FloatArray:
    """Robust standard deviations of distances from the usual ones."""
    centre = np.median(usual, axis=0)
    spread = 1.4826 * np.median(np.abs(usual - centre), axis=0)
    return np.asarray((own - centre) / np.maximum(spread, _OPTIONS.least_deviation))


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
        return f"; they fit if '{joint_names[joint]}' is shifted by {-offsets[joint]:.2g} rad (or m)"
    signs = np.ones(len(joint_names))
    for _ in joint_names:
        flips: NDArray[np.float64] = signs * (1.0 - 2.0 * np.eye(len(signs)))
        trials = [_distances(curves * flip[:, None], others)[0] for flip in flips]
        signs = flips[int(np.argmin(trials))]
        if fits(curves * signs[:, None]):
            turned = [name for name, sign in zip(joint_names, signs, strict=True) if sign < 0.0]
            return f"; they fit with the opposite sign of {quote_names(turned)}"
    return ""
