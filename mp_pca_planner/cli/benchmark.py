# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""`benchmark`: comparison of components with B-splines and other methods on the same problems."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..evaluation.method import Method, PeerResult
from ..evaluation.problems import (
    DEMONSTRATIONS_SEED,
    HUMAN_ARM,
    Scene,
    demonstrations_in,
    demonstrations_of,
    held_out_problems,
    random_problems,
    robot_file,
)
from ..evaluation.run import PEERS, compare, ratios, set_up, summarise, unsolved
from ..exceptions import PlannerError, quote_names
from ..plotting.comparison import comparison_figure
from ..plotting.drawing import picture
from ..plotting.page import Table
from ..plotting.text import cells, table
from ..primitives.primitive import MovementPrimitive
from ..primitives.primitive_library import load_primitives
from ..robot.model import Robot
from .common import check_output, limits_of, named_peers, print_json, progress_bar
from .scenes import run_scenes
from .terminal import DONE, say, written_lines

_COLUMNS = {
    "J": ("effort_cost", ".4g", 1.0),
    "time [ms]": ("solve_time_s", ".2f", 1e3),
    "99 %": ("solve_time_99_s", ".2f", 1e3),
    "iterations": ("iterations", "g", 1.0),
    "violation": ("limit_violation", ".1g", 1.0),
    "active [%]": ("limits_active_share", ".0f", 100.0),
    "from demo [°]": ("demo_distance_deg", ".2f", 1.0),
    "T [s]": ("duration", ".2f", 1.0),
    "time ratio": ("time_ratio", ".3g", 1.0),
    "cost ratio": ("cost_ratio", ".3g", 1.0),
}


def run(arguments: argparse.Namespace) -> int:
    """Run the command; returns the exit status."""
    if arguments.scenes is not None:
        given = arguments.primitives
        return run_scenes(arguments, None if given is None else _only_primitive(given))
    if arguments.seed == DEMONSTRATIONS_SEED:
        raise PlannerError(f"--seed must not be {arguments.seed}, which chooses the demonstrations")
    check_output(arguments.plot, ".png", force=arguments.force)
    peers = named_peers(arguments.peers, list(PEERS))
    scene = _scene(arguments)
    draw = random_problems if arguments.random_ends else held_out_problems
    problems = draw(scene, arguments.problems, arguments.seed)
    max_time = arguments.time_limit or 10.0
    methods, absent = set_up(scene, peers, max_time)
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
    facts["tables"] = {_title(facts): _table(facts)._asdict()}
    if arguments.json:
        print_json(facts)
    else:
        say(*_text(facts), *written_lines([arguments.plot]))
    return DONE


def _scene(arguments: argparse.Namespace) -> Scene:
    name, urdf, usual_joints = robot_file(arguments.robot or HUMAN_ARM)
    primitive = None
    if arguments.primitives is not None:
        if arguments.joints is not None:
            raise PlannerError("--joints is for generated motions: --primitives has its own joints")
        primitive = _only_primitive(arguments.primitives)
    joints = primitive.joint_names if primitive else arguments.joints or usual_joints
    robot = Robot.from_file(urdf, joints)
    limits = limits_of(robot, arguments.limits)
    motions = demonstrations_in(primitive) if primitive else demonstrations_of(name, robot, limits)
    return Scene(name, urdf, robot, limits, tuple(motions), primitive)


def _only_primitive(path: Path) -> MovementPrimitive:
    primitives = load_primitives([path])
    if len(primitives) != 1:
        found = quote_names(primitives.names)
        raise PlannerError(f"--primitives must be one primitive, but there are {found}")
    return primitives[0]


def _facts(
    scene: Scene,
    methods: Sequence[Method],
    absent: Mapping[str, str],
    results: Sequence[dict[str, PeerResult]],
) -> dict[str, Any]:
    names = [method.name for method in methods]
    own = [name for name in names if name.startswith("pca_")]
    compared = {one: {name: ratios(results, one, name) for name in names} for one in own}
    # Other methods have no naturalness term, so all methods minimise the effort alone.
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


def _table(facts: Mapping[str, Any]) -> Table:
    """The methods, one in each row."""
    chosen = facts["ratios_of"]
    rows = []
    for name, summary in facts["summary"].items():
        values = summary | facts["ratios"][chosen][name]
        counts = f"{values['n_feasible']} / {values['n_solved']} / {values['n_problems']}"
        rows.append([name, counts, *cells(values, _COLUMNS)])
    return Table(["method", "feasible / solved / of", *_COLUMNS], rows)


def _title(facts: Mapping[str, Any]) -> str:
    drawn = "anywhere within the limits" if facts["random_ends"] else "like the demonstrations"
    return (
        f"{facts['n_problems']} problems of '{facts['robot']}', {facts['n_joints']} joints, {drawn}"
    )


def _text(facts: Mapping[str, Any]) -> list[str]:
    chosen, missed = facts["ratios_of"], facts["solved_by_bspline_only"]
    methods = _table(facts)
    return [
        _title(facts),
        "",
        *table(methods.rows, header=methods.header).splitlines(),
        "",
        "Medians over the problems that a method calls solved; the worst violation, relative, on "
        "a 0.5 ms grid;",
        "feasible: limits to 1e-6, ends to 1e-3 rad and 1e-2 rad/s; active: a limit is reached on "
        "the way;",
        "from demo: RMS difference from the held-out demonstration; ratios: medians of "
        f"{chosen} over the method.",
        "",
        *(f"{name}: {about}" for name, about in facts["methods"].items()),
        *(f"{name} is absent: {reason}" for name, reason in facts["absent"].items()),
        *(
            f"{name}: of the problems that B-splines solve, {len(problems)} are not solved"
            for name, problems in missed.items()
        ),
    ]


def _draw(
    arguments: argparse.Namespace,
    scene: Scene,
    methods: Sequence[Method],
    results: Sequence[dict[str, PeerResult]],
) -> None:
    clouds = {}
    for method in methods:
        points = []
        for found in results:
            own, reference = found.get(method.name), found["minimum_jerk"].verdict
            if own and own.solved and own.verdict and reference:
                ratio = own.verdict.effort_cost / reference.effort_cost
                points.append((1e3 * own.solve_time, ratio))
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
