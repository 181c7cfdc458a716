# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The result of the planner: the plan."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..arrays import FloatArray
from ..exceptions import PlannerError
from ..motion.trajectory import Trajectory
from ..motion.validation import LimitCheck
from .motion import Motion

if TYPE_CHECKING:
    from .planner import Planner

SOLVED = "solved"
STOPPED_EARLY = "stopped_early"
INFEASIBLE = "infeasible"
ALREADY_THERE = "already_there"


@dataclass(frozen=True, eq=False)
class MotionSolution:
    """Result of the solver for a motion.

    Attributes
    ----------
    weights : array, shape (n_weights,)
        The best weights w found.
    objective_cost : float
        Their weighted sum of the objectives, without naturalness.
    effort_cost : float
        Their J = ½∫‖τ‖²dt [N²·m²·s], whether that is an objective or not.
    naturalness_cost : float
        Their ½ρ(w−ŵ)ᵀΛ⁻¹(w−ŵ), in units of the objectives.
    start_cost : float
        J of the predicted motion.
    converged : bool
        Whether it is optimal within the limits, to the solver's tolerance.
    iterations : int
        Passes over the quadrature nodes.
    kkt_residual : float
        Norm of the Lagrangian's gradient by scaled weights, as a share of the objective.
    """

    weights: FloatArray
    objective_cost: float
    effort_cost: float
    naturalness_cost: float
    start_cost: float
    converged: bool
    iterations: int
    kkt_residual: float

    @property
    def cost(self) -> float:
        """The whole objective."""
        return self.objective_cost + self.naturalness_cost


_NAN = float("nan")
NOT_SOLVED = MotionSolution(np.zeros(0), _NAN, _NAN, 0.0, _NAN, False, 0, _NAN)
"""The result for a motion that was not optimised; the search adds its costs."""


