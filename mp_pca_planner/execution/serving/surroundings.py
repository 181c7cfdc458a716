# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The obstacles around a robot while it executes motions."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from ...arrays import FloatArray
from ...exceptions import GoalError, RobotError
from ...motion.collision import Collision, CollisionModel
from ...motion.trajectory import Trajectory
from ...robot.model import Robot
from ...robot.world import Obstacle, World
from ..options import Serving
from ..parameters import REFUSE
from ..threads import SAFETY_WAIT, IsCancelled, TimedLock
from ..tracking.following import Following, How, MotionFollower
from ..tracking.start_state import TooLateError
from .assembly import Model, collision_model
from .execution import Execution

Poses = Mapping[str, FloatArray | None]
"""Poses of frames in the base frame of the robot, shape (7,) each; None where it is unknown."""

# Change of a coordinate or of a component of a quaternion that moves an obstacle.
_MOVED = 1e-4


def foreign_poses(
    obstacles: Iterable[Obstacle],
    links: Collection[str],
    pose_of: Callable[[str], FloatArray | None],
) -> dict[str, FloatArray | None]:
    """Look up the frames of obstacles that are not links.

    Parameters
    ----------
    obstacles :
        The obstacles as stated.
    links :
        The links of the robot.
    pose_of :
        Returns the pose of a frame, or None.
    """
    frames = {obstacle.frame for obstacle in obstacles} - {""} - set(links)
    return {frame: pose_of(frame) for frame in sorted(frames)}


def is_same(one: Poses, other: Poses) -> bool:
    """Whether the same frames have the same poses, except for noise."""
    return one.keys() == other.keys() and all(
        a is b or (a is not None and b is not None and bool(np.abs(a - b).max() <= _MOVED))
        for a, b in ((pose, other[frame]) for frame, pose in one.items())
    )


def placed(obstacles: Iterable[Obstacle], poses: Poses) -> tuple[list[Obstacle], list[str]]:
    """Place obstacles in the base frame, and name those whose frame has no pose.

    Parameters
    ----------
    obstacles :
        The obstacles as stated.
    poses :
        Poses of the frames that are not links.

    Returns
    -------
    obstacles, unplaced :
        The obstacles on links and in the base frame, and why others are missing.
    """
    found, unplaced = list[Obstacle](), list[str]()
    for obstacle in obstacles:
        if obstacle.frame not in poses:
            found.append(obstacle)
        elif (pose := poses[obstacle.frame]) is None:
            unplaced.append(
                f"obstacle '{obstacle.name}' is stated in the frame '{obstacle.frame}', which is "
                "not a link of the robot and has no known pose: set the parameter 'fixed_frames' "
                "(FRAME: X Y Z), or publish its transform to tf2"
            )
        else:
            shapes = [shape.moved(pose) for shape in obstacle.shapes]
            found.append(Obstacle(obstacle.name, shapes, "", obstacle.touch_links))
    return found, unplaced


@dataclass(eq=False)
class Threat:
    """A collision of the rest of the running motion with an obstacle.

    Attributes
    ----------
    collision : Collision
        The collision.
    time : float
        When it begins [s].
    is_given_up : bool
        Whether no other motion was found, so that the robot is stopped at once.
    """

    collision: Collision
    time: float
    is_given_up: bool = False

    @property
    def reason(self) -> str:
        """Why the running motion has to be replaced."""
        link, obstacle = self.collision.links
        return f"a new obstacle is on the path ('{link}' would hit '{obstacle}')"

    @property
    def last_time(self) -> float:
        """Time at which the search for another motion ends, and the robot is stopped [s]."""
        return -math.inf if self.is_given_up else self.time - Serving.avoidance_reserve


