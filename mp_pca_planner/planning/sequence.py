# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Sequences of primitives through configurations and poses, joined to the second derivative.

Between the vias, each segment is a motion q(s) = h(s) + μ(s) + Σ wₖ φₖ(s) of the primitive whose
demonstrations are nearest. As shapes vanish with two derivatives at both ends, segments join in
position, velocity and acceleration as soon as their boundary parts h do, whatever the weights.

*In real time*, nothing is optimised: the boundary parts together are the quintic spline of least
jerk through the vias (de Boor, "A Practical Guide to Splines", 1978: one banded system), with the
expected weights and durations.

*Optimal* are the weights, the velocities and accelerations at the vias, and the durations of all
segments together, by a Levenberg–Marquardt method on the sum of squares ½∫‖τ‖²dt and the
naturalness of each segment: how far it is from the one joined in real time, in spreads of the
demonstrations. A segment shares unknowns with its neighbours only, so that the
Hessian is banded, and an iteration costs time linear in the number of segments. The durations
between two fixed times keep their sum.

A pose is first reached in that of several configurations which makes the sequence most like the
demonstrations. In an optimal sequence its configuration is one more unknown, which steps keep,
to first order, at the pose; each is then brought back to it to the last digits.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, cho_solve_banded, cholesky_banded

from ..arrays import FloatArray
from ..exceptions import GoalError, TrajectoryError
from ..goal import JointState, Pose, SequenceGoal
from ..limits import JointLimits
from ..primitives.basis import Basis
from ..primitives.boundary import boundary_values, hermite_functions
from ..primitives.primitive import MovementPrimitive
from ..primitives.statistics import Conditional
from ..robot import Robot
from ..trajectory import Trajectory
from ..validation import LimitCheck, check_executable, check_limits
from .collision import NOT_CHECKED, Collision, CollisionModel
from .compiler import QuadratureTables
from .conditions import JointTarget, PoseTarget, Target
from .motion import Motion
from .planner import INFEASIBLE, LONGEST_DURATION, SOLVED, STOPPED_EARLY
from .pose_search import (
    POSE_TOLERANCE,
    configurations_at,
    nearest_configuration,
    starts_near,
)
from .selection import Selector, effort_of
from .states import check_within_limits, completed, in_order, unwrapped

REAL_TIME, OPTIMAL = "real_time", "optimal"
MODES = (REAL_TIME, OPTIMAL)

_MOST_ITERATIONS = 60
_TOLERANCE = 1e-5
_RAN_OUT = "time or iterations ran out before"
# Spread of the logarithm of durations that is as natural as a standard deviation of weights.
_DURATION_SPREAD = 0.3
# Passing at speed bends segments by more than demonstrations from rest to rest show: this many of
# their standard deviations count as one (`benchmarks/sequences.py` shows what comes of it). Where
# a joint hardly spreads, the deviation is at least this [rad or m].
_BEND_SPREAD, _LEAST_SPREAD = 12.0, 0.01
# Weights of what is out of limits (as shares of them), next to the whole cost, in turn, and how
# far inside of the limits motions are kept.
_PENALTIES = ((0.0, 0.0), (30.0, 0.02), (1e3, 0.02), (3e4, 0.03))
_MOST_STRETCHES = 12
_MOST_TARGETS = 200
# Targets at the beginning that the robot is this near to are passed already, and targets that are
# this near to each other the same [rad or m].
_HERE, _SAME = 0.01, 1e-6
# Configurations that reach a pose which are weighed against each other.
_MOST_CONFIGURATIONS = 6
# Passing velocities are lowered in these steps where a position limit is overshot.
_SLOWER = (1.0, 0.5, 0.25, 0.0)


@dataclass(frozen=True, eq=False)
class SequencePlan:
    """What came of a request for a sequence.

    Attributes
    ----------
    status : str
        'solved'. 'stopped_early': executable, but time or iterations ran out before the least
        effort was found. 'infeasible': must not be executed.
    message : str
        One sentence for a person.
    mode : {'real_time', 'optimal'}
        How it was made; 'real_time' also if no optimal motion within the limits was found.
    trajectory : Trajectory
        The sampled motion; the vias are among its points.
    motions : tuple of Motion
        The segments, each starting in the state in which the one before ends.
    primitives : tuple of str
        Names of their primitives.
    in_span_score : float
        The largest of the segments: how far outside the demonstrations they lie.
    effort_cost : float
        ½∫‖τ‖²dt of the whole [N²·m²·s].
    iterations : int
        Passes over the segments.
    limit_check : LimitCheck
        Comparison with the limits on a grid of at most 1 ms.
    start_error, goal_error, via_error : float
        Largest distance of the trajectory from the present position, from the last target and
        from those before [rad or m].
    solve_time : float
        Time taken to find the motion, without its checks [s].
    """

    status: str
    message: str
    mode: str
    trajectory: Trajectory
    motions: tuple[Motion, ...]
    primitives: tuple[str, ...]
    in_span_score: float
    effort_cost: float
    iterations: int
    limit_check: LimitCheck
    start_error: float
    goal_error: float
    via_error: float
    solve_time: float

    @property
    def is_executable(self) -> bool:
        """Whether the trajectory may be sent to a robot."""
        return self.status != INFEASIBLE

    def summary(self) -> dict[str, str | float | int]:
        """Scalar facts, by the names of the package's public interface."""
        return {
            "status": self.status,
            "message": self.message,
            "mode": self.mode,
            "primitive": ", ".join(self.primitives),
            "n_segments": len(self.motions),
            "duration": self.trajectory.duration,
            "effort_cost": self.effort_cost,
            "iterations": self.iterations,
            "solve_time_s": self.solve_time,
            "in_span_score": self.in_span_score,
            "limit_violation": self.limit_check.worst_excess,
            "start_error": self.start_error,
            "goal_error": self.goal_error,
            "via_error": self.via_error,
        }


