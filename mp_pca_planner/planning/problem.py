# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A compiled request with the constraints that are relevant, refined until they hold.

The solver enforces limits at the points of its grid, and clearances of pairs of links that collided
before. The validator checks the motion on a denser grid. If it finds a violation, bounds are
tightened or clearance constraints are added, and the solver continues from its last solution.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..motion.collision import Collision, CollisionModel
from ..motion.goal import JointState
from ..motion.validation import GRID_PERIOD, Violation
from ..robot.limits import JointLimits
from ..robot.model import Robot
from .bases import MotionBasis
from .chain import ChainProgram, junctions_of
from .clearance import Clearances, ClearProgram
from .compiler import MotionProgram
from .constraints import LimitedProgram
from .motion import Motion
from .naturalness import natural_starts, segment_precision
from .pose_search import nearest_configuration
from .program import Program
from .request import Request
from .selection import effort_of
from .sequence_request import SequenceRequest, passing_phases
from .setup import Setup
from .starts import StartPoint
from .time_scaling import limit_shares
from .unknowns import GOAL_POSITION, Unknowns


@dataclass(eq=False)
class Part:
    """A segment of a problem.

    Attributes
    ----------
    program : MotionProgram
        The segment without inequalities.
    basis : MotionBasis
        Its basis.
    ends : tuple of (JointState or None)
        Start and goal, None where the position is free.
    limited : LimitedProgram
        The segment with limits; without limits until they become constraints.
    clearances : Clearances or None
        Clearance constraints; None until there was a collision.
    """

    program: MotionProgram
    basis: MotionBasis
    ends: tuple[JointState | None, JointState | None]
    limited: LimitedProgram = field(init=False)
    clearances: Clearances | None = None

    def near_limits(self, limits: JointLimits, share: float) -> NDArray[np.bool_]:
        """Limits that a motion near the expected one may reach, shape (5, n_joints).

        None of them if the expected motion keeps the limits at the nodes, and its duration is
        known; otherwise those of which it takes more than a share.
        """
        x, at = self.program.unknowns, self.program.at_expected
        shares = limit_shares(limits, at.states, at.efforts)
        is_timed = not x.duration_is_free or self.program.precision[x.n_linear, x.n_linear] > 0.0
        return ~(shares <= (1.0 if is_timed and np.all(shares <= 1.0) else share))

    def bound(
        self, limits: JointLimits, robot: Robot, chosen: NDArray[np.bool_] | None = None
    ) -> None:
        """Make limits constraints: all, or the chosen ones."""
        # Only fixed ends reduce the margin, and only of limits.
        is_bounded = chosen is None or chosen.any()
        known = [state for state in self.ends if state is not None and is_bounded]
        states = np.zeros((len(known), 4, robot.n_joints))
        if known:
            q, v, a = (
                np.array([getattr(state, kind) for state in known])
                for kind in ("positions", "velocities", "accelerations")
            )
            states = np.stack([q, v, a, robot.inverse_dynamics(q, v, a)], axis=1)
        tables = self.basis.limit_tables
        self.limited = LimitedProgram(self.program, tables, limits, states, chosen)

    def whole(self, collision: CollisionModel | None) -> Program:
        """The segment with all of its inequalities."""
        if collision is None or self.clearances is None:
            return self.limited
        return ClearProgram(self.limited, self.basis.basis, collision, self.clearances)


