# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Collisions along a trajectory, of links with each other and with obstacles.

The distances of pairs of bodies are followed along the motion that the controller executes. A pair
can't touch between two moments if the joints between its bodies move by less than the sum of its
distances there (conservative advancement: Mirtich, PhD thesis, Berkeley, 1996). Other intervals
are halved, down to a sixteenth of a millisecond. Bodies that may touch even then are in collision.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray, frozen_array
from ..exceptions import RobotError, WorldError
from ..files import read_text, reading
from ..input_limits import INPUT_LIMITS
from ..robot.bodies import Bodies
from ..robot.distances import CONTACT, BodyPairs, Indices, JointPoses, JointTree, NearPairs
from ..robot.joints import joints_of_links
from ..robot.model import Robot
from ..robot.urdf import parse_xml
from ..robot.world import World
from .interpolation import (
    GRID_PERIOD,
    DenseSamples,
    curve_bounds,
    interpolate,
    interpolate_at,
    parts_of_segments,
    segment_ends,
)
from .trajectory import Trajectory

_Doubtful = tuple[Indices, Indices, Indices, FloatArray]
"""Pairs, first and last moments of intervals, and the distances there, shape (2, n)."""

# Moments between two samples of 1 ms. Over that time, positions are linear to some 1e-6 rad.
_PARTS = 16
# Precision of the least clearance of a motion [m], and distances that are measured at once.
_PRECISION, _AT_ONCE, _N_FIRST = 1e-4, 16, 64


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


