# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The program of a sequence: effort and naturalness of all segments, by shared unknowns.

A segment shares unknowns with its neighbours only, so that the Hessian is banded, and an iteration
of the Levenberg–Marquardt method costs time linear in the number of segments.
"""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, cho_solve_banded, cholesky_banded

from ..arrays import FloatArray
from ..motion.goal import JointState
from ..primitives.basis import Basis
from ..primitives.boundary import boundary_values, hermite_functions
from ..primitives.conditional_model import ConditionalDistribution
from ..robot.limits import JointLimits
from ..robot.model import Robot
from .compiler import QuadratureTables
from .conditions import PoseTarget
from .motion import Motion
from .pose_search import POSE_TOLERANCE, nearest_configuration
from .selection import effort_of
from .sequence_request import SequenceRequest

_MOST_ITERATIONS = 60
_TOLERANCE = 1e-5
# Spread of the logarithm of durations that is as natural as a standard deviation of weights.
_DURATION_SPREAD = 0.3
# Passing at speed bends segments by more than demonstrations from rest to rest show: this many of
# their standard deviations count as one (`benchmarks/sequences.py` shows what comes of it). Where
# a joint hardly spreads, the deviation is at least this [rad or m].
_BEND_SPREAD, _LEAST_SPREAD = 18.0, 0.01


class _Tables(QuadratureTables):
    """Those of a quadrature, and of both ends, where limits are as easily broken."""

    def __init__(self, basis: Basis) -> None:
        super().__init__(basis)
        ends = np.array([0.0, 1.0])
        hermite = np.array([hermite_functions(ends, d) for d in range(len(self.hermite))])
        values = basis.tables(ends, len(self.hermite) - 1)
        functions = values[..., 1:].transpose(1, 0, 2, 3) * basis.scales
        self.phases = np.concatenate([self.phases, ends])
        self.quadrature = np.concatenate([self.quadrature, [0.0, 0.0]])
        self.hermite = np.concatenate([self.hermite, hermite], axis=1)
        self.mean = np.concatenate([self.mean, values[..., 0]], axis=1)
        self.functions = np.concatenate([self.functions, functions])


class _Segment:
    """One segment's part of the program.

    Its unknowns are, in this order: position, velocity and acceleration at its start, scaled
    weights, the logarithm of its duration, position, velocity and acceleration at its end;
    6 n + m + 1 of them.
    """

    def __init__(self, robot: Robot, limits: JointLimits, motion: Motion, tables: QuadratureTables):
        self._robot = robot
        self.motion, self._tables = motion, tables
        self.n, self.m = robot.n_joints, motion.basis.n_weights
        half = (limits.upper - limits.lower) / 2.0
        centre = np.where(np.isfinite(half), (limits.upper + limits.lower) / 2.0, 0.0)
        self._centre = centre
        self._bounds = (half, limits.velocity, limits.acceleration, limits.jerk)
        self._most_effort = limits.effort

    def unknowns(self) -> FloatArray:
        """Their values for the motion."""
        motion = self.motion
        begin, end = (
            np.concatenate([state.positions, state.velocities, state.accelerations])
            for state in (motion.start, motion.goal)
        )
        own = np.append(motion.weights / motion.basis.scales, np.log(motion.duration))
        return np.concatenate([begin, own, end])

    def scales(self) -> FloatArray:
        """Usual sizes of their changes."""
        n, duration = self.n, self.motion.duration
        end = np.repeat([1.0, 1.0 / duration, 5.0 / duration**2], n)
        return np.concatenate([end, np.ones(self.m + 1), end])

    def precision(self, expected: ConditionalDistribution) -> FloatArray:
        """How unlike the demonstrations a change of the unknowns from the motion is.

        A change of the states at the ends bends the motion, as weights do, so that it is weighed
        by how far the demonstrations spread, joint by joint, in the mean over the motion.
        """
        n, m, tables, scales = self.n, self.m, self._tables, self.motion.basis.scales
        clock = 3 * n + m
        precision = np.zeros((clock + 1 + 3 * n, clock + 1 + 3 * n))
        precision[3 * n : clock, 3 * n : clock] = expected.precision * np.outer(scales, scales)
        precision[clock, clock] = _DURATION_SPREAD**-2
        functions = tables.functions[:, 0] / scales
        variances = np.einsum(
            "k,kji,il,kjl->j", tables.quadrature, functions, expected.covariance, functions
        )
        spreads = _BEND_SPREAD * np.maximum(np.sqrt(variances), _LEAST_SPREAD)
        bends = tables.hermite[0] * self.motion.duration ** np.tile(np.arange(3.0), 2)
        gram = bends.T @ (bends * tables.quadrature[:, None])
        ends = np.concatenate([np.arange(0, 3 * n, n), clock + 1 + np.arange(0, 3 * n, n)])
        for j in range(n):
            precision[np.ix_(ends + j, ends + j)] += gram / spreads[j] ** 2
        return precision

    def linearise(
        self, u: FloatArray, free: NDArray[np.intp], penalty: float, margin: float
    ) -> tuple[FloatArray, FloatArray]:
        """Residuals of effort and of broken limits, and their derivatives by free unknowns."""
        n, m, tables = self.n, self.m, self._tables
        clock = 3 * n + m
        begin = u[:n], u[n : 2 * n], u[2 * n : 3 * n]
        end = u[clock + 1 : -2 * n], u[-2 * n : -n], u[-n:]
        duration = float(np.exp(u[clock]))
        powers = np.array([0.0, 1.0, 2.0, 0.0, 1.0, 2.0])
        ends = boundary_values(begin, end, duration)
        # Jerks matter for their limits alone.
        n_rates = 4 if penalty > 0.0 and np.isfinite(self._bounds[3]).any() else 3
        rates = duration ** -np.arange(float(n_rates))
        hermite, functions = tables.hermite[:n_rates], tables.functions[:, :n_rates]
        shape = tables.mean[:n_rates] + (functions @ u[3 * n : clock]).transpose(1, 0, 2)
        states = (hermite @ ends + shape) * rates[:, None, None]
        by = np.zeros((hermite.shape[1], n_rates, n, u.size))
        eye = np.eye(n)
        for function, power in enumerate(powers):
            column = function * n if function < 3 else clock + 1 + (function - 3) * n
            values = (hermite[:, :, function] * (duration**power * rates)[:, None]).T
            by[:, :, :, column : column + n] = values[:, :, None, None] * eye
        by[..., 3 * n : clock] = functions * rates[:, None, None]
        growth = (hermite @ (powers[:, None] * ends)) * rates[:, None, None]
        growth -= np.arange(float(n_rates))[:, None, None] * states
        by[..., clock] = growth.transpose(1, 0, 2)
        by = by[..., free]
        tau, dtau = self._robot.inverse_dynamics_derivatives(*states[:3])
        by_effort = dtau @ by[:, :3].reshape(len(tau), 3 * n, -1)
        root = np.sqrt(tables.quadrature * duration)[:, None]
        residual = [(tau * root).ravel()]
        jacobian = by_effort * root[:, :, None]
        jacobian[..., free == clock] += (0.5 * tau * root)[..., None]
        jacobians = [jacobian.reshape(tau.size, -1)]
        if penalty > 0.0:
            values = np.concatenate([states, tau[None]])
            values[0] -= self._centre
            slopes = np.concatenate([by.transpose(1, 0, 2, 3), by_effort[None]])
            bounds = np.stack([*self._bounds[:n_rates], self._most_effort])[:, None]
            signed = values / bounds
            over = np.abs(signed) - (1.0 - margin)
            broken = np.isfinite(bounds) & (over > 0.0)
            weight = np.sqrt(penalty / len(tau))
            residual.append(weight * over[broken])
            scale = np.broadcast_to(np.sign(signed) / bounds, broken.shape)[broken]
            jacobians.append(weight * scale[:, None] * slopes[broken])
        return np.concatenate(residual), np.concatenate(jacobians)


class SequenceProgram:
    """The whole sequence: unknowns in the order segment, target, segment, …, target.

    Those of a segment are its weights and its duration; those of a target its position, if it is
    a pose, and velocity and acceleration, unless the motion stops there.
    """

    def __init__(
        self,
        robot: Robot,
        limits: JointLimits,
        request: SequenceRequest,
        start: tuple[Motion, ...],
        naturalness: float,
    ) -> None:
        n = robot.n_joints
        self._n, self._start_motions = n, start
        self._robot, self._limits = robot, limits
        tables = {p.name: _Tables(p.basis) for p in request.primitives}
        self.segments = [
            _Segment(robot, limits, motion, tables[primitive.name])
            for motion, primitive in zip(start, request.primitives, strict=True)
        ]
        # Of each segment: all of its unknowns, which of them are free, where those are among all
        # free ones, and where its weights and its duration are. Of poses: where positions are.
        self._locals = [segment.unknowns() for segment in self.segments]
        self._free: list[NDArray[np.intp]] = []
        self._where: list[slice] = []
        self._own: list[slice] = []
        self._posed: list[tuple[slice, PoseTarget]] = []
        at, before = 0, np.arange(0)
        for segment, target, stops in zip(
            self.segments, request.targets, request.stops, strict=True
        ):
            own = 3 * n + np.arange(segment.m + 1)
            after = np.arange(n if stops else 3 * n)
            self._own.append(slice(at, at + own.size))
            at += own.size
            if isinstance(target, PoseTarget):
                self._posed.append((slice(at, at + n), target))
            else:
                after = after[n:]
            at += after.size
            self._free.append(np.concatenate([before, own, own[-1] + 1 + after]))
            self._where.append(slice(at - self._free[-1].size, at))
            before = after
        self.size = at
        self._band = min(max(free.size for free in self._free), self.size) - 1
        self._scales = np.ones(self.size)
        x = np.zeros(self.size)
        for segment, local, free, where in zip(
            self.segments, self._locals, self._free, self._where, strict=True
        ):
            x[where], self._scales[where] = local[free], segment.scales()[free]
        self.start = x
        self._groups = [group for group, _ in request.groups]
        self._durations = [motion.duration for motion in start]
        efforts = [effort_of(robot, motion) for motion in start]
        self._reference = sum(efforts)
        self._priors = [
            naturalness * effort * segment.precision(expected)[np.ix_(free, free)]
            for effort, segment, expected, free in zip(
                efforts, self.segments, request.expected, self._free, strict=True
            )
        ]

    def _local(self, x: FloatArray, i: int) -> FloatArray:
        """All unknowns of a segment."""
        u = self._locals[i].copy()
        u[self._free[i]] = x[self._where[i]]
        return u

    def motions(self, x: FloatArray) -> tuple[Motion, ...]:
        """The segments that unknowns stand for."""
        n, motions = self._n, []
        durations = self._exact_durations(x)
        names = self._start_motions[0].start.joint_names
        before = self._start_motions[0].start
        for i, (segment, old) in enumerate(zip(self.segments, self._start_motions, strict=True)):
            u = self._local(x, i)
            clock = 3 * n + segment.m
            goal = JointState(names, *u[clock + 1 :].reshape(3, n))
            motions.append(
                replace(
                    old,
                    start=before,
                    goal=goal,
                    duration=durations[i],
                    weights=u[3 * n : clock] * old.basis.scales,
                )
            )
            before = goal
        return tuple(motions)

    def _exact_durations(self, x: FloatArray) -> list[float]:
        """Durations, their sums over groups to the last bits."""
        durations = [float(np.exp(x[own.stop - 1])) for own in self._own]
        for group in self._groups:
            factor = sum(self._durations[i] for i in group) / sum(durations[i] for i in group)
            for i in group:
                durations[i] *= factor
        return durations

    def _assemble(
        self, x: FloatArray, penalty: float, margin: float
    ) -> tuple[float, FloatArray, FloatArray]:
        """Cost, gradient and Gauss–Newton Hessian (lower band) by scaled unknowns."""
        cost = 0.0
        gradient = np.zeros(self.size)
        band = np.zeros((self._band + 1, self.size))
        for i, segment in enumerate(self.segments):
            where, free = self._where[i], self._free[i]
            residual, jacobian = segment.linearise(
                self._local(x, i), free, penalty * self._reference, margin
            )
            hessian = jacobian.T @ jacobian
            slope = jacobian.T @ residual
            deviation = x[where] - self._locals[i][free]
            pull = self._priors[i] @ deviation
            hessian += self._priors[i]
            slope += pull
            cost += 0.5 * float(residual @ residual + deviation @ pull)
            gradient[where] += slope
            for d in range(len(slope)):
                band[d, where.start : where.stop - d] += np.diagonal(hessian, -d)
        scaled = band.copy()
        for d in range(self._band + 1):
            stop = self.size - d
            scaled[d, :stop] *= self._scales[:stop] * self._scales[d:]
        return cost, gradient * self._scales, scaled

    def minimise(
        self, x: FloatArray, penalty: float, margin: float, deadline: float = float("inf")
    ) -> tuple[FloatArray, int, bool]:
        """Levenberg–Marquardt steps downhill from x, within fixed sums of durations.

        Returns
        -------
        x, passes, converged
            The unknowns, the passes this took, and whether no further step was worth it.
        """
        cost, gradient, band = self._assemble(x, penalty, margin)
        damping, passes = 1e-3 * float(np.mean(band[0])), 1
        while passes < _MOST_ITERATIONS and time.perf_counter() < deadline:
            step = self._step(x, gradient, band, damping)
            if step is None:
                damping *= 10.0
                continue
            predicted = -float(gradient @ step) - 0.5 * _quadratic(band, step)
            new = self._shifted(x, step)
            if new is None:
                damping *= 5.0
                continue
            new_cost, new_gradient, new_band = self._assemble(new, penalty, margin)
            passes += 1
            decrease = cost - new_cost
            if decrease > 0.0:
                x, cost, gradient, band = new, new_cost, new_gradient, new_band
                gain = decrease / max(predicted, 1e-300)
                damping *= 0.3 if gain > 0.5 else 1.5
                if decrease <= _TOLERANCE * cost:
                    break
            else:
                damping *= 5.0
                if predicted <= 1e-2 * _TOLERANCE * cost or not np.isfinite(damping):
                    break
        else:
            return x, passes, False
        return x, passes, True

    def _shifted(self, x: FloatArray, step: FloatArray) -> FloatArray | None:
        """Take a step, with poses and sums of durations restored; None if a pose can't be."""
        new = np.asarray(x + self._scales * step)
        for where, target in self._posed:
            pose = target.pose
            new[where], error = nearest_configuration(self._robot, self._limits, pose, new[where])
            if np.abs(error).max() > POSE_TOLERANCE:
                return None
        for i, duration in enumerate(self._exact_durations(new)):
            new[self._own[i].stop - 1] = np.log(duration)
        return new

    def _step(
        self, x: FloatArray, gradient: FloatArray, band: FloatArray, damping: float
    ) -> FloatArray | None:
        """The damped Newton step that keeps, to first order, poses and sums of durations."""
        damped = band.copy()
        damped[0] += damping
        try:
            factor = cholesky_banded(damped, lower=True, check_finite=False)
        except LinAlgError:
            return None
        sums = np.zeros((len(self._groups), self.size))
        for row, group in zip(sums, self._groups, strict=True):
            for i in group:
                place = self._own[i].stop - 1
                row[place] = np.exp(x[place])
        rows = [sums]
        for where, target in self._posed:
            slopes = target.error(x[where])[1]
            rows.append(np.zeros((len(slopes), self.size)))
            rows[-1][:, where] = slopes
        kept = np.vstack(rows)
        solved = cho_solve_banded((factor, True), np.column_stack([gradient, kept.T]))
        free, across = solved[:, 0], solved[:, 1:]
        # A pose may have more equations than joints.
        multipliers = np.linalg.lstsq(kept @ across, kept @ free, rcond=None)[0]
        return np.asarray(across @ multipliers - free)


def _quadratic(band: FloatArray, x: FloatArray) -> float:
    """The form xᵀHx of a symmetric H given by its lower band."""
    total = float(band[0] @ x**2)
    for d in range(1, len(band)):
        total += 2.0 * float(band[d, : len(x) - d] @ (x[d:] * x[: len(x) - d]))
    return total
