# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The pairs of a robot's links, and of links and obstacles, that may collide."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray, frozen_array
from ..exceptions import RobotError, WorldError
from ..files import read_text, reading
from ..input_limits import INPUT_LIMITS
from .bodies import Bodies
from .distances import CONTACT, BodyPairs, Indices, JointTree, NearPairs
from .model import Robot
from .urdf import parse_xml
from .world import World


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
        self._made = partial(
            type(self),
            robot,
            srdf=srdf,
            package_dirs=tuple(package_dirs),
            self_collision=self_collision,
        )
        model, order = robot.pinocchio_model()
        self._links = links = robot.link_bodies(package_dirs)
        self._tree = JointTree(model, np.argsort(order))
        excepted = robot.are_neighbours(links.names) if srdf is None else _disabled(srdf, links)
        # A pair without relative motion is not checked.
        excepted |= links.joints[:, None] == links.joints
        pairs = np.argwhere(np.triu(~excepted, 1)) if self_collision else np.zeros((0, 2), np.intp)
        if srdf is None:
            neutral = np.clip(0.0, model.lowerPositionLimit, model.upperPositionLimit)[order]
            pairs = pairs[_are_apart(self._tree, links, pairs, neutral)]
        self._pairs_of_links = [(a, b) for a, b in pairs.tolist()]
        self.margin = _checked_margin(margin)
        self.set_world(World() if world is None else world)

    def __reduce__(self) -> tuple[Any, ...]:
        # Meshes are read again where it is unpickled.
        return partial(self._made, world=self.world, margin=self.margin), ()

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

    @property
    def notes(self) -> tuple[str, ...]:
        """What is unusual about the shapes of links and obstacles, as sentences."""
        return self._links.notes + self.world.notes

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
        pairs.

        Parameters
        ----------
        q : array, shape (n_configurations, n_joints)
            Positions of the robot's joints in its order.
        """
        return bool(np.any(self.near(q, 0.0).bounds < CONTACT))

    def check(self, distances: FloatArray, *, hulls: bool = False) -> Callable[[FloatArray], bool]:
        """A function like `collides`: whether any pair is nearer than its margin and a distance.

        Parameters
        ----------
        distances : array, shape (n_pairs,)
            The distances [m].
        hulls : bool
            Whether convex hulls may take the place of meshes that move: faster, on the safe side.
        """
        return self.body_pairs.check(distances, hulls=hulls)

    def near(self, q: FloatArray, reach: float) -> NearPairs:
        """The pairs nearer than some distance beside their margins.

        Parameters
        ----------
        q : array, shape (n_configurations, n_joints)
            Positions of the robot's joints in its order.
        reach : float
            The distance [m].
        """
        return self.body_pairs.near(q, reach)


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
        distances = measured.distances(q[None], np.zeros_like(some), np.arange(len(some)))
        return some[~(distances >= CONTACT)]

    near = touching(links, np.arange(len(pairs)))
    # Hulls may touch where the meshes in their place don't.
    used, every = np.unique(pairs[near]), enumerate(zip(links.shapes, links.pieces, strict=True))
    shapes = [piece.surface if piece and i in used else shape for i, (shape, piece) in every]
    exact = replace(links, shapes=tuple(shapes), are_convex=np.zeros_like(links.are_convex))
    # All pieces of two meshes may touch if two of them do.
    both = links.numbers[pairs]
    met = set(map(tuple, both[touching(exact, near)].tolist()))
    return np.array([pair not in met for pair in map(tuple, both.tolist())], dtype=bool)


def _disabled(srdf: str | Path, links: Bodies) -> NDArray[np.bool_]:
    """Whether an SRDF file disables the collisions of each pair, shape (n_shapes, n_shapes)."""
    with reading(f"the SRDF file '{srdf}'", RobotError):
        root = parse_xml(read_text(Path(srdf)), f"the SRDF file '{srdf}'")
    pairs = {(x.get("link1"), x.get("link2")) for x in root.iter("disable_collisions")}
    either = pairs | {(b, a) for a, b in pairs}
    return np.array([[(a, b) in either for b in links.names] for a in links.names], dtype=bool)


def package_folders(given: Sequence[Path], urdf: Path | None = None) -> list[Path]:
    """Folders in which packages may be: those given, those of ROS, and those above a URDF file."""
    folders = [*given]
    folders += [Path(p) for p in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep) if p]
    prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    folders += [Path(p) / "share" for p in prefixes if p]
    return folders if urdf is None else [*folders, *urdf.resolve().parents]