class SequencePlanner:
    """Plans motions through several configurations and poses.

    Parameters
    ----------
    robot : Robot
        The model, with the joints of the primitives in their order.
    primitives : sequence of MovementPrimitive
        At least one.
    limits : JointLimits
        Limits of the joints.
    naturalness : float
        ρ, see :class:`.PlannerOptions`.
    sample_period : float
        Longest time between the points of a trajectory [s].
    max_solve_time : float
        Longest time for the search [s]; the best motion found by then is returned.
    collision : CollisionModel, optional
        Of the same robot, not shared between threads: an optimal motion in which the robot hits
        itself gives way to the one joined in real time, which is nearer to the demonstrations.
    """

    def __init__(
        self,
        robot: Robot,
        primitives: Sequence[MovementPrimitive],
        limits: JointLimits,
        *,
        naturalness: float = 1.0,
        sample_period: float = 0.01,
        max_solve_time: float = float("inf"),
        collision: CollisionModel | None = None,
    ) -> None:
        self.robot = robot
        self.primitives = tuple(primitives)
        self._selector = Selector(robot, primitives)
        self.limits = limits
        self._naturalness = naturalness
        self._period = sample_period
        self._max_solve_time = max_solve_time
        self._collision = collision

    def plan(self, goal: SequenceGoal, start: JointState, mode: str = OPTIMAL) -> SequencePlan:
        """Plan a motion through the configurations and poses of a goal.

        Parameters
        ----------
        goal : SequenceGoal
            Where to go. Targets at the beginning where the robot is already are passed.
        start : JointState
            Present state of all joints.
        mode : {'real_time', 'optimal'}
            Whether to optimise. If that finds no motion within the limits, the one in real time is
            returned. If the limits can't be kept in durations that the goal leaves free, these
            are lengthened.

        Raises
        ------
        GoalError
            If the goal or the state can't be used.
        RobotError
            If a pose is of no frame of the robot.
        """
        if mode not in MODES:
            raise GoalError(f"the mode of a sequence must be one of {MODES}, got {mode!r}")
        began = time.perf_counter()
        deadline = began + self._max_solve_time
        request = self._complete(goal, start)
        request.concatenate()
        found = time.perf_counter() - began
        quick, check = self._within_limits(request, deadline)
        iterations, chosen = 0, quick
        note = "motion concatenated in real time"
        used, status = REAL_TIME, SOLVED
        if mode == OPTIMAL:
            began = time.perf_counter()
            better, better_check, iterations, converged = self._optimise(request, quick, deadline)
            found += time.perf_counter() - began
            status = SOLVED if converged else STOPPED_EARLY
            collisions = () if better_check.violations else self._collisions(better)
            if collisions:
                note += f", for in the optimal one {collisions[0]}"
            elif not better_check.violations:
                chosen, check, used = better, better_check, OPTIMAL
                note = "motion of least effort found"
                if not converged:
                    note = f"{_RAN_OUT} the least effort was found"
            elif converged:
                note += ", for no cheaper one within the limits was found"
            else:
                note += f", for {_RAN_OUT} a cheaper one within the limits was found"
        usual = sum(request.durations)
        total = sum(x.duration for x in chosen)
        if total > usual * (1.0 + 1e-9):
            note += f"; to keep the limits, it was lengthened from {usual:.3g} to {total:.3g} s"
        return self._judge(request, chosen, check, status, note, used, iterations, found)

    def _complete(self, goal: SequenceGoal, start: JointState) -> _Request:
        self._check_size(goal)
        here = in_order(start, self.robot.joint_names)
        check_within_limits("present", here, self.limits)
        selector = self._selector.among(goal.primitive)
        n_passed = self._n_passed(goal, here)
        goal = replace(
            goal,
            targets=goal.targets[n_passed:],
            times=goal.times[n_passed:],
            stops=goal.stops[n_passed:],
        )
        states = self._route(goal, here, selector, n_passed + 1)
        chosen = [selector.choose(a.positions, b.positions).first for a, b in pairwise(states)]
        expected = [one.expected for one in chosen]
        durations = _fit_durations([e.duration for e in expected], goal.times)
        if sum(durations) > LONGEST_DURATION:
            raise GoalError(
                f"the sequence would take {sum(durations):.4g} s, at most {LONGEST_DURATION:g} s "
                "are accepted"
            )
        groups = _groups(goal.times)
        return _Request(
            tuple(states),
            tuple(map(self._target, goal.targets, states[1:])),
            (*goal.stops[:-1], True),
            tuple(one.primitive for one in chosen),
            tuple(expected),
            durations,
            groups,
        )

    def _target(self, target: JointState | Pose, there: JointState) -> Target:
        if isinstance(target, Pose):
            return PoseTarget(self.robot, target)
        n = self.robot.n_joints
        return JointTarget(np.arange(n), there.positions, n)

    def _route(
        self, goal: SequenceGoal, here: JointState, selector: Selector, first_number: int
    ) -> tuple[JointState, ...]:
        """The states at the start and the targets, most like the demonstrations.

        Where poses leave a choice, the sum of squared in-span scores is least (dynamic
        programming over the configurations that were found).
        """
        known = np.concatenate([p.boundary_states[:, [0, 3]] for p in selector.primitives])
        known = known.reshape(-1, self.robot.n_joints)
        routes = [_Route(0.0, (here,))]
        for number, target in enumerate(goal.targets, first_number):
            if isinstance(target, Pose):
                routes = self._through(target, number, routes, known, selector)
                continue
            what = f"target {number}"
            longer = []
            for route in routes:
                positions = completed(target, route.states[-1], self.robot, what).positions
                there = JointState(here.joint_names, positions)
                check_within_limits(what, there, self.limits)
                longer.append(route.to(there, selector))
            named_all = len(target.joint_names) == self.robot.n_joints
            routes = [min(longer, key=lambda route: route.cost)] if named_all else longer
        states = min(routes, key=lambda route: route.cost).states
        for number, (a, b) in enumerate(pairwise(states[1:]), first_number):
            if np.abs(a.positions - b.positions).max() <= _SAME:
                # To the optimiser, a way to nowhere is time for any swing.
                raise GoalError(
                    f"targets {number} and {number + 1} of the sequence are the same: give it once"
                )
        return states

    def _n_passed(self, goal: SequenceGoal, here: JointState) -> int:
        """The number of targets at the beginning where the robot is already."""
        for n_passed, (target, when) in enumerate(
            zip(goal.targets[:-1], goal.times[:-1], strict=True)
        ):
            if isinstance(target, JointState):
                there = completed(target, here, self.robot, f"target {n_passed + 1}")
                missed = there.positions - here.positions
            else:
                missed = PoseTarget(self.robot, target).error(here.positions)[0]
            if np.abs(missed).max() > _HERE:
                return n_passed
            if when is not None:
                raise GoalError(
                    f"target {n_passed + 1} of the sequence is where the robot is, and is to be "
                    f"passed at {when:g} s: to wait there, send the sequence later"
                )
        return len(goal.targets) - 1

    def _through(
        self,
        pose: Pose,
        number: int,
        routes: Sequence[_Route],
        known: FloatArray,
        selector: Selector,
    ) -> list[_Route]:
        """The best route to each of the configurations that reach a pose."""
        starts = [route.states[-1].positions for route in routes]
        starts += starts_near(self.robot, pose, known)
        try:
            found = configurations_at(self.robot, self.limits, pose, starts)
        except GoalError as error:
            raise GoalError(f"target {number}: {error}") from None
        longer = []
        for q in found[:_MOST_CONFIGURATIONS]:
            ways = []
            for route in routes:
                before = route.states[-1]
                there = JointState(before.joint_names, unwrapped(q, before, self.robot))
                ways.append(route.to(there, selector))
            longer.append(min(ways, key=lambda route: route.cost))
        return longer

    def _check_size(self, goal: SequenceGoal) -> None:
        """Refuse what would take all time or memory, before it does."""
        if len(goal.targets) > _MOST_TARGETS:
            raise GoalError(
                f"the sequence has {len(goal.targets)} targets, at most {_MOST_TARGETS} are "
                "accepted"
            )
        last = max((when for when in goal.times if when is not None), default=0.0)
        if last > LONGEST_DURATION:
            raise GoalError(
                f"the sequence asks for a time of {last:.4g} s, at most {LONGEST_DURATION:g} s are "
                "accepted"
            )

    def _within_limits(
        self, request: _Request, deadline: float
    ) -> tuple[tuple[Motion, ...], LimitCheck]:
        """Lengthen free durations, and lower passing velocities, until the limits are kept."""
        durations = list(request.durations)
        best: tuple[tuple[Motion, ...], LimitCheck] | None = None
        for share in _SLOWER:
            for _ in range(_MOST_STRETCHES):
                motions = request.concatenate(durations, share)
                check = check_limits(self._sample(motions), self.robot, self.limits)
                if best is None or check.worst_excess < best[1].worst_excess:
                    best = motions, check
                if not check.violations or time.perf_counter() > deadline:
                    return best
                longer = _stretched(check, durations, request)
                if longer == durations:
                    break
                durations = longer
        assert best is not None
        return best

    def _optimise(
        self, request: _Request, start: tuple[Motion, ...], deadline: float
    ) -> tuple[tuple[Motion, ...], LimitCheck, int, bool]:
        """Minimise, with limits as penalties where they turn out broken.

        Returns
        -------
        motions, check, passes, converged
            What was found, how it keeps the limits, the passes over the segments that this took,
            and whether it ended of itself.
        """
        program = _Program(self.robot, self.limits, request, start, self._naturalness)
        x, passes, converged = program.start, 0, False
        motions, check = start, None
        for penalty, margin in _PENALTIES:
            x, spent, converged = program.minimise(x, penalty, margin, deadline)
            passes += spent
            motions = program.motions(x)
            check = check_limits(self._sample(motions), self.robot, self.limits)
            if not check.violations or time.perf_counter() > deadline:
                break
        assert check is not None
        return motions, check, passes, converged

    def _collisions(self, motions: Sequence[Motion]) -> tuple[Collision, ...]:
        if self._collision is None:
            return ()
        return self._collision.collisions(self._sample(motions))

    def _in_span_score(self, primitive: MovementPrimitive, motion: Motion) -> float:
        scores = self._selector.scores(motion.start.positions, motion.goal.positions)
        return float(scores[self.primitives.index(primitive)])

    def _sample(self, motions: Sequence[Motion]) -> Trajectory:
        times, states, began = [], [], 0.0
        for i, motion in enumerate(motions):
            own = motion.sample_times(self._period)
            kept = slice(0 if i == 0 else 1, None)
            times.append(began + own[kept])
            states.append(np.stack(motion.evaluate(own[kept])))
            began += motion.duration
        q, v, a = np.concatenate(states, axis=1)
        tau = self.robot.inverse_dynamics(q, v, a)
        return Trajectory(self.robot.joint_names, np.concatenate(times), q, v, a, tau)

    def _judge(
        self,
        request: _Request,
        motions: tuple[Motion, ...],
        check: LimitCheck,
        status: str,
        note: str,
        mode: str,
        iterations: int,
        solve_time: float,
    ) -> SequencePlan:
        trajectory = self._sample(motions)
        try:
            check_executable(trajectory, check, request.states[0])
        except TrajectoryError as error:
            status, note = INFEASIBLE, f"no motion within the limits was found: {error}"
        else:
            # An optimal one was looked at before it was chosen.
            collisions = self._collisions(motions) if mode == REAL_TIME else ()
            if collisions:
                status = INFEASIBLE
                note = f"no motion without self-collision was found: {collisions[0]}"
            elif self._collision is not None and not self._collision.has_geometry:
                note += NOT_CHECKED
        ends = np.cumsum([motion.duration for motion in motions])
        rows = [int(np.abs(trajectory.times - end).argmin()) for end in ends]
        *vias, last = (
            float(np.abs(target.error(q)[0]).max())
            for target, q in zip(request.targets, trajectory.positions[rows], strict=True)
        )
        jump = np.abs(trajectory.positions[0] - request.states[0].positions)
        return SequencePlan(
            status=status,
            message=note,
            mode=mode,
            trajectory=trajectory,
            motions=motions,
            primitives=tuple(p.name for p in request.primitives),
            in_span_score=max(
                self._in_span_score(p, motion)
                for p, motion in zip(request.primitives, motions, strict=True)
            ),
            effort_cost=sum(effort_of(self.robot, motion) for motion in motions),
            iterations=iterations,
            limit_check=check,
            start_error=float(jump.max()),
            goal_error=last,
            via_error=max(vias, default=0.0),
            solve_time=solve_time,
        )


