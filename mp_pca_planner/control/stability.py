# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Stability of a control law along a motion: poles, a bound on the error, the effort reserve.

The bound is a small-gain argument for peaks (Desoer and Vidyasagar, "Feedback Systems:
Input–Output Properties", 1975, chapter III; Dahleh and Diaz-Bobillo, "Control of Uncertain
Systems", 1995). With the error e = q_d − q, the nominal model (hats) linearised about the motion,
and the true inertial parameters π̂ + Δπ, in which inverse dynamics are linear, the loop is

    M̂ë + Ĉė + Ĝe + (feedback) = Y(q_d)Δπ + lag − (ΔM ë + ΔC ė + ΔG e) + r

with the following terms on the right: the effort of the wrong parameters along the motion itself,
the lag of the feed-forward by sampling and delay, the change of the linear part by the parameters,
and the nonlinear remainder. The first two are known except for the factors Δπ: the nominal loop,
sampled and delayed, is simulated for each of them, which bounds their joint effect exactly. Each
link has four factors, of its mass and of its principal moments of inertia. The steps of this loop
hold the efforts of their middles; the difference from a simulation of the nominal loop is added.
The rest, w, is bounded through the peaks z of (‖e‖, ‖ė‖, ‖ë‖) and the peak gains H of the nominal
loop,

    ‖w‖ ≤ cᵀz + ‖r‖,   z ≤ z₁ + H ‖w‖,

in each of some intervals of the motion: H is a matrix from the intervals before.
Friction is one more effort on the right. Its direction may change at any time, so its largest norm
is added to ‖w‖. Bounds ‖w‖ that these two inequalities map into themselves are valid.

The norms are those of the mass matrix, ‖ë‖² = ëᵀM̂ë and ‖w‖² = wᵀM̂⁻¹w: for inertias with a
relative error δ, ‖ΔM ë‖ ≤ δ‖ë‖ holds in these norms on any robot. The remainder r is an estimate:
its largest value at sampled corners of the box of errors, times a factor of safety.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..lazy import LazyModule
from ..robot.model import Robot
from .closed_loop import ControlLoop, ErrorModel, simulate
from .law import COMPUTED_TORQUE

linalg = LazyModule("scipy.linalg")

# Intervals of the motion with bounds of their own; the time grows with their square.
_N_INTERVALS = 40
# Random corners of the box of errors at which the nonlinear remainder is evaluated.
_N_CORNERS = 32
# Factor on the estimated parts of the bound, ≥ 1.
_SAFETY = 1.5
# Samples between two evaluations of the gains, which change slowly along a motion.
_GAIN_PERIOD = 5
# Instants at which poles are computed.
_N_POLE_TIMES = 25
# Iterations towards bounds that map into themselves, and their relative excess at each.
_MAX_ROUNDS = 1000
_EXCESS = 1e-3
# Relative size below which a response counts as decayed.
_FORGOTTEN = 1e-8
# Largest meaningful bound; above it, no bound is reported [SI].
_MAX_BOUND = 1e4


@dataclass(frozen=True, eq=False)
class Stability:
    """Poles, error bound and effort reserve of a law along a motion.

    Attributes
    ----------
    slowest_pole : float
        Largest real part of the nominal closed loop's poles along the motion [1/s]; negative
        means that it is stable at every point.
    least_damping : float
        Least damping ratio of the poles.
    sampled_radius : float
        Largest magnitude of the poles of the sampled loop with its delay; below 1: stable.
    error_bound : array, shape (n_samples, n_joints), or None
        Bound on |q_d − q| at each; None if there is none.
    effort_bound : array, shape (n_samples, n_joints), or None
        Bound on the efforts of the law.
    effort_reserve : float
        Least share of the effort limit that is left, negative if efforts may saturate: then the
        bound is void. 1 without effort limits; that of the motion alone if there is no bound.
    """

    slowest_pole: float
    least_damping: float
    sampled_radius: float
    error_bound: FloatArray | None
    effort_bound: FloatArray | None
    effort_reserve: float

    @property
    def holds(self) -> bool:
        """Whether there is a bound, and efforts can't saturate."""
        return self.error_bound is not None and self.effort_reserve >= 0.0


def analyse(control: ControlLoop, errors: ErrorModel) -> Stability:
    """Analyse the stability of a law along a motion.

    Parameters
    ----------
    control : ControlLoop
        The law and the motion.
    errors : ErrorModel
        Assumed errors of the model and of the start.

    Raises
    ------
    RobotError
        If a moving link of the model has no valid inertia.
    """
    model = control.model
    model.require_inertias("statements on stability")
    loop = NominalLoop(control)
    changed = _changed_robots(model) if errors.inertia else []
    known = _known_responses(loop, changed, errors)
    gains = _peak_gains(loop)
    changes = _parameter_changes(loop, changed, errors)
    rest = _rest(loop, control, errors, known, gains, changes)
    bound = effort_bound = None
    efforts = np.abs(loop.feedforward)
    if rest is not None:
        n = model.n_joints
        z = known[0] + np.einsum("ljc,j->lc", gains[1], rest)[loop.interval]
        bound = z[:, :n]
        feedback = np.einsum("kij,kj->ki", np.abs(loop.feedback), z[:, : 2 * n])
        efforts = effort_bound = efforts + feedback
    reserve = float((1.0 - efforts / control.effort_limits).min())
    return Stability(*_poles(loop), bound, effort_bound, reserve)


class NominalLoop:
    """The nominal loop along a motion, linearised and sampled: x = (e, ė), input an effort."""

    def __init__(self, control: ControlLoop) -> None:
        model, law, step = control.model, control.law, control.period
        n = self.n = model.n_joints
        self.delay, self.times = control.delay, control.times
        unlimited = replace(control, effort_limits=np.array(np.inf))
        self.errors = simulate(unlimited, model, np.zeros(n))[0]
        # Intervals of equal length, and the one of each sample.
        per_interval = max(len(self.times) // _N_INTERVALS, 1)
        self.interval = np.arange(len(self.times)) // per_interval
        self.edges = np.arange(0, len(self.times), per_interval)
        self.feedforward, linear = model.inverse_dynamics_derivatives(*control.reference)
        # Feedback gains of the law at the samples: effort per error.
        gains = np.concatenate([np.diag(law.position_gains), np.diag(law.velocity_gains)], axis=1)
        self.feedback = np.broadcast_to(gains, (len(self.times), n, 2 * n))
        if law.kind == COMPUTED_TORQUE:
            self.feedback = linear[:, :, 2 * n :] @ gains - linear[:, :, : 2 * n]
        # The dynamics between samples, with coefficients of the middle of the step.
        self.middle = control.reference_at(self.times + 0.5 * step)
        self.middle_efforts, self.linear = model.inverse_dynamics_derivatives(*self.middle)
        self.mass_inverse = np.linalg.inv(self.linear[:, :, 2 * n :])
        eigenvalues, vectors = np.linalg.eigh(self.linear[:, :, 2 * n :])
        self.root = (vectors * np.sqrt(eigenvalues)[:, None]) @ vectors.transpose(0, 2, 1)
        self.inverse_root = np.linalg.inv(self.root)
        self.drift = -self.mass_inverse @ self.linear[:, :, : 2 * n]
        system = np.zeros((len(self.times), 3 * n, 3 * n))
        system[:, :n, n : 2 * n] = np.eye(n)
        system[:, n : 2 * n, : 2 * n] = self.drift
        system[:, n : 2 * n, 2 * n :] = self.mass_inverse
        whole = linalg.expm(system * step)
        self.transition = whole[:, : 2 * n, : 2 * n]
        self.input = whole[:, : 2 * n, 2 * n :]

    def respond(self, disturbance: FloatArray, start: FloatArray) -> FloatArray:
        """Responses to efforts on the right-hand side, held over each step.

        Parameters
        ----------
        disturbance : array, shape (n_samples, n_joints, n_signals)
            The efforts.
        start : array, shape (2 n_joints, n_signals)
            Errors at the start.

        Returns
        -------
        responses : array, shape (n_samples, 3 n_joints, n_signals)
            e, ė and ë.
        """
        n = self.n
        x = start
        # As in the simulation, the law acts on the start error before the start.
        pending = [self.feedback[0] @ start] * self.delay
        responses = np.empty((len(self.times), 3 * n, start.shape[1]))
        for k, push in enumerate(disturbance):
            pending.append(self.feedback[k] @ x)
            effort = push - pending.pop(0)
            responses[k, : 2 * n] = x
            responses[k, 2 * n :] = self.drift[k] @ x + self.mass_inverse[k] @ effort
            x = self.transition[k] @ x + self.input[k] @ effort
        return responses


def _poles(loop: NominalLoop) -> tuple[float, float, float]:
    """Largest real part, least damping ratio, and radius of the sampled poles."""
    n, delay = loop.n, loop.delay
    rows = np.unique(np.linspace(0, len(loop.times) - 1, _N_POLE_TIMES).astype(int))
    transition, push, feedback = loop.transition[rows], loop.input[rows], loop.feedback[rows]
    continuous = np.zeros((len(rows), 2 * n, 2 * n))
    continuous[:, :n, n:] = np.eye(n)
    continuous[:, n:] = loop.drift[rows] - loop.mass_inverse[rows] @ feedback
    poles = np.linalg.eigvals(continuous)
    # State: x, then the delayed efforts.
    size = (2 + delay) * n
    sampled = np.zeros((len(rows), size, size))
    sampled[:, : 2 * n, : 2 * n] = transition
    if delay == 0:
        sampled -= push @ feedback
    else:
        sampled[:, : 2 * n, 2 * n : 3 * n] = -push
        sampled[:, 2 * n : size - n, 3 * n :] = np.eye(size - 3 * n)
        sampled[:, size - n :, : 2 * n] = feedback
    radius = np.abs(np.linalg.eigvals(sampled)).max()
    return float(poles.real.max()), float((-poles.real / np.abs(poles)).min()), float(radius)


def _known_responses(
    loop: NominalLoop, changed: Sequence[Robot], errors: ErrorModel
) -> tuple[FloatArray, FloatArray]:
    """Bounds on the responses to the disturbances that are known except for their factors.

    Returns
    -------
    values : array, shape (n_samples, 3 n)
        Of |e|, |ė| and |ë| of each joint.
    norms : array, shape (n_intervals, 3)
        Peaks of ‖e‖, ‖ė‖ and ‖ë‖ in each interval.
    """
    n = loop.n
    pushes = [
        errors.inertia * (robot.inverse_dynamics(*loop.middle) - loop.middle_efforts)
        for robot in changed
    ]
    # Efforts computed for one sample act `delay` samples later.
    computed = np.arange(len(loop.times)) - loop.delay
    pushes.append(loop.middle_efforts - loop.feedforward[np.maximum(computed, 0)])
    signals = np.stack(pushes, axis=2)
    still = np.zeros((len(loop.times), n, n))
    responses = np.concatenate(
        [
            loop.respond(signals, np.zeros((2 * n, signals.shape[2]))),
            loop.respond(still, errors.position * np.eye(2 * n, n)),
        ],
        axis=2,
    )
    parts = np.split(responses, 3, axis=1)
    norms = [np.linalg.norm(loop.root @ part, axis=1).sum(axis=1) for part in parts]
    values = np.abs(responses).sum(axis=2)
    # The effort in the middle of a step represents the whole step. The error of this approximation
    # is computed for the nominal loop; parameter errors change it little.
    missed = np.abs(loop.errors - responses[:, :n, len(pushes) - 1])
    values[:, :n] += _SAFETY * missed.max(axis=0)
    return values, np.maximum.reduceat(np.stack(norms, axis=1), loop.edges)


def _changed_robots(model: Robot) -> list[Robot]:
    """Robots with the mass, or one principal moment of inertia, of one link doubled."""
    ones = np.ones((len(model.link_inertias), 4))
    units = np.eye(ones.size).reshape(-1, *ones.shape)
    return [model.with_link_inertias(ones + unit) for unit in units]


def _parameter_changes(
    loop: NominalLoop, changed: Sequence[Robot], errors: ErrorModel
) -> FloatArray:
    """Vector c of the module docstring: norms of ΔG, ΔC and ΔM, shape (n_intervals, 3)."""
    n = loop.n
    change = np.zeros((len(loop.times), 3))
    root = loop.inverse_root[:, None]
    for robot in changed:
        _, linear = robot.inverse_dynamics_derivatives(*loop.middle)
        difference = (linear - loop.linear).reshape(-1, n, 3, n).transpose(0, 2, 1, 3)
        norms = np.linalg.norm(root @ difference @ root, 2, axis=(2, 3))
        change[:, :2] += errors.inertia * norms[:, :2]
    change[:, 2] += errors.inertia  # −δM̂ ≤ ΔM ≤ δM̂ for the parts of all links together
    return np.asarray(np.maximum.reduceat(change, loop.edges))


def _peak_gains(loop: NominalLoop) -> tuple[FloatArray, FloatArray]:
    """Peak gains of the nominal loop from ‖w‖ in each interval to each later one.

    Returns
    -------
    norms : array, shape (n_intervals, n_intervals, 3)
        To ‖e‖, ‖ė‖ and ‖ë‖, later intervals first.
    rows : array, shape (n_intervals, n_intervals, 3 n)
        To each |e|, |ė| and |ë|.
    """
    n, m = loop.n, len(loop.edges)
    # Columns: responses to unit efforts, weighted, in each step so far.
    x = np.zeros((2 * n, 0))
    pending = [np.zeros((n, 0))] * loop.delay
    norms, rows = np.zeros((m, m, 3)), np.zeros((m, m, 3 * n))
    forgotten = 0
    for k, later in enumerate(loop.interval):
        pending.append(loop.feedback[k] @ x)
        delayed = pending.pop(0)
        effort = np.zeros((n, x.shape[1] + n))
        effort[:, : delayed.shape[1]] = -delayed
        effort[:, -n:] = loop.root[k]
        x = np.concatenate([x, np.zeros((2 * n, n))], axis=1)
        if k % _GAIN_PERIOD == 0 or k + 1 == len(loop.times) or loop.interval[k + 1] > later:
            outputs = np.concatenate([x, loop.drift[k] @ x + loop.mass_inverse[k] @ effort])
            # Shape (3, n_impulses, n, n).
            blocks = outputs.reshape(3, n, -1, n).transpose(0, 2, 1, 3)
            row_norms = np.sqrt(np.einsum("cbij,cbij->bci", blocks, blocks))
            spectral = _norms(loop.root[k] @ blocks).T
            earlier, first = np.unique(loop.interval[forgotten : k + 1], return_index=True)
            for table, values in ((norms, spectral), (rows, row_norms.reshape(-1, 3 * n))):
                sums = np.add.reduceat(values, first)
                table[later, earlier] = np.maximum(table[later, earlier], sums)
        x = loop.transition[k] @ x + loop.input[k] @ effort
        if k % 100 == 99:
            alive = _alive(x, n)
            forgotten += alive
            x, pending = x[:, alive * n :], [part[:, alive * n :] for part in pending]
    return norms, rows


def _norms(matrices: FloatArray) -> FloatArray:
    """Tight upper bounds on the spectral norms of many matrices, computed fast."""
    magnitude = np.abs(matrices)
    sums = magnitude.sum(axis=-1).max(axis=-1) * magnitude.sum(axis=-2).max(axis=-1)
    squares = np.einsum("...ij,...ij->...", matrices, matrices)
    return np.asarray(np.sqrt(np.minimum(sums, squares)))


def _alive(x: FloatArray, n: int) -> int:
    """Index of the first response that has not decayed."""
    size = np.abs(x).max(axis=0).reshape(-1, n).max(axis=1)
    return int(np.argmax(size > _FORGOTTEN * size.max()))


def _rest(
    loop: NominalLoop,
    control: ControlLoop,
    errors: ErrorModel,
    known: tuple[FloatArray, FloatArray],
    gains: tuple[FloatArray, FloatArray],
    changes: FloatArray,
) -> FloatArray | None:
    """Bounds ‖w‖ of each interval that map into themselves; None if there are none."""
    (values, known_norms), (norm_gains, row_gains) = known, gains
    peaks = np.maximum.reduceat(values, loop.edges)
    friction, rest = _friction(loop, errors), np.zeros(len(changes))
    for _ in range(_MAX_ROUNDS):
        z = peaks + np.einsum("ljc,j->lc", row_gains, rest)
        norms = known_norms + np.einsum("ljc,j->lc", norm_gains, rest)
        if not z.max() < _MAX_BOUND:
            return None
        remainder = _remainder(loop, control, errors, z)
        needed = np.sum(changes * norms, axis=1) + remainder + friction
        if np.all(needed <= rest):
            return rest
        # Slightly larger bounds than needed, so that the iteration ends inside of its own image.
        rest = np.maximum(rest, (1.0 + _EXCESS) * needed)
    return None


def _friction(loop: NominalLoop, errors: ErrorModel) -> FloatArray:
    """Largest norm of friction of any direction in each interval, shape (n_intervals,)."""
    sizes = np.broadcast_to(errors.friction, (loop.n,))
    squares = np.einsum("i,kij,j->k", sizes, np.abs(loop.mass_inverse), sizes)
    return np.asarray(np.maximum.reduceat(np.sqrt(squares), loop.edges))


def _remainder(
    loop: NominalLoop, control: ControlLoop, errors: ErrorModel, z: FloatArray
) -> FloatArray:
    """Bound on the nonlinear remainder ‖r‖ in each interval, shape (n_intervals,).

    Parameters
    ----------
    z : array, shape (n_intervals, 3 n)
        Largest errors of each interval.
    """
    n, law = loop.n, control.law
    middles = loop.edges + len(loop.times) // len(loop.edges) // 2
    rows = np.minimum(middles, len(loop.times) - 1)
    signs = np.random.default_rng(0).choice([-1.0, 1.0], size=(_N_CORNERS, 1, 3 * n))
    corners = signs * z
    deviation = _deviation(loop, control.model, rows, corners)
    if law.kind == COMPUTED_TORQUE:
        # Inverse dynamics within the law, as a function of the measured errors.
        e, rate = corners[..., :n], corners[..., n : 2 * n]
        command = -(law.position_gains * e + law.velocity_gains * rate)
        measured = np.concatenate([corners[..., : 2 * n], command], axis=2)
        deviation = np.abs(deviation) + np.abs(_deviation(loop, control.model, rows, measured))
    weighted = np.einsum("kij,ckj->cki", loop.inverse_root[rows], deviation)
    factor = _SAFETY * (1.0 + errors.inertia)
    return np.asarray(factor * np.linalg.norm(weighted, axis=2).max(axis=0))


def _deviation(
    loop: NominalLoop, model: Robot, rows: NDArray[np.int64], errors: FloatArray
) -> FloatArray:
    """τ(d − z) − τ(d) + linear part at some samples, shape (n_corners, n_intervals, n)."""
    n = loop.n
    desired = np.concatenate(loop.middle[:, rows], axis=1)
    states = (desired - errors).reshape(-1, 3 * n)
    tau = model.inverse_dynamics(states[:, :n], states[:, n : 2 * n], states[:, 2 * n :])
    linear = np.einsum("kij,ckj->cki", loop.linear[rows], errors)
    return np.asarray(tau.reshape(linear.shape) - loop.middle_efforts[rows] + linear)
