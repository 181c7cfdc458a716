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
from .problems import Problem, Scene
from .referee import RigidArm, SceneReferee, judge

Peer = Callable[[Scene, float], Method]
"""Sets a method of others up, with a time limit [s]."""
OWN, REFERENCE = "pca", "ompl_toppra"
"""Names of the planner of this package among obstacles, and of the peer it is compared with."""
PEERS: dict[str, Peer] = {
    "promp": promp_method,
    "dmp": dmp_method,
    "fddp": partial(crocoddyl_method, box=False),
    "box_fddp": partial(crocoddyl_method, box=True),
}
"""Methods to compare the planner with."""
SCENE_PEERS: dict[str, Peer] = {
    REFERENCE: ompl_method,
    "vamp_toppra": vamp_method,
    "roboplan": roboplan_method,
}
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
    """The planner with the options of the benchmark, a user's defaults and the shortest duration.

    With a `max_time` above 100 ms, also with the options of the benchmark within 100 ms.
    """
    size, rho, quick = _SCENE_N_COMPONENTS, _SCENE_NATURALNESS, _SCENE_QUICK
    chosen, usual = (
        scene.primitive or build_primitive(scene.demonstrations, scene.name, options)
        for options in (PrimitiveOptions("arm", size), PrimitiveOptions())
    )
    own = PlannerOptions(naturalness=rho, timing=FREE, max_solve_time=max_time)
    methods = [planner_method(OWN, scene, chosen, own)]
    if max_time > quick:
        name, own = f"{OWN}_{1e3 * quick:.0f}ms", replace(own, max_solve_time=quick)
        methods.append(planner_method(name, scene, chosen, own))
    for name, timing in (("default", PlannerOptions.timing), (SHORTEST, SHORTEST)):
        options = PlannerOptions(timing=timing, max_solve_time=max_time)
        methods.append(planner_method(f"{OWN}_{name}", scene, usual, options))
    return methods


def compare(
    scene: Scene,
    methods: Sequence[Method],
    problems: Sequence[Problem],
    *,
    repeats: int = 1,
    n_slow: int = 0,
    srdf: Path | None = None,
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
        found: dict[str, list[PeerResult]] = {method.name: [] for method in chosen}
        for repeat in range(repeats):
            for method in chosen if (i + repeat) % 2 == 0 else chosen[::-1]:
                # A method that has taken 2 s on a problem is not repeated on it.
                if sum(one.solve_time for one in found[method.name]) < 2.0:
                    found[method.name].append(_solve(method, problem))
        judged: dict[str, PeerResult] = {}
        for name, repeated in found.items():
            motion = repeated[-1].trajectory
            judged[name] = replace(
                repeated[-1],
                solve_time=float(np.median([one.solve_time for one in repeated])),
                verdict=None
                if motion is None
                else judge(motion, problem, arm, scene.limits, surroundings),
            )
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

    The ratios of effort and jerk are those of the planner to a method on problems that both solve;
    the ratios to the reference are those of a method to it.
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
        "solved_in_100_ms_share": sum(x["solve_time_s"] <= _SCENE_QUICK for x in solved)
        / len(facts),
        "n_collisions": sum(one.solved and one.facts()["collision"] != "" for one in of_method),
        "limits_kept_share": _share([one["feasible"] for one in solved]),
        "time_of_all_s": _quantile([one["solve_time_s"] for one in facts]),
        **{fact: _quantile([x[fact] for x in solved]) for fact in _FACTS},
    }
    for fact in ("effort_cost", "rms_jerk"):
        ratios = _ratios_in_scenes(results, OWN, name, fact)
        found[f"{fact}_ratio"] = _quantile(ratios)
        found[f"{fact}_lower_share"] = _share([ratio < 1.0 for ratio in ratios])
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


def unsolved(results: Results, ours: str, other: str = BSPLINE) -> list[int]:
    """Indices of the problems that the other method solves and the planner doesn't."""
    return [
        i
        for i, r in enumerate(results)
        if ours in r and other in r and r[other].feasible and not r[ours].feasible
    ]
