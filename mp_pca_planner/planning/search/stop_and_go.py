# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Motions within the limits without optimisation: braking, then motions from rest to rest.

From rest to rest the motion is the minimum-jerk one, slowed by the laws of time scaling (see
:mod:`.time_scaling`). A robot that moves is braked first, each joint by the deceleration of least
time within its limits of acceleration and jerk.

Jerks change at the points of the trajectory only. Ruckig brakes 4 % sooner, but its jerks change
between points: the quintics of a controller through points 10 ms apart then exceed the limit of
jerk by 37 % in the median of 300 brakes, by 75 % at most.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from ...arrays import FloatArray
from ...exceptions import GoalError, TrajectoryError
from ...input_limits import INPUT_LIMITS
from ...motion.goal import JointState
from ...motion.interpolation import hermite_functions, segment_ends
from ...motion.trajectory import Trajectory
from ...motion.validation import LimitCheck, check_limits
from ...robot.limits import JointLimits
from ...robot.model import Robot
from ..context import Budget, Context
from ..motion import Motion, Tables
from ..program.compile import MotionBasis
from ..request import Request
from ..time_scaling import least_duration, slowdown
from .candidate import SLOW, Candidate, checked, sampled
from .detours import corners_of, paths

# Shares of the limits of acceleration and jerk for braking, tried in turn. Hard braking needs least
# distance to position limits, soft braking least effort.
_SHARES = (0.999, 0.8, 0.6, 0.4, 0.2, 0.1, 0.05)
# Shares of the jerk, tried in turn until braking in whole steps stays within the jerk limit.
_JERK_SHARES = (1.0, 0.8, 0.6, 0.4, 0.2)
# Times in which braking ends velocities and accelerations that have no limits [s].
_STOPPING_TIME, _RAMP_TIME = 0.1, 0.05
# Factor on least durations: motions with a distance to limits are checked several times faster.
_CLEARANCE = 1.001
# Times that a motion is slowed because its points exceed a limit, at most.
_MAX_STRETCHES = 10


class FixedShape:
    """A basis without weights, whose mean shape passes given states by quintics.

    Parameters
    ----------
    times : array, shape (n_knots,)
        Increasing times from 0 [s].
    states : array, shape (3, n_knots, n_joints)
        Positions, velocities and accelerations at these times.
    """

    def __init__(self, times: FloatArray, states: FloatArray) -> None:
        self.duration = duration = float(times[-1])
        self._phases = times / duration
        q, v, a = states
        self._ends = segment_ends(self._phases, q, duration * v, duration**2 * a)
        rates = duration ** np.arange(3.0)[:, None]
        self._boundary = np.concatenate([rates * states[:, 0], rates * states[:, -1]])
        self.n_joints, self.n_weights, self.scales = q.shape[1], 0, np.zeros(0)
        # Knots of braking are dense: every tenth is enough for integration.
        self.breakpoints = np.union1d(self._phases[::10], [1.0])

    def functions(self, phases: FloatArray, derivative: int = 0) -> FloatArray:
        """No functions, shape (n_steps, n_joints, 0)."""
        return np.zeros((len(phases), self.n_joints, 0))

    def shape(self, weights: FloatArray, phases: FloatArray, derivative: int = 0) -> FloatArray:
        """Values of the mean shape, shape (n_steps, n_joints)."""
        k = np.searchsorted(self._phases, phases, side="right") - 1
        k = np.clip(k, 0, len(self._ends) - 1)
        widths = np.diff(self._phases)[k]
        tables = hermite_functions((phases - self._phases[k]) / widths, derivative)
        values = np.einsum("ki,kij->kj", tables, self._ends[k]) / widths[:, None] ** derivative
        return np.asarray(values - hermite_functions(phases, derivative) @ self._boundary)

    def shapes(self, weights: FloatArray, phases: FloatArray, highest: int) -> FloatArray:
        """Shape and derivatives up to the highest one, shape (highest + 1, n_steps, n_joints)."""
        return np.array([self.shape(weights, phases, d) for d in range(highest + 1)])

    def tables(self, phases: FloatArray, highest: int) -> FloatArray:
        """All values and derivatives, shape (highest + 1, n_steps, n_joints, 1)."""
        return self.shapes(self.scales, phases, highest)[..., None]


