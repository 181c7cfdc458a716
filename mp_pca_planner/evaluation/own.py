# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The planner of this package with the bases it offers, as methods of the benchmark."""

from __future__ import annotations

from ..motion.goal import JointGoal, JointState
from ..planning.plan import PlannerOptions
from ..planning.planner import Planner
from ..primitives.build import PrimitiveOptions, build_primitive
from ..primitives.primitive import MovementPrimitive
from .method import SOLVED, Answer
from .problems import Problem, Scene

BSPLINE = "bspline"

# As many as it takes to come as near to the least effort as [P] does with 4 of each joint.
_N_COMPONENTS = {"arm": 10, "joint": 4}


class PlannerMethod:
    """The planner with one basis and naturalness.

    Its solve time is the planner's: attempts that failed the limits are in it, the last check
    of the motion is not, nor is what it has practised for the primitive beforehand.
    """

    slow = False

    def __init__(
        self, name: str, scene: Scene, primitive: MovementPrimitive, options: PlannerOptions
    ) -> None:
        self.name = name
        self._planner = Planner(scene.robot, [primitive], scene.limits, options)
        self._planner.practise()
        if options.basis == "bspline":
            self.about = "B-splines, 6 control points per joint, the same compiler; least effort"
        else:
            self.about = (
                f"principal components, coupling {primitive.coupling}, {primitive.n_components} "
                f"weights, naturalness ρ = {options.naturalness:g}"
            )

    def solve(self, problem: Problem) -> Answer:
        """Plan one motion."""
        names = self._planner.robot.joint_names
        goal = JointGoal(JointState(names, problem.goal), problem.duration)
        plan = self._planner.plan(goal, JointState(names, problem.start))
        status = SOLVED if plan.is_executable else plan.message
        return Answer(plan.trajectory, plan.solve_time, plan.solution.iterations, status)


def planner_methods(scene: Scene, max_time: float) -> list[PlannerMethod]:
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
    methods = []
    for primitive in primitives:
        name = f"pca_{primitive.coupling}"
        bare = PlannerOptions(max_solve_time=max_time, naturalness=0.0)
        methods.append(PlannerMethod(name, scene, primitive, usual))
        methods.append(PlannerMethod(f"{name}_effort_only", scene, primitive, bare))
    bspline = PlannerOptions(max_solve_time=max_time, basis="bspline", naturalness=0.0)
    return [*methods, PlannerMethod(BSPLINE, scene, primitives[0], bspline)]
