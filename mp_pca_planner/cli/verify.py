# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""`verify`: a control law for a primitive, its error bound, and simulations of the bound."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Any

import numpy as np

from ..arrays import FloatArray, text_table
from ..control.closed_loop import ControlLoop, ErrorModel, Verification, verify
from ..control.identification import Identification, MeasuredMotion, identify, measured_motions
from ..control.law import (
    COMPUTED_TORQUE,
    KINDS,
    ControlLaw,
    controller_parameters,
    excluded,
    pair_law,
    paired_law,
    verified_case,
)
from ..control.stability import Stability, analyse
from ..exceptions import ControlError
from ..files import check_writable, write_whole
from ..primitives.file import save_primitive
from ..recordings.bags import find_recordings, local_copy
from ..robot.model import Robot
from .common import check_output, progress_bar, report
from .goal_arguments import joint_values
from .plan import PlannedRequest, plan_request
from .terminal import DONE, FAILED, written_lines


def run(arguments: argparse.Namespace) -> int:
    """Run the command; returns the exit status."""
    output, parameters_file = arguments.output, arguments.controller_parameters
    check_output(output, ".npz", force=arguments.force)
    if parameters_file is not None:
        check_writable(parameters_file, overwrite=arguments.force)
    request = plan_request(arguments)
    if not request.plan.is_executable:
        raise ControlError(f"there is no motion to verify: {request.plan.message}")
    robot, trajectory = request.planner.robot, request.plan.trajectory
    friction, armature = robot.described_friction, np.zeros(robot.n_joints)
    identified = None
    if arguments.identify is not None:
        identified = identify(robot, _measured(arguments.identify, robot.joint_names))
        friction = identified.friction(np.abs(trajectory.velocities).max(axis=0), friction)
        armature = identified.armature
    if arguments.armature is not None:
        armature = _by_joint(arguments.armature, "--armature", robot)
    if arguments.friction is not None:
        friction = _by_joint(arguments.friction, "--friction", robot)
    if armature.any():
        robot = robot.with_armature(armature)
    errors = ErrorModel(
        arguments.inertia_error,
        arguments.payload,
        arguments.payload_link,
        arguments.start_error,
        friction=tuple(friction.tolist()),
    )
    law = _choose_law(arguments, request, robot)
    parameters = parameters_file and controller_parameters(law, "joint_trajectory_controller")
    sampling, limits = (arguments.control_period, arguments.delay), request.planner.limits
    loop = ControlLoop(robot, law, trajectory, limits.effort, *sampling)
    stability, n = analyse(loop, errors), arguments.trials
    with progress_bar("simulations", "simulation") as progress:
        found = verify(loop, errors, stability.error_bound, n, progress=progress)
    facts = _facts(arguments, law, stability, found, errors, armature)
    facts["holds_for"] = verified_case(robot, trajectory)
    if output is not None:
        paired = pair_law(request.primitives[0], law, facts)
        save_primitive(paired, output, overwrite=arguments.force)
    if parameters is not None:
        write_whole(parameters_file, parameters, overwrite=arguments.force)
    duration = f"duration     {trajectory.duration:.3f} s, of robot '{robot.name}'"
    lines = [*request.lines(), duration]
    if identified is not None:
        lines += _identified_lines(identified)
        facts["identified"] = identified.summary()
    lines += _text(robot, law, stability, found, excluded(facts["assumed"]))
    content = facts | {"law": law.kind, "joint_names": list(law.joint_names)}
    report(arguments, content, *lines, *written_lines([output, parameters_file]))
    return DONE if found.bound_held == arguments.trials and stability.holds else FAILED


def _by_joint(text: str, option: str, robot: Robot) -> FloatArray:
    """One number for all joints, or one for each; joints that are not named have 0."""
    if "=" not in text and len(text.replace(",", " ").split()) == 1:
        text = ",".join([text] * len(robot.described_joints))
    values = joint_values(text, robot.described_joints, option)
    return np.array([values.get(name, 0.0) for name in robot.joint_names])


def _measured(paths: Sequence[str], joint_names: Sequence[str]) -> list[MeasuredMotion]:
    """Motions with efforts in all recordings."""
    motions = []
    for recording in find_recordings(paths):
        with local_copy(recording) as path:
            motions += measured_motions(path, joint_names)
    return motions