@dataclass(frozen=True, eq=False)
class StopAndGo:
    """A motion between two states with rests between them.

    Attributes
    ----------
    start, goal : JointState
        States at the ends.
    brake, launch : array, shape (3, n_knots, n_joints)
        Positions, velocities and accelerations at knots `step` apart, from the start to rest and
        from rest to the goal; a single knot where that end is at rest.
    places : array, shape (n_places, n_joints)
        Positions of the rests: at the end of braking, between, at the start of the launch.
    legs : array, shape (n_places - 1,)
        The least durations of the minimum-jerk motions between [s].
    step : float
        Time between the knots of a brake [s].
    """

    start: JointState
    goal: JointState
    brake: FloatArray
    launch: FloatArray
    places: FloatArray
    legs: FloatArray
    step: float

    @property
    def moves_at_ends(self) -> bool:
        """Whether an end is not at rest."""
        return bool(self.brake.shape[1] + self.launch.shape[1] > 2)

    @property
    def durations(self) -> FloatArray:
        """The least durations of the legs, with braking and launching, shape (n_legs,) [s]."""
        durations = self.legs.copy()
        durations[0] += self.step * (self.brake.shape[1] - 1)
        durations[-1] += self.step * (self.launch.shape[1] - 1)
        return durations

    def motions(self, durations: FloatArray, counts: Sequence[int]) -> tuple[Motion, ...]:
        """The motion in segments of several legs, each ending at rest.

        Parameters
        ----------
        durations : array, shape (n_legs,)
            Durations of the legs [s].
        counts : sequence of int
            Number of legs of each segment.
        """
        rest = np.zeros((3, *self.places.shape))
        rest[0] = self.places
        found, state, first, n_legs = list[Motion](), self.start, 0, len(self.legs)
        for count in counts:
            times, knots, began = [np.zeros(1)], list[FloatArray](), 0.0
            for leg in range(first, first + count):
                before = self.brake if leg == 0 else rest[:, leg : leg + 1]
                after = self.launch if leg == n_legs - 1 else rest[:, leg + 1 : leg + 2]
                braking = self.step * np.arange(1.0, before.shape[1])
                ended = began + float(durations[leg])
                launching = ended - self.step * np.arange(float(after.shape[1]))[::-1]
                times += [began + braking, launching]
                # A leg begins where the one before it ends.
                knots += [before if leg == first else before[:, 1:], after]
                began = ended
            first += count
            basis = FixedShape(np.concatenate(times), np.concatenate(knots, axis=1))
            is_last = first == n_legs
            goal = self.goal if is_last else JointState(state.joint_names, self.places[first])
            found.append(Motion(state, goal, basis.duration, basis, basis.scales))
            state = goal
        return tuple(found)


def stop_and_go(
    robot: Robot,
    limits: JointLimits,
    states: Sequence[JointState],
    step: float,
) -> StopAndGo:
    """The fastest motion with rests through some states.

    Parameters
    ----------
    robot, limits
        The robot and the limits of its joints.
    states : sequence of JointState
        At least two, of all joints, within the limits of position; the motion rests at those
        between the first and the last.
    step : float
        Time between the points of the trajectory [s].

    Raises
    ------
    TrajectoryError
        If an end can't be left or reached within the limits, or gravity alone exceeds the limits
        of effort between.
    """
    start, goal = states[0], states[-1]
    brake = _brake(robot, limits, start, step)
    # In reversed time, velocities change their sign; accelerations and efforts do not.
    backwards = JointState(goal.joint_names, goal.positions, -goal.velocities, goal.accelerations)
    launch = _brake(robot, limits, backwards, step)[:, ::-1] * [[[1.0]], [[-1.0]], [[1.0]]]
    between = [state.positions for state in states[1:-1]]
    places = np.array([brake[0, -1], *between, launch[0, 0]])
    least = [least_duration(robot, limits, a, b) for a, b in pairwise(places)]
    legs = [max(_CLEARANCE * duration, step) for duration in least]
    return StopAndGo(start, goal, brake, launch, places, np.array(legs), step)


