# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Assembly of a planner from primitives, a robot description and settings."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

from ...exceptions import PlannerError, RobotError, quote_names, unknown_name
from ...motion.collision import CollisionModel, package_folders
from ...planning.objectives import objective_weights, weighted_objectives
from ...planning.path_constraints import PathConstraint, path_constraints
from ...planning.planner import Planner
from ...primitives.primitive import MovementPrimitive
from ...robot.limits import JointLimits, Overrides
from ...robot.model import Robot
from ...robot.world import World
from ..parameters import Settings, locked_positions
from ..threads import IsCancelled

LOCKED_TOLERANCE = 1e-3
"""Distance from its position in the model up to which a locked joint counts as there [rad or m]:
more than the noise of sensors."""


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

    @contextmanager
    def by(self, is_cancelled: IsCancelled) -> Iterator[None]:
        """Context manager in which this callable says whether the plan is no longer needed."""
        before, self.is_cancelled = self.is_cancelled, is_cancelled
        try:
            yield
        finally:
            # Kept, it would keep the model alive that it stops: freeing that later, in a search for
            # garbage, stops all threads for up to 20 ms.
            self.is_cancelled = before


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
    collision : CollisionModel or None
        The collision model without obstacles, which is never changed: threads use copies of it with
        obstacles. None if the robot's collision geometry can't be used.
    constraints : tuple of PathConstraint
        Constraints on every configuration.
    """

    planner: Planner
    planning_robot: Robot
    cancellation: Cancellation
    robot: Robot
    limits: JointLimits
    settings: Settings
    end_effector: str
    urdf: str
    collision: CollisionModel | None = None
    constraints: tuple[PathConstraint, ...] = ()


def assemble_model(
    urdf: str,
    primitives: Sequence[MovementPrimitive],
    settings: Settings,
    measured: Mapping[str, float] | None = None,
) -> Model:
    """Set up a planner for the joints of the primitives.

    Parameters
    ----------
    urdf :
        The robot description, XML text.
    primitives :
        At least one.
    settings :
        Limits and options.
    measured :
        Measured positions of any joints [rad or m]; those that the primitives do not move are
        locked there.

    Raises
    ------
    PlannerError
        If these are inconsistent.
    """
    joint_names = primitives[0].joint_names
    locked = _locked(_checked(Robot(urdf, joint_names), settings), settings, measured or {})
    given: tuple[Overrides | str, ...] = (settings.limits_file or {}, settings.limits)
    planning_robot, robot = (
        Robot(urdf, joint_names, locked=locked).with_drives(*given) for _ in range(2)
    )
    limits = robot.limits(*given)
    # Made now, so that no goal or stop among the first obstacles waits for it.
    collision = None
    try:
        collision = collision_model(planning_robot, settings)
    except RobotError:
        if settings.collision:
            raise
    cancellation = Cancellation()
    frame = settings.end_effector_frame or robot.end_effector
    if frame not in robot.frame_names:
        reason = unknown_name("link of the robot description", frame, robot.frame_names)
        raise PlannerError(f"parameter 'end_effector_frame': {reason}")
    weights = objective_weights(settings.objective, "parameter 'objective'")
    options = replace(
        settings.planner_options,
        should_stop=cancellation,
        objectives=weighted_objectives(weights, planning_robot, frame),
        constraints=path_constraints(
            settings.constraints, "parameter 'constraints'", planning_robot
        ),
    )
    planner = Planner(planning_robot, primitives, limits, options)
    if collision is not None and settings.collision:
        planner.use_collision(collision.with_world(World()))
    own = planner, planning_robot, cancellation
    return Model(*own, robot, limits, settings, frame, urdf, collision, options.constraints)


def is_outdated(model: Model, measured: Mapping[str, float], world: World) -> bool:
    """Whether a joint that makes a difference was measured away from where a model locks it.

    Parameters
    ----------
    model :
        The model.
    measured :
        Measured positions of any joints [rad or m].
    world :
        The obstacles.
    """
    used = model.robot.locked_positions
    moved = {
        name
        for name, position in _locked(model.robot, model.settings, measured).items()
        if name not in used or abs(position - used[name]) > LOCKED_TOLERANCE
    }
    return bool(moved and moved.intersection(_relevant(model, world)))


def unknown_positions(model: Model, world: World) -> str:
    """Which joints make a difference and have an unknown position; empty if there are none."""
    known, relevant = model.robot.locked_positions, _relevant(model, world)
    if texts := model.robot.mimicry(relevant):
        return texts[0]
    unknown = [name for name in relevant if name not in known]
    if not unknown:
        return ""
    return (
        f"the positions of joints {quote_names(unknown)} are not known: the primitives do not move "
        "them, but they place links with a mass or a collision shape; publish them in "
        "joint_states, or set the parameter 'locked_joints' (name=value,…)"
    )


def _relevant(model: Model, world: World) -> tuple[str, ...]:
    """The locked joints whose positions make a difference."""
    links = {model.settings.end_effector_frame, *(obstacle.frame for obstacle in world)}
    links |= {constraint.frame for constraint in model.constraints}
    return model.robot.relevant_joints(pairs=model.settings.collision, links=links)


def _checked(robot: Robot, settings: Settings) -> Robot:
    """The robot, if it has all locked joints of the settings, and the primitives move none."""
    known = [name for name in robot.movable_joints if name not in robot.joint_names]
    for name in locked_positions(settings.locked_joints):
        if name not in known:
            reason = unknown_name("joint that the primitives do not move", name, known)
            raise PlannerError(f"parameter 'locked_joints': {reason}")
    return robot


def _locked(robot: Robot, settings: Settings, measured: Mapping[str, float]) -> dict[str, float]:
    """Positions of the joints that do not move: those given, replaced by those measured."""
    given = locked_positions(settings.locked_joints)
    names = set(robot.movable_joints) - set(robot.joint_names)
    return {
        name: position
        for name, position in {**given, **measured}.items()
        if name in names and math.isfinite(position)
    }


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
