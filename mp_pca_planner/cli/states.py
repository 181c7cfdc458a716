# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""States by joint name, and remarks on a plan, as the planning commands print them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..arrays import FloatArray, by_name, name_values
from ..motion.collision import CollisionModel
from ..motion.goal import JointState
from ..motion.trajectory import Trajectory
from ..planning.motion import Motion
from ..planning.plan import INFEASIBLE, STOPPED_EARLY, Plan
from ..planning.remarks import remarks
from ..planning.sequence import SequencePlan

VALUES = "name=value,… or values in the robot description's joint order [rad or m]"
"""How help texts describe what :func:`joint_values` reads."""


def passed(motions: Sequence[Motion]) -> list[JointState]:
    """The start of the first of some motions, and the end of each."""
    return [motions[0].start, *(motion.goal for motion in motions)]


def status_line(plan: Plan | SequencePlan) -> str:
    """The status of a plan, what that means for the motion, and the plan's own sentence."""
    meaning = {
        STOPPED_EARLY: " (the motion may be executed, but is not optimal)",
        INFEASIBLE: " (the motion must not be executed)",
    }
    return f"{plan.status}{meaning.get(plan.status, '')}: {plan.message}"


def effort_words(effort: float, expected: float = math.nan) -> str:
    """An effort, beside that of the expected motion; either may be unknown."""
    if math.isnan(effort):
        return "unknown: the robot description lacks inertias"
    beside = "" if math.isnan(expected) else f" (expected motion: {expected:.4g})"
    return f"{effort:.4g} N²m²s{beside}"


def collision_words(collision: CollisionModel, trajectory: Trajectory) -> str:
    """What a check of a motion for self-collisions finds."""
    if not collision.has_geometry:
        return "not checked: the robot description has no collision geometry"
    found = collision.collisions(trajectory)
    if not found:
        return f"none; {len(collision.pairs)} pairs of links were checked"
    more = f", and {len(found) - 1} more pairs of links collide" if len(found) > 1 else ""
    return f"{found[0]}{more}"


def collision_facts(collision: CollisionModel | None, trajectory: Trajectory) -> dict[str, str]:
    """What a check for self-collisions found, if there was one."""
    return {} if collision is None else {"collision": collision_words(collision, trajectory)}


def collision_lines(facts: Mapping[str, Any]) -> list[str]:
    """The line of text on self-collisions, if they were checked."""
    return [f"collision    {facts['collision']}"] if "collision" in facts else []


def passed_lines(
    states: Sequence[JointState], names: Sequence[str], asked: Sequence[str] = ()
) -> list[str]:
    """Lines of text with the start, the vias and the goal of a motion by joint name.

    Parameters
    ----------
    states : sequence of JointState
        At least two. Velocities and accelerations at the ends have lines where one is not zero.
    names : sequence of str
        Their joints, in the order to print.
    asked : sequence of str
        What was asked for after the start, as options say it. A pose is printed beside the
        configuration that reaches it.
    """
    labels = ["start", *(f"via {k}" for k in range(1, len(states) - 1)), "goal"]
    poses = [f" (for the pose {text})" if ":" in text else "" for text in asked]
    poses = ["", *(poses or [""] * (len(states) - 1))]
    lines = []
    for label, state, pose in zip(labels, states, poses, strict=True):
        lines.append(f"{label:<12} {_named(state.positions, state, names)}{pose}")
        for rate in ("velocities", "accelerations") if label in ("start", "goal") else ():
            values = getattr(state, rate)
            if np.any(values):
                lines.append(f"{'':<12} {rate} {_named(values, state, names)}")
    return lines


def _named(values: FloatArray, state: JointState, names: Sequence[str]) -> str:
    found = by_name(state.joint_names, values)
    return name_values({name: found[name] for name in names})


def remark_lines(plan: Plan | SequencePlan) -> list[str]:
    """Lines of text with what is unusual about a plan, beside its status."""
    return [f"remark       {remark}" for remark in remarks(plan) if remark != plan.message]


def states_by_name(states: Sequence[JointState]) -> dict[str, Any]:
    """Start, goal and the states between them by joint name, for JSON reports."""
    start, *vias, goal = [by_name(state.joint_names, state.positions) for state in states]
    return {"start": start, "goal": goal} | ({"vias": vias} if vias else {})