class CollisionModel:
    """The pairs of bodies that may collide, links and obstacles, and their collisions.

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
    body_pairs : BodyPairs
        The distances of the pairs.
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
        model, order = robot.pinocchio_model()
        self._links = links = robot.link_bodies(package_dirs)
        self._tree = JointTree(model, np.argsort(order))
        excepted = _are_neighbours(robot, links.names) if srdf is None else _disabled(srdf, links)
        # A pair without relative motion is not checked.
        excepted |= links.joints[:, None] == links.joints
        pairs = np.argwhere(np.triu(~excepted, 1)) if self_collision else np.zeros((0, 2), np.intp)
        if srdf is None:
            neutral = np.clip(0.0, model.lowerPositionLimit, model.upperPositionLimit)[order]
            pairs = pairs[_are_apart(self._tree, links, pairs, neutral)]
        self._pairs_of_links = [(a, b) for a, b in pairs.tolist()]
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
        pairs = [*self._pairs_of_links, *further]
        if world.allowed:
            pairs = [(a, b) for a, b in pairs if not world.allows(names[a], names[b])]
        indices = np.array(pairs, dtype=np.intp).reshape(-1, 2)
        margins = np.where(indices[:, 1] >= n_links, margin, 0.0)
        self.body_pairs = BodyPairs(self._tree, bodies, indices, margins)
        self.world, self.margin, self.margins = world, margin, margins
        self.pairs = tuple((names[a], names[b]) for a, b in pairs)

    def with_world(self, world: World) -> Self:
        """The same among other obstacles, for use in another thread.

        Raises
        ------
        WorldError
            See the class.
        """
        other = object.__new__(type(self))
        vars(other).update(vars(self))
        other.set_world(world)
        return other

    def drop_pairs(self, pairs: Collection[tuple[str, str]]) -> None:
        """Check some of the `pairs` of links no longer."""
        names = self._links.names
        self._pairs_of_links = [
            (a, b) for a, b in self._pairs_of_links if (names[a], names[b]) not in pairs
        ]
        self.set_world(self.world)

    @property
    def has_geometry(self) -> bool:
        """Whether there is any collision geometry of links at all."""
        return bool(self._links.names)

    @property
    def checks_links(self) -> bool:
        """Whether links are checked for collisions with each other."""
        return bool(self._pairs_of_links)

    def collides(self, q: FloatArray) -> bool:
        """Whether any pair is in collision in a configuration.

        Parameters
        ----------
        q : array, shape (n_joints,)
            Positions of the robot's joints in its order.
        """
        return self.body_pairs.collide(q)

    def collide_anywhere(self, q: FloatArray) -> bool:
        """Whether any pair is in collision in any of some configurations.

        In a new world this is faster than the first call of `collides`, which makes data of all
        pairs; of links alone, these are made once.

        Parameters
        ----------
        q : array, shape (n_configurations, n_joints)
            Positions of the robot's joints in its order.
        """
        if not len(self.world):
            return any(map(self.collides, q))
        poses = self.body_pairs.poses(q)
        entries = np.nonzero(~(self.body_pairs.bounds(poses, CONTACT) > CONTACT))
        return bool(np.any(~(self.body_pairs.distances(poses, *entries) >= CONTACT)))

    def near(self, q: FloatArray, reach: float, before: NearPairs | None = None) -> NearPairs:
        """The pairs nearer than some distance beside their margins.

        Parameters
        ----------
        q : array, shape (n_configurations, n_joints)
            Positions of the robot's joints in its order.
        reach : float
            The distance [m].
        before : NearPairs, optional
            The pairs in as many configurations nearby, which spare distances here.
        """
        return self.body_pairs.near(q, reach, before)

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
        doubtful = _doubtful(self.body_pairs, trajectory)
        if not doubtful[0].size:
            return ()
        dense = interpolate(trajectory)
        speeds = np.abs(dense.v)
        displacements = np.maximum(speeds[1:], speeds[:-1]) * np.diff(dense.times)[:, None]
        # Distance that each joint has travelled up to each moment.
        travelled = np.concatenate(
            [np.zeros((1, displacements.shape[1])), np.cumsum(displacements, axis=0)]
        )
        met = _moments_in_collision(self, dense.q, travelled, doubtful, precisely)
        found = [self._collision(dense, k, moments) for k, moments in met.items()]
        return tuple(sorted(found, key=attrgetter("penetration"), reverse=True))

    def clearance(self, trajectory: Trajectory, reach: float) -> tuple[float, str] | None:
        """The least distance of a motion from an obstacle [m], whose name follows it.

        Intervals in which a pair may come nearer are halved, down to 4 ms. The result is a lower
        bound, at most 0.1 mm too small; 0 in a collision.

        Parameters
        ----------
        trajectory : Trajectory
            The motion, of the robot's joints in its order.
        reach : float
            Largest distance of interest [m]; without any up to this, the result is None.
        """
        bodies, obstacles = self.body_pairs, frozenset(self.world.names)
        are_near = np.full(len(self.pairs), -np.inf)
        are_near[[one[1] in obstacles for one in self.pairs]] = reach
        n, at = _samples(trajectory)
        grid = np.linspace(0, n - 1, _N_FIRST).astype(np.intp)
        q, travelled = at(grid)
        poses = bodies.poses(q)
        bounds = bodies.bounds(poses, are_near)
        moments, pairs = np.nonzero(bounds <= are_near)
        least, found = reach, None

        def measured(poses: JointPoses, moments: Indices, pairs: Indices) -> FloatArray:
            nonlocal least, found
            distances = bodies.nearest(poses, moments, pairs)
            if distances.min(initial=np.inf) <= least:
                least, found = float(distances.min()), int(pairs[distances.argmin()])
            return distances

        # The least distances at a few moments decide which bounds of the others matter.
        order = np.argsort(bounds[moments, pairs])
        for chosen in np.split(order, range(_AT_ONCE, order.size, _AT_ONCE)):
            moments_now, pairs_now = moments[chosen], pairs[chosen]
            if not chosen.size or bounds[moments_now[0], pairs_now[0]] > least:
                break
            bounds[moments_now, pairs_now] = measured(poses, moments_now, pairs_now)
        # Of each interval and pair: the samples at its ends, distances or bounds there, and what
        # the joints have travelled by then.
        closed = np.diff(travelled, axis=0) @ bodies.levers.T
        interval, pairs = np.nonzero(bounds[:-1] + bounds[1:] - closed <= 2.0 * are_near)
        sides = np.array([interval, interval + 1])
        samples, ends, moved = grid[sides], bounds[sides, pairs], travelled[sides]
        while True:
            closed = np.einsum("ej,ej->e", moved[1] - moved[0], bodies.levers[pairs])
            kept = ends.sum(axis=0) - closed < 2.0 * (least - _PRECISION)
            kept &= samples[1] - samples[0] > 4
            if not kept.any():
                if found is None:
                    return None
                distance = float(least - _PRECISION + self.margins[found])
                return max(distance, 0.0), self.pairs[found][1]
            pairs, samples = pairs[kept], samples[:, kept]
            ends, moved = ends[:, kept], moved[:, kept]
            middle = samples.sum(axis=0) // 2
            every, places = np.unique(middle, return_inverse=True)
            q, travelled = at(every)
            between = middle, measured(bodies.poses(q), places, pairs), travelled[places]
            samples, ends, moved = (
                np.stack([np.concatenate([old[0], new]), np.concatenate([new, old[1]])])
                for old, new in zip((samples, ends, moved), between, strict=True)
            )
            pairs = np.tile(pairs, 2)

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


def _checked_margin(margin: float) -> float:
    value = float(frozen_array(margin, (), "margin of the clearance", WorldError))
    most = INPUT_LIMITS.world_length
    if not 0.0 <= value <= most:
        raise WorldError(f"margin of the clearance must be from 0 to {most:g} m, got {value}")
    return value


def _pairs_with_world(bodies: Bodies, n_links: int, world: World) -> Iterator[tuple[int, int]]:
    """The pairs of a link, or an obstacle on a link, with an obstacle that moves relative to it."""
    by_name = {obstacle.name: obstacle for obstacle in world}
    obstacles = [by_name[name] for name in bodies.names[n_links:]]
    for i, obstacle in enumerate(obstacles):
        b = n_links + i
        excepted = {obstacle.name, obstacle.frame, *obstacle.touch_links}
        for a in np.flatnonzero(bodies.joints[:b] != bodies.joints[b]).tolist():
            other = obstacles[a - n_links].touch_links if a >= n_links else ()
            if bodies.names[a] not in excepted and obstacle.name not in other:
                yield a, b


def _are_apart(tree: JointTree, links: Bodies, pairs: Indices, q: FloatArray) -> NDArray[np.bool_]:
    """Whether each pair is of shapes that don't touch in a configuration."""

    def touching(bodies: Bodies, some: Indices) -> Indices:
        measured = BodyPairs(tree, bodies, pairs[some], np.zeros(len(some)))
        at = measured.poses(q[None]), np.zeros_like(some), np.arange(len(some))
        distances = measured.distances(*at)
        return some[~(distances >= CONTACT)]

    near = touching(links, np.arange(len(pairs)))
    # Hulls may touch where the meshes in their place don't.
    used = np.unique(pairs[near])
    meshes = [
        body._replace(shape=body.mesh.surface) if body.mesh and i in used else body
        for i, body in enumerate(links.parts)
    ]
    exact = Bodies(links.model, meshes)
    are_apart = np.ones(len(pairs), dtype=bool)
    are_apart[touching(exact, near)] = False
    return are_apart