def brakes(
    robot: Robot,
    limits: JointLimits,
    state: JointState,
    step: float,
) -> Iterator[tuple[Trajectory, LimitCheck]]:
    """Motions from a moving state to rest, each joint by itself, and their comparison with limits.

    Parameters
    ----------
    robot, limits
        The robot and the limits of its joints.
    state : JointState
        The state.
    step : float
        Time between the points [s].

    Yields
    ------
    brake : Trajectory
        The motion; the fastest first.
    check : LimitCheck
        Its comparison with the limits.
    """
    for share in _SHARES:
        try:
            knots = _decelerate(state, limits, share, step)
        except TrajectoryError:  # a softer brake takes even longer
            return
        times = step * np.arange(knots.shape[1])
        brake = Trajectory(state.joint_names, times, *knots)
        yield brake, check_limits(brake, robot, limits)


def _brake(robot: Robot, limits: JointLimits, state: JointState, step: float) -> FloatArray:
    """Knots from a state to rest, the fastest within the limits, shape (3, n_knots, n_joints)."""
    if not np.any([state.velocities, state.accelerations]):
        return np.array(state.values)[:, None]
    for brake, check in brakes(robot, limits, state, step):
        if not check.violations:
            return np.array(brake.states)
    raise TrajectoryError("no brake within the limits was found")


def _decelerate(state: JointState, limits: JointLimits, share: float, step: float) -> FloatArray:
    """Knots from a state to rest with a share of the limits of acceleration and jerk."""
    v, a = state.velocities, state.accelerations
    usual = np.maximum(np.abs(v).max() / _STOPPING_TIME, np.abs(a).max())
    most = np.maximum(share * np.minimum(limits.acceleration, usual), np.abs(a))
    jerks = np.minimum(share * limits.jerk, most / _RAMP_TIME)
    columns = [_jerks(*joint, step) for joint in zip(v, a, most, jerks, strict=True)]
    n_steps = max(map(len, columns))
    jerk = np.array([np.pad(x, (0, n_steps - len(x))) for x in columns]).T
    states = np.zeros((3, n_steps + 1, len(v)))
    states[:, 0] = state.positions, v, a
    for order, slope in ((2, jerk), (1, jerk / 2.0), (0, jerk / 6.0)):  # Taylor's series, exact
        for higher in range(2, order, -1):
            slope = slope * step + states[higher, :-1] / (higher - order)
        states[order, 1:] = states[order, 0] + step * np.cumsum(slope, axis=0)
    for j, column in enumerate(columns):  # exactly at rest
        states[1:, len(column) :, j] = 0.0
    return states


def _jerks(v: float, a: float, most: float, jerk: float, step: float) -> FloatArray:
    """Jerks of one joint in steps that end its velocity and acceleration in the least time.

    Parameters
    ----------
    v, a : float
        Velocity and acceleration [/s, /s²].
    most, jerk : float
        Largest acceleration and jerk [/s², /s³].
    step : float
        Length of a step [s].
    """
    if v == 0.0 and a == 0.0:
        return np.zeros(0)
    for share in _JERK_SHARES:
        found = _trapezoid(v, a, most, share * jerk, step)
        if np.abs(found).max() <= jerk:
            break
    return found


def _trapezoid(v: float, a: float, most: float, jerk: float, step: float) -> FloatArray:
    """Jerks by which the acceleration changes from a to −p, stays there, and changes to 0.

    With whole numbers of steps, the jerk may exceed the given one.
    """
    # Sign of the velocity that remains if the acceleration is reduced to 0 at once.
    sign = 1.0 if v + a * abs(a) / (2.0 * jerk) >= 0.0 else -1.0
    v, a = sign * v, sign * a
    peak = min(float(np.sqrt(max(jerk * v + a * a / 2.0, 0.0))), most)
    hold = (v + a * a / (2.0 * jerk)) / peak - peak / jerk if peak > 0.0 else 0.0
    times = np.array([(a + peak) / jerk, hold, peak / jerk])
    n = np.maximum(np.ceil(times / step - 1e-9), (1.0, 0.0, 1.0))
    if not n.sum() * step <= INPUT_LIMITS.longest_motion(step):
        raise TrajectoryError("the brake takes too long")
    # With whole steps, the peak is adapted so that the final velocity is 0.
    peak = (v + a * n[0] * step / 2.0) / (step * (n[0] / 2.0 + n[1] + n[2] / 2.0))
    pieces = [-(a + peak) / (n[0] * step), 0.0, peak / (n[2] * step)]
    return np.repeat(sign * np.array(pieces), n.astype(int))


Corners = tuple[FloatArray, ...]
"""Points between the ends of each segment at which a motion rests, shape (n_corners, n_joints)."""