@dataclass(frozen=True, eq=False)
class _Route:
    """States up to a target, and the sum of squared in-span scores of the ways between them."""

    cost: float
    states: tuple[JointState, ...]

    def to(self, there: JointState, selector: Selector) -> _Route:
        """Go on to a state."""
        scores = selector.scores(self.states[-1].positions, there.positions)
        return _Route(self.cost + float(scores.min()) ** 2, (*self.states, there))


@dataclass(frozen=True, eq=False)
class _Request:
    """A goal made complete.

    states: at the start and at each target, at rest; targets: what these must meet; stops:
    whether the motion rests there; durations: the usual ones, fitted to fixed times; groups:
    segments between fixed times, with whether their sum is fixed by the goal.
    """

    states: tuple[JointState, ...]
    targets: tuple[Target, ...]
    stops: tuple[bool, ...]
    primitives: tuple[MovementPrimitive, ...]
    expected: tuple[Conditional, ...]
    durations: tuple[float, ...]
    groups: tuple[tuple[tuple[int, ...], bool], ...]

    def concatenate(
        self, durations: Sequence[float] | None = None, share: float = 1.0
    ) -> tuple[Motion, ...]:
        """Join the expected motions by the spline of least jerk, without optimisation.

        Parameters
        ----------
        durations : sequence of float, optional
            Durations of the segments [s]; the usual ones unless given.
        share : float
            Factor of the velocities and accelerations at the vias.
        """
        # Takes long to import, and a node may never be asked for a sequence.
        from scipy.interpolate import make_interp_spline

        durations = self.durations if durations is None else durations
        times = np.concatenate([[0.0], np.cumsum(durations)])
        first = self.states[0]
        places = np.array([state.positions for state in self.states])
        rest = np.zeros_like(first.positions)
        rates = np.zeros((2, *places.shape))
        rates[:, 0] = first.velocities, first.accelerations
        for i, j in pairwise([0, *(np.flatnonzero(self.stops) + 1)]):
            spline = make_interp_spline(
                times[i : j + 1],
                places[i : j + 1],
                k=5,
                bc_type=([(1, rates[0, i]), (2, rates[1, i])], [(1, rest), (2, rest)]),
            )
            for d in (1, 2):
                rates[d - 1, i + 1 : j] = share * spline.derivative(d)(times[i + 1 : j])
        ends = [
            JointState(first.joint_names, q, v, a) for q, v, a in zip(places, *rates, strict=True)
        ]
        return tuple(
            Motion(here, there, float(duration), primitive.basis, expected.weights)
            for (here, there), duration, primitive, expected in zip(
                pairwise(ends), durations, self.primitives, self.expected, strict=True
            )
        )


