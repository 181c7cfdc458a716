# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The joints of a robot that do not move, and whether it matters where they are."""

from __future__ import annotations

from collections.abc import Collection

from .joints import joints_of_links, locked_joints
from .model import Robot


def mimicking_joints(robot: Robot) -> dict[str, str]:
    """Locked joints that mimic one that moves, and that one; in the model, they are fixed."""
    moving = robot.joint_names
    return {
        name: followed
        for name, (followed, _, _) in robot.description.mimics.items()
        if followed in moving and name not in moving
    }


def mimicry(robot: Robot, joint_names: Collection[str]) -> list[str]:
    """A sentence on each of these joints that mimics one that moves."""
    return [
        f"joint '{name}' mimics '{followed}', which the primitives move, but would count as "
        f"fixed: build the primitives without '{followed}' (--joints)"
        for name, followed in mimicking_joints(robot).items()
        if name in joint_names
    ]


def carrying_joints(robot: Robot, links: Collection[str] = ()) -> tuple[str, ...]:
    """The locked joints that place joints that move, or some links."""
    full = robot.description.model
    fixed = locked_joints(full, robot.joint_names)
    placed = {*range(1, full.njoints)} - {*fixed} | {*joints_of_links(full, links)}
    return tuple(full.names[joint] for joint in fixed if placed.intersection(full.subtrees[joint]))


def relevant_joints(robot: Robot, *, pairs: bool, links: Collection[str] = ()) -> tuple[str, ...]:
    """The locked joints whose positions make a difference to the motion of the others.

    These place joints that move, or they place a mass or a collision shape that these carry.

    Parameters
    ----------
    robot : Robot
        The robot.
    pairs : bool
        Whether pairs of links are checked for collisions: then collision shapes that the base
        carries matter, too.
    links : collection of str
        Links whose poses are needed.
    """
    description, full = robot.description, robot.description.model
    shapes = [link for link in description.links if description.states(link, "collision")]
    colliding = {*joints_of_links(full, shapes)}
    heavy = {i for i in range(1, full.njoints) if full.inertias[i].mass > 0.0}
    fixed, carrying = locked_joints(full, robot.joint_names), carrying_joints(robot, links)
    relevant = []
    for joint in fixed:
        is_on_arm = not {*full.supports[joint]} <= {0, *fixed}
        matters = colliding | heavy if is_on_arm else colliding if pairs else set()
        if full.names[joint] in carrying or matters.intersection(full.subtrees[joint]):
            relevant.append(full.names[joint])
    return tuple(relevant)
