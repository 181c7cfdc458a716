# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Collisions along a trajectory, of links with each other and with obstacles.

The distances of pairs of bodies are followed along the motion that the controller executes. A pair
can't touch between two moments if the joints between its bodies move by less than the sum of its
distances there (conservative advancement: Mirtich, PhD thesis, Berkeley, 1996). Other intervals
are halved, down to a sixteenth of a millisecond. Bodies that may touch even then are in collision.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from operator import attrgetter

import numpy as np

from ..arrays import FloatArray
from ..robot.collision import CollisionGeometry
from ..robot.distances import CONTACT, BodyPairs, Indices
from .interpolation import DenseSamples, interpolate
from .trajectory import Trajectory

NOT_CHECKED = "; self-collisions were not checked: the robot has no collision geometry"
"""End of messages on robots without collision geometry."""

# Moments between two samples of 1 ms. Over that time, positions are linear to some 1e-6 rad.
_PARTS = 16


@dataclass(frozen=True)
class Collision:
    """Two bodies that collide during a motion, or come nearer than their margin.

    Attributes
    ----------
    pair : int
        Index of the pair in the model.
    links : tuple of str
        Their names.
    time : float
        When their penetration is deepest [s].
    penetration : float
        Its depth [m]; a lower bound for meshes that are not convex. With a margin, by how much the
        bodies are nearer than that.
    first_time : float
        When the collision begins [s].
    last_time : float
        When it was last found [s].
    point : tuple of float
        Where the bodies meet then, in the base frame [m].
    margin : float
        Least clearance of the pair [m].
    """

    pair: int
    links: tuple[str, str]
    time: float
    penetration: float
    first_time: float
    last_time: float
    point: tuple[float, float, float]
    margin: float = 0.0

    def within(self, began: float, ended: float) -> Collision | None:
        """The part of it between two times, with times counted from the first; None if none."""
        first, last = max(self.first_time, began), min(self.last_time, ended)
        if first > last:
            return None
        moment = min(max(self.time, first), last)
        return replace(self, time=moment - began, first_time=first - began, last_time=last - began)

    def __str__(self) -> str:
        found, depth = self._words
        return f"{found} from {self.first_time:.3f} s on (deepest at {self.time:.3f} s, {depth})"

    @property
    def at_rest(self) -> str:
        """Text on the collision of a robot that does not move."""
        found, depth = self._words
        return f"{found}{' ' if self.penetration >= self.margin else ', '}{depth}"

    @property
    def _words(self) -> tuple[str, str]:
        """Texts: what is wrong with the two bodies, and how deep and where."""
        found, apart = f"'{self.links[0]}' and '{self.links[1]}'", self.margin - self.penetration
        x, y, z = self.point
        where = f"near ({x:.3f}, {y:.3f}, {z:.3f}) m"
        if apart <= 0.0:
            return f"{found} collide", f"by {-1e3 * apart + 0.0:.1f} mm, {where}"
        found += f" are nearer than the margin of {1e3 * self.margin:.3g} mm"
        return found, f"{1e3 * apart:.1f} mm apart, {where}"


class CollisionModel(CollisionGeometry):
    """Collisions of a robot's motions."""

    def collisions(
        self, trajectory: Trajectory, *, precisely: bool = True
    ) -> tuple[Collision, ...]:
        """The collisions of a motion, one of each pair that has any, the deepest first.

        Parameters
        ----------
        trajectory : Trajectory
            The motion, of the robot's joints in its order.
        precisely : bool
            Whether to find all of them, their deepest points and times to a millisecond. If
            false, those at the moments that are checked first are enough, if there are any.
        """
        if not self.pairs:
            return ()
        dense = interpolate(trajectory)
        speeds = np.abs(dense.v)
        displacements = np.maximum(speeds[1:], speeds[:-1]) * np.diff(dense.times)[:, None]
        # Distance that each joint has travelled up to each moment.
        travelled = np.concatenate(
            [np.zeros((1, displacements.shape[1])), np.cumsum(displacements, axis=0)]
        )
        met = _moments_in_collision(self, dense.q, travelled, precisely)
        found = [self._collision(dense, k, moments) for k, moments in met.items()]
        return tuple(sorted(found, key=attrgetter("penetration"), reverse=True))

    def _collision(
        self, dense: DenseSamples, pair: int, moments: list[tuple[float, int]]
    ) -> Collision:
        distance, deepest = min(moments)
        numbers = np.array([deepest, *(moment for _, moment in moments)])
        times = _between(dense.times, numbers)
        return Collision(
            pair,
            self.pairs[pair],
            float(times[0]),
            max(0.0, -distance),
            float(times.min()),
            float(times.max()),
            tuple(self.body_pairs.nearest_point(_between(dense.q, numbers)[0], pair).tolist()),
            float(self.margins[pair]),
        )


