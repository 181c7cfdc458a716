# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Sampling planners among obstacles, OMPL and VAMP, with time-optimal motions along their paths.

TOPP-RA keeps velocities and accelerations; jerks and efforts are not kept.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from importlib import import_module
from typing import Any

import numpy as np
import pinocchio as pin

from ..arrays import FloatArray
from ..exceptions import PlannerError, require
from ..motion.collision import CollisionModel
from ..motion.trajectory import Trajectory
from ..planning.search.sampling import SamplingOptions, sampled_path
from ..robot.model import Robot
from ..robot.world import Box, Capsule, Cylinder, Obstacle, Shape, Sphere, World
from .method import Method, PeerResult
from .problems import Problem, Scene

_SAME_PLACE = 1e-3  # Distance of the hand in two models of a robot [m]; VAMP has 32 bits.


def ompl_method(scene: Scene, max_time: float, collision: CollisionModel) -> Method:
    """RRT-Connect of OMPL with shortcuts and smoothing, then TOPP-RA."""
    require("ompl", "ompl", "the peer 'ompl_toppra'")
    limits, options = scene.limits, SamplingOptions(step=0.05, smooths=True)

    def search(problem: Problem) -> tuple[FloatArray | None, float]:
        """Search a path with the planner's own distances."""
        began = time.perf_counter()
        path = sampled_path(
            collision.collides,
            (limits.lower, limits.upper),
            (problem.start, problem.goal),
            options,
            lambda: time.perf_counter() - began > max_time,
        )
        return path, time.perf_counter() - began

    about = (
        "RRT-Connect of OMPL, shortcuts and smoothing, then TOPP-RA within the limits of "
        "velocities and accelerations"
    )
    return _along_paths("ompl_toppra", about, scene, search)


def vamp_method(scene: Scene, max_time: float, collision: CollisionModel) -> Method:
    """RRT-Connect of VAMP with its simplification, then TOPP-RA.

    Raises
    ------
    MissingDependencyError
        If VAMP is not installed.
    PlannerError
        If it has no such robot.
    """
    # A library for sound has the name `vamp`, too, but not this module.
    require("vamp.constants", "vamp", "the peer 'vamp_toppra'")
    vamp = import_module("vamp")
    name = vamp_robot(vamp, scene.robot)
    robot, plan, options, shortening = vamp.configure_robot_and_planner_with_kwargs(name, "rrtc")

    def search(problem: Problem) -> tuple[FloatArray | None, float]:
        """Search a path among the obstacles of the collision model."""
        ends = problem.start.tolist(), problem.goal.tolist()
        environment = _environment(vamp, robot, collision.world, ends)
        began, sampler, path = time.perf_counter(), robot.halton(), None
        found = plan(*ends, environment, options, sampler)
        if found.solved:
            shorter = robot.simplify(found.path, environment, shortening, sampler).path
            path = np.array(shorter.numpy(), dtype=float)
        took = time.perf_counter() - began
        return (path if took <= max_time else None), took

    about = (
        f"RRT-Connect and simplification of VAMP with its model of '{name}', "
        f"{robot.n_spheres()} spheres in place of the links, then TOPP-RA as for OMPL"
    )
    return _along_paths("vamp_toppra", about, scene, search)


def _along_paths(
    name: str,
    about: str,
    scene: Scene,
    search: Callable[[Problem], tuple[FloatArray | None, float]],
) -> Method:
    """A search that returns a path and the time it took, then TOPP-RA."""
    toppra = require("toppra", "peers", f"the peer '{name}'")
    limits, both, bounds = scene.limits, np.array([-1.0, 1.0]), toppra.constraint
    constraints = [bounds.JointVelocityConstraint(np.outer(limits.velocity, both))]
    if np.isfinite(limits.acceleration).all():
        bound = np.outer(limits.acceleration, both)
        constraints.append(bounds.JointAccelerationConstraint(bound))

    def timed(path: FloatArray) -> Any:
        """The time-optimal motion along a path; None if there is none."""
        lengths = np.linalg.norm(np.diff(path, axis=0), axis=1)
        path, lengths = path[np.append(True, lengths > 1e-6)], lengths[lengths > 1e-6]
        spline = toppra.SplineInterpolator(np.append(0.0, np.cumsum(lengths)), path)
        return toppra.algorithm.TOPPRA(constraints, spline).compute_trajectory()

    def solve(problem: Problem) -> PeerResult:
        """Find a path, and the shortest motion along it."""
        path, searched = search(problem)
        began = time.perf_counter()
        motion = None if path is None else timed(path)
        took = searched + time.perf_counter() - began
        if motion is None:
            what = "no path was found" if path is None else "the path could not be parametrised"
            return PeerResult(None, took, status=what, path_time=searched)
        # At most 10 ms apart.
        times = np.linspace(0.0, motion.duration, int(np.ceil(motion.duration / 0.01)) + 1)
        states = [motion(times, order) for order in range(3)]
        trajectory = Trajectory(limits.joint_names, times, *states)
        return PeerResult(trajectory, took, path_time=searched)

    return Method(name, about, solve)


