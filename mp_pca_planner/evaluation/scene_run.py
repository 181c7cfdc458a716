# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The comparison among obstacles: the planner and peers on the same scenes, and their summary."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from ..arrays import FloatArray
from ..exceptions import MissingDependencyError, PlannerError
from ..motion.collision import CollisionModel
from ..planning.plan import FREE, PlannerOptions
from ..planning.planner import Planner
from ..primitives.build import PrimitiveOptions, build_primitive
from ..robot.world import World
from .check import RefereeOptions, RigidArm, judge
from .method import PeerResult
from .problems import Problem, Scene
from .sampling_peer import SamplingPeer
from .scene_problems import SceneProblem
from .scene_referee import SceneReferee, SceneVerdict

OWN = "pca"
"""Name of the planner of this package in results."""
QUICK = 0.1
"""Time limit of its second run [s]."""
PEERS = {SamplingPeer.name: SamplingPeer}
"""Methods to compare with."""

# Least effort near the expected motion, in the duration of least effort.
_NATURALNESS, _N_COMPONENTS = 0.01, 8
_FACTS = ("solve_time_s", "duration", "effort_cost", "path_length", "rms_jerk", "clearance")


class SceneMethod(Protocol):
    """A method of planning among obstacles, set up for one robot.

    Attributes
    ----------
    name : str
        Its name in tables and JSON.
    about : str
        Description, one sentence.
    """

    name: str
    about: str

    def solve(
        self, start: FloatArray, goal: FloatArray, collides: Callable[[FloatArray], bool]
    ) -> PeerResult:
        """Plan one motion from scratch."""


class OwnMethod:
    """The planner of this package.

    Its time is that of the whole call; the world was set before.

    Parameters
    ----------
    scene : Scene
        Robot, limits and demonstrations.
    collision : CollisionModel
        The model whose world is replaced from problem to problem.
    max_time : float
        Time limit [s].
    name : str
        Its name in tables and JSON.
    """

    def __init__(
        self, scene: Scene, collision: CollisionModel, max_time: float, name: str = OWN
    ) -> None:
        self.name = name
        options = PrimitiveOptions("arm", _N_COMPONENTS)
        primitive = scene.primitive or build_primitive(scene.demonstrations, scene.name, options)
        self.about = (
            f"{primitive.n_components} components of '{primitive.name}', naturalness "
            f"{_NATURALNESS:g}, free duration, within {max_time:g} s"
        )
        self._planner = Planner(
            scene.robot,
            [primitive],
            scene.limits,
            PlannerOptions(naturalness=_NATURALNESS, timing=FREE, max_solve_time=max_time),
            collision,
        )

    def solve(
        self, start: FloatArray, goal: FloatArray, collides: Callable[[FloatArray], bool]
    ) -> PeerResult:
        """Plan one motion."""
        began = time.perf_counter()
        plan = self._planner.plan(goal, start)
        took = time.perf_counter() - began
        if not plan.is_executable:
            return PeerResult(None, took, plan.iterations, plan.message)
        return PeerResult(plan.trajectory, took, plan.iterations)


@dataclass(frozen=True)
class SceneResult:
    """Result of a method for one problem among obstacles.

    Attributes
    ----------
    found : PeerResult
        The motion, with the verdict on limits and effort.
    verdict : SceneVerdict or None
        The verdict on collisions; None without a motion.
    """

    found: PeerResult
    verdict: SceneVerdict | None = None

    @property
    def solved(self) -> bool:
        """Whether the motion reaches the goal without a collision; peers may exceed limits."""
        if self.verdict is None or self.found.verdict is None or self.verdict.collision:
            return False
        error, velocity = self.found.verdict.end_error, self.found.verdict.end_velocity
        tolerated = RefereeOptions()
        return error <= tolerated.position_tolerance and velocity <= tolerated.velocity_tolerance

    @property
    def keeps_limits(self) -> bool:
        """Whether the motion keeps all limits."""
        return self.found.feasible

    def facts(self) -> dict[str, Any]:
        """All values by name."""
        own = {} if self.verdict is None else asdict(self.verdict)
        return self.found.facts() | own | {"solved": self.solved}


SceneResults = Sequence[tuple[SceneProblem, Mapping[str, SceneResult]]]
"""The problems, each with its results by method name."""