def _between(values: FloatArray, moments: Indices) -> FloatArray:
    """Values at moments, by linear interpolation between samples."""
    before, part = np.divmod(moments, _PARTS)
    after = np.minimum(before + 1, len(values) - 1)
    shares = (part / _PARTS).reshape(-1, *(1,) * (values.ndim - 1))
    return np.asarray(values[before] + shares * (values[after] - values[before]))


def _moments_in_collision(
    model: CollisionModel, q: FloatArray, travelled: FloatArray, precisely: bool
) -> dict[int, list[tuple[float, int]]]:
    """Search for collisions along a motion, by halving the intervals that may have one.

    Moments are counted in parts of the time between two samples.

    Parameters
    ----------
    model : CollisionModel
        Computes the distances.
    q, travelled : array, shape (n_samples, n_joints)
        The motion, and the distances that the joints have travelled.
    precisely : bool
        See :meth:`CollisionModel.collisions`.

    Returns
    -------
    found : dict
        Distances and moments of collisions by pair, with the first, last and deepest one.
    """
    bodies, n_pairs = model.body_pairs, len(model.pairs)
    deepest = np.full(n_pairs, np.inf)
    found: dict[int, list[tuple[float, int]]] = {}

    def largest_approach(pairs: Indices, first: Indices, last: Indices) -> FloatArray:
        moved = _between(travelled, last) - _between(travelled, first)
        return np.asarray(np.einsum("ej,ej->e", moved, bodies.levers[pairs]))

    def distances_at(moments: Indices, pairs: Indices) -> FloatArray:
        every, places = np.unique(moments, return_inverse=True)
        distances = bodies.distances(_between(q, every), places, pairs)
        for e in np.flatnonzero(~(distances >= CONTACT)):  # a NaN is a collision
            noted = found.setdefault(int(pairs[e]), [])
            noted.append((float(distances[e]), int(moments[e])))
        np.fmin.at(deepest, pairs, distances)
        return distances

    pairs, first, last = _doubtful(bodies, q, travelled)
    closed = largest_approach(pairs, first, last)
    both = np.concatenate([first, last]) * n_pairs + np.tile(pairs, 2)
    every, places = np.unique(both, return_inverse=True)
    ends = distances_at(*np.divmod(every, n_pairs))[places].reshape(2, -1)
    if found and not precisely:
        return found
    doubtful: dict[int, list[tuple[float, int]]] = {}
    while True:
        # A distance within an interval is at least half of this.
        least = ends.sum(axis=0) - closed
        # Between two collisions, only the deepest one matters.
        collide = ends < CONTACT
        both = collide.all(axis=0) & (0.5 * least > deepest[pairs] - CONTACT)
        # A collision that is known is timed to a sample.
        is_done = both | (last - first <= np.where(collide.any(axis=0), _PARTS, 1))
        is_clear = least > 2.0 * CONTACT
        for e in np.flatnonzero(~is_clear & (last - first <= 1)):
            doubtful.setdefault(int(pairs[e]), []).append((0.0, int(first[e])))
        if (is_done | is_clear).all():
            return doubtful | found
        kept = np.flatnonzero(~(is_done | is_clear))
        pairs, first, last, ends = pairs[kept], first[kept], last[kept], ends[:, kept]
        middle = (first + last) // 2
        middle -= np.where(last - first > _PARTS, middle % _PARTS, 0)
        between = distances_at(middle, pairs)
        pairs = np.tile(pairs, 2)
        first, last = np.concatenate([first, middle]), np.concatenate([middle, last])
        ends = np.block([[ends[0], between], [between, ends[1]]])
        closed = largest_approach(pairs, first, last)


def _doubtful(
    bodies: BodyPairs, q: FloatArray, travelled: FloatArray
) -> tuple[Indices, Indices, Indices]:
    """Pairs and intervals that bounds of the distances don't clear."""
    # Every 32 ms are checked first; a single point is an interval of its own.
    n = len(q)
    grid = np.linspace(0, n - 1, max(2, -(-n // 32))).astype(np.intp)
    closed = np.diff(travelled[grid], axis=0) @ bodies.levers.T
    pad = np.zeros((1, closed.shape[1]))
    bounds = bodies.bounds(q[grid], np.maximum(np.vstack([closed, pad]), np.vstack([pad, closed])))
    interval, pairs = np.nonzero(~(bounds[:-1] + bounds[1:] - closed > 2.0 * CONTACT))
    return pairs, _PARTS * grid[interval], _PARTS * grid[interval + 1]
