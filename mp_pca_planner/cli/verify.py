# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""`verify`: a control law for a primitive, its error bound, and simulations of the bound."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import FloatArray
from ..control.closed_loop import ControlLoop, ErrorModel, verify
from ..control.law import (
    KINDS,
    STATEMENT,
    ControlLaw,
    bound_statement,
    pair_law,
    paired_law,
    verified_case,
)
from ..control.stability import Stability, analyse
from ..exceptions import ControlError
from ..primitives.file import save_primitive
from ..robot.model import Robot
from .common import check_output, progress_bar, show
from .goal_arguments import joint_values
from .options import add_report, add_request, number, whole
from .plan import PlannedRequest, plan_request
from .terminal import DONE, FAILED

_ASSUMED = ("inertia_error", "payload", "start_error", "control_period", "delay")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.description = (
        "Simulate a planned motion under a control law, and compare with the claimed error bound. "
        "The simulations include errors of the model and the start, effort limits, sampling and "
        "delay."
    )
    add_request(parser)
    parser.add_argument(
        "--trials",
        type=whole(1, 1_000_000),
        default=100,
        help="number of simulations (default: %(default)s)",
    )
    parser.add_argument(
        "--output", metavar="FILE.npz", type=Path, help="primitive to write, with this law"
    )
    add_report(parser)
    law = parser.add_argument_group("control law (default: the primitive's own, if it has one)")
    law.add_argument("--law", choices=KINDS, help=f"kind of law (default: {KINDS[0]})")
    law.add_argument(
        "--natural-frequency",
        metavar="ω",
        type=number(1e-3, 1e5),
        default=30.0,
        help="natural frequency of the error, which determines the gains [rad/s] "
        "(default: %(default)g)",
    )
    errors = parser.add_argument_group("assumed errors")
    errors.add_argument(
        "--inertia-error",
        metavar="SHARE",
        type=number(0.0, 0.999),
        default=0.05,
        help="relative error of the links' masses and principal moments of inertia, up or down "
        "(default: %(default)g)",
    )
    errors.add_argument(
        "--payload",
        type=number(0.0, 1e4),
        default=0.0,
        help="largest unknown mass at the last link that most joints move [kg]",
    )
    errors.add_argument(
        "--friction",
        help="largest Coulomb friction: one number, or name=value,… [N·m or N]",
    )
    errors.add_argument(
        "--armature",
        help="inertias of the rotors, reflected to the joints: one number, or name=value,… "
        "[kg·m² or kg]",
    )
    errors.add_argument(
        "--start-error",
        type=number(0.0, 10.0),
        default=0.001,
        help="error of each joint at the start [rad or m] (default: %(default)g)",
    )
    errors.add_argument(
        "--control-period",
        type=number(1e-5, 0.1, "s"),
        default=0.001,
        help="sampling period [s] (default: %(default)g)",
    )
    errors.add_argument(
        "--delay",
        type=whole(0, 100),
        default=1,
        help="delay from measurement to action [samples] (default: %(default)s)",
    )


def run(arguments: argparse.Namespace) -> int:
    """Run the command; returns the exit status."""
    output = arguments.output
    check_output(output, ".npz", force=arguments.force)
    request = plan_request(arguments)
    if not request.plan.is_executable:
        raise ControlError(f"there is no motion to verify: {request.plan.message}")
    robot, trajectory = request.planner.robot, request.plan.trajectory
    friction = _by_joint(arguments.friction or "0", "--friction", robot)
    armature = _by_joint(arguments.armature or "0", "--armature", robot)
    if armature.any():
        robot = robot.with_armature(armature)
    errors = ErrorModel(
        arguments.inertia_error,
        arguments.payload,
        arguments.start_error,
        friction=tuple(friction.tolist()),
    )
    law = _choose_law(arguments, request, robot)
    sampling, limits = (arguments.control_period, arguments.delay), request.planner.limits
    loop = ControlLoop(robot, law, trajectory, limits.effort, *sampling)
    stability, n = analyse(loop, errors), arguments.trials
    with progress_bar("simulations", "simulation") as progress:
        found = verify(loop, errors, stability.error_bound, n, progress=progress)
    facts: dict[str, Any] = {
        "position_gains": law.position_gains.tolist(),
        "velocity_gains": law.velocity_gains.tolist(),
        "assumed": {name: getattr(arguments, name) for name in _ASSUMED}
        | {"friction": friction.tolist()}
        | {"armature": armature.tolist() if armature.any() else None},
        **stability.summary(),
        "n_trials": n,
        "bound_held": found.bound_held,
        "saturated": found.saturated,
        "worst_error": found.errors.max(axis=0).tolist(),
        "median_error": np.median(found.errors, axis=0).tolist(),
        "holds_for": verified_case(robot, trajectory),
    }
    facts[STATEMENT] = bound_statement(robot.joint_names, facts)
    if output is not None:
        paired = pair_law(request.primitives[0], law, facts)
        save_primitive(paired, output, overwrite=arguments.force)
    content = {
        "law": law.kind,
        "joint_names": list(law.joint_names),
        "duration": trajectory.duration,
        **facts,
        "remedy": _remedy(stability) if stability.error_bound is None else None,
        "remarks": request.remarks,
        "written": output,
    }
    show(arguments, content)
    return DONE if found.bound_held == n and stability.holds else FAILED


def _by_joint(text: str, option: str, robot: Robot) -> FloatArray:
    """One number for all joints, or one for each; joints that are not named have 0."""
    if "=" not in text and len(text.replace(",", " ").split()) == 1:
        text = ",".join([text] * len(robot.described_joints))
    values = joint_values(text, robot.described_joints, option)
    if min(values.values()) < 0.0:
        raise ControlError(f"{option} must be at least 0, got {min(values.values()):g}")
    return np.array([values.get(name, 0.0) for name in robot.joint_names])


def _choose_law(arguments: argparse.Namespace, request: PlannedRequest, robot: Robot) -> ControlLaw:
    """The law of the options, the primitive's own, or one made from frequency and damping."""
    own = paired_law(request.primitives[0])
    if own is not None and arguments.law is None:
        return own
    kind, frequency = arguments.law or KINDS[0], arguments.natural_frequency
    return ControlLaw.from_frequency(kind, robot, request.plan.trajectory, frequency)


def _remedy(stability: Stability) -> str:
    """Why there is no bound, and what helps."""
    if stability.slowest_pole >= 0.0 or stability.sampled_radius >= 1.0:
        reason = "the loop is unstable; lower --natural-frequency, --control-period or --delay"
    elif stability.loop_gain >= 1.0:
        reason = "errors of the model are amplified; give less --inertia-error"
    else:
        reason = (
            "the assumed errors leave the range of the linear loop; raise --natural-frequency, or "
            "give less --friction, --start-error or --inertia-error"
        )
    rotors = "the inertias of the rotors (--armature), which light links need"
    return f"there is no bound: {reason}, or {rotors}"