class PlanningProblem(ABC):
    """A compiled request, with constraints that are refined.

    Attributes
    ----------
    setup : Setup
        Robot, limits and options of the planner.
    request : Request or SequenceRequest
        The request.
    bases : tuple of MotionBasis
        The basis of each segment.
    naturalness : float
        Naturalness weight ρ.
    parts : list of Part
        The segments.
    starts : list of StartPoint
        Starts of the solver, the cheapest first.
    """

    setup: Setup
    request: Request | SequenceRequest
    bases: tuple[MotionBasis, ...]
    naturalness: float
    parts: list[Part]
    starts: list[StartPoint]

    @property
    def has_clearances(self) -> bool:
        """Whether there are clearance constraints."""
        return any(part.clearances is not None for part in self.parts)

    @property
    def is_near_expected(self) -> bool:
        """Whether motions stay near an expected one."""
        certain = all(basis.precision is not None for basis in self.bases)
        return certain and self.naturalness >= self.setup.options.search.near_expected

    @abstractmethod
    def program(self) -> Program:
        """The program with its present constraints."""

    @abstractmethod
    def motions(self, x: FloatArray) -> tuple[Motion, ...]:
        """The segments that unknowns stand for."""

    @abstractmethod
    def phases(self, x: FloatArray) -> tuple[float, ...]:
        """The phases of the conditions."""

    @abstractmethod
    def efforts(self, x: FloatArray) -> tuple[float, float]:
        """½∫‖τ‖²dt of unknowns, and of the motion that naturalness refers to [N²·m²·s]."""

    @abstractmethod
    def naturalness_cost(self, x: FloatArray) -> float:
        """The naturalness term of the objective."""

    def bound(self, *, fully: bool) -> None:
        """Make limits constraints: all, or those that motions near the expected ones may reach."""
        limits, share = self.setup.limits, self.setup.options.search.near_limit
        for part in self.parts:
            chosen = None if fully else part.near_limits(limits, share)
            part.bound(limits, self.setup.robot, chosen)

    def covers(self, violations: Sequence[Violation], motions: Sequence[Motion]) -> bool:
        """Whether all limits that segments violate are constraints of theirs."""
        parts = self._by_part(violations, motions)
        return all(part.limited.covers(own) for part, own in parts)

    def tighten(self, violations: Sequence[Violation], motions: Sequence[Motion]) -> None:
        """Tighten the bounds of the segments in which limits are violated or touched."""
        for part, own in self._by_part(violations, motions):
            if own:
                part.limited = part.limited.tightened(own)

    def _by_part(
        self, violations: Sequence[Violation], motions: Sequence[Motion]
    ) -> Iterator[tuple[Part, list[Violation]]]:
        """The segments, and the violations in each of them."""
        began = 0.0
        for part, motion in zip(self.parts, motions, strict=True):
            # At a target, the violation may belong to either segment.
            first, last = began - GRID_PERIOD, began + motion.duration + GRID_PERIOD
            yield part, [one for one in violations if first <= one.time <= last]
            began += motion.duration

    def keep_clear(self) -> None:
        """Add clearance constraints before any collision."""
        if self.setup.collision is not None:
            for part in self.parts:
                part.clearances = self._clearances(part, self.setup.collision)

    def _clearances(self, part: Part, collision: CollisionModel) -> Clearances:
        ends = [None if end is None else end.positions for end in part.ends]
        return Clearances.between(ends, collision, self.setup.robot.n_joints)

    def separate(self, collisions: Sequence[Collision], motions: Sequence[Motion]) -> bool:
        """Add clearance constraints after collisions; return whether any were added."""
        collision = self.setup.collision
        met = collision_at_end(collisions, self.request, sum(one.duration for one in motions))
        if collision is None or met is not None:
            return False
        began = 0.0
        for part, motion in zip(self.parts, motions, strict=True):
            within = [one.within(began, began + motion.duration) for one in collisions]
            own = [one for one in within if one is not None]
            if own and part.clearances is None:
                part.clearances = self._clearances(part, collision)
            elif own and part.clearances is not None:
                part.clearances = part.clearances.during(own, motion.duration)
            began += motion.duration
        return bool(collisions)


class SingleProblem(PlanningProblem):
    """The problem of a motion to a single goal.

    Parameters
    ----------
    setup : Setup
        Robot, limits and options of the planner.
    request : Request
        The request.
    basis : MotionBasis
        The basis of its motions.
    duration : float
        Duration [s], or its initial value if it is free.
    naturalness : float
        Naturalness weight ρ.
    duration_is_free : bool
        Whether the duration is an unknown.
    """

    def __init__(
        self,
        setup: Setup,
        request: Request,
        basis: MotionBasis,
        duration: float,
        naturalness: float,
        *,
        duration_is_free: bool = False,
    ) -> None:
        self.setup, self.request, self.bases = setup, request, (basis,)
        self.naturalness = naturalness
        initial = Motion(request.start, request.goal, duration, basis.basis, basis.expected)
        self._program = MotionProgram(
            setup.robot,
            basis.tables,
            Unknowns(
                basis.basis.scales,
                initial.boundary,
                duration,
                free_rows=[] if request.pose is None else [GOAL_POSITION],
                duration_is_free=duration_is_free,
                n_places=sum(one.phase is None for one in request.conditions),
            ),
            basis.expected,
            objectives=setup.options.objectives,
            conditions=request.conditions,
        )
        # A free goal is natural where demonstrations end.
        goals = request.primitive.boundary_states[:, GOAL_POSITION]
        self.starts = natural_starts(basis, self._program, naturalness, setup.options.search, goals)
        ends = request.start, request.goal if request.pose is None else None
        self.parts = [Part(self._program, basis, ends)]
        if basis.is_detour:
            self.setup = setup.for_detours()
            self.keep_clear()

    @property
    def starts_in_collision(self) -> bool:
        """Whether the first motion is in collision at a quadrature node."""
        collision, start = self.setup.collision, self.starts[0].unknowns
        positions = self._program.states(start)[0]
        return collision is not None and collision.collide_anywhere(positions)

    def program(self) -> Program:
        """The one segment."""
        return self.parts[0].whole(self.setup.collision)

    def motions(self, x: FloatArray) -> tuple[Motion, ...]:
        """The motion, with its end corrected to reach the goal pose exactly."""
        request, unknowns = self.request, self._program.unknowns
        goal = request.goal
        if request.pose is not None:
            q = unknowns.boundary_at(x)[0][GOAL_POSITION]
            q, _ = nearest_configuration(self.setup.robot, self.setup.limits, request.pose, q)
            goal = JointState(goal.joint_names, q)
        weights, duration = unknowns.weights(x), unknowns.duration_at(x)
        return (Motion(request.start, goal, duration, self.bases[0].basis, weights),)

    def phases(self, x: FloatArray) -> tuple[float, ...]:
        """The phases of vias and of the pose."""
        return tuple(self._program.equations.phases(x))

    def efforts(self, x: FloatArray) -> tuple[float, float]:
        """Efforts ½∫‖τ‖²dt of the motion and of the expected one [N²·m²·s]."""
        return self._program.effort_cost(x), self._program.effort_cost(self._program.expected)

    def naturalness_cost(self, x: FloatArray) -> float:
        """The naturalness term of the weights."""
        return self._program.naturalness(x)


