# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Cost, limits and clearances of refined motions by their parameters, with derivatives."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.polynomial import legendre

from ..arrays import FloatArray
from ..motion.collision import Collision, CollisionModel
from ..motion.validation import LimitCheck
from ..planning.motion import Motion
from ..planning.options import ClearanceOptions
from ..planning.program.clearance import Clearances, least_distances
from ..robot.limits import JointLimits
from ..robot.model import Robot
from .refined_motion import LOG_DURATION, N_PARAMETERS, RefinedMotion, SegmentStates, segment_states


class RefinementCost:
    """Effort, and the price of time, by the parameters of a refinement.

    Parameters
    ----------
    segments : sequence of Motion
        The motions to refine.
    robot : Robot
        The model.
    time_price : float or None
        Cost of a second; None for none.
    n_nodes : int
        Quadrature nodes of a segment.
    """

    def __init__(
        self,
        segments: Sequence[Motion],
        robot: Robot,
        time_price: float | None = None,
        n_nodes: int = 40,
    ) -> None:
        robot.require_inertias("refinements")
        self._segments = tuple(segments)
        self._robot = robot
        self._price = time_price or 0.0
        x, weights = legendre.leggauss(n_nodes)
        self._phases, self._quadrature = (x + 1.0) / 2.0, weights / 2.0

    def effort_and_cost(self, parameters: FloatArray) -> tuple[float, float]:
        """½∫‖τ‖²dt [N²·m²·s], and that with the price of time."""
        return self._evaluated(parameters)[:2]

    def value_and_gradient(self, parameters: FloatArray) -> tuple[float, FloatArray]:
        """The cost and its gradient, by the parameters of all segments in one row."""
        return self._evaluated(parameters)[1:]

    def _evaluated(self, parameters: FloatArray) -> tuple[float, float, FloatArray]:
        """Effort, cost and its gradient."""
        efforts, total, gradient = 0.0, 0.0, np.zeros((len(self._segments), N_PARAMETERS))
        for i, part in enumerate(_by_segment(parameters)):
            states = segment_states(self._segments[i], part, self._phases)
            tau, by_parameter = _efforts(self._robot, states)
            weights = self._quadrature * states.duration
            effort = 0.5 * float(weights @ np.sum(tau**2, axis=1))
            cost = effort + self._price * states.duration
            efforts, total = efforts + effort, total + cost
            gradient[i] = np.einsum("s,sj,sjp->p", weights, tau, by_parameter)
            # The cost is proportional to the duration.
            gradient[i, LOG_DURATION] += cost
        return efforts, total, gradient.ravel()


