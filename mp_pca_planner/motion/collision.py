# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Whether a robot hits itself: which links may not touch, and how far apart they are.

The distances of pairs of links are followed along the motion that the controller executes. A pair
that is apart can't touch before the joints between have closed its distance, so it is looked at
again only then (conservative advancement: Mirtich, PhD thesis, Berkeley, 1996), and otherwise
every millisecond. Meshes are looked at closer than their convex hulls only where these are near.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..exceptions import RobotError
from ..files import read_text, reading
from ..robot.model import Robot
from ..robot.urdf import parse_xml
from .trajectory import Trajectory
from .validation import interpolate

NOT_CHECKED = "; self-collisions were not checked: the robot has no collision geometry"
"""What messages say then."""

# Distances below this are contact [m]: what the algorithms give for touching surfaces.
_CONTACT = 1e-6
# Precision of distances [m]: derivatives hold to a hundredth of what is usual.
_PRECISION = 1e-8
# Nearer than this [m], it matters whether links are in their convex hulls as a whole.
_NEAR = 1e-2
# A pair that needs another look later than so many samples needs no exact distance, and none waits
# for more than so many.
_SOON, _LATEST = 20, 500


@dataclass(frozen=True)
class Collision:
    """Two links that are in each other during a motion.

    Attributes
    ----------
    pair : int
        Which of the pairs of the model they are.
    links : tuple of str
        Their names.
    time : float
        When they are deepest in each other [s].
    penetration : float
        How deep [m]; of meshes that are not convex it is a lower bound.
    first_time : float
        When they meet [s].
    last_time : float
        When they were last found in each other [s].
    """

    pair: int
    links: tuple[str, str]
    time: float
    penetration: float
    first_time: float
    last_time: float

    def within(self, began: float, ended: float) -> Collision | None:
        """The part of it between two times, with times counted from the first; None if none."""
        first, last = max(self.first_time, began), min(self.last_time, ended)
        if first > last:
            return None
        moment = min(max(self.time, first), last)
        return replace(self, time=moment - began, first_time=first - began, last_time=last - began)

    def __str__(self) -> str:
        return (
            f"'{self.links[0]}' and '{self.links[1]}' collide from {self.first_time:.3f} s on "
            f"(deepest at {self.time:.3f} s, by {1e3 * self.penetration:.1f} mm)"
        )


