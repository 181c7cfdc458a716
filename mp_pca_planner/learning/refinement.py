# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Off-line refinement: scaling and warping of least cost by the robot's model."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray
from scipy.optimize import OptimizeResult, minimize

from ..arrays import FloatArray
from ..exceptions import GoalError, TrajectoryError
from ..motion.collision import Collision, CollisionModel
from ..motion.trajectory import Trajectory
from ..motion.validation import LimitCheck, check_executable, check_limits
from ..planning.motion import Motion
from ..planning.options import ClearanceOptions
from ..planning.program.clearance import least_distances, with_phases_of
from ..robot.limits import JointLimits
from ..robot.model import Robot
from .refined_motion import (
    AMPLITUDE,
    LOG_DURATION,
    N_PARAMETERS,
    RefinedMotion,
    SegmentStates,
    segment_states,
)

MARGIN = 1e-3
"""Share of each limit that is kept free, because constraints hold only at some phases."""

# Most iterations of the optimiser.
_MAX_ITERATIONS = 100
# Optimisations, each with the violations of the one before as constraints.
_MAX_ROUNDS = 6
# Factors that reduce a refinement that violates limits or in which bodies collide.
_RETREATS = (0.95, 0.8, 0.5, 0.25)
# Largest change of the amplitude as a share of it; 1 allows 0 to twice the original.
_MAX_AMPLITUDE_CHANGE = 1.0
# Largest factor by which a segment becomes slower or faster, > 1.
_MAX_TIME_FACTOR = 3.0
# Largest magnitude of a parameter of the time warp; at 3 time runs about three times as fast or
# slow.
_MAX_WARP = 3.0
# Distance to a limit, as a share of it, within which it is an initial constraint.
_NEAR = 0.4
# Quadrature nodes of a segment, and its phases at which limits are constraints, besides those of
# violations found.
_N_NODES, _N_PHASES = 40, 25


@dataclass(frozen=True)
class RefinementOptions:
    """Options of refinement and of learning by trials.

    Attributes
    ----------
    time_price : float or None
        Cost of a second, in units of the effort ½∫‖τ‖²dt a second. None keeps the total
        duration; segments may still trade time with each other.
    sample_period : float
        Time between the points of the trajectory [s].
    allow_nonzero_end_velocity : bool
        Whether the controller accepts motions that don't end at rest.
    seed : int
        Seed of the trials: the same seed and costs give the same trials.

    Raises
    ------
    GoalError
        If an option is out of its range.
    """

    time_price: float | None = None
    sample_period: float = 0.01
    allow_nonzero_end_velocity: bool = False
    seed: int = 0

    def __post_init__(self) -> None:
        price = self.time_price
        if price is not None and not (np.isfinite(price) and price >= 0.0):
            raise GoalError(f"time_price must be a number ≥ 0, got {price}")
        if not 1e-4 <= self.sample_period <= 1.0:
            raise GoalError(f"sample_period must be 0.0001 to 1 s, got {self.sample_period}")


def parameter_bounds(n_segments: int) -> FloatArray:
    """Largest magnitudes of the parameters, shape (n_segments, N_PARAMETERS)."""
    bounds = np.full((n_segments, N_PARAMETERS), _MAX_WARP)
    bounds[:, AMPLITUDE] = _MAX_AMPLITUDE_CHANGE
    bounds[:, LOG_DURATION] = np.log(_MAX_TIME_FACTOR)
    return bounds


@dataclass(frozen=True, eq=False)
class AcceptedMotion:
    """A refined motion that may be sent to the robot.

    Attributes
    ----------
    motion : RefinedMotion
        The motion.
    trajectory : Trajectory
        Its points; executable.
    check : LimitCheck
        Comparison with the limits.
    """

    motion: RefinedMotion
    trajectory: Trajectory
    check: LimitCheck


