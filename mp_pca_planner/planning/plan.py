# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The result of the planner: the plan."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from ..arrays import text_table
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
    objective_cost : float
        The weighted sum of the objectives, without naturalness.
    effort_cost : float
        J = ½∫‖τ‖²dt [N²·m²·s], whether that is an objective or not.
    naturalness_cost : float
        ½ρ(w−ŵ)ᵀΛ⁻¹(w−ŵ), in units of the objectives.
    start_cost : float
        J of the predicted motion.
    converged : bool
        Whether it is optimal within the limits, to the solver's tolerance.
    iterations : int
        Passes over the quadrature nodes.
    kkt_residual : float
        Norm of the Lagrangian's gradient by scaled weights, as a share of the objective.
    """

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
NOT_SOLVED = MotionSolution(_NAN, _NAN, 0.0, _NAN, False, 0, _NAN)
"""The result for a motion that was not optimised; the search adds its costs."""


@dataclass(frozen=True, eq=False)
class Plan:
    """The result of planning for a request: plain values, which can be pickled.

    Attributes
    ----------
    status : str
        'solved': converged, and executable. 'stopped_early': executable, but not optimal: time
        ran out, or no optimised motion met the limits. 'infeasible': must not be executed.
        'already_there': the robot rests at the goal; there is no motion, and the trajectory is the
        present state alone.
    message : str
        One sentence for the user: what the motion is like, or why there is none.
    trajectory : Trajectory
        The sampled motion with its efforts; present for an infeasible plan, too, for inspection.
    motions : tuple of Motion
        The continuous motion, segment by segment; one for a single goal, none where
        the robot is there already.
    primitives : tuple of str
        Names of the primitives of the segments.
    solution : MotionSolution
        Result of the solver.
    limit_check : LimitCheck
        Comparison with the limits on a grid of at most 1 ms.
    remarks : tuple of str
        Sentences on what is unusual about the request or the motion; none for a usual one.
    in_span_score : float
        Distance of the request from the demonstrations (about 1: like them, above 3: unlike them);
        the largest of the segments.
    goal_error : float
        Largest distance from the goal position or pose [rad or m].
    solve_time : float
        Time of the search for the motion [s].
    mode : str
        How the segments of a goal of several targets were joined: 'real_time' (without
        optimisation) or 'optimal'. Empty for a single goal.
    facts : mapping of str to str, float or int
        Further scalars, see :meth:`summary`.

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
    motions: tuple[Motion, ...] = ()
    primitives: tuple[str, ...] = ()
    solution: MotionSolution = NOT_SOLVED
    limit_check: LimitCheck = field(default_factory=LimitCheck)
    remarks: tuple[str, ...] = ()
    in_span_score: float = _NAN
    goal_error: float = 0.0
    solve_time: float = 0.0
    mode: str = ""
    facts: Mapping[str, str | float | int] = field(default_factory=dict)

    def __repr__(self) -> str:
        by = f" by {self._named}" if self.primitives else ""
        return "; ".join([f"Plan: {self.status}{by}: {self.message}", *self.remarks])

    def __str__(self) -> str:
        """What was found, how good it is, and where each joint goes, in some lines."""
        if not self.motions:
            return repr(self)
        lines = [f"Plan: {self.status}, {self.duration:.2f} s by {self._named}", self.message]
        lines += [f"remark: {remark}" for remark in self.remarks]
        lines += [f"{name}: {self.facts[name]}" for name in ("limits", "collision")]
        lines.append(f"efforts: of {self.facts['effort_parts']}")
        trajectory = self.trajectory
        fastest = np.abs(trajectory.velocities).max(axis=0)
        # A number that is rounded to zero has no sign.
        columns = np.round([*trajectory.positions[[0, -1]], fastest], 3) + 0.0
        numbers = [[f"{x:.3f}" for x in row] for row in columns.T]
        rows = [[name, *row] for name, row in zip(trajectory.joint_names, numbers, strict=True)]
        head, *joints = text_table(rows, header=["joint", "start", "goal", "fastest"]).splitlines()
        return "\n  ".join([*lines, f"{head}  [rad or m, /s]", *joints])

    @property
    def _named(self) -> str:
        return ", ".join(f"'{name}'" for name in dict.fromkeys(self.primitives))

    def plot(self, planner: Planner | None = None) -> Any:
        """Plot the trajectory in a new pyplot figure; return the array of its Axes.

        ``plt.savefig("motion.png")`` writes it.

        Parameters
        ----------
        planner : Planner, optional
            The planner, to show its limits and the nearest demonstrations, too.
        """
        from ..plotting.motion import plot_plan

        return plot_plan(self, planner)

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
    def via_phases(self) -> tuple[float, ...]:
        """Passing times of the vias, as shares of the duration."""
        ends = np.cumsum([motion.duration for motion in self.motions])
        return tuple((ends[:-1] / self.duration).tolist()) if self.motions else ()

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
        """Scalar facts, by the names of the package's public interface.

        Beside the attributes and those of the solution: `naturalness` (the ρ used),
        `expected_error` (RMS difference in path to expect between the predicted motion and what
        would be demonstrated [rad or m]), `correction` (RMS of what B-splines add [rad or m]),
        `limit_violation`, `start_error`, `via_error` [rad or m], `clearance` [m] from
        `nearest_obstacle`, if there is one near, and in words `effort_parts`, `limits` and
        `collision`.
        """
        several: dict[str, str | float | int] = {}
        if self.mode:
            several = {"mode": self.mode, "n_segments": len(self.motions)}
        solution = self.solution
        return {
            "status": self.status,
            "message": self.message,
            "primitive": self.primitive,
            **several,
            "duration": self.duration,
            "in_span_score": self.in_span_score,
            "cost": self.cost,
            "objective_cost": solution.objective_cost,
            "effort_cost": solution.effort_cost,
            "naturalness_cost": solution.naturalness_cost,
            "start_cost": solution.start_cost,
            "solve_time_s": self.solve_time,
            "iterations": solution.iterations,
            "kkt_residual": solution.kkt_residual,
            "limit_violation": self.limit_check.worst_excess,
            "goal_error": self.goal_error,
            **self.facts,
        }