def scene_methods(
    scene: Scene, collision: CollisionModel, peers: Iterable[str], max_time: float
) -> tuple[list[SceneMethod], dict[str, str]]:
    """Set up the planner, with `max_time` and with 100 ms if that is longer, and the peers.

    Returns
    -------
    methods : list of SceneMethod
        The planner, then the peers that are installed.
    absent : dict
        Reasons why the others are missing, by name.
    """
    methods: list[SceneMethod] = [OwnMethod(scene, collision, max_time)]
    if max_time > QUICK:
        methods.append(OwnMethod(scene, collision, QUICK, f"{OWN}_{1e3 * QUICK:.0f}ms"))
    absent = {}
    for name in peers:
        try:
            methods.append(PEERS[name](scene.limits, max_time))
        except MissingDependencyError as error:
            absent[name] = str(error)
    return methods, absent


def compare_in_scenes(
    scene: Scene,
    collision: CollisionModel,
    methods: Sequence[SceneMethod],
    problems: Sequence[SceneProblem],
    srdf: Path | None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> list[tuple[SceneProblem, dict[str, SceneResult]]]:
    """Run methods on problems, in an order that alternates from problem to problem.

    Parameters
    ----------
    scene : Scene
        The robot and its limits.
    collision : CollisionModel
        The model that the methods were set up with.
    methods : sequence of SceneMethod
        The methods.
    problems : sequence of SceneProblem
        The problems.
    srdf : Path or None
        File of the pairs of links that are not checked, for the referee.
    progress : callable
        Called with the problems done and their number.
    """
    arm, results = RigidArm(scene.urdf, scene.robot.joint_names), []
    for i, problem in enumerate(problems):
        ends = problem.ends(scene.robot.joint_names)
        collision.set_world(World.from_file(problem.scene))
        referee = SceneReferee(arm, scene.urdf, problem.scene, srdf)
        found = {}
        for method in methods if i % 2 == 0 else methods[::-1]:
            try:
                one = method.solve(*ends, collision.collides)
            except PlannerError as error:
                one = PeerResult(None, float("nan"), status=str(error))
            found[method.name] = _judged(one, ends, arm, scene, referee)
        results.append((problem, {method.name: found[method.name] for method in methods}))
        progress(i + 1, len(problems))
    return results


def _judged(
    found: PeerResult,
    ends: tuple[FloatArray, FloatArray],
    arm: RigidArm,
    scene: Scene,
    referee: SceneReferee,
) -> SceneResult:
    motion = found.trajectory
    if motion is None:
        return SceneResult(found)
    verdict = judge(motion, Problem(*ends, motion.duration), arm, scene.limits)
    return SceneResult(replace(found, verdict=verdict), referee.judge(motion))


def summarise_scenes(results: SceneResults) -> dict[str, dict[str, Any]]:
    """By group and method: shares of solved problems, and medians over those.

    The ratios of effort and jerk are those of the planner to a method on problems that both solve.
    """
    groups = dict.fromkeys(problem.group for problem, _ in results)
    return {
        group: _group_summary([found for problem, found in results if problem.group == group])
        for group in groups
    }


def _group_summary(results: Sequence[Mapping[str, SceneResult]]) -> dict[str, dict[str, Any]]:
    summary = {}
    for name in results[0]:
        of_method = [found[name] for found in results]
        solved = [one for one in of_method if one.solved]
        facts = [one.facts() for one in solved]
        n_quick = sum(x["solve_time_s"] <= QUICK for x in facts)
        times = [one.found.solve_time for one in of_method]
        summary[name] = {
            "n_problems": len(of_method),
            "solved_share": len(solved) / len(of_method),
            "solved_in_100_ms_share": n_quick / len(of_method),
            "n_collisions": sum(
                one.verdict is not None and bool(one.verdict.collision) for one in of_method
            ),
            "limits_kept_share": _share([one.keeps_limits for one in solved]),
            "time_of_all_s": _median(times),
            **{fact: _median([x[fact] for x in facts]) for fact in _FACTS},
            **_against(results, name),
        }
    return summary


def _against(results: Sequence[Mapping[str, SceneResult]], name: str) -> dict[str, Any]:
    """Share of the problems in which the planner needs less effort and less jerk."""
    both = [found for found in results if found[OWN].solved and found[name].solved]
    compared: dict[str, Any] = {}
    for fact in ("effort_cost", "rms_jerk"):
        ratios = [found[OWN].facts()[fact] / found[name].facts()[fact] for found in both]
        compared[f"{fact}_ratio"] = _median(ratios)
        compared[f"{fact}_lower_share"] = _share([ratio < 1.0 for ratio in ratios])
    return compared


def _share(truths: Sequence[bool]) -> float | None:
    return float(np.mean(truths)) if truths else None


def _median(values: Sequence[float]) -> float | None:
    known = [value for value in values if np.isfinite(value)]
    return float(np.median(known)) if known else None