def _fit_durations(usual: Sequence[float], times: Sequence[float | None]) -> tuple[float, ...]:
    """Usual durations, those between two fixed times scaled to fill them."""
    durations = np.array(usual)
    began, first = 0.0, 0
    for i, fixed in enumerate(times):
        if fixed is not None:
            part = slice(first, i + 1)
            durations[part] *= (fixed - began) / durations[part].sum()
            began, first = fixed, i + 1
    return tuple(map(float, durations))


def _groups(times: Sequence[float | None]) -> tuple[tuple[tuple[int, ...], bool], ...]:
    groups, current = [], []
    for i, fixed in enumerate(times):
        current.append(i)
        if fixed is not None:
            groups.append((tuple(current), True))
            current = []
    if current:
        groups.append((tuple(current), False))
    return tuple(groups)


def _stretched(check: LimitCheck, durations: list[float], request: _Request) -> list[float]:
    """Longer durations of the groups that may be longer and in which a limit is broken."""
    powers = {"velocity": 1.0, "acceleration": 0.5, "jerk": 1.0 / 3.0, "effort": 0.5}
    ends = np.cumsum(durations)
    longer = list(durations)
    for violation in check.violations:
        segment = min(int(np.searchsorted(ends, violation.time)), len(durations) - 1)
        group = next(g for g, _ in request.groups if segment in g)
        fixed = next(is_fixed for g, is_fixed in request.groups if g == group)
        power = powers.get(violation.quantity)
        if fixed or power is None:
            continue
        if durations[segment] > 10.0 * request.durations[segment]:
            continue
        factor = float(np.clip(1.02 * (1.0 + violation.excess) ** power, 1.05, 2.0))
        for i in group:
            longer[i] = max(longer[i], durations[i] * factor)
    return longer