class CollisionModel:
    """Which links of a robot may not touch, and whether they do.

    Parameters
    ----------
    robot : Robot
        The robot, whose URDF has collision geometry.
    srdf : str or Path, optional
        An SRDF file whose ``disable_collisions`` name the pairs that need no look. Without one,
        these are neighbours and what touches in the neutral configuration.
    package_dirs : sequence of Path
        Folders in which packages of ``package://`` paths of meshes are.

    Attributes
    ----------
    pairs : tuple of tuple of str
        The pairs of links that are watched; empty without collision geometry.

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
        self._model, self._geometry, self._order = robot.collision_geometry(package_dirs)
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
            self._remove_disabled(Path(srdf))
        self._remove_fixed()
        self._geometry_data = self._geometry.createData()
        self._hulls, convex = _hulls(self._geometry)
        self._hull_data = self._hulls.createData()
        for request in self._hull_data.distanceRequests:
            request.gjk_tolerance = _PRECISION
        pairs = self._geometry.collisionPairs
        self._are_convex = [convex[pair.first] and convex[pair.second] for pair in pairs]
        self.pairs = tuple(self._links(pair) for pair in pairs)
        self._moved = self._moved_by_joints()
        self._levers = self._lever_arms()

    @property
    def has_geometry(self) -> bool:
        """Whether there is any collision geometry at all."""
        return bool(self._geometry.ngeoms)

    def collisions(self, trajectory: Trajectory) -> tuple[Collision, ...]:
        """The collisions of a motion, one of each pair that has any, the deepest first.

        Parameters
        ----------
        trajectory : Trajectory
            The motion, of the robot's joints in its order.
        """
        dense = interpolate(trajectory)
        speeds = np.abs(dense.v[:, self._order])
        ways = np.maximum(speeds[1:], speeds[:-1]) * np.diff(dense.times)[:, None]
        # How far each joint has gone up to each moment.
        gone = np.concatenate([np.zeros((1, ways.shape[1])), np.cumsum(ways, axis=0)])
        i, last = 0, len(gone) - 1
        due = np.zeros(len(self.pairs), dtype=np.intp)
        found: dict[int, list[tuple[float, float]]] = {}
        while i <= last and self.pairs:
            # The last sample is looked at whatever is due.
            now = np.flatnonzero(due <= i) if i < last else np.arange(due.size)
            # How far each pair can have closed at the samples that follow, at most [m].
            closed = (gone[i + 1 : i + 1 + _LATEST] - gone[i]) @ self._levers[now].T
            soon = closed[:_SOON].max(axis=0, initial=0.0)
            distances = self._lower_bounds(dense.q[i], now, soon)
            due[now] = i + 1 + np.count_nonzero(closed < distances, axis=0)
            for pair, distance in zip(now, distances, strict=True):
                if not distance >= _CONTACT:  # a NaN is a collision
                    met = float(distance), float(dense.times[i])
                    found.setdefault(int(pair), []).append(met)
            i = min(int(due.min()), last) if i < last else last + 1
        return tuple(
            Collision(k, self.pairs[k], time, max(0.0, -distance), looks[0][1], looks[-1][1])
            for (distance, time), k, looks in sorted(
                (min(looks), k, looks) for k, looks in found.items()
            )
        )

    def distances(self, q: FloatArray, pairs: NDArray[np.intp]) -> tuple[FloatArray, FloatArray]:
        """How far pairs are apart, and how that changes with the joints.

        Parameters
        ----------
        q : array, shape (n_joints,)
            Positions of the robot's joints in its order.
        pairs : array of int, shape (n_pairs,)
            Which of the pairs.

        Returns
        -------
        distances : array, shape (n_pairs,)
            In [m]; of meshes that are in each other, minus how deep their convex hulls are.
        rows : array, shape (n_pairs, n_joints)
            Their derivatives by the joints: of two links, how fast the nearest point of the second
            goes away from that of the first.
        """
        jacobian = pin.computeJointJacobians(self._model, self._data, self._in_model_order(q))
        pin.updateGeometryPlacements(self._model, self._data, self._hulls, self._hull_data)
        found = [self._nearest_points(int(k)) for k in pairs]
        distances = np.array([one.min_distance for one in found])
        first = np.array([one.getNearestPoint1() for one in found])
        second = np.array([one.getNearestPoint2() for one in found])
        away = (second - first) * np.sign(distances)[:, None]
        lengths = np.linalg.norm(away, axis=1)
        for i in np.flatnonzero(~(lengths > _CONTACT)):
            # In contact there are no two points to tell the direction; centres do, if they differ.
            a, b = (self._centre(part) for part in _both(self._hulls.collisionPairs[int(pairs[i])]))
            second[i] = b
            away[i] = b - a if np.linalg.norm(b - a) > _CONTACT else np.ones(3)
            lengths[i] = np.linalg.norm(away[i])
        away /= lengths[:, None]
        # Both points are on one line along that direction, which turns about the origin alike.
        along = np.hstack([away, np.cross(second, away)]) @ jacobian
        rows = np.empty_like(along)
        rows[:, self._order] = along * self._moved[pairs]
        return distances, rows

    def _nearest_points(self, pair: int) -> Any:
        """Pinocchio's answer for the links where they are."""
        found = pin.computeDistance(self._hulls, self._hull_data, pair)
        if self._are_convex[pair] or found.min_distance > _NEAR:
            return found
        geometry, data = self._geometry, self._geometry_data
        pin.updateGeometryPlacements(self._model, self._data, geometry, data)
        exact = pin.computeDistance(geometry, data, pair)
        # Of meshes in each other it tells nothing.
        return exact if exact.min_distance > _CONTACT else found

    def _in_model_order(self, q: FloatArray) -> FloatArray:
        return np.ascontiguousarray(q[self._order])

    def _centre(self, part: int) -> FloatArray:
        return np.asarray(self._hull_data.oMg[part].act(self._centres[part]))

    def _lower_bounds(self, q: FloatArray, pairs: Any, enough: FloatArray) -> FloatArray:
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

    def _remove_fixed(self) -> None:
        """Leave the pairs that move against each other."""
        joints = [part.parentJoint for part in self._geometry.geometryObjects]
        self._keep_pairs([joints[a] != joints[b] for a, b in self._index_pairs()])

    def _remove_touching_at_neutral(self) -> None:
        low, high = self._model.lowerPositionLimit, self._model.upperPositionLimit
        neutral = np.clip(pin.neutral(self._model), low, high)
        self._geometry_data = self._geometry.createData()
        distances = self._exact_distances(neutral, range(len(self._geometry.collisionPairs)))
        self._keep_pairs(distances >= _CONTACT)

    def _index_pairs(self) -> list[tuple[int, int]]:
        """Numbers of the geometry objects of each pair."""
        return [_both(pair) for pair in self._geometry.collisionPairs]

    def _keep_pairs(self, kept: Iterable[bool]) -> None:
        # What Python gets of Pinocchio's pairs are references to places in a vector, so the vector
        # is made again: removing one pair would put others into the places behind it.
        pairs = [pair for pair, keep in zip(self._index_pairs(), kept, strict=True) if keep]
        self._geometry.removeAllCollisionPairs()
        for first, second in pairs:
            self._geometry.addCollisionPair(pin.CollisionPair(first, second))

    def _remove_disabled(self, srdf: Path) -> None:
        source = f"the SRDF file '{srdf}'"
        with reading(source, RobotError):
            text = read_text(srdf)
            parse_xml(text, source)
            pin.removeCollisionPairsFromXML(self._model, self._geometry, text)

    def _moved_by_joints(self) -> FloatArray:
        """What each joint moves of each pair, shape (n_pairs, n_joints).

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
        """How fast each joint can make the links of each pair approach, (n_pairs, n_joints).

        For a joint that turns, the longest way from it along the links to a point of the geometry
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
                    slides = self._slide(joint)
                    if joint not in other:
                        row[self._model.joints[joint].idx_v] = 1.0 if slides else reach
                    placement = self._model.jointPlacements[joint].translation
                    reach += float(np.linalg.norm(placement)) + slides
        return arms

    def _slide(self, joint: int) -> float:
        """How far a joint that slides goes [m], 0 for one that turns."""
        if not self._model.joints[joint].shortname().startswith("JointModelP"):
            return 0.0
        index = self._model.joints[joint].idx_q
        ends = self._model.lowerPositionLimit[index], self._model.upperPositionLimit[index]
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
