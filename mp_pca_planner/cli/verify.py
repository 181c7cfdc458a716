# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""`verify`: a control law for a primitive, what is known of it, and simulations that check it."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..control.closed_loop import ControlLoop, Sampling
from ..control.errors import ErrorModel
from ..control.law import KINDS, ControlLaw, controller_parameters, pair_law, paired_law
from ..control.stability import Stability, analyse
from ..control.statement import verified_case
from ..control.verification import Verification, verify
from ..exceptions import ControlError
from ..files import check_writable, write_whole
from ..planning.plan import Plan
from ..planning.planner import Planner
from ..plotting.text import table
from ..primitives.file import save_primitive
from .common import (
    CommandParser,
    check_output,
    count,
    joint_values,
    number,
    print_json,
    progress_bar,
    run,
    seed,
    whole,
)
from .plan import add_request_options, asked, plan_request
from .states import passed_lines, remark_lines
from .terminal import DONE, FAILED, say, written_lines


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit status."""
    return run(_parser(), _verify, argv)


def _parser() -> CommandParser:
    errors = ErrorModel()
    parser = CommandParser(
        "verify",
        "Simulate a planned motion under a control law with a wrong model, wrong start, effort "
        "limits, sampling and delay, and compare with the error bound that is claimed.",
    )
    add_request_options(parser)
    law = parser.add_argument_group("control law (default: the primitive's own, if it has one)")
    law.add_argument("--law", choices=KINDS, help="which law (default: feedforward_pd)")
    law.add_argument(
        "--natural-frequency",
        type=number(1e-3, 1e5),
        default=30.0,
        metavar="ω",
        help="for gains [rad/s]",
    )
    law.add_argument(
        "--damping-ratio", type=number(1e-3, 1e3), default=1.0, metavar="ζ", help="for gains"
    )
    law.add_argument(
        "--position-gains", metavar="P", help="given gains: name=value,… of all joints"
    )
    law.add_argument(
        "--velocity-gains", metavar="D", help="given gains: name=value,… of all joints"
    )
    assumed = parser.add_argument_group("errors assumed")
    assumed.add_argument(
        "--inertia-error",
        type=number(0.0, 1.0),
        default=errors.inertia,
        metavar="SHARE",
        help="of the mass and of each principal moment of inertia of each link, either way",
    )
    assumed.add_argument(
        "--payload", type=number(0.0, 1e4), default=errors.payload, help="largest unknown mass [kg]"
    )
    assumed.add_argument("--payload-link", metavar="LINK", help="where it is (default: the last)")
    assumed.add_argument(
        "--start-error",
        type=number(0.0, 10.0),
        default=errors.position,
        help="of each joint [rad or m]",
    )
    assumed.add_argument(
        "--control-period", type=number(1e-6, 1.0, "s"), default=1e-3, help="sampling [s]"
    )
    assumed.add_argument(
        "--delay", type=whole(0, 1000), default=1, help="samples from measuring to acting"
    )
    parser.add_argument("--trials", type=count, default=100, help="simulations")
    parser.add_argument("--seed", type=seed, default=0, help="seed of the errors")
    parser.add_argument(
        "--output", type=Path, metavar="FILE.npz", help="write the primitive with this law"
    )
    parser.add_argument(
        "--controller-parameters",
        type=Path,
        metavar="FILE.yaml",
        help="write the gains as parameters of joint_trajectory_controller",
    )
    parser.add_argument(
        "--controller", default="joint_trajectory_controller", help="name of that controller"
    )
    parser.add_argument("--force", action="store_true", help="overwrite files")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    return parser


def _verify(arguments: argparse.Namespace) -> int:
    check_output(arguments.output, ".npz", force=arguments.force)
    if arguments.controller_parameters is not None:
        check_writable(arguments.controller_parameters, overwrite=arguments.force)
    errors = ErrorModel(
        arguments.inertia_error, arguments.payload, arguments.payload_link, arguments.start_error
    )
    sampling = Sampling(arguments.control_period, arguments.delay)
    planner, plan = plan_request(arguments)
    if not plan.is_executable:
        raise ControlError(f"there is no motion to verify: {plan.message}")
    law = _choose_law(arguments, planner, plan)
    if arguments.controller_parameters is not None:
        parameters = controller_parameters(law, arguments.controller)
    limits = planner.limits.effort
    loop = ControlLoop(planner.robot, law, plan.trajectory, limits, sampling)
    stability = analyse(loop, errors)
    with progress_bar("simulations", "simulation") as progress:
        found = verify(
            loop, errors, stability, arguments.trials, seed=arguments.seed, progress=progress
        )
    case = verified_case(planner.robot, plan.trajectory)
    facts = _facts(law, errors, sampling, stability, found) | {"holds_for": case}
    if arguments.output is not None:
        primitive = next(p for p in planner.primitives if p.name == plan.primitive)
        save_primitive(pair_law(primitive, law, facts), arguments.output, overwrite=arguments.force)
    if arguments.controller_parameters is not None:
        write_whole(arguments.controller_parameters, parameters, overwrite=arguments.force)
    if arguments.json:
        print_json(facts | {"law": law.kind, "joint_names": list(law.joint_names)})
    else:
        ends, robot = [plan.motion.start, plan.motion.goal], planner.robot
        goal = asked(arguments, robot)[-1:]
        say(*remark_lines(plan), *passed_lines(ends, robot.described_joints, goal))
        say(f"duration     {plan.trajectory.duration:.3f} s, of robot '{planner.robot.name}'")
        say(*_text(law, stability, found))
        say(*written_lines([arguments.output, arguments.controller_parameters]))
    return DONE if found.bound_held == arguments.trials and stability.holds else FAILED


def _choose_law(arguments: argparse.Namespace, planner: Planner, plan: Plan) -> ControlLaw:
    """The law that is asked for, the primitive's own, or one made from frequency and damping."""
    kind = arguments.law or KINDS[0]
    names = planner.robot.joint_names
    given = (arguments.position_gains, arguments.velocity_gains)
    if any(given):
        if not all(given):
            raise ControlError("--position-gains and --velocity-gains go together")
        gains = [
            joint_values(text, planner.robot.described_joints, option)
            for text, option in zip(given, ("--position-gains", "--velocity-gains"), strict=True)
        ]
        for values, option in zip(gains, ("--position-gains", "--velocity-gains"), strict=True):
            missing = [name for name in names if name not in values]
            if missing:
                raise ControlError(f"{option} lacks a gain for {', '.join(missing)}")
        return ControlLaw(kind, names, *([values[name] for name in names] for values in gains))
    own = paired_law(next(p for p in planner.primitives if p.name == plan.primitive))
    if own is not None and arguments.law is None:
        return own
    return ControlLaw.from_frequency(
        kind, planner.robot, plan.trajectory, arguments.natural_frequency, arguments.damping_ratio
    )


