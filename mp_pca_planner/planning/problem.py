# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A compiled request with the constraints that are relevant, refined until they hold.

The solver enforces limits at the points of its grid, and clearances of pairs of links that collided
before. The validator checks the motion on a denser grid. If it finds a violation, bounds are
tightened or clearance constraints are added, and the solver continues from its last solution.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

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
from .naturalness import goal_precision, segment_precision
from .pose_search import nearest_configuration
from .program import Program
from .request import Request
from .search_options import SearchOptions
from .selection import effort_of
from .sequence_request import SequenceRequest, passing_phases
from .setup import Setup
from .starts import StartPoint
from .time_scaling import keeps_limits
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

    def is_expected_within(self, limits: JointLimits) -> bool:
        """Whether the expected motion keeps the limits at the nodes, and its duration is known."""
        x = self.program.unknowns
        if x.duration_is_free and not self.program.precision[x.n_linear, x.n_linear] > 0.0:
            return False
        at = self.program.at_expected
        return keeps_limits(limits, at.states, at.efforts)

    def bound(self, limits: JointLimits | None, robot: Robot) -> None:
        """Add the limits as constraints."""
        # Only fixed ends reduce the margin, and only of limits.
        known = [state for state in self.ends if state is not None and limits is not None]
        states = np.zeros((len(known), 4, robot.n_joints))
        if known:
            q, v, a = (
                np.array([getattr(state, kind) for state in known])
                for kind in ("positions", "velocities", "accelerations")
            )
            states = np.stack([q, v, a, robot.inverse_dynamics(q, v, a)], axis=1)
        self.limited = LimitedProgram(self.program, self.basis.limit_tables, limits, states)

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
    is_bounded : bool
        Whether limits are constraints; otherwise they are only checked.
    """

    setup: Setup
    request: Request | SequenceRequest
    bases: tuple[MotionBasis, ...]
    naturalness: float
    parts: list[Part]
    starts: list[StartPoint]
    is_bounded = False

    @property
    def has_clearances(self) -> bool:
        """Whether there are clearance constraints."""
        return any(part.clearances is not None for part in self.parts)

    @property
    def is_near_expected(self) -> bool:
        """Whether motions stay near an expected one within limits, which are rarely active then."""
        certain = all(basis.precision is not None for basis in self.bases)
        near = certain and self.naturalness >= self.setup.options.search.near_expected
        return near and all(part.is_expected_within(self.setup.limits) for part in self.parts)

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

    def bound(self, *, with_limits: bool) -> None:
        """Start with or without the limits."""
        self.is_bounded = with_limits
        for part in self.parts:
            part.bound(self.setup.limits if with_limits else None, self.setup.robot)

    def tighten(self, violations: Sequence[Violation], motions: Sequence[Motion]) -> None:
        """Tighten the bounds of the segments in which limits are violated or touched."""
        began = 0.0
        for part, motion in zip(self.parts, motions, strict=True):
            # At a target, the violation may belong to either segment.
            first, last = began - GRID_PERIOD, began + motion.duration + GRID_PERIOD
            own = [one for one in violations if first <= one.time <= last]
            if own:
                part.limited = part.limited.tightened(own)
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
        self.starts = _starts(basis, self._program, naturalness, setup.options.search, goals)
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
        return collision is not None and any(map(collision.collides, positions))

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


def _starts(
    basis: MotionBasis,
    program: MotionProgram,
    naturalness: float,
    search: SearchOptions,
    goals: FloatArray,
) -> list[StartPoint]:
    """Set the program's naturalness; return the unknowns to start from, the cheapest first."""
    starts = basis.starts
    if basis.precision is not None and naturalness > 0.0:
        program.precision = naturalness * goal_precision(program, basis, goals, search)
        if naturalness >= search.near_expected:
            starts = starts[:1]
    # The state of a solver for weights alone does not fit programs with other unknowns.
    fits, to_unknowns = program.scales.size == basis.expected.size, program.unknowns.from_weights
    found = [StartPoint(to_unknowns(w), memory if fits else None) for w, memory in starts]
    if len(found) > 1:
        costs = program.costs(np.array([start.unknowns for start in found]))
        found = [found[i] for i in np.argsort(costs, kind="stable")]
    return found
