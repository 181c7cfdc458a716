# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Comparison of components with B-splines of 6 control points and other methods.

All methods solve the same problems, generated ones or those of MotionBenchMaker among obstacles,
and a referee judges their motions ([P] Table 3).

    python3 benchmarks/compare.py [--robot panda] [--scenes DIR] [--problems 200] [--json]
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from methods import (
    Method,
    PeerResult,
    dmp_method,
    minimum_jerk_method,
    planner_method,
    planner_methods,
    promp_method,
)
from peers import crocoddyl_method, ompl_method
from scenes import (
    demonstrations_in,
    own_problems,
    requested_ends,
    robot_of_scene,
    scene_problem,
    scenes_in,
)
from support.motion_referee import RigidArm, SceneReferee, judge
from support.problems import Problem, Scene, random_problems
from support.tables import Table, benchmark_parser, show

from mp_pca_planner.cli.common import progress_bar
from mp_pca_planner.cli.example_robots import (
    DEMONSTRATIONS_SEED,
    demonstrations_of,
)
from mp_pca_planner.exceptions import PlannerError, RobotError, quote_names, unknown_name
from mp_pca_planner.files import config_file
from mp_pca_planner.motion.collision import CollisionModel
from mp_pca_planner.planning.options import SHORTEST, PlannerOptions
from mp_pca_planner.primitives.build import build_primitive
from mp_pca_planner.primitives.library import load_primitives
from mp_pca_planner.primitives.primitive import MovementPrimitive
from mp_pca_planner.robot.examples import EXAMPLE_ROBOTS, HUMAN_ARM, example_file
from mp_pca_planner.robot.meshes import package_folders
from mp_pca_planner.robot.model import Robot
from mp_pca_planner.robot.world import World

Peer = Callable[[Scene, float], Method]
"""Sets a method of others up, with a time limit [s]."""
OWN, REFERENCE = "pca", "ompl_toppra"
"""Names of the planner of this package among obstacles, and of the peer it is compared with."""
PEERS: dict[str, Peer] = {
    "promp": promp_method,
    "dmp": dmp_method,
    "fddp": crocoddyl_method,
}
"""Methods to compare the planner with."""
SCENE_PEERS: dict[str, Peer] = {REFERENCE: ompl_method}
"""Those among obstacles."""
_FACTS = (
    "solve_time_s",
    "path_time_s",
    "duration",
    "effort_cost",
    "path_length",
    "rms_jerk",
    "clearance",
)


QUICK = 0.1
"""Time limit of a further run of the planner among obstacles [s]."""

Results = Sequence[Mapping[str, PeerResult]]
"""For each problem, the results of the methods that were run on it, by method name."""


def set_up(
    scene: Scene, peers: Iterable[str], max_time: float
) -> tuple[list[Method], dict[str, str]]:
    """Set up the planner's methods and the peers.

    Returns
    -------
    methods : list of Method
        The planner's, without obstacles the minimum-jerk motion, and the peers that can be set up.
    absent : dict
        Reasons why the other peers can't, by name.
    """
    if scene.collision is None:
        known, methods = PEERS, [*planner_methods(scene, max_time), minimum_jerk_method(scene)]
    else:
        known, methods = SCENE_PEERS, _planner_in_scenes(scene, max_time)
    absent = {}
    for name in peers:
        try:
            methods.append(known[name](scene, max_time))
        except PlannerError as error:
            absent[name] = str(error)
    return methods, absent


def _planner_in_scenes(scene: Scene, max_time: float) -> list[Method]:
    """The planner with a user's defaults, also within 100 ms, and with the shortest duration."""
    primitive = scene.primitive or build_primitive(scene.demonstrations, scene.name)
    usual = PlannerOptions(max_solve_time=max_time)
    return [
        planner_method(name, scene, primitive, options)
        for name, options in (
            (OWN, usual),
            (f"{OWN}_{1e3 * QUICK:.0f}ms", replace(usual, max_solve_time=QUICK)),
            (f"{OWN}_{SHORTEST}", replace(usual, timing=SHORTEST)),
        )
    ]


