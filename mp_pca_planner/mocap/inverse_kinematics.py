# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Inverse kinematics of whole recordings: joint positions that fit the measured markers.

With the marker positions p_i(q) of the model and the measured ones m_i, the joint positions
q_1 … q_n of all frames minimise

    Σ_k Σ_i w_i ‖p_i(q_k) − m_ik‖² + c² Σ_k ‖(q_{k−1} − 2 q_k + q_{k+1}) / Δt²‖²

within the joint limits; a missing marker has no term in its frame. A first pass solves one frame
after the other, each from the solution of the last. A second one improves all frames together, a
banded system: the accelerations determine motions that markers don't show, such as the axial
rotation of an upper arm while the elbow is straight.

Joint origins can be fitted to a recording, so that one model serves people of different sizes.
The marker positions are linear in the joints' origins o (or in their distances, along the
directions that the URDF gives): with the rotation R of the parent link, ∂p/∂o = R for every marker
beyond the joint. Origins and the joint positions of some frames are found together by Gauss-Newton.
The joint positions are eliminated frame by frame by a projection of the errors, which leaves a
small system for the origins alone.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable, Mapping, Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solveh_banded

from ..arrays import FloatArray
from ..exceptions import RecordingError, unknown_name
from ..robot.model import Robot
from .markers import MarkerMap, MarkerPlacement, OriginFit

BoolArray = NDArray[np.bool_]

Linearised = tuple[float, FloatArray, FloatArray]
"""Sum of squares; half its gradient, of the shape of x; half its Gauss-Newton matrix, in whatever
form the step function takes it."""

Step = Callable[[FloatArray, FloatArray, BoolArray, float], FloatArray]
"""Step for a gradient, a matrix, the variables that are held at a bound, and a damping."""


def minimise(
    x: FloatArray,
    linearise: Callable[[FloatArray], Linearised],
    step: Step,
    bounds: tuple[FloatArray, FloatArray],
    last_step: float,
    max_iterations: int,
    min_decrease: float = 1e-8,
) -> tuple[FloatArray, float]:
    """Minimise a sum of squares within bounds.

    The damping grows tenfold while a step would raise the sum, and falls tenfold otherwise.

    Parameters
    ----------
    x : array
        Where to start.
    linearise, step :
        The problem, see :data:`Linearised` and :data:`Step`.
    bounds : tuple of array
        Lower and upper bounds, which broadcast to the shape of `x`.
    last_step : float
        The iteration ends at a step whose entries are all smaller.
    max_iterations : int
        Largest number of steps.
    min_decrease : float
        The iteration also ends at a step that lowers the sum by less than this share. It is the
        first damping, too.

    Returns
    -------
    x : array
        The minimum, or the best point found.
    cost : float
        The sum of squares there.
    """
    lower, upper = bounds
    x = np.clip(x, lower, upper)
    cost, gradient, matrix = linearise(x)
    damping = min_decrease
    for _ in range(max_iterations):
        held = ((x <= lower) & (gradient > 0.0)) | ((x >= upper) & (gradient < 0.0))
        trial = np.clip(x + step(gradient, matrix, held, damping), lower, upper)
        if np.abs(trial - x).max() < last_step:
            break
        found = linearise(trial)
        if found[0] <= cost:
            converged = cost - found[0] <= min_decrease * cost
            x, (cost, gradient, matrix) = trial, found
            if converged:
                break
            damping = max(min_decrease, damping / 10.0)
        else:
            damping *= 10.0
    return x, cost


IntArray = NDArray[np.int64]


# Frames to which origins are fitted, evenly spread over the recording.
_N_FRAMES = 30
# Largest number of steps of the fit, which takes two to four where the model can reach the markers,
# and change of the origins at which it ends [m].
_MAX_ORIGIN_STEPS, _LAST_ORIGIN_STEP = 10, 1e-7
# Directions that change the errors less than this share of the strongest stay unchanged.
_MIN_EFFECT = 1e-4
# After this number of frames without enough markers several starts are tried again.
_MAX_GAP = 10
# Largest numbers of steps: of one frame, and of all frames together.
_MAX_ITERATIONS = 100
_MAX_SWEEPS = 20
# Steps at which the first pass and the others end [rad or m].
_FIRST_STEP = 1e-3
_LAST_STEP = 1e-8
# Number of starting configurations for a frame without a solved frame before.
_N_STARTS = 12
# Singular values below this share of the largest count as zero.
_SINGULAR = 1e-6


