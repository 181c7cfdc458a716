# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A compiled request with the constraints that were found to matter, refined until they hold.

The solver keeps limits at the points of its grid, and pairs of links apart once they collided. The
validator checks the motion on a denser grid. Where it finds a violation, bounds are tightened or
clearance constraints are added, and the solver continues from where it was.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from ..arrays import FloatArray
from ..motion.collision import Collision, CollisionModel
from ..motion.goal import JointState
from ..motion.validation import Violation
from ..robot.limits import JointLimits
from ..robot.model import Robot
from .bases import MotionBasis
from .chain import ChainProgram, Junction
from .clearance import Clearance, ClearProgram, clearances_of
from .compiler import MotionProgram
from .constraints import LimitedProgram
from .motion import Motion
from .program import Program


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
        With limits; without until they are found to matter.
    clearances : tuple of Clearance
        Pairs of links that are kept apart.
    """

    program: MotionProgram
    basis: MotionBasis
    ends: tuple[JointState | None, JointState | None]
    limited: LimitedProgram = field(init=False)
    clearances: tuple[Clearance, ...] = ()

    def bound(self, limits: JointLimits | None, robot: Robot) -> None:
        """Keep limits from now on; none without them."""
        known = [state for state in self.ends if state is not None]
        # A free end leaves itself as much room as it needs.
        n = robot.n_joints
        states = np.zeros((len(known), 4, n))
        if known:
            q, v, a = (
                np.array([getattr(state, kind) for state in known])
                for kind in ("positions", "velocities", "accelerations")
            )
            states = np.stack([q, v, a, robot.inverse_dynamics(q, v, a)], axis=1)
        self.limited = LimitedProgram(self.program, self.basis.limit_tables, limits, states)

    def whole(self, collision: CollisionModel | None) -> Program:
        """The segment with all of its inequalities."""
        if collision is None or not self.clearances:
            return self.limited
        return ClearProgram(self.limited, self.basis.basis, collision, self.clearances)


class Problem:
    """One segment or several, as a program with constraints.

    Parameters
    ----------
    parts : sequence of Part
        The segments.
    robot, limits, collision
        The planner's.
    junctions : sequence of Junction, optional
        The start and the targets of a chain; a single segment has none.

    Attributes
    ----------
    is_bounded : bool
        Whether limits are constraints; otherwise they are only checked.
    """

    def __init__(
        self,
        parts: Sequence[Part],
        robot: Robot,
        limits: JointLimits,
        collision: CollisionModel | None,
        junctions: Sequence[Junction] = (),
    ) -> None:
        self.parts, self._robot, self._limits, self._collision = parts, robot, limits, collision
        self.junctions, self.is_bounded = junctions, False

    def program(self) -> Program:
        """The program with its present constraints."""
        wholes = [part.whole(self._collision) for part in self.parts]
        return self.chain(wholes) if self.junctions else wholes[0]

    def chain(self, wholes: Sequence[Program] = ()) -> ChainProgram:
        """The segments joined, without inequalities unless given."""
        return ChainProgram(self.junctions, [part.program for part in self.parts], wholes)

    def naturalness(self, x: FloatArray) -> float:
        """The naturalness term of all segments."""
        local = self.chain().locals(x) if self.junctions else [x]
        return sum(
            part.program.naturalness(own) for part, own in zip(self.parts, local, strict=True)
        )

    def bound(self, *, with_limits: bool) -> None:
        """Start with or without the limits."""
        self.is_bounded = with_limits
        for part in self.parts:
            part.bound(self._limits if with_limits else None, self._robot)

    def tighten(self, violations: Sequence[Violation], motions: Sequence[Motion]) -> None:
        """Tighten the bounds of the segments in which limits are violated or touched."""
        ends = np.cumsum([motion.duration for motion in motions])
        index = np.minimum(np.searchsorted(ends, [v.time for v in violations]), len(ends) - 1)
        for k, part in enumerate(self.parts):
            own = [v for v, i in zip(violations, index, strict=True) if i == k]
            if own:
                part.limited = part.limited.tightened(own)

    def separate(self, collisions: Sequence[Collision], motions: Sequence[Motion]) -> bool:
        """Add clearance constraints where links collide; whether there was anything to add."""
        if self._collision is None:
            return False
        began = 0.0
        for part, motion in zip(self.parts, motions, strict=True):
            own = [one.within(began, began + motion.duration) for one in collisions]
            part.clearances += clearances_of(
                [one for one in own if one is not None],
                part.clearances,
                self._collision,
                [None if end is None else end.positions for end in part.ends],
                motion.duration,
            )
            began += motion.duration
        return bool(collisions)
