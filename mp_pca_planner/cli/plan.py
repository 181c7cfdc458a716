# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""`plan`: one motion, offline, from primitive files."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..exceptions import GoalError, PlannerError
from ..motion.collision import CollisionModel, package_folders
from ..motion.goal import JointGoal, JointState, Pose, PoseGoal, Via
from ..planning.objectives import OBJECTIVES, Objective, objective_by_name
from ..planning.plan import BASES, DEMONSTRATED, FREE, SHORTEST, Plan, PlannerOptions
from ..planning.planner import Planner
from ..planning.remarks import remarks
from ..planning.request import LONGEST_DURATION
from ..planning.starts import MOST_STARTS
from ..plotting.drawing import draw_motion
from ..primitives.primitive_library import load_primitives
from ..robot.model import Robot
from .common import (
    CommandParser,
    joint_values,
    limits_of,
    number,
    number_list,
    print_json,
    run,
    whole,
)
from .motion_files import check_outputs, output_lines, trajectory_columns, write_trajectory
from .states import (
    VALUES,
    collision_facts,
    collision_lines,
    effort_words,
    passed_lines,
    remark_lines,
    states_by_name,
    status_line,
)
from .terminal import DONE, FAILED, say

NATURALNESS, SAMPLE_PERIOD = number(0.0, 1e6), number(1e-4, 1.0, "s")
_DURATION = number(1e-3, LONGEST_DURATION, "s")
_WEIGHTS = 1e-12, 1e12  # of objectives
_AT_PHASE = "at a phase from 0 to 1 or when it suits best"


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit status."""
    return run(_parser(), _plan, argv)


def _parser() -> CommandParser:
    parser = CommandParser("plan", "Plan one motion of least effort from primitive files.")
    add_request_options(parser)
    parser.add_argument(
        "--output", type=Path, metavar="FILE", help="write it: .csv, .json, .npz, or a bag"
    )
    parser.add_argument("--plot", type=Path, metavar="FILE.png", help="draw it")
    parser.add_argument("--force", action="store_true", help="overwrite files")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    return parser


def add_request_options(
    parser: CommandParser, *, via_form: str = "V[@PHASE]", via_time: str = _AT_PHASE
) -> None:
    """Add what says which motion is wanted; :func:`plan_request` reads it.

    Parameters
    ----------
    parser :
        The parser.
    via_form, via_time : str
        The form of ``--via``, and when that is passed.
    """
    defaults = PlannerOptions()
    parser.add_argument("primitives", nargs="+", metavar="FILE", help="primitive files or folders")
    parser.add_argument("--robot", required=True, type=Path, metavar="URDF", help="the robot")
    parser.add_argument("--start", required=True, help=f"start configuration: {VALUES}")
    goal = parser.add_mutually_exclusive_group(required=True)
    goal.add_argument("--goal", help=f"goal: {VALUES}; joints left out stay")
    goal.add_argument(
        "--goal-pose",
        metavar="'X Y Z QX QY QZ QW'",
        help="pose of a frame [m, unit quaternion] in the base frame; 3 numbers: position only",
    )
    parser.add_argument("--frame", help="link whose pose --goal-pose is (default: the last)")
    for end in ("start", "goal"):
        for rate in ("velocity", "acceleration"):
            parser.add_argument(
                f"--{end}-{rate}", metavar=rate[0].upper(), help=f"{rate} at the {end}, likewise"
            )
    parser.add_argument(
        "--via",
        action="append",
        default=[],
        metavar=via_form,
        help="configuration (name=value,…) or pose ('FRAME: X Y Z' or with a quaternion) to pass "
        f"on the way, {via_time}; may be repeated",
    )
    parser.add_argument(
        "--duration",
        type=_duration,
        metavar="T",
        help="duration [s]; 'shortest' that the limits allow; 'free': the one of least cost "
        "(default: like the demonstrations)",
    )
    parser.add_argument(
        "--objective",
        metavar="NAME=WEIGHT,…",
        default="effort=1",
        help=f"what to minimise, a weighted sum of: {', '.join(OBJECTIVES)}",
    )
    parser.add_argument("--use", metavar="NAME", help="primitive to use (default: the nearest)")
    parser.add_argument("--basis", choices=BASES, default=defaults.basis, help="basis functions")
    parser.add_argument(
        "--naturalness",
        type=NATURALNESS,
        default=defaults.naturalness,
        metavar="ρ",
        help="weight of likeness to the demonstrations against effort",
    )
    parser.add_argument(
        "--starts",
        type=whole(1, MOST_STARTS),
        default=MOST_STARTS,
        metavar="N",
        help="starts of the search for the least, where likeness counts for little (ρ < 0.1)",
    )
    parser.add_argument(
        "--limits", type=Path, metavar="FILE.yaml", help="limits in the form of joint_limits.yaml"
    )
    parser.add_argument(
        "--sample-period", type=SAMPLE_PERIOD, default=defaults.sample_period, help="time step [s]"
    )
    add_collision_options(parser)


def add_collision_options(parser: CommandParser) -> None:
    """Add what says whether the robot may hit itself; :func:`collision_model` reads it."""
    parser.add_argument(
        "--collision",
        action="store_true",
        help="keep the robot from hitting itself",
    )
    parser.add_argument(
        "--srdf",
        type=Path,
        metavar="FILE",
        help="pairs of links that need no look (default: neighbours, and what touches at neutral)",
    )
    parser.add_argument(
        "--package-dirs",
        type=Path,
        nargs="+",
        default=(),
        metavar="DIR",
        help="where packages with meshes are, before ROS's and the folders above the URDF",
    )


def _plan(arguments: argparse.Namespace) -> int:
    check_outputs(arguments)
    planner, plan = plan_request(arguments)
    facts = plan_facts(plan, planner.collision)
    if arguments.output is not None and plan.is_executable:
        write_trajectory(plan.trajectory, arguments.output, facts, arguments.force)
    if arguments.plot is not None:
        draw_motion(
            arguments.plot,
            plan.trajectory,
            title=f"'{plan.primitive}': {plan.message}",
            limits=planner.limits,
            prismatic=planner.robot.prismatic_joints,
            force=arguments.force,
        )
    if arguments.json:
        print_json(facts)
    else:
        say(*_text(plan, planner.robot, asked(arguments, planner.robot), facts))
        say(*output_lines(arguments, plan))
    return DONE if plan.is_executable else FAILED


def plan_request(arguments: argparse.Namespace) -> tuple[Planner, Plan]:
    """Plan what the options of :func:`add_request_options` ask for.

    Raises
    ------
    PlannerError
        If a file can't be read or an option can't be served.
    """
    primitives = load_primitives(arguments.primitives)
    names = primitives[0].joint_names
    robot = Robot.from_file(arguments.robot, names)
    # Without a controller to refuse it, a motion may end as it was asked to.
    options = PlannerOptions(
        basis=arguments.basis,
        objectives=_objectives(arguments.objective, robot, arguments.frame),
        timing=arguments.duration if arguments.duration in (SHORTEST, FREE) else DEMONSTRATED,
        naturalness=arguments.naturalness,
        n_starts=arguments.starts,
        sample_period=arguments.sample_period,
        allow_nonzero_end_velocity=arguments.goal_velocity is not None,
    )
    start = _state(arguments, "start", robot.described_joints)
    if set(start.joint_names) != set(names):
        missing = [name for name in names if name not in start.joint_names]
        raise GoalError(f"--start lacks a position for {', '.join(missing)}")
    limits, collision = limits_of(robot, arguments.limits), collision_model(arguments, robot)
    planner = Planner(robot, primitives, limits, options, collision)
    return planner, planner.plan(_goal(arguments, robot), start)


def collision_model(arguments: argparse.Namespace, robot: Robot) -> CollisionModel | None:
    """The robot's collision model, None if that isn't asked for.

    Raises
    ------
    PlannerError
        If it can't be made, or is only half asked for.
    """
    if not arguments.collision:
        if arguments.srdf is not None or arguments.package_dirs:
            raise PlannerError("--srdf and --package-dirs are for --collision: give that, too")
        return None
    folders = package_folders(arguments.package_dirs, arguments.robot)
    return CollisionModel(robot, srdf=arguments.srdf, package_dirs=folders)


def _goal(arguments: argparse.Namespace, robot: Robot) -> JointGoal | PoseGoal:
    how = {
        "duration": arguments.duration if isinstance(arguments.duration, float) else None,
        "primitive": arguments.use,
        "vias": tuple(_via(text, robot.described_joints) for text in arguments.via),
    }
    if arguments.goal is not None:
        return JointGoal(_state(arguments, "goal", robot.described_joints), **how)
    for option in ("goal_velocity", "goal_acceleration"):
        if getattr(arguments, option) is not None:
            raise GoalError(f"--{option.replace('_', '-')} needs --goal: a pose is reached at rest")
    frame = _frame(arguments, robot)
    return PoseGoal(_pose(frame, arguments.goal_pose, "--goal-pose"), **how)


def _frame(arguments: argparse.Namespace, robot: Robot) -> str:
    return str(arguments.frame or robot.frame_names[-1])


def _state(arguments: argparse.Namespace, end: str, names: Sequence[str]) -> JointState:
    q = joint_values(getattr(arguments, end), names, f"--{end}")
    rates = []
    for rate in ("velocity", "acceleration"):
        text, option = getattr(arguments, f"{end}_{rate}"), f"--{end}-{rate}"
        values = joint_values(text, names, option) if text else {}
        for name in values:
            if name not in q:
                raise GoalError(f"{option} names joint '{name}', but --{end} does not")
        rates.append([values.get(name, 0.0) for name in q])
    return JointState(list(q), list(q.values()), *rates)


def _pose(frame: str, text: str, option: str) -> Pose:
    numbers = number_list(text, option)
    if len(numbers) not in (3, 7):
        raise GoalError(
            f"{option} '{text}' has {len(numbers)} numbers, but a position has 3 (x y z) and a "
            "pose 7 (x y z qx qy qz qw)"
        )
    return Pose(frame, numbers[:3], numbers[3:] or None)


def _via(text: str, names: Sequence[str]) -> Via:
    where, _, when = text.partition("@")
    phase = number_list(when, "the phase of --via")[0] if when else None
    return Via(target(where, names, "--via"), phase)


def target(text: str, names: Sequence[str], option: str) -> JointState | Pose:
    """Read a configuration (name=value,…) or a pose ('FRAME: X Y Z' or with a quaternion).

    Raises
    ------
    GoalError
        If it is neither.
    """
    frame, is_pose, numbers = text.partition(":")
    if is_pose:
        return _pose(frame.strip(), numbers, option)
    q = joint_values(text, names, option)
    return JointState(list(q), list(q.values()))


def _duration(text: str) -> str | float:
    """Parse the option, for argparse."""
    if text in (SHORTEST, FREE):
        return text
    try:
        return _DURATION(text)
    except argparse.ArgumentTypeError as error:
        raise argparse.ArgumentTypeError(f"{error}, '{SHORTEST}' or '{FREE}'") from None


def _objectives(text: str, robot: Robot, frame: str | None) -> tuple[tuple[float, Objective], ...]:
    weights = joint_values(text, OBJECTIVES, "--objective", "objective")
    low, high = _WEIGHTS
    for name, weight in weights.items():
        if not low <= weight <= high:
            raise GoalError(
                f"--objective: the weight of '{name}' is {weight:g}, expected one from {low:g} "
                f"to {high:g}"
            )
    return tuple((w, objective_by_name(name, robot, frame)) for name, w in weights.items())


def asked(arguments: argparse.Namespace, robot: Robot) -> list[str]:
    """What to pass and where to end, as the options say it; poses with the name of their frame."""
    goal = arguments.goal or f"{_frame(arguments, robot)}: {arguments.goal_pose}"
    return [*arguments.via, goal]


def plan_facts(plan: Plan, collision: CollisionModel | None) -> dict[str, Any]:
    """What `plan --json` prints."""
    return (
        plan.summary()
        | collision_facts(collision, plan.trajectory)
        | {
            **states_by_name(_passed(plan)),
            "remarks": remarks(plan),
            "joint_names": list(plan.trajectory.joint_names),
            "weights": plan.solution.weights,
            "via_phases": list(plan.via_phases),
            **trajectory_columns(plan.trajectory),
        }
    )


def _passed(plan: Plan) -> list[JointState]:
    """The start, the configurations at the vias, and the goal."""
    motion = plan.motion
    at_vias, _, _ = motion.evaluate(motion.duration * np.array(plan.via_phases))
    vias = [JointState(motion.start.joint_names, q) for q in at_vias]
    return [motion.start, *vias, motion.goal]


def _ways(plan: Plan) -> list[str]:
    """What is worth a line only of some plans."""
    lines = []
    if plan.via_phases:
        phases = ", ".join(f"{phase:.3f}" for phase in plan.via_phases)
        lines.append(f"vias         passed at phase {phases}, error {plan.via_error:.2g} rad or m")
    if plan.correction > 0.0:
        lines.append(
            f"correction   {plan.correction:.2g} rad or m beside "
            f"{plan.n_components_used} components"
        )
    return lines


def _text(plan: Plan, robot: Robot, asked: Sequence[str], facts: Mapping[str, Any]) -> list[str]:
    return [
        status_line(plan),
        *remark_lines(plan),
        *passed_lines(_passed(plan), robot.described_joints, asked),
        f"primitive    {facts['primitive']} (in-span score {facts['in_span_score']:.2f}, "
        "about 1 is like the demonstrations)",
        f"selection    {facts['selection']}",
        f"duration     {facts['duration']:.3f} s",
        f"effort       {effort_words(plan.solution.effort_cost, plan.solution.start_cost)}",
        f"solve time   {1e3 * plan.solve_time:.2f} ms, {facts['iterations']} iterations",
        f"goal error   {facts['goal_error']:.2g} rad or m",
        *_ways(plan),
        *collision_lines(facts),
        f"worst limit violation  {facts['limit_violation']:.2g} (relative, 1 ms grid)",
    ]
