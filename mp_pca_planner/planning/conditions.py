# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Targets of positions at a phase: a pose at the end, configurations and poses before it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..motion.goal import Pose
from ..robot.model import Robot
from .unknowns import QuadratureTables, StateMap, Unknowns, state_map


class Target(Protocol):
    """A target, as equations of the joint positions."""

    def error(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Residuals, shape (m,), and their derivatives by q, shape (m, n_joints)."""


@dataclass(frozen=True, eq=False)
class PoseTarget:
    """The condition that a frame is at a pose.

    Attributes
    ----------
    robot : Robot
        The model.
    pose : Pose
        The frame and its pose.
    """

    robot: Robot
    pose: Pose

    def error(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Distance [m] and, with an orientation, rotation vector [rad]."""
        return self.robot.pose_error(self.pose.frame, q, self.pose.position, self.pose.orientation)


@dataclass(frozen=True, eq=False)
class JointTarget:
    """The condition that some joints are at given positions.

    Attributes
    ----------
    index : array, shape (m,)
        Indices of the joints.
    positions : array, shape (m,)
        Their positions [rad or m].
    n_joints : int
        Number of joints of the robot.
    """

    index: NDArray[np.intp]
    positions: FloatArray
    n_joints: int

    def error(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The differences of the positions."""
        return q[self.index] - self.positions, np.eye(self.n_joints)[self.index]


@dataclass(frozen=True, eq=False)
class Condition:
    """A target and its phase.

    Attributes
    ----------
    target : Target
        What to reach.
    phase : float or None
        Phase of the target; None: any phase within the `window`.
    window : (float, float)
        Phases between which a free one is searched.
    """

    target: Target
    phase: float | None
    window: tuple[float, float] = (0.0, 1.0)

    def phase_at(self, place: float) -> tuple[float, float]:
        """The phase within the window for an unbounded place, and its derivative by the place."""
        if self.phase is not None:
            return self.phase, 0.0
        low, high = self.window
        share = 0.5 * (1.0 + np.tanh(0.5 * place))
        return low + (high - low) * share, (high - low) * share * (1.0 - share)


class ConditionEquations:
    """The conditions of a motion as equations of its unknowns.

    Parameters
    ----------
    unknowns : Unknowns
        The unknowns.
    tables : QuadratureTables
        The basis of the motion.
    conditions : sequence of Condition
        The conditions; the phases that are free are the last unknowns, in the same order.
    """

    def __init__(
        self, unknowns: Unknowns, tables: QuadratureTables, conditions: Sequence[Condition]
    ) -> None:
        self._unknowns, self._basis, self._conditions = unknowns, tables.basis, tuple(conditions)
        fixed = [one.phase for one in conditions if one.phase is not None]
        self._map: StateMap | None = None
        if fixed == [1.0] and len(conditions) == 1:
            self._map = tables.goal_states(unknowns)
        elif 0 < len(fixed) == len(conditions):
            self._map = self._map_at(fixed)

    def _map_at(self, phases: Sequence[float]) -> StateMap:
        return state_map(self._unknowns, self._basis, np.array(phases), 1)

    def phases(self, x: FloatArray) -> list[float]:
        """The phases of the conditions."""
        return [phase for phase, _ in self._phases(x)]

    def _phases(self, x: FloatArray) -> list[tuple[float, float]]:
        """The phases of the conditions, and their derivatives by their places."""
        places = iter(x[self._unknowns.first_place :])
        return [c.phase_at(next(places) if c.phase is None else 0.0) for c in self._conditions]

    def errors(self, x: FloatArray) -> FloatArray:
        """Residuals of the conditions, shape (m,)."""
        if not self._conditions:
            return np.zeros(0)
        phases = self.phases(x)
        q, _ = (self._map or self._map_at(phases)).values(x).reshape(2, -1, len(phases))
        targets = zip(self._conditions, q.T, strict=True)
        return np.concatenate([condition.target.error(place)[0] for condition, place in targets])

    def residuals(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Residuals of the conditions, shape (m,), and their derivatives, shape (m, n_unknowns)."""
        errors, rows = [np.zeros(0)], [np.zeros((0, x.size))]
        if not self._conditions:
            return errors[0], rows[0]
        phases, place = self._phases(x), self._unknowns.first_place
        states = self._map or self._map_at([phase for phase, _ in phases])
        values = states.values(x)
        jacobian = states.jacobian(x, values).reshape(2, -1, len(phases), x.size)
        q, v = values.reshape(2, -1, len(phases))
        for i, (condition, (_, slope)) in enumerate(zip(self._conditions, phases, strict=True)):
            by_unknown = jacobian[0, :, i]
            if condition.phase is None:
                by_unknown[:, place] = self._unknowns.duration_at(x) * v[:, i] * slope
                place += 1
            error, by_position = condition.target.error(q[:, i])
            errors.append(error)
            rows.append(by_position @ by_unknown)
        return np.concatenate(errors), np.concatenate(rows)
