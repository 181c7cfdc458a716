# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The benchmark: all methods on the same problems, and their comparison."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ..exceptions import PlannerError
from ..motion.collision import CollisionModel
from ..planning.plan import FREE, SHORTEST, PlannerOptions
from ..primitives.build import PrimitiveOptions, build_primitive
from ..robot.world import World
from .methods import (
    BSPLINE,
    Method,
    PeerResult,
    dmp_method,
    minimum_jerk_method,
    planner_method,
    planner_methods,
    promp_method,
)
from .peers import crocoddyl_method, ompl_method, roboplan_method, vamp_method
from .problems import Problem, Scene, SceneProblem
from .referee import RigidArm, SceneReferee, judge

PEERS: dict[str, Callable[[Scene, float], Method]] = {
    "promp": promp_method,
    "dmp": dmp_method,
    "fddp": partial(crocoddyl_method, box=False),
    "box_fddp": partial(crocoddyl_method, box=True),
}
"""Methods to compare the planner with: set up with the scene and a time limit [s]."""
OWN, REFERENCE = "pca", "ompl_toppra"
"""Names of the planner of this package among obstacles, and of the peer it is compared with."""
SCENE_PEERS: dict[str, Callable[[Scene, float, CollisionModel], Method]] = {
    REFERENCE: ompl_method,
    "vamp_toppra": vamp_method,
    "roboplan": roboplan_method,
}
"""Those among obstacles: set up with the collision model, too."""
_FACTS = (
    "solve_time_s",
    "path_time_s",
    "duration",
    "effort_cost",
    "path_length",
    "rms_jerk",
    "clearance",
)


# Likeness to the demonstrations, in the duration of least cost: nearly least effort.
_SCENE_NATURALNESS = 0.01
# Components of the primitive.
_SCENE_N_COMPONENTS = 8
# Time limit of a further run [s].
_SCENE_QUICK = 0.1


Results = Sequence[Mapping[str, PeerResult]]
"""For each problem, the results of the methods that were run on it, by method name."""


def set_up(
    scene: Scene, peers: Iterable[str], max_time: float
) -> tuple[list[Method], dict[str, str]]:
    """Set up the planner's methods and the peers.

    Returns
    -------
    methods : list of Method
        The planner's, the minimum-jerk motion, and the peers that can be set up.
    absent : dict
        Reasons why the other peers can't, by name.
    """
    own = [*planner_methods(scene, max_time), minimum_jerk_method(scene)]
    return _with_peers(own, {name: partial(PEERS[name], scene, max_time) for name in peers})


def set_up_in_scenes(
    scene: Scene, collision: CollisionModel, peers: Iterable[str], max_time: float
) -> tuple[list[Method], dict[str, str]]:
    """Set up the planner with several options, and the peers.

    Its options are those of the benchmark, the defaults of a user, and the shortest duration; with
    a `max_time` above 100 ms, those of the benchmark within 100 ms, too.

    Returns
    -------
    methods, absent :
        As :func:`set_up`.
    """
    size, rho, quick = _SCENE_N_COMPONENTS, _SCENE_NATURALNESS, _SCENE_QUICK
    chosen, usual = (
        scene.primitive or build_primitive(scene.demonstrations, scene.name, options)
        for options in (PrimitiveOptions("arm", size), PrimitiveOptions())
    )
    runs = {OWN: (chosen, PlannerOptions(naturalness=rho, timing=FREE, max_solve_time=max_time))}
    if max_time > quick:
        options = replace(runs[OWN][1], max_solve_time=quick)
        runs[f"{OWN}_{1e3 * quick:.0f}ms"] = chosen, options
    runs[f"{OWN}_default"] = usual, PlannerOptions(max_solve_time=max_time)
    runs[f"{OWN}_shortest"] = usual, PlannerOptions(timing=SHORTEST, max_solve_time=max_time)
    own = [
        planner_method(name, scene, primitive, options, collision)
        for name, (primitive, options) in runs.items()
    ]
    setting = scene, max_time, collision
    return _with_peers(own, {name: partial(SCENE_PEERS[name], *setting) for name in peers})


def _with_peers(
    methods: list[Method], peers: Mapping[str, Callable[[], Method]]
) -> tuple[list[Method], dict[str, str]]:
    """Add the peers that can be set up; reasons why the others can't, by name."""
    absent = {}
    for name, make in peers.items():
        try:
            methods.append(make())
        except PlannerError as error:
            absent[name] = str(error)
    return methods, absent


