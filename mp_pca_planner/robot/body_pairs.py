# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Distances of pairs of bodies in many configurations at once.

Balls and boxes around the bodies bound most distances from below. The others are computed by GJK on
convex hulls, and on the meshes themselves where the hulls are near each other.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ..arrays import FloatArray
from .bodies import Bodies
from .joint_poses import JointPoses, JointTree

CONTACT = 1e-6
"""Distance below which bodies are in contact [m]: the precision of touching surfaces."""

# Precision of distances [m], at which relative errors of derivatives are usually below 1 %.
_PRECISION = 1e-8
# Hulls nearer than this beside their margin [m] are replaced by the meshes themselves.
_NEAR = 3e-3
# Number of bodies up to which the boxes of each pair are compared.
_FEW = 50

Indices = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class NearPairs:
    """The pairs that are near each other in some configurations.

    Attributes
    ----------
    bounds : array, shape (n_configurations, n_pairs)
        Distances of the entries below, and lower bounds of all others [m].
    configurations, pairs : array of int, shape (n_near,)
        The configuration and the pair of each entry.
    distances : array, shape (n_near,)
        Distances [m]; for meshes in collision, the negative penetration depth of their convex
        hulls.
    rows : array, shape (n_near, n_joints)
        Their derivatives by the joints: rates at which the nearest points of two bodies separate.
    """

    bounds: FloatArray
    configurations: Indices
    pairs: Indices
    distances: FloatArray
    rows: FloatArray


