# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""`benchmark`: comparison of components with B-splines and other methods on the same problems."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..arrays import text_table
from ..evaluation.methods import Method
from ..evaluation.problems import (
    DEMONSTRATIONS_SEED,
    HUMAN_ARM,
    Scene,
    demonstrations_in,
    demonstrations_of,
    held_out_problems,
    random_problems,
    requested_ends,
    robot_file,
    robot_of_scene,
    scene_problem,
    scenes_in,
)
from ..evaluation.run import (
    OWN,
    PEERS,
    REFERENCE,
    SCENE_PEERS,
    Results,
    compare,
    ratios,
    set_up,
    summarise,
    summarise_scenes,
    unsolved,
)
from ..exceptions import PlannerError, quote_names, unknown_name
from ..files import config_file
from ..motion.collision import CollisionModel, package_folders
from ..plotting.report import comparison_figure
from ..plotting.style import picture
from ..plotting.text import Table, cells
from ..primitives.library import load_primitives
from ..primitives.primitive import MovementPrimitive
from ..robot.model import Robot
from .common import check_output, progress_bar, report
from .terminal import DONE, written_lines

_COLUMNS = {
    "J": ("effort_cost", ".4g", ""),
    "time [ms]": ("solve_time_s", ".2f", "ms"),
    "99 %": ("solve_time_99_s", ".2f", "ms"),
    "iterations": ("iterations", "g", ""),
    "violation": ("limit_violation", ".1g", ""),
    "active [%]": ("limits_active_share", ".0f", "%"),
    "from demo [°]": ("demo_distance_deg", ".2f", ""),
    "T [s]": ("duration", ".2f", ""),
    "time ratio": ("time_ratio", ".3g", ""),
    "cost ratio": ("cost_ratio", ".3g", ""),
}
_SCENE_COLUMNS = {
    "solved [%]": ("solved_share", ".0f", "%"),
    "in 100 ms [%]": ("solved_in_100_ms_share", ".0f", "%"),
    "collisions": ("n_collisions", "g", ""),
    "limits kept [%]": ("limits_kept_share", ".0f", "%"),
    "all [ms]": ("time_of_all_s", ".0f", "ms"),
    "time [ms]": ("solve_time_s", ".0f", "ms"),
    "path only [ms]": ("path_time_s", ".1f", "ms"),
    "T [s]": ("duration", ".2f", ""),
    "J": ("effort_cost", ".4g", ""),
    "path [rad]": ("path_length", ".2f", ""),
    "jerk [rad/s³]": ("rms_jerk", ".3g", ""),
    "clearance [mm]": ("clearance", ".1f", "mm"),
    "J / OMPL": (f"effort_cost_over_{REFERENCE}", ".2f", ""),
    "T / OMPL": (f"duration_over_{REFERENCE}", ".2f", ""),
    "jerk lower [%]": ("rms_jerk_lower_share", ".0f", "%"),
}


def run(arguments: argparse.Namespace) -> int:
    """Run the command; returns the exit status."""
    facts, notes = (_in_free_space if arguments.scenes is None else _in_scenes)(arguments)
    tables = facts["tables"]
    facts["tables"] = {
        title: {"header": header, "rows": rows} for title, (header, rows) in tables.items()
    }
    lines = []
    for title, (header, rows) in tables.items():
        lines += [title, "", *text_table(rows, header=header).splitlines(), ""]
    lines += [*notes, "", *(f"{name}: {about}" for name, about in facts["methods"].items())]
    lines += [f"{name} is absent: {reason}" for name, reason in facts["absent"].items()]
    report(arguments, facts, *lines, *written_lines([arguments.plot]))
    return DONE


def _in_free_space(arguments: argparse.Namespace) -> tuple[dict[str, Any], list[str]]:
    """Results, and lines of text on them."""
    if arguments.seed == DEMONSTRATIONS_SEED:
        raise PlannerError(f"--seed must not be {arguments.seed}, which chooses the demonstrations")
    check_output(arguments.plot, ".png", force=arguments.force)
    peers = _named_peers(arguments.peers, list(PEERS))
    scene = _scene(arguments, *robot_file(arguments.robot or HUMAN_ARM), arguments.limits)
    draw = random_problems if arguments.random_ends else held_out_problems
    problems = draw(scene, arguments.problems, arguments.seed)
    methods, absent = set_up(scene, peers, arguments.time_limit or 10.0)
    repeats, n_slow = arguments.repeats, arguments.peer_problems
    with progress_bar("planning", "problem") as progress:
        results = compare(
            scene, methods, problems, repeats=repeats, n_slow=n_slow, progress=progress
        )
    if arguments.plot is not None:
        _draw(arguments, scene, methods, results)
    facts = _compared(arguments, scene, methods, absent, results)
    return facts, [
        "Medians over the problems that a method calls solved; the worst violation, relative, on "
        "a 0.5 ms grid;",
        "feasible: limits to 1e-6, ends to 1e-3 rad and 1e-2 rad/s; active: a limit is reached on "
        "the way;",
        "from demo: RMS difference from the held-out demonstration; ratios: medians of "
        f"{facts['ratios_of']} over the method.",
        *(
            f"{name}: of the problems that B-splines solve, {len(indices)} are not solved"
            for name, indices in facts["solved_by_bspline_only"].items()
        ),
    ]


def _named_peers(text: str, known: Sequence[str]) -> list[str]:
    """The methods that an option names: several, "all" or "none".

    Raises
    ------
    PlannerError
        If there is no such method.
    """
    if text in ("all", "none"):
        return list(known) if text == "all" else []
    names = [name.strip() for name in text.split(",")]
    for name in names:
        if name not in known:
            raise PlannerError(unknown_name("peer", name, [*known, "all", "none"]))
    return list(dict.fromkeys(names))


