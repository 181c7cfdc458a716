# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Inverse kinematics over whole recordings: joint positions that bring markers to their places.

With the marker positions p_i(q) of the model and the measured ones m_i, the joint positions
q_1 … q_n of all frames minimise

    Σ_k Σ_i w_i ‖p_i(q_k) − m_ik‖² + c² Σ_k ‖(q_{k−1} − 2 q_k + q_{k+1}) / Δt²‖²

within the joint limits; a marker that is missing in a frame has no term there. A first pass goes
from frame to frame, each starting from the last (Levenberg-Marquardt). A second one improves all
frames together (Gauss-Newton, a banded system), since the accelerations tie them to each other:
they say what markers can't, such as the turn of an upper arm about itself while the elbow is
straight.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solveh_banded

from ..arrays import FloatArray
from ..robot.model import AttachedPoints, Robot
from .marker_map import MarkerPlacement

BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]

SMOOTHNESS = 1e-6
"""c [m·s²/rad]: an acceleration of 100 rad/s² counts as much as 0.1 mm at one marker."""

N_STARTS = 12
"""Configurations to start from where there is no frame before."""

_SHORT_GAP = 10
"""After so many frames without enough markers the joints can't be far from where they were."""

_MAX_ITERATIONS = 100
_MAX_SWEEPS = 20
_FIRST_PASS_STEP = 1e-3
_LAST_STEP = 1e-8
_LEAST_DAMPING = 1e-8
_MUCH_BETTER, _NEGLIGIBLE = 0.9, 1e-12  # share, and squared distance [m²]
_SINGULAR = 1e-6
_SECOND_DIFFERENCE = (1.0, -2.0, 1.0)


