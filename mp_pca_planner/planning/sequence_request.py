# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Resolved goals of several targets, and their motions joined in real time.

Shapes vanish with two derivatives at both ends. Therefore segments are continuous in position,
velocity and acceleration for any weights if their boundary parts h are. Here the boundary parts
form the quintic spline of least jerk through the vias (de Boor, "A Practical Guide to Splines",
1978: one banded system).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ..arrays import FloatArray
from ..exceptions import TrajectoryError
from ..motion.goal import JointState, Pose
from ..motion.validation import LimitCheck
from ..primitives.conditional_model import ConditionalDistribution
from ..primitives.primitive import MovementPrimitive
from .bases import MotionBasis
from .conditions import Condition, PoseTarget, Target
from .motion import Motion
from .selection import Selection
from .time_scaling import slowdown


@dataclass(frozen=True, eq=False)
class SequenceRequest:
    """A resolved goal of n segments.

    Attributes
    ----------
    states : tuple of JointState
        States at the start, and at rest at each target; n + 1 of them.
    targets : tuple of Target
        Targets of the last n states.
    stops : tuple of bool
        Whether the motion rests at each target.
    selections : tuple of Selection
        Reason for the choice of each segment's primitive.
    durations : tuple of float
        Predicted durations [s], scaled to fixed times.
    groups : tuple
        See :func:`duration_groups`.
    """

    states: tuple[JointState, ...]
    targets: tuple[Target, ...]
    stops: tuple[bool, ...]
    selections: tuple[Selection, ...]
    durations: tuple[float, ...]
    groups: tuple[tuple[tuple[int, ...], bool], ...]

    duration_is_free = True

    @property
    def start(self) -> JointState:
        """The state at the start."""
        return self.states[0]

    @property
    def goal(self) -> JointState:
        """The state at the last target."""
        return self.states[-1]

    @property
    def pose(self) -> Pose | None:
        """The pose to reach, if the last target is one."""
        last = self.targets[-1]
        return last.pose if isinstance(last, PoseTarget) else None

    @property
    def n_vias(self) -> int:
        """Number of targets before the last."""
        return len(self.targets) - 1

    @property
    def conditions(self) -> tuple[Condition, ...]:
        """The targets as conditions, with phases that the planner chooses."""
        return tuple(Condition(target, None) for target in self.targets)

    @property
    def primitives(self) -> tuple[MovementPrimitive, ...]:
        """The primitive of each segment."""
        return tuple(one.first.primitive for one in self.selections)

    @property
    def expected(self) -> tuple[ConditionalDistribution, ...]:
        """The prediction for each segment."""
        return tuple(one.first.expected for one in self.selections)

    @property
    def usual_duration(self) -> float:
        """The predicted duration of the whole motion [s]."""
        return sum(self.durations)

    def concatenate(
        self, bases: Sequence[MotionBasis], durations: Sequence[float], share: float = 1.0
    ) -> tuple[Motion, ...]:
        """Join the expected motions by the spline of least jerk, without optimisation.

        Parameters
        ----------
        bases : sequence of MotionBasis
            The bases of the segments.
        durations : sequence of float
            Durations of the segments [s].
        share : float
            Factor of the velocities and accelerations at the vias.
        """
        # Imported here, because the import is slow and a node may never need it.
        from scipy.interpolate import make_interp_spline

        times = np.concatenate([[0.0], np.cumsum(durations)])
        first = self.states[0]
        places = np.array([state.positions for state in self.states])
        rest = np.zeros_like(first.positions)
        rates = np.zeros((2, *places.shape))
        rates[:, 0] = first.velocities, first.accelerations
        for i, j in pairwise([0, *(np.flatnonzero(self.stops) + 1)]):
            spline = make_interp_spline(
                times[i : j + 1],
                places[i : j + 1],
                k=5,
                bc_type=([(1, rates[0, i]), (2, rates[1, i])], [(1, rest), (2, rest)]),
            )
            for d in (1, 2):
                rates[d - 1, i + 1 : j] = share * spline.derivative(d)(times[i + 1 : j])
        ends = [
            JointState(first.joint_names, q, v, a) for q, v, a in zip(places, *rates, strict=True)
        ]
        return tuple(
            Motion(here, there, float(duration), basis.basis, basis.expected)
            for (here, there), duration, basis in zip(pairwise(ends), durations, bases, strict=True)
        )

    def stretched(self, check: LimitCheck, durations: list[float], most: float) -> list[float]:
        """Longer durations of the free groups in which a limit is violated.

        Parameters
        ----------
        check : LimitCheck
            Check of the motion with these durations.
        durations : list of float
            The durations of the segments [s].
        most : float
            Largest factor on the predicted durations.
        """
        ends, longer = np.cumsum(durations), list(durations)
        for violation in check.violations:
            segment = min(int(np.searchsorted(ends, violation.time)), len(durations) - 1)
            group, is_fixed = next(one for one in self.groups if segment in one[0])
            if is_fixed or durations[segment] > most * self.durations[segment]:
                continue
            factor = slowdown(LimitCheck((violation,)))
            for i in group:
                longer[i] = max(longer[i], durations[i] * factor)
        return longer

    def resting_durations(self, least: FloatArray, step: float) -> tuple[float, ...]:
        """Durations of segments from rest to rest, not below the least ones [s].

        Parameters
        ----------
        least : array, shape (n_segments,)
            The least durations [s].
        step : float
            If the start moves, a free first duration is a multiple of this step [s].

        Raises
        ------
        TrajectoryError
            If fixed times leave less time.
        """
        durations = np.maximum(least, self.durations)
        if np.any([self.states[0].velocities, self.states[0].accelerations]):
            durations[0] = step * np.ceil(durations[0] / step - 1e-9)
        for group, is_fixed in self.groups:
            if is_fixed:
                part = list(group)
                needed, given = float(least[part].sum()), sum(self.durations[i] for i in part)
                if needed > given * (1.0 + 1e-9):
                    raise TrajectoryError(
                        f"{f'from target {part[0]} ' if part[0] else ''}to target {part[-1] + 1} "
                        f"a motion with rests takes {needed:.4g} s, {given:.4g} s are given"
                    )
                durations[part] = least[part] * (given / needed)
        return tuple(map(float, durations))


def fit_durations(
    usual: Sequence[float] | FloatArray, times: Sequence[float | None]
) -> tuple[float, ...]:
    """Predicted durations; those between two fixed times are scaled to the interval."""
    durations = np.array(usual)
    began, first = 0.0, 0
    for i, fixed in enumerate(times):
        if fixed is not None:
            part = slice(first, i + 1)
            durations[part] *= (fixed - began) / durations[part].sum()
            began, first = fixed, i + 1
    return tuple(map(float, durations))


def duration_groups(times: Sequence[float | None]) -> tuple[tuple[tuple[int, ...], bool], ...]:
    """The segments between fixed times, and whether the sum of their durations is fixed.

    The sum is fixed for all groups except the segments after the last fixed time.
    """
    groups, current = [], []
    for i, fixed in enumerate(times):
        current.append(i)
        if fixed is not None:
            groups.append((tuple(current), True))
            current = []
    if current:
        groups.append((tuple(current), False))
    return tuple(groups)


def passing_phases(durations: Sequence[float]) -> tuple[float, ...]:
    """The phases at the ends of segments."""
    ends = np.cumsum(durations)
    return tuple(map(float, ends / ends[-1]))