@dataclass(frozen=True, eq=False)
class Refinement(AcceptedMotion):
    """Result of refining a motion: the best one found, or the original.

    Attributes
    ----------
    original_cost, cost : float
        Cost before and after: effort ½∫‖τ‖²dt, plus the price of the duration if it has one.
    original_effort, effort : float
        The effort alone.
    iterations : int
        Iterations of the optimiser.
    """

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
        Bounds, price of time and sampling.
    collision : CollisionModel, optional
        Collision model of the same robot. Pairs of bodies in which refinements collide are kept
        apart as in planning.

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
    kept = LimitConstraints(len(segments), robot, limits)
    apart = ClearanceConstraints(segments, collision)
    visited = [np.zeros(len(segments) * N_PARAMETERS)]
    for _ in range(_MAX_ROUNDS):
        found = _minimise(cost, [kept, apart], segments, visited, options)
        iterations += int(found.nit)
        motion = RefinedMotion(segments, found.x)
        _, check, collisions = judge.examine(motion)
        if not (check.violations or collisions):
            break
        kept.add_phases(motion, check)
        apart.add(motion, collisions)
        visited.append(found.x)
    for factor in (1.0, *_RETREATS):
        candidate = RefinedMotion(segments, factor * found.x)
        if options.time_price is None:
            candidate = candidate.lasting(original.duration)
        now = cost.effort_and_cost(candidate.parameters)[1]
        if now < best_cost:
            with suppress(TrajectoryError):
                best, best_cost = judge.accept(candidate), now
                break
    effort, total = cost.effort_and_cost(best.motion.parameters)
    return Refinement(
        best.motion, best.trajectory, best.check, before[1], total, before[0], effort, iterations
    )


@dataclass(frozen=True, eq=False)
class ExecutableMotions:
    """The validator for refinements of one motion.

    Attributes
    ----------
    segments : sequence of Motion
        The original motion.
    robot : Robot
        The model.
    limits : JointLimits
        Limits of the joints.
    options : RefinementOptions
        Sampling of trajectories.
    collision : CollisionModel or None
        Collision model of the same robot.
    """

    segments: Sequence[Motion]
    robot: Robot
    limits: JointLimits
    options: RefinementOptions
    collision: CollisionModel | None = None

    def examine(
        self, motion: RefinedMotion
    ) -> tuple[Trajectory, LimitCheck, tuple[Collision, ...]]:
        """The points of a motion, their comparison with the limits, and collisions if checked."""
        trajectory = motion.sample(self.robot, self.options.sample_period)
        collisions = self.collision.collisions(trajectory) if self.collision else ()
        return trajectory, check_limits(trajectory, self.robot, self.limits), collisions

    def accept(self, motion: RefinedMotion) -> AcceptedMotion:
        """Sample a motion; refuse one that must not be executed.

        Raises
        ------
        TrajectoryError
            If it violates a limit or a rule of the controller, or bodies collide.
        """
        trajectory, check, collisions = self.examine(motion)
        allowed = self.options.allow_nonzero_end_velocity
        check_executable(
            trajectory, check, self.segments[0].start, allow_nonzero_end_velocity=allowed
        )
        if collisions:
            raise TrajectoryError(str(collisions[0]))
        return AcceptedMotion(motion, trajectory, check)


def _minimise(
    cost: RefinementCost,
    kept: Sequence[LimitConstraints | ClearanceConstraints],
    segments: Sequence[Motion],
    visited: Sequence[FloatArray],
    options: RefinementOptions,
) -> OptimizeResult:
    """Sequential least squares programming (SciPy) with constraints that are near.

    It starts from the original motion, the first of those visited. From within a collision, it
    might leave that on the other side. Constraints that were near for any visited motion count.
    """
    start = visited[0]
    scale = max(cost.effort_and_cost(start)[1], np.finfo(float).tiny)

    def objective(x: FloatArray) -> tuple[float, FloatArray]:
        value, gradient = cost.value_and_gradient(x)
        return value / scale, gradient / scale

    constraints: list[dict[str, Any]] = []
    for terms in kept:
        values = [terms.values_and_jacobian(segments, x)[0] for x in visited]
        near = np.min(values, axis=0) < _NEAR
        if near.any():
            constraints.append(_inequality(terms, segments, near))
    if options.time_price is None:
        shares = np.array([segment.duration for segment in segments])
        # Rows that pick the logarithms of the durations out of the parameters.
        pick = np.eye(start.size)[LOG_DURATION::N_PARAMETERS]
        shares /= shares.sum()
        constraints.append(
            {
                "type": "eq",
                "fun": lambda x: shares @ np.exp(pick @ x) - 1.0,
                "jac": lambda x: (shares * np.exp(pick @ x)) @ pick,
            }
        )
    bounds = parameter_bounds(len(segments)).ravel()
    return minimize(
        objective,
        start,
        jac=True,
        method="SLSQP",
        bounds=np.column_stack([-bounds, bounds]),
        constraints=constraints,
        options={"maxiter": _MAX_ITERATIONS, "ftol": 1e-7},
    )