def _compared(
    arguments: argparse.Namespace,
    scene: Scene,
    methods: Sequence[Method],
    absent: Mapping[str, str],
    results: Results,
) -> dict[str, Any]:
    """All results, and the ratios of the planner's methods to the others."""
    names = [method.name for method in methods]
    own = [name for name in names if name.startswith("pca_")]
    compared = {one: {name: ratios(results, one, name) for name in names} for one in own}
    # Other methods have no naturalness term, so all methods minimise the effort alone.
    chosen = next(name for name in own if name.endswith("_effort_only"))
    facts = _facts(scene, methods, absent, results) | {
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
        "random_ends": arguments.random_ends,
    }
    drawn = "anywhere within the limits" if arguments.random_ends else "like the demonstrations"
    title = f"{_title(facts)}, {drawn}"
    facts["tables"] = {title: _table(facts["summary"], compared[chosen])}
    return facts


def _in_scenes(arguments: argparse.Namespace) -> tuple[dict[str, Any], list[str]]:
    """Results among obstacles, and lines of text on them."""
    if arguments.plot is not None or arguments.random_ends:
        raise PlannerError("--plot and --random-ends are not accepted with --scenes: remove them")
    peers = _named_peers(arguments.peers, list(SCENE_PEERS))
    max_time = arguments.time_limit or 1.0
    files = scenes_in(arguments.scenes, arguments.problems)
    urdf = Path(arguments.robot) if arguments.robot else robot_of_scene(files[0])
    start, goal = requested_ends(files[0])
    joints = [name for name in start if name in goal]
    limits = arguments.limits or _shipped_limits(urdf.stem)
    scene = _scene(arguments, urdf.stem, urdf, joints, limits)
    srdf = urdf.with_suffix(".srdf") if urdf.with_suffix(".srdf").is_file() else None
    folders = package_folders([urdf.parent], urdf)
    scene = replace(scene, collision=CollisionModel(scene.robot, srdf=srdf, package_dirs=folders))
    problems = [scene_problem(file, scene.robot.joint_names) for file in files]
    methods, absent = set_up(scene, peers, max_time)
    with progress_bar("planning", "problem") as progress:
        results = compare(scene, methods, problems, srdf=srdf, progress=progress)
    summaries = summarise_scenes(problems, results)
    facts = _facts(scene, methods, absent, results) | {
        "time_limit_s": max_time,
        "summary": summaries,
        "tables": {
            group: (
                ["method", *_SCENE_COLUMNS],
                [[name, *cells(values, _SCENE_COLUMNS)] for name, values in summary.items()],
            )
            for group, summary in summaries.items()
        },
    }
    for file, found in zip(files, facts["problems"], strict=True):
        found |= {"group": file.parent.name, "number": file.stem.removeprefix("scene")}
    return facts, [
        f"{_title(facts)}, within {max_time:g} s",
        "",
        "By the referee: solved: reaches the goal without a collision on a 1 ms grid. Medians over",
        "the solved problems; 'all' over all. J and T / OMPL: medians of the method over "
        f"{REFERENCE},",
        f"'jerk lower': share of the problems in which {OWN} has less; both where both solve.",
    ]


def _scene(
    arguments: argparse.Namespace,
    name: str,
    urdf: Path,
    usual_joints: Sequence[str] | None,
    limits_file: Path | None,
) -> Scene:
    """The robot, and the motions of a primitive or generated ones."""
    primitive = None
    if arguments.primitives is not None:
        if arguments.joints is not None:
            raise PlannerError(
                "--joints is not accepted with --primitives, which determine the joints"
            )
        primitive = _only_primitive(arguments.primitives)
    joints = primitive.joint_names if primitive else arguments.joints or usual_joints
    robot = Robot.from_file(urdf, joints)
    limits = robot.limits(limits_file or {})
    motions = demonstrations_in(primitive) if primitive else demonstrations_of(name, robot, limits)
    return Scene(name, urdf, robot, limits, tuple(motions), primitive)


def _only_primitive(path: Path) -> MovementPrimitive:
    primitives = load_primitives([path])
    if len(primitives) != 1:
        found = quote_names(primitives.names)
        raise PlannerError(f"--primitives must be one primitive, but there are {found}")
    return primitives[0]


def _shipped_limits(name: str) -> Path | None:
    """Limits of accelerations and jerks, if the package ships some for a robot of this name."""
    try:
        return config_file(f"{name}_joint_limits.yaml")
    except PlannerError:
        return None


def _facts(
    scene: Scene, methods: Sequence[Method], absent: Mapping[str, str], results: Results
) -> dict[str, Any]:
    return {
        "robot": scene.name,
        "n_joints": scene.robot.n_joints,
        "n_problems": len(results),
        "methods": {method.name: method.about for method in methods},
        "absent": absent,
        "problems": [{name: result.facts() for name, result in found.items()} for found in results],
    }


def _title(facts: Mapping[str, Any]) -> str:
    return f"{facts['n_problems']} problems of '{facts['robot']}', {facts['n_joints']} joints"


def _table(summaries: Mapping[str, Any], compared: Mapping[str, Any]) -> Table:
    """The methods, one in each row."""
    rows = []
    for name, summary in summaries.items():
        values = summary | compared[name]
        counts = f"{values['n_feasible']} / {values['n_solved']} / {values['n_problems']}"
        rows.append([name, counts, *cells(values, _COLUMNS)])
    return ["method", "feasible / solved / of", *_COLUMNS], rows


def _draw(
    arguments: argparse.Namespace, scene: Scene, methods: Sequence[Method], results: Results
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
