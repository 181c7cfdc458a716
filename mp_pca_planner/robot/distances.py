# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Distances of pairs of bodies in many configurations at once.

Balls and boxes around the bodies bound most distances from below. The others are computed by GJK on
convex hulls, and on the meshes themselves where the hulls are near each other.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..lazy import LazyModule
from .bodies import Bodies

coal, pin = LazyModule("coal"), LazyModule("pinocchio")

JointPoses = tuple[FloatArray, FloatArray]
"""Orientations and origins [m] of all joints in some configurations, in the base frame.

Their shapes are (n_configurations, n_joints + 1, 3, 3) and (n_configurations, n_joints + 1, 3); the
first joint is the base.
"""


class JointTree:
    """The joints of a model, each with one degree of freedom.

    Parameters
    ----------
    model : pinocchio.Model
        The model.
    order : array of int, shape (n_joints,)
        For each joint of the model's configurations, its index in configurations here.

    Attributes
    ----------
    order : array of int, shape (n_joints,)
        As given.
    axes : array, shape (n_joints + 1, 3)
        Axis of each joint in its own frame; 0 for the base.
    turns : array of bool, shape (n_joints + 1,)
        Whether each joint turns about its axis; otherwise it slides along it.
    joints : array of int, shape (n_joints,)
        For each coordinate of a configuration, the joint's number, from 0 without the base.
    moves : array, shape (n_joints + 1, n_joints)
        1 for each coordinate that moves a joint, else 0.
    offsets : array, shape (n_joints + 1, 3)
        Origin of each joint at position 0, in the frame of the one before it [m].
    slides : array, shape (n_joints + 1,)
        How far each joint may slide [m]; 0 for those that turn.
    paths : array, shape (n_joints + 1, n_joints + 1)
        Length of the links from one joint to another one that it moves [m].
    first_after : array of int, shape (n_joints + 1, n_joints + 1)
        The first joint on the path from one joint to another one that it moves, else 0.
    """

    def __init__(self, model: Any, order: NDArray[np.intp]) -> None:
        self.order, n, placements = order, model.njoints, model.jointPlacements
        self._parents = [int(parent) for parent in model.parents]
        columns = [model.joints[j].idx_v for j in range(1, n)]
        self._columns = [0, *order[columns].tolist()]
        self.joints = np.argsort(self._columns[1:])
        self.moves = np.zeros((n, n - 1))
        for j in range(1, n):
            self.moves[j] = self.moves[self._parents[j]]
            self.moves[j, self._columns[j]] = 1.0
        self.offsets = np.array([placements[j].translation for j in range(n)])
        fixed = np.array([placements[j].rotation for j in range(n)])
        self.axes, self.turns = _axes(model, columns)
        ends = np.abs([model.lowerPositionLimit, model.upperPositionLimit])
        slides = np.append(0.0, ends.max(axis=0)[columns])
        self.slides = np.where(self.turns, 0.0, slides)
        lengths = np.linalg.norm(self.offsets, axis=1) + self.slides
        self.paths, self.first_after = np.zeros((n, n)), np.zeros((n, n), dtype=np.intp)
        for j in range(1, n):
            parent = self._parents[j]
            self.paths[:, j] = self.paths[:, parent] + lengths[j]
            self.paths[j, j] = 0.0
            self.first_after[:, j] = self.first_after[:, parent]
            self.first_after[parent, j] = j
        cross = np.cross(self.axes[:, None], np.eye(3)).transpose(0, 2, 1)
        # Rodrigues: R(q) = I + sin q · K + (1 − cos q) · K², after the fixed placement.
        self._by_sine, square = fixed @ cross, fixed @ cross @ cross
        self._by_sine[~self.turns] = square[~self.turns] = 0.0
        self._constant, self._by_cosine = fixed + square, -square
        self._slide = np.where(self.turns[:, None], 0.0, (fixed @ self.axes[:, :, None])[:, :, 0])

    def poses(self, q: FloatArray) -> JointPoses:
        """Poses in some configurations, shape (n_configurations, n_joints)."""
        angles = q[:, self._columns, None]
        local = self._constant + self._by_sine * np.sin(angles)[..., None]
        local += self._by_cosine * np.cos(angles)[..., None]
        shifts = self.offsets + self._slide * angles
        rotations, positions = np.empty_like(local), np.empty_like(shifts)
        rotations[:, 0], positions[:, 0] = np.eye(3), 0.0
        for j, parent in list(enumerate(self._parents))[1:]:
            np.matmul(rotations[:, parent], local[:, j], out=rotations[:, j])
            moved = (rotations[:, parent] @ shifts[:, j, :, None])[..., 0]
            positions[:, j] = positions[:, parent] + moved
        return rotations, positions