def _inequality(
    terms: LimitConstraints | ClearanceConstraints,
    segments: Sequence[Motion],
    chosen: NDArray[np.bool_],
) -> dict[str, Any]:
    """Some rows of a constraint for SciPy."""
    return {
        "type": "ineq",
        "fun": lambda x: terms.values_and_jacobian(segments, x)[0][chosen],
        "jac": lambda x: terms.values_and_jacobian(segments, x)[1][chosen],
    }


class RefinementCost:
    """Effort, and the price of time, by the parameters of a refinement.

    Parameters
    ----------
    segments : sequence of Motion
        The motions to refine.
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
        return self._evaluated(parameters)[:2]

    def value_and_gradient(self, parameters: FloatArray) -> tuple[float, FloatArray]:
        """The cost and its gradient, by the parameters of all segments in one row."""
        return self._evaluated(parameters)[1:]

    def _evaluated(self, parameters: FloatArray) -> tuple[float, float, FloatArray]:
        """Effort, cost and its gradient."""
        efforts, total, gradient = 0.0, 0.0, np.zeros((len(self._segments), N_PARAMETERS))
        for i, part in enumerate(_by_segment(parameters)):
            states = segment_states(self._segments[i], part, self._phases)
            tau, by_parameter = _efforts(self._robot, states)
            weights = self._quadrature * states.duration
            effort = 0.5 * float(weights @ np.sum(tau**2, axis=1))
            cost = effort + self._price * states.duration
            efforts, total = efforts + effort, total + cost
            gradient[i] = np.einsum("s,sj,sjp->p", weights, tau, by_parameter)
            # The cost is proportional to the duration.
            gradient[i, LOG_DURATION] += cost
        return efforts, total, gradient.ravel()


class LimitConstraints:
    """Limits at chosen phases as inequalities g(parameters) ≥ 0, of order 1.

    Parameters
    ----------
    n_segments : int
        Segments of the motion.
    robot : Robot
        The model.
    limits : JointLimits
        Limits of the joints.
    """

    def __init__(self, n_segments: int, robot: Robot, limits: JointLimits) -> None:
        self._robot = robot
        self._phases = [np.linspace(0.02, 0.98, _N_PHASES)] * n_segments
        # Rows: positions, velocities, accelerations, efforts and jerks.
        magnitudes = (limits.velocity, limits.acceleration, limits.effort, limits.jerk)
        upper = np.stack([limits.upper, *magnitudes])
        lower = np.stack([limits.lower, *(-x for x in magnitudes)])
        span = np.stack([limits.upper - limits.lower, *magnitudes])
        self._span = np.where(np.isfinite(span), span, 1.0)
        bounds = np.stack([upper, lower])
        self._is_limited = np.isfinite(bounds)
        self._bounds = np.where(self._is_limited, bounds, 0.0)

    def add_phases(self, motion: RefinedMotion, check: LimitCheck) -> None:
        """Add the phases at which a check found violations."""
        ends = np.cumsum(motion.durations)
        for violation in check.violations:
            i = min(int(np.searchsorted(ends, violation.time)), len(ends) - 1)
            phase = 1.0 - (ends[i] - violation.time) / motion.durations[i]
            self._phases[i] = np.unique([*self._phases[i], np.clip(phase, 0.0, 1.0)])

    def values_and_jacobian(
        self, segments: Sequence[Motion], parameters: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Values of g, and their derivatives by the parameters of all segments in one row."""
        values, rows = [], []
        signs = np.array([1.0, -1.0])[:, None, None, None]
        for i, part in enumerate(_by_segment(parameters)):
            states = segment_states(segments[i], part, self._phases[i])
            tau, by_parameter = _efforts(self._robot, states)
            jerks, of_jerks = _jerks(segments[i], part, self._phases[i])
            x = np.concatenate([states.values, tau[None], jerks[None]])
            dx = np.concatenate([states.by_parameter, by_parameter[None], of_jerks[None]])
            room = signs * (self._bounds[:, :, None] - x) / self._span[:, None] - MARGIN
            slope = -signs[..., None] * dx / self._span[:, None, :, None]
            limited = np.broadcast_to(self._is_limited[:, :, None], room.shape)
            values.append(room[limited])
            rows.append(np.zeros((values[-1].size, parameters.size)))
            rows[-1][:, i * N_PARAMETERS : (i + 1) * N_PARAMETERS] = slope[limited]
        return np.concatenate(values), np.concatenate(rows)


