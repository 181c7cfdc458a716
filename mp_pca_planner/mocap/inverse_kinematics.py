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

Joint origins can be fitted to a recording, so that one model serves people of different sizes. The
marker positions are linear in the joints' origins (or in their distances, along the directions
that the URDF gives). They and the joint positions of some frames are found together, as least
squares.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..exceptions import RecordingError, unknown_name
from ..lazy import LazyModule
from ..robot.model import AttachedPoints, Robot
from .markers import MarkerMap, MarkerPlacement

linalg, optimize = LazyModule("scipy.linalg"), LazyModule("scipy.optimize")

BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]

# Frames to which origins are fitted, evenly spread over the recording.
_N_FRAMES = 30
# Largest number of steps of the fit, which takes few where the model can reach the markers.
_MAX_STEPS = 30
# Weight of the change of an origin, which matters only where the markers don't show it.
_UNCHANGED = 1e-4
# After this number of frames without enough markers several starts are tried again.
_MAX_GAP = 10
# Largest numbers of steps: of one frame, and of all frames together.
_MAX_ITERATIONS = 100
_MAX_SWEEPS = 20
# Steps at which the first pass and the others end [rad or m].
_FIRST_STEP = 1e-3
_LAST_STEP = 1e-8
# Share of the cost that a step must gain, and the first damping.
_MIN_DECREASE = 1e-8
# Number of starting configurations for a frame without a solved frame before.
_N_STARTS = 12
# Singular values below this share of the largest count as zero.
_SINGULAR = 1e-6


