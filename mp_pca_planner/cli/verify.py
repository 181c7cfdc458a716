# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""`verify`: a control law for a primitive, its error bound, and simulations of the bound."""

from __future__ import annotations

import argparse

import numpy as np

from ..arrays import FloatArray, by_name, name_values
from ..control.closed_loop import ControlLoop, ErrorModel, verify
from ..control.law import KINDS, ControlLaw, pair_law, paired_law
from ..control.stability import Stability, analyse
from ..exceptions import ControlError
from ..primitives.file import save_primitive
from ..robot.model import Robot
from .common import check_output, show
from .goal_arguments import joint_values
from .options import add_file, add_report, add_request, number
from .plan import plan_request
from .terminal import DONE, FAILED

_REMEDY = (
    "there is no bound: the loop is unstable, or the assumed errors leave the range of its linear "
    "model; change --natural-frequency, give less --friction, --start-error or --inertia-error, or "
    "the inertias of the rotors (--armature), which light links need"
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.description = (
        "Bound the error of a control law along a planned motion, and simulate it with errors."
    )
    add_request(parser)
    add_report(parser)
    add_file(parser, "--output", "FILE.npz", "primitive to write, with this law")
    law = parser.add_argument_group("control law (default: the primitive's own, if it has one)")
    law.add_argument("--law", choices=KINDS, help=f"kind of law (default: {KINDS[0]})")
    help_text = "of the error, for the gains [rad/s] (default: %(default)g)"
    omega = number(1e-3, 1e5)
    law.add_argument("--natural-frequency", metavar="ω", type=omega, default=30.0, help=help_text)
    errors = parser.add_argument_group("assumed errors")
    help_text = "relative error of masses and moments of inertia (default: %(default)g)"
    share = number(0.0, 0.999)
    errors.add_argument("--inertia-error", metavar="X", type=share, default=0.05, help=help_text)
    help_text = "error of each joint at the start [rad or m] (default: %(default)g)"
    angle = number(0.0, 10.0)
    errors.add_argument("--start-error", metavar="X", type=angle, default=0.001, help=help_text)
    help_text = "Coulomb friction, a number or name=value,… [N·m or N] (default: 0)"
    errors.add_argument("--friction", metavar="VALUES", default="0", help=help_text)
    help_text = "inertias of the rotors, likewise [kg·m² or kg] (default: 0)"
    errors.add_argument("--armature", metavar="VALUES", default="0", help=help_text)
    trials = number(1, 100_000, kind=int)
    help_text = "simulations (default: %(default)s)"
    errors.add_argument("--trials", metavar="N", type=trials, default=100, help=help_text)


def run(arguments: argparse.Namespace) -> int:
    """Run the command; returns the exit status."""
    check_output(arguments.output, ".npz", force=arguments.force)
    request = plan_request(arguments)
    if not request.plan.is_executable:
        raise ControlError(f"there is no motion to verify: {request.plan.message}")
    motion, primitive = request.plan.trajectory, request.primitives[0]
    robot, names = request.planner.robot, motion.joint_names
    friction = _by_joint(arguments.friction, "--friction", robot)
    armature = _by_joint(arguments.armature, "--armature", robot)
    if armature.any():
        robot = robot.with_drives({n: {"armature": x} for n, x in by_name(names, armature).items()})
    law = paired_law(primitive)
    if law is None or arguments.law is not None:
        kind = arguments.law or KINDS[0]
        law = ControlLaw.from_frequency(kind, robot, motion, arguments.natural_frequency)
    loop = ControlLoop(robot, law, motion, request.planner.limits.effort)
    errors = ErrorModel(arguments.inertia_error, arguments.start_error, friction)
    stability = analyse(loop, errors)
    bound = stability.error_bound
    found = verify(loop, errors, bound, arguments.trials)
    statement = _statement(loop, errors, stability, armature)
    if arguments.output is not None:
        paired = pair_law(primitive, law, statement)
        save_primitive(paired, arguments.output, overwrite=arguments.force)
    content = {
        "law": law.kind,
        "joint_names": names,
        "position_gains": law.position_gains,
        "velocity_gains": law.velocity_gains,
        "duration": motion.duration,
        "slowest_pole": stability.slowest_pole,
        "least_damping": stability.least_damping,
        "sampled_radius": stability.sampled_radius,
        "effort_reserve": stability.effort_reserve,
        "error_bound": None if bound is None else bound.max(axis=0),
        "bound_holds": stability.holds,
        "n_trials": arguments.trials,
        "bound_held": found.bound_held,
        "saturated": found.saturated,
        "worst_error": found.errors.max(axis=0),
        "statement": statement,
        "remedy": _REMEDY if bound is None else None,
        "remarks": request.remarks,
        "written": arguments.output,
    }
    show(arguments, content)
    return DONE if found.bound_held == arguments.trials and stability.holds else FAILED


def _by_joint(text: str, option: str, robot: Robot) -> FloatArray:
    """One number for all joints, or one for each; joints that are not named have 0."""
    if "=" not in text and len(text.replace(",", " ").split()) == 1:
        text = ",".join([text] * len(robot.described_joints))
    values = joint_values(text, robot.described_joints, option)
    for name, value in values.items():
        if value < 0.0:
            raise ControlError(f"{option} of '{name}' must be at least 0, got {value:g}")
    return np.array([values.get(name, 0.0) for name in robot.joint_names])


def _statement(
    loop: ControlLoop, errors: ErrorModel, stability: Stability, armature: FloatArray
) -> str:
    """A sentence on the error bound: its motion and robot, and what it assumes."""
    motion, unit = loop.trajectory, loop.model.position_unit
    torque, inertia = "N·m", "kg·m²"
    if loop.model.prismatic_joints:
        torque, inertia = "N·m or N", "kg·m² or kg"

    def shown(values: FloatArray) -> str:
        return name_values(by_name(motion.joint_names, values))

    verdict = "no error bound"
    if stability.error_bound is not None and stability.holds:
        verdict = f"errors stay within {shown(stability.error_bound.max(axis=0))} {unit}"
    return (
        f"{verdict} on the motion from {shown(motion.positions[0])} to "
        f"{shown(motion.positions[-1])} in {motion.duration:.6g} s of robot '{loop.model.name}', "
        f"if each mass and moment of inertia is within {100.0 * errors.inertia:g} %, "
        f"friction within {shown(np.asarray(errors.friction))} {torque}, "
        f"the inertias of the rotors are {shown(armature)} {inertia}, "
        f"the start within {errors.position:g} {unit}, the control period "
        f"{1e3 * loop.period:g} ms, and the delay {loop.delay} samples; not included: "
        "errors of centres of mass and of the velocity at the start, elasticity, backlash, and "
        "noise of the sensors"
    )
