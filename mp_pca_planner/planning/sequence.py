# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Sequences of primitives through configurations and poses, joined to the second derivative.

Between the vias, each segment is a motion q(s) = h(s) + μ(s) + Σ wₖ φₖ(s) of the primitive whose
demonstrations are nearest. *In real time*, nothing is optimised: the segments have the expected
weights and durations (see :mod:`.sequence_request`). *Optimal* are the weights, the velocities and
accelerations at the vias, and the durations of all segments together: least are the effort
½∫‖τ‖²dt and the naturalness of each segment, how far it is from the one joined in real time, in
spreads of the demonstrations (see :mod:`.sequence_program`). The durations between two fixed times
keep their sum.

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

from ..arrays import FloatArray
from ..exceptions import GoalError, TrajectoryError
from ..motion.collision import NOT_CHECKED, Collision, CollisionModel
from ..motion.goal import JointState, Pose, SequenceGoal
from ..motion.trajectory import Trajectory
from ..motion.validation import LimitCheck, check_executable, check_limits
from ..primitives.primitive import MovementPrimitive
from ..robot.limits import JointLimits
from ..robot.model import Robot
from .conditions import JointTarget, PoseTarget, Target
from .motion import Motion
from .plan import INFEASIBLE, SOLVED, STOPPED_EARLY
from .pose_search import configurations_at, starts_near
from .request import LONGEST_DURATION
from .selection import Selector, effort_of
from .sequence_program import SequenceProgram
from .sequence_request import SequenceRequest, duration_groups, fit_durations
from .states import check_within_limits, completed, in_order, unwrapped
from .stop_and_go import slowdown, stop_and_go

REAL_TIME, OPTIMAL = "real_time", "optimal"
MODES = (REAL_TIME, OPTIMAL)

