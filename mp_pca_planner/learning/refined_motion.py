# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Motions made of planned ones by scaling and warping ([P] Section 2, the learning block).

With x(s) = h(s) + (1 + α)(μ + Σ wₖ φₖ)(s), a refined segment is q(t) = x(σ(t / T)) with
T = T₀ exp(δ): the amplitude α scales the shape between the end states, δ the duration, and
the monotone warp σ moves time. For all parameters, the segment starts and ends in the states of
the original, so segments remain continuous.

The warp is σ' = exp(u) with u = Σ cₖ bₖ − κ b₀ and functions bₖ = p²(1−p)² Pₖ(2p−1) of the phase p
that vanish at both ends with their first derivative. For all parameters c, σ increases, σ' = 1 and
σ'' = 0 at both ends. κ ensures σ(1) = 1.

A primitive around a refined motion has the mean shape of the original one, displaced so that it
predicts the motion for its end points; components and the conditional model are kept, so nearby
requests give similar motions. Gains of a control law are kept; its error bound is removed, because
it holds for another motion.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import Any

import numpy as np
from numpy.polynomial import legendre

from ..arrays import FloatArray, frozen_array, set_frozen
from ..control.law import without_bound
from ..exceptions import LearningError, PlannerError
from ..motion.interpolation import hermite_functions, quintics
from ..motion.trajectory import Trajectory
from ..planning.motion import Motion
from ..primitives.basis import (
    end_vanishing_coefficients,
    legendre_derivatives,
    legendre_values,
)
from ..primitives.differences import FINE_PHASES, expected_motion, path_difference
from ..primitives.primitive import MovementPrimitive
from ..primitives.timing import time_scaling
from ..robot.model import Robot

AMPLITUDE, LOG_DURATION, WARP = 0, 1, slice(2, 5)
"""Indices of the parameters of a segment: α, δ and those of the warp (towards an end, towards the
middle, and both); zeros leave it unchanged."""
N_PARAMETERS = WARP.stop

# Gauss–Legendre nodes of integrals over a segment.
_N_NODES = 40


def evaluate_warp(parameters: FloatArray, phases: FloatArray) -> FloatArray:
    """Evaluate a warp and its derivatives by phase.

    Parameters
    ----------
    parameters : array, shape (n_parameters,)
        c; zeros are the identity.
    phases : array, shape (n_steps,)
        Phases p in [0, 1].

    Returns
    -------
    values : array, shape (4, n_steps)
        σ and its first three derivatives.
    """
    analysis, integrals, bumps = _warp_tables()
    exponent = bumps[:, 1:] @ parameters
    exponent = exponent - _normalising(exponent, bumps[:, 0]) * bumps[:, 0]
    u, u1, u2 = legendre_derivatives(analysis @ exponent, phases, 2)
    shares, rates = legendre_values(integrals @ np.exp(exponent), phases), np.exp(u)
    return np.stack([shares, rates, rates * u1, rates * (u1**2 + u2)])


@cache
def _gauss_legendre() -> tuple[FloatArray, FloatArray]:
    return legendre.leggauss(_N_NODES)


@cache
def _warp_tables() -> tuple[FloatArray, FloatArray, FloatArray]:
    """Tables of warps.

    Returns
    -------
    analysis, integrals : array
        Matrices from values at the nodes to the coefficients of their Legendre series, and to those
        of its integral over phase, from 0 on.
    bumps : array
        b₀ (1 in the middle), b₁ … at the nodes.
    """
    # exp(u) is analytic: so many nodes give it to rounding for parameters of a few units.
    nodes, quadrature = _gauss_legendre()
    values = legendre.legvander(nodes, _N_NODES - 1)
    analysis = (values * quadrature[:, None] * (np.arange(_N_NODES) + 0.5)).T
    # The phase is p = (x + 1) / 2.
    integrals = np.asarray(legendre.legint(analysis, scl=0.5, lbnd=-1.0), np.float64)
    phases = (nodes + 1.0) / 2.0
    bump = 16.0 * (phases * (1.0 - phases)) ** 2
    return analysis, integrals, bump[:, None] * values[:, : WARP.stop - WARP.start + 1]


def _normalising(exponent: FloatArray, bump: FloatArray) -> float:
    """The κ that makes the integral of exp(exponent − κ bump) over phase 1."""
    _, quadrature = _gauss_legendre()
    kappa = 0.0
    for _ in range(50):
        rate = quadrature * np.exp(exponent - kappa * bump) / 2.0
        excess = float(rate.sum()) - 1.0
        # The integral is convex in κ and decreasing: Newton's method converges monotonically.
        kappa += excess / float(rate @ bump)
        if abs(excess) < 1e-14:
            break
    return kappa


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

    def effort(self, robot: Robot) -> float:
        """½∫‖τ‖²dt [N²·m²·s]."""
        (x, weights), total = _gauss_legendre(), 0.0
        for segment, part, duration in zip(
            self.segments, self.parameters, self.durations, strict=True
        ):
            tau = robot.inverse_dynamics(*segment_states(segment, part, (x + 1.0) / 2.0)[:3])
            total += 0.25 * duration * float(weights @ np.sum(tau**2, axis=1))
        return total

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
            values = segment_states(segment, self.parameters[i], phases)[:3]
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
        efforts = robot.inverse_dynamics(q, v, a)
        known = None if np.isnan(efforts).any() else efforts
        return Trajectory(robot.joint_names, times, q, v, a, known)