class _Tables(QuadratureTables):
    """Those of a quadrature, and of both ends, where limits are as easily broken."""

    def __init__(self, basis: Basis) -> None:
        super().__init__(basis)
        ends = np.array([0.0, 1.0])
        hermite = np.array([hermite_functions(ends, d) for d in range(len(self.hermite))])
        values = basis.tables(ends, len(self.hermite) - 1)
        functions = values[..., 1:].transpose(1, 0, 2, 3) * basis.scales
        self.phases = np.concatenate([self.phases, ends])
        self.quadrature = np.concatenate([self.quadrature, [0.0, 0.0]])
        self.hermite = np.concatenate([self.hermite, hermite], axis=1)
        self.mean = np.concatenate([self.mean, values[..., 0]], axis=1)
        self.functions = np.concatenate([self.functions, functions])


class _Segment:
    """One segment's part of the program.

    Its unknowns are, in this order: position, velocity and acceleration at its start, scaled
    weights, the logarithm of its duration, position, velocity and acceleration at its end;
    6 n + m + 1 of them.
    """

    def __init__(self, robot: Robot, limits: JointLimits, motion: Motion, tables: QuadratureTables):
        self._robot = robot
        self.motion, self._tables = motion, tables
        self.n, self.m = robot.n_joints, motion.basis.n_weights
        half = (limits.upper - limits.lower) / 2.0
        centre = np.where(np.isfinite(half), (limits.upper + limits.lower) / 2.0, 0.0)
        self._centre = centre
        self._bounds = (half, limits.velocity, limits.acceleration, limits.jerk)
        self._most_effort = limits.effort

    def unknowns(self) -> FloatArray:
        """Their values for the motion."""
        motion = self.motion
        begin, end = (
            np.concatenate([state.positions, state.velocities, state.accelerations])
            for state in (motion.start, motion.goal)
        )
        own = np.append(motion.weights / motion.basis.scales, np.log(motion.duration))
        return np.concatenate([begin, own, end])

    def scales(self) -> FloatArray:
        """Usual sizes of their changes."""
        n, duration = self.n, self.motion.duration
        end = np.repeat([1.0, 1.0 / duration, 5.0 / duration**2], n)
        return np.concatenate([end, np.ones(self.m + 1), end])

    def precision(self, expected: Conditional) -> FloatArray:
        """How unlike the demonstrations a change of the unknowns from the motion is.

        A change of the states at the ends bends the motion, as weights do, so that it is weighed
        by how far the demonstrations spread, joint by joint, in the mean over the motion.
        """
        n, m, tables, scales = self.n, self.m, self._tables, self.motion.basis.scales
        clock = 3 * n + m
        precision = np.zeros((clock + 1 + 3 * n, clock + 1 + 3 * n))
        precision[3 * n : clock, 3 * n : clock] = expected.precision * np.outer(scales, scales)
        precision[clock, clock] = _DURATION_SPREAD**-2
        functions = tables.functions[:, 0] / scales
        variances = np.einsum(
            "k,kji,il,kjl->j", tables.quadrature, functions, expected.covariance, functions
        )
        spreads = _BEND_SPREAD * np.maximum(np.sqrt(variances), _LEAST_SPREAD)
        bends = tables.hermite[0] * self.motion.duration ** np.tile(np.arange(3.0), 2)
        gram = bends.T @ (bends * tables.quadrature[:, None])
        ends = np.concatenate([np.arange(0, 3 * n, n), clock + 1 + np.arange(0, 3 * n, n)])
        for j in range(n):
            precision[np.ix_(ends + j, ends + j)] += gram / spreads[j] ** 2
        return precision

    def linearise(
        self, u: FloatArray, free: NDArray[np.intp], penalty: float, margin: float
    ) -> tuple[FloatArray, FloatArray]:
        """Residuals of effort and of broken limits, and their derivatives by free unknowns."""
        n, m, tables = self.n, self.m, self._tables
        clock = 3 * n + m
        begin = u[:n], u[n : 2 * n], u[2 * n : 3 * n]
        end = u[clock + 1 : -2 * n], u[-2 * n : -n], u[-n:]
        duration = float(np.exp(u[clock]))
        powers = np.array([0.0, 1.0, 2.0, 0.0, 1.0, 2.0])
        ends = boundary_values(begin, end, duration)
        # Jerks matter for their limits alone.
        n_rates = 4 if penalty > 0.0 and np.isfinite(self._bounds[3]).any() else 3
        rates = duration ** -np.arange(float(n_rates))
        hermite, functions = tables.hermite[:n_rates], tables.functions[:, :n_rates]
        shape = tables.mean[:n_rates] + (functions @ u[3 * n : clock]).transpose(1, 0, 2)
        states = (hermite @ ends + shape) * rates[:, None, None]
        by = np.zeros((hermite.shape[1], n_rates, n, u.size))
        eye = np.eye(n)
        for function, power in enumerate(powers):
            column = function * n if function < 3 else clock + 1 + (function - 3) * n
            values = (hermite[:, :, function] * (duration**power * rates)[:, None]).T
            by[:, :, :, column : column + n] = values[:, :, None, None] * eye
        by[..., 3 * n : clock] = functions * rates[:, None, None]
        growth = (hermite @ (powers[:, None] * ends)) * rates[:, None, None]
        growth -= np.arange(float(n_rates))[:, None, None] * states
        by[..., clock] = growth.transpose(1, 0, 2)
        by = by[..., free]
        tau, dtau = self._robot.inverse_dynamics_derivatives(*states[:3])
        by_effort = dtau @ by[:, :3].reshape(len(tau), 3 * n, -1)
        root = np.sqrt(tables.quadrature * duration)[:, None]
        residual = [(tau * root).ravel()]
        jacobian = by_effort * root[:, :, None]
        jacobian[..., free == clock] += (0.5 * tau * root)[..., None]
        jacobians = [jacobian.reshape(tau.size, -1)]
        if penalty > 0.0:
            values = np.concatenate([states, tau[None]])
            values[0] -= self._centre
            slopes = np.concatenate([by.transpose(1, 0, 2, 3), by_effort[None]])
            bounds = np.stack([*self._bounds[:n_rates], self._most_effort])[:, None]
            signed = values / bounds
            over = np.abs(signed) - (1.0 - margin)
            broken = np.isfinite(bounds) & (over > 0.0)
            weight = np.sqrt(penalty / len(tau))
            residual.append(weight * over[broken])
            scale = np.broadcast_to(np.sign(signed) / bounds, broken.shape)[broken]
            jacobians.append(weight * scale[:, None] * slopes[broken])
        return np.concatenate(residual), np.concatenate(jacobians)