def _facts(
    law: ControlLaw,
    errors: ErrorModel,
    sampling: Sampling,
    stability: Stability,
    found: Verification,
) -> dict[str, Any]:
    worst = found.errors.max(axis=0)
    return {
        "position_gains": law.position_gains.tolist(),
        "velocity_gains": law.velocity_gains.tolist(),
        "assumed": {
            "inertia_error": errors.inertia,
            "payload": errors.payload,
            "payload_link": errors.frame,
            "start_error": errors.position,
            "control_period": sampling.period,
            "delay": sampling.delay,
        },
        **stability.summary(),
        "n_trials": len(found.errors),
        "bound_held": found.bound_held,
        "saturated": found.saturated,
        "worst_error": worst.tolist(),
        "median_error": np.median(found.errors, axis=0).tolist(),
    }


def _text(law: ControlLaw, stability: Stability, found: Verification) -> list[str]:
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
        for j, name in enumerate(law.joint_names)
    ]
    header = ["joint", "Kp", "Kd", "bound [mrad]", "worst [mrad]", "median [mrad]"]
    return [
        f"law           {law.kind}",
        f"poles         slowest {stability.slowest_pole:.3g} 1/s, least damping ratio "
        f"{stability.least_damping:.3g}, sampled radius {stability.sampled_radius:.4f}",
        f"loop gain     {stability.loop_gain:.3g} (of the model's errors; below 1: stable)",
        f"effort left   {100 * stability.effort_reserve:.1f} % of the limit",
        f"saturated     {found.saturated} of {n} simulations",
        f"bound held    {found.bound_held} of {n} simulations"
        if bound is not None
        else "bound         none: errors this large can't be bounded with these gains",
        "",
        *table(rows, header=header).splitlines(),
    ]