def segment_states(segment: Motion, parameters: FloatArray, phases: FloatArray) -> FloatArray:
    """Positions to jerks of one refined segment, shape (4, n_steps, n_joints).

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
    warp = evaluate_warp(parameters[WARP], phases)[:, :, None]
    s, rate, bend, third = np.clip(warp[0, :, 0], 0.0, 1.0), *warp[1:]
    boundary = replace(segment, duration=duration).boundary
    shapes = segment.basis.shapes(segment.weights, s, 3)
    x, x1, x2, x3 = quintics(s, boundary, 3) + (1.0 + parameters[AMPLITUDE]) * shapes
    by_phase = [
        x,
        x1 * rate,
        x2 * rate**2 + x1 * bend,
        x3 * rate**3 + 3.0 * x2 * rate * bend + x1 * third,
    ]
    return np.asarray(by_phase / duration ** np.arange(4.0)[:, None, None])


def demonstrated_distance(motion: RefinedMotion, primitives: Sequence[MovementPrimitive]) -> float:
    """Distance of a motion from what its primitives predict between the ends of its segments.

    The predictions are what would be demonstrated. The distance is the RMS over the paths, the
    joints and the segments [rad or m]; the timing does not count.
    """
    squares = []
    for segment, part, primitive in zip(
        motion.segments, motion.parameters, primitives, strict=True
    ):
        alone = RefinedMotion([segment], part)
        path, _, _ = alone.evaluate(alone.duration * FINE_PHASES)
        ends = segment.start.positions, segment.goal.positions
        expected = expected_motion(primitive, *ends, alone.duration)
        squares.append(path_difference(path, expected) ** 2)
    return float(np.sqrt(np.mean(squares)))


def primitive_around(
    primitive: MovementPrimitive, motion: RefinedMotion, name: str, provenance: Mapping[str, Any]
) -> MovementPrimitive:
    """Make a primitive of a refined motion.

    Parameters
    ----------
    primitive : MovementPrimitive
        The primitive of the original motion.
    motion : RefinedMotion
        The refined motion, of one segment.
    name : str
        Name of the new primitive.
    provenance : mapping
        Facts on its origin, of JSON types; the name of the original primitive is added.

    Returns
    -------
    family : MovementPrimitive
        Of the same joints, coupling and degree. Its `fit_residual` is an upper bound.

    Raises
    ------
    LearningError
        If the motion has several segments.
    """
    if len(motion.segments) != 1:
        raise LearningError(
            f"a primitive is made of one motion, got a sequence of {len(motion.segments)}: "
            "keep its segments one by one"
        )
    (segment,) = motion.segments
    start, goal = segment.start.positions, segment.goal.positions
    slower = motion.duration / segment.duration
    phases = np.linspace(0.0, 1.0, 201)
    requests = primitive.model.requests.copy()
    requests[:, -1] += np.log(slower)
    model = replace(primitive.model, requests=requests)
    expected = model.predict(start, goal, motion.duration)
    beyond = np.tensordot(expected.weights, primitive.component_coefficients, axes=1)
    mean = _shape_coefficients(motion, primitive, expected.pace, phases) - beyond
    # The errors of left-out motions are those of the original.
    metadata = without_bound(primitive.metadata) | {"left_out_error": None}
    metadata.pop("minimum_jerk_error", None)
    moved = legendre_values(mean - primitive.mean_coefficients, phases)
    return replace(
        primitive,
        name=name,
        metadata=metadata | {"refined_from": {"name": primitive.name, **provenance}},
        mean_coefficients=mean,
        durations=primitive.durations * slower,
        # The triangle inequality: the old residual, and the displacement of the mean.
        fit_residual=primitive.fit_residual + np.sqrt(np.mean(moved**2, axis=0)),
        model=model,
    )


def _shape_coefficients(
    motion: RefinedMotion, primitive: MovementPrimitive, pace: FloatArray, phases: FloatArray
) -> FloatArray:
    """Legendre coefficients, in aligned phase, of a motion less its boundary part.

    Their shape is (n_joints, degree + 1).
    """
    (segment,) = motion.segments
    aligned = phases
    if np.any(pace):
        aligned = np.clip(legendre_values(time_scaling(pace), phases), 0.0, 1.0)
    q, _, _ = motion.evaluate(phases * motion.duration)
    shape = q - hermite_functions(aligned) @ replace(segment, duration=motion.duration).boundary
    admissible = end_vanishing_coefficients(primitive.degree)
    weights, *_ = np.linalg.lstsq(legendre_values(admissible, aligned), shape, rcond=None)
    return np.asarray(weights.T @ admissible)
