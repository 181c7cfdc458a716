# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The referee of the benchmark: effort, limits and, among obstacles, collisions of a motion.

It shares no code with the planner, its solver, its world and its validator: Pinocchio's `rnea` on a
model of its own, SciPy's polynomials between the points of a trajectory, a grid of 0.5 ms. It reads
scenes itself, and calls Pinocchio and Coal on a 1 ms grid.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin
from scipy.integrate import trapezoid
from scipy.interpolate import BPoly
from support.problems import Problem

from mp_pca_planner.arrays import FloatArray
from mp_pca_planner.files import load_yaml, read_text
from mp_pca_planner.motion.trajectory import Trajectory
from mp_pca_planner.robot.limits import JointLimits

# Longest step of the grid [s].
REFEREE_PERIOD = 5e-4
# Largest relative excess over a limit of a feasible motion.
REFEREE_LIMIT_TOLERANCE = 1e-6
# Largest distance of a feasible motion from its start and goal [rad or m].
REFEREE_POSITION_TOLERANCE = 1e-3
# Largest velocity of a feasible motion at its ends [rad/s or m/s].
REFEREE_VELOCITY_TOLERANCE = 1e-2
# Share of a limit from which it counts as active.
REFEREE_ACTIVE_SHARE = 0.998
# Share of the duration at either end in which limits don't count as active.
REFEREE_END_SHARE = 0.05
# Steps of the grids on which collisions and clearances are computed [s].
REFEREE_COLLISION_PERIOD = 1e-3
REFEREE_CLEARANCE_PERIOD = 1e-2
SHAPES = {"box": coal.Box, "sphere": coal.Sphere, "cylinder": coal.Cylinder}


@dataclass(frozen=True)
class Verdict:
    """The referee's findings on one motion.

    Attributes
    ----------
    duration : float
        Duration [s].
    effort_cost : float
        J = ½∫‖τ‖²dt [N²·m²·s], [P] eq. (6), by the trapezoidal rule on the grid.
    limit_violation : float
        Largest relative excess over a limit; for positions the distance outside, as a share of
        the range (of 1 rad or m if that is infinite).
    worst_limit : str
        The limit concerned ('' if all hold).
    limits_active : bool
        Whether the motion reaches 99.8 % of a limit away from its ends.
    end_error : float
        Largest distance from start and goal [rad or m].
    end_velocity : float
        Largest velocity at its ends [rad/s or m/s].
    demo_distance_deg : float
        RMS difference from the held-out demonstration with these ends over joints and 101
        phases [deg]; NaN if the problem has none.
    reaches : bool
        Whether it starts and ends at rest at the start and goal, within the tolerances.
    feasible : bool
        Whether it reaches the goal and keeps the limits, within the tolerance.
    path_length : float
        Length of the path of the joints [rad or m].
    rms_jerk : float
        Root mean square over time of the norm of the jerk [rad/s³ or m/s³].
    collision : str
        The first pair in collision and its time, '' if there is none.
    clearance : float
        Least distance of the obstacles from the convex hulls of moving links on a 10 ms grid [m],
        infinite without obstacles.
    """

    duration: float
    effort_cost: float
    limit_violation: float
    worst_limit: str
    limits_active: bool
    end_error: float
    end_velocity: float
    demo_distance_deg: float
    reaches: bool
    feasible: bool
    path_length: float
    rms_jerk: float
    collision: str = ""
    clearance: float = np.inf