class ClearanceConstraints:
    """Distances of the pairs of bodies that collided, as inequalities g(parameters) ≥ 0 [m].

    Parameters
    ----------
    segments : sequence of Motion
        The motions to refine.
    collision : CollisionModel or None
        Computes the distances, if collisions are avoided.
    """

    def __init__(self, segments: Sequence[Motion], collision: CollisionModel | None) -> None:
        self._model = collision
        # Of each segment.
        self._phases, self._least = list[FloatArray](), list[FloatArray]()
        self._pairs = np.zeros(0, dtype=np.intp)
        if collision is not None:
            phases = np.linspace(0.0, 1.0, ClearanceOptions().n_phases + 1)
            for one in segments:
                q, _, _ = one.evaluate(phases * one.duration)
                # Bodies may come as near to each other as in the original.
                self._least.append(least_distances(q, collision))
                self._phases.append(phases[1:-1])

    def add(self, motion: RefinedMotion, collisions: Sequence[Collision]) -> None:
        """Constrain the pairs of some collisions of a motion."""
        ended = np.cumsum(motion.durations)
        for i, (end, duration) in enumerate(zip(ended, motion.durations, strict=True)):
            own = [one.within(end - duration, end) for one in collisions]
            met = [one for one in own if one is not None]
            if met:
                n_more = ClearanceOptions().n_more
                self._phases[i] = with_phases_of(met, self._phases[i], duration, n_more)
        self._pairs = np.union1d(self._pairs, [one.pair for one in collisions]).astype(np.intp)

    def values_and_jacobian(
        self, segments: Sequence[Motion], parameters: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """See :meth:`LimitConstraints.values_and_jacobian`."""
        values, rows = [np.zeros(0)], [np.zeros((0, parameters.size))]
        if not self._pairs.size:
            return values[0], rows[0]
        assert self._model is not None
        for i, part in enumerate(_by_segment(parameters)):
            states = segment_states(segments[i], part, self._phases[i])
            near = self._model.near(states.values[0], ClearanceOptions().reach)
            values.append((near.bounds - self._least[i])[:, self._pairs].ravel())
            slopes = np.zeros((*near.bounds.shape, parameters.size))
            own = slice(i * N_PARAMETERS, (i + 1) * N_PARAMETERS)
            by_parameter = states.by_parameter[0][near.configurations]
            slopes[near.configurations, near.pairs, own] = np.einsum(
                "ej,ejp->ep", near.rows, by_parameter
            )
            rows.append(slopes[:, self._pairs].reshape(-1, parameters.size))
        return np.concatenate(values), np.concatenate(rows)


def _efforts(robot: Robot, states: SegmentStates) -> tuple[FloatArray, FloatArray]:
    """Efforts (n_steps, n_joints) and their derivatives (…, N_PARAMETERS)."""
    tau, dtau = robot.inverse_dynamics_derivatives(*states.values)
    _, n_steps, n_joints, n_parameters = states.by_parameter.shape
    stacked = states.by_parameter.transpose(1, 0, 2, 3).reshape(n_steps, 3 * n_joints, n_parameters)
    return tau, dtau @ stacked


def _jerks(
    segment: Motion, parameters: FloatArray, phases: FloatArray, step: float = 1e-4
) -> tuple[FloatArray, FloatArray]:
    """Jerks (n_steps, n_joints) and their derivatives (…, N_PARAMETERS), by differences.

    The first and the last are those at the ends, where jerks are often largest.
    """
    at = np.concatenate([[0.0], phases[1:-1], [1.0]])
    around = np.clip([at - step, at + step], 0.0, 1.0)
    states = segment_states(segment, parameters, around.ravel())
    behind, ahead = states.values[2].reshape(2, len(at), -1)
    shape = (2, *ahead.shape, N_PARAMETERS)
    by_behind, by_ahead = states.by_parameter[2].reshape(shape)
    times = states.duration * (around[1] - around[0])[:, None]
    jerks = (ahead - behind) / times
    by_parameter = (by_ahead - by_behind) / times[..., None]
    by_parameter[..., LOG_DURATION] -= jerks  # the time between the two states grows, too
    return jerks, by_parameter


def _by_segment(parameters: FloatArray) -> FloatArray:
    return np.reshape(parameters, (-1, N_PARAMETERS))