@dataclass(frozen=True, eq=False)
class Plan:
    """The result of planning for a request.

    Attributes
    ----------
    status : str
        'solved': converged, and executable. 'stopped_early': executable, but not optimal: time
        ran out, or no optimised motion met the limits. 'infeasible': must not be executed.
        'already_there': the robot rests at the goal; there is no motion, and the trajectory is the
        present state alone.
    message : str
        One sentence for the user.
    trajectory : Trajectory
        The sampled motion with its efforts; present for an infeasible plan, too, for inspection.
    motions : tuple of Motion
        The continuous motion, segment by segment; one for a single goal, none where
        the robot is there already.
    primitives : tuple of str
        Names of the primitives of the segments.
    solution : MotionSolution
        Result of the solver.
    considered : int
        Number of primitives near the request that were considered, at most 12.
    in_span_score : float
        Distance of the request from the demonstrations (about 1: like them, above 3: unlike them);
        the largest of the segments.
    outside : str
        The joints, three at most, whose start or goal is far outside its demonstrated range; empty
        if there are none.
    expected_error : float
        RMS difference in path to expect between the predicted motion and what would be demonstrated
        [rad or m]; the largest of the segments. NaN for a primitive of one demonstration.
    limit_check : LimitCheck
        Comparison with the limits on a grid of at most 1 ms.
    start_error, goal_error : float
        Largest distance of the ends from the present and the goal position, or from the goal
        pose [rad or m].
    via_error : float
        Largest distance from the vias [rad or m].
    via_phases : tuple of float
        Passing times of the vias, as shares of the duration.
    n_components_used : int
        Number of principal components of the motion, the largest of the segments.
    correction : float
        RMS of the correction that B-splines add to the components [rad or m].
    deviation_score : float
        Deviation of the motion from the predicted one: RMS difference between the components'
        weights and the expected weights, in standard deviations. The largest of the segments; NaN
        without components.
    naturalness : float
        The ρ used: that of the options, or a larger one that was needed to meet the limits.
    solve_time : float
        Time taken to find the weights [s]; attempts that failed the limits are included, the
        check of the motion that is returned is not.
    mode : str
        How the segments of a goal of several targets were joined: 'real_time' (without
        optimisation) or 'optimal'. Empty for a single goal.
    planner : Planner or None
        The planner that made it.

    Examples
    --------
    >>> import mp_pca_planner as mp
    >>> urdf = mp.config_file("human_arm.urdf")
    >>> motions = mp.load_demonstrations(mp.write_example_recording("motions.mcap", 6), robot=urdf)
    >>> planner = mp.Planner(mp.Robot.from_file(urdf), mp.MovementPrimitive.fit(motions))
    >>> plan = planner.plan(start=motions[0].positions[0], goal={"elbow": -0.8})
    >>> plan.is_executable, plan.trajectory.n_joints
    (True, 4)
    """

    status: str
    message: str
    trajectory: Trajectory
    motions: tuple[Motion, ...]
    primitives: tuple[str, ...]
    solution: MotionSolution
    considered: int
    in_span_score: float
    outside: str
    expected_error: float
    limit_check: LimitCheck
    start_error: float
    goal_error: float
    via_error: float
    via_phases: tuple[float, ...]
    n_components_used: int
    correction: float
    deviation_score: float
    naturalness: float
    solve_time: float
    mode: str = ""
    planner: Planner | None = None

    def __repr__(self) -> str:
        if self.status == ALREADY_THERE:
            return f"Plan: {self.status}: {self.message}"
        names = ", ".join(dict.fromkeys(self.primitives))
        facts = (
            f"Plan: {self.status}, {self.duration:.2f} s by '{names}', "
            f"in-span score {self.in_span_score:.2f}"
        )
        others = [remark for remark in self.remarks if remark != self.message]
        return "; ".join([f"{facts}: {self.message}", *others])

    def __str__(self) -> str:
        from .report import table

        return table(self)

    @property
    def remarks(self) -> list[str]:
        """Sentences on what is unusual about the plan; none for a usual one."""
        from .report import motion_remarks

        found = [self.message] if self.status == STOPPED_EARLY else []
        return found + motion_remarks(self.in_span_score, self.limit_check, self.outside)

    def plot(self) -> Any:
        """Plot the trajectory in a new pyplot figure; return the array of its Axes.

        ``plt.savefig("motion.png")`` writes it.
        """
        from ..plotting.motion import plot_plan

        return plot_plan(self)

    def show(self, *, port: int = 8080) -> Any:
        """Show the robot, its primitives and this motion in the browser; returns the page.

        See :func:`.show`.

        Raises
        ------
        PlannerError
            If no planner made this plan, or see :func:`.show`.
        """
        from ..view.content import show

        if self.planner is None:
            raise PlannerError("a plan that no planner made can't be shown: use Planner.plan")
        return show(self.planner, self, port=port)

    @property
    def is_executable(self) -> bool:
        """Whether the trajectory may be sent to a robot."""
        return self.status in (SOLVED, STOPPED_EARLY)

    @property
    def motion(self) -> Motion:
        """The motion to a single goal, or the first segment."""
        return self.motions[0]

    @property
    def primitive(self) -> str:
        """Name of the primitive, or names of those of the segments."""
        return ", ".join(self.primitives)

    @property
    def duration(self) -> float:
        """Duration of all segments [s]."""
        return sum((motion.duration for motion in self.motions), 0.0)

    @property
    def cost(self) -> float:
        """The whole objective, naturalness included."""
        return self.solution.cost

    @property
    def effort_cost(self) -> float:
        """½∫‖τ‖²dt of the whole [N²·m²·s]."""
        return self.solution.effort_cost

    @property
    def iterations(self) -> int:
        """Passes over the quadrature nodes."""
        return self.solution.iterations

    def summary(self) -> dict[str, str | float | int]:
        """Scalar facts, by the names of the package's public interface."""
        several: dict[str, str | float | int] = {}
        if self.mode:
            several = {"mode": self.mode, "n_segments": len(self.motions)}
        if self.planner is not None:
            several["effort_parts"] = self.planner.robot.effort_parts
        return several | {
            "status": self.status,
            "message": self.message,
            "primitive": self.primitive,
            "considered": self.considered,
            "duration": self.duration,
            "cost": self.cost,
            "objective_cost": self.solution.objective_cost,
            "effort_cost": self.solution.effort_cost,
            "naturalness": self.naturalness,
            "naturalness_cost": self.solution.naturalness_cost,
            "start_cost": self.solution.start_cost,
            "solve_time_s": self.solve_time,
            "iterations": self.solution.iterations,
            "kkt_residual": self.solution.kkt_residual,
            "in_span_score": self.in_span_score,
            "expected_error": self.expected_error,
            "deviation_score": self.deviation_score,
            "n_components_used": self.n_components_used,
            "correction_used": int(self.correction > 0.0),
            "correction": self.correction,
            "limit_violation": self.limit_check.worst_excess,
            "start_error": self.start_error,
            "goal_error": self.goal_error,
            "via_error": self.via_error,
        }