def compare(
    scene: Scene,
    methods: Sequence[Method],
    problems: Sequence[Problem],
    *,
    repeats: int,
    n_slow: int,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> list[dict[str, PeerResult]]:
    """Run methods on problems, in an order that alternates from repeat to repeat.

    Parameters
    ----------
    scene : Scene
        The robot, limits and demonstrations for which the methods were set up.
    methods : sequence of Method
        The methods.
    problems : sequence of Problem
        The problems.
    repeats : int
        Number of times that each is solved.
    n_slow : int
        Number of problems for slow methods, evenly spread.
    progress : callable
        Called with the problems done and their number.

    Returns
    -------
    results : list of dict
        For each problem, the result of each method that was run on it, by name.
    """
    arm = RigidArm(scene.urdf, scene.robot.joint_names)
    for_slow = np.linspace(0, len(problems) - 1, min(n_slow, len(problems))).round().astype(int)
    results = []
    for i, problem in enumerate(problems):
        chosen = [method for method in methods if not method.slow or i in for_slow]
        found: dict[str, list[PeerResult]] = {method.name: [] for method in chosen}
        for repeat in range(repeats):
            for method in chosen if (i + repeat) % 2 == 0 else chosen[::-1]:
                # A method that has taken 2 s on a problem is not repeated on it.
                if sum(one.solve_time for one in found[method.name]) < 2.0:
                    found[method.name].append(_solve(method, problem))
        results.append({name: _judged(x, problem, arm, scene) for name, x in found.items()})
        progress(i + 1, len(problems))
    return results


def compare_in_scenes(
    scene: Scene,
    collision: CollisionModel,
    methods: Sequence[Method],
    problems: Sequence[SceneProblem],
    srdf: Path | None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> list[dict[str, PeerResult]]:
    """Run methods on problems among obstacles, in an order that alternates between problems.

    Parameters
    ----------
    scene : Scene
        The robot and its limits.
    collision : CollisionModel
        The model that the methods were set up with.
    methods : sequence of Method
        The methods.
    problems : sequence of SceneProblem
        The problems.
    srdf : Path or None
        File of the pairs of links that are not checked, for the referee.
    progress : callable
        Called with the problems done and their number.

    Returns
    -------
    results : list of dict
        For each problem, the result of each method, by name.
    """
    arm, results = RigidArm(scene.urdf, scene.robot.joint_names), []
    for i, one in enumerate(problems):
        problem = Problem(*one.ends(scene.robot.joint_names), float("nan"))
        collision.set_world(World.from_file(one.scene))
        referee = SceneReferee(arm, scene.urdf, one.scene, srdf)
        found = {}
        for method in methods if i % 2 == 0 else methods[::-1]:
            result = _judged([_solve(method, problem)], problem, arm, scene)
            verdict = referee.judge(result.trajectory) if result.trajectory else None
            found[method.name] = replace(result, among_obstacles=verdict)
        results.append({method.name: found[method.name] for method in methods})
        progress(i + 1, len(problems))
    return results


def _solve(method: Method, problem: Problem) -> PeerResult:
    try:
        return method.solve(problem)
    except PlannerError as error:
        return PeerResult(None, float("nan"), status=str(error))


def _judged(
    found: Sequence[PeerResult], problem: Problem, arm: RigidArm, scene: Scene
) -> PeerResult:
    """The repeated solutions of a problem as one result, with the referee's verdict."""
    motion = found[-1].trajectory
    return replace(
        found[-1],
        solve_time=float(np.median([one.solve_time for one in found])),
        verdict=None if motion is None else judge(motion, problem, arm, scene.limits),
    )


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


def summarise_scenes(
    problems: Sequence[SceneProblem], results: Results
) -> dict[str, dict[str, Any]]:
    """By group and method: shares of solved problems, and medians over those.

    The ratios of effort and jerk are those of the planner to a method on problems that both solve;
    the ratios to the reference are those of a method to it.
    """
    groups: dict[str, list[Mapping[str, PeerResult]]] = {}
    for problem, found in zip(problems, results, strict=True):
        groups.setdefault(problem.group, []).append(found)
    return {name: _group_summary(group) for name, group in groups.items()}


def _group_summary(results: Results) -> dict[str, dict[str, Any]]:
    summary = {}
    for name in results[0]:
        of_method = [found[name] for found in results]
        solved = [one for one in of_method if one.avoids_obstacles]
        facts = [one.facts() for one in solved]
        n_quick = sum(x["solve_time_s"] <= _SCENE_QUICK for x in facts)
        collided = [one.among_obstacles for one in of_method if one.solved]
        summary[name] = {
            "n_problems": len(of_method),
            "solved_share": len(solved) / len(of_method),
            "solved_in_100_ms_share": n_quick / len(of_method),
            "n_collisions": sum(
                verdict is not None and verdict.collision != "" for verdict in collided
            ),
            "limits_kept_share": _share([one.feasible for one in solved]),
            "time_of_all_s": _quantile([one.solve_time for one in of_method]),
            **{fact: _quantile([x[fact] for x in facts]) for fact in _FACTS},
            **_against(results, name),
            **_over_reference(results, name),
        }
    return summary


def _against(results: Results, name: str) -> dict[str, Any]:
    """Share of the problems in which the planner needs less effort and less jerk."""
    both = [
        found for found in results if found[OWN].avoids_obstacles and found[name].avoids_obstacles
    ]
    compared: dict[str, Any] = {}
    for fact in ("effort_cost", "rms_jerk"):
        ratios = [found[OWN].facts()[fact] / found[name].facts()[fact] for found in both]
        compared[f"{fact}_ratio"] = _quantile(ratios)
        compared[f"{fact}_lower_share"] = _share([ratio < 1.0 for ratio in ratios])
    return compared


def _over_reference(results: Results, name: str) -> dict[str, Any]:
    """Median effort and duration of a method relative to the reference."""
    both = [
        (found[name].facts(), found[REFERENCE].facts())
        for found in results
        if REFERENCE in found and found[REFERENCE].avoids_obstacles and found[name].avoids_obstacles
    ]
    return {
        f"{fact}_over_{REFERENCE}": _quantile([one[fact] / other[fact] for one, other in both])
        for fact in ("effort_cost", "duration")
    }


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


def unsolved(results: Results, ours: str, other: str = BSPLINE) -> list[int]:
    """Indices of the problems that the other method solves and the planner doesn't."""
    return [
        i
        for i, r in enumerate(results)
        if ours in r and other in r and r[other].feasible and not r[ours].feasible
    ]
