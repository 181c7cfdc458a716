# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Distances between the links of a robot.

Meshes are compared exactly only where their convex hulls are near each other.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..exceptions import RobotError
from ..files import read_text, reading
from .model import Robot
from .urdf import parse_xml

CONTACT = 1e-6
"""Distance below which links are in contact [m]: the precision of touching surfaces."""

# Precision of distances [m], at which relative errors of derivatives are usually below 1 %.
_PRECISION = 1e-8
# Hulls nearer than this [m] are replaced by the meshes themselves.
_NEAR = 1e-2


class CollisionGeometry:
    """The pairs of links of a robot that may collide, and their distances.

    Parameters
    ----------
    robot : Robot
        The robot, whose URDF has collision geometry.
    srdf : str or Path, optional
        An SRDF file whose ``disable_collisions`` name the pairs that are not checked. Without one,
        these are neighbours and what touches in the neutral configuration.
    package_dirs : sequence of Path
        Folders that hold the packages of ``package://`` paths of meshes.

    Attributes
    ----------
    levers : array, shape (n_pairs, n_joints)
        Bound of the speed at which each joint closes the distance of each pair [m or 1], joints in
        the order of `model_order`.
    model_order : array of int, shape (n_joints,)
        Index of the robot's joint for each joint of the geometry.
    pairs : tuple of tuple of str
        The pairs of links that are checked; empty without collision geometry.

    Raises
    ------
    RobotError
        If a mesh or the SRDF file can't be read.
    """

    def __init__(
        self,
        robot: Robot,
        *,
        srdf: str | Path | None = None,
        package_dirs: Sequence[Path] = (),
    ) -> None:
        self._model, self._geometry, self.model_order = robot.collision_geometry(package_dirs)
        self._data = self._model.createData()
        shapes = [part.geometry for part in self._geometry.geometryObjects]
        for shape in shapes:
            shape.computeLocalAABB()
        self._centres = [np.array(shape.aabb_center) for shape in shapes]
        self._radii = [float(shape.aabb_radius) for shape in shapes]
        if srdf is None:
            self._remove_touching_at_neutral()
        else:
            self._geometry.addAllCollisionPairs()
            _remove_disabled(self._model, self._geometry, Path(srdf))
        _remove_fixed(self._geometry)
        self._geometry_data = self._geometry.createData()
        self._hulls, convex = _hulls(self._geometry)
        self._hull_data = self._hulls.createData()
        for request in self._hull_data.distanceRequests:
            request.gjk_tolerance = _PRECISION
        pairs = self._geometry.collisionPairs
        self._are_convex = [convex[pair.first] and convex[pair.second] for pair in pairs]
        self.pairs = tuple(self._links(pair) for pair in pairs)
        self._moved = self._moved_by_joints()
        self.levers = self._lever_arms()

    @property
    def has_geometry(self) -> bool:
        """Whether there is any collision geometry at all."""
        return bool(self._geometry.ngeoms)

    def distances(self, q: FloatArray, pairs: NDArray[np.intp]) -> tuple[FloatArray, FloatArray]:
        """Distances of pairs, and their derivatives by the joints.

        Parameters
        ----------
        q : array, shape (n_joints,)
            Positions of the robot's joints in its order.
        pairs : array of int, shape (n_pairs,)
            Which of the pairs.

        Returns
        -------
        distances : array, shape (n_pairs,)
            Distances [m]; for meshes in collision, the negative penetration depth of their convex
            hulls.
        rows : array, shape (n_pairs, n_joints)
            Their derivatives by the joints: rates at which the nearest points of two links
            separate.
        """
        jacobian = pin.computeJointJacobians(self._model, self._data, self._in_model_order(q))
        pin.updateGeometryPlacements(self._model, self._data, self._hulls, self._hull_data)
        found = [self._nearest_points(int(k)) for k in pairs]
        distances = np.array([one.min_distance for one in found])
        first = np.array([one.getNearestPoint1() for one in found])
        second = np.array([one.getNearestPoint2() for one in found])
        away = (second - first) * np.sign(distances)[:, None]
        lengths = np.linalg.norm(away, axis=1)
        for i in np.flatnonzero(~(lengths > CONTACT)):
            # In contact the two points coincide; then the centres define the direction, if they
            # differ.
            a, b = (self._centre(part) for part in _both(self._hulls.collisionPairs[int(pairs[i])]))
            second[i] = b
            away[i] = b - a if np.linalg.norm(b - a) > CONTACT else np.ones(3)
            lengths[i] = np.linalg.norm(away[i])
        away /= lengths[:, None]
        # Both points lie on one line along that direction, so both give the same moment about the
        # origin.
        along = np.hstack([away, np.cross(second, away)]) @ jacobian
        rows = np.empty_like(along)
        rows[:, self.model_order] = along * self._moved[pairs]
        return distances, rows

    def _nearest_points(self, pair: int) -> Any:
        """Pinocchio's result for the current poses of the links."""
        found = pin.computeDistance(self._hulls, self._hull_data, pair)
        if self._are_convex[pair] or found.min_distance > _NEAR:
            return found
        geometry, data = self._geometry, self._geometry_data
        pin.updateGeometryPlacements(self._model, self._data, geometry, data)
        exact = pin.computeDistance(geometry, data, pair)
        # It is undefined for meshes in contact.
        return exact if exact.min_distance > CONTACT else found

    def _in_model_order(self, q: FloatArray) -> FloatArray:
        return np.ascontiguousarray(q[self.model_order])

    def _centre(self, part: int) -> FloatArray:
        return np.asarray(self._hull_data.oMg[part].act(self._centres[part]))

    def lower_bounds(self, q: FloatArray, pairs: Any, enough: FloatArray) -> FloatArray:
        """Distances of pairs [m]; where they exceed `enough`, a lower bound that does, too."""
        q = self._in_model_order(q)
        pin.updateGeometryPlacements(self._model, self._data, self._hulls, self._hull_data, q)
        distances = np.array([self._hull_distance(int(k)) for k in pairs])
        near = [i for i in np.flatnonzero(distances <= enough) if not self._are_convex[pairs[i]]]
        if near:
            distances[near] = self._exact_distances(q, pairs[near])
        return distances

    def _hull_distance(self, pair: int) -> float:
        return float(pin.computeDistance(self._hulls, self._hull_data, pair).min_distance)

    def _exact_distances(self, configuration: FloatArray, pairs: Any) -> FloatArray:
        geometry, data = self._geometry, self._geometry_data
        pin.updateGeometryPlacements(self._model, self._data, geometry, data, configuration)
        return np.array([pin.computeDistance(geometry, data, int(k)).min_distance for k in pairs])

    def _links(self, pair: Any) -> tuple[str, str]:
        objects = self._geometry.geometryObjects
        first, second = (
            self._model.frames[objects[i].parentFrame].name for i in (pair.first, pair.second)
        )
        return first, second

    def _remove_touching_at_neutral(self) -> None:
        low, high = self._model.lowerPositionLimit, self._model.upperPositionLimit
        neutral = np.clip(pin.neutral(self._model), low, high)
        self._geometry_data = self._geometry.createData()
        distances = self._exact_distances(neutral, range(len(self._geometry.collisionPairs)))
        _keep_pairs(self._geometry, distances >= CONTACT)

    def _moved_by_joints(self) -> FloatArray:
        """The link of each pair that each joint moves, shape (n_pairs, n_joints).

        The second link: 1, the first: −1, none or both: 0.
        """
        moves = np.zeros((self._model.njoints, self._model.nv))
        for joint, supports in enumerate(self._model.supports):
            for other in list(supports)[1:]:
                moves[joint, self._model.joints[other].idx_v] = 1.0
        objects = self._geometry.geometryObjects
        joints = [[objects[i].parentJoint for i in _both(p)] for p in self._hulls.collisionPairs]
        first, second = np.reshape(joints, (-1, 2)).T.astype(np.intp)
        return np.asarray(moves[second] - moves[first])

    def _lever_arms(self) -> FloatArray:
        """Largest speed of approach of each pair by each joint, (n_pairs, n_joints).

        For a joint that turns, the longest path from it along the links to a point of the geometry
        behind it [m]; for one that slides, 1.
        """
        objects = self._geometry.geometryObjects
        arms = np.zeros((len(self.pairs), self._model.nv))
        for row, pair in zip(arms, self._geometry.collisionPairs, strict=True):
            chains = [list(self._model.supports[objects[i].parentJoint]) for i in _both(pair)]
            for i, chain, other in zip(_both(pair), chains, chains[::-1], strict=True):
                centre = objects[i].placement.act(self._centres[i])
                reach = float(np.linalg.norm(centre)) + self._radii[i]
                for joint in reversed([j for j in chain if j > 0]):
                    slides = _slide(self._model, joint)
                    if joint not in other:
                        row[self._model.joints[joint].idx_v] = 1.0 if slides else reach
                    placement = self._model.jointPlacements[joint].translation
                    reach += float(np.linalg.norm(placement)) + slides
        return arms


