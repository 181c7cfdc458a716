# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Limits of velocity and acceleration, and pairs of links to check, by the demonstrations."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from ..arrays import FloatArray
from ..exceptions import RobotError
from ..motion.collision import CollisionModel
from ..motion.interpolation import hermite_functions
from ..primitives.primitive import MovementPrimitive
from ..primitives.timing import aligned_phases
from ..robot.distances import CONTACT
from ..robot.limits import LIMIT_KEYS, JointLimits
from ..robot.model import Robot
from ..robot.world import World

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


# Samples of a demonstration. Two of its derivatives by differences over four of them are smooth.
_N_SAMPLES = 64
# Share of the fastest joint's peak that a joint may take, however little it moved.
_LEAST_SHARE = 0.25


def demonstrated_positions(primitive: MovementPrimitive, n_samples: int) -> FloatArray:
    """Positions of the demonstrations at evenly spread times [rad or m].

    Returns
    -------
    positions : array, shape (n_demonstrations, n_samples, n_joints)
        As the components of the primitive have them.
    """
    phases = aligned_phases(primitive.warps, np.linspace(0.0, 1.0, n_samples))
    rates = primitive.durations[:, None] ** [0, 1, 2, 0, 1, 2]
    hermite = hermite_functions(phases.ravel()).reshape(*phases.shape, 6)
    shapes = map(primitive.basis.shape, primitive.weights, phases)
    boundary = hermite @ (rates[:, :, None] * primitive.boundary_states)
    return np.asarray(boundary + np.array([*shapes]))


def demonstrated_limits(
    robot: Robot, primitives: Iterable[MovementPrimitive], limits: JointLimits, margin: float
) -> tuple[JointLimits, JointLimits]:
    """Limits with those of the demonstrations.

    Parameters
    ----------
    robot : Robot
        The robot.
    primitives : iterable of MovementPrimitive
        The primitives.
    limits : JointLimits
        Limits of the robot.
    margin : float
        Factor of the demonstrated peaks.

    Returns
    -------
    careful : JointLimits
        The lower of each velocity and acceleration and of the demonstrated one times the margin.
    usual : JointLimits
        The same, but only of accelerations without a limit.
    """
    peaks = np.zeros((2, robot.n_joints))  # of velocities and accelerations [/s, /s²]
    for primitive in primitives:
        q = demonstrated_positions(primitive, _N_SAMPLES)
        steps = primitive.durations[:, None, None] / (_N_SAMPLES - 1)
        v = np.gradient(q, axis=1) / steps
        a = np.gradient(v, axis=1) / steps
        peaks = np.maximum(peaks, np.abs([v, a]).max(axis=(1, 2)))
    is_prismatic = np.isin(robot.joint_names, robot.prismatic_joints)
    for kind in (is_prismatic, ~is_prismatic):
        if kind.any():
            fastest = peaks[:, kind].max(axis=1, keepdims=True)
            peaks[:, kind] = np.maximum(peaks[:, kind], _LEAST_SHARE * fastest)
    velocity, acceleration = np.maximum(margin * peaks, 1e-6)
    free = np.isinf(limits.acceleration)
    careful = _with(limits, np.minimum(limits.velocity, velocity), acceleration)
    return careful, _with(limits, limits.velocity, np.where(free, acceleration, np.inf))


def _with(limits: JointLimits, velocity: FloatArray, acceleration: FloatArray) -> JointLimits:
    """Limits with other velocities and with accelerations that are not above some."""
    acceleration = np.minimum(limits.acceleration, acceleration)
    columns = (limits.lower, limits.upper, velocity, acceleration, limits.jerk, limits.effort)
    rows = np.transpose(columns).tolist()
    names = limits.joint_names
    given = {
        name: dict(zip(LIMIT_KEYS, row, strict=True)) for name, row in zip(names, rows, strict=True)
    }
    return JointLimits(names, given, source="limits of the demonstrations")