def _are_neighbours(robot: Robot, links: Sequence[str]) -> NDArray[np.bool_]:
    """Whether at most one joint is between two links, locked ones included, for each two."""
    full = robot.description.model
    joints = np.array(joints_of_links(full, links), dtype=np.intp)
    above, moved = np.array(full.parents, dtype=np.intp)[joints], joints[:, None]
    return np.asarray((moved == joints) | (moved == above) | (above[:, None] == joints))


def _disabled(srdf: str | Path, links: Bodies) -> NDArray[np.bool_]:
    """Whether an SRDF file disables the collisions of each pair, shape (n_shapes, n_shapes)."""
    with reading(f"the SRDF file '{srdf}'", RobotError):
        root = parse_xml(read_text(Path(srdf)), f"the SRDF file '{srdf}'")
    pairs = {(x.get("link1"), x.get("link2")) for x in root.iter("disable_collisions")}
    either = pairs | {(b, a) for a, b in pairs}
    return np.array([[(a, b) in either for b in links.names] for a in links.names], dtype=bool)


def _between(values: FloatArray, moments: Indices) -> FloatArray:
    """Values at moments, by linear interpolation between samples."""
    before, part = np.divmod(moments, _PARTS)
    after = np.minimum(before + 1, len(values) - 1)
    shares = (part / _PARTS).reshape(-1, *(1,) * (values.ndim - 1))
    return np.asarray(values[before] + shares * (values[after] - values[before]))


