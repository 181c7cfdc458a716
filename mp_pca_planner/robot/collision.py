# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Distances between the links of a robot, and between links and obstacles.

Meshes are compared exactly only where their convex hulls are near each other.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ..arrays import FloatArray, frozen_array
from ..exceptions import RobotError, WorldError
from ..files import read_text, reading
from .bodies import Bodies
from .model import Robot
from .urdf import parse_xml
from .world import MAX_LENGTH, World

CONTACT = 1e-6
"""Distance below which bodies are in contact [m]: the precision of touching surfaces."""

# Precision of distances [m], at which relative errors of derivatives are usually below 1 %.
_PRECISION = 1e-8
# Hulls nearer than this [m] are replaced by the meshes themselves.
_NEAR = 1e-2


class CollisionGeometry:
    """The pairs of bodies that may collide, links and obstacles, and their distances.

    Parameters
    ----------
    robot : Robot
        The robot, whose URDF has collision geometry.
    srdf : str or Path, optional
        An SRDF file whose ``disable_collisions`` name the pairs of links that are not checked.
        Without one, these are neighbours and what touches in the neutral configuration.
    package_dirs : sequence of Path
        Folders that hold the packages of ``package://`` paths of meshes.
    world : World, optional
        The obstacles around the robot; none unless given.
    margin : float
        Least clearance from obstacles [m].
    self_collision : bool
        Whether pairs of links are checked, too.

    Attributes
    ----------
    levers : array, shape (n_pairs, n_joints)
        Bound of the speed at which each joint closes the distance of each pair [m or 1], joints in
        the order of `model_order`.
    model_order : array of int, shape (n_joints,)
        Index of the robot's joint for each joint of the geometry.
    pairs : tuple of tuple of str
        The pairs of bodies that are checked, those of links first; empty without collision
        geometry.
    margins : array, shape (n_pairs,)
        Least clearance of each pair [m].
    world : World
        The obstacles.
    margin : float
        Least clearance from them [m].

    Raises
    ------
    RobotError
        If a mesh or the SRDF file can't be read.
    WorldError
        If an obstacle is attached to an unknown link or has the name of a link, or the margin is
        no length.
    """

    def __init__(
        self,
        robot: Robot,
        *,
        srdf: str | Path | None = None,
        package_dirs: Sequence[Path] = (),
        world: World | None = None,
        margin: float = 0.0,
        self_collision: bool = True,
    ) -> None:
        self._model, geometry, self.model_order = robot.collision_geometry(package_dirs)
        self._data = self._model.createData()
        if not self_collision:
            geometry.removeAllCollisionPairs()
        elif srdf is None:
            _remove_touching_at_neutral(self._model, geometry)
        else:
            geometry.addAllCollisionPairs()
            _remove_disabled(self._model, geometry, Path(srdf))
        self._links = Bodies.of_links(self._model, geometry)
        joints = self._links.joints
        # A pair without relative motion is not checked.
        self._pairs_of_links = [(a, b) for a, b in _index_pairs(geometry) if joints[a] != joints[b]]
        self.margin = _checked_margin(margin)
        self.set_world(World() if world is None else world)

    def set_world(self, world: World, margin: float | None = None) -> None:
        """Replace the obstacles.

        Parameters
        ----------
        world : World
            The new obstacles.
        margin : float, optional
            Least clearance from them [m]; the present one unless given.

        Raises
        ------
        WorldError
            See the class; the present obstacles are kept then.
        """
        margin = self.margin if margin is None else _checked_margin(margin)
        bodies, n_links = self._links.with_world(world), len(self._links.names)
        names, further = bodies.names, _pairs_with_world(bodies, n_links, world)
        pairs = [
            (a, b)
            for a, b in [*self._pairs_of_links, *further]
            if not world.allows(names[a], names[b])
        ]
        self.world, self.margin, self._bodies = world, margin, bodies
        self.pairs = tuple((names[a], names[b]) for a, b in pairs)
        self._geometry, self._hulls = bodies.shapes, bodies.hulls
        for geometry in (self._geometry, self._hulls):
            _set_pairs(geometry, pairs)
        self._geometry_data = self._geometry.createData()
        self._hull_data = self._hulls.createData()
        for request in self._hull_data.distanceRequests:
            request.gjk_tolerance = _PRECISION
        self._indices = np.array(pairs, dtype=np.intp).reshape(-1, 2)
        first, second = self._indices.T
        self.margins = np.where(second >= n_links, margin, 0.0)
        self._are_convex = bodies.are_convex[first] & bodies.are_convex[second]
        # Of the joints that move one of both, 1 for the second body, −1 for the first.
        self._moved = bodies.moved[second] - bodies.moved[first]
        self.levers = np.maximum(
            np.where(self._moved > 0.0, bodies.levers[second], 0.0),
            np.where(self._moved < 0.0, bodies.levers[first], 0.0),
        )

    @property
    def has_geometry(self) -> bool:
        """Whether there is any collision geometry of links at all."""
        return bool(self._links.names)

    def distances(self, q: FloatArray, pairs: NDArray[np.intp]) -> tuple[FloatArray, FloatArray]:
        """Distances of pairs less their margins, and their derivatives by the joints.

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
            Their derivatives by the joints: rates at which the nearest points of two bodies
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
            a, b = (self._centre(part) for part in self._indices[pairs[i]])
            second[i] = b
            away[i] = b - a if np.linalg.norm(b - a) > CONTACT else np.ones(3)
            lengths[i] = np.linalg.norm(away[i])
        away /= lengths[:, None]
        # Both points lie on one line along that direction, so both give the same moment about the
        # origin.
        along = np.hstack([away, np.cross(second, away)]) @ jacobian
        rows = np.empty_like(along)
        rows[:, self.model_order] = along * self._moved[pairs]
        return distances - self.margins[pairs], rows

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

    def nearest_point(self, q: FloatArray, pair: int) -> FloatArray:
        """Point of the second body of a pair that is nearest to the first one, shape (3,) [m]."""
        pin.forwardKinematics(self._model, self._data, self._in_model_order(q))
        pin.updateGeometryPlacements(self._model, self._data, self._hulls, self._hull_data)
        return np.array(self._nearest_points(pair).getNearestPoint2())

    def _in_model_order(self, q: FloatArray) -> FloatArray:
        return np.ascontiguousarray(q[self.model_order])

    def _centre(self, part: int) -> FloatArray:
        placement = self._data.oMi[int(self._bodies.joints[part])]
        return np.asarray(placement.act(self._bodies.centres[part]))

    def lower_bounds(self, q: FloatArray, pairs: Any, enough: FloatArray) -> FloatArray:
        """Distances of pairs less their margins [m]; a lower bound where it exceeds `enough`."""
        q = self._in_model_order(q)
        pin.updateGeometryPlacements(self._model, self._data, self._hulls, self._hull_data, q)
        distances: FloatArray = np.array([self._hull_distance(int(k)) for k in pairs])
        distances -= self.margins[pairs]
        near = [i for i in np.flatnonzero(distances <= enough) if not self._are_convex[pairs[i]]]
        if near:
            distances[near] = self._exact_distances(q, pairs[near]) - self.margins[pairs[near]]
        return distances

    def _hull_distance(self, pair: int) -> float:
        return float(pin.computeDistance(self._hulls, self._hull_data, pair).min_distance)

    def _exact_distances(self, configuration: FloatArray, pairs: Any) -> FloatArray:
        geometry, data = self._geometry, self._geometry_data
        pin.updateGeometryPlacements(self._model, self._data, geometry, data, configuration)
        return np.array([pin.computeDistance(geometry, data, int(k)).min_distance for k in pairs])


def _checked_margin(margin: float) -> float:
    value = float(frozen_array(margin, (), "margin of the clearance", WorldError))
    if not 0.0 <= value <= MAX_LENGTH:
        raise WorldError(f"margin of the clearance must be from 0 to {MAX_LENGTH:g} m, got {value}")
    return value


def _pairs_with_world(bodies: Bodies, n_links: int, world: World) -> Iterator[tuple[int, int]]:
    """The pairs of a link, or an obstacle on a link, with an obstacle that moves relative to it."""
    obstacles = [obstacle for obstacle in world for _ in obstacle.shapes]
    for i, obstacle in enumerate(obstacles):
        b = n_links + i
        excepted = {obstacle.name, obstacle.frame, *obstacle.touch_links}
        for a in range(b):
            other = obstacles[a - n_links].touch_links if a >= n_links else ()
            if bodies.joints[a] == bodies.joints[b] or bodies.names[a] in excepted:
                continue
            if obstacle.name not in other:
                yield a, b


def _remove_touching_at_neutral(model: Any, geometry: Any) -> None:
    neutral = np.clip(pin.neutral(model), model.lowerPositionLimit, model.upperPositionLimit)
    data = geometry.createData()
    pin.updateGeometryPlacements(model, model.createData(), geometry, data, neutral)
    pairs = _index_pairs(geometry)
    distances = [pin.computeDistance(geometry, data, k).min_distance for k in range(len(pairs))]
    _set_pairs(geometry, [pair for pair, d in zip(pairs, distances, strict=True) if d >= CONTACT])


def _index_pairs(geometry: Any) -> list[tuple[int, int]]:
    """Numbers of the geometry objects of each pair."""
    return [(pair.first, pair.second) for pair in geometry.collisionPairs]


def _set_pairs(geometry: Any, pairs: Sequence[tuple[int, int]]) -> None:
    # What Python gets of Pinocchio's pairs are references to places in a vector, so the vector
    # is made again: removing one pair would put others into the places behind it.
    geometry.removeAllCollisionPairs()
    for first, second in pairs:
        geometry.addCollisionPair(pin.CollisionPair(first, second))


def _remove_disabled(model: Any, geometry: Any, srdf: Path) -> None:
    source = f"the SRDF file '{srdf}'"
    with reading(source, RobotError):
        text = read_text(srdf)
        parse_xml(text, source)
        pin.removeCollisionPairsFromXML(model, geometry, text)


def package_folders(given: Sequence[Path], urdf: Path | None = None) -> list[Path]:
    """Folders in which packages may be: those given, those of ROS, and those above a URDF file."""
    folders = [*given]
    folders += [Path(p) for p in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep) if p]
    prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    folders += [Path(p) / "share" for p in prefixes if p]
    return folders if urdf is None else [*folders, *urdf.resolve().parents]
