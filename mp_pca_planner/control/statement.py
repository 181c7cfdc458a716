# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Sentences on the control law of a primitive: its error bound and the motion it holds for."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ..arrays import by_name, name_values
from ..exceptions import PrimitiveFileError
from ..motion.trajectory import Trajectory
from ..primitives.primitive import MovementPrimitive
from ..robot.model import Robot
from .law import known_stability, paired_law

NO_LAW = "none; run verify to pair one with this primitive"


def verified_case(robot: Robot, trajectory: Trajectory) -> dict[str, Any]:
    """The motion and the robot of an error bound, of JSON types."""
    names, positions = trajectory.joint_names, trajectory.positions
    return {
        "start": by_name(names, positions[0]),
        "goal": by_name(names, positions[-1]),
        "duration": trajectory.duration,
        "robot": robot.name,
    }


def control_statement(primitive: MovementPrimitive) -> str:
    """Sentences on the control law of a primitive, also on one that can't be read."""
    try:
        law = paired_law(primitive)
        if law is None:
            return NO_LAW
        known = known_stability(primitive)
        if known is None:
            return f"{law.kind}; no error bound: verify has not been run for this primitive"
        if "holds_for" not in known:
            return f"{law.kind}; the error bound is void: it names no motion, run verify again"
        return f"{law.kind}; {_bound(primitive, known)}"
    except (PrimitiveFileError, KeyError, TypeError, ValueError, AttributeError) as error:
        return f"unusable: {error!r:.200}; run verify again"


def _bound(primitive: MovementPrimitive, known: Mapping[str, Any]) -> str:
    names = primitive.joint_names
    if not known["bound_holds"]:
        verdict = "no error bound"
    else:
        bound = dict(zip(names, known["error_bound"], strict=True))
        verdict = f"errors stay within {name_values(bound)} rad or m"
    case, assumed = known["holds_for"], known["assumed"]
    # Names are in alphabetical order in files.
    start, goal = ({name: case[end][name] for name in names} for end in ("start", "goal"))
    return (
        f"{verdict} on the motion from {name_values(start)} to {name_values(goal)} in "
        f"{case['duration']:.6g} s of robot '{case['robot']}', if each mass and moment of inertia "
        f"is within {100.0 * assumed['inertia_error']:g} %, the payload within "
        f"{assumed['payload']:g} kg, the start within {assumed['start_error']:g} rad or m, the "
        f"control period {1e3 * assumed['control_period']:g} ms, and the delay "
        f"{assumed['delay']} samples"
    )
