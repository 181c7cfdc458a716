# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Movement primitives from recorded demonstrations, and motions made of them.

import mp_pca_planner as mp

demonstrations = mp.load_demonstrations("bags/", robot="arm.urdf")
reach = mp.MovementPrimitive.fit(demonstrations)
robot = mp.Robot.from_file("arm.urdf", reach.joint_names)
plan = mp.Planner(robot, [reach]).plan(start=q0, goal={"elbow": -1.2})
plan.trajectory.save("motion.csv")
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .exceptions import ControlError as ControlError
    from .exceptions import GoalError as GoalError
    from .exceptions import LearningError as LearningError
    from .exceptions import LimitsError as LimitsError
    from .exceptions import MissingDependencyError as MissingDependencyError
    from .exceptions import PlannerError as PlannerError
    from .exceptions import PrimitiveError as PrimitiveError
    from .exceptions import RecordingError as RecordingError
    from .exceptions import RobotError as RobotError
    from .exceptions import TrajectoryError as TrajectoryError
    from .exceptions import WorldError as WorldError
    from .files import config_file as config_file
    from .motion.goal import JointGoal as JointGoal
    from .motion.goal import JointState as JointState
    from .motion.goal import Pose as Pose
    from .motion.goal import PoseGoal as PoseGoal
    from .motion.goal import SequenceGoal as SequenceGoal
    from .motion.trajectory import Trajectory as Trajectory
    from .planning.context import Budget as Budget
    from .planning.options import PlannerOptions as PlannerOptions
    from .planning.path_constraints import Upright as Upright
    from .planning.plan import Plan as Plan
    from .planning.planner import Planner as Planner
    from .primitives.primitive import MovementPrimitive as MovementPrimitive
    from .recordings.demonstration import Demonstration as Demonstration
    from .recordings.load import load_demonstrations as load_demonstrations
    from .recordings.synthetic import write_example_recording as write_example_recording
    from .robot.limits import JointLimits as JointLimits
    from .robot.model import Robot as Robot
    from .robot.world import Box as Box
    from .robot.world import Capsule as Capsule
    from .robot.world import Cylinder as Cylinder
    from .robot.world import Mesh as Mesh
    from .robot.world import Obstacle as Obstacle
    from .robot.world import Sphere as Sphere
    from .robot.world import World as World
    from .view.content import show as show

__version__ = "0.1.0"

# Imported at first use, so that `import mp_pca_planner` is fast and loads only what is used.
_NAMES = {
    "exceptions": (
        "ControlError",
        "GoalError",
        "LearningError",
        "LimitsError",
        "MissingDependencyError",
        "PlannerError",
        "PrimitiveError",
        "RecordingError",
        "RobotError",
        "TrajectoryError",
        "WorldError",
    ),
    "motion.goal": ("JointGoal", "JointState", "Pose", "PoseGoal", "SequenceGoal"),
    "motion.trajectory": ("Trajectory",),
    "planning.path_constraints": ("Upright",),
    "planning.context": ("Budget",),
    "planning.options": ("PlannerOptions",),
    "planning.plan": ("Plan",),
    "planning.planner": ("Planner",),
    "primitives.primitive": ("MovementPrimitive",),
    "recordings.demonstration": ("Demonstration",),
    "recordings.load": ("load_demonstrations",),
    "recordings.synthetic": ("write_example_recording",),
    "files": ("config_file",),
    "robot.limits": ("JointLimits",),
    "robot.model": ("Robot",),
    "robot.world": ("Box", "Capsule", "Cylinder", "Mesh", "Obstacle", "Sphere", "World"),
    "view.content": ("show",),
}
_HOMES = {name: module for module, names in _NAMES.items() for name in names}
__all__ = sorted(_HOMES)


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    value = globals()[name] = getattr(import_module(f".{_HOMES[name]}", __name__), name)
    return value


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