class ChainProblem(PlanningProblem):
    """The problem of a motion through several targets.

    The unit of each segment's naturalness is the effort of its joined motion.

    Parameters
    ----------
    setup : Setup
        Robot, limits and options of the planner.
    request : SequenceRequest
        The request.
    bases : tuple of MotionBasis
        The basis of each segment.
    joined : tuple of Motion
        The motion joined without optimisation.
    """

    def __init__(
        self,
        setup: Setup,
        request: SequenceRequest,
        bases: tuple[MotionBasis, ...],
        joined: tuple[Motion, ...],
    ) -> None:
        self.setup, self.request, self.bases = setup, request, bases
        self.naturalness, self._joined = setup.options.naturalness, joined
        self._junctions, self.parts = junctions_of(request, joined), []
        for i, (motion, basis) in enumerate(zip(joined, bases, strict=True)):
            here, there = self._junctions[i : i + 2]
            program = MotionProgram(
                setup.robot,
                basis.tables,
                Unknowns(
                    basis.basis.scales,
                    motion.boundary,
                    motion.duration,
                    free_rows=[*here.rows, *(3 + row for row in there.rows)],
                    duration_is_free=here.time_is_free or there.time_is_free,
                ),
                motion.weights,
                objectives=setup.options.objectives,
            )
            price = self.naturalness * effort_of(setup.robot, motion)
            program.precision = price * segment_precision(
                program, basis, request.expected[i], setup.options.search
            )
            self.parts.append(Part(program, basis, (here.fixed_state, there.fixed_state)))
        self._programs = [part.program for part in self.parts]
        self._chain = ChainProgram(self._junctions, self._programs, [])
        self.starts = [StartPoint(self._chain.start)]

    def program(self) -> ChainProgram:
        """The segments, joined."""
        wholes = [part.whole(self.setup.collision) for part in self.parts]
        return ChainProgram(self._junctions, self._programs, wholes)

    def motions(self, x: FloatArray) -> tuple[Motion, ...]:
        """The segments."""
        return self._chain.motions(x)

    def phases(self, x: FloatArray) -> tuple[float, ...]:
        """Passing times of the targets, as shares of the duration."""
        return passing_phases([motion.duration for motion in self.motions(x)])

    def efforts(self, x: FloatArray) -> tuple[float, float]:
        """Efforts ½∫‖τ‖²dt of the motion and of the joined one [N²·m²·s]."""
        robot = self.setup.robot
        joined = sum(effort_of(robot, motion) for motion in self._joined)
        return sum(effort_of(robot, motion) for motion in self.motions(x)), joined

    def naturalness_cost(self, x: FloatArray) -> float:
        """The sum of the naturalness terms of the segments."""
        parts = zip(self.parts, self._chain.locals(x), strict=True)
        return sum(part.program.naturalness(own) for part, own in parts)


def collision_at_end(
    collisions: Sequence[Collision], request: Request | SequenceRequest, duration: float
) -> tuple[str, Collision] | None:
    """The first collision at an end that is fixed, "start" or "goal"; None if there is none."""
    for one in collisions:
        if one.first_time == 0.0:
            return "start", one
        if request.pose is None and one.last_time >= duration:
            return "goal", one
    return None