def compare(
    scene: Scene,
    methods: Sequence[Method],
    problems: Sequence[Problem],
    *,
    n_slow: int = 0,
    srdf: Path | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> list[dict[str, PeerResult]]:
    """Run methods on problems, in an order that alternates.

    Parameters
    ----------
    scene : Scene
        The robot, limits and demonstrations for which the methods were set up.
    methods : sequence of Method
        The methods.
    problems : sequence of Problem
        The problems.
    n_slow : int
        Number of problems for slow methods, evenly spread.
    srdf : Path, optional
        File of the pairs of links that are not checked, for the referee.
    progress : callable
        Called with the problems done and their number.

    Returns
    -------
    results : list of dict
        For each problem, the result of each method that was run on it, by name.
    """
    arm, surroundings = RigidArm(scene.urdf, scene.robot.joint_names), None
    for_slow = np.linspace(0, len(problems) - 1, min(n_slow, len(problems))).round().astype(int)
    results = []
    for i, problem in enumerate(problems):
        if scene.collision is not None and problem.scene is not None:
            scene.collision.set_world(World.from_file(problem.scene))
            surroundings = SceneReferee(arm, scene.urdf, problem.scene, srdf)
        chosen = [method for method in methods if not method.slow or i in for_slow]
        judged: dict[str, PeerResult] = {}
        for method in chosen if i % 2 == 0 else chosen[::-1]:
            found = _solve(method, problem)
            if found.trajectory is not None:
                verdict = judge(found.trajectory, problem, arm, scene.limits, surroundings)
                found = replace(found, verdict=verdict)
            judged[method.name] = found
        results.append(judged)
        progress(i + 1, len(problems))
    return results


def _solve(method: Method, problem: Problem) -> PeerResult:
    try:
        return method.solve(problem)
    except PlannerError as error:
        return PeerResult(None, float("nan"), status=str(error))


def summarise(results: Results, names: Sequence[str]) -> dict[str, Any]:
    """Medians by method name; costs and violations over problems that it reports as solved."""
    return {name: _summary([r[name] for r in results if name in r]) for name in names}


def _summary(results: Sequence[PeerResult]) -> dict[str, Any]:
    times = [r.solve_time for r in results]
    solved = [r for r in results if r.solved]
    verdicts = [r.verdict for r in solved if r.verdict is not None]
    medians = ("effort_cost", "duration", "demo_distance_deg")
    worst = ("limit_violation", "end_error", "end_velocity")
    return {
        "n_problems": len(results),
        "n_solved": len(solved),
        "n_feasible": sum(r.feasible for r in results),
        "solve_time_s": _quantile(times),
        "solve_time_99_s": _quantile(times, 0.99),
        "iterations": _quantile([r.iterations for r in solved]),
        **{name: _quantile([getattr(v, name) for v in verdicts]) for name in medians},
        **{name: max((getattr(v, name) for v in verdicts), default=None) for name in worst},
        "limits_active_share": _share([v.limits_active for v in verdicts]),
    }


def _quantile(values: Sequence[float], share: float = 0.5) -> float | None:
    known = [value for value in values if np.isfinite(value)]
    return float(np.quantile(known, share)) if known else None


def summarise_scenes(problems: Sequence[Problem], results: Results) -> dict[str, dict[str, Any]]:
    """By folder and method: shares of solved problems, and medians over those.

    "Jerk lower" and the ratios to the reference are of problems that both methods solve.
    """
    groups: dict[str, list[Mapping[str, PeerResult]]] = {}
    for problem, found in zip(problems, results, strict=True):
        assert problem.scene is not None
        groups.setdefault(problem.scene.parent.name, []).append(found)
    return {
        group: {name: _summary_in_scenes(found, name) for name in found[0]}
        for group, found in groups.items()
    }


def _summary_in_scenes(results: Results, name: str) -> dict[str, Any]:
    of_method = [found[name] for found in results]
    facts = [one.facts() for one in of_method]
    solved = [one for one in facts if one["solved"]]
    found = {
        "n_problems": len(facts),
        "solved_share": len(solved) / len(facts),
        "solved_in_100_ms_share": sum(x["solve_time_s"] <= QUICK for x in solved) / len(facts),
        "n_collisions": sum(one.solved and one.facts()["collision"] != "" for one in of_method),
        "limits_kept_share": _share([one["feasible"] for one in solved]),
        "time_of_all_s": _quantile([one["solve_time_s"] for one in facts]),
        **{fact: _quantile([x[fact] for x in solved]) for fact in _FACTS},
    }
    jerks = _ratios_in_scenes(results, OWN, name, "rms_jerk")
    found["rms_jerk_lower_share"] = _share([ratio < 1.0 for ratio in jerks])
    for fact in ("effort_cost", "duration"):
        ratios = _ratios_in_scenes(results, name, REFERENCE, fact)
        found[f"{fact}_over_{REFERENCE}"] = _quantile(ratios)
    return found


def _ratios_in_scenes(results: Results, one: str, other: str, fact: str) -> list[float]:
    """Ratios of a quantity of two methods, on the problems that both solve."""
    return [
        found[one].facts()[fact] / found[other].facts()[fact]
        for found in results
        if other in found and found[one].arrived and found[other].arrived
    ]


def _share(truths: Sequence[bool]) -> float | None:
    return float(np.mean(truths)) if truths else None


def ratios(results: Results, ours: str, other: str) -> dict[str, float | None]:
    """Compare two methods on the problems that both solve, the planner's motion within the limits.

    Returns
    -------
    ratios : dict
        Medians of `time_ratio` and `cost_ratio`, the planner's over the other's; None if there is
        no such problem.
    """
    times, costs = [], []
    for found in results:
        one, two = found.get(ours), found.get(other)
        if one is None or two is None or one.verdict is None or two.verdict is None:
            continue
        if one.feasible and two.solved:
            times.append(one.solve_time / two.solve_time)
            costs.append(one.verdict.effort_cost / two.verdict.effort_cost)
    return {"time_ratio": _quantile(times), "cost_ratio": _quantile(costs)}


Column = tuple[str, str, str]
"""Name of a value, its format, and its unit in the table if that is not the SI unit."""


def cells(values: Mapping[str, float | None], columns: Mapping[str, Column]) -> list[str]:
    """Values of a row as text, one for each column by its header; a dash for None."""
    factors = {"": 1.0, "%": 100.0, "ms": 1e3, "mm": 1e3, "mrad": 1e3}
    chosen = [(values[name], form, factors[unit]) for name, form, unit in columns.values()]
    return ["–" if x is None else format(factor * x, form) for x, form, factor in chosen]


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


def _robot_file(name: str) -> tuple[str, Path, tuple[str, ...] | None]:
    """Name, URDF file and joints of an example, or of the robot of a URDF file."""
    if name in EXAMPLE_ROBOTS:
        return name, *example_file(name)
    if not Path(name).is_file():
        known = quote_names(EXAMPLE_ROBOTS)
        raise RobotError(f"the robot '{name}' is neither a URDF file nor one of {known}")
    return Path(name).stem, Path(name), None


def main() -> int:
    """Compare the methods; returns the exit status."""
    parser = benchmark_parser(__doc__)
    parser.add_argument(
        "--robot",
        metavar="NAME|URDF",
        help=f"URDF file, or one of {', '.join(EXAMPLE_ROBOTS)} (default: "
        f"{HUMAN_ARM}, or the robot of --scenes)",
    )
    parser.add_argument("--limits", type=Path, metavar="FILE.yaml", help="MoveIt's joint_limits")
    parser.add_argument(
        "--primitives", type=Path, metavar="FILE", help="instead of generated motions"
    )
    parser.add_argument("--scenes", type=Path, metavar="DIR", help="MotionBenchMaker's problems")
    parser.add_argument("--problems", type=int, default=200, help="with --scenes, of each set")
    parser.add_argument("--random-ends", action="store_true", help="anywhere within the limits")
    parser.add_argument("--seed", type=int, default=2, help="of the problems")
    peers = ", ".join([*PEERS, *SCENE_PEERS])
    parser.add_argument("--peers", default="all", help=f"all, none, or some of {peers}")
    parser.add_argument("--peer-problems", type=int, default=10, help="for slow peers")
    parser.add_argument("--time-limit", type=float, help="[s]; 10, or 1 with --scenes")
    arguments = parser.parse_args()
    try:
        facts, notes = (_in_free_space if arguments.scenes is None else _in_scenes)(arguments)
    except PlannerError as error:
        parser.error(str(error))
    about = [f"{name}: {text}" for name, text in facts["methods"].items()]
    about += [f"{name} is absent: {reason}" for name, reason in facts["absent"].items()]
    show(facts.pop("tables"), as_json=arguments.json, facts=facts, notes=[*notes, "", *about])
    return 0


def _in_free_space(arguments: argparse.Namespace) -> tuple[dict[str, Any], list[str]]:
    """Results, and lines of text on them."""
    if arguments.seed == DEMONSTRATIONS_SEED:
        raise PlannerError(f"--seed must not be {arguments.seed}, which chooses the demonstrations")
    peers = _named_peers(arguments.peers, list(PEERS))
    scene = _scene(arguments, *_robot_file(arguments.robot or HUMAN_ARM), arguments.limits)
    draw = random_problems if arguments.random_ends else own_problems
    problems = draw(scene, arguments.problems, arguments.seed)
    methods, absent = set_up(scene, peers, arguments.time_limit or 10.0)
    n_slow = arguments.peer_problems
    with progress_bar("planning", "problem") as progress:
        results = compare(scene, methods, problems, n_slow=n_slow, progress=progress)
    facts = _compared(arguments, scene, methods, absent, results)
    return facts, [
        "Medians over the problems that a method calls solved; the worst violation, relative, on "
        "a 0.5 ms grid;",
        "feasible: limits to 1e-6, ends to 1e-3 rad and 1e-2 rad/s; active: a limit is reached on "
        "the way;",
        "from demo: RMS difference from the held-out demonstration; ratios: medians of "
        f"{facts['ratios_of']} over the method.",
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
    # Other methods have no naturalness term, so all methods minimise the effort alone.
    chosen = next(name for name in own if name.endswith("_effort_only"))
    compared = {name: ratios(results, chosen, name) for name in names}
    facts = _facts(scene, methods, absent, results) | {
        "ratios_of": chosen,
    }
    drawn = "anywhere within the limits" if arguments.random_ends else "like the demonstrations"
    title = f"{_title(facts)}, {drawn}"
    facts["tables"] = {title: _table(summarise(results, names), compared)}
    return facts


def _in_scenes(arguments: argparse.Namespace) -> tuple[dict[str, Any], list[str]]:
    """Results among obstacles, and lines of text on them."""
    if arguments.random_ends:
        raise PlannerError("--random-ends is not accepted with --scenes: remove it")
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
        primitive = _only_primitive(arguments.primitives)
    joints = primitive.joint_names if primitive else usual_joints
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


if __name__ == "__main__":
    sys.exit(main())
