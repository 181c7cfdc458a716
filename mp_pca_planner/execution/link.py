# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""What the node and its workers say to each other: values that can be pickled.

The *planner* has the primitives and plans; the *watcher* checks the running motion against the
newest obstacles, around the robot that the planner has accepted. The node sends both the obstacles.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

from ..motion.goal import Goal, JointState
from ..motion.trajectory import Trajectory
from ..motion.validation import LimitCheck
from ..robot.limits import JointLimits, Overrides
from .parameters import Settings


@dataclass(frozen=True, eq=False)
class SetUp:
    """Primitives, robot and parameters to use, if they fit together; else those before stay.

    Attributes
    ----------
    number : int
        Identifies the answer.
    urdf : str
        The robot description, XML text; empty if there is none yet.
    settings : Settings
        The parameters.
    measured : mapping of str to float
        Measured positions of joints that the primitives do not move [rad or m].
    rereads : bool
        Whether the primitive files are read again.
    """

    number: int
    urdf: str
    settings: Settings
    measured: Mapping[str, float] = field(default_factory=dict)
    rereads: bool = False


@dataclass(frozen=True, eq=False)
class ModelFacts:
    """What the node needs to know of the planner's model.

    Attributes
    ----------
    limits : JointLimits
        Limits of the joints.
    drives : mapping
        Their drives, see :meth:`.Robot.with_drives`.
    locked : mapping of str to float
        Known positions of joints that do not move [rad or m].
    carriers : tuple of str
        Those of them that carry the arm.
    unknown : str
        Which joints make a difference and have an unknown position; empty if there are none.
    end_effector : str
        The link of pose goals.
    notes : tuple of str
        What a user should know.
    """

    limits: JointLimits
    drives: Overrides
    locked: Mapping[str, float]
    carriers: tuple[str, ...]
    unknown: str
    end_effector: str
    notes: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class SetUpDone:
    """The answer to a set-up.

    Attributes
    ----------
    number : int
        That of the set-up.
    joint_names : tuple of str
        Joints of the primitives; none if there are no primitives.
    primitives : tuple of str
        Names of the primitives.
    model : ModelFacts or None
        None if there are no primitives or no robot description, or there is a problem.
    problem : str
        Why it can't be used; empty if it is used.
    is_unreadable : bool
        Whether the primitive files can't be read.
    """

    number: int
    joint_names: tuple[str, ...] = ()
    primitives: tuple[str, ...] = ()
    model: ModelFacts | None = None
    problem: str = ""
    is_unreadable: bool = False


@dataclass(frozen=True)
class WatchedRobot:
    """The robot of an accepted set-up, as the watcher needs it; it waits for no primitives.

    Attributes
    ----------
    urdf : str
        The robot description, XML text.
    joint_names : tuple of str
        Joints of the motions.
    locked : mapping of str to float
        Known positions of the others [rad or m].
    settings : Settings
        The parameters.
    """

    urdf: str
    joint_names: tuple[str, ...]
    locked: Mapping[str, float]
    settings: Settings


@dataclass(frozen=True, eq=False)
class Positions:
    """Measured positions of joints that the primitives do not move [rad or m]."""

    measured: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class RunningMotion:
    """The motion of a goal that a robot follows, to be continued to another goal.

    Attributes
    ----------
    planned : Planned
        What was planned for that goal, with the motion as it was published.
    place : float
        Where on it the next motion begins [s].
    is_over : bool
        Whether the robot holds its end.
    """

    planned: Planned
    place: float
    is_over: bool


@dataclass(frozen=True, eq=False)
class PlanRequest:
    """A goal to plan for.

    Attributes
    ----------
    key : int
        Identifies the answer; later goals have larger ones.
    goal : Goal
        The goal.
    start : JointState
        Where the motion begins.
    measured : mapping of str to float
        Measured positions of joints that do not move [rad or m].
    running : RunningMotion or None
        The motion that it continues.
    """

    key: int
    goal: Goal
    start: JointState
    measured: Mapping[str, float] = field(default_factory=dict)
    running: RunningMotion | None = None


@dataclass(frozen=True, eq=False)
class Planned:
    """A motion for a goal.

    Attributes
    ----------
    key : int
        That of the request.
    goal : Goal
        The goal, in the frame of the base.
    trajectory : Trajectory
        The motion, within the limits.
    check : LimitCheck
        Its comparison with the limits.
    message, remarks : str, tuple of str
        A sentence, and what is unusual about the motion.
    values : mapping
        Scalar facts, by the names of the package's public interface.
    primitives : tuple of str
        Names of its primitives.
    laws : mapping of str to str
        What is known of their control laws.
    planned_duration, solve_time : float
        Duration of the planned motion, perhaps displaced several times since; time taken to find
        it [s].
    """

    key: int
    goal: Goal
    trajectory: Trajectory
    check: LimitCheck
    message: str
    remarks: tuple[str, ...]
    values: Mapping[str, Any]
    primitives: tuple[str, ...]
    laws: Mapping[str, str]
    planned_duration: float
    solve_time: float


@dataclass(frozen=True, eq=False)
class Rejected:
    """A goal that no motion serves.

    Attributes
    ----------
    key : int
        That of the request.
    reason : str
        Why, one sentence.
    values : mapping
        Facts of the plan that may not be executed; none if there is no plan.
    is_preempted : bool
        Whether it was cancelled.
    """

    key: int
    reason: str
    values: Mapping[str, Any] = field(default_factory=dict)
    is_preempted: bool = False


@dataclass(frozen=True, eq=False)
class WorldFacts:
    """What a worker knows of the obstacles.

    Attributes
    ----------
    n_obstacles : int
        Their number.
    missing : str
        Why an obstacle that was given is not avoided; empty if all are.
    frames : tuple of str
        Frames of obstacles that are neither links nor fixed.
    """

    n_obstacles: int
    missing: str = ""
    frames: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Watch:
    """The motion to watch from now on, and the first place that counts [s]."""

    number: int
    trajectory: Trajectory
    place: float


@dataclass(frozen=True, eq=False)
class Place:
    """Where the robot is on the motion that is watched [s]."""

    number: int
    place: float


@dataclass(frozen=True, eq=False)
class Verdict:
    """What the watched motion would hit.

    Attributes
    ----------
    number : int
        That of the motion.
    place : float
        Where on it that begins [s]; infinite if nothing is in its way.
    last : float
        Where the last collision on it ends [s].
    reason : str
        One sentence on it.
    """

    number: int
    place: float = math.inf
    last: float = math.inf
    reason: str = ""


@dataclass(frozen=True, eq=False)
class WorkerDied:
    """A worker has ended; it is being started again."""

    reason: str


class Link(Protocol):
    """A way to a worker."""

    def send(self, message: object) -> None:
        """Send a message; it never waits."""

    def cancel(self, key: int) -> None:
        """Ask the planner to end its work on a request, and on all before."""