class MarkerProblem:
    """Assembled: what the joint positions of a recording have to fit.

    Parameters
    ----------
    points : AttachedPoints
        The markers on the model.
    targets : array, shape (n_frames, n_markers, 3)
        Measured positions in the model's base frame [m]; NaN where missing.
    weights : array, shape (n_markers,)
        How much the squared distances count.
    lower, upper : array, shape (n_joints,)
        Range of the joints [rad or m], infinite where there is none.
    """

    def __init__(
        self,
        points: AttachedPoints,
        targets: FloatArray,
        weights: FloatArray,
        lower: FloatArray,
        upper: FloatArray,
    ) -> None:
        self._points = points
        self._seen: BoolArray = np.asarray(np.isfinite(targets).all(axis=2))
        self._targets = np.where(self._seen[..., None], targets, 0.0)
        self._weights = weights
        self.lower = lower
        self.upper = upper

    @property
    def n_frames(self) -> int:
        """Number of frames."""
        return len(self._targets)

    @property
    def n_joints(self) -> int:
        """Number of joints."""
        return int(self.lower.size)

    def open_joints(self, seen: BoolArray) -> tuple[int, ...]:
        """Joints whose positions some of the markers leave open, however they stand.

        They are found from the Jacobian in configurations at random: in nearly all of them it has
        the rank that it has apart from singular ones.

        Parameters
        ----------
        seen : array of bool, shape (n_markers,)
            Which markers there are.
        """
        _, jacobians = self._points.positions_and_jacobians(self.starts())
        found = set(range(self.n_joints))
        for jacobian in jacobians[:, seen].reshape(N_STARTS, -1, self.n_joints):
            _, values, directions = np.linalg.svd(jacobian)
            rank = np.count_nonzero(values > _SINGULAR * values.max(initial=0.0))
            null = np.abs(directions[rank:]).max(axis=0, initial=0.0)
            found &= set(np.flatnonzero(null > _SINGULAR).tolist())
        return tuple(sorted(found))

    def determined(self) -> BoolArray:
        """Tell the frames in which the markers that are seen fix all joints, shape (n_frames,)."""
        patterns, pattern_of = np.unique(self._seen, axis=0, return_inverse=True)
        enough = np.array([not self.open_joints(seen) for seen in patterns], dtype=bool)
        return np.asarray(enough[pattern_of.reshape(-1)])

    def residuals(self, frames: Sequence[int] | NDArray[np.int64], q: FloatArray) -> FloatArray:
        """Distances of the markers from where they were measured [m], NaN where missing.

        Returns
        -------
        :
            shape (n_chosen_frames, n_markers)
        """
        points, _ = self._points.positions_and_jacobians(q)
        distances = np.linalg.norm(points - self._targets[frames], axis=2)
        return np.where(self._seen[frames], distances, np.nan)

    def linearised(
        self, frames: Sequence[int] | NDArray[np.int64], q: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Cost of frames, its gradient and its Gauss-Newton matrix by the joints of the frame.

        Parameters
        ----------
        frames : array of int, shape (n_chosen_frames,)
            Which frames.
        q : array, shape (n_chosen_frames, n_joints)
            Joint positions [rad or m].

        Returns
        -------
        cost : array, shape (n_chosen_frames,)
            Weighted squared distances [m²].
        gradient : array, shape (n_chosen_frames, n_joints)
            Half the gradient.
        matrix : array, shape (n_chosen_frames, n_joints, n_joints)
            Half the Gauss-Newton matrix.
        """
        errors, jacobians = self.weighted(frames, q)
        transposed = jacobians.transpose(0, 2, 1)
        gradient = (transposed @ errors[..., None])[..., 0]
        return np.sum(errors**2, axis=1), gradient, transposed @ jacobians

    def weighted(
        self, frames: Sequence[int] | NDArray[np.int64], q: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Errors of frames [m] times the roots of the weights, and their derivatives.

        Returns
        -------
        errors : array, shape (n_chosen_frames, 3 n_markers)
            0 where a marker is missing.
        jacobians : array, shape (n_chosen_frames, 3 n_markers, n_joints)
            Their derivatives by the joints.
        """
        points, jacobians = self._points.positions_and_jacobians(q)
        scale = self.scale(frames)
        errors = (points - self._targets[frames]) * scale[..., None]
        jacobians *= scale[..., None, None]
        return errors.reshape(len(q), -1), jacobians.reshape(len(q), -1, self.n_joints)

    def scale(self, frames: Sequence[int] | NDArray[np.int64]) -> FloatArray:
        """Roots of the weights, 0 where a marker is missing; shape (n_chosen_frames, n_markers)."""
        return np.asarray(self._seen[frames] * np.sqrt(self._weights), dtype=np.float64)

    def starts(self) -> FloatArray:
        """Configurations to start from: all joints near zero, then at random within the limits."""
        low = np.where(np.isfinite(self.lower), self.lower, -np.pi)
        high = np.where(np.isfinite(self.upper), self.upper, np.pi)
        # A little inside: at a limit, or where an arm is straight, gradients may vanish.
        near_zero = np.clip(0.0, low + 0.1 * (high - low), high - 0.1 * (high - low))
        random = np.random.default_rng(0).uniform(low, high, (N_STARTS - 1, self.n_joints))
        return np.vstack([near_zero, random])


def marker_problem(
    robot: Robot, markers: Sequence[MarkerPlacement], targets: FloatArray
) -> MarkerProblem:
    """Assemble the problem of a robot with markers (see :class:`MarkerProblem`)."""
    limits = robot.limits()
    return MarkerProblem(
        robot.attach_points([m.link for m in markers], np.array([m.position for m in markers])),
        targets,
        np.array([m.weight for m in markers]),
        limits.lower,
        limits.upper,
    )


def solve(problem: MarkerProblem, period: float, *, smoothness: float = SMOOTHNESS) -> FloatArray:
    """Find the joint positions of all frames.

    Parameters
    ----------
    problem :
        What they have to fit.
    period :
        Time from one frame to the next [s].
    smoothness :
        How much accelerations count, c above [m·s²/rad].

    Returns
    -------
    q : array, shape (n_frames, n_joints)
        Joint positions [rad or m]; NaN in frames whose markers don't fix them.
    """
    q = np.full((problem.n_frames, problem.n_joints), np.nan)
    start, last_frame = np.empty(0), -np.inf
    for run in _runs(problem.determined()):
        if run[0] - last_frame > _SHORT_GAP:
            start = best_of_starts(problem, int(run[0]))
        first_pass = _track(problem, run, start)
        start, last_frame = first_pass[-1], run[-1]
        q[run] = _improve_together(problem, run, first_pass, smoothness / period**2)
    return q


def solve_each(problem: MarkerProblem, starts: FloatArray | None = None) -> FloatArray:
    """Find the joint positions of frames that may be far apart, which fix all joints.

    Parameters
    ----------
    problem :
        What they have to fit.
    starts : array, shape (n_frames, n_joints)
        Joint positions to start from; those of the frame before unless given.
    """
    frames = np.arange(problem.n_frames)
    if starts is None:
        starts = _track(problem, frames, best_of_starts(problem, 0))
    return np.array([_descend(problem, k, start, _LAST_STEP)[0] for k, start in enumerate(starts)])


def _runs(used: BoolArray) -> list[IntArray]:
    """Indices of frames that follow one another without a gap."""
    frames = np.flatnonzero(used)
    return [r for r in np.split(frames, np.flatnonzero(np.diff(frames) > 1) + 1) if r.size]


def _track(problem: MarkerProblem, frames: IntArray, start: FloatArray) -> FloatArray:
    """Go from frame to frame, starting each from the last one."""
    q = np.empty((frames.size, problem.n_joints))
    for k, frame in enumerate(frames.tolist()):
        q[k], _ = _descend(problem, frame, start, _FIRST_PASS_STEP)
        start = q[k]
    return q


def best_of_starts(problem: MarkerProblem, frame: int) -> FloatArray:
    """Joint positions of one frame; of several minima the lowest, or the first of equal ones."""
    best, lowest = np.empty(0), np.inf
    for start in problem.starts():
        q, cost = _descend(problem, frame, start, _LAST_STEP)
        if cost < _MUCH_BETTER * lowest - _NEGLIGIBLE:
            best, lowest = q, cost
    return best


def _descend(
    problem: MarkerProblem, frame: int, start: FloatArray, last_step: float
) -> tuple[FloatArray, float]:
    """Levenberg-Marquardt with the joint limits as bounds, until steps are small."""
    chosen = [frame]
    q = np.clip(start, problem.lower, problem.upper)
    costs, gradients, matrices = problem.linearised(chosen, q[None])
    damping = _LEAST_DAMPING
    for _ in range(_MAX_ITERATIONS):
        step = _bounded_step(problem, q, gradients[0], matrices[0], damping)
        trial = np.clip(q + step, problem.lower, problem.upper)
        if np.abs(trial - q).max() < last_step:
            break
        found = problem.linearised(chosen, trial[None])
        if found[0][0] <= costs[0]:
            q, (costs, gradients, matrices) = trial, found
            damping = max(_LEAST_DAMPING, damping / 10.0)
        else:
            damping *= 10.0
    return q, float(costs[0])


def _bounded_step(
    problem: MarkerProblem, q: FloatArray, gradient: FloatArray, matrix: FloatArray, damping: float
) -> FloatArray:
    held = _held(problem, q, gradient)
    matrix = matrix + damping * np.eye(problem.n_joints)
    matrix[held], matrix[:, held] = 0.0, 0.0
    matrix[held, held] = 1.0
    return np.asarray(np.linalg.solve(matrix, np.where(held, 0.0, -gradient)))


def _held(problem: MarkerProblem, q: FloatArray, gradient: FloatArray) -> BoolArray:
    """Tell the joints at a limit that would leave it."""
    return np.asarray(
        ((q <= problem.lower) & (gradient > 0.0)) | ((q >= problem.upper) & (gradient < 0.0))
    )


def _improve_together(
    problem: MarkerProblem, frames: IntArray, start: FloatArray, weight: float
) -> FloatArray:
    """Gauss-Newton on all frames of a run together; the damping grows while the cost would."""
    q = start
    found = _linearised_together(problem, frames, q, weight)
    damping = _LEAST_DAMPING
    for _ in range(_MAX_SWEEPS):
        held = _held(problem, q, found[1])
        step = _banded_step(found[1], found[2], held, weight, damping)
        trial = np.clip(q + step, problem.lower, problem.upper)
        if np.abs(trial - q).max() < _LAST_STEP:
            break
        found_there = _linearised_together(problem, frames, trial, weight)
        if found_there[0] <= found[0]:
            q, found = trial, found_there
            damping = max(_LEAST_DAMPING, damping / 10.0)
        else:
            damping *= 10.0
    return q


def _linearised_together(
    problem: MarkerProblem, frames: IntArray, q: FloatArray, weight: float
) -> tuple[float, FloatArray, FloatArray]:
    costs, gradients, matrices = problem.linearised(frames, q)
    accelerations = weight * np.diff(q, n=2, axis=0)
    gradients = gradients + weight * _second_difference_transposed(accelerations, len(q))
    return float(np.sum(costs) + np.sum(accelerations**2)), gradients, matrices


def _second_difference_transposed(values: FloatArray, n_frames: int) -> FloatArray:
    result = np.zeros((n_frames, values.shape[1]))
    for offset, factor in enumerate(_SECOND_DIFFERENCE):
        result[offset : offset + len(values)] += factor * values
    return result


def _banded_step(
    gradients: FloatArray, matrices: FloatArray, held: BoolArray, weight: float, damping: float
) -> FloatArray:
    """Solve for the steps of all frames; joints that are held have none."""
    n_frames, n_joints = gradients.shape
    free = ~held
    # Diagonal d of the matrix is row d of the band: frames are n_joints apart.
    band = np.zeros((2 * n_joints + 1, n_frames, n_joints))
    for d in range(n_joints):
        for j in range(n_joints - d):
            band[d, :, j] = matrices[:, j + d, j] * free[:, j + d] * free[:, j]
    for apart in range(len(_SECOND_DIFFERENCE)):
        coupling = np.zeros(n_frames)
        for k in range(len(_SECOND_DIFFERENCE) - apart):
            product = _SECOND_DIFFERENCE[k] * _SECOND_DIFFERENCE[k + apart]
            coupling[k : max(k, n_frames - 2 + k)] += weight**2 * product
        both = free.copy()
        both[: n_frames - apart] &= free[apart:]
        band[apart * n_joints] += coupling[:, None] * both
    band[0] += np.where(free, damping, 1.0)
    rows, right = band.reshape(2 * n_joints + 1, -1), -(gradients * free).reshape(-1)
    step = solveh_banded(rows, right, lower=True, check_finite=False)
    return np.asarray(step, dtype=np.float64).reshape(n_frames, n_joints)
