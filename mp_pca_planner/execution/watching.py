# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The watcher: checks the running motion against the newest obstacles, in a process of its own."""

from __future__ import annotations

from ..exceptions import PlannerError
from ..motion.collision import CollisionModel
from ..robot.world import World
from .link import Place, Verdict, Watch, WatchedRobot
from .planning import Model, WatchedModel, in_world


class Watcher:
    """Says what the motion that it watches would hit.

    Attributes
    ----------
    model : Model, WatchedModel or None
        The robot.
    world : World
        The obstacles.
    """

    def __init__(self) -> None:
        self.model: Model | WatchedModel | None = None
        self.world = World()
        self._watch: Watch | None = None
        self._place = 0.0
        self._checked: tuple[object, ...] = ()
        self._collision: tuple[object, World, CollisionModel] | None = None

    def receive(self, message: WatchedRobot | Watch | Place) -> None:
        """Watch another robot or motion, or note how far the robot is."""
        if isinstance(message, WatchedRobot):
            self.model = WatchedModel.of(message)
        elif isinstance(message, Watch):
            self._watch, self._place = message, message.place
        elif self._watch is not None and message.number == self._watch.number:
            self._place = message.place

    def look(self) -> Verdict | None:
        """Check the rest of the motion; None if neither it nor the obstacles have changed."""
        watch, model, world = self._watch, self.model, self.world
        if watch is None or model is None or self._checked == (watch.number, model, world):
            return None
        self._checked = watch.number, model, world
        trajectory = watch.trajectory
        if not len(world) or self._place >= trajectory.duration or trajectory.n_steps < 2:
            return Verdict(watch.number)
        try:
            known = self._collision
            if known is None or known[0] is not model or known[1] is not world:
                known = self._collision = model, world, in_world(model, world)
        except PlannerError:  # the planner says why nothing can be checked
            return Verdict(watch.number)
        found = [one for one in known[2].collisions(trajectory) if one.links[1] in world.names]
        # The robot has passed what ends before its place.
        ahead = [one for one in found if one.last_time >= self._place]
        if not ahead:
            return Verdict(watch.number)
        first = min(ahead, key=lambda one: one.first_time)
        link, obstacle = first.links
        reason = f"a new obstacle is on the path ('{link}' would hit '{obstacle}')"
        if first.first_time <= self._place:
            reason = f"a new obstacle is on the robot ('{link}' is in collision with '{obstacle}')"
        last = max(one.last_time for one in ahead)
        return Verdict(watch.number, max(first.first_time, self._place), last, reason)