def _identified_lines(found: Identification) -> list[str]:
    """Identified friction and rotor inertias with standard errors, and joints without."""
    header = ["identified", "friction", "viscous friction", "armature", "unexplained"]
    rows = [
        [name]
        + [f"{value:.3g} ± {error:.1g}" for value, error in zip(values, errors, strict=True)]
        + [f"{unexplained:.3g}"]
        for name, values, errors, unexplained in zip(
            found.joint_names, found.values.T, found.errors.T, found.unexplained, strict=True
        )
        if name not in found.rejected
    ]
    rejected = [f"joint '{name}' not identified: {why}" for name, why in found.rejected.items()]
    return ["", *text_table(rows, header=header).splitlines(), *rejected, ""]


def _choose_law(arguments: argparse.Namespace, request: PlannedRequest, robot: Robot) -> ControlLaw:
    """The law of the options, the primitive's own, or one made from frequency and damping."""
    kind = arguments.law or KINDS[0]
    own = paired_law(request.primitives[0])
    if own is not None and arguments.law is None:
        return own
    frequency = arguments.natural_frequency
    return ControlLaw.from_frequency(kind, robot, request.plan.trajectory, frequency)


def _facts(
    arguments: argparse.Namespace,
    law: ControlLaw,
    stability: Stability,
    found: Verification,
    errors: ErrorModel,
    armature: FloatArray,
) -> dict[str, Any]:
    assumed = ("inertia_error", "payload", "payload_link", "start_error", "control_period", "delay")
    return {
        "position_gains": law.position_gains.tolist(),
        "velocity_gains": law.velocity_gains.tolist(),
        "assumed": {name: getattr(arguments, name) for name in assumed}
        | {
            "friction": list(errors.friction),
            "armature": armature.tolist() if armature.any() else None,
        },
        **stability.summary(),
        "n_trials": len(found.errors),
        "bound_held": found.bound_held,
        "saturated": found.saturated,
        "worst_error": found.errors.max(axis=0).tolist(),
        "median_error": np.median(found.errors, axis=0).tolist(),
    }


def _text(
    robot: Robot, law: ControlLaw, stability: Stability, found: Verification, without: str
) -> list[str]:
    n = len(found.errors)
    bound = stability.error_bound
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
    return [
        f"law           {law.kind}",
        f"poles         slowest {stability.slowest_pole:.3g} 1/s, least damping ratio "
        f"{stability.least_damping:.3g}, sampled radius {stability.sampled_radius:.4f}",
        *_damping_lines(law, stability),
        f"loop gain     {stability.loop_gain:.3g} (of the model's errors; below 1: stable)",
        f"effort left   {100 * stability.effort_reserve:.1f} % of the limit",
        f"saturated     {found.saturated} of {n} simulations",
        f"bound held    {found.bound_held} of {n} simulations"
        if bound is not None
        else f"bound         none: {_remedy(stability)}",
        f"not included  {without}",
        "",
        *text_table(rows, header=header).splitlines(),
    ]


def _damping_lines(law: ControlLaw, stability: Stability) -> list[str]:
    """The reason for poles of less damping than requested, if there are any."""
    if law.kind == COMPUTED_TORQUE or stability.least_damping > 0.9:
        return []
    return [
        "              PD gains are those of each joint alone, with a damping ratio of 1; inertia",
        "              that couples joints gives less. --law computed_torque decouples them",
    ]


def _remedy(stability: Stability) -> str:
    """Why there is no bound, and what helps."""
    if stability.slowest_pole >= 0.0 or stability.sampled_radius >= 1.0:
        return (
            "the loop is unstable; lower --natural-frequency, --control-period or --delay, or give "
            "the inertias of the rotors (--armature), which light last links need"
        )
    if stability.loop_gain >= 1.0:
        return (
            "errors of the model are amplified (loop gain above 1); give the inertias of the "
            "rotors (--armature), which light last links need, or less --inertia-error"
        )
    return (
        "the assumed errors leave the range of the linear loop; raise --natural-frequency, or give "
        "less --friction, --start-error or --inertia-error, or the inertias of the rotors "
        "(--armature)"
    )
