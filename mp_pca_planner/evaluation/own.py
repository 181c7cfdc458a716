# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The planner of this package with its bases, as methods of the benchmark."""

from __future__ import annotations

from ..motion.goal import JointGoal, JointState
from ..planning.plan import PlannerOptions
from ..planning.planner import Planner
from ..primitives.build import PrimitiveOptions, build_primitive
from ..primitives.primitive import MovementPrimitive
from .method import SOLVED, Method, PeerResult
from .problems import Problem, Scene

BSPLINE = "bspline"

_N_COMPONENTS = {"arm": 10, "joint": 4}
"""Numbers of components, chosen so that efforts come as near to the least as in [P], Table 3."""


def planner_method(
    name: str, scene: Scene, primitive: MovementPrimitive, options: PlannerOptions
) -> Method:
    """The planner with one basis and naturalness.

    Its solve time is the planner's: it includes attempts that failed the limits, but neither the
    last check of the motion nor the preparation of the primitive.
    """
    names = scene.robot.joint_names
    planner = Planner(scene.robot, [primitive], scene.limits, options)
    planner.precompute()

    def solve(problem: Problem) -> PeerResult:
        """Plan one motion."""
        goal = JointGoal(JointState(names, problem.goal), problem.duration)
        plan = planner.plan(goal, JointState(names, problem.start))
        status = SOLVED if plan.is_executable else plan.message
        return PeerResult(plan.trajectory, plan.solve_time, plan.solution.iterations, status)

    chosen = "" if scene.primitive else " (chosen to come as near to least effort as the paper's)"
    about = (
        "B-splines, 6 free control points per joint beside 6 that the ends fix; least effort"
        if options.basis == BSPLINE
        else f"principal components, coupling {primitive.coupling}, {primitive.n_components} "
        f"weights{chosen}, naturalness ρ = {options.naturalness:g}"
    )
    return Method(name, about, solve)


def planner_methods(scene: Scene, max_time: float) -> list[Method]:
    """Components with the usual and without naturalness, and B-splines."""
    primitives = (
        [scene.primitive]
        if scene.primitive is not None
        else [
            build_primitive(
                scene.demonstrations, scene.name, PrimitiveOptions(coupling, n_components)
            )
            for coupling, n_components in _N_COMPONENTS.items()
        ]
    )
    usual = PlannerOptions(max_solve_time=max_time)
    bare = PlannerOptions(max_solve_time=max_time, naturalness=0.0)
    bspline = PlannerOptions(max_solve_time=max_time, naturalness=0.0, basis="bspline")
    methods = []
    for primitive in primitives:
        name = f"pca_{primitive.coupling}"
        methods.append(planner_method(name, scene, primitive, usual))
        methods.append(planner_method(f"{name}_effort_only", scene, primitive, bare))
    return [*methods, planner_method(BSPLINE, scene, primitives[0], bspline)]
