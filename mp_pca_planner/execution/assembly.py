# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Files, robot description and settings → planner."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from ..arrays import FloatArray
from ..exceptions import unknown_name
from ..motion.collision import CollisionModel, package_folders
from ..planning.planner import Planner
from ..planning.sequence import SequencePlanner
from ..primitives.primitive import MovementPrimitive
from ..robot.limits import JointLimits, read_limits_file
from ..robot.model import Robot
from .newest_goal import CancelledError
from .parameters import ParameterError, Settings

# Time [s] for practice with primitives, which a node that starts has to wait for.
_LONGEST_PRACTICE = 0.5


class InterruptibleRobot(Robot):
    """A robot that can refuse to answer, which ends a solve: every pass of it asks for efforts.

    Attributes
    ----------
    is_cancelled : callable
        Whether to raise a `CancelledError` instead of an answer.
    """

    is_cancelled: Callable[[], bool] = staticmethod(lambda: False)

    def inverse_dynamics(self, q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
        """See the base class."""
        self._check()
        return super().inverse_dynamics(q, v, a)

    def inverse_dynamics_derivatives(self, *args: Any, **options: Any) -> Any:
        """See the base class."""
        self._check()
        return super().inverse_dynamics_derivatives(*args, **options)

    def _check(self) -> None:
        if self.is_cancelled():
            raise CancelledError


@dataclass(frozen=True, eq=False)
class Model:
    """What motions are planned with.

    Attributes
    ----------
    planner : Planner
        For the planning thread alone.
    planning_robot : InterruptibleRobot
        The planner's robot.
    robot : Robot
        The same robot for everybody else.
    limits : JointLimits
        The limits of its joints.
    settings : Settings
        What it was made with.
    end_effector : str
        The link of the robot that poses and previews are about.
    urdf : str
        The robot description.
    """

    planner: Planner
    planning_robot: InterruptibleRobot
    robot: Robot
    limits: JointLimits
    settings: Settings
    end_effector: str
    urdf: str

    @cached_property
    def sequence_planner(self) -> SequencePlanner:
        """For the planning thread alone; set up when the first sequence is asked for."""
        return SequencePlanner(
            self.planning_robot,
            self.planner.primitives,
            self.limits,
            naturalness=self.settings.naturalness,
            sample_period=self.settings.sample_period,
            max_solve_time=self.settings.max_solve_time,
            collision=self.planner.collision,
        )


def assemble_model(urdf: str, primitives: Sequence[MovementPrimitive], settings: Settings) -> Model:
    """Set up a planner for the joints of the primitives.

    Parameters
    ----------
    urdf :
        The robot description, XML text.
    primitives :
        At least one.
    settings :
        Limits and options.

    Raises
    ------
    PlannerError
        If these don't fit together.
    """
    planning_robot = InterruptibleRobot(urdf, primitives[0].joint_names)
    robot = Robot(urdf, primitives[0].joint_names)
    file = settings.limits_file
    # Such a file describes the whole robot, the primitives may move a part of it.
    overrides = read_limits_file(file, robot.movable_joints) if file else {}
    limits = robot.limits(overrides, settings.limits)
    collision = None
    if settings.collision:
        folders = package_folders(settings.package_folders)
        srdf = settings.srdf or None
        collision = CollisionModel(planning_robot, srdf=srdf, package_dirs=folders)
    planner = Planner(planning_robot, primitives, limits, settings.planner_options, collision)
    planner.practise(_LONGEST_PRACTICE)
    frame = settings.end_effector_frame
    if frame and frame not in robot.frame_names:
        reason = unknown_name("link of the robot description", frame, robot.frame_names)
        raise ParameterError(f"parameter 'end_effector_frame': {reason}")
    frame = frame or robot.frame_names[-1]
    return Model(planner, planning_robot, robot, limits, settings, frame, urdf)
