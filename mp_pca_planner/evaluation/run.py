# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Run all methods on the same problems, and compare them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ..arrays import FloatArray
from ..exceptions import MissingDependencyError, PlannerError
from .check import RigidArm, Verdict, judge
from .collocation import SequentialLeastSquares
from .drake_optimization import DrakeOptimization
from .method import SOLVED, Answer, Method
from .optimal_control import DifferentialDynamicProgramming
from .own import BSPLINE, planner_methods
from .problems import Problem, Scene
from .without_optimisation import (
    DynamicPrimitive,
    MinimumJerk,
    ProbabilisticPrimitive,
    TimeOptimal,
)

Progress = Callable[[int, int], None]

PEERS: dict[str, Callable[[Scene, float], Method]] = {
    "promp": lambda scene, _: ProbabilisticPrimitive(scene),
    "dmp": lambda scene, _: DynamicPrimitive(scene),
    "fddp": lambda scene, time: DifferentialDynamicProgramming(scene, time, box=False),
    "box_fddp": lambda scene, time: DifferentialDynamicProgramming(scene, time, box=True),
    "slsqp_differences": lambda scene, time: SequentialLeastSquares(scene, time, differences=True),
    "slsqp_gradients": lambda scene, time: SequentialLeastSquares(scene, time, differences=False),
    "drake": DrakeOptimization,
    "ruckig": lambda scene, _: TimeOptimal(scene),
}
"""What the planner can be compared with: set up with the scene and a time limit [s]."""

# A method that has taken this long on one problem [s] is not repeated on it.
_ENOUGH_TIME = 2.0


@dataclass(frozen=True, eq=False)
class Result:
    """One method on one problem.

    Attributes
    ----------
    solve_time : float
        Median over the repeats [s].
    answer : Answer
        The answer of the last repeat.
    verdict : Verdict or None
        What the referee says of its motion, if there is one.
    """

    solve_time: float
    answer: Answer
    verdict: Verdict | None

    @property
    def feasible(self) -> bool:
        """Whether there is a motion that the referee accepts."""
        return self.verdict is not None and self.verdict.feasible

    @property
    def solved(self) -> bool:
        """Whether the method calls its motion solved, whatever the referee says."""
        return self.verdict is not None and self.answer.status == SOLVED

    def facts(self) -> dict[str, Any]:
        """The result by the names of the package's public interface."""
        verdict = {} if self.verdict is None else asdict(self.verdict)
        return {
            "effort_cost": None,
            "solve_time_s": self.solve_time,
            "iterations": self.answer.iterations,
            "feasible": self.feasible,
            "status": self.answer.status,
            **verdict,
        }


def set_up(
    scene: Scene, peers: Iterable[str], max_time: float
) -> tuple[list[Method], dict[str, str]]:
    """Set up the planner's methods and the peers.

    Returns
    -------
    methods : list of Method
        Those that there are: the planner's, the minimum-jerk motion, and the peers.
    absent : dict
        Why the others are not, by name.
    """
    methods: list[Method] = [*planner_methods(scene, max_time), MinimumJerk(scene)]
    absent = {}
    for name in peers:
        try:
            methods.append(PEERS[name](scene, max_time))
        except MissingDependencyError as error:
            absent[name] = str(error)
    return methods, absent


def compare(
    scene: Scene,
    methods: Sequence[Method],
    problems: Sequence[Problem],
    *,
    repeats: int,
    n_slow: int,
    progress: Progress = lambda done, total: None,
) -> list[dict[str, Result]]:
    """Run methods on problems, in an order that alternates from repeat to repeat.

    Parameters
    ----------
    scene : Scene
        What the methods were set up with.
    methods : sequence of Method
        The methods.
    problems : sequence of Problem
        The problems.
    repeats : int
        Times that each is solved.
    n_slow : int
        Problems that slow methods get, evenly spread.
    progress : callable
        Called with the problems done and their number.

    Returns
    -------
    results : list of dict
        For each problem, the result of each method that was run on it, by name.
    """
    arm = RigidArm(scene.urdf, scene.robot.joint_names)
    for_slow = set(
        np.linspace(0, len(problems) - 1, min(n_slow, len(problems))).round().astype(int)
    )
    results = []
    for i, problem in enumerate(problems):
        chosen = [method for method in methods if not method.slow or i in for_slow]
        answers: dict[str, list[Answer]] = {method.name: [] for method in chosen}
        for repeat in range(repeats):
            for method in chosen if (i + repeat) % 2 == 0 else chosen[::-1]:
                so_far = answers[method.name]
                if sum(answer.solve_time for answer in so_far) < _ENOUGH_TIME:
                    so_far.append(_answer(method, problem))
        results.append(
            {name: _result(found, problem, arm, scene) for name, found in answers.items()}
        )
        progress(i + 1, len(problems))
    return results