def _axes(model: Any, columns: list[int]) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Axes of the joints, and whether they turn."""
    data, axes = model.createData(), np.zeros((model.njoints, 3))
    # Of a single joint, Pinocchio returns a vector.
    jacobians = np.reshape(pin.computeJointJacobians(model, data, np.zeros(model.nq)), (6, -1))
    turns = np.zeros(model.njoints, dtype=bool)
    for j, column in enumerate(jacobians.T[columns], start=1):
        turns[j] = bool(np.any(column[3:]))
        axes[j] = data.oMi[j].rotation.T @ (column[3:] if turns[j] else column[:3])
    return axes, turns


CONTACT = 1e-6
"""Distance below which bodies are in contact [m]: the precision of touching surfaces."""

# Precision of distances [m], at which relative errors of derivatives are usually below 1 %.
_PRECISION = 1e-8
# Hulls nearer than this beside their margin [m] are replaced by the meshes themselves.
_NEAR = 3e-3
# Numbers of bodies: up to which the boxes of each pair are compared, and from which on the data of
# all pairs take longer to make than a search for a path takes.
_FEW, _MANY = 50, 300

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
    q : array, shape (n_configurations, n_joints)
        The configurations.
    """

    bounds: FloatArray
    configurations: Indices
    pairs: Indices
    distances: FloatArray
    rows: FloatArray
    q: FloatArray


