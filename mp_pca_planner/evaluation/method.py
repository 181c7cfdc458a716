# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Methods of the benchmark: their interface, and the planner of this package."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ..motion.collision import CollisionModel
from ..motion.goal import JointGoal, JointState
from ..motion.trajectory import Trajectory
from ..planning.plan import FREE, PlannerOptions
from ..planning.planner import Planner
from ..primitives.build import PrimitiveOptions, build_primitive
from ..primitives.primitive import MovementPrimitive
from .check import REFEREE, Verdict
from .problems import Problem, Scene
from .scene_referee import SceneVerdict

SOLVED = "solved"
BSPLINE = "bspline"


@dataclass(frozen=True, eq=False)
class PeerResult:
    """Result of a method for one problem.

    Repeated solutions make one result, with the median time of all and the rest of the last one.

    Attributes
    ----------
    trajectory : Trajectory or None
        The motion, whether it keeps the limits or not; None if there is none.
    solve_time : float
        Time to find it [s], as the method defines it.
    iterations : int
        Iterations of its optimisation, 0 if it has none.
    status : str
        The status that the method reports: 'solved', or the reason of its failure.
    verdict : Verdict or None
        The referee's verdict on the motion, once there is one.
    among_obstacles : SceneVerdict or None
        The verdict on its collisions, if there are obstacles.
    path_time : float
        The part of the time in which a path was searched [s]; NaN without such a part.
    """

    trajectory: Trajectory | None
    solve_time: float
    iterations: int = 0
    status: str = SOLVED
    verdict: Verdict | None = None
    among_obstacles: SceneVerdict | None = None
    path_time: float = float("nan")

    @property
    def feasible(self) -> bool:
        """Whether there is a motion that the referee accepts."""
        return self.verdict is not None and self.verdict.feasible

    @property
    def solved(self) -> bool:
        """Whether there is a motion that the method itself reports as solved."""
        return self.verdict is not None and self.status == SOLVED

    @property
    def avoids_obstacles(self) -> bool:
        """Whether the motion reaches the goal without a collision; peers may exceed limits."""
        if not self.solved or self.among_obstacles is None or self.verdict is None:
            return False
        return (
            not self.among_obstacles.collision
            and self.verdict.end_error <= REFEREE.position_tolerance
            and self.verdict.end_velocity <= REFEREE.velocity_tolerance
        )

    def facts(self) -> dict[str, Any]:
        """The result by the names of the package's public interface."""
        obstacles = self.among_obstacles
        return {
            "effort_cost": None,
            "solve_time_s": self.solve_time,
            "iterations": self.iterations,
            "feasible": False,
            "status": self.status,
            **({} if self.verdict is None else asdict(self.verdict)),
            **({} if obstacles is None else {**asdict(obstacles), "solved": self.avoids_obstacles}),
            "path_time_s": self.path_time,
        }


@dataclass(frozen=True, eq=False)
class Method:
    """A planning method, set up for one robot, its limits and demonstrations.

    Attributes
    ----------
    name : str
        Its name in tables and JSON.
    about : str
        Description of the method and its setup, one sentence.
    solve : callable
        Solves one problem from scratch.
    slow : bool
        Whether the method is run on a subset of the problems only.
    """

    name: str
    about: str
    solve: Callable[[Problem], PeerResult]
    slow: bool = False


def planner_method(
    name: str,
    scene: Scene,
    primitive: MovementPrimitive,
    options: PlannerOptions,
    collision: CollisionModel | None = None,
) -> Method:
    """The planner with one basis and naturalness.

    Its solve time is the planner's: it includes attempts that failed the limits, but neither the
    last check of the motion nor the preparation of the primitive. Among obstacles it is that of
    the whole call; the world was set before.
    """
    names = scene.robot.joint_names
    planner = Planner(scene.robot, [primitive], scene.limits, options, collision)

    def solve(problem: Problem) -> PeerResult:
        """Plan one motion."""
        began = time.perf_counter()
        duration = None if np.isnan(problem.duration) else problem.duration
        goal = JointGoal(JointState(names, problem.goal), duration)
        plan = planner.plan(goal, JointState(names, problem.start))
        took = plan.solve_time if collision is None else time.perf_counter() - began
        status = SOLVED if plan.is_executable else plan.message
        return PeerResult(plan.trajectory, took, plan.iterations, status)

    chosen = "" if scene.primitive else " (chosen to come as near to least effort as the paper's)"
    about = (
        "B-splines, 6 free control points per joint beside 6 that the ends fix; least effort"
        if options.basis == BSPLINE
        else f"principal components, coupling {primitive.coupling}, {primitive.n_components} "
        f"weights{chosen}, naturalness ρ = {options.naturalness:g}"
    )
    if options.timing == FREE:
        about += f", free duration, within {options.max_solve_time:g} s"
    return Method(name, about, solve)


def planner_methods(scene: Scene, max_time: float) -> list[Method]:
    """Components with the usual and without naturalness, and B-splines."""
    primitives = [] if scene.primitive is None else [scene.primitive]
    if not primitives:
        # So many that efforts come as near to the least as in [P], Table 3.
        sizes = PrimitiveOptions("arm", 10), PrimitiveOptions("joint", 4)
        primitives = [build_primitive(scene.demonstrations, scene.name, x) for x in sizes]
    usual = PlannerOptions(max_solve_time=max_time)
    bare = PlannerOptions(max_solve_time=max_time, naturalness=0.0)
    bspline = PlannerOptions(max_solve_time=max_time, naturalness=0.0, basis="bspline")
    methods = []
    for primitive in primitives:
        name = f"pca_{primitive.coupling}"
        methods.append(planner_method(name, scene, primitive, usual))
        methods.append(planner_method(f"{name}_effort_only", scene, primitive, bare))
    return [*methods, planner_method(BSPLINE, scene, primitives[0], bspline)]
