# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Off-line refinement: the scaling and warping that cost least by the robot's model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.polynomial import legendre
from scipy.optimize import OptimizeResult, minimize

from ..arrays import FloatArray
from ..exceptions import GoalError, TrajectoryError
from ..motion.collision import CollisionModel
from ..motion.trajectory import Trajectory
from ..motion.validation import LimitCheck, check_executable, check_limits
from ..planning.motion import Motion
from ..robot.limits import JointLimits
from ..robot.model import Robot
from .refined_motion import (
    LOG_DURATION,
    N_PARAMETERS,
    RefinedMotion,
    SegmentStates,
    segment_states,
)

# How far a refinement may go: amplitudes from 0 to twice the original, durations by a factor
# of 3, time three times as fast or slow.
BOUNDS = np.array([1.0, np.log(3.0)] + [3.0] * (N_PARAMETERS - 2))

_N_NODES = 40
# Limits are kept at these phases of each segment, and wherever they are found broken.
_CHECKED_PHASES = np.linspace(0.02, 0.98, 25)
# Constraints keep this share of a limit as a margin, since limits hold only where checked.
_MARGIN = 1e-3
# Only limits that are this near, as shares of themselves, are constraints at first.
_NEAR = 0.4
_MOST_ROUNDS = 6
# A refinement that still breaks limits, or in which links meet, is taken back by these factors.
_RETREATS = (0.95, 0.8, 0.5, 0.25)


@dataclass(frozen=True)
class RefinementOptions:
    """How motions are refined.

    Attributes
    ----------
    time_price : float or None
        Cost of a second, in units of the effort ½∫‖τ‖²dt a second. None keeps the total
        duration; segments may still trade time with each other.
    sample_period : float
        Time between the points of the trajectory [s].
    max_iterations : int
        Most iterations of the optimiser.
    allow_nonzero_end_velocity : bool
        Whether the controller accepts motions that don't end at rest.

    Raises
    ------
    GoalError
        If an option is out of its range.
    """

    time_price: float | None = None
    sample_period: float = 0.01
    max_iterations: int = 100
    allow_nonzero_end_velocity: bool = False

    def __post_init__(self) -> None:
        price = self.time_price
        if price is not None and not (np.isfinite(price) and price >= 0.0):
            raise GoalError(f"time_price must be a number ≥ 0, got {price}")
        if not 1e-4 <= self.sample_period <= 1.0:
            raise GoalError(f"sample_period must be 0.0001 to 1 s, got {self.sample_period}")


@dataclass(frozen=True, eq=False)
class Refinement:
    """What came of refining a motion.

    Attributes
    ----------
    motion : RefinedMotion
        The best motion found; the original one if none was better.
    trajectory : Trajectory
        Its points; executable.
    check : LimitCheck
        Comparison with the limits.
    original_cost, cost : float
        Cost before and after: effort ½∫‖τ‖²dt, plus the price of the duration if it has one.
    original_effort, effort : float
        The effort alone.
    iterations : int
        Iterations of the optimiser.
    """

    motion: RefinedMotion
    trajectory: Trajectory
    check: LimitCheck
    original_cost: float
    cost: float
    original_effort: float
    effort: float
    iterations: int

    @property
    def gain(self) -> float:
        """Share by which the cost fell."""
        return 1.0 - self.cost / self.original_cost


def refine(
    segments: Sequence[Motion],
    robot: Robot,
    limits: JointLimits,
    options: RefinementOptions = RefinementOptions(),
    collision: CollisionModel | None = None,
) -> Refinement:
    """Scale and warp a motion, or several joined ones, to the least cost within the limits.

    Parameters
    ----------
    segments : sequence of Motion
        The motion, which must be executable itself.
    robot : Robot
        The model.
    limits : JointLimits
        Limits of the joints.
    options : RefinementOptions
        How.
    collision : CollisionModel, optional
        Of the same robot: a refinement in which it hits itself is taken back.

    Returns
    -------
    refinement : Refinement
        Never costlier than the original.

    Raises
    ------
    TrajectoryError
        If the original motion is not executable.
    RobotError
        If a moving link of the robot has no valid inertia.
    """
    cost = RefinementCost(segments, robot, options.time_price)
    judge = ExecutableMotions(segments, robot, limits, options, collision)
    original = RefinedMotion(segments)
    best = judge.accept(original)
    before = cost.effort_and_cost(original.parameters)
    best_cost, iterations = before[1], 0
    kept = _Limits(len(segments), robot, limits)
    start = np.zeros(len(segments) * N_PARAMETERS)
    for _ in range(_MOST_ROUNDS):
        found = _minimise(cost, kept, segments, start, options)
        iterations += int(found.nit)
        check = judge.check(RefinedMotion(segments, found.x))
        if not check.violations:
            break
        kept.add_phases(RefinedMotion(segments, found.x), check)
        start = found.x
    for factor in (1.0, *_RETREATS):
        candidate = RefinedMotion(segments, factor * found.x)
        if options.time_price is None:
            candidate = candidate.lasting(original.duration)
        now = cost.effort_and_cost(candidate.parameters)[1]
        if not now < best_cost:
            continue
        try:
            best, best_cost = judge.accept(candidate), now
        except TrajectoryError:
            continue
        break
    effort, total = cost.effort_and_cost(best.motion.parameters)
    return Refinement(
        best.motion, best.trajectory, best.check, before[1], total, before[0], effort, iterations
    )


