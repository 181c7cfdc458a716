# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""States, poses and goals, the values of a request, and their conversion from arrays and dicts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeGuard, cast

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import (
    FloatArray,
    by_name,
    check_number,
    check_type,
    float_array,
    frozen_array,
    is_number,
    set_frozen,
    unique_names,
)
from ..exceptions import GoalError, quote_names, shown, unknown_name
from ..input_limits import INPUT_LIMITS
from ..robot.world import unit_quaternion


@dataclass(frozen=True, eq=False)
class JointState:
    """Positions, velocities and accelerations of named joints at one moment.

    Attributes
    ----------
    joint_names : tuple of str
        Names of the joints.
    positions : array, shape (n_joints,)
        Joint positions [rad or m].
    velocities, accelerations : array, shape (n_joints,)
        Their derivatives [/s, /s²]; zero unless given.

    Raises
    ------
    GoalError
        If names repeat, lengths differ or a number is not finite.

    Examples
    --------
    >>> import mp_pca_planner as mp
    >>> state = mp.JointState(["shoulder", "elbow"], [0.2, -0.5])
    >>> state.velocities.tolist()
    [0.0, 0.0]
    """

    joint_names: tuple[str, ...]
    positions: FloatArray
    velocities: FloatArray
    accelerations: FloatArray

    def __init__(
        self,
        joint_names: Sequence[str],
        positions: ArrayLike,
        velocities: ArrayLike | None = None,
        accelerations: ArrayLike | None = None,
    ) -> None:
        names = unique_names(joint_names, "joints of a state", GoalError)
        set_frozen(self, joint_names=names)
        zero = np.zeros(len(names))
        for field, values in (
            ("positions", positions),
            ("velocities", zero if velocities is None else velocities),
            ("accelerations", zero if accelerations is None else accelerations),
        ):
            set_frozen(self, **{field: frozen_array(values, zero.shape, field, GoalError)})

    @property
    def values(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Positions, velocities and accelerations."""
        return self.positions, self.velocities, self.accelerations


@dataclass(frozen=True, eq=False)
class Pose:
    """Desired pose of a frame of the robot.

    Attributes
    ----------
    frame : str
        Name of the frame, a link or joint of the robot.
    position : array, shape (3,)
        Its origin in the robot's base frame [m].
    orientation : array, shape (4,), or None
        Its orientation as a unit quaternion (x, y, z, w); None leaves it free.

    Raises
    ------
    GoalError
        If a shape is wrong, a number not finite, or the quaternion not of length 1.

    Examples
    --------
    >>> import mp_pca_planner as mp
    >>> anywhere_turned = mp.Pose("hand", [0.4, 0.1, 0.3])
    >>> upright = mp.Pose("hand", [0.4, 0.1, 0.3], [0.0, 0.0, 0.0, 1.0])
    >>> anywhere_turned.orientation is None
    True
    """

    frame: str
    position: FloatArray
    orientation: FloatArray | None

    def __init__(
        self, frame: str, position: ArrayLike, orientation: ArrayLike | None = None
    ) -> None:
        position = frozen_array(position, (3,), "position of a pose", GoalError)
        if orientation is not None:
            what = "the orientation of a pose"
            orientation = unit_quaternion(orientation, what, GoalError)
        set_frozen(self, frame=frame, position=position, orientation=orientation)


def _check_duration(duration: float | None) -> None:
    if duration is not None:
        what = "the duration of a motion [s], which `PlannerOptions(timing=…)` chooses without one,"
        check_number(duration, what, GoalError, 1e-6)


@dataclass(frozen=True, eq=False)
class JointGoal:
    """A configuration to reach.

    Attributes
    ----------
    state : JointState or mapping
        Configuration at the end of the motion, with the velocities and accelerations
        there. Joints of the robot that it doesn't name keep their present position.
    duration : float or None
        Duration of the motion [s]; None leaves it to the planner.
    primitive : str or None
        Name of the primitive to use; None leaves it to the planner.

    Raises
    ------
    GoalError
        If a field is something else.

    Examples
    --------
    >>> import mp_pca_planner as mp
    >>> goal = mp.JointGoal(mp.JointState(["elbow"], [-0.8]), duration=2.0)
    >>> goal.duration
    2.0
    """

    state: JointState
    duration: float | None = None
    primitive: str | None = None

    def __post_init__(self) -> None:
        _check_duration(self.duration)
        set_frozen(self, state=_named(self.state, "the state of a goal", JointState))


@dataclass(frozen=True, eq=False)
class PoseGoal:
    """A pose to reach, at rest; the planner chooses the configuration.

    Attributes
    ----------
    pose : Pose
        Pose of a frame of the robot at the end of the motion.
    duration, primitive
        As of a `JointGoal`.

    Raises
    ------
    GoalError
        If a field is something else.

    Examples
    --------
    >>> import mp_pca_planner as mp
    >>> goal = mp.PoseGoal(mp.Pose("hand", [0.4, 0.1, 0.3]))
    >>> goal.duration is None
    True
    """

    pose: Pose
    duration: float | None = None
    primitive: str | None = None

    def __post_init__(self) -> None:
        _check_duration(self.duration)


@dataclass(frozen=True, eq=False)
class SequenceGoal:
    """Configurations and poses to reach one after the other, at rest only where requested.

    Attributes
    ----------
    targets : tuple of JointState, mapping or Pose
        At least one. Joints that a state doesn't name keep the position they had before.
    times : tuple of (float or None)
        Time of each target after the start [s]; None leaves it to the planner.
    primitive : str or None
        Name of the primitive to use; None leaves it to the planner, for each segment.
    stops : tuple of bool
        Whether to rest at each target; the motion always rests at the last one, and by default
        only there.

    Raises
    ------
    GoalError
        If there is no target, one is something else, the numbers of targets, times and stops
        differ, or times don't increase.

    Examples
    --------
    >>> import mp_pca_planner as mp
    >>> above, there = (mp.JointState(["elbow"], [q]) for q in (-0.4, -0.8))
    >>> goal = mp.SequenceGoal([above, there], times=[1.0, None])
    >>> len(goal.targets)
    2
    """

    targets: tuple[JointState | Pose, ...]
    times: tuple[float | None, ...] = ()
    primitive: str | None = None
    stops: tuple[bool, ...] = ()

    def __post_init__(self) -> None:
        n = len(self.targets)
        _check_count(n)
        named = (_named(x, "a target", JointState, Pose) for x in self.targets)
        set_frozen(self, targets=tuple(named))
        for field, what, usual in (("times", "time (or None)", None), ("stops", "stop", False)):
            given = tuple(getattr(self, field)) or (usual,) * n
            set_frozen(self, **{field: given})
            if len(given) != n:
                raise GoalError(
                    f"a sequence needs a {what} for each of its {n} targets, got {len(given)}"
                )
        stated = [0.0, *(time for time in self.times if time is not None)]
        if not (all(map(is_number, stated)) and np.all(np.diff(stated) > 0.0)):
            raise GoalError(
                f"the times of a sequence must be positive and increase, got {shown(self.times)}"
            )


Goal = JointGoal | PoseGoal | SequenceGoal


StateLike = JointState | Mapping[str, float] | ArrayLike
"""A configuration: positions by joint name, or of all joints of the robot in their order."""

TargetLike = StateLike | Pose
GoalLike = Goal | TargetLike | Sequence[TargetLike]


def as_state(value: StateLike, joint_names: Sequence[str], what: str) -> JointState:
    """Make a state of positions.

    Parameters
    ----------
    value : JointState, mapping or array, shape (n_joints,)
        Positions [rad or m] by joint name, or of all joints in their order.
    joint_names : sequence of str
        The joints of an array, n_joints of them.
    what : str
        Name of the state in messages.

    Raises
    ------
    GoalError
        If the value is none of these, or its length is not the number of joints.
    """
    if isinstance(value, JointState):
        return value
    names: Sequence[str] = tuple(value) if isinstance(value, Mapping) else joint_names
    given = list(value.values()) if isinstance(value, Mapping) else value
    try:
        positions = float_array(given, what, GoalError, (len(names),))
    except GoalError:
        raise GoalError(
            f"{what} must be one position [rad or m] for each of the {len(joint_names)} joints "
            f"({', '.join(joint_names)}), or a dict of positions by joint name, got "
            f"{shown(given, 100)}"
        ) from None
    for name, position in zip(names, positions, strict=True):
        if not np.isfinite(position):
            raise GoalError(f"{what}: the position of joint '{name}' is {position}, not finite")
    return JointState(names, positions)


def joint_positions(
    value: StateLike, joint_names: Sequence[str], what: str, others: FloatArray | None = None
) -> FloatArray:
    """Positions of all joints in their order, shape (n_joints,), see :func:`as_state`.

    Joints that are not named take their positions from `others`, shape (n_joints,), if given.

    Raises
    ------
    GoalError
        If the value is no state of these joints.
    """
    state = as_state(value, joint_names, what)
    known = {} if others is None else by_name(joint_names, others)
    for name, position in zip(state.joint_names, state.positions, strict=True):
        if name not in joint_names:
            raise GoalError(f"{what}: {unknown_name('joint', name, joint_names)}")
        known[name] = position
    missing = [name for name in joint_names if name not in known]
    if missing:
        raise GoalError(f"{what} lacks a position for {quote_names(missing)}")
    return np.array([known[name] for name in joint_names])


def as_goal(value: GoalLike, joint_names: Sequence[str], duration: float | None = None) -> Goal:
    """Make a goal of a target or of several.

    Parameters
    ----------
    value : Goal, Pose, JointState, mapping, array or sequence of these
        One target becomes a goal to reach at rest; several become a sequence, passed without a
        stop. A sequence of one target becomes the goal of that target; others are not changed.
    joint_names : sequence of str
        The joints of an array, n_joints of them.
    duration : float, optional
        Duration of the motion [s]; chosen by the planner unless given.

    Raises
    ------
    GoalError
        If the value is none of these, or a duration is given for a finished goal.
    """
    if isinstance(value, Goal) and duration is not None:
        raise GoalError(
            f"a {type(value).__name__} has its own duration or times: remove `duration`"
        )
    if not isinstance(value, Goal) and _is_several(value):
        _check_count(len(value))
        targets = [
            target if isinstance(target, Pose) else as_state(target, joint_names, f"target {i}")
            for i, target in enumerate(value, 1)
        ]
        times = (*(None for _ in targets[1:]), duration)
        value = SequenceGoal(tuple(targets), times)
    if isinstance(value, SequenceGoal) and len(value.targets) == 1:
        (only,), (duration,), primitive = value.targets, value.times, value.primitive
        if isinstance(only, Pose):
            return PoseGoal(only, duration, primitive)
        return JointGoal(JointState(only.joint_names, only.positions), duration, primitive)
    if isinstance(value, Goal):
        return value
    if isinstance(value, Pose):
        return PoseGoal(value, duration)
    return JointGoal(as_state(cast(StateLike, value), joint_names, "the goal"), duration)


def _check_count(n_targets: int) -> None:
    """Reject sequences without a target, and those that would exceed time or memory."""
    most = INPUT_LIMITS.targets
    check_number(n_targets, "the number of targets", GoalError, 1, most, is_whole=True)


def _is_several(value: object) -> TypeGuard[Sequence[TargetLike]]:
    """Whether a value is a list of targets, rather than one list of positions."""
    if isinstance(value, np.ndarray):
        return value.ndim == 2
    kinds = (JointState, Pose, Mapping, Sequence, np.ndarray)
    # A range is a sequence of any length.
    is_list = isinstance(value, Sequence) and not isinstance(value, range)
    return is_list and any(isinstance(target, kinds) for target in cast(Sequence[Any], value))


def _named(value: Any, what: str, *kinds: type) -> Any:
    """A value of some types, or the state that a mapping describes."""
    check_type(value, what, GoalError, *kinds, Mapping)
    return as_state(value, (), what) if isinstance(value, Mapping) else value
