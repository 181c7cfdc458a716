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
from ..control.law import with_gains_only
from ..exceptions import LearningError, PlannerError
from ..motion.interpolation import hermite_functions
from ..motion.trajectory import Trajectory
from ..planning.motion import Motion
from ..primitives.basis import end_vanishing_coefficients, legendre_values
from ..primitives.pace import time_scaling
from ..primitives.primitive import MovementPrimitive
from ..robot.model import Robot

AMPLITUDE, LOG_DURATION, WARP = 0, 1, slice(2, 5)
"""Indices of the parameters of a segment: α, δ and those of the warp (towards an end, towards the
middle, and both); zeros leave it unchanged."""
N_PARAMETERS = WARP.stop


def evaluate_warp(parameters: FloatArray, phases: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Evaluate a warp, with its derivatives by phase and by parameter.

    Parameters
    ----------
    parameters : array, shape (n_parameters,)
        c; zeros are the identity.
    phases : array, shape (n_steps,)
        Phases p in [0, 1].

    Returns
    -------
    values : array, shape (3, n_steps)
        σ, σ' and σ''.
    by_parameter : array, shape (3, n_steps, n_parameters)
        Their derivatives by the parameters.
    """
    quadrature, analysis, table = _warp_tables()
    bump, bumps = table[:, 0], table[:, 1:]
    kappa = _normalising(bumps @ parameters, bump, quadrature)
    rate = quadrature * np.exp(bumps @ parameters - kappa * bump)
    # κ follows the parameters so that the integral of σ' stays 1.
    admissible = bumps - bump[:, None] * ((rate @ bumps) / (rate @ bump))
    # Columns: of the values, then of their derivatives by each parameter.
    exponents = (analysis @ np.column_stack([bumps @ parameters - kappa * bump, admissible])).T
    u, bend = (legendre_values(exponents, phases, d) for d in (0, 1))
    ratio = np.exp(u[:, :1])
    rates = np.hstack([ratio, ratio * u[:, 1:]])
    bends = np.hstack([ratio * bend[:, :1], rates[:, 1:] * bend[:, :1] + ratio * bend[:, 1:]])
    at_nodes = (rate / quadrature)[:, None] * np.column_stack([np.ones(len(rate)), admissible])
    # dp = dx / 2, and σ(0) = 0.
    integrals = legendre.legint((analysis @ at_nodes).T, scl=0.5, lbnd=-1.0, axis=1)
    shares = legendre_values(np.asarray(integrals, dtype=np.float64), phases)
    tables = np.stack([shares, rates, bends])
    return tables[:, :, 0], tables[:, :, 1:]


@cache
def _warp_tables() -> tuple[FloatArray, FloatArray, FloatArray]:
    """Weights of nodes; Legendre coefficients of values at them; b₀ (1 in the middle) … there."""
    # exp(u) is analytic: so many nodes give it to rounding for parameters of a few units.
    n_nodes = 40
    nodes, quadrature = legendre.leggauss(n_nodes)
    values = legendre.legvander(nodes, n_nodes - 1)
    analysis = (values * quadrature[:, None] * (np.arange(n_nodes) + 0.5)).T
    phases = (nodes + 1.0) / 2.0
    bump = 16.0 * (phases * (1.0 - phases)) ** 2
    return quadrature, analysis, bump[:, None] * values[:, : WARP.stop - WARP.start + 1]


def _normalising(exponent: FloatArray, bump: FloatArray, quadrature: FloatArray) -> float:
    """The κ that makes the integral of exp(exponent − κ bump) over phase 1."""
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
    (s, rate, bend), by_parameter = evaluate_warp(parameters[WARP], phases)
    by_s, by_rate, by_bend = (x[:, None, :] for x in by_parameter)
    s = np.clip(s, 0.0, 1.0)
    boundary = replace(segment, duration=duration).boundary
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
    moved = legendre_values(mean - primitive.mean_coefficients, phases)
    return replace(
        primitive,
        name=name,
        metadata=with_gains_only(primitive.metadata)
        | {"refined_from": {"name": primitive.name, **provenance}},
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