@dataclass(frozen=True, eq=False)
class AcceptedMotion:
    """A refined motion that may be sent to the robot."""

    motion: RefinedMotion
    trajectory: Trajectory
    check: LimitCheck


class ExecutableMotions:
    """The validator for refinements of one motion."""

    def __init__(
        self,
        segments: Sequence[Motion],
        robot: Robot,
        limits: JointLimits,
        options: RefinementOptions,
        collision: CollisionModel | None,
    ) -> None:
        self._start = segments[0].start
        self._robot = robot
        self._limits = limits
        self._options = options
        self._collision = collision

    def check(self, motion: RefinedMotion) -> LimitCheck:
        """Compare a motion with the limits."""
        trajectory = motion.sample(self._robot, self._options.sample_period)
        return check_limits(trajectory, self._robot, self._limits)

    def accept(self, motion: RefinedMotion) -> AcceptedMotion:
        """Sample a motion; refuse one that must not be executed.

        Raises
        ------
        TrajectoryError
            If it breaks a limit or a rule of the controller, or the robot hits itself.
        """
        trajectory = motion.sample(self._robot, self._options.sample_period)
        check = check_limits(trajectory, self._robot, self._limits)
        allowed = self._options.allow_nonzero_end_velocity
        check_executable(trajectory, check, self._start, allow_nonzero_end_velocity=allowed)
        collisions = self._collision.collisions(trajectory) if self._collision else ()
        if collisions:
            raise TrajectoryError(str(collisions[0]))
        return AcceptedMotion(motion, trajectory, check)


class RefinementCost:
    """Effort, and the price of time, by the parameters of a refinement.

    Parameters
    ----------
    segments : sequence of Motion
        What is refined.
    robot : Robot
        The model.
    time_price : float or None
        Cost of a second; None for none.
    """

    def __init__(
        self, segments: Sequence[Motion], robot: Robot, time_price: float | None = None
    ) -> None:
        robot.require_inertias("refinements")
        self._segments = tuple(segments)
        self._robot = robot
        self._price = time_price or 0.0
        x, weights = legendre.leggauss(_N_NODES)
        self._phases, self._quadrature = (x + 1.0) / 2.0, weights / 2.0

    def effort_and_cost(self, parameters: FloatArray) -> tuple[float, float]:
        """½∫‖τ‖²dt [N²·m²·s], and that with the price of time."""
        effort = duration = 0.0
        for segment, part in zip(self._segments, _by_segment(parameters), strict=True):
            states = segment_states(segment, part, self._phases)
            tau = self._robot.inverse_dynamics(*states.values)
            effort += self._integral(tau, states.duration)
            duration += states.duration
        return effort, effort + self._price * duration

    def value_and_gradient(self, parameters: FloatArray) -> tuple[float, FloatArray]:
        """The cost and its gradient, by the parameters of all segments in one row."""
        total, gradient = 0.0, np.zeros((len(self._segments), N_PARAMETERS))
        for i, part in enumerate(_by_segment(parameters)):
            states = segment_states(self._segments[i], part, self._phases)
            tau, by_parameter = _efforts(self._robot, states)
            effort = self._integral(tau, states.duration)
            total += effort + self._price * states.duration
            weights = self._quadrature * states.duration
            gradient[i] = np.einsum("s,sj,sjp->p", weights, tau, by_parameter)
            # The time it takes weighs all of it.
            gradient[i, LOG_DURATION] += effort + self._price * states.duration
        return total, gradient.ravel()

    def _integral(self, tau: FloatArray, duration: float) -> float:
        return 0.5 * duration * float(self._quadrature @ np.sum(tau**2, axis=1))


