# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Robots, demonstrations and problems that are generated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mp_pca_planner.arrays import FloatArray
from mp_pca_planner.cli.example_robots import demonstrations_of
from mp_pca_planner.motion.collision import CollisionModel
from mp_pca_planner.primitives.primitive import MovementPrimitive
from mp_pca_planner.recordings.demonstration import Demonstration
from mp_pca_planner.recordings.reaches import ReachingArm
from mp_pca_planner.recordings.synthetic import progress
from mp_pca_planner.robot.limits import JointLimits
from mp_pca_planner.robot.model import Robot


@dataclass(frozen=True, eq=False)
class Problem:
    """A motion from rest to rest in a given time.

    Attributes
    ----------
    start, goal : array, shape (n_joints,)
        Configurations [rad or m].
    duration : float
        Duration [s]; NaN: the method chooses it.
    demonstration : Demonstration or None
        The held-out motion with these ends, if there is one; it is not used to build primitives.
    scene : Path or None
        The file of the obstacles, if there are any.
    """

    start: FloatArray
    goal: FloatArray
    duration: float
    demonstration: Demonstration | None = None
    scene: Path | None = None


@dataclass(frozen=True, eq=False)
class Scene:
    """A robot, its limits and demonstrations: the same for all methods.

    Attributes
    ----------
    name : str
        Name of the robot.
    urdf : Path
        Its description.
    robot : Robot
        The planner's model of it.
    limits : JointLimits
        Limits to keep.
    demonstrations : tuple of Demonstration
        Motions to learn from.
    primitive : MovementPrimitive or None
        A primitive that is used instead of one learned from the demonstrations.
    collision : CollisionModel or None
        The model that keeps motions clear of obstacles, which are set for each problem.
    """

    name: str
    urdf: Path
    robot: Robot
    limits: JointLimits
    demonstrations: tuple[Demonstration, ...]
    primitive: MovementPrimitive | None = None
    collision: CollisionModel | None = None

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints."""
        return self.robot.joint_names


def scene_of(name: str, urdf: Path, joints: Sequence[str] | None, n_motions: int) -> Scene:
    """A robot with the limits of its description and randomly generated motions.

    Parameters
    ----------
    name, urdf, joints :
        Its name, its description and the joints of its arm.
    n_motions :
        Number of demonstrations.
    """
    robot = Robot.from_file(urdf, joints)
    limits = robot.limits()
    motions = demonstrations_of(name, robot, limits, n_motions)
    return Scene(name, urdf, robot, limits, tuple(motions))


def held_out_problems(scene: Scene, n_problems: int, seed: int) -> list[Problem]:
    """Problems like the demonstrations: ends and durations of held-out motions."""
    return [
        Problem(motion.positions[0], motion.positions[-1], motion.duration, motion)
        for motion in demonstrations_of(scene.name, scene.robot, scene.limits, n_problems, seed)
    ]


def random_ends(
    robot: Robot, limits: JointLimits, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray, float]:
    """A start, a goal and the duration of a minimum-jerk motion, all within the limits."""
    arm = ReachingArm(robot, limits)
    share = progress(np.linspace(0.0, 1.0, 101)[:, None], np.array([0.5]))
    while True:
        start, goal = (arm.posture(rng, 0.9) for _ in range(2))
        haste = rng.uniform(0.6, 0.95)
        if np.abs(goal - start).max() < 0.1 * np.max(arm.half_range):
            continue
        duration = arm.duration(start + (goal - start) * share, haste)
        if duration is not None:
            return start, goal, duration


def random_problems(scene: Scene, n_problems: int, seed: int) -> list[Problem]:
    """Problems between any two postures within the limits."""
    return [
        Problem(*random_ends(scene.robot, scene.limits, np.random.default_rng([seed, i])))
        for i in range(n_problems)
    ]