class Surroundings:
    """The newest obstacles, for planning and for the check of the running motion.

    The planner has a collision model of its own, which only the thread of planning uses. Running
    motions and stops are checked in any thread with another one.

    Parameters
    ----------
    follower :
        Tracks the robot on its motion.

    Attributes
    ----------
    missing : str
        Why an obstacle that was given is not avoided; empty if all are.
    settle : callable
        Called before a motion is planned: waits until the obstacles that have arrived are here.
    unplaced : str
        Why it is unknown where an obstacle is; empty if all places are known.
    """

    def __init__(self, follower: MotionFollower) -> None:
        self._follower, self._world = follower, World()
        # Held while the checker below is used; no other lock is taken meanwhile.
        self._lock = TimedLock()
        # Replaced as a whole: its model is never changed.
        self._checker: tuple[Robot, CollisionModel] | None = None
        self.missing = self.unplaced = ""
        self.settle: Callable[[IsCancelled], None] = lambda _: None

    @property
    def world(self) -> World:
        """The newest obstacles."""
        return self._world

    @property
    def threat(self) -> Threat | None:
        """What the running motion would hit; None if nothing is known to be on its path."""
        execution = self._follower.execution
        return None if execution is None else execution.threat

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
        try:
            if model is not None and len(world):
                self._checker_in(world, model)
        except RobotError:
            self._world = world
            raise
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
        if self.unplaced and model.settings.unplaced_obstacles == REFUSE:
            raise GoalError(
                f"{self.unplaced}; with the parameter 'unplaced_obstacles' of 'warn', goals are "
                "served without it"
            )
        if planner.collision is None and len(world):
            planner.use_collision(_collision_of(model).with_world(world))
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
        """Check the rest of the running motion, unless it was checked, and set its `threat`.

        Call this again and again in the thread of obstacles: the place of a robot without states is
        unknown, one that is held may move on, and the controller may have rejected the newest
        motion. It also makes the collision model that stops are checked with.

        Raises
        ------
        PlannerError
            If the motion can't be checked.
        """
        if len(self._world) or model.settings.collision:
            self._checker_in(self._world, model)
        published = self._follower.published
        execution = None if published is None else published.execution
        if published is None or execution is None:
            return
        if execution.checked == (published.current.motion, self._world):
            return
        following = None
        if len(self._world):
            try:
                following = self._follower.follow(model.settings)
            except GoalError:  # the robot may be anywhere on its motion
                return
            if following is not None and following.how is How.OFF:  # it may come back to its path
                return
        motion, world, threat = published.current.motion, self._world, None
        if following is not None and following.motion is motion:
            threat = self._threat(following, execution, world, model)
        execution.threat, execution.checked = threat, (motion, world)

    def _threat(
        self, following: Following, execution: Execution, world: World, model: Model
    ) -> Threat | None:
        """The next collision of the rest of a motion with an obstacle."""
        motion, place = following.motion, following.progress.place
        if execution.is_stop and motion is execution.motion:
            return None
        is_held = following.how is How.HELD
        if place >= motion.duration or not (following.is_running or is_held):
            return None
        checker, rest = self._checker_in(world, model), motion.rest(place)
        with self._lock:
            found = checker.collisions(rest)
        # Planning and stopping care for collisions of links.
        times = [(one.first_time, one) for one in found if one.links[1] in world.names]
        if not times:
            return None
        since, first = min(times, key=lambda one: one[0])
        # When a held robot moves on is unknown.
        return Threat(first, self._follower.motion_time + (0.0 if is_held else since))

    def collision_of(self, stop: Sequence[Trajectory], model: Model) -> Collision | None:
        """The deepest collision of the motions to a stop, with an obstacle or between links.

        None if there is none, or if that is not known: a stop waits for no collision model.
        """
        if not (len(self._world) or model.settings.collision):
            return None
        robot, checker = self._checker or (None, None)
        if checker is None or robot is not model.robot:
            return None
        with suppress(Exception), self._lock.within(SAFETY_WAIT):  # in any case, the stop must come
            # Roughly where there are many: they take a millisecond each.
            one = len(stop) == 1
            every = (checker.collisions(motion, precisely=one) for motion in stop)
            met = [found[0] for found in every if found]
            return max(met, key=lambda found: found.penetration, default=None)
        return None

    def _checker_in(self, world: World, model: Model) -> CollisionModel:
        """The collision model of running motions in a world."""
        robot, checker = self._checker or (None, None)
        if checker is not None and robot is model.robot and checker.world is world:
            return checker
        if checker is None or robot is not model.robot:
            checker = _collision_of(model)
        if len(world) and not checker.has_geometry:
            raise _without_geometry()
        checker = checker.with_world(world)
        self._checker = model.robot, checker
        return checker


def _collision_of(model: Model) -> CollisionModel:
    """The collision model without obstacles; if there is none, why."""
    return model.collision or collision_model(model.planning_robot, model.settings)


def _without_geometry() -> RobotError:
    return RobotError(
        "obstacles can't be avoided: the robot description has no collision geometry; add "
        "<collision> to its links, or remove the obstacles"
    )