def vamp_robot(vamp: Any, robot: Robot) -> str:
    """The name that VAMP has for a robot.

    Raises
    ------
    PlannerError
        If it has none with these joints in this order and the hand in the same place.
    """
    known = {tuple(getattr(vamp, name).joint_names()): str(name) for name in vamp.robots}
    if robot.joint_names not in known:
        robots = "; ".join(f"{name}: {', '.join(joints)}" for joints, name in known.items())
        raise PlannerError(
            f"VAMP has no robot with the joints {', '.join(robot.joint_names)} in this order; it "
            f"has {robots}"
        )
    name = known[robot.joint_names]
    model, q = getattr(vamp, name), np.full(robot.n_joints, 0.3)
    hand = model.end_effector()
    place = robot.frame_positions(q[None], [hand])[0, 0]
    distance = np.linalg.norm(place - model.eefk(q.tolist())[:3, 3])
    if distance > _SAME_PLACE:
        raise PlannerError(
            f"VAMP's model of '{name}' has '{hand}' {distance:.3g} m from here: expected the URDF "
            "of MotionBenchMaker"
        )
    return name


def _environment(vamp: Any, robot: Any, world: World, ends: tuple[list[float], ...]) -> Any:
    """Obstacles for VAMP; cylinders are boxes where capsules would contain a part of the robot.

    Raises
    ------
    PlannerError
        If the start or the goal is in collision.
    """
    add = {"Sphere": "add_sphere", "Cuboid": "add_cuboid", "Cylinder": "add_capsule"}
    for boxes in (False, True):
        environment = vamp.Environment()
        for kind, sizes in vamp_shapes(world, boxes=boxes):
            getattr(environment, add[kind])(getattr(vamp, kind)(*sizes))
        if all(robot.validate(end, environment) for end in ends):
            return environment
    raise PlannerError("the start or the goal is in collision for VAMP's spheres of the robot")


def vamp_shapes(world: World, *, boxes: bool) -> list[tuple[str, tuple[Any, ...]]]:
    """VAMP's classes for the shapes of a world, and their arguments.

    Its cylinders are capsules. As in VAMP's own scripts for MotionBenchMaker, capsules or boxes
    that contain them stand for cylinders.

    Parameters
    ----------
    world : World
        Spheres, boxes, capsules and cylinders.
    boxes : bool
        Whether cylinders become boxes.

    Raises
    ------
    PlannerError
        If there is another shape, or an obstacle that moves with a link.
    """
    return [_vamp_shape(one, shape, boxes) for one in world for shape in one.shapes]


def _vamp_shape(obstacle: Obstacle, shape: Shape, boxes: bool) -> tuple[str, tuple[Any, ...]]:
    if obstacle.frame:
        raise PlannerError(f"VAMP gets no obstacles on links, as '{obstacle.name}'")
    angles = pin.rpy.matrixToRpy(pin.Quaternion(np.array(shape.orientation)).matrix())
    place, pose = shape.position.tolist(), (shape.position.tolist(), angles.tolist())
    if isinstance(shape, Sphere):
        return "Sphere", (place, shape.radius)
    if isinstance(shape, Box):
        return "Cuboid", (*pose, (0.5 * shape.size).tolist())
    if isinstance(shape, Cylinder) and boxes and not isinstance(shape, Capsule):
        return "Cuboid", (*pose, [shape.radius, shape.radius, 0.5 * shape.height])
    if isinstance(shape, Cylinder):
        return "Cylinder", (*pose, shape.radius, shape.height)
    raise PlannerError(f"VAMP has no meshes, as of obstacle '{obstacle.name}'")
