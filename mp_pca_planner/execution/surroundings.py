# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The obstacles around a robot while it executes motions."""

from __future__ import annotations

import threading

from ..exceptions import RobotError
from ..motion.collision import Collision, CollisionModel
from ..robot.world import World
from .assembly import Model, collision_model
from .following import Following


class Surroundings:
    """The newest obstacles, for planning and for the check of a running motion.

    The planner has a collision model of its own, which only the thread of planning uses. Running
    motions are checked in any thread with another one. Both are made when the first obstacle is
    known.
    """

    def __init__(self) -> None:
        self._world = World()
        self._lock = threading.Lock()
        self._checker: tuple[Model, CollisionModel] | None = None

    @property
    def world(self) -> World:
        """The newest obstacles."""
        return self._world

    def replace(self, world: World, model: Model | None) -> None:
        """Use other obstacles from now on.

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
            before, self._world = self._world, world
            if model is None or not len(world):
                return
            try:
                checker = self._checker_of(model)
            except RobotError:
                self._checker = None
                raise
            try:
                checker.set_world(world)
            except Exception:
                self._world = before
                raise

    def prepare(self, model: Model) -> World:
        """Give the planner the newest obstacles, in its own thread; return them.

        Raises
        ------
        PlannerError
            If they can't be avoided.
        """
        world, planner = self._world, model.planner
        if planner.collision is None:
            if not len(world):
                return world
            planner.use_collision(collision_model(model.planning_robot, model.settings))
        collision = planner.collision
        assert collision is not None
        if collision.world is not world:
            if len(world) and not collision.has_geometry:
                raise _without_geometry()
            collision.set_world(world)
        return world

    def threat(self, model: Model, following: Following | None) -> Collision | None:
        """The next collision of a running motion with an obstacle; None if there is none.

        Raises
        ------
        PlannerError
            If motions can't be checked.
        """
        with self._lock:
            world = self._world
            if following is None or not following.is_running or not len(world):
                return None
            checker = self._checker_of(model)
            if checker.world is not world:
                checker.set_world(world)
            place = following.progress.place
            found = checker.collisions(following.motion.trajectory)
            ahead = [one for one in found if one.last_time >= place]
            return min(ahead, key=lambda one: one.first_time, default=None)

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
