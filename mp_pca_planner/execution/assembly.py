# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Assembly of a planner from primitives, a robot description and settings."""

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
from .parameters import ParameterError, Settings
from .preemptive_worker import CancelledError

# Longest time to precompute warm starts [s]: a starting node waits for it.
_MAX_PRACTICE = 0.5


class InterruptibleRobot(Robot):
    """A robot whose dynamics raise an error when a solve is cancelled; each pass computes efforts.

    Attributes
    ----------
    is_cancelled : callable
        Whether to raise a `CancelledError`.
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
    """The planner of a node, and what it was made of.

    Attributes
    ----------
    planner : Planner
        For the planning thread alone.
    planning_robot : InterruptibleRobot
        The planner's robot.
    robot : Robot
        The same robot for all other threads.
    limits : JointLimits
        The limits of its joints.
    settings : Settings
        The parameters.
    end_effector : str
        The link of pose goals and previews.
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
        """For the planning thread alone; set up for the first sequence."""
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
        If these are inconsistent.
    """
    planning_robot = InterruptibleRobot(urdf, primitives[0].joint_names)
    robot = Robot(urdf, primitives[0].joint_names)
    file = settings.limits_file
    # The file describes the whole robot; the primitives may move a part of it.
    overrides = read_limits_file(file, robot.movable_joints) if file else {}
    limits = robot.limits(overrides, settings.limits)
    collision = None
    if settings.collision:
        folders = package_folders(settings.package_folders)
        srdf = settings.srdf or None
        collision = CollisionModel(planning_robot, srdf=srdf, package_dirs=folders)
    planner = Planner(planning_robot, primitives, limits, settings.planner_options, collision)
    planner.practise(_MAX_PRACTICE)
    frame = settings.end_effector_frame
    if frame and frame not in robot.frame_names:
        reason = unknown_name("link of the robot description", frame, robot.frame_names)
        raise ParameterError(f"parameter 'end_effector_frame': {reason}")
    frame = frame or robot.frame_names[-1]
    return Model(planner, planning_robot, robot, limits, settings, frame, urdf)
