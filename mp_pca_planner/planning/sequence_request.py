# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A goal of several targets made complete, and joined in real time.

As shapes vanish with two derivatives at both ends, segments join in position, velocity and
acceleration as soon as their boundary parts h do, whatever the weights. The boundary parts that
are joined here are the quintic spline of least jerk through the vias (de Boor, "A Practical Guide
to Splines", 1978: one banded system).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ..arrays import FloatArray
from ..exceptions import TrajectoryError
from ..motion.goal import JointState
from ..primitives.conditional_model import ConditionalDistribution
from ..primitives.primitive import MovementPrimitive
from .conditions import Target
from .motion import Motion


@dataclass(frozen=True, eq=False)
class SequenceRequest:
    """A goal made complete, of n segments.

    Attributes
    ----------
    states : tuple of JointState
        At the start, then at rest at each target; n + 1 of them.
    targets : tuple of Target
        What the n last states must meet.
    stops : tuple of bool
        Whether the motion rests at each target.
    primitives, expected : tuple of MovementPrimitive, tuple of ConditionalDistribution
        Of each segment.
    durations : tuple of float
        The usual ones [s], fitted to fixed times.
    groups : tuple
        See :func:`duration_groups`.
    """

    states: tuple[JointState, ...]
    targets: tuple[Target, ...]
    stops: tuple[bool, ...]
    primitives: tuple[MovementPrimitive, ...]
    expected: tuple[ConditionalDistribution, ...]
    durations: tuple[float, ...]
    groups: tuple[tuple[tuple[int, ...], bool], ...]

    def concatenate(
        self, durations: Sequence[float] | None = None, share: float = 1.0
    ) -> tuple[Motion, ...]:
        """Join the expected motions by the spline of least jerk, without optimisation.

        Parameters
        ----------
        durations : sequence of float, optional
            Durations of the segments [s]; the usual ones unless given.
        share : float
            Factor of the velocities and accelerations at the vias.
        """
        # Takes long to import, and a node may never be asked for a sequence.
        from scipy.interpolate import make_interp_spline

        durations = self.durations if durations is None else durations
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
            Motion(here, there, float(duration), primitive.basis, expected.weights)
            for (here, there), duration, primitive, expected in zip(
                pairwise(ends), durations, self.primitives, self.expected, strict=True
            )
        )

    def resting_durations(self, least: FloatArray, step: float) -> tuple[float, ...]:
        """Durations of segments that begin and end at rest, at least so long [s].

        Parameters
        ----------
        least : array, shape (n_segments,)
            The least durations [s].
        step : float
            The first duration, if free, is a multiple of it where the start moves [s].

        Raises
        ------
        TrajectoryError
            If fixed times leave less.
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
    """Usual durations, those between two fixed times scaled to fill them."""
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

    It is for all but those after the last fixed time.
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