def _remove_fixed(geometry: Any) -> None:
    """Keep the pairs with relative motion."""
    joints = [part.parentJoint for part in geometry.geometryObjects]
    _keep_pairs(geometry, [joints[a] != joints[b] for a, b in _index_pairs(geometry)])


def _index_pairs(geometry: Any) -> list[tuple[int, int]]:
    """Numbers of the geometry objects of each pair."""
    return [_both(pair) for pair in geometry.collisionPairs]


def _keep_pairs(geometry: Any, kept: Iterable[bool]) -> None:
    # What Python gets of Pinocchio's pairs are references to places in a vector, so the vector
    # is made again: removing one pair would put others into the places behind it.
    pairs = [pair for pair, keep in zip(_index_pairs(geometry), kept, strict=True) if keep]
    geometry.removeAllCollisionPairs()
    for first, second in pairs:
        geometry.addCollisionPair(pin.CollisionPair(first, second))


def _remove_disabled(model: Any, geometry: Any, srdf: Path) -> None:
    source = f"the SRDF file '{srdf}'"
    with reading(source, RobotError):
        text = read_text(srdf)
        parse_xml(text, source)
        pin.removeCollisionPairsFromXML(model, geometry, text)


def _slide(model: Any, joint: int) -> float:
    """Range of a joint that slides [m], 0 for one that turns."""
    if not model.joints[joint].shortname().startswith("JointModelP"):
        return 0.0
    index = model.joints[joint].idx_q
    ends = model.lowerPositionLimit[index], model.upperPositionLimit[index]
    return float(np.abs(ends).max())


def _hulls(geometry: Any) -> tuple[Any, list[bool]]:
    """The same with convex hulls in the place of meshes, and which parts were convex before."""
    hulls = geometry.copy()
    convex = []
    for part, hull in zip(geometry.geometryObjects, hulls.geometryObjects, strict=True):
        shape = part.geometry
        convex.append(not hasattr(shape, "buildConvexHull"))
        if not convex[-1]:
            try:
                convex[-1] = shape.buildConvexHull(True, "Qt")
            except (RuntimeError, ValueError):
                continue  # it is flat, or the library was built without qhull
            hull.geometry = shape.convex
    return hulls, convex


def _both(pair: Any) -> tuple[int, int]:
    return pair.first, pair.second


def package_folders(given: Sequence[Path], urdf: Path | None = None) -> list[Path]:
    """Folders in which packages may be: those given, those of ROS, and those above a URDF file."""
    folders = [*given]
    folders += [Path(p) for p in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep) if p]
    prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    folders += [Path(p) / "share" for p in prefixes if p]
    return folders if urdf is None else [*folders, *urdf.resolve().parents]