def _answer(method: Method, problem: Problem) -> Answer:
    try:
        return method.solve(problem)
    except PlannerError as error:
        return Answer(None, float("nan"), status=str(error))


def _result(answers: Sequence[Answer], problem: Problem, arm: RigidArm, scene: Scene) -> Result:
    time = float(np.median([answer.solve_time for answer in answers]))
    last = answers[-1]
    verdict = None
    if last.trajectory is not None:
        verdict = judge(last.trajectory, problem, arm, scene.limits)
    return Result(time, last, verdict)


def summarise(results: Sequence[dict[str, Result]], names: Sequence[str]) -> dict[str, Any]:
    """Medians of each method, by name; of costs and violations over what it calls solved."""
    return {name: _summary([r[name] for r in results if name in r]) for name in names}


def _summary(results: Sequence[Result]) -> dict[str, Any]:
    times = np.array([r.solve_time for r in results])
    solved = [r for r in results if r.solved]
    verdicts = [r.verdict for r in solved if r.verdict is not None]
    return {
        "n_problems": len(results),
        "n_solved": len(solved),
        "n_feasible": sum(r.feasible for r in results),
        "solve_time_s": _quantile(times, 0.5),
        "solve_time_99_s": _quantile(times, 0.99),
        "iterations": _quantile(np.array([float(r.answer.iterations) for r in solved]), 0.5),
        "effort_cost": _quantile(np.array([v.effort_cost for v in verdicts]), 0.5),
        "duration": _quantile(np.array([v.duration for v in verdicts]), 0.5),
        "limit_violation": max((v.limit_violation for v in verdicts), default=None),
        "end_error": max((v.end_error for v in verdicts), default=None),
        "end_velocity": max((v.end_velocity for v in verdicts), default=None),
        "limits_active_share": float(np.mean([v.limits_active for v in verdicts]))
        if verdicts
        else None,
        "demo_distance_deg": _quantile(np.array([v.demo_distance_deg for v in verdicts]), 0.5),
    }


def _quantile(values: FloatArray, share: float) -> float | None:
    known = values[np.isfinite(values)]
    return float(np.quantile(known, share)) if known.size else None


def ratios(results: Sequence[dict[str, Result]], ours: str, other: str) -> dict[str, float | None]:
    """Compare two methods on the problems that both solve, ours within the limits.

    Returns
    -------
    ratios : dict
        Medians of `time_ratio` and `cost_ratio`, ours over the other's; None if there is no
        such problem.
    """
    times, costs = [], []
    for r in results:
        if ours not in r or other not in r or not r[ours].feasible or not r[other].solved:
            continue
        one, two = r[ours], r[other]
        times.append(one.solve_time / two.solve_time)
        if one.verdict is not None and two.verdict is not None:
            costs.append(one.verdict.effort_cost / two.verdict.effort_cost)
    return {
        "time_ratio": _quantile(np.array(times), 0.5),
        "cost_ratio": _quantile(np.array(costs), 0.5),
    }


def unsolved(results: Sequence[dict[str, Result]], ours: str, other: str = BSPLINE) -> list[int]:
    """Problems that the other method solves and ours doesn't."""
    return [
        i
        for i, r in enumerate(results)
        if ours in r and other in r and r[other].feasible and not r[ours].feasible
    ]
