# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Methods of the benchmark: their interface, the planner, and methods without optimisation."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy.interpolate import make_interp_spline
from support.motion_referee import Verdict
from support.problems import Problem, Scene

from mp_pca_planner.arrays import FloatArray
from mp_pca_planner.exceptions import require
from mp_pca_planner.motion.goal import JointGoal, JointState
from mp_pca_planner.motion.interpolation import hermite_functions
from mp_pca_planner.motion.trajectory import Trajectory
from mp_pca_planner.planning.options import PlannerOptions
from mp_pca_planner.planning.planner import Planner
from mp_pca_planner.primitives.build import PrimitiveOptions, build_primitive
from mp_pca_planner.primitives.differences import PHASES
from mp_pca_planner.primitives.primitive import MovementPrimitive
from mp_pca_planner.recordings.demonstration import Demonstration

SOLVED = "solved"
BSPLINE = "bspline"


@dataclass(frozen=True, eq=False)
class PeerResult:
    """Result of a method for one problem.

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
    path_time : float
        The part of the time in which a path was searched [s]; NaN without such a part.
    """

    trajectory: Trajectory | None
    solve_time: float
    iterations: int = 0
    status: str = SOLVED
    verdict: Verdict | None = None
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
    def arrived(self) -> bool:
        """Whether the motion reaches the goal without a collision; peers may exceed limits."""
        return (
            self.status == SOLVED
            and self.verdict is not None
            and self.verdict.reaches
            and not self.verdict.collision
        )

    def facts(self) -> dict[str, Any]:
        """The result by the names of the package's public interface."""
        return {
            "effort_cost": None,
            "solve_time_s": self.solve_time,
            "iterations": self.iterations,
            "feasible": False,
            "status": self.status,
            "solved": self.arrived,
            **({} if self.verdict is None else asdict(self.verdict)),
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
) -> Method:
    """The planner with one basis and naturalness.

    Its solve time is the planner's: it includes attempts that failed the limits, but neither the
    last check of the motion nor the preparation of the primitive. Among obstacles it is that of
    the whole call; the world was set before.
    """
    names = scene.robot.joint_names
    planner = Planner(scene.robot, [primitive], scene.limits, options, scene.collision)

    def solve(problem: Problem) -> PeerResult:
        """Plan one motion."""
        began = time.perf_counter()
        duration = None if np.isnan(problem.duration) else problem.duration
        goal = JointGoal(JointState(names, problem.goal), duration)
        plan = planner.plan(goal, JointState(names, problem.start))
        took = plan.solve_time if scene.collision is None else time.perf_counter() - began
        status = SOLVED if plan.is_executable else plan.message
        return PeerResult(plan.trajectory, took, plan.iterations, status)

    return Method(name, _about_planner(scene, primitive, options), solve)


def _about_planner(scene: Scene, primitive: MovementPrimitive, options: PlannerOptions) -> str:
    """The basis and the options of the planner, one sentence."""
    if options.basis == BSPLINE:
        return "B-splines, 6 free control points per joint beside 6 that the ends fix; least effort"
    is_chosen = scene.primitive is None and scene.collision is None
    chosen = " (chosen to come as near to least effort as the paper's)" if is_chosen else ""
    rho = options.naturalness
    natural = "ρ = 1, less for in-span scores above 3 (default)" if rho is None else f"ρ = {rho:g}"
    about = (
        f"principal components, coupling {primitive.coupling}, {primitive.n_components} "
        f"weights{chosen}, naturalness {natural}"
    )
    if scene.collision is not None:
        is_default = " (default)" if options.timing == PlannerOptions.timing else ""
        about += f", timing '{options.timing}'{is_default}, within {options.max_solve_time:g} s"
    return about


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


def minimum_jerk_method(scene: Scene) -> Method:
    """The quintic polynomial from rest to rest (Flash and Hogan, J. Neurosci. 5(7), 1985)."""
    joints = scene.robot.joint_names

    def solve(problem: Problem) -> PeerResult:
        """Evaluate the polynomial."""
        began = time.perf_counter()
        states = minimum_jerk(problem, PHASES)
        took = time.perf_counter() - began
        return PeerResult(Trajectory(joints, PHASES * problem.duration, *states), took)

    return Method("minimum_jerk", "the quintic polynomial from rest to rest", solve)


def promp_method(scene: Scene, _: float) -> Method:
    """ProMP of the package movement_primitives, conditioned on start and goal."""
    module = require("movement_primitives.promp", "peers", "the peer 'promp'")
    joints = scene.robot.joint_names
    shown = np.array([motion.time_normalised(PHASES.size) for motion in scene.demonstrations])
    model = module.ProMP(n_dims=len(joints), n_weights_per_dim=10)
    model.imitate([PHASES] * len(shown), shown)
    exact = 1e-8 * np.eye(len(joints))

    def solve(problem: Problem) -> PeerResult:
        """Condition the ProMP on both ends, and return its mean."""
        began = time.perf_counter()
        from_start = model.condition_position(problem.start, exact, t=0.0)
        conditioned = from_start.condition_position(problem.goal, exact, t=1.0)
        positions = conditioned.mean_trajectory(PHASES)
        took = time.perf_counter() - began
        return PeerResult(_through(joints, PHASES * problem.duration, positions), took)

    about = "ProMP of movement_primitives, conditioned on start and goal; no limits, no efforts"
    return Method("promp", about, solve)


def dmp_method(scene: Scene, _: float) -> Method:
    """DMP of the package movement_primitives, of the demonstration with the nearest ends."""
    module = require("movement_primitives.dmp", "peers", "the peer 'dmp'")
    joints = scene.robot.joint_names

    def model_of(duration: float, n_steps: int) -> Any:
        """An untrained DMP."""
        step = duration / n_steps
        return module.DMP(
            n_dims=len(joints), execution_time=duration, dt=step, n_weights_per_dim=20
        )

    def learn(motion: Demonstration) -> FloatArray:
        """Weights of a DMP trained with a motion."""
        model = model_of(motion.duration, len(motion.times) - 1)
        model.imitate(motion.times, motion.positions)
        return np.asarray(model.get_weights())

    learned = [learn(motion) for motion in scene.demonstrations]
    ends = np.array([motion.positions[[0, -1]] for motion in scene.demonstrations])

    def solve(problem: Problem) -> PeerResult:
        """Integrate the DMP to the new goal with the new duration."""
        began = time.perf_counter()
        distances = np.sum((ends - [problem.start, problem.goal]) ** 2, axis=(1, 2))
        model = model_of(problem.duration, PHASES.size - 1)
        model.set_weights(learned[int(np.argmin(distances))])
        model.configure(start_y=problem.start, goal_y=problem.goal)
        times, positions = model.open_loop()
        took = time.perf_counter() - began
        return PeerResult(_through(joints, np.asarray(times), np.asarray(positions)), took)

    about = "DMP of movement_primitives, of the nearest demonstration; no limits, no efforts"
    return Method("dmp", about, solve)


def minimum_jerk(problem: Problem, phases: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Positions, velocities and accelerations of the minimum-jerk motion."""
    ends = np.array([problem.start, problem.goal])
    q, v, a = (
        hermite_functions(phases, d)[:, [0, 3]] @ ends / problem.duration**d for d in range(3)
    )
    return q, v, a


def _through(joints: tuple[str, ...], times: FloatArray, positions: FloatArray) -> Trajectory:
    """The quintic spline through positions without given derivatives."""
    curve = make_interp_spline(times, positions, k=5)
    return Trajectory(joints, times, *(curve(times, nu=order) for order in range(3)))
