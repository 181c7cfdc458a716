# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Motions made of planned ones by scaling and warping ([P] Section 2, the learning block).

With x(s) = h(s) + (1 + α)(μ + Σ wₖ φₖ)(s), a refined segment is q(t) = x(σ(t / T)) with
T = T₀ exp(δ): the amplitude α scales the shape between the end states, δ the duration, and
the warp σ moves time. For all parameters, the segment starts and ends in the states of the
original, so segments remain continuous.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..arrays import FloatArray, frozen_array, set_frozen
from ..exceptions import PlannerError
from ..motion.trajectory import Trajectory
from ..planning.motion import Motion
from ..primitives.boundary import boundary_values, hermite_functions
from ..robot.model import Robot
from .warp import N_WARP_PARAMETERS, evaluate_warp

AMPLITUDE, LOG_DURATION = 0, 1
WARP = slice(2, 2 + N_WARP_PARAMETERS)
N_PARAMETERS = 2 + N_WARP_PARAMETERS
"""Parameters of a segment: α, δ and those of the warp; zeros leave it unchanged."""


@dataclass(frozen=True, eq=False)
class RefinedMotion:
    """One motion, or several joined ones, scaled and warped.

    Attributes
    ----------
    segments : tuple of Motion
        The originals, each starting in the state in which the one before ends.
    parameters : array, shape (n_segments, N_PARAMETERS)
        Scaling and warp of each.

    Raises
    ------
    PlannerError
        If there is no segment or a number isn't finite.
    """

    segments: tuple[Motion, ...]
    parameters: FloatArray

    def __init__(self, segments: Sequence[Motion], parameters: FloatArray | None = None) -> None:
        if not segments:
            raise PlannerError("a motion to refine needs at least one segment, got none")
        shape = (len(segments), N_PARAMETERS)
        values = np.zeros(shape) if parameters is None else np.reshape(parameters, shape)
        values = frozen_array(values, shape, "refinement parameters", PlannerError)
        set_frozen(self, segments=tuple(segments), parameters=values)

    @cached_property
    def durations(self) -> FloatArray:
        """Durations of the segments, shape (n_segments,) [s]."""
        originals = np.array([segment.duration for segment in self.segments])
        return np.asarray(originals * np.exp(self.parameters[:, LOG_DURATION]))

    @property
    def duration(self) -> float:
        """Duration of the whole [s]."""
        return float(self._ends[-1])

    @cached_property
    def _ends(self) -> FloatArray:
        """When the segments end, shape (n_segments,) [s]."""
        return np.cumsum(self.durations)

    def lasting(self, duration: float) -> RefinedMotion:
        """The motion with all segments scaled to a total duration [s]."""
        parameters = self.parameters.copy()
        parameters[:, LOG_DURATION] += np.log(duration / self.duration)
        return RefinedMotion(self.segments, parameters)

    def evaluate(self, times: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Positions, velocities and accelerations at times from 0 to `duration` [s].

        Returns
        -------
        q, v, a : array, shape (n_steps, n_joints)
            [rad or m], [/s], [/s²]; at the ends of segments exactly their states.
        """
        ends = self._ends
        starts = np.concatenate([[0.0], ends[:-1]])
        index = np.minimum(np.searchsorted(ends, times, side="right"), len(ends) - 1)
        states = np.empty((3, len(times), len(self.segments[0].start.positions)))
        for i, segment in enumerate(self.segments):
            here = index == i
            # This form gives exactly 0 and 1 at the ends.
            phases = np.clip((times[here] - starts[i]) / (ends[i] - starts[i]), 0.0, 1.0)
            values = segment_states(segment, self.parameters[i], phases).values
            for end, state in ((phases == 0.0, segment.start), (phases == 1.0, segment.goal)):
                exact = np.stack([state.positions, state.velocities, state.accelerations])
                values[:, end] = exact[:, None]
            states[:, here] = values
        return states[0], states[1], states[2]

    def sample(self, robot: Robot, period: float) -> Trajectory:
        """The trajectory, with its efforts if they are known, points at most `period` apart [s]."""
        n_steps = max(int(np.ceil(self.duration / period - 1e-9)), 1)
        times = np.linspace(0.0, self.duration, n_steps + 1)
        q, v, a = self.evaluate(times)
        return Trajectory(robot.joint_names, times, q, v, a, robot.known_efforts(q, v, a))


@dataclass(frozen=True, eq=False)
class SegmentStates:
    """A refined segment at some phases.

    Attributes
    ----------
    duration : float
        Its duration [s].
    values : array, shape (3, n_steps, n_joints)
        Positions, velocities and accelerations.
    by_parameter : array, shape (3, n_steps, n_joints, N_PARAMETERS)
        Their derivatives by the parameters.
    """

    duration: float
    values: FloatArray
    by_parameter: FloatArray


def segment_states(segment: Motion, parameters: FloatArray, phases: FloatArray) -> SegmentStates:
    """Evaluate one refined segment with its derivatives by the parameters.

    Parameters
    ----------
    segment : Motion
        The original.
    parameters : array, shape (N_PARAMETERS,)
        Its scaling and warp.
    phases : array, shape (n_steps,)
        Phases of the refined segment.
    """
    duration = segment.duration * float(np.exp(parameters[LOG_DURATION]))
    warp = evaluate_warp(parameters[WARP], phases)
    s, rate, bend = warp.values
    by_s, by_rate, by_bend = (x[:, None, :] for x in warp.by_parameter)
    s = np.clip(s, 0.0, 1.0)
    boundary = _boundary(segment, duration)
    # A boundary value of order d is proportional to Tᵈ.
    growth = np.array([0.0, 1.0, 2.0, 0.0, 1.0, 2.0])[:, None] * boundary
    hermite = [hermite_functions(s, d) for d in range(4)]
    shape = segment.basis.shapes(segment.weights, s, 3)
    x, x1, x2, x3 = (
        table @ boundary + (1.0 + parameters[AMPLITUDE]) * part
        for table, part in zip(hermite, shape, strict=True)
    )
    rate, bend = rate[:, None], bend[:, None]
    values = np.stack([x, x1 * rate / duration, (x2 * rate**2 + x1 * bend) / duration**2])
    derivatives = np.zeros((*values.shape, N_PARAMETERS))
    for column, (y, y1, y2) in (
        (AMPLITUDE, shape[:3]),
        (LOG_DURATION, [table @ growth for table in hermite[:3]]),
    ):
        derivatives[0, :, :, column] = y
        derivatives[1, :, :, column] = y1 * rate / duration
        derivatives[2, :, :, column] = (y2 * rate**2 + y1 * bend) / duration**2
    derivatives[1, :, :, LOG_DURATION] -= values[1]
    derivatives[2, :, :, LOG_DURATION] -= 2.0 * values[2]
    x1, x2, x3, rate, bend = (part[:, :, None] for part in (x1, x2, x3, rate, bend))
    derivatives[0, :, :, WARP] = x1 * by_s
    derivatives[1, :, :, WARP] = (x2 * rate * by_s + x1 * by_rate) / duration
    derivatives[2, :, :, WARP] = (
        (x3 * rate**2 + x2 * bend) * by_s + 2.0 * x2 * rate * by_rate + x1 * by_bend
    ) / duration**2
    return SegmentStates(duration, values, derivatives)


def _boundary(segment: Motion, duration: float) -> FloatArray:
    ends = [(x.positions, x.velocities, x.accelerations) for x in (segment.start, segment.goal)]
    return boundary_values(ends[0], ends[1], duration)
