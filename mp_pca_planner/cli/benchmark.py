# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""`benchmark`: components against B-splines and other methods, on the same problems."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..evaluation.method import Method, PeerResult
from ..evaluation.problems import (
    EXAMPLE_ROBOTS,
    HUMAN_ARM,
    Scene,
    demonstrations_in,
    demonstrations_of,
    held_out_problems,
    random_problems,
    robot_file,
)
from ..evaluation.run import PEERS, compare, ratios, set_up, summarise, unsolved
from ..exceptions import PlannerError, quote_names, unknown_name
from ..plotting.comparison import comparison_figure
from ..plotting.drawing import picture, require_matplotlib
from ..plotting.text import table
from ..primitives.primitive_library import load_primitives
from ..robot.model import Robot
from .common import (
    CommandParser,
    check_output,
    count,
    joint_list,
    limits_of,
    print_json,
    progress_bar,
    run,
    seconds,
    seed,
)
from .terminal import DONE, say, written_lines

_N_DEMONSTRATIONS = 40
_DEMONSTRATIONS_SEED = 1


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit status."""
    return run(_parser(), _benchmark, argv)


def _parser() -> CommandParser:
    parser = CommandParser(
        "benchmark", "Compare components with B-splines and other methods on the same problems."
    )
    parser.add_argument(
        "--robot",
        default=HUMAN_ARM,
        metavar="NAME|URDF",
        help=f"a URDF file, '{HUMAN_ARM}', or of example-robot-data: {', '.join(EXAMPLE_ROBOTS)}",
    )
    parser.add_argument(
        "--joints",
        type=joint_list,
        metavar="a,b,c",
        help="joints that move, such as those of one arm (default: the robot's arm, or all)",
    )
    parser.add_argument(
        "--primitives",
        type=Path,
        metavar="FILE",
        help="a primitive file (default: learn from made-up motions of the robot)",
    )
    parser.add_argument("--limits", type=Path, metavar="FILE.yaml", help="as joint_limits.yaml")
    parser.add_argument("--problems", type=count, default=200, metavar="N", help="how many")
    parser.add_argument(
        "--random-ends",
        action="store_true",
        help="problems anywhere within the limits, not from the range of the demonstrations",
    )
    parser.add_argument("--seed", type=seed, default=2, help="chooses the problems")
    parser.add_argument(
        "--peers",
        default="all",
        metavar="a,b,c",
        help=f"other methods: all, none, or some of {', '.join(PEERS)}",
    )
    parser.add_argument(
        "--peer-problems", type=count, default=10, metavar="N", help="problems for slow peers"
    )
    parser.add_argument("--repeats", type=count, default=3, help="times each is solved")
    parser.add_argument(
        "--time-limit", type=seconds, default=10.0, metavar="S", help="for one problem [s]"
    )
    parser.add_argument("--plot", type=Path, metavar="FILE.png", help="draw cost over time")
    parser.add_argument("--force", action="store_true", help="overwrite the picture")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    return parser


def _benchmark(arguments: argparse.Namespace) -> int:
    if arguments.seed == _DEMONSTRATIONS_SEED:
        raise PlannerError(f"--seed must not be {arguments.seed}, which chooses the demonstrations")
    if arguments.plot is not None:
        require_matplotlib()
        check_output(arguments.plot, ".png", force=arguments.force)
    peers = _peers(arguments.peers)
    scene = _scene(arguments)
    draw = random_problems if arguments.random_ends else held_out_problems
    problems = draw(scene, arguments.problems, arguments.seed)
    methods, absent = set_up(scene, peers, arguments.time_limit)
    with progress_bar("planning", "problem") as progress:
        results = compare(
            scene,
            methods,
            problems,
            repeats=arguments.repeats,
            n_slow=arguments.peer_problems,
            progress=progress,
        )
    if arguments.plot is not None:
        _draw(arguments, scene, methods, results)
    facts = _facts(scene, methods, absent, results) | {"random_ends": arguments.random_ends}
    if arguments.json:
        print_json(facts)
    else:
        say(*_text(facts), *written_lines([arguments.plot]))
    return DONE


def _peers(text: str) -> list[str]:
    if text in ("all", "none"):
        return list(PEERS) if text == "all" else []
    names = [name.strip() for name in text.split(",")]
    for name in names:
        if name not in PEERS:
            raise PlannerError(unknown_name("peer", name, [*PEERS, "all", "none"]))
    return list(dict.fromkeys(names))


def _scene(arguments: argparse.Namespace) -> Scene:
    name, urdf, usual_joints = robot_file(arguments.robot)
    joints, primitive = arguments.joints or usual_joints, None
    if arguments.primitives is not None:
        if arguments.joints is not None:
            raise PlannerError("--joints is for made-up motions: --primitives has its own joints")
        primitives = load_primitives([arguments.primitives])
        if len(primitives) != 1:
            found = quote_names(p.name for p in primitives)
            raise PlannerError(f"--primitives must be one primitive, but there are {found}")
        primitive = primitives[0]
        joints = primitive.joint_names
    robot = Robot.from_file(urdf, joints)
    limits = limits_of(robot, arguments.limits)
    motions = (
        demonstrations_of(name, robot, limits, _N_DEMONSTRATIONS, _DEMONSTRATIONS_SEED)
        if primitive is None
        else demonstrations_in(primitive)
    )
    return Scene(name, urdf, robot, limits, tuple(motions), primitive)


def _facts(
    scene: Scene,
    methods: Sequence[Method],
    absent: Mapping[str, str],
    results: Sequence[dict[str, PeerResult]],
) -> dict[str, Any]:
    names = [method.name for method in methods]
    own = [name for name in names if name.startswith("pca_")]
    compared = {one: {name: ratios(results, one, name) for name in names} for one in own}
    # The others know no naturalness, so the effort alone is what all of them minimise.
    chosen = next(name for name in own if name.endswith("_effort_only"))
    return {
        "robot": scene.name,
        "n_joints": scene.robot.n_joints,
        "n_problems": len(results),
        "methods": {method.name: method.about for method in methods},
        "absent": dict(absent),
        "problems": [{name: result.facts() for name, result in found.items()} for found in results],
        "summary": summarise(results, names),
        "ratios": compared,
        "ratios_of": chosen,
        **{
            f"{kind}_pca_over_{name}": compared[chosen][name][kind]
            for name in names
            if name not in own
            for kind in ("time_ratio", "cost_ratio")
        },
        "solved_by_bspline_only": {name: unsolved(results, name) for name in own},
    }


def _text(facts: Mapping[str, Any]) -> list[str]:
    chosen = facts["ratios_of"]
    rows = []
    for name, s in facts["summary"].items():
        compared = facts["ratios"][chosen][name]
        rows.append(
            [
                name,
                f"{s['n_feasible']} / {s['n_solved']} / {s['n_problems']}",
                _number(s["effort_cost"], "{:.4g}"),
                _number(s["solve_time_s"], "{:.2f}", 1e3),
                _number(s["solve_time_99_s"], "{:.2f}", 1e3),
                _number(s["iterations"], "{:g}"),
                _number(s["limit_violation"], "{:.1g}"),
                _number(s["limits_active_share"], "{:.0f}", 100.0),
                _number(s["demo_distance_deg"], "{:.2f}"),
                _number(s["duration"], "{:.2f}"),
                _number(compared["time_ratio"], "{:.3g}"),
                _number(compared["cost_ratio"], "{:.3g}"),
            ]
        )
    header = ["method", "feasible / solved / of", "J", "time [ms]", "99 %", "iterations"]
    header += ["violation", "active [%]", "from demo [°]", "T [s]", "time ratio", "cost ratio"]
    lines = [
        f"{facts['n_problems']} problems of '{facts['robot']}', {facts['n_joints']} joints, "
        + ("anywhere within the limits" if facts["random_ends"] else "like the demonstrations"),
        "",
        *table(rows, header=header).splitlines(),
        "",
        "Medians over the problems that a method calls solved; the worst violation, relative, on "
        "a 0.5 ms grid;",
        "feasible: limits to 1e-6, ends to 1e-3 rad and 1e-2 rad/s; active: a limit is reached on "
        "the way;",
        "from demo: RMS difference from the held-out demonstration; ratios: medians of "
        f"{chosen} over the method.",
        "",
        *(f"{name}: {about}" for name, about in facts["methods"].items()),
    ]
    lines += [f"{name} is absent: {reason}" for name, reason in facts["absent"].items()]
    for name, missed in facts["solved_by_bspline_only"].items():
        lines.append(f"{name}: of the problems that B-splines solve, {len(missed)} are not solved")
    return lines


def _number(value: float | None, form: str, factor: float = 1.0) -> str:
    return "–" if value is None else form.format(factor * value)


def _draw(
    arguments: argparse.Namespace,
    scene: Scene,
    methods: Sequence[Method],
    results: Sequence[dict[str, PeerResult]],
) -> None:
    clouds = {}
    for method in methods:
        points = [
            (1e3 * r[method.name].solve_time, verdict.effort_cost / reference.effort_cost)
            for r in results
            if method.name in r
            and r[method.name].solved
            and (verdict := r[method.name].verdict) is not None
            and (reference := r["minimum_jerk"].verdict) is not None
        ]
        if points:
            clouds[method.name] = points
    with picture(arguments.plot, force=arguments.force) as figure:
        comparison_figure(
            figure,
            clouds,
            x="solve time [ms]",
            y="effort J over that of the minimum-jerk motion",
            title=f"{len(results)} problems of '{scene.name}': effort over time",
        )