class RigidArm:
    """A Pinocchio model of some joints of a URDF, the others locked; for the referee and peers.

    Parameters
    ----------
    urdf : str or Path
        The URDF file.
    joint_names : sequence of str
        The n_joints joints that move, in the order of every array here.

    Attributes
    ----------
    model : pinocchio.Model
        The model; continuous joints are a cosine and a sine in its configurations.
    velocity_index : array of int, shape (n_joints,)
        Where the joints are in Pinocchio's velocities.
    continuous : array of bool, shape (n_joints,)
        Whether each joint is continuous.
    """

    def __init__(self, urdf: str | Path, joint_names: Sequence[str]) -> None:
        full = pin.buildModelFromUrdf(str(urdf))
        others = [i for i, name in enumerate(full.names) if i > 0 and name not in joint_names]
        rest = np.clip(pin.neutral(full), full.lowerPositionLimit, full.upperPositionLimit)
        self.model = pin.buildReducedModel(full, others, rest) if others else full
        self._data = self.model.createData()
        joints = [self.model.joints[self.model.getJointId(name)] for name in joint_names]
        self.velocity_index = np.array([joint.idx_v for joint in joints])
        self.continuous = np.array([joint.nq == 2 for joint in joints])
        self._neutral = pin.neutral(self.model)

    def configuration(self, angles: FloatArray) -> FloatArray:
        """Pinocchio's configuration of joint positions, shape (nq,)."""
        return np.asarray(pin.integrate(self.model, self._neutral, self.velocity(angles)))

    def angles(self, configuration: FloatArray) -> FloatArray:
        """Joint positions of one of Pinocchio's configurations, up to whole turns."""
        displacement = pin.difference(self.model, self._neutral, configuration)
        return np.asarray(displacement[self.velocity_index])

    def velocity(self, v: FloatArray) -> FloatArray:
        """Pinocchio's vector of joint velocities (or accelerations), shape (nv,)."""
        result = np.empty(self.model.nv)
        result[self.velocity_index] = v
        return result

    def efforts(self, q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
        """Efforts of a motion, all of shape (n_steps, n_joints)."""
        steps = zip(q, v, a, strict=True)
        tau = [
            pin.rnea(self.model, self._data, self.configuration(x), *map(self.velocity, rest))
            for x, *rest in steps
        ]
        return np.array(tau)[:, self.velocity_index]


def judge(
    trajectory: Trajectory,
    problem: Problem,
    arm: RigidArm,
    limits: JointLimits,
    surroundings: SceneReferee | None = None,
    *,
    period: float = REFEREE_PERIOD,
) -> Verdict:
    """Evaluate a motion as a controller executes it: quintic polynomials between its points."""
    curve = executed(trajectory)
    n_steps = int(np.ceil(trajectory.duration / period))
    times = np.linspace(0.0, trajectory.duration, n_steps + 1)
    q, v, a, jerk = (curve(times) if k == 0 else curve.derivative(k)(times) for k in range(4))
    tau = arm.efforts(q, v, a)
    excess, worst, active = _against_limits(times, (q, v, a, jerk, tau), limits)
    collision, clearance = surroundings.contacts(trajectory) if surroundings else ("", np.inf)
    end_error = float(np.abs(q[[0, -1]] - [problem.start, problem.goal]).max())
    end_velocity = float(np.abs(v[[0, -1]]).max())
    reaches = end_error <= REFEREE_POSITION_TOLERANCE and end_velocity <= REFEREE_VELOCITY_TOLERANCE
    return Verdict(
        duration=trajectory.duration,
        effort_cost=float(trapezoid(0.5 * np.sum(tau**2, axis=1), times)),
        limit_violation=excess,
        worst_limit=worst,
        limits_active=active,
        end_error=end_error,
        end_velocity=end_velocity,
        demo_distance_deg=_distance(curve, trajectory.duration, problem),
        reaches=reaches,
        feasible=reaches and excess <= REFEREE_LIMIT_TOLERANCE,
        path_length=float(np.linalg.norm(np.diff(q, axis=0), axis=1).sum()),
        rms_jerk=float(np.sqrt(np.mean(np.sum(jerk**2, axis=1)))),
        collision=collision,
        clearance=clearance,
    )


def executed(trajectory: Trajectory) -> BPoly:
    """A motion as a controller executes it: quintic polynomials between its points."""
    return BPoly.from_derivatives(
        trajectory.times.copy(),  # older releases of SciPy refuse read-only arrays
        np.stack([trajectory.positions, trajectory.velocities, trajectory.accelerations], axis=1),
    )


def _against_limits(
    times: FloatArray, states: tuple[FloatArray, ...], limits: JointLimits
) -> tuple[float, str, bool]:
    """Largest relative excess, where that is, and whether a limit is active."""
    q, v, a, jerk, tau = states
    width = limits.upper - limits.lower
    width = np.where(np.isfinite(width), width, 1.0)
    excesses = {
        "position": np.maximum(limits.lower - q, q - limits.upper) / width,
        "velocity": np.abs(v) / limits.velocity - 1.0,
        "acceleration": np.abs(a) / limits.acceleration - 1.0,
        "jerk": np.abs(jerk) / limits.jerk - 1.0,
        "effort": np.abs(tau) / limits.effort - 1.0,
    }
    inside = np.abs(times / times[-1] - 0.5) < 0.5 - REFEREE_END_SHARE
    active = any(excess[inside].max() > REFEREE_ACTIVE_SHARE - 1.0 for excess in excesses.values())
    quantity = max(excesses, key=lambda name: float(excesses[name].max()))
    step, joint = np.unravel_index(excesses[quantity].argmax(), q.shape)
    worst = float(excesses[quantity][step, joint])
    if worst <= 0.0:
        return 0.0, "", active
    where = f"{quantity} of joint '{limits.joint_names[joint]}' at {times[step]:.3f} s"
    return worst, where, active


def _distance(curve: BPoly, duration: float, problem: Problem) -> float:
    if problem.demonstration is None:
        return float("nan")
    shown = problem.demonstration.time_normalised(101)
    found = curve(np.linspace(0.0, duration, 101))
    return float(np.rad2deg(np.sqrt(np.mean((found - shown) ** 2))))


class SceneReferee:
    """Finds collisions of a robot's motions in one scene.

    Parameters
    ----------
    arm : RigidArm
        The robot, of the same URDF.
    urdf : Path
        Its description. ``package://`` paths of meshes are searched in its folder.
    scene : Path
        File of a moveit_msgs/PlanningScene with boxes, spheres and cylinders.
    srdf : Path, optional
        Pairs of links that are not checked; neighbours unless given.
    """

    def __init__(self, arm: RigidArm, urdf: Path, scene: Path, srdf: Path | None = None) -> None:
        self._arm = arm
        full = pin.buildModelFromUrdf(str(urdf))
        links = pin.buildGeomFromUrdf(
            full, str(urdf), pin.GeometryType.COLLISION, package_dirs=[str(urdf.parent)]
        )
        others = [i for i, name in enumerate(full.names) if name not in arm.model.names]
        rest = np.clip(pin.neutral(full), full.lowerPositionLimit, full.upperPositionLimit)
        if others:
            _, links = pin.buildReducedModel(full, links, others, rest)
        self._geometry, n_links = links, links.ngeoms
        for name, shape, pose in _obstacles(scene):
            part = pin.GeometryObject(
                name, parent_joint=0, placement=pose, collision_geometry=shape
            )
            self._geometry.addGeometryObject(part)
        self._add_pairs(n_links)
        if srdf is not None:
            pin.removeCollisionPairs(arm.model, self._geometry, str(srdf))
        pairs = self._geometry.collisionPairs
        self._of_obstacles = [k for k, pair in enumerate(pairs) if pair.second >= n_links]
        self._hulls = _hulls(self._geometry)
        self._data, self._poses = arm.model.createData(), self._geometry.createData()
        self._hull_poses = self._hulls.createData()

    def contacts(self, trajectory: Trajectory) -> tuple[str, float]:
        """The first collision of a motion and its clearance, see :class:`Verdict`."""
        curve = executed(trajectory)
        n_fine, n_coarse = (
            1 + max(int(np.ceil(trajectory.duration / period - 1e-9)), 1)
            for period in (REFEREE_COLLISION_PERIOD, REFEREE_CLEARANCE_PERIOD)
        )
        times = np.linspace(0.0, trajectory.duration, n_fine)
        coarse = np.linspace(0, n_fine - 1, n_coarse).astype(int)
        q = curve(times)
        return self._collision(times, q), min(map(self._clearance, q[coarse]))

    def _collision(self, times: FloatArray, q: FloatArray) -> str:
        model, data = self._arm.model, self._data
        for time, angles in zip(times, q, strict=True):
            configuration = self._arm.configuration(angles)
            hulls = self._hulls, self._hull_poses
            if not pin.computeCollisions(model, data, *hulls, configuration, True):
                continue
            pin.updateGeometryPlacements(model, data, self._geometry, self._poses, configuration)
            for k, pair in enumerate(self._geometry.collisionPairs):
                if pin.computeCollision(self._geometry, self._poses, k):
                    parts = self._geometry.geometryObjects
                    names = parts[pair.first].name, parts[pair.second].name
                    return f"{' and '.join(names)} at {time:.3f} s"
        return ""

    def _clearance(self, angles: FloatArray) -> float:
        configuration = self._arm.configuration(angles)
        hulls, poses = self._hulls, self._hull_poses
        pin.updateGeometryPlacements(self._arm.model, self._data, hulls, poses, configuration)
        found = (pin.computeDistance(hulls, poses, k).min_distance for k in self._of_obstacles)
        return float(min(found, default=np.inf))

    def _add_pairs(self, n_links: int) -> None:
        """Pairs of links, and of moving links with obstacles, that are not neighbours."""
        model, parts = self._arm.model, self._geometry.geometryObjects
        joints = [part.parentJoint for part in parts]
        for i in range(n_links):
            for k in range(i + 1, len(parts)):
                first, second = sorted((joints[i], joints[k]))
                neighbours = k < n_links and first == model.parents[second]
                if first != second and not neighbours:
                    self._geometry.addCollisionPair(pin.CollisionPair(i, k))


def _hulls(geometry: Any) -> Any:
    """The same with convex hulls in the place of meshes with a volume."""
    hulls = geometry.copy()
    for part in hulls.geometryObjects:
        if hasattr(part.geometry, "buildConvexHull"):
            points = np.array(part.geometry.vertices())
            if np.linalg.matrix_rank(points - points.mean(axis=0), tol=1e-6 * np.ptp(points)) < 3:
                continue  # Coal would end the process
            part.geometry.buildConvexHull(True, "Qt")
            part.geometry = part.geometry.convex
    return hulls


def _obstacles(scene: Path) -> Iterator[tuple[str, Any, Any]]:
    """Name, shape and pose of each obstacle of a planning scene."""
    for one in load_yaml(read_text(scene))["world"]["collision_objects"]:
        for shape, pose in zip(one["primitives"], one["primitive_poses"], strict=True):
            turn = pin.Quaternion(np.array(pose["orientation"], dtype=float)).normalized()
            placement = pin.SE3(turn.matrix(), np.array(pose["position"], dtype=float))
            # A cylinder has its height first.
            sizes = shape["dimensions"][:: -1 if shape["type"] == "cylinder" else 1]
            yield one["id"], SHAPES[shape["type"]](*sizes), placement