class MarkerProblem:
    """Marker positions that the joint positions of a recording have to fit.

    Parameters
    ----------
    robot : Robot
        The model.
    markers : sequence of MarkerPlacement
        The markers on it.
    targets : array, shape (n_frames, n_markers, 3)
        Measured positions in the model's base frame [m]; NaN where missing.
    smoothness : float
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
        self.points = _attached(robot, markers)
        self._seen: BoolArray = np.asarray(np.isfinite(targets).all(axis=2))
        self.targets = np.where(self._seen[..., None], targets, 0.0)
        # Roots of the weights, 0 where a marker is missing; shape (n_frames, n_markers).
        self.scale = np.where(self._seen, np.sqrt([m.weight for m in markers]), 0.0)
        self.lower, self.upper = robot.limits().lower, robot.limits().upper
        self.smoothness = smoothness

    @property
    def n_frames(self) -> int:
        """Number of frames."""
        return len(self.targets)

    @property
    def n_joints(self) -> int:
        """Number of joints."""
        return self.lower.size

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
        _, jacobians = self.points.positions_and_jacobians(starts)
        loose = set(range(self.n_joints))
        for jacobian in jacobians[:, seen].reshape(len(starts), -1, self.n_joints):
            _, values, directions = np.linalg.svd(jacobian)
            rank = np.count_nonzero(values > _SINGULAR * values.max(initial=0.0))
            null = np.abs(directions[rank:]).max(axis=0, initial=0.0)
            loose &= set(np.flatnonzero(null > _SINGULAR).tolist())
        return tuple(sorted(loose))

    def determined(self) -> BoolArray:
        """Whether the visible markers of each frame fix all joints, shape (n_frames,)."""
        patterns, pattern_of = np.unique(self._seen, axis=0, return_inverse=True)
        enough = np.array([not self.open_joints(seen) for seen in patterns], dtype=bool)
        return np.asarray(enough[pattern_of.reshape(-1)])

    def residuals(self, frames: IntArray, q: FloatArray) -> FloatArray:
        """Distances of the markers from their measured positions [m], NaN where missing.

        Their shape is (n_chosen_frames, n_markers).
        """
        points, _ = self.points.positions_and_jacobians(q)
        distances = np.linalg.norm(points - self.targets[frames], axis=2)
        return np.where(self._seen[frames], distances, np.nan)

    def starts(self) -> FloatArray:
        """Configurations to start from: all joints near zero, then at random within the limits."""
        low = np.where(np.isfinite(self.lower), self.lower, -np.pi)
        high = np.where(np.isfinite(self.upper), self.upper, np.pi)
        # Starts are slightly inside of the limits: at a limit, or with a straight arm, gradients
        # may vanish.
        near_zero = np.clip(0.0, low + 0.1 * (high - low), high - 0.1 * (high - low))
        size = _N_STARTS - 1, self.n_joints
        return np.vstack([near_zero, np.random.default_rng(0).uniform(low, high, size)])


def _attached(robot: Robot, markers: Sequence[MarkerPlacement]) -> AttachedPoints:
    return robot.attach_points([m.link for m in markers], np.array([m.position for m in markers]))


def solve(problem: MarkerProblem, period: float) -> FloatArray:
    """Find the joint positions of all frames.

    Parameters
    ----------
    problem : MarkerProblem
        The markers to fit.
    period : float
        Time from one frame to the next [s].

    Returns
    -------
    q : array, shape (n_frames, n_joints)
        Joint positions [rad or m]; NaN in frames whose markers don't fix them.
    """
    q = np.full((problem.n_frames, problem.n_joints), np.nan)
    frames = np.flatnonzero(problem.determined())
    start, last_frame = np.empty(0), -np.inf
    for run in np.split(frames, np.flatnonzero(np.diff(frames) > 1) + 1):
        if run.size and run[0] - last_frame > _MAX_GAP:
            start = _best_of_starts(problem, run[0])
        for frame in run:
            start, _ = _solve_frame(problem, frame, start, _FIRST_STEP)
            q[frame], last_frame = start, frame
        if run.size:
            weight = problem.smoothness / period**2
            q[run], _ = _minimise(problem, run, q[run], weight, _LAST_STEP, _MAX_SWEEPS)
    return q


def _best_of_starts(problem: MarkerProblem, frame: int) -> FloatArray:
    """Joint positions of one frame; of several minima the lowest, or the first of equal ones."""
    best, lowest = np.empty(0), np.inf
    for start in problem.starts():
        q, cost = _solve_frame(problem, frame, start, _LAST_STEP)
        # A minimum is lower if a tenth of the cost, and a micrometre, are gained.
        if cost < 0.9 * lowest - 1e-12:
            best, lowest = q, cost
    return best


def _solve_frame(
    problem: MarkerProblem, frame: int, start: FloatArray, last_step: float
) -> tuple[FloatArray, float]:
    """Joint positions of one frame, shape (n_joints,), and their cost."""
    alone = np.array([frame])
    q, cost = _minimise(problem, alone, start[None], 0.0, last_step, _MAX_ITERATIONS)
    return q[0], cost


def _minimise(
    problem: MarkerProblem,
    frames: IntArray,
    q: FloatArray,
    weight: float,
    last_step: float,
    max_steps: int,
) -> tuple[FloatArray, float]:
    """Joint positions of consecutive frames within the limits, and their cost."""
    # Gauss-Newton steps: the damping grows tenfold while one would raise the cost, and falls
    # tenfold otherwise.
    q = np.clip(q, problem.lower, problem.upper)
    cost, gradient, matrices = _linearised(problem, frames, q, weight)
    damping = _MIN_DECREASE
    for _ in range(max_steps):
        held = ((q <= problem.lower) & (gradient > 0.0)) | ((q >= problem.upper) & (gradient < 0.0))
        step = _banded_step(weight, gradient, matrices, ~held, damping)
        trial = np.clip(q + step, problem.lower, problem.upper)
        if np.abs(trial - q).max() < last_step:
            break
        lower_cost, *derivatives = _linearised(problem, frames, trial, weight)
        if lower_cost > cost:
            damping *= 10.0
            continue
        gained, cost, q = cost - lower_cost, lower_cost, trial
        gradient, matrices = derivatives
        if gained <= _MIN_DECREASE * (cost + gained):
            break
        damping = max(_MIN_DECREASE, damping / 10.0)
    return q, cost


def _linearised(
    problem: MarkerProblem, frames: IntArray, q: FloatArray, weight: float
) -> tuple[float, FloatArray, FloatArray]:
    """Cost [m²], half its gradient by q, and half the Gauss-Newton matrix of each frame alone."""
    points, jacobians = problem.points.positions_and_jacobians(q)
    scale = problem.scale[frames][..., None]
    errors = (scale * (points - problem.targets[frames])).reshape(len(q), -1)
    jacobians = (scale[..., None] * jacobians).reshape(len(q), -1, problem.n_joints)
    accelerations, pulls = np.zeros(0), np.zeros_like(q)
    if weight:
        accelerations = weight * np.diff(q, n=2, axis=0)
        # The transpose of the second difference is itself, of values padded with zeros.
        padded = np.pad(accelerations, ((2, 2), (0, 0)))
        pulls = weight * np.diff(padded, n=2, axis=0)[: len(q)]
    transposed = jacobians.transpose(0, 2, 1)
    gradient = (transposed @ errors[..., None])[..., 0] + pulls
    cost = float(np.sum(errors**2) + np.sum(accelerations**2))
    return cost, gradient, transposed @ jacobians


def _banded_step(
    weight: float, gradients: FloatArray, matrices: FloatArray, free: BoolArray, damping: float
) -> FloatArray:
    """Solve for the steps of all frames; joints that are not free have none."""
    n_frames, n_joints = gradients.shape
    matrices = matrices * (free[:, :, None] & free[:, None, :])
    if n_frames == 1:  # a band takes more time
        matrix = matrices[0] + np.diag(np.where(free[0], damping, 1.0))
        return np.asarray(np.linalg.solve(matrix, -(gradients * free)[0])[None])
    # Diagonal d of the matrix is row d of the band: consecutive frames are offset by n_joints.
    band = np.zeros((2 * n_joints + 1, n_frames, n_joints))
    for d in range(n_joints):
        band[d, :, : n_joints - d] = matrices.diagonal(-d, 1, 2)
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
    step = linalg.solveh_banded(rows, right, lower=True, check_finite=False)
    return np.asarray(step, dtype=np.float64).reshape(n_frames, n_joints)


FittedOrigins = Mapping[str, tuple[FloatArray, FloatArray]]
"""By joint, its origin in its parent link in the URDF [m], shape (3,), and the directions there in
which it is fitted, shape (n_directions, 3)."""


def fitted_origins(urdf: str, marker_map: MarkerMap) -> FittedOrigins:
    """The joints whose origins are fitted.

    Raises
    ------
    RecordingError
        If the robot description has no such joint, or a joint whose distance is fitted has no
        direction.
    """
    where = f"{marker_map.source}: fit_origins"
    joints = {joint.get("name", ""): joint for joint in ET.fromstring(urdf).findall("joint")}
    fitted = {}
    for name, kind in marker_map.fit_origins.items():
        if name not in joints:
            raise RecordingError(f"{where}: {unknown_name('joint', name, joints)}")
        place = joints[name].find("origin")
        text = "0 0 0" if place is None else place.get("xyz", "0 0 0")
        origin = np.array(text.split(), dtype=float)
        if kind == "length" and not origin.any():
            raise RecordingError(
                f"{where}: joint '{name}' is at the origin of its parent link, so there is no "
                "length to fit; use 'position'"
            )
        directions = np.eye(3) if kind == "position" else origin[None] / np.linalg.norm(origin)
        fitted[name] = origin, directions
    return fitted


def fit_origins(
    robot: Robot, markers: Sequence[MarkerPlacement], fitted: FittedOrigins, targets: FloatArray
) -> tuple[Robot, tuple[str, ...]]:
    """Fit the origins of some joints.

    Parameters
    ----------
    robot : Robot
        The model.
    markers : sequence of MarkerPlacement
        Markers that its joints move.
    fitted : FittedOrigins
        Those joints.
    targets : array, shape (n_frames, n_markers, 3)
        Measured positions in the base frame [m]; NaN where missing. The frames must fix all joints.

    Returns
    -------
    robot : Robot
        The robot with the fitted origins.
    notes : tuple of str
        The fitted origins, one sentence for each joint.
    """
    chosen = np.unique(np.linspace(0, len(targets) - 1, _N_FRAMES).round().astype(int))
    problem = MarkerProblem(robot, markers, targets[chosen])
    # Places are linear in the origins: those of robots with one of them displaced by 1 m tell all.
    displaced = [
        _with_origins(robot, {name: origin + direction})
        for name, (origin, directions) in fitted.items()
        for direction in directions
    ]
    places = [problem.points, *(_attached(other, markers) for other in displaced)]
    n, scale = len(displaced), problem.scale[..., None]

    def errors(x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Weighted errors of the markers, and their derivatives by origins and joint positions."""
        change, q = x[:n], x[n:].reshape(-1, robot.n_joints)
        of_all = [place.positions_and_jacobians(q) for place in places]
        points, by_q = map(np.array, zip(*of_all, strict=True))
        shares = np.append(1.0 - change.sum(), change)
        wrong = scale * (np.tensordot(shares, points, 1) - problem.targets)
        effects = scale[..., None] * np.moveaxis(points[1:] - points[0], 0, -1)
        rows = scale[..., None] * np.tensordot(shares, by_q, 1)
        blocks = linalg.block_diag(*rows.reshape(len(q), -1, robot.n_joints))
        still = _UNCHANGED * np.eye(n, x.size)
        jacobian = np.vstack([np.hstack([effects.reshape(-1, n), blocks]), still])
        return np.append(wrong.reshape(-1), still @ x), jacobian

    configurations = [_best_of_starts(problem, 0)]
    for frame in range(1, problem.n_frames):
        solved, _ = _solve_frame(problem, frame, configurations[-1], _FIRST_STEP)
        configurations.append(solved)
    bounds = [
        np.append(np.full(n, end), np.tile(limit, problem.n_frames))
        for end, limit in ((-np.inf, problem.lower), (np.inf, problem.upper))
    ]
    start = np.append(np.zeros(n), configurations)
    fit = optimize.least_squares(
        lambda x: errors(x)[0], start, lambda x: errors(x)[1], bounds, max_nfev=_MAX_STEPS
    )
    changes = iter(fit.x)
    origins = {
        name: origin + sum(next(changes) * direction for direction in directions)
        for name, (origin, directions) in fitted.items()
    }
    notes = tuple(
        f"joint '{name}' fits the markers best at ({_millimetres(origin)}) mm in its parent link; "
        f"the URDF has it at ({_millimetres(fitted[name][0])}) mm"
        for name, origin in origins.items()
    )
    return _with_origins(robot, origins), notes


def _millimetres(place: FloatArray) -> str:
    return ", ".join(f"{1000.0 * x:.1f}" for x in place)


def _with_origins(robot: Robot, origins: Mapping[str, FloatArray]) -> Robot:
    """The robot with other origins of some joints."""
    root = ET.fromstring(robot.urdf)
    for joint in root.findall("joint"):
        if (position := origins.get(joint.get("name", ""))) is not None:
            origin = joint.find("origin")
            origin = ET.SubElement(joint, "origin") if origin is None else origin
            origin.set("xyz", " ".join(map(repr, position.tolist())))
    return Robot(ET.tostring(root, encoding="unicode"), robot.joint_names)
