# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The collision model of a robot that moves as its demonstrations do."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from ..exceptions import RobotError
from ..motion.collision import CollisionModel
from ..primitives.primitive import MovementPrimitive
from ..robot.distances import CONTACT
from ..robot.model import Robot
from ..robot.world import World
from .demonstrated import demonstrated_positions

NO_SHAPES = "self-collision is not checked: the robot description has no collision geometry"

# Moments of each demonstration at which links are checked, and demonstrations of each primitive at
# most.
_N_MOMENTS, _MAX_DEMONSTRATIONS = 9, 100


def robot_collision(
    robot: Robot,
    primitives: Iterable[MovementPrimitive],
    *,
    self_collision: bool = True,
    srdf: str | Path | None = None,
    package_dirs: Sequence[Path] = (),
    world: World | None = None,
    margin: float = 0.0,
) -> tuple[CollisionModel | None, tuple[str, ...]]:
    """The collision model of a robot, without the pairs of links that collide in demonstrations.

    Demonstrations were executed, so shapes that overlap there are larger than their links. An SRDF
    file takes the place of this rule.

    Parameters
    ----------
    robot : Robot
        The robot.
    primitives : iterable of MovementPrimitive
        With the demonstrations.
    self_collision, srdf, package_dirs, world, margin
        See :class:`.CollisionModel`.

    Returns
    -------
    model : CollisionModel or None
        None if neither links nor obstacles are checked.
    remarks : tuple of str
        What is not checked, against expectation.

    Raises
    ------
    RobotError
        If there are obstacles, and no collision geometry, or geometry that can't be read; if the
        SRDF file can't be read.
    WorldError
        See :class:`.CollisionModel`.
    """
    if not self_collision and world is None:
        return None, ()
    world = World() if world is None else world
    try:
        model = CollisionModel(
            robot, srdf=srdf, package_dirs=package_dirs, self_collision=self_collision
        )
    except RobotError as error:
        if len(world) or srdf is not None:
            raise
        return None, (f"self-collision is not checked: {error}",) if self_collision else ()
    if not model.has_geometry:
        if len(world):
            raise RobotError(
                "obstacles can't be avoided: the robot description has no collision geometry; add "
                "<collision> to its links, or remove the obstacles"
            )
        return None, (NO_SHAPES,) if self_collision else ()
    remarks: tuple[str, ...] = ()
    if self_collision and srdf is None and (dropped := _colliding(model, primitives)):
        model.drop_pairs(dropped)
        listed = ", ".join(f"'{a}' and '{b}'" for a, b in dropped)
        remarks = (
            f"collisions of {listed} are not checked: their shapes collide in the demonstrations",
        )
    model.set_world(world, margin)
    return model, remarks


def _colliding(
    model: CollisionModel, primitives: Iterable[MovementPrimitive]
) -> list[tuple[str, str]]:
    """The pairs of links whose shapes collide in a demonstration."""
    found = set[int]()
    for primitive in primitives:
        q = demonstrated_positions(primitive, _N_MOMENTS)
        q = q[:: -(-len(q) // _MAX_DEMONSTRATIONS)].reshape(-1, q.shape[2])
        near = model.near(q, 0.0)
        found.update(np.unique(near.pairs[~(near.distances >= CONTACT)]).tolist())
    return list(dict.fromkeys(model.pairs[pair] for pair in sorted(found)))
