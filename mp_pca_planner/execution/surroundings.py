# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The obstacles around a robot while it executes motions."""

from __future__ import annotations

import threading
from dataclasses import dataclass

from ..exceptions import GoalError, RobotError
from ..motion.collision import Collision, CollisionModel
from ..motion.trajectory import Trajectory
from ..robot.world import World
from .assembly import Model, collision_model
from .start_state import StartStates, TooLateError


@dataclass(frozen=True)
class Threat:
    """A collision of the rest of the running motion with an obstacle, and when it begins [s]."""

    collision: Collision
    time: float

    @property
    def reason(self) -> str:
        """Why the running motion has to be replaced."""
        link, obstacle = self.collision.links
        return f"a new obstacle is on the path ('{link}' would hit '{obstacle}')"


class Surroundings:
    """The newest obstacles, for planning and for the check of the running motion.

    The planner has a collision model of its own, which only the thread of planning uses. Running
    motions are checked in any thread with another one. Both are made when the first obstacle is
    known.

    Parameters
    ----------
    states :
        Source of the robot's place on its motion.

    Attributes
    ----------
    missing : str
        Why an obstacle that was given is not avoided; empty if all are.
    """

    def __init__(self, states: StartStates) -> None:
        self._states, self._world = states, World()
        self._lock = threading.Lock()
        self._checker: tuple[Model, CollisionModel] | None = None
        self.missing = ""

    @property
    def world(self) -> World:
        """The newest obstacles."""
        return self._world

    @property
    def threat(self) -> Threat | None:
        """What the running motion would hit; None if nothing is known to be on its path."""
        published = self._states.published
        return None if published is None else published.threat

    def replace(self, world: World, model: Model | None) -> bool:
        """Use other obstacles from now on; return whether a motion would hit one of them.

        Parameters
        ----------
        world : World
            The obstacles.
        model : Model or None
            The robot, if it is known.

        Raises
        ------
        WorldError
            If they don't fit the robot, such as an obstacle on an unknown link; the present ones
            are kept then.
        RobotError
            If the robot's collision geometry can't be used; the new obstacles are kept, and goals
            are rejected.
        """
        with self._lock:
            if model is not None and len(world):
                try:
                    checker = self._checker_of(model)
                except RobotError:
                    self._world = world
                    raise
                checker.set_world(world)
            self._world = world
        if model is not None:
            self.look_ahead(model)
        return self.threat is not None

    def prepare(self, model: Model) -> World:
        """Give the planner the newest obstacles, in its own thread; return them.

        Raises
        ------
        PlannerError
            If they can't be avoided.
        """
        world, planner = self._world, model.planner
        if planner.collision is None and len(world):
            planner.use_collision(collision_model(model.planning_robot, model.settings))
        collision = planner.collision
        if collision is not None and collision.world is not world:
            if len(world) and not collision.has_geometry:
                raise _without_geometry()
            collision.set_world(world)
        return world

    def check_again(self, trajectory: Trajectory, planned_in: World, model: Model) -> World:
        """Check a planned motion if the obstacles have changed since; return the newest ones.

        Raises
        ------
        TooLateError
            If it collides with them.
        """
        if self._world is planned_in:
            return planned_in
        world, collision = self.prepare(model), model.planner.collision
        found = () if collision is None else collision.collisions(trajectory)
        if found:
            raise TooLateError(
                f"the obstacles changed during planning: {found[0]}; send the goal again"
            )
        return world

    def look_ahead(self, model: Model) -> None:
        """Check the rest of the running motion of a goal, and set its `threat`.

        Raises
        ------
        PlannerError
            If the motion can't be checked.
        """
        published = self._states.published
        if published is None or published.execution is None or published.execution.is_stop:
            return
        try:
            following = self._states.follow(model.settings)
        except GoalError:  # the robot may be anywhere on its motion
            return
        published.threat = None
        if following is None or following.motion is not published.joined.motion:
            return
        motion, place = following.motion, following.progress.place
        with self._lock:
            if not (following.is_running and len(self._world) and place < motion.duration):
                return
            checker = self._checker_of(model)
            if checker.world is not self._world:
                checker.set_world(self._world)
            found = checker.collisions(motion.rest(place))
        if found:
            first = min(found, key=lambda one: one.first_time)
            published.threat = Threat(first, motion.began + place + first.first_time)

    def _checker_of(self, model: Model) -> CollisionModel:
        if self._checker is None or self._checker[0] is not model:
            checker = collision_model(model.robot, model.settings, self_collision=False)
            if not checker.has_geometry:
                raise _without_geometry()
            self._checker = model, checker
        return self._checker[1]


def _without_geometry() -> RobotError:
    return RobotError(
        "obstacles can't be avoided: the robot description has no collision geometry; add "
        "<collision> to its links, or remove the obstacles"
    )
