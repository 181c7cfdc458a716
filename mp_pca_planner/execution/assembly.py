# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Assembly of a planner from primitives, a robot description and settings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from ..exceptions import unknown_name
from ..motion.collision import CollisionModel, package_folders
from ..planning.objectives import objective_weights, weighted_objectives
from ..planning.options import SolverOptions
from ..planning.path_constraints import path_constraints
from ..planning.planner import Planner
from ..primitives.primitive import MovementPrimitive
from ..robot.limits import JointLimits
from ..robot.model import Robot
from .parameters import ParameterError, Settings
from .preemptive_worker import IsCancelled


class Cancellation:
    """Stops the planner when a goal is cancelled.

    Attributes
    ----------
    is_cancelled : callable
        Whether the plan is no longer needed.
    """

    is_cancelled: IsCancelled = staticmethod(lambda: False)

    def __call__(self) -> bool:
        """Whether the plan is no longer needed, see `is_cancelled`."""
        return self.is_cancelled()


@dataclass(frozen=True, eq=False)
class Model:
    """The planner of a node with its robot, limits and settings.

    Attributes
    ----------
    planner : Planner
        The planner; for the planning thread alone.
    planning_robot : Robot
        The planner's robot.
    cancellation : Cancellation
        Stops the planner.
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
    planning_robot: Robot
    cancellation: Cancellation
    robot: Robot
    limits: JointLimits
    settings: Settings
    end_effector: str
    urdf: str


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
    planning_robot = Robot(urdf, primitives[0].joint_names)
    robot = Robot(urdf, primitives[0].joint_names)
    limits = robot.limits(settings.limits_file or {}, settings.limits)
    collision = collision_model(planning_robot, settings) if settings.collision else None
    cancellation = Cancellation()
    frame = settings.end_effector_frame or robot.end_effector
    if frame not in robot.frame_names:
        reason = unknown_name("link of the robot description", frame, robot.frame_names)
        raise ParameterError(f"parameter 'end_effector_frame': {reason}")
    weights = objective_weights(settings.objective, "parameter 'objective'")
    options = replace(
        settings.planner_options,
        solver=SolverOptions(should_stop=cancellation),
        objectives=weighted_objectives(weights, planning_robot, frame),
        constraints=path_constraints(
            settings.constraints, "parameter 'constraints'", planning_robot
        ),
    )
    planner = Planner(planning_robot, primitives, limits, options, collision)
    planner.precompute(0.5)  # a starting node waits that long [s]
    return Model(planner, planning_robot, cancellation, robot, limits, settings, frame, urdf)


def collision_model(
    robot: Robot, settings: Settings, *, self_collision: bool | None = None
) -> CollisionModel:
    """The collision model of a robot without obstacles.

    Parameters
    ----------
    robot :
        The robot.
    settings :
        With the files of the geometry and the margin.
    self_collision :
        Whether pairs of links are checked; as the settings say unless given.

    Raises
    ------
    RobotError
        If the geometry can't be read.
    """
    return CollisionModel(
        robot,
        srdf=settings.srdf or None,
        package_dirs=package_folders(settings.package_folders),
        margin=settings.obstacle_margin,
        self_collision=settings.collision if self_collision is None else self_collision,
    )