class BodyPairs:
    """Pairs of bodies and their distances.

    Parameters
    ----------
    tree : JointTree
        The joints of the model, in the order of configurations.
    bodies : Bodies
        The bodies.
    indices : array of int, shape (n_pairs, 2)
        The two bodies of each pair.
    margins : array, shape (n_pairs,)
        Subtracted from each distance [m].

    Attributes
    ----------
    levers : array, shape (n_pairs, n_joints)
        Bound of the speed at which each joint closes the distance of each pair [m or 1].
    """

    def __init__(
        self, tree: JointTree, bodies: Bodies, indices: Indices, margins: FloatArray
    ) -> None:
        self._bodies, self._indices, self.margins = bodies, indices, margins
        self._tree, self._transforms = tree, list[Any]()
        self._of_hulls = _shape_distances([body.hull for body in bodies.parts], indices)
        self._of_shapes = _shape_distances([body.shape for body in bodies.parts], indices)
        first, second = indices.T
        self._are_convex = bodies.are_convex[first] & bodies.are_convex[second]
        self._radii = bodies.radii[first] + bodies.radii[second] + margins
        # The first bodies are few: their distances from all others are a matrix.
        self._firsts, rows = np.unique(first, return_inverse=True)
        self._entries = rows.ravel() * len(bodies.names) + second
        # Of the joints that move one of both, 1 for the second body, −1 for the first.
        moves = tree.moves[bodies.joints]
        self._moved = moves[second] - moves[first]
        levers = _levers(tree, bodies)
        # A joint that moves both does not count.
        self.levers = np.abs(self._moved) * np.where(self._moved > 0.0, *levers[[second, first]])
        self._levers_in_contact = self._of_contacts(first, second)

    @cached_property
    def collide(self) -> Callable[[FloatArray], bool]:
        """Whether any pair is in collision in a configuration."""
        return self.check(np.full(len(self.margins), CONTACT))

    def check(self, distances: FloatArray, *, hulls: bool = False) -> Callable[[FloatArray], bool]:
        """The check for pairs nearer than margins and distances of shape (n_pairs,).

        With `hulls`, bodies that move may be replaced by their convex hulls.
        """
        if len(self._bodies.names) > _MANY:
            reach = float(distances.max(initial=0.0))
            return lambda q: bool(np.any(~(self.near(q[None], reach).bounds > distances)))
        parts = self._tree, self._bodies, self._indices, self.margins + distances
        return _collision_check(*parts, hulls=hulls)

    def poses(self, q: FloatArray) -> JointPoses:
        """Poses of the joints in some configurations, shape (n_configurations, n_joints)."""
        return self._tree.poses(q)

    def bounds(
        self, poses: JointPoses, enough: FloatArray | float, known: FloatArray | None = None
    ) -> FloatArray:
        """Lower bounds of all distances in some configurations.

        Parameters
        ----------
        poses : JointPoses
            Those of the configurations.
        enough : float, or array that broadcasts to (n_configurations, n_pairs)
            A bound above this one is not improved [m].
        known : array, shape (n_configurations, n_pairs), optional
            Bounds that are known already [m]; they are improved in place.

        Returns
        -------
        bounds : array, shape (n_configurations, n_pairs)
            The bounds [m]; those of bodies in collision are at most 0.
        """
        bodies = self._bodies
        turned, centres = (values[:, bodies.joints] for values in poses)
        centres = centres + (turned @ bodies.centres[:, :, None])[..., 0]
        if known is None:
            apart = _distances(centres[:, self._firsts], centres)
            apart = apart.reshape(len(centres), self._firsts.size * len(bodies.names))
            known = np.take(apart, self._entries, axis=1)
            known -= self._radii
        axes, every = turned @ bodies.rotations, known.reshape(-1)
        enough = np.broadcast_to(enough, known.shape).reshape(-1)
        for bound, *order in ((_ball_and_box, 0, 1), (_ball_and_box, 1, 0), (_boxes, 0, 1)):
            places = np.flatnonzero(~(every > enough))
            k, pairs = np.divmod(places, max(len(self.margins), 1))
            one, other = self._indices[pairs][:, order].T
            away = (centres[k, other] - centres[k, one])[:, None]
            gaps = bound(bodies, axes, away, k, one, other) - self.margins[pairs]
            every[places] = np.maximum(every[places], gaps)
        return known

    def distances(self, poses: JointPoses, configurations: Indices, pairs: Indices) -> FloatArray:
        """Distances of pairs in configurations; of hulls, as long as these are not in contact.

        Parameters
        ----------
        poses : JointPoses
            Those of the configurations.
        configurations, pairs : array of int, shape (n,)
            Configuration and pair of each entry.

        Returns
        -------
        distances : array, shape (n,)
            The distances [m].
        """
        places = self._places(poses, configurations, pairs)
        numbers, margins = pairs.tolist(), self.margins[pairs]
        results = map(self._of_hulls, numbers, *places)
        found = np.array([one.min_distance for one in results])
        found -= margins
        for e in np.flatnonzero(~(found >= CONTACT) & ~self._are_convex[pairs]).tolist():
            exact = self._of_shapes(numbers[e], places[0][e], places[1][e])
            found[e] = exact.min_distance - margins[e]
        return found

    def _of_contacts(self, first: Indices, second: Indices) -> FloatArray:
        """Levers of the points at which pairs meet, like `levers`.

        These points are on both bodies: no farther from a joint than the body that it does not
        move reaches. Known where that one is nearer to the base along the links.
        """
        bodies, tree = self._bodies, self._tree
        levers = np.full(self.levers.shape, np.inf)
        for still, moving in ((first, second), (second, first)):
            base, tip = bodies.joints[still], bodies.joints[moving]
            joints = tree.first_after[base, tip]
            (p,) = np.nonzero(joints)
            to_joint = np.linalg.norm(tree.offsets[joints[p]] - bodies.centres[still[p]], axis=1)
            to_joint += bodies.radii[still[p]] + self.margins[p] + tree.slides[joints[p]]
            lengths = tree.paths[joints[p]][:, 1 + tree.joints]
            levers[p] = np.where(tree.turns[1 + tree.joints], to_joint[:, None] + lengths, np.inf)
        return np.where(self.levers > 0.0, levers, np.inf)

    def approaches(self, pairs: Indices, moved: FloatArray, distances: FloatArray) -> FloatArray:
        """Largest lengths by which pairs come nearer, until they meet or again that near [m].

        Parameters
        ----------
        pairs : array of int, shape (n,)
            The pairs.
        moved : array, shape (n, n_joints)
            Displacements of the joints [rad or m].
        distances : array, shape (n,)
            Their distances before, or lower bounds of these [m].
        """
        near = self._levers_in_contact[pairs] + np.maximum(distances, 0.0)[:, None]
        return np.asarray(np.einsum("ej,ej->e", moved, np.minimum(self.levers[pairs], near)))

    def near(self, q: FloatArray, reach: float, before: NearPairs | None = None) -> NearPairs:
        """The pairs that are nearer than some distance in some configurations.

        Parameters
        ----------
        q : array, shape (n_configurations, n_joints)
            The configurations.
        reach : float
            The distance [m].
        before : NearPairs, optional
            The pairs in as many configurations nearby: those far apart there are not measured.
        """
        poses, known = self._tree.poses(q), None
        if before is not None:
            known = before.bounds - np.abs(q - before.q) @ self.levers.T
        bounds = self.bounds(poses, reach, known)
        configurations, pairs = np.nonzero(~(bounds > reach))
        most = self.margins[pairs] + reach
        distances, points = self._nearest_points(poses, configurations, pairs, most)
        bounds[configurations, pairs] = distances - self.margins[pairs]
        is_near = ~(distances > most)
        configurations, pairs = configurations[is_near], pairs[is_near]
        rows = self._rows(poses, configurations, pairs, distances[is_near], points[is_near])
        return NearPairs(bounds, configurations, pairs, bounds[configurations, pairs], rows, q)

    def nearest(self, poses: JointPoses, configurations: Indices, pairs: Indices) -> FloatArray:
        """The same as `distances`, but of the meshes themselves also where their hulls are near."""
        every = np.full(pairs.size, -np.inf)
        found, _ = self._nearest_points(poses, configurations, pairs, every)
        return found - self.margins[pairs]

    def nearest_point(self, q: FloatArray, pair: int) -> FloatArray:
        """Point of the second body of a pair that is nearest to the first one, shape (3,) [m]."""
        one, far = np.zeros(1, dtype=np.intp), np.array([np.inf])
        _, points = self._nearest_points(self._tree.poses(q[None]), one, one + pair, far)
        return np.array(points[0, 1])

    def _nearest_points(
        self, poses: JointPoses, configurations: Indices, pairs: Indices, most: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Distances of entries, and the nearest points of both bodies, shape (n, 2, 3).

        The points of entries that are farther apart than `most` are left out.
        """
        distances, points = [], np.zeros((pairs.size, 2, 3))
        reaches = np.where(self._are_convex[pairs], -np.inf, self.margins[pairs] + _NEAR).tolist()
        places = self._places(poses, configurations, pairs)
        entries = zip(pairs.tolist(), *places, reaches, most.tolist(), strict=True)
        for e, (pair, first, second, reach, far) in enumerate(entries):
            found = self._of_hulls(pair, first, second)
            distance = found.min_distance
            if not distance > reach:
                exact = self._of_shapes(pair, first, second)
                # It is undefined for meshes in contact.
                found = exact if exact.min_distance > CONTACT else found
                distance = found.min_distance
            distances.append(distance)
            if not distance > far:
                points[e] = found.getNearestPoint1(), found.getNearestPoint2()
        return np.array(distances), points

    def _places(
        self, poses: JointPoses, configurations: Indices, pairs: Indices
    ) -> tuple[list[Any], list[Any]]:
        """Poses of the first and the second bodies of entries, valid until the next call."""
        bodies, n_bodies = self._bodies, len(self._bodies.names)
        every = self._indices[pairs]
        # Bodies on the base are placed once.
        moments = np.where(bodies.joints[every] > 0, configurations[:, None], 0)
        numbers = moments * n_bodies + every
        every, found = np.unique(numbers, return_inverse=True)
        k, body = np.divmod(every, n_bodies)
        turned, places = (values[k, bodies.joints[body]] for values in poses)
        origins = (turned @ bodies.origins[body][:, :, None])[..., 0] + places
        placed = self._transforms
        # To set one takes a quarter of the time to make one.
        placed += [coal.Transform3s() for _ in range(len(every) - len(placed))]
        for one, *where in zip(placed, turned @ bodies.rotations[body], origins, strict=False):
            one.setTransform(*where)
        first, second = found.reshape(-1, 2).T.tolist()
        return [placed[i] for i in first], [placed[i] for i in second]

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
        tree, (turned, origins) = self._tree, (values[k, 1:] for values in poses)
        axes = (turned @ tree.axes[1:, :, None])[..., 0]
        arms = place[:, None] - origins
        motions = np.where(tree.turns[1:, None], np.cross(axes, arms), axes)
        rows = np.einsum("eji,ei->ej", motions, away)
        return np.asarray(rows[:, tree.joints] * self._moved[pairs])


def _shape_distances(shapes: Sequence[Any], indices: Indices) -> Callable[[int, Any, Any], Any]:
    """A function that returns Coal's result for a pair in two poses; its next call overwrites it.

    Parameters
    ----------
    shapes : sequence of coal.CollisionGeometry
        The shapes.
    indices : array of int, shape (n_pairs, 2)
        The two shapes of each pair.
    """
    # Coal's functions of the pairs that were near each other.
    functions: dict[int, Any] = {}
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    request.gjk_tolerance = _PRECISION

    def distance(pair: int, first: Any, second: Any) -> Any:
        function = functions.get(pair)
        if function is None:
            one, other = indices[pair].tolist()
            function = functions[pair] = coal.ComputeDistance(shapes[one], shapes[other])
        result.clear()
        function(first, second, request, result)
        return result

    return distance


def _collision_check(
    tree: JointTree, bodies: Bodies, indices: Indices, margins: FloatArray, *, hulls: bool
) -> Callable[[FloatArray], bool]:
    """The check whether any pair is nearer than its margin, see `BodyPairs.check`."""
    are_meshes = ~(bodies.are_convex | (hulls & (bodies.joints > 0)))
    geometry = pin.GeometryModel()
    for i, (body, is_mesh) in enumerate(zip(bodies.parts, are_meshes, strict=True)):
        part = pin.GeometryObject(
            str(i),
            parent_joint=body.joint,
            placement=body.place,
            collision_geometry=body.shape if is_mesh else body.hull,
        )
        geometry.addGeometryObject(part)
    for first, second in indices.tolist():
        geometry.addCollisionPair(pin.CollisionPair(first, second))
    # Pinocchio's broad phase keeps no references to these, but the function does.
    every = bodies.model, bodies.model.createData(), geometry, geometry.createData()
    requests = every[-1].collisionRequests
    for request, margin in zip(requests, margins.tolist(), strict=True):
        request.security_margin = margin
    # The fastest broad phases of Coal: each pair of boxes, or sweep and prune of many.
    kind = "Naive" if len(bodies.names) <= _FEW else "SSaP"
    manager = getattr(pin, f"BroadPhaseManager_{kind}CollisionManager")
    # Its boxes are enlarged by the margins in their first update.
    phase = manager(bodies.model, geometry, every[-1])
    return lambda q: bool(pin.computeCollisions(*every[:2], phase, q[tree.order], True))


def _levers(tree: JointTree, bodies: Bodies) -> FloatArray:
    """Largest speeds of the bodies by the joints, shape (n_bodies, n_joints).

    For a joint that turns, the longest path from it along the links to a point of the body [m]; for
    one that slides, 1.
    """
    reaches, joints = bodies.radii + np.linalg.norm(bodies.centres, axis=1), 1 + tree.joints
    lengths = reaches[:, None] + tree.paths[joints][:, bodies.joints].T
    levers = np.where(tree.turns[joints], lengths, 1.0)
    return np.where(tree.moves[bodies.joints] > 0.0, levers, 0.0)


def _ball_and_box(
    bodies: Bodies, axes: FloatArray, away: FloatArray, k: Indices, ball: Indices, box: Indices
) -> FloatArray:
    """Gaps between balls around bodies and boxes around others, with axes in configurations k."""
    outside = np.abs((away @ axes[k, box])[:, 0]) - bodies.halves[box]
    np.maximum(outside, 0.0, out=outside)
    return np.asarray(np.sqrt(np.einsum("ei,ei->e", outside, outside)) - bodies.radii[ball])


def _boxes(
    bodies: Bodies, axes: FloatArray, away: FloatArray, k: Indices, one: Indices, other: Indices
) -> FloatArray:
    """Largest gaps along their axes between boxes around bodies."""
    own, others = axes[k, one], axes[k, other]
    halves, other_halves = bodies.halves[one], bodies.halves[other]
    overlaps = np.abs(own.transpose(0, 2, 1) @ others)
    along = np.abs(away @ own)[:, 0] - halves - (overlaps @ other_halves[..., None])[..., 0]
    across = np.abs(away @ others)[:, 0] - other_halves - (halves[:, None] @ overlaps)[:, 0]
    return np.asarray(np.maximum(along.max(axis=1), across.max(axis=1)))


def _distances(one: FloatArray, other: FloatArray) -> FloatArray:
    """Distances of all points of shape (…, n, 3) from all others of shape (…, m, 3)."""
    # |a − b|² = |a|² − 2 a·b + |b|²: where that is rounded noticeably, balls overlap.
    own, others = (np.sum(x**2, axis=2, keepdims=True) for x in (one, other))
    left = np.concatenate([-2.0 * one, own, np.ones_like(own)], axis=2)
    right = np.concatenate([other, np.ones_like(others), others], axis=2)
    squares = left @ right.transpose(0, 2, 1)
    return np.asarray(np.sqrt(np.maximum(squares, 0.0, out=squares), out=squares))


def _centres(bodies: Bodies, poses: JointPoses, k: Indices, body: Indices) -> FloatArray:
    """Centres of bodies in configurations, one of each per entry, shape (n, 3)."""
    turned, places = (values[k, bodies.joints[body]] for values in poses)
    return np.asarray(places + (turned @ bodies.centres[body][:, :, None])[..., 0])


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