def slow_motion(
    context: Context, request: Request, path: FloatArray | None, budget: Budget
) -> Candidate | None:
    """The slow motion of a request.

    Parameters
    ----------
    context, request
        Of the planner; the request.
    path : array, shape (n_corners, n_joints), or None
        Corners of a collision-free path, if one is known.
    budget : Budget
        The time for further paths.

    Returns
    -------
    candidate : Candidate or None
        The motion, within the limits and without collisions; None if there is none with the
        requested duration.
    """
    # Durations of the segments to try, not below the least ones.
    tried = [np.array([segment.duration for segment in request.segments])]
    if request.is_shortest:
        tried = [0.0 * tried[0]]
    elif not request.mode and not request.duration_is_free:
        tried.append(0.0 * tried[0])
    for usual in tried:
        for corners in _rests(context, request, path, budget):
            try:
                found = _slow(context, request, usual, corners)
            except (GoalError, TrajectoryError):
                break
            if found.collisions:
                continue
            in_time = found.duration <= float(usual.sum()) * (1.0 + 1e-9)
            if not found.strayed and (request.duration_is_free or in_time):
                return found
            break
    return None


def _rests(
    context: Context, request: Request, path: FloatArray | None, budget: Budget
) -> Iterator[Corners]:
    """Where to rest between the targets: nowhere, then at the corners of collision-free paths."""
    if path is not None:
        yield (path[1:-1],)
        return
    yield (np.zeros((0, context.robot.n_joints)),) * len(request.segments)
    if not request.mode:  # paths of one segment were searched before
        return
    corners = []
    for segment in request.segments:
        ends = segment.start.positions, segment.goal.positions
        around = next(paths(context, ends, budget), None)
        if around is None:
            return
        corners.append(corners_of(context, around, budget)[1:-1])
    yield tuple(corners)


def _slow(context: Context, request: Request, usual: FloatArray, corners: Corners) -> Candidate:
    """The slow motion that rests at all targets and corners.

    Raises
    ------
    GoalError, TrajectoryError
        If it would take too long, or no durations keep the limits.
    """
    robot, limits, period = context.robot, context.limits, context.options.sample_period
    states = [request.start]
    for segment, points in zip(request.segments, corners, strict=True):
        states += [JointState(robot.joint_names, q) for q in points]
        states.append(segment.goal)
    counts = [1 + len(part) for part in corners]
    route = stop_and_go(robot, limits, states, period)
    if route.moves_at_ends:  # the knots of a brake are points of the trajectory
        first = _durations(context, request, route, counts, usual)[: counts[0]].sum()
        step = float(first / np.ceil(first / period - 1e-9))
        route = stop_and_go(robot, limits, states, step)
    for _ in range(_MAX_STRETCHES):
        durations = _durations(context, request, route, counts, usual)
        motions = route.motions(durations, counts)
        _, check = sampled(context, motions)
        if not check.violations:
            break
        route = replace(route, legs=slowdown(check.violations) * route.legs)
    else:
        raise TrajectoryError(str(check.violations[0]))
    bases = tuple(
        MotionBasis(Tables(motion.basis), motion.weights, None, 0, ()) for motion in motions
    )
    found = checked(context, request, bases, motions)
    return replace(found, n_stops=sum(map(len, corners)), how=SLOW)


def _durations(
    context: Context, request: Request, route: StopAndGo, counts: Sequence[int], usual: FloatArray
) -> FloatArray:
    """Durations of the legs, which share out those of the segments, shape (n_legs,) [s]."""
    legs, firsts = route.durations, np.cumsum([0, *counts[:-1]])
    least = np.add.reduceat(legs, firsts)
    durations = np.maximum(least, usual)
    for group, is_fixed in request.groups:
        if request.mode and is_fixed:
            part = list(group)
            needed, given = float(least[part].sum()), float(usual[part].sum())
            if needed > given * (1.0 + 1e-9):
                raise TrajectoryError("the times are too short to rest at each target")
            durations[part] = least[part] * (given / needed)
    if route.moves_at_ends and not (request.mode and request.groups[0][1]):
        # Between other points, the controller's quintics would exceed the jerk of the brake.
        durations[0] = route.step * np.ceil(durations[0] / route.step - 1e-9)
    context.check_duration("the slow motion would take", float(durations.sum()))
    return legs * np.repeat(durations / least, counts)
