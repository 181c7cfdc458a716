# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""`verify`: a control law for a primitive, its error bound, and simulations of the bound."""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np

from ..arrays import FloatArray, text_table
from ..control.closed_loop import ControlLoop, ErrorModel, Verification, verify
from ..control.law import (
    KINDS,
    STATEMENT,
    ControlLaw,
    bound_statement,
    excluded,
    pair_law,
    paired_law,
    verified_case,
)
from ..control.stability import Stability, analyse
from ..exceptions import ControlError
from ..primitives.file import save_primitive
from ..robot.model import Robot
from .common import check_output, progress_bar, report
from .goal_arguments import joint_values
from .plan import PlannedRequest, plan_request
from .terminal import DONE, FAILED, written_lines

_ASSUMED = ("inertia_error", "payload", "start_error", "control_period", "delay")


def run(arguments: argparse.Namespace) -> int:
    """Run the command; returns the exit status."""
    output = arguments.output
    check_output(output, ".npz", force=arguments.force)
    request = plan_request(arguments)
    if not request.plan.is_executable:
        raise ControlError(f"there is no motion to verify: {request.plan.message}")
    robot, trajectory = request.planner.robot, request.plan.trajectory
    friction = robot.described_friction
    if arguments.friction is not None:
        friction = _by_joint(arguments.friction, "--friction", robot)
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
    lines = [
        *request.lines(),
        f"duration     {trajectory.duration:.3f} s, of robot '{robot.name}'",
        *_lines(robot, law, stability, found),
        f"not included  {excluded(facts['assumed'])}",
    ]
    content = facts | {"law": law.kind, "joint_names": list(law.joint_names)}
    report(arguments, content, *lines, *written_lines([output]))
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


def _lines(robot: Robot, law: ControlLaw, stability: Stability, found: Verification) -> list[str]:
    n, bound = len(found.errors), stability.error_bound
    rows = [
        [
            name,
            f"{law.position_gains[j]:.4g}",
            f"{law.velocity_gains[j]:.4g}",
            "none" if bound is None else f"{1e3 * bound[:, j].max():.3g}",
            f"{1e3 * found.errors[:, j].max():.3g}",
            f"{1e3 * np.median(found.errors[:, j]):.3g}",
        ]
        for name in robot.described_joints
        for j in [law.joint_names.index(name)]
    ]
    header = ["joint", "Kp", "Kd", "bound [mrad]", "worst [mrad]", "median [mrad]"]
    held = f"held in {found.bound_held} of {n} simulations"
    return [
        f"law           {law.kind}",
        f"poles         slowest {stability.slowest_pole:.3g} 1/s, least damping ratio "
        f"{stability.least_damping:.3g}, sampled radius {stability.sampled_radius:.4f}",
        f"loop gain     {stability.loop_gain:.3g} (of the model's errors; below 1: stable)",
        f"effort left   {100 * stability.effort_reserve:.1f} % of the limit",
        f"saturated     {found.saturated} of {n} simulations",
        f"bound         {_remedy(stability) if bound is None else held}",
        *text_table(rows, header=header).splitlines(),
    ]


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
    return f"none: {reason}, or the inertias of the rotors (--armature), which light links need"