class BodyPairs:
    """Pairs of bodies and their distances; configurations are in the order of the model's joints.

    Parameters
    ----------
    tree : JointTree
        The joints of the model.
    bodies : Bodies
        The bodies.
    indices : array of int, shape (n_pairs, 2)
        The two bodies of each pair.
    margins : array, shape (n_pairs,)
        Subtracted from each distance [m].

    Attributes
    ----------
    levers : array, shape (n_pairs, n_joints)
        See `CollisionGeometry`.
    """

    def __init__(
        self, tree: JointTree, bodies: Bodies, indices: Indices, margins: FloatArray
    ) -> None:
        self._bodies, self._indices, self.margins = bodies, indices, margins
        self._model, self._data = bodies.model, bodies.model.createData()
        self._tree = tree
        first, second = indices.T
        self._are_convex = bodies.are_convex[first] & bodies.are_convex[second]
        meshes = ~self._are_convex
        # Number of each pair with a mesh among these pairs.
        self._meshes = np.cumsum(meshes) - 1
        self._shape_data = _working_memory(bodies.shapes, indices[meshes], margins[meshes])
        self._hull_data = _working_memory(bodies.hulls, indices, margins)
        # Of the joints that move one of both, 1 for the second body, −1 for the first.
        self._moved = bodies.moved[second] - bodies.moved[first]
        # A joint that moves both does not count.
        both = np.where(self._moved > 0.0, bodies.levers[second], bodies.levers[first])
        self.levers = both * np.abs(self._moved)

    @cached_property
    def collide(self) -> CollisionCheck:
        """Whether any pair is in collision in a configuration."""
        return self.check(self.margins)

    def check(self, distances: FloatArray, *, hulls: bool = False) -> CollisionCheck:
        """The check of configurations for pairs nearer than some distances, shape (n_pairs,).

        With `hulls`, bodies that move are replaced by their convex hulls.
        """
        are_meshes = ~self._bodies.are_convex
        if hulls:
            are_meshes = are_meshes & (self._bodies.joints == 0)
        return CollisionCheck(self._bodies, self._indices, distances, are_meshes)

    def bounds(self, q: FloatArray, enough: FloatArray | float) -> FloatArray:
        """Lower bounds of all distances in some configurations.

        Parameters
        ----------
        q : array, shape (n_configurations, n_joints)
            The configurations.
        enough : float, or array that broadcasts to (n_configurations, n_pairs)
            A bound above this one is not improved [m].

        Returns
        -------
        bounds : array, shape (n_configurations, n_pairs)
            The bounds [m]; those of bodies in collision are at most 0.
        """
        return self._bounds(self._tree.poses(q), enough)

    def _bounds(self, poses: JointPoses, enough: FloatArray | float) -> FloatArray:
        bodies, (first, second) = self._bodies, self._indices.T
        turned = poses.rotations[:, bodies.joints]
        centres: FloatArray = poses.positions[:, bodies.joints]
        centres = centres + (turned @ bodies.centres[:, :, None])[..., 0]
        apart = centres[:, second] - centres[:, first]
        bounds: FloatArray = np.sqrt(np.einsum("kpi,kpi->kp", apart, apart))
        bounds -= bodies.radii[first] + bodies.radii[second] + self.margins
        k, pairs = np.nonzero(~(bounds > enough))
        away, margins = apart[k, pairs], self.margins[pairs]
        for one, other in ((first[pairs], second[pairs]), (second[pairs], first[pairs])):
            # The ball around one body and the box around the other.
            axes = turned[k, other] @ bodies.rotations[other]
            local = np.abs(np.einsum("eij,ei->ej", axes, away))
            outside = np.maximum(local - bodies.halves[other], 0.0)
            gaps = np.sqrt(np.einsum("ei,ei->e", outside, outside)) - bodies.radii[one] - margins
            bounds[k, pairs] = np.maximum(bounds[k, pairs], gaps)
        return bounds

    def distances(self, q: FloatArray, configurations: Indices, pairs: Indices) -> FloatArray:
        """Distances of pairs in configurations; of hulls, as long as these are not in contact.

        Parameters
        ----------
        q : array, shape (n_configurations, n_joints)
            The configurations.
        configurations, pairs : array of int, shape (n,)
            Configuration and pair of each entry.

        Returns
        -------
        distances : array, shape (n,)
            The distances [m].
        """
        found, margins = np.empty(pairs.size), self.margins[pairs]
        for entries in self._placed(q, configurations, self._bodies.hulls, self._hull_data):
            distances = map(self._hull_distance, pairs[entries].tolist())
            found[entries] = [one.min_distance for one in distances]
        found -= margins
        near = np.flatnonzero(~(found >= CONTACT) & ~self._are_convex[pairs])
        shapes, data = self._bodies.shapes, self._shape_data
        for entries in self._placed(q, configurations[near], shapes, data):
            for e in near[entries]:
                number = int(self._meshes[pairs[e]])
                exact = pin.computeDistance(shapes, data, number).min_distance
                found[e] = exact - margins[e]
        return found

    def near(self, q: FloatArray, reach: float) -> NearPairs:
        """The pairs that are nearer than some distance in some configurations.

        Parameters
        ----------
        q : array, shape (n_configurations, n_joints)
            The configurations.
        reach : float
            The distance [m].
        """
        poses = self._tree.poses(q)
        bounds = self._bounds(poses, reach)
        configurations, pairs = np.nonzero(~(bounds > reach))
        distances, points = self._nearest_points(q, configurations, pairs)
        bounds[configurations, pairs] = distances - self.margins[pairs]
        is_near = ~(bounds[configurations, pairs] > reach)
        configurations, pairs = configurations[is_near], pairs[is_near]
        rows = self._rows(poses, configurations, pairs, distances[is_near], points[is_near])
        return NearPairs(bounds, configurations, pairs, bounds[configurations, pairs], rows)

    def nearest_point(self, q: FloatArray, pair: int) -> FloatArray:
        """Point of the second body of a pair that is nearest to the first one, shape (3,) [m]."""
        one = np.zeros(1, dtype=np.intp)
        return np.array(self._nearest_points(q[None], one, one + pair)[1][0, 1])

    def _nearest_points(
        self, q: FloatArray, configurations: Indices, pairs: Indices
    ) -> tuple[FloatArray, FloatArray]:
        """Distances of entries, and the nearest points of both bodies, shape (n, 2, 3)."""
        distances, points = np.empty(pairs.size), np.empty((pairs.size, 2, 3))
        near, are_convex = (self.margins + _NEAR).tolist(), self._are_convex.tolist()
        for entries in self._placed(q, configurations, self._bodies.hulls, self._hull_data):
            for e, pair in zip(entries.tolist(), pairs[entries].tolist(), strict=True):
                found = self._hull_distance(pair)
                if not are_convex[pair] and not found.min_distance > near[pair]:
                    found = self._mesh_distance(pair)
                distances[e] = found.min_distance
                points[e, 0], points[e, 1] = found.getNearestPoint1(), found.getNearestPoint2()
        return distances, points

    def _hull_distance(self, pair: int) -> Any:
        return pin.computeDistance(self._bodies.hulls, self._hull_data, pair)

    def _mesh_distance(self, pair: int) -> Any:
        """The result for the meshes themselves, or for their hulls if the meshes are in contact."""
        shapes, data = self._bodies.shapes, self._shape_data
        pin.updateGeometryPlacements(self._model, self._data, shapes, data)
        exact = pin.computeDistance(shapes, data, int(self._meshes[pair]))
        # It is undefined for meshes in contact.
        return exact if exact.min_distance > CONTACT else self._hull_distance(pair)

    def _placed(
        self, q: FloatArray, configurations: Indices, geometry: Any, data: Any
    ) -> Iterator[Indices]:
        """Place the geometry for one configuration after the other; yield its entries."""
        order = np.argsort(configurations, kind="stable")
        every, starts = np.unique(configurations[order], return_index=True)
        edges = [*starts.tolist(), order.size]
        for one, (first, last) in zip(every.tolist(), pairwise(edges), strict=True):
            pin.updateGeometryPlacements(self._model, self._data, geometry, data, q[one])
            yield order[first:last]

    def _rows(
        self,
        poses: JointPoses,
        k: Indices,
        pairs: Indices,
        distances: FloatArray,
        points: FloatArray,
    ) -> FloatArray:
        """Derivatives of distances by the joints, see `NearPairs`."""
        first, second = self._indices[pairs].T
        centres = [_centres(self._bodies, poses, k, body) for body in (first, second)]
        away, place = _directions(distances, points, np.stack(centres, axis=1))
        tree = self._tree
        axes = (poses.rotations[k, 1:] @ tree.axes[1:, :, None])[..., 0]
        arms = place[:, None] - poses.positions[k, 1:]
        motions = np.where(tree.turns[1:, None], np.cross(axes, arms), axes)
        rows = np.einsum("eji,ei->ej", motions, away)
        return np.asarray(rows[:, tree.order] * self._moved[pairs])