_RAN_OUT = "time or iterations ran out before"
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
        effort was found, or only with a rest at each target within the limits. 'infeasible':
        must not be executed.
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

    Raises
    ------
    RobotError
        If a moving link of the robot has no valid inertia.
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
        robot.require_inertias("sequences")
        self.robot = robot
        self.primitives = tuple(primitives)
        self._selector = Selector(robot, primitives)
        self.limits = limits
        self._naturalness = naturalness
        self._period = sample_period
        self._max_solve_time = max_solve_time
        self.collision = collision

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
        seconds = time.perf_counter() - began
        found = self._within_limits(request, deadline)
        if mode == OPTIMAL:
            began = time.perf_counter()
            found = self._improved(request, found, deadline)
            seconds += time.perf_counter() - began
        ran_out = time.perf_counter() > deadline
        if found.mode == REAL_TIME and not found.check.violations:
            found = replace(found, collisions=self._collisions(found.motions))
        if found.check.violations or found.collisions:
            found = self._slow(request, found, ran_out)
        return self._judge(request, found, seconds)

    def _improved(self, request: SequenceRequest, quick: _Found, deadline: float) -> _Found:
        """The optimal motion, or the quick one if none within the limits was found."""
        better, check, iterations, converged = self._optimise(request, quick.motions, deadline)
        status = SOLVED if converged else STOPPED_EARLY
        collisions = () if check.violations else self._collisions(better)
        if not (check.violations or collisions):
            note = "motion of least effort found"
            if not converged:
                note = f"{_RAN_OUT} the least effort was found"
            return _Found(better, check, note, status, OPTIMAL, iterations)
        note = f"{quick.note}, for no cheaper one within the limits was found"
        if collisions:
            note = f"{quick.note}, for in the optimal one {collisions[0]}"
        elif not converged:
            note = f"{quick.note}, for {_RAN_OUT} a cheaper one within the limits was found"
        return replace(quick, note=note, status=status, iterations=iterations)

    def _slow(self, request: SequenceRequest, failed: _Found, ran_out: bool) -> _Found:
        """The motion that rests at each target, or why there is none."""
        search = "no motion {} was found"
        if ran_out:
            limit = f"max_solve_time = {self._max_solve_time:g} s"
            search = f"time ran out ({limit}) before a motion {{}} was found"
        try:
            motions, check = self._resting(request)
            collisions = self._collisions(motions)
            if collisions:
                raise TrajectoryError(str(collisions[0]))
        except TrajectoryError as error:
            kind = "within the limits" if failed.check.violations else "without self-collision"
            broken = (*failed.check.violations, *failed.collisions)[0]
            note = f"{search.format(kind)}: {broken}; nor was a slow one found: {error}"
            return replace(failed, note=note, status=INFEASIBLE)
        note = search.format("without stops within the limits")
        note += "; this one rests at each target, keeps the limits and may be executed"
        return _Found(motions, check, note, STOPPED_EARLY, iterations=failed.iterations)

    def _resting(self, request: SequenceRequest) -> tuple[tuple[Motion, ...], LimitCheck]:
        """The motion that rests at each target."""
        route = stop_and_go(self.robot, self.limits, request.states, self._period)
        if route.moves_at_ends:  # the knots of a brake are points of the trajectory
            first = request.resting_durations(route.durations, route.step)[0]
            step = first / float(np.ceil(first / self._period - 1e-9))
            route = stop_and_go(self.robot, self.limits, request.states, step)
        durations, _, check = route.slowed(
            self.robot,
            self.limits,
            lambda slower: request.resting_durations(slower.durations, slower.step),
            lambda times: self._sample(route.segments(times)),
        )
        return route.segments(durations), check

    def _complete(self, goal: SequenceGoal, start: JointState) -> SequenceRequest:
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
        durations = fit_durations([e.duration for e in expected], goal.times)
        if sum(durations) > LONGEST_DURATION:
            raise GoalError(
                f"the sequence would take {sum(durations):.4g} s, at most {LONGEST_DURATION:g} s "
                "are accepted"
            )
        groups = duration_groups(goal.times)
        return SequenceRequest(
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

    def _within_limits(self, request: SequenceRequest, deadline: float) -> _Found:
        """Lengthen free durations, and lower passing velocities, until the limits are kept."""
        durations = list(request.durations)
        best: _Found | None = None
        for share in _SLOWER:
            for _ in range(_MOST_STRETCHES):
                motions = request.concatenate(durations, share)
                check = check_limits(self._sample(motions), self.robot, self.limits)
                if best is None or check.worst_excess < best.check.worst_excess:
                    best = _Found(motions, check)
                if not check.violations or time.perf_counter() > deadline:
                    return best
                longer = _stretched(check, durations, request)
                if longer == durations:
                    break
                durations = longer
        assert best is not None
        return best

    def _optimise(
        self, request: SequenceRequest, start: tuple[Motion, ...], deadline: float
    ) -> tuple[tuple[Motion, ...], LimitCheck, int, bool]:
        """Minimise, with limits as penalties where they turn out broken.

        Returns
        -------
        motions, check, passes, converged
            What was found, how it keeps the limits, the passes over the segments that this took,
            and whether it ended of itself.
        """
        program = SequenceProgram(self.robot, self.limits, request, start, self._naturalness)
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
        if self.collision is None:
            return ()
        return self.collision.collisions(self._sample(motions))

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

    def _judge(self, request: SequenceRequest, found: _Found, solve_time: float) -> SequencePlan:
        motions, status, note = found.motions, found.status, found.note
        trajectory = self._sample(motions)
        if status != INFEASIBLE:
            check_executable(trajectory, found.check, request.states[0])
            usual, total = sum(request.durations), trajectory.duration
            if total > usual * (1.0 + 1e-9):
                note += f"; to keep the limits, it was lengthened from {usual:.3g} to {total:.3g} s"
            if self.collision is not None and not self.collision.has_geometry:
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
            mode=found.mode,
            trajectory=trajectory,
            motions=motions,
            primitives=tuple(p.name for p in request.primitives),
            in_span_score=max(
                self._in_span_score(p, motion)
                for p, motion in zip(request.primitives, motions, strict=True)
            ),
            effort_cost=sum(effort_of(self.robot, motion) for motion in motions),
            iterations=found.iterations,
            limit_check=found.check,
            start_error=float(jump.max()),
            goal_error=last,
            via_error=max(vias, default=0.0),
            solve_time=solve_time,
        )


@dataclass(frozen=True, eq=False)
class _Found:
    """Motions that were found, the check of their limits, and what became of the search."""

    motions: tuple[Motion, ...]
    check: LimitCheck
    note: str = "motion concatenated in real time"
    status: str = SOLVED
    mode: str = REAL_TIME
    iterations: int = 0
    collisions: tuple[Collision, ...] = ()


@dataclass(frozen=True, eq=False)
class _Route:
    """States up to a target, and the sum of squared in-span scores of the ways between them."""

    cost: float
    states: tuple[JointState, ...]

    def to(self, there: JointState, selector: Selector) -> _Route:
        """Go on to a state."""
        scores = selector.scores(self.states[-1].positions, there.positions)
        return _Route(self.cost + float(scores.min()) ** 2, (*self.states, there))


def _stretched(check: LimitCheck, durations: list[float], request: SequenceRequest) -> list[float]:
    """Longer durations of the groups that may be longer and in which a limit is broken."""
    ends = np.cumsum(durations)
    longer = list(durations)
    for violation in check.violations:
        segment = min(int(np.searchsorted(ends, violation.time)), len(durations) - 1)
        group = next(g for g, _ in request.groups if segment in g)
        fixed = next(is_fixed for g, is_fixed in request.groups if g == group)
        if fixed or durations[segment] > 10.0 * request.durations[segment]:
            continue
        factor = slowdown(LimitCheck((violation,)))
        for i in group:
            longer[i] = max(longer[i], durations[i] * factor)
    return longer
