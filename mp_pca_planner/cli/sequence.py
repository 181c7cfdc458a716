# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""`sequence`: one motion through configurations and poses, offline, from primitive files."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..motion.goal import JointState, SequenceGoal
from ..planning.plan import PlannerOptions
from ..planning.remarks import remarks
from ..planning.sequence import MODES, OPTIMAL, SequencePlan, SequencePlanner
from ..plotting.drawing import draw_motion
from ..primitives.primitive_library import load_primitives
from ..robot.model import Robot
from .common import (
    CommandParser,
    Stop,
    add_via_options,
    joint_values,
    limits_of,
    print_json,
    run,
    split_time,
)
from .motion_files import check_outputs, output_lines, trajectory_columns, write_trajectory
from .plan import NATURALNESS, SAMPLE_PERIOD, add_collision_options, collision_model, target
from .states import (
    VALUES,
    collision_facts,
    collision_lines,
    effort_words,
    passed,
    passed_lines,
    remark_lines,
    states_by_name,
    status_line,
)
from .terminal import DONE, FAILED, say


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit status."""
    return run(_parser(), _sequence, argv)


def _parser() -> CommandParser:
    defaults = PlannerOptions()
    parser = CommandParser(
        "sequence",
        "Plan one motion through configurations and poses that stops only where it is told to.",
    )
    parser.add_argument("primitives", nargs="+", metavar="FILE", help="primitive files or folders")
    parser.add_argument("--robot", required=True, type=Path, metavar="URDF", help="the robot")
    parser.add_argument("--start", required=True, help=f"start configuration: {VALUES}")
    add_via_options(
        parser,
        "V[@T]",
        f"configuration ({VALUES}; joints left out stay) or pose ('FRAME: X Y Z' or with a "
        "quaternion), with @T to be there T s after the start,",
    )
    parser.add_argument("--goal", required=True, help="where to stop, likewise")
    parser.add_argument("--mode", choices=MODES, default=OPTIMAL, help="optimise, or only join")
    parser.add_argument("--use", metavar="NAME", help="primitive to use (default: the nearest)")
    parser.add_argument(
        "--naturalness",
        type=NATURALNESS,
        default=defaults.naturalness,
        metavar="ρ",
        help="as in `plan`",
    )
    parser.add_argument("--limits", type=Path, metavar="FILE.yaml", help="as in `plan`")
    parser.add_argument(
        "--sample-period", type=SAMPLE_PERIOD, default=defaults.sample_period, help="time step [s]"
    )
    add_collision_options(parser)
    parser.add_argument(
        "--output", type=Path, metavar="FILE", help="write it: .csv, .json, .npz, or a bag"
    )
    parser.add_argument("--plot", type=Path, metavar="FILE.png", help="draw it")
    parser.add_argument("--force", action="store_true", help="overwrite files")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    return parser


def _sequence(arguments: argparse.Namespace) -> int:
    check_outputs(arguments)
    planner, plan = sequence_request(arguments, arguments.mode)
    facts = plan.summary() | {
        **states_by_name(passed(plan.motions)),
        "remarks": remarks(plan),
        "joint_names": list(plan.trajectory.joint_names),
        **collision_facts(planner.collision, plan.trajectory),
        "durations": [motion.duration for motion in plan.motions],
        **trajectory_columns(plan.trajectory),
    }
    if arguments.output is not None and plan.is_executable:
        write_trajectory(plan.trajectory, arguments.output, facts, arguments.force)
    if arguments.plot is not None:
        draw_motion(
            arguments.plot,
            plan.trajectory,
            title=f"{len(plan.motions)} segments: {plan.message}",
            limits=planner.limits,
            prismatic=planner.robot.prismatic_joints,
            force=arguments.force,
        )
    if arguments.json:
        print_json(facts)
    else:
        say(*_text(plan, planner.robot, [*arguments.via, arguments.goal], facts))
        say(*output_lines(arguments, plan))
    return DONE if plan.is_executable else FAILED


def sequence_request(
    arguments: argparse.Namespace, mode: str
) -> tuple[SequencePlanner, SequencePlan]:
    """Plan the sequence that options ask for.

    Raises
    ------
    PlannerError
        If a file can't be read or an option can't be served.
    """
    # Refuses numbers that are out of range.
    options = PlannerOptions(
        naturalness=arguments.naturalness, sample_period=arguments.sample_period
    )
    primitives = load_primitives(arguments.primitives)
    robot = Robot.from_file(arguments.robot, primitives[0].joint_names)
    names = robot.described_joints
    start = joint_values(arguments.start, names, "--start")
    planner = SequencePlanner(
        robot,
        primitives,
        limits_of(robot, arguments.limits),
        naturalness=options.naturalness,
        sample_period=options.sample_period,
        collision=collision_model(arguments, robot),
    )
    here = JointState(list(start), list(start.values()))
    return planner, planner.plan(_goal(arguments, names), here, mode)


def _goal(arguments: argparse.Namespace, names: Sequence[str]) -> SequenceGoal:
    targets, times = [], []
    for option, text in [*(("--via", via) for via in arguments.via), ("--goal", arguments.goal)]:
        values, moment = split_time(text, option)
        targets.append(target(values, names, option))
        times.append(moment)
    stops = (*(isinstance(via, Stop) for via in arguments.via), True)
    return SequenceGoal(tuple(targets), tuple(times), arguments.use, stops)


def _text(
    plan: SequencePlan, robot: Robot, asked: Sequence[str], facts: Mapping[str, Any]
) -> list[str]:
    durations = ", ".join(f"{motion.duration:.3f}" for motion in plan.motions)
    return [
        status_line(plan),
        *remark_lines(plan),
        *passed_lines(passed(plan.motions), robot.described_joints, asked),
        f"primitives   {facts['primitive']} (in-span score {facts['in_span_score']:.2f})",
        f"duration     {facts['duration']:.3f} s ({durations})",
        f"effort       {effort_words(plan.effort_cost)}",
        f"solve time   {1e3 * plan.solve_time:.2f} ms, {facts['iterations']} iterations",
        f"target error {max(plan.via_error, plan.goal_error):.2g} rad or m",
        *collision_lines(facts),
        f"worst limit violation  {facts['limit_violation']:.2g} (relative, 1 ms grid)",
    ]
