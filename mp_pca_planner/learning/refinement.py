# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Off-line refinement: scaling and warping of least cost by the robot's model."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any

import numpy as np

from ..arrays import FloatArray, check_number
from ..exceptions import LearningError, TrajectoryError
from ..lazy import LazyModule
from ..motion.collision import Collision, CollisionModel
from ..motion.trajectory import Trajectory
from ..motion.validation import LimitCheck, check_executable, check_limits
from ..planning.motion import Motion
from ..planning.program.constraints import (
    CLEARANCE_REACH,
    N_CLEARANCE_PHASES,
    N_MORE_PHASES,
    least_distances,
    limit_shares,
)
from ..robot.limits import JointLimits
from ..robot.model import Robot
from .refined_motion import (
    AMPLITUDE,
    LOG_DURATION,
    N_PARAMETERS,
    RefinedMotion,
    segment_states,
)

if TYPE_CHECKING:
    from scipy.optimize import OptimizeResult

linalg, optimize = LazyModule("scipy.linalg"), LazyModule("scipy.optimize")

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
# Phases of a segment at which limits and clearances are constraints, besides those of violations
# and collisions found.
_N_PHASES = 40
# Step of the central differences by a parameter.
_STEP = 1e-5


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
    collision: CollisionModel | None = None,
    *,
    time_price: float | None = None,
    sample_period: float = 0.01,
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
    collision : CollisionModel, optional
        Collision model of the same robot. Pairs of bodies in which refinements collide are kept
        apart as in planning.
    time_price : float, optional
        Cost of a second, in units of the effort ½∫‖τ‖²dt a second. By default the total duration
        is kept; segments may still trade time with each other.
    sample_period : float
        Time between the points of the trajectory [s].

    Returns
    -------
    refinement : Refinement
        Never costlier than the original.

    Raises
    ------
    LearningError
        If the price of time is no number of at least 0.
    TrajectoryError
        If the original motion is not executable.
    RobotError
        If a moving link of the robot has no valid inertia.
    """
    if time_price is not None:
        check_number(time_price, "time_price", LearningError, 0.0)
    robot.require_inertias("refinements")
    judge = ExecutableMotions(segments, robot, limits, collision, time_price, sample_period)
    original = RefinedMotion(segments)
    best = judge.accept(original)
    original_cost = best_cost = judge.cost(original)
    kept, iterations = Constraints(judge), 0
    visited = [original.parameters.ravel()]
    for _ in range(_MAX_ROUNDS):
        optimum = _minimise(judge, kept, visited)
        iterations += int(optimum.nit)
        motion = RefinedMotion(segments, optimum.x)
        _, check, collisions = judge.examine(motion)
        if not (check.violations or collisions):
            break
        kept.add(motion, check, collisions)
        visited.append(optimum.x)
    for factor in (1.0, *_RETREATS):
        candidate = RefinedMotion(segments, factor * optimum.x)
        if time_price is None:
            candidate = candidate.lasting(original.duration)
        cost = judge.cost(candidate)
        if cost < best_cost:
            with suppress(TrajectoryError):
                best, best_cost = judge.accept(candidate), cost
                break
    costs = original_cost, best_cost, original.effort(robot), best.motion.effort(robot)
    return Refinement(best.motion, best.trajectory, best.check, *costs, iterations)


@dataclass(frozen=True, eq=False)
class ExecutableMotions:
    """The validator for refinements of one motion, see :func:`refine`."""

    segments: Sequence[Motion]
    robot: Robot
    limits: JointLimits
    collision: CollisionModel | None = None
    time_price: float | None = None
    sample_period: float = 0.01

    def cost(self, motion: RefinedMotion) -> float:
        """Effort of a motion [N²·m²·s], plus the price of its duration."""
        return motion.effort(self.robot) + (self.time_price or 0.0) * motion.duration

    def examine(
        self, motion: RefinedMotion
    ) -> tuple[Trajectory, LimitCheck, tuple[Collision, ...]]:
        """The points of a motion, their comparison with the limits, and collisions if checked."""
        trajectory = motion.sample(self.robot, self.sample_period)
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
        check_executable(trajectory, check, self.segments[0].start)
        if collisions:
            raise TrajectoryError(str(collisions[0]))
        return AcceptedMotion(motion, trajectory, check)


def _minimise(
    judge: ExecutableMotions, kept: Constraints, visited: Sequence[FloatArray]
) -> OptimizeResult:
    """Sequential least squares programming (SciPy) with constraints that are near.

    It starts from the original motion, the first of those visited. From within a collision, it
    might leave that on the other side. Constraints that were near for any visited motion count.
    """
    segments, start = judge.segments, visited[0]
    scale = max(judge.cost(RefinedMotion(segments)), np.finfo(float).tiny)

    def cost(segment: Motion, parameters: FloatArray) -> float:
        return judge.cost(RefinedMotion([segment], parameters)) / scale

    def total(x: FloatArray) -> float:
        return sum(map(cost, segments, _by_segment(x)))

    def gradient(x: FloatArray) -> FloatArray:
        parts = zip(segments, _by_segment(x), strict=True)
        return np.concatenate([_slopes(partial(cost, segment), part) for segment, part in parts])

    near = np.min([kept.values(x) for x in visited], axis=0) < _NEAR
    constraints: list[dict[str, Any]] = [
        {
            "type": "ineq",
            "fun": lambda x: kept.values(x)[near],
            "jac": lambda x: kept.jacobian(x)[near],
        }
    ]
    if judge.time_price is None:
        shares = np.array([segment.duration for segment in segments])
        shares /= shares.sum()
        constraints.append(
            {
                "type": "eq",
                "fun": lambda x: shares @ np.exp(_by_segment(x)[:, LOG_DURATION]) - 1.0,
            }
        )
    bounds = parameter_bounds(len(segments)).ravel()
    return optimize.minimize(
        total,
        start,
        jac=gradient,
        method="SLSQP",
        bounds=np.column_stack([-bounds, bounds]),
        constraints=constraints,
        options={"maxiter": _MAX_ITERATIONS, "ftol": 1e-7},
    )


class Constraints:
    """Limits and clearances at some phases of each segment, as inequalities g(parameters) ≥ 0.

    The values are the shares of the limits that are left, and distances [m] of the pairs of bodies
    that collided in a refinement.

    Parameters
    ----------
    judge : ExecutableMotions
        The original motion, the robot and its limits.

    Attributes
    ----------
    phases : list of array
        The phases of each segment, from 0 to 1, increasing.
    """

    def __init__(self, judge: ExecutableMotions) -> None:
        self._judge = judge
        self.phases = [np.linspace(0.0, 1.0, _N_PHASES)] * len(judge.segments)
        self._pairs = np.zeros(0, dtype=np.intp)

    @cached_property
    def _least(self) -> list[FloatArray]:
        """Least distances in each segment: bodies may come as near as in the original."""
        assert self._judge.collision is not None
        times = np.linspace(0.0, 1.0, N_CLEARANCE_PHASES + 1)
        paths = [one.evaluate(one.duration * times)[0] for one in self._judge.segments]
        return [least_distances(q, self._judge.collision) for q in paths]

    def add(
        self, motion: RefinedMotion, check: LimitCheck, collisions: Sequence[Collision]
    ) -> None:
        """Add the phases and the pairs of bodies at which a motion failed."""
        met = [np.linspace(one.first_time, one.last_time, N_MORE_PHASES) for one in collisions]
        times = np.concatenate([[one.time for one in check.violations], *met])
        ends = np.cumsum(motion.durations)
        for i, (end, duration) in enumerate(zip(ends, motion.durations, strict=True)):
            phases = 1.0 - (end - times) / duration
            inside = phases[(phases >= 0.0) & (phases <= 1.0)]
            self.phases[i] = np.union1d(self.phases[i], inside)
        self._pairs = np.union1d(self._pairs, [one.pair for one in collisions]).astype(np.intp)

    def values(self, x: FloatArray) -> FloatArray:
        """The values g for the parameters of all segments in one row."""
        return np.concatenate([self._of_segment(i, x_i) for i, x_i in enumerate(_by_segment(x))])

    def jacobian(self, x: FloatArray) -> FloatArray:
        """Their derivatives, shape (n_values, n_parameters)."""
        parts = enumerate(_by_segment(x))
        blocks = [_slopes(partial(self._of_segment, i), x_i) for i, x_i in parts]
        return np.asarray(linalg.block_diag(*blocks))

    def _of_segment(self, i: int, parameters: FloatArray) -> FloatArray:
        """The values of one segment."""
        judge = self._judge
        states = segment_states(judge.segments[i], parameters, self.phases[i])
        shares = limit_shares(judge.limits, states, judge.robot.inverse_dynamics(*states[:3]))
        # Only jerks are free at the ends.
        shares[np.ix_([0, 1, 2, 4], [0, -1])] = 0.0
        values = (1.0 - MARGIN - shares).ravel()
        if not self._pairs.size:
            return np.asarray(values)
        assert judge.collision is not None
        # Distances beyond the reach are not known.
        bounds = judge.collision.near(states[0], CLEARANCE_REACH).bounds[:, self._pairs]
        room = np.minimum(bounds, CLEARANCE_REACH) - self._least[i][self._pairs]
        return np.concatenate([values, room.ravel()])


def _slopes(
    function: Callable[[FloatArray], FloatArray | float], parameters: FloatArray
) -> FloatArray:
    """Derivatives of a function by the parameters of a segment, in the last axis."""
    slopes = [
        np.subtract(function(parameters + step), function(parameters - step)) / (2.0 * _STEP)
        for step in _STEP * np.eye(N_PARAMETERS)
    ]
    return np.asarray(np.stack(slopes, axis=-1))


def _by_segment(parameters: FloatArray) -> FloatArray:
    return np.reshape(parameters, (-1, N_PARAMETERS))