class MarkerProblem:
    """Marker positions that the joint positions of a recording have to fit.

    Parameters
    ----------
    robot :
        The model.
    markers :
        The markers on it.
    targets : array, shape (n_frames, n_markers, 3)
        Measured positions in the model's base frame [m]; NaN where missing.
    smoothness :
        c [m·s²/rad]. At the default an acceleration of 100 rad/s² counts as much as 0.1 mm at one
        marker.
    """

    def __init__(
        self,
        robot: Robot,
        markers: Sequence[MarkerPlacement],
        targets: FloatArray,
        smoothness: float = 1e-6,
    ) -> None:
        self._points = robot.attach_points(
            [m.link for m in markers], np.array([m.position for m in markers])
        )
        self._seen: BoolArray = np.asarray(np.isfinite(targets).all(axis=2))
        self._targets = np.where(self._seen[..., None], targets, 0.0)
        # Roots of the weights, 0 where a marker is missing; shape (n_frames, n_markers).
        self.scale = np.where(self._seen, np.sqrt([m.weight for m in markers]), 0.0)
        self.lower, self.upper = robot.limits().lower, robot.limits().upper
        self.smoothness = smoothness

    @property
    def n_frames(self) -> int:
        """Number of frames."""
        return len(self._targets)

    @property
    def n_joints(self) -> int:
        """Number of joints."""
        return int(self.lower.size)

    def open_joints(self, seen: BoolArray) -> tuple[int, ...]:
        """Joints whose positions some of the markers leave open in every configuration.

        They are found from the Jacobian in random configurations: nearly all of them have the
        rank of nonsingular ones.

        Parameters
        ----------
        seen : array of bool, shape (n_markers,)
            Which markers are present.
        """
        starts = self.starts()
        _, jacobians = self._points.positions_and_jacobians(starts)
        found = set(range(self.n_joints))
        for jacobian in jacobians[:, seen].reshape(len(starts), -1, self.n_joints):
            _, values, directions = np.linalg.svd(jacobian)
            rank = np.count_nonzero(values > _SINGULAR * values.max(initial=0.0))
            null = np.abs(directions[rank:]).max(axis=0, initial=0.0)
            found &= set(np.flatnonzero(null > _SINGULAR).tolist())
        return tuple(sorted(found))

    def determined(self) -> BoolArray:
        """Whether the visible markers of each frame fix all joints, shape (n_frames,)."""
        patterns, pattern_of = np.unique(self._seen, axis=0, return_inverse=True)
        enough = np.array([not self.open_joints(seen) for seen in patterns], dtype=bool)
        return np.asarray(enough[pattern_of.reshape(-1)])

    def residuals(self, frames: Sequence[int] | NDArray[np.int64], q: FloatArray) -> FloatArray:
        """Distances of the markers from their measured positions [m], NaN where missing.

        Their shape is (n_chosen_frames, n_markers).
        """
        points, _ = self._points.positions_and_jacobians(q)
        distances = np.linalg.norm(points - self._targets[frames], axis=2)
        return np.where(self._seen[frames], distances, np.nan)

    def linearised(
        self, frames: Sequence[int] | NDArray[np.int64], q: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Cost of frames [m²], half its gradient, and half its Gauss-Newton matrix.

        Parameters
        ----------
        frames : array of int, shape (n_chosen_frames,)
            Which frames.
        q : array, shape (n_chosen_frames, n_joints)
            Joint positions [rad or m], by which the derivatives of each frame are.
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
        scale = self.scale[frames]
        errors = (points - self._targets[frames]) * scale[..., None]
        jacobians *= scale[..., None, None]
        return errors.reshape(len(q), -1), jacobians.reshape(len(q), -1, self.n_joints)

    def starts(self) -> FloatArray:
        """Configurations to start from: all joints near zero, then at random within the limits."""
        low = np.where(np.isfinite(self.lower), self.lower, -np.pi)
        high = np.where(np.isfinite(self.upper), self.upper, np.pi)
        # Starts are slightly inside of the limits: at a limit, or with a straight arm, gradients
        # may vanish.
        near_zero = np.clip(0.0, low + 0.1 * (high - low), high - 0.1 * (high - low))
        size = _N_STARTS - 1, self.n_joints
        random = np.random.default_rng(0).uniform(low, high, size)
        return np.vstack([near_zero, random])


def solve(problem: MarkerProblem, period: float) -> FloatArray:
    """Find the joint positions of all frames.

    Parameters
    ----------
    problem :
        The markers to fit.
    period :
        Time from one frame to the next [s].

    Returns
    -------
    q : array, shape (n_frames, n_joints)
        Joint positions [rad or m]; NaN in frames whose markers don't fix them.
    """
    q = np.full((problem.n_frames, problem.n_joints), np.nan)
    start, last_frame = np.empty(0), -np.inf
    for run in _runs(problem.determined()):
        if run[0] - last_frame > _MAX_GAP:
            start = _best_of_starts(problem, int(run[0]))
        first_pass = _track(problem, run, start)
        start, last_frame = first_pass[-1], run[-1]
        q[run] = _improve_together(problem, run, first_pass, period)
    return q


def solve_each(problem: MarkerProblem, starts: FloatArray | None = None) -> FloatArray:
    """Find the joint positions of single frames, which all fix them.

    Parameters
    ----------
    problem :
        The markers to fit.
    starts : array, shape (n_frames, n_joints)
        Joint positions to start from; those of the frame before unless given.
    """
    frames = np.arange(problem.n_frames)
    if starts is None:
        starts = _track(problem, frames, _best_of_starts(problem, 0))
    return np.array([_solve_frame(problem, k, q, _LAST_STEP)[0] for k, q in enumerate(starts)])


def _best_of_starts(problem: MarkerProblem, frame: int) -> FloatArray:
    """Joint positions of one frame; of several minima the lowest, or the first of equal ones."""
    best, lowest = np.empty(0), np.inf
    for start in problem.starts():
        q, cost = _solve_frame(problem, frame, start, _LAST_STEP)
        # A minimum is lower if a tenth of the cost, and a micrometre, are gained.
        if cost < 0.9 * lowest - 1e-12:
            best, lowest = q, cost
    return best


def _runs(used: BoolArray) -> list[IntArray]:
    """Indices of frames that follow one another without a gap."""
    frames = np.flatnonzero(used)
    return [r for r in np.split(frames, np.flatnonzero(np.diff(frames) > 1) + 1) if r.size]


def _track(problem: MarkerProblem, frames: IntArray, start: FloatArray) -> FloatArray:
    """Solve one frame after the other, each from the solution of the last."""
    q = np.empty((frames.size, problem.n_joints))
    for k, frame in enumerate(frames.tolist()):
        q[k], _ = _solve_frame(problem, frame, start, _FIRST_STEP)
        start = q[k]
    return q


def _solve_frame(
    problem: MarkerProblem, frame: int, start: FloatArray, last_step: float
) -> tuple[FloatArray, float]:
    def linearise(q: FloatArray) -> Linearised:
        costs, gradients, matrices = problem.linearised([frame], q[None])
        return float(costs[0]), gradients[0], matrices[0]

    bounds = problem.lower, problem.upper
    return minimise(start, linearise, _dense_step, bounds, last_step, _MAX_ITERATIONS)


def _dense_step(
    gradient: FloatArray, matrix: FloatArray, held: BoolArray, damping: float
) -> FloatArray:
    matrix = matrix + damping * np.eye(held.size)
    matrix[held], matrix[:, held] = 0.0, 0.0
    matrix[held, held] = 1.0
    return np.asarray(np.linalg.solve(matrix, np.where(held, 0.0, -gradient)))


def _improve_together(
    problem: MarkerProblem, frames: IntArray, start: FloatArray, period: float
) -> FloatArray:
    """Improve all frames of a run together, with the accelerations that connect them."""
    weight = problem.smoothness / period**2

    def linearise(q: FloatArray) -> Linearised:
        costs, gradients, matrices = problem.linearised(frames, q)
        accelerations = weight * np.diff(q, n=2, axis=0)
        # The transpose of the second difference is itself, of values padded with zeros.
        padded = np.pad(accelerations, ((2, 2), (0, 0)))
        gradients = gradients + weight * np.diff(padded, n=2, axis=0)[: len(q)]
        return float(np.sum(costs) + np.sum(accelerations**2)), gradients, matrices

    step = partial(_banded_step, weight)
    bounds = problem.lower, problem.upper
    return minimise(start, linearise, step, bounds, _LAST_STEP, _MAX_SWEEPS)[0]


def _banded_step(
    weight: float, gradients: FloatArray, matrices: FloatArray, held: BoolArray, damping: float
) -> FloatArray:
    """Solve for the steps of all frames; joints that are held have none."""
    n_frames, n_joints = gradients.shape
    free = ~held
    # Diagonal d of the matrix is row d of the band: consecutive frames are offset by n_joints.
    band = np.zeros((2 * n_joints + 1, n_frames, n_joints))
    for d in range(n_joints):
        for j in range(n_joints - d):
            band[d, :, j] = matrices[:, j + d, j] * free[:, j + d] * free[:, j]
    difference = (1.0, -2.0, 1.0)
    for apart in range(3):
        coupling = np.zeros(n_frames)
        for k in range(3 - apart):
            product = difference[k] * difference[k + apart]
            coupling[k : max(k, n_frames - 2 + k)] += weight**2 * product
        both = free.copy()
        both[: n_frames - apart] &= free[apart:]
        band[apart * n_joints] += coupling[:, None] * both
    band[0] += np.where(free, damping, 1.0)
    rows, right = band.reshape(2 * n_joints + 1, -1), -(gradients * free).reshape(-1)
    step = solveh_banded(rows, right, lower=True, check_finite=False)
    return np.asarray(step, dtype=np.float64).reshape(n_frames, n_joints)


_Joint = tuple[str, str, FloatArray]
"""A joint of a URDF: its parent and child link, and its origin in the parent link [m]."""


def check_fits(urdf: str, marker_map: MarkerMap) -> None:
    """Refuse fits that are impossible for this robot description.

    Raises
    ------
    RecordingError
        If it has no such joint, or a joint whose distance is fitted has no direction.
    """
    joints = _joints(ET.fromstring(urdf))
    for name, kind in marker_map.fit_origins.items():
        if name not in joints:
            raise RecordingError(
                f"{marker_map.source}: fit_origins: {unknown_name('joint', name, joints)}"
            )
        if kind == "length" and not joints[name][2].any():
            raise RecordingError(
                f"{marker_map.source}: fit_origins: joint '{name}' is at the origin of its parent "
                "link, so there is no length to fit; use 'position'"
            )


def fit_origins(
    urdf: str,
    joint_names: Sequence[str],
    markers: Sequence[MarkerPlacement],
    fits: Mapping[str, OriginFit],
    targets: FloatArray,
) -> tuple[str, tuple[str, ...]]:
    """Fit the origins of some joints.

    Parameters
    ----------
    urdf :
        The robot description.
    joint_names :
        Joints that move.
    markers :
        Markers that they move.
    fits :
        The fitted part of each origin, see :class:`.MarkerMap`.
    targets : array, shape (n_frames, n_markers, 3)
        Measured positions in the base frame [m]; NaN where missing. The frames must fix all joints.

    Returns
    -------
    urdf : str
        The robot description with the fitted origins.
    notes : tuple of str
        The fitted origins, one sentence for each joint.
    """
    joints = _joints(ET.fromstring(urdf))
    columns = [
        (name, direction)
        for name, fit in fits.items()
        for direction in _directions(joints[name][2], fit)
    ]
    in_parents = [(joints[name][0], direction) for name, direction in columns]
    chosen = np.unique(np.linspace(0, len(targets) - 1, _N_FRAMES).round().astype(int))
    beyond = _beyond(joints, [name for name, _ in columns], markers)
    q: FloatArray | None = None

    def fitted(change: FloatArray) -> dict[str, FloatArray]:
        origins = {name: joints[name][2] for name in fits}
        for (name, direction), amount in zip(columns, change, strict=True):
            origins[name] = origins[name] + amount * direction
        return origins

    def linearise(change: FloatArray) -> Linearised:
        nonlocal q
        robot = Robot(_with_origins(urdf, fitted(change)), joint_names)
        problem = MarkerProblem(robot, markers, targets[chosen])
        q = solve_each(problem, q)
        effects = np.einsum("mc,kci->kmic", beyond, _turned(robot, q, in_parents))
        return _reduced(problem, q, effects)

    bounds = np.array(-np.inf), np.array(np.inf)
    start = np.zeros(len(columns))
    limits = _LAST_ORIGIN_STEP, _MAX_ORIGIN_STEPS
    change, _ = minimise(start, linearise, _strong_step, bounds, *limits)
    notes = tuple(
        f"joint '{name}' fits the markers best at ({_millimetres(origin)}) mm in its parent link; "
        f"the URDF has it at ({_millimetres(joints[name][2])}) mm"
        for name, origin in fitted(change).items()
    )
    return _with_origins(urdf, fitted(change)), notes


def _reduced(problem: MarkerProblem, q: FloatArray, effects: FloatArray) -> Linearised:
    """Least squares of the origins, from which the joint positions are eliminated.

    Parameters
    ----------
    problem, q :
        Frames and their best joint positions.
    effects : array, shape (n_frames, n_markers, 3, n_columns)
        Derivatives of the marker positions by the origins.
    """
    frames = np.arange(len(q))
    errors, jacobians = problem.weighted(frames, q)
    effects = effects * problem.scale[frames][..., None, None]
    removed = jacobians @ np.linalg.pinv(jacobians, rcond=_MIN_EFFECT)
    rest = np.eye(errors.shape[1]) - removed
    matrix = (rest @ effects.reshape(*errors.shape, -1)).reshape(-1, effects.shape[-1])
    left = (rest @ errors[..., None]).reshape(-1)
    return float(np.sum(errors**2)), matrix.T @ left, matrix.T @ matrix


def _strong_step(
    gradient: FloatArray, matrix: FloatArray, held: BoolArray, damping: float
) -> FloatArray:
    """Step in the directions that change the errors."""
    values, vectors = np.linalg.eigh(matrix)
    strong = values > _MIN_EFFECT**2 * values[-1]
    vectors = vectors[:, strong]
    return np.asarray(-vectors @ ((vectors.T @ gradient) / (values[strong] + damping)))


def _joints(root: ET.Element) -> dict[str, _Joint]:
    found = {}
    for joint in root.iter("joint"):
        parent, child, origin = (joint.find(tag) for tag in ("parent", "child", "origin"))
        if parent is not None and child is not None:
            text = "0 0 0" if origin is None else origin.get("xyz", "0 0 0")
            origin_in_parent = np.array(text.split(), dtype=float)
            links = parent.get("link", ""), child.get("link", "")
            found[joint.get("name", "")] = *links, origin_in_parent
    return found


def _with_origins(urdf: str, origins: Mapping[str, FloatArray]) -> str:
    root = ET.fromstring(urdf)
    for joint in root.iter("joint"):
        position = origins.get(joint.get("name", ""))
        if position is not None:
            origin = joint.find("origin")
            origin = ET.SubElement(joint, "origin") if origin is None else origin
            origin.set("xyz", " ".join(repr(float(x)) for x in position))
    return ET.tostring(root, encoding="unicode")


def _directions(origin: FloatArray, fit: OriginFit) -> FloatArray:
    """Directions in the parent link that the origin may move in, shape (n_directions, 3)."""
    if fit == "position":
        return np.eye(3)
    return np.asarray(origin[None] / np.linalg.norm(origin))


def _beyond(
    joints: Mapping[str, _Joint], names: Sequence[str], markers: Sequence[MarkerPlacement]
) -> FloatArray:
    """1 where a marker is beyond a joint, else 0; shape (n_markers, n_names)."""
    above = {child: (name, parent) for name, (parent, child, _) in joints.items()}
    result = np.zeros((len(markers), len(names)))
    for row, marker in zip(result, markers, strict=True):
        link = marker.link
        while link in above:
            passed, link = above[link]
            row[[name == passed for name in names]] = 1.0
    return result


def _turned(robot: Robot, q: FloatArray, columns: Sequence[tuple[str, FloatArray]]) -> FloatArray:
    """Directions given in links, in the base frame; shape (n_frames, n_columns, 3)."""
    links = [link for link, _ in columns]
    directions = np.array([direction for _, direction in columns])
    tips, _ = robot.attach_points(links, directions).positions_and_jacobians(q)
    origins, _ = robot.attach_points(links, 0.0 * directions).positions_and_jacobians(q)
    return tips - origins


def _millimetres(position: FloatArray) -> str:
    return ", ".join(f"{1000.0 * x:.1f}" for x in position)