def _moments_in_collision(
    model: CollisionModel,
    q: FloatArray,
    travelled: FloatArray,
    doubtful: _Doubtful,
    precisely: bool,
) -> dict[int, list[tuple[float, int]]]:
    """Search for collisions along a motion, by halving the intervals that may have one.

    Moments are counted in parts of the time between two samples.

    Parameters
    ----------
    model : CollisionModel
        Computes the distances.
    q, travelled : array, shape (n_samples, n_joints)
        The motion, and the distances that the joints have travelled.
    doubtful : tuple of array
        See :func:`_doubtful`.
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

    def largest_approach(
        pairs: Indices, first: Indices, last: Indices, ends: FloatArray
    ) -> FloatArray:
        moved = _between(travelled, last) - _between(travelled, first)
        return bodies.approaches(pairs, moved, ends.max(axis=0))

    def note(moments: Indices, pairs: Indices, distances: FloatArray) -> None:
        for e in np.flatnonzero(~(distances >= CONTACT)):  # a NaN is a collision
            noted = found.setdefault(int(pairs[e]), [])
            noted.append((float(distances[e]), int(moments[e])))
        np.fmin.at(deepest, pairs, distances)

    pairs, first, last, ends = doubtful
    closed = largest_approach(pairs, first, last, ends)
    every, places = np.unique(_at_ends(first, last, pairs, n_pairs), return_index=True)
    note(*np.divmod(every, n_pairs), ends.ravel()[places])
    if found and not precisely:
        return found
    uncertain: dict[int, list[tuple[float, int]]] = {}
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
            uncertain.setdefault(int(pairs[e]), []).append((0.0, int(first[e])))
        if (is_done | is_clear).all():
            return uncertain | found
        kept = np.flatnonzero(~(is_done | is_clear))
        pairs, first, last, ends = pairs[kept], first[kept], last[kept], ends[:, kept]
        middle = (first + last) // 2
        middle -= np.where(last - first > _PARTS, middle % _PARTS, 0)
        every, places = np.unique(middle, return_inverse=True)
        between = bodies.distances(bodies.poses(_between(q, every)), places, pairs)
        note(middle, pairs, between)
        pairs = np.tile(pairs, 2)
        first, last = np.concatenate([first, middle]), np.concatenate([middle, last])
        ends = np.block([[ends[0], between], [between, ends[1]]])
        closed = largest_approach(pairs, first, last, ends)


def _at_ends(first: Indices, last: Indices, pairs: Indices, n_pairs: int) -> Indices:
    """A number for each pair at each end of its interval."""
    return np.concatenate([first, last]) * n_pairs + np.tile(pairs, 2)


_At = Callable[[Indices], tuple[FloatArray, FloatArray]]


def _samples(trajectory: Trajectory) -> tuple[int, _At]:
    """The number of the samples of :func:`interpolate`, and a function that returns some of them.

    It returns positions, and how far each joint has travelled by then at most, both of shape
    (n_samples, n_joints) [rad or m].
    """
    times, steps = trajectory.times, np.diff(trajectory.times)
    if not steps.size:  # a single point
        q = trajectory.positions
        return 1, lambda samples: (q[samples], np.zeros((len(samples), trajectory.n_joints)))
    ends = segment_ends(times, *trajectory.states)
    displacements = curve_bounds(ends, steps)[1][1] * steps[:, None]
    before = np.cumsum(displacements, axis=0) - displacements
    n_parts = parts_of_segments(steps, GRID_PERIOD)

    def at(samples: Indices) -> tuple[FloatArray, FloatArray]:
        segment, part = np.divmod(samples, n_parts + 1)
        share = part / n_parts
        q, _, _ = interpolate_at(times[segment] + share * steps[segment], times, ends)
        return q, before[segment] + share[:, None] * displacements[segment]

    return steps.size * (n_parts + 1), at


def _doubtful(bodies: BodyPairs, trajectory: Trajectory) -> _Doubtful:
    """The pairs and intervals that distances at the ends of intervals don't clear."""
    n_pairs, (n, at) = len(bodies.margins), _samples(trajectory)
    grid = np.linspace(0, n - 1, max(2, -(-n // 32))).astype(np.intp)  # every 32nd
    q, travelled = at(grid)
    moved = np.diff(travelled, axis=0)
    closed, pad = moved @ bodies.levers.T, np.zeros((1, n_pairs))
    enough = np.maximum(np.vstack([closed, pad]), np.vstack([pad, closed]))
    poses = bodies.poses(q)
    bounds = bodies.bounds(poses, enough)
    interval, pairs = np.nonzero(~(bounds[:-1] + bounds[1:] - closed > 2.0 * CONTACT))

    def in_doubt(ends: FloatArray) -> NDArray[np.bool_]:
        closed = bodies.approaches(pairs, moved[interval], ends.max(axis=0))
        return np.asarray(~(ends.sum(axis=0) - closed > 2.0 * CONTACT))

    kept = in_doubt(np.array([bounds[interval, pairs], bounds[interval + 1, pairs]]))
    interval, pairs = interval[kept], pairs[kept]
    if not interval.size:
        return pairs, pairs, pairs, np.zeros((2, 0))
    every, places = np.unique(_at_ends(interval, interval + 1, pairs, n_pairs), return_inverse=True)
    distances = bodies.distances(poses, *np.divmod(every, n_pairs))[places].reshape(2, -1)
    kept = in_doubt(distances)
    interval, pairs = interval[kept], pairs[kept]
    return pairs, _PARTS * grid[interval], _PARTS * grid[interval + 1], distances[:, kept]
