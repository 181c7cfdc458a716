# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The referee of motions among obstacles: collisions, clearance, path length and jerk.

It shares no code with the planner, its world and its collision model. It reads the scene itself,
and calls Pinocchio and Coal on a 1 ms grid. Limits and efforts are judged by :mod:`.check`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import yaml

from ..arrays import FloatArray
from ..exceptions import PlannerError
from ..files import read_text, reading
from ..input_limits import INPUT_LIMITS
from ..motion.trajectory import Trajectory
from .check import REFEREE, RigidArm, executed

try:
    import coal
except ImportError:  # its name before release 3
    import hppfcl as coal

_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


@dataclass(frozen=True)
class SceneVerdict:
    """The referee's findings on a motion among obstacles.

    Attributes
    ----------
    collision : str
        The first pair in collision and its time, '' if there is none.
    clearance : float
        Least distance of the obstacles from the convex hulls of moving links on a 10 ms grid [m].
    path_length : float
        Length of the path of the joints [rad or m].
    rms_jerk : float
        Root mean square over time of the norm of the jerk [rad/s³ or m/s³].
    """

    collision: str
    clearance: float
    path_length: float
    rms_jerk: float


class SceneReferee:
    """Judges motions of a robot in one scene.

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

    Raises
    ------
    PlannerError
        If the scene can't be read.
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

    def judge(self, trajectory: Trajectory) -> SceneVerdict:
        """Evaluate a motion as a controller executes it: quintic polynomials between its points."""
        curve = executed(trajectory)
        n_fine, n_coarse = (
            1 + _count(trajectory.duration, period)
            for period in (REFEREE.collision_period, REFEREE.clearance_period)
        )
        times = np.linspace(0.0, trajectory.duration, n_fine)
        coarse = np.linspace(0, n_fine - 1, n_coarse)
        q, jerk = curve(times), curve.derivative(3)(times)
        return SceneVerdict(
            collision=self._collision(times, q),
            clearance=min(map(self._clearance, q[coarse.astype(int)])),
            path_length=float(np.linalg.norm(np.diff(q, axis=0), axis=1).sum()),
            rms_jerk=float(np.sqrt(np.mean(np.sum(jerk**2, axis=1)))),
        )

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
            if np.linalg.matrix_rank(points - points.mean(axis=0), rtol=1e-6) < 3:
                continue  # Coal would end the process
            part.geometry.buildConvexHull(True, "Qt")
            part.geometry = part.geometry.convex
    return hulls


def _obstacles(scene: Path) -> Iterator[tuple[str, Any, Any]]:
    """Name, shape and pose of each obstacle of a planning scene."""
    with reading(f"the scene '{scene}'", PlannerError):
        content = yaml.load(read_text(scene, INPUT_LIMITS.yaml_bytes), Loader=_LOADER)
        for one in content["world"]["collision_objects"]:
            for shape, pose in zip(one["primitives"], one["primitive_poses"], strict=True):
                turn = pin.Quaternion(np.array(pose["orientation"], dtype=float)).normalized()
                placement = pin.SE3(turn.matrix(), np.array(pose["position"], dtype=float))
                yield one["id"], _shape(shape["type"], shape["dimensions"]), placement


def _shape(kind: str, sizes: Sequence[float]) -> Any:
    if kind == "box":
        return coal.Box(*sizes)
    if kind == "sphere":
        return coal.Sphere(*sizes)
    if kind == "cylinder":
        height, radius = sizes
        return coal.Cylinder(radius, height)
    raise ValueError(f"the referee knows boxes, spheres and cylinders, but not '{kind}'")


def _count(duration: float, period: float) -> int:
    return max(int(np.ceil(duration / period - 1e-9)), 1)
