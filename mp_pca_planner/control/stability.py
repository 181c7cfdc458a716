# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""What is known of a control law along a motion: poles, a bound on the error, room for effort.

The bound is a small-gain argument for peaks (Desoer and Vidyasagar, "Feedback Systems:
Input–Output Properties", 1975, chapter III; Dahleh and Diaz-Bobillo, "Control of Uncertain
Systems", 1995). With the error e = q_d − q, the nominal model (hats) linearised about the motion,
and the true inertial parameters π̂ + Δπ, in which inverse dynamics are linear, the loop is

    M̂ë + Ĉė + Ĝe + (feedback) = Y(q_d)Δπ + lag − (ΔM ë + ΔC ė + ΔG e) + r

on the right of which stand the effort of the wrong parameters along the motion itself, what the
feed-forward lags behind by sampling and delay, what the parameters change in the linear part, and
what is not linear. The first two are known but for the factors Δπ: the nominal loop, sampled and
delayed, is run through for each of them, which bounds their joint effect exactly. The rest, w, is
bounded through the peaks z of (‖e‖, ‖ė‖, ‖ë‖) and the peak gains H of the nominal loop,

    ‖w‖ ≤ cᵀz + ‖r‖,   z ≤ z₁ + H ‖w‖,

in each of some intervals that the motion is cut into: H is a matrix from the intervals before.
Bounds ‖w‖ that these two map into themselves hold.

The norms are those of the mass matrix, ‖ë‖² = ëᵀM̂ë and ‖w‖² = wᵀM̂⁻¹w: inertias that are wrong by
a share δ have ‖ΔM ë‖ ≤ δ‖ë‖ in them, on any robot. The remainder r is an estimate: its largest
value at sampled corners of the box of errors, times a factor of safety.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import expm

from ..arrays import FloatArray, frozen_array
from ..exceptions import ControlError
from ..robot import Robot
from ..trajectory import Trajectory
from .closed_loop import DEFAULT_SAMPLING, Reference, Sampling, sample_times
from .law import COMPUTED_TORQUE, ControlLaw

_ROUNDS = 1000
_SETTLED = 1e-3
# Corners of the box of errors at which the remainder is taken, and a factor for safety.
_N_CORNERS = 32
_SAFETY = 1.5
# Intervals that a motion is cut into.
_INTERVALS = 40
# Responses this small next to the largest are over.
_FORGOTTEN = 1e-8
_POLE_TIMES = 25
# Gains change slowly along a motion: samples from one to the next at which they are taken.
_GAINS_EVERY = 5
# Accelerations and the like beyond which there is no bound worth the name [SI].
_ABSURD = 1e4


@dataclass(frozen=True, eq=False)
class ErrorModel:
    """What may be wrong with a model and a start.

    Attributes
    ----------
    inertia : float
        Share by which the mass and inertia of each link may be wrong, either way.
    payload : float
        Largest unknown mass at the end effector [kg].
    frame : str or None
        Link of the end effector; None takes the last one.
    position : float
        Largest error of each joint at the start [rad or m].
    velocity : float
        The same of velocities [/s].

    Raises
    ------
    ControlError
        If one is negative, or inertias may vanish.
    """

    inertia: float = 0.05
    payload: float = 0.0
    frame: str | None = None
    position: float = 0.001
    velocity: float = 0.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.inertia < 1.0:
            raise ControlError(f"an error of inertias must be 0 to less than 1, got {self.inertia}")
        for name in ("payload", "position", "velocity"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0.0):
                raise ControlError(f"the error of {name} must be a number ≥ 0, got {value}")

    def sample(
        self, robot: Robot, rng: np.random.Generator, *, extreme: bool = False
    ) -> tuple[Robot, FloatArray, FloatArray]:
        """One robot within the errors and its start errors: (robot, position, velocity).

        Parameters
        ----------
        robot : Robot
            The nominal one.
        rng : Generator
            Where chance comes from.
        extreme : bool
            Whether every error has its largest magnitude.
        """

        def draw(size: int) -> FloatArray:
            values = rng.uniform(-1.0, 1.0, size)
            return np.where(values < 0.0, -1.0, 1.0) if extreme else values

        n = robot.n_joints
        payload = self.payload * 0.5 * (1.0 + float(draw(1)[0]))
        true = robot.with_inertias(1.0 + self.inertia * draw(n), payload, self.frame)
        return true, self.position * draw(n), self.velocity * draw(n)


@dataclass(frozen=True, eq=False)
class Stability:
    """What is known of a law along a motion.

    Attributes
    ----------
    slowest_pole : float
        Largest real part of the nominal closed loop's poles along the motion [1/s]; negative
        means that it is stable at every point.
    least_damping : float
        Least damping ratio of the poles.
    sampled_radius : float
        Largest magnitude of the poles of the sampled loop with its delay; below 1: stable.
    loop_gain : float
        cᵀH, summed over the intervals: below 1 the linear part is stable, however long the
        motion, whatever the parameters are within their errors.
    times : array, shape (n_samples,)
        Instants of control [s].
    error_bound : array, shape (n_samples, n_joints), or None
        Bound on |q_d − q| at each; None if there is none.
    effort_bound : array, shape (n_samples, n_joints), or None
        Bound on the efforts that the law asks for.
    effort_reserve : float
        Least share of the effort limit that is left, negative if efforts may saturate: then the
        bound is void. 1 without effort limits; that of the motion alone if there is no bound.
    """

    slowest_pole: float
    least_damping: float
    sampled_radius: float
    loop_gain: float
    times: FloatArray
    error_bound: FloatArray | None
    effort_bound: FloatArray | None
    effort_reserve: float

    @property
    def holds(self) -> bool:
        """Whether there is a bound, and efforts can't saturate."""
        return self.error_bound is not None and self.effort_reserve >= 0.0

    def summary(self) -> dict[str, Any]:
        """Facts of JSON types."""
        bound = None if self.error_bound is None else self.error_bound.max(axis=0).tolist()
        return {
            "slowest_pole": self.slowest_pole,
            "least_damping": self.least_damping,
            "sampled_radius": self.sampled_radius,
            "loop_gain": self.loop_gain,
            "error_bound": bound,
            "effort_reserve": self.effort_reserve,
            "bound_holds": self.holds,
        }


def analyse(
    model: Robot,
    law: ControlLaw,
    trajectory: Trajectory,
    errors: ErrorModel,
    effort_limits: FloatArray,
    sampling: Sampling = DEFAULT_SAMPLING,
) -> Stability:
    """Find what is known of a law along a motion.

    Parameters
    ----------
    model : Robot
        The nominal model.
    law : ControlLaw
        The law, of its joints.
    trajectory : Trajectory
        The motion.
    errors : ErrorModel
        What may be wrong.
    effort_limits : array, shape (n_joints,)
        Where efforts saturate; infinite if they don't.
    sampling : Sampling
        Timing of the loop.

    Raises
    ------
    ControlError
        If the joints differ.
    """
    if not law.joint_names == model.joint_names == trajectory.joint_names:
        raise ControlError(
            f"the law is of {law.joint_names}, the model of {model.joint_names} and the motion of "
            f"{trajectory.joint_names}"
        )
    limits = frozen_array(
        np.where(np.isfinite(effort_limits), effort_limits, 0.0),
        (model.n_joints,),
        "effort limits",
        ControlError,
    )
    limits = np.where(np.isfinite(effort_limits), limits, np.inf)
    loop = _Loop(model, law, trajectory, sampling)
    known = _known_responses(loop, model, errors)
    gains = _peak_gains(loop)
    changes = _parameter_changes(loop, model, errors)
    loop_gain = float((gains.norms.sum(axis=1) @ changes.max(axis=0)).max())
    rest = _rest(_Remainder(loop, law, model, errors), known, gains, changes)
    slowest, damping, radius = _poles(loop)
    bound = effort_bound = None
    reserve = _reserve(np.abs(loop.feedforward), limits)
    if rest is not None:
        n = model.n_joints
        z = known.values + np.einsum("ljc,j->lc", gains.rows, rest)[loop.interval]
        bound = z[:, :n]
        feedback = np.einsum("kij,kj->ki", np.abs(loop.feedback), z[:, : 2 * n])
        effort_bound = np.abs(loop.feedforward) + feedback
        reserve = _reserve(effort_bound, limits)
    return Stability(slowest, damping, radius, loop_gain, loop.times, bound, effort_bound, reserve)


def _reserve(efforts: FloatArray, limits: FloatArray) -> float:
    return float((1.0 - efforts / limits).min())


class _Loop:
    """The nominal loop along a motion, linearised and sampled: x = (e, ė), input an effort."""

    def __init__(
        self, model: Robot, law: ControlLaw, trajectory: Trajectory, sampling: Sampling
    ) -> None:
        n = self.n = model.n_joints
        step = sampling.period
        self.delay = sampling.delay
        self.times = sample_times(trajectory, sampling)
        self.reference = Reference.of(trajectory, self.times)
        # Intervals of equal length, and which one each sample is in.
        per_interval = max(len(self.times) // _INTERVALS, 1)
        self.interval = np.arange(len(self.times)) // per_interval
        self.edges = np.arange(0, len(self.times), per_interval)
        ref = self.reference
        self.feedforward, linear = model.inverse_dynamics_derivatives(ref.q, ref.v, ref.a)
        # The effort that the law adds per error, at the samples.
        gains = np.concatenate([np.diag(law.position_gains), np.diag(law.velocity_gains)], axis=1)
        self.feedback = np.broadcast_to(gains, (len(self.times), n, 2 * n))
        if law.kind == COMPUTED_TORQUE:
            self.feedback = linear[:, :, 2 * n :] @ gains - linear[:, :, : 2 * n]
        # The dynamics between samples, with coefficients of the middle of the step.
        self.middle = Reference.of(trajectory, self.times + 0.5 * step)
        mid = self.middle
        self.middle_efforts, self.linear = model.inverse_dynamics_derivatives(mid.q, mid.v, mid.a)
        self.mass_inverse = np.linalg.inv(self.linear[:, :, 2 * n :])
        eigenvalues, vectors = np.linalg.eigh(self.linear[:, :, 2 * n :])
        self.root = (vectors * np.sqrt(eigenvalues)[:, None]) @ vectors.transpose(0, 2, 1)
        self.inverse_root = np.linalg.inv(self.root)
        self.drift = -self.mass_inverse @ self.linear[:, :, : 2 * n]
        system = np.zeros((len(self.times), 3 * n, 3 * n))
        system[:, :n, n : 2 * n] = np.eye(n)
        system[:, n : 2 * n, : 2 * n] = self.drift
        system[:, n : 2 * n, 2 * n :] = self.mass_inverse
        whole = expm(system * step)
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
        # As in the simulation, the law saw the start error before the start, too.
        pending = [self.feedback[0] @ start] * self.delay
        responses = np.empty((len(self.times), 3 * n, start.shape[1]))
        for k, push in enumerate(disturbance):
            pending.append(self.feedback[k] @ x)
            effort = push - pending.pop(0)
            responses[k, : 2 * n] = x
            responses[k, 2 * n :] = self.drift[k] @ x + self.mass_inverse[k] @ effort
            x = self.transition[k] @ x + self.input[k] @ effort
        return responses


class _Known(NamedTuple):
    """Bounds on the responses to what is known but for its factors.

    values: of |e|, |ė| and |ë| of each joint, shape (n_samples, 3 n);
    norms: peaks of ‖e‖, ‖ė‖ and ‖ë‖ in each interval, shape (n_intervals, 3);
    peaks: those of the values, shape (n_intervals, 3 n).
    """

    values: FloatArray
    norms: FloatArray
    peaks: FloatArray


def _known_responses(loop: _Loop, model: Robot, errors: ErrorModel) -> _Known:
    n, mid = loop.n, loop.middle
    pushes = []
    for robot, magnitude in _parameter_directions(model, errors):
        difference = robot.inverse_dynamics(mid.q, mid.v, mid.a) - loop.middle_efforts
        pushes.append(magnitude * difference)
    # Efforts computed for one sample act some later.
    computed = np.arange(len(loop.times)) - loop.delay
    pushes.append(loop.middle_efforts - loop.feedforward[np.maximum(computed, 0)])
    signals = np.stack(pushes, axis=2)
    size = np.repeat([errors.position, errors.velocity], n)
    still = np.zeros((len(loop.times), n, 2 * n))
    responses = np.concatenate(
        [
            loop.respond(signals, np.zeros((2 * n, signals.shape[2]))),
            loop.respond(still, np.diag(size)),
        ],
        axis=2,
    )
    parts = np.split(responses, 3, axis=1)
    norms = [np.linalg.norm(loop.root @ part, axis=1).sum(axis=1) for part in parts]
    values = np.abs(responses).sum(axis=2)
    return _Known(
        values,
        np.maximum.reduceat(np.stack(norms, axis=1), loop.edges),
        np.maximum.reduceat(values, loop.edges),
    )


def _parameter_directions(model: Robot, errors: ErrorModel) -> list[tuple[Robot, float]]:
    """Robots one unit of each parameter away from the model, and how far it may be wrong."""
    ones = np.ones(model.n_joints)
    directions = [
        (model.with_inertias(ones + unit), errors.inertia) for unit in np.eye(model.n_joints)
    ]
    if errors.payload > 0.0:
        directions.append((model.with_inertias(ones, 1.0, errors.frame), errors.payload))
    return directions


def _parameter_changes(loop: _Loop, model: Robot, errors: ErrorModel) -> FloatArray:
    """The c of the module: norms of ΔG, ΔC and ΔM, shape (n_intervals, 3)."""
    n, mid = loop.n, loop.middle
    change = np.zeros((len(loop.times), 3))
    for robot, magnitude in _parameter_directions(model, errors):
        _, linear = robot.inverse_dynamics_derivatives(mid.q, mid.v, mid.a)
        difference = (linear - loop.linear).reshape(-1, n, 3, n).transpose(0, 2, 1, 3)
        root = loop.inverse_root[:, None]
        change += magnitude * np.linalg.norm(root @ difference @ root, 2, axis=(2, 3))
        if magnitude is errors.inertia:
            change[:, 2] = errors.inertia  # −δM̂ ≤ ΔM ≤ δM̂ for all links together
    return np.asarray(np.maximum.reduceat(change, loop.edges))


class _Gains(NamedTuple):
    """Peak gains of the nominal loop from ‖w‖ in each interval to each later one.

    norms: to ‖e‖, ‖ė‖ and ‖ë‖, shape (n_intervals, n_intervals, 3), later ones first;
    rows: to each |e|, |ė| and |ë|, shape (n_intervals, n_intervals, 3 n), earlier ones last
    but one.
    """

    norms: FloatArray
    rows: FloatArray


def _peak_gains(loop: _Loop) -> _Gains:
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
        if k % _GAINS_EVERY == 0 or k + 1 == len(loop.times) or loop.interval[k + 1] > later:
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
    return _Gains(norms, rows)


def _norms(matrices: FloatArray) -> FloatArray:
    """Upper bounds, close and fast, on the spectral norms of many matrices."""
    magnitude = np.abs(matrices)
    sums = magnitude.sum(axis=-1).max(axis=-1) * magnitude.sum(axis=-2).max(axis=-1)
    squares = np.einsum("...ij,...ij->...", matrices, matrices)
    return np.asarray(np.sqrt(np.minimum(sums, squares)))


def _alive(x: FloatArray, n: int) -> int:
    """Which response is the first that has not died away."""
    size = np.abs(x).max(axis=0).reshape(-1, n).max(axis=1)
    return int(np.argmax(size > _FORGOTTEN * size.max()))


def _rest(
    remainder: _Remainder, known: _Known, gains: _Gains, changes: FloatArray
) -> FloatArray | None:
    """Bounds ‖w‖ of each interval that map into themselves; None if there are none."""
    rest = np.zeros(len(changes))
    for _ in range(_ROUNDS):
        z = known.peaks + np.einsum("ljc,j->lc", gains.rows, rest)
        norms = known.norms + np.einsum("ljc,j->lc", gains.norms, rest)
        if z.max() > _ABSURD:
            return None
        wanted = np.sum(changes * norms, axis=1) + remainder(z)
        if np.all(wanted <= rest):
            return rest
        # A little more than needed, so that the iteration ends inside of its own image.
        rest = np.maximum(rest, (1.0 + _SETTLED) * wanted)
    return None


class _Remainder:
    """Bound on what is not linear in the errors, for a box of errors in each interval."""

    def __init__(self, loop: _Loop, law: ControlLaw, model: Robot, errors: ErrorModel) -> None:
        rows = np.minimum(loop.edges + len(loop.times) // len(loop.edges) // 2, len(loop.times) - 1)
        rng = np.random.default_rng(0)
        self._n = loop.n
        self._signs = rng.choice([-1.0, 1.0], size=(_N_CORNERS, 1, 3 * loop.n))
        ref = loop.middle
        self._states = np.concatenate([ref.q[rows], ref.v[rows], ref.a[rows]], axis=1)
        self._robot, self._law = model, law
        self._factor = _SAFETY * (1.0 + errors.inertia)
        self._linear, self._efforts = loop.linear[rows], loop.middle_efforts[rows]
        self._inverse_root = loop.inverse_root[rows]

    def __call__(self, z: FloatArray) -> FloatArray:
        """‖r‖ for errors z, shape (n_intervals, 3 n), of each interval."""
        errors = self._signs * z
        deviation = self._deviation(errors)
        if self._law.kind == COMPUTED_TORQUE:
            # The law's own inverse dynamics, of the errors that it measures.
            e, rate = errors[..., : self._n], errors[..., self._n : 2 * self._n]
            wanted = -(self._law.position_gains * e + self._law.velocity_gains * rate)
            measured = np.concatenate([errors[..., : 2 * self._n], wanted], axis=2)
            deviation = np.abs(deviation) + np.abs(self._deviation(measured))
        weighted = np.einsum("kij,ckj->cki", self._inverse_root, deviation)
        return np.asarray(self._factor * np.linalg.norm(weighted, axis=2).max(axis=0))

    def _deviation(self, errors: FloatArray) -> FloatArray:
        """τ(d − z) − τ(d) + linear part, shape (n_corners, n_intervals, n)."""
        n = self._n
        states = (self._states - errors).reshape(-1, 3 * n)
        tau = self._robot.inverse_dynamics(states[:, :n], states[:, n : 2 * n], states[:, 2 * n :])
        linear = np.einsum("kij,ckj->cki", self._linear, errors)
        return np.asarray(tau.reshape(linear.shape) - self._efforts + linear)


def _poles(loop: _Loop) -> tuple[float, float, float]:
    """Largest real part, least damping ratio, and radius of the sampled poles."""
    n, delay = loop.n, loop.delay
    rows = np.unique(np.linspace(0, len(loop.times) - 1, _POLE_TIMES).astype(int))
    slowest, damping, radius = -np.inf, np.inf, 0.0
    for k in rows:
        continuous = np.zeros((2 * n, 2 * n))
        continuous[:n, n:] = np.eye(n)
        continuous[n:] = loop.drift[k] - loop.mass_inverse[k] @ loop.feedback[k]
        poles = np.linalg.eigvals(continuous)
        slowest = max(slowest, float(poles.real.max()))
        damping = min(damping, float((-poles.real / np.abs(poles)).min()))
        # State: x, then the efforts on their way.
        size = 2 * n + delay * n
        sampled = np.zeros((size, size))
        sampled[: 2 * n, : 2 * n] = loop.transition[k]
        if delay == 0:
            sampled[: 2 * n, : 2 * n] -= loop.input[k] @ loop.feedback[k]
        else:
            sampled[: 2 * n, 2 * n : 3 * n] = -loop.input[k]
            sampled[2 * n : size - n, 3 * n :] = np.eye(size - 3 * n)
            sampled[size - n :, : 2 * n] = loop.feedback[k]
        radius = max(radius, float(np.abs(np.linalg.eigvals(sampled)).max()))
    return slowest, damping, radius