class LimitConstraints:
    """Limits at chosen phases as inequalities g(parameters) ≥ 0, of order 1.

    Parameters
    ----------
    n_segments : int
        Segments of the motion.
    robot : Robot
        The model.
    limits : JointLimits
        Limits of the joints.
    margin : float
        Share of each limit that is kept free.
    n_phases : int
        Phases of each segment at which limits are constraints, besides those of violations found.
    """

    def __init__(
        self, n_segments: int, robot: Robot, limits: JointLimits, margin: float, n_phases: int = 25
    ) -> None:
        self._robot, self._margin = robot, margin
        self._phases = [np.linspace(0.02, 0.98, n_phases)] * n_segments
        # Rows: positions, velocities, accelerations, efforts and jerks.
        magnitudes = (limits.velocity, limits.acceleration, limits.effort, limits.jerk)
        upper = np.stack([limits.upper, *magnitudes])
        lower = np.stack([limits.lower, *(-x for x in magnitudes)])
        span = np.stack([limits.upper - limits.lower, *magnitudes])
        self._span = np.where(np.isfinite(span), span, 1.0)
        bounds = np.stack([upper, lower])
        self._is_limited = np.isfinite(bounds)
        self._bounds = np.where(self._is_limited, bounds, 0.0)

    def add_phases(self, motion: RefinedMotion, check: LimitCheck) -> None:
        """Add the phases at which a check found violations."""
        ends = np.cumsum(motion.durations)
        for violation in check.violations:
            i = min(int(np.searchsorted(ends, violation.time)), len(ends) - 1)
            phase = 1.0 - (ends[i] - violation.time) / motion.durations[i]
            self._phases[i] = np.unique([*self._phases[i], np.clip(phase, 0.0, 1.0)])

    def values_and_jacobian(
        self, segments: Sequence[Motion], parameters: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Values of g, and their derivatives by the parameters of all segments in one row."""
        values, rows = [], []
        signs = np.array([1.0, -1.0])[:, None, None, None]
        for i, part in enumerate(_by_segment(parameters)):
            states = segment_states(segments[i], part, self._phases[i])
            tau, by_parameter = _efforts(self._robot, states)
            jerks, of_jerks = _jerks(segments[i], part, self._phases[i])
            x = np.concatenate([states.values, tau[None], jerks[None]])
            dx = np.concatenate([states.by_parameter, by_parameter[None], of_jerks[None]])
            room = signs * (self._bounds[:, :, None] - x) / self._span[:, None] - self._margin
            slope = -signs[..., None] * dx / self._span[:, None, :, None]
            limited = np.broadcast_to(self._is_limited[:, :, None], room.shape)
            values.append(room[limited])
            rows.append(np.zeros((values[-1].size, parameters.size)))
            rows[-1][:, i * N_PARAMETERS : (i + 1) * N_PARAMETERS] = slope[limited]
        return np.concatenate(values), np.concatenate(rows)


class ClearanceConstraints:
    """Distances of the pairs of bodies that collided, as inequalities g(parameters) ≥ 0 [m].

    Parameters
    ----------
    segments : sequence of Motion
        The motions to refine.
    collision : CollisionModel or None
        Computes the distances, if collisions are avoided.
    """

    def __init__(self, segments: Sequence[Motion], collision: CollisionModel | None) -> None:
        self._model = collision
        self._clearances: list[Clearances] = []
        self._pairs = np.zeros(0, dtype=np.intp)
        if collision is not None:
            phases = np.linspace(0.0, 1.0, ClearanceOptions().n_phases + 1)
            for one in segments:
                q, _, _ = one.evaluate(phases * one.duration)
                # Bodies may come as near to each other as in the original.
                least = least_distances(q, collision)
                self._clearances.append(Clearances(phases[1:-1], least))

    def add(self, motion: RefinedMotion, collisions: Sequence[Collision]) -> None:
        """Constrain the pairs of some collisions of a motion."""
        ended = np.cumsum(motion.durations)
        for i, (end, duration) in enumerate(zip(ended, motion.durations, strict=True)):
            own = [one.within(end - duration, end) for one in collisions]
            met = [one for one in own if one is not None]
            if met:
                self._clearances[i] = self._clearances[i].during(met, duration)
        self._pairs = np.union1d(self._pairs, [one.pair for one in collisions]).astype(np.intp)

    def values_and_jacobian(
        self, segments: Sequence[Motion], parameters: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """See :meth:`LimitConstraints.values_and_jacobian`."""
        values, rows = [np.zeros(0)], [np.zeros((0, parameters.size))]
        if not self._pairs.size:
            return values[0], rows[0]
        assert self._model is not None
        for i, (part, one) in enumerate(
            zip(_by_segment(parameters), self._clearances, strict=True)
        ):
            states = segment_states(segments[i], part, one.phases)
            near = self._model.near(states.values[0], ClearanceOptions().reach)
            values.append((near.bounds - one.least)[:, self._pairs].ravel())
            slopes = np.zeros((*near.bounds.shape, parameters.size))
            own = slice(i * N_PARAMETERS, (i + 1) * N_PARAMETERS)
            by_parameter = states.by_parameter[0][near.configurations]
            slopes[near.configurations, near.pairs, own] = np.einsum(
                "ej,ejp->ep", near.rows, by_parameter
            )
            rows.append(slopes[:, self._pairs].reshape(-1, parameters.size))
        return np.concatenate(values), np.concatenate(rows)


def _efforts(robot: Robot, states: SegmentStates) -> tuple[FloatArray, FloatArray]:
    """Efforts (n_steps, n_joints) and their derivatives (…, N_PARAMETERS)."""
    tau, dtau = robot.inverse_dynamics_derivatives(*states.values)
    _, n_steps, n_joints, n_parameters = states.by_parameter.shape
    stacked = states.by_parameter.transpose(1, 0, 2, 3).reshape(n_steps, 3 * n_joints, n_parameters)
    return tau, dtau @ stacked


def _jerks(
    segment: Motion, parameters: FloatArray, phases: FloatArray, step: float = 1e-4
) -> tuple[FloatArray, FloatArray]:
    """Jerks (n_steps, n_joints) and their derivatives (…, N_PARAMETERS), by differences.

    The first and the last are those at the ends, where jerks are often largest.
    """
    at = np.concatenate([[0.0], phases[1:-1], [1.0]])
    around = np.clip([at - step, at + step], 0.0, 1.0)
    states = segment_states(segment, parameters, around.ravel())
    behind, ahead = states.values[2].reshape(2, len(at), -1)
    shape = (2, *ahead.shape, N_PARAMETERS)
    by_behind, by_ahead = states.by_parameter[2].reshape(shape)
    times = states.duration * (around[1] - around[0])[:, None]
    jerks = (ahead - behind) / times
    by_parameter = (by_ahead - by_behind) / times[..., None]
    by_parameter[..., LOG_DURATION] -= jerks  # the time between the two states grows, too
    return jerks, by_parameter


def _by_segment(parameters: FloatArray) -> FloatArray:
    return np.reshape(parameters, (-1, N_PARAMETERS))