class _Program:
    """The whole sequence: unknowns in the order segment, target, segment, …, target.

    Those of a segment are its weights and its duration; those of a target its position, if it is
    a pose, and velocity and acceleration, unless the motion stops there.
    """

    def __init__(
        self,
        robot: Robot,
        limits: JointLimits,
        request: _Request,
        start: tuple[Motion, ...],
        naturalness: float,
    ) -> None:
        n = robot.n_joints
        self._n, self._start_motions = n, start
        self._robot, self._limits = robot, limits
        tables = {p.name: _Tables(p.basis) for p in request.primitives}
        self.segments = [
            _Segment(robot, limits, motion, tables[primitive.name])
            for motion, primitive in zip(start, request.primitives, strict=True)
        ]
        # Of each segment: all of its unknowns, which of them are free, where those are among all
        # free ones, and where its weights and its duration are. Of poses: where positions are.
        self._locals = [segment.unknowns() for segment in self.segments]
        self._free: list[NDArray[np.intp]] = []
        self._where: list[slice] = []
        self._own: list[slice] = []
        self._posed: list[tuple[slice, PoseTarget]] = []
        at, before = 0, np.arange(0)
        for segment, target, stops in zip(
            self.segments, request.targets, request.stops, strict=True
        ):
            own = 3 * n + np.arange(segment.m + 1)
            after = np.arange(n if stops else 3 * n)
            self._own.append(slice(at, at + own.size))
            at += own.size
            if isinstance(target, PoseTarget):
                self._posed.append((slice(at, at + n), target))
            else:
                after = after[n:]
            at += after.size
            self._free.append(np.concatenate([before, own, own[-1] + 1 + after]))
            self._where.append(slice(at - self._free[-1].size, at))
            before = after
        self.size = at
        self._band = min(max(free.size for free in self._free), self.size) - 1
        self._scales = np.ones(self.size)
        x = np.zeros(self.size)
        for segment, local, free, where in zip(
            self.segments, self._locals, self._free, self._where, strict=True
        ):
            x[where], self._scales[where] = local[free], segment.scales()[free]
        self.start = x
        self._groups = [group for group, _ in request.groups]
        self._durations = [motion.duration for motion in start]
        efforts = [effort_of(robot, motion) for motion in start]
        self._reference = sum(efforts)
        self._priors = [
            naturalness * effort * segment.precision(expected)[np.ix_(free, free)]
            for effort, segment, expected, free in zip(
                efforts, self.segments, request.expected, self._free, strict=True
            )
        ]

    def _local(self, x: FloatArray, i: int) -> FloatArray:
        """All unknowns of a segment."""
        u = self._locals[i].copy()
        u[self._free[i]] = x[self._where[i]]
        return u

    def motions(self, x: FloatArray) -> tuple[Motion, ...]:
        """The segments that unknowns stand for."""
        n, motions = self._n, []
        durations = self._exact_durations(x)
        names = self._start_motions[0].start.joint_names
        before = self._start_motions[0].start
        for i, (segment, old) in enumerate(zip(self.segments, self._start_motions, strict=True)):
            u = self._local(x, i)
            clock = 3 * n + segment.m
            goal = JointState(names, *u[clock + 1 :].reshape(3, n))
            motions.append(
                replace(
                    old,
                    start=before,
                    goal=goal,
                    duration=durations[i],
                    weights=u[3 * n : clock] * old.basis.scales,
                )
            )
            before = goal
        return tuple(motions)

    def _exact_durations(self, x: FloatArray) -> list[float]:
        """Durations, their sums over groups to the last bits."""
        durations = [float(np.exp(x[own.stop - 1])) for own in self._own]
        for group in self._groups:
            factor = sum(self._durations[i] for i in group) / sum(durations[i] for i in group)
            for i in group:
                durations[i] *= factor
        return durations

    def _assemble(
        self, x: FloatArray, penalty: float, margin: float
    ) -> tuple[float, FloatArray, FloatArray]:
        """Cost, gradient and Gauss–Newton Hessian (lower band) by scaled unknowns."""
        cost = 0.0
        gradient = np.zeros(self.size)
        band = np.zeros((self._band + 1, self.size))
        for i, segment in enumerate(self.segments):
            where, free = self._where[i], self._free[i]
            residual, jacobian = segment.linearise(
                self._local(x, i), free, penalty * self._reference, margin
            )
            hessian = jacobian.T @ jacobian
            slope = jacobian.T @ residual
            deviation = x[where] - self._locals[i][free]
            pull = self._priors[i] @ deviation
            hessian += self._priors[i]
            slope += pull
            cost += 0.5 * float(residual @ residual + deviation @ pull)
            gradient[where] += slope
            for d in range(len(slope)):
                band[d, where.start : where.stop - d] += np.diagonal(hessian, -d)
        scaled = band.copy()
        for d in range(self._band + 1):
            stop = self.size - d
            scaled[d, :stop] *= self._scales[:stop] * self._scales[d:]
        return cost, gradient * self._scales, scaled

    def minimise(
        self, x: FloatArray, penalty: float, margin: float, deadline: float = float("inf")
    ) -> tuple[FloatArray, int, bool]:
        """Levenberg–Marquardt steps downhill from x, within fixed sums of durations.

        Returns
        -------
        x, passes, converged
            The unknowns, the passes this took, and whether no further step was worth it.
        """
        cost, gradient, band = self._assemble(x, penalty, margin)
        damping, passes = 1e-3 * float(np.mean(band[0])), 1
        while passes < _MOST_ITERATIONS and time.perf_counter() < deadline:
            step = self._step(x, gradient, band, damping)
            if step is None:
                damping *= 10.0
                continue
            predicted = -float(gradient @ step) - 0.5 * _quadratic(band, step)
            new = self._shifted(x, step)
            if new is None:
                damping *= 5.0
                continue
            new_cost, new_gradient, new_band = self._assemble(new, penalty, margin)
            passes += 1
            decrease = cost - new_cost
            if decrease > 0.0:
                x, cost, gradient, band = new, new_cost, new_gradient, new_band
                gain = decrease / max(predicted, 1e-300)
                damping *= 0.3 if gain > 0.5 else 1.5
                if decrease <= _TOLERANCE * cost:
                    break
            else:
                damping *= 5.0
                if predicted <= 1e-2 * _TOLERANCE * cost or not np.isfinite(damping):
                    break
        else:
            return x, passes, False
        return x, passes, True

    def _shifted(self, x: FloatArray, step: FloatArray) -> FloatArray | None:
        """Take a step, with poses and sums of durations restored; None if a pose can't be."""
        new = np.asarray(x + self._scales * step)
        for where, target in self._posed:
            pose = target.pose
            new[where], error = nearest_configuration(self._robot, self._limits, pose, new[where])
            if np.abs(error).max() > POSE_TOLERANCE:
                return None
        for i, duration in enumerate(self._exact_durations(new)):
            new[self._own[i].stop - 1] = np.log(duration)
        return new

    def _step(
        self, x: FloatArray, gradient: FloatArray, band: FloatArray, damping: float
    ) -> FloatArray | None:
        """The damped Newton step that keeps, to first order, poses and sums of durations."""
        damped = band.copy()
        damped[0] += damping
        try:
            factor = cholesky_banded(damped, lower=True, check_finite=False)
        except LinAlgError:
            return None
        sums = np.zeros((len(self._groups), self.size))
        for row, group in zip(sums, self._groups, strict=True):
            for i in group:
                place = self._own[i].stop - 1
                row[place] = np.exp(x[place])
        rows = [sums]
        for where, target in self._posed:
            slopes = target.error(x[where])[1]
            rows.append(np.zeros((len(slopes), self.size)))
            rows[-1][:, where] = slopes
        kept = np.vstack(rows)
        solved = cho_solve_banded((factor, True), np.column_stack([gradient, kept.T]))
        free, across = solved[:, 0], solved[:, 1:]
        # A pose may have more equations than joints.
        multipliers = np.linalg.lstsq(kept @ across, kept @ free, rcond=None)[0]
        return np.asarray(across @ multipliers - free)


def _quadratic(band: FloatArray, x: FloatArray) -> float:
    """The form xᵀHx of a symmetric H given by its lower band."""
    total = float(band[0] @ x**2)
    for d in range(1, len(band)):
        total += 2.0 * float(band[d, : len(x) - d] @ (x[d:] * x[: len(x) - d]))
    return total
