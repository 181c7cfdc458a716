# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""States by joint name, and remarks on a plan, as the planning commands print them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..arrays import FloatArray, by_name, name_values
from ..goal import JointState
from ..planning.motion import Motion
from ..planning.plan import Plan
from ..planning.remarks import remarks
from ..planning.sequence import SequencePlan

VALUES = "name=value,… or values in the robot description's joint order [rad or m]"
"""How help texts describe what :func:`joint_values` reads."""


def passed(motions: Sequence[Motion]) -> list[JointState]:
    """The start of the first of some motions, and the end of each."""
    return [motions[0].start, *(motion.goal for motion in motions)]


def passed_lines(states: Sequence[JointState], names: Sequence[str]) -> list[str]:
    """Lines of text with the start, the vias and the goal of a motion by joint name.

    Parameters
    ----------
    states : sequence of JointState
        At least two. Velocities and accelerations at the ends have lines where one is not zero.
    names : sequence of str
        Their joints, in the order to print.
    """
    labels = ["start", *(f"via {k}" for k in range(1, len(states) - 1)), "goal"]
    lines = []
    for label, state in zip(labels, states, strict=True):
        lines.append(f"{label:<12} {_named(state.positions, state, names)}")
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