class _Limits:
    """Limits at chosen phases as inequalities g(parameters) ≥ 0, of order 1."""

    def __init__(self, n_segments: int, robot: Robot, limits: JointLimits) -> None:
        self._robot = robot
        self._phases = [_CHECKED_PHASES] * n_segments
        span = np.where(np.isfinite(limits.upper - limits.lower), limits.upper - limits.lower, 1.0)
        self._bounds = [
            (limits.lower, limits.upper, span),
            *((-x, x, x) for x in (limits.velocity, limits.acceleration, limits.effort)),
        ]

    def add_phases(self, motion: RefinedMotion, check: LimitCheck) -> None:
        """Keep limits, too, where a check found them broken."""
        ends = np.cumsum(motion.durations)
        for violation in check.violations:
            i = min(int(np.searchsorted(ends, violation.time)), len(ends) - 1)
            phase = 1.0 - (ends[i] - violation.time) / motion.durations[i]
            self._phases[i] = np.unique([*self._phases[i], np.clip(phase, 0.0, 1.0)])

    def values_and_jacobian(
        self, segments: Sequence[Motion], parameters: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """The g and their derivative by the parameters of all segments in one row."""
        values, rows = [], []
        for i, part in enumerate(_by_segment(parameters)):
            states = segment_states(segments[i], part, self._phases[i])
            tau, by_parameter = _efforts(self._robot, states)
            quantities = [*zip(states.values, states.by_parameter, strict=True)]
            for (x, dx), (low, high, span) in zip(
                [*quantities, (tau, by_parameter)], self._bounds, strict=True
            ):
                for sign, bound in ((1.0, high), (-1.0, -low)):
                    limited = np.isfinite(bound)
                    room = (bound - sign * x)[:, limited] / span[limited] - _MARGIN
                    slope = -sign * dx[:, limited] / span[limited][:, None]
                    values.append(room.ravel())
                    block = np.zeros((room.size, parameters.size))
                    block[:, i * N_PARAMETERS : (i + 1) * N_PARAMETERS] = slope.reshape(
                        room.size, N_PARAMETERS
                    )
                    rows.append(block)
        return np.concatenate(values), np.concatenate(rows)


def _minimise(
    cost: RefinementCost,
    kept: _Limits,
    segments: Sequence[Motion],
    start: FloatArray,
    options: RefinementOptions,
) -> OptimizeResult:
    """Sequential least squares programming (SciPy) with the constraints that are near."""
    scale = max(cost.effort_and_cost(start)[1], np.finfo(float).tiny)

    def objective(x: FloatArray) -> tuple[float, FloatArray]:
        value, gradient = cost.value_and_gradient(x)
        return value / scale, gradient / scale

    near = kept.values_and_jacobian(segments, start)[0] < _NEAR
    constraints: list[dict[str, Any]] = []
    if near.any():
        constraints.append(
            {
                "type": "ineq",
                "fun": lambda x: kept.values_and_jacobian(segments, x)[0][near],
                "jac": lambda x: kept.values_and_jacobian(segments, x)[1][near],
            }
        )
    bounds = np.tile(BOUNDS, len(segments))
    timings = np.arange(len(segments)) * N_PARAMETERS + LOG_DURATION
    if options.time_price is None and len(segments) == 1:
        bounds[timings] = 0.0
    elif options.time_price is None:
        shares = np.array([segment.duration for segment in segments])
        shares /= shares.sum()
        rows = np.zeros((len(segments), start.size))
        rows[np.arange(len(segments)), timings] = 1.0
        constraints.append(
            {
                "type": "eq",
                "fun": lambda x: shares @ np.exp(rows @ x) - 1.0,
                "jac": lambda x: (shares * np.exp(rows @ x)) @ rows,
            }
        )
    return minimize(
        objective,
        start,
        jac=True,
        method="SLSQP",
        bounds=np.column_stack([-bounds, bounds]),
        constraints=constraints,
        options={"maxiter": options.max_iterations, "ftol": 1e-7},
    )


def _efforts(robot: Robot, states: SegmentStates) -> tuple[FloatArray, FloatArray]:
    """Efforts (n_steps, n_joints) and their derivatives (…, N_PARAMETERS)."""
    tau, dtau = robot.inverse_dynamics_derivatives(*states.values)
    _, n_steps, n_joints, n_parameters = states.by_parameter.shape
    stacked = states.by_parameter.transpose(1, 0, 2, 3).reshape(n_steps, 3 * n_joints, n_parameters)
    return tau, dtau @ stacked


def _by_segment(parameters: FloatArray) -> FloatArray:
    return np.reshape(parameters, (-1, N_PARAMETERS))