def _working_memory(geometry: Any, indices: Indices, margins: FloatArray) -> Any:
    """Pinocchio's data of a geometry with these pairs."""
    set_pairs(geometry, indices.tolist())
    data = geometry.createData()
    for request in data.distanceRequests:
        request.gjk_tolerance = _PRECISION
    for request, margin in zip(data.collisionRequests, margins.tolist(), strict=True):
        request.security_margin = margin
    return data


class CollisionCheck:
    """Whether any pair is nearer than its margin in a configuration.

    Parameters
    ----------
    bodies, indices, margins
        See `BodyPairs`.
    are_meshes : array of bool, shape (n_bodies,)
        Bodies that are meshes; the others are convex hulls.
    """

    def __init__(
        self,
        bodies: Bodies,
        indices: Indices,
        margins: FloatArray,
        are_meshes: NDArray[np.bool_],
    ) -> None:
        geometry = bodies.hulls.copy()
        for i in np.flatnonzero(are_meshes).tolist():
            geometry.geometryObjects[i].geometry = bodies.shapes.geometryObjects[i].geometry
        data, geometry_data = bodies.model.createData(), _working_memory(geometry, indices, margins)
        # Pinocchio's broad phase keeps no references to these.
        self._kept = bodies.model, data, geometry, geometry_data
        # The fastest broad phases of Coal: each pair of boxes, or sweep and prune of many.
        kind = "Naive" if len(bodies.names) <= _FEW else "SSaP"
        manager = getattr(pin, f"BroadPhaseManager_{kind}CollisionManager", None)
        if manager is None:  # before release 3
            self._arguments: tuple[Any, ...] = self._kept
        else:
            # Its boxes are enlarged by the margins in their first update.
            self._arguments = *self._kept[:2], manager(bodies.model, geometry, geometry_data)

    def __call__(self, q: FloatArray) -> bool:
        """The answer for a configuration, shape (n_joints,)."""
        return bool(pin.computeCollisions(*self._arguments, q, True))


def _centres(bodies: Bodies, poses: JointPoses, k: Indices, body: Indices) -> FloatArray:
    """Centres of bodies in configurations, one of each per entry, shape (n, 3)."""
    joints = bodies.joints[body]
    local = (poses.rotations[k, joints] @ bodies.centres[body][:, :, None])[..., 0]
    return np.asarray(poses.positions[k, joints] + local)


def _directions(
    distances: FloatArray, points: FloatArray, centres: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Directions in which pairs separate, and points of them on the second bodies, shape (n, 3).

    In contact the two nearest points coincide; then the centres define the direction, if they
    differ.
    """
    away = (points[:, 1] - points[:, 0]) * np.sign(distances)[:, None]
    met = ~(np.linalg.norm(away, axis=1) > CONTACT)
    away[met] = centres[met, 1] - centres[met, 0]
    away[~(np.linalg.norm(away, axis=1) > CONTACT)] = 1.0
    place = np.where(met[:, None], centres[:, 1], points[:, 1])
    return away / np.linalg.norm(away, axis=1)[:, None], place


def index_pairs(geometry: Any) -> list[tuple[int, int]]:
    """Numbers of the geometry objects of each pair."""
    return [(pair.first, pair.second) for pair in geometry.collisionPairs]


def set_pairs(geometry: Any, pairs: list[Any]) -> None:
    """Replace the pairs of a geometry."""
    # What Python gets of Pinocchio's pairs are references to places in a vector, so the vector
    # is made again: removing one pair would put others into the places behind it.
    geometry.removeAllCollisionPairs()
    for first, second in pairs:
        geometry.addCollisionPair(pin.CollisionPair(first, second))
