# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The nominal closed loop along a motion, linearised and sampled, and its poles."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.linalg import expm

from ..arrays import FloatArray
from .closed_loop import ControlLoop, Reference, simulate
from .law import COMPUTED_TORQUE


class NominalLoop:
    """The nominal loop along a motion, linearised and sampled: x = (e, ė), input an effort."""

    def __init__(self, control: ControlLoop, n_intervals: int) -> None:
        model, law, trajectory = control.model, control.law, control.trajectory
        n = self.n = model.n_joints
        step = control.sampling.period
        self.delay, self.times = control.sampling.delay, control.times
        unlimited = replace(control, effort_limits=np.array(np.inf))
        self.errors = simulate(unlimited, model, np.zeros(n), np.zeros(n)).errors
        # Intervals of equal length, and the one of each sample.
        per_interval = max(len(self.times) // n_intervals, 1)
        self.interval = np.arange(len(self.times)) // per_interval
        self.edges = np.arange(0, len(self.times), per_interval)
        self.feedforward, linear = model.inverse_dynamics_derivatives(*control.reference)
        # Feedback gains of the law at the samples: effort per error.
        gains = np.concatenate([np.diag(law.position_gains), np.diag(law.velocity_gains)], axis=1)
        self.feedback = np.broadcast_to(gains, (len(self.times), n, 2 * n))
        if law.kind == COMPUTED_TORQUE:
            self.feedback = linear[:, :, 2 * n :] @ gains - linear[:, :, : 2 * n]
        # The dynamics between samples, with coefficients of the middle of the step.
        self.middle = Reference.of(trajectory, self.times + 0.5 * step)
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


def poles(loop: NominalLoop, n_times: int) -> tuple[float, float, float]:
    """Largest real part, least damping ratio, and radius of the sampled poles, at some times."""
    n, delay = loop.n, loop.delay
    rows = np.unique(np.linspace(0, len(loop.times) - 1, n_times).astype(int))
    slowest, damping, radius = -np.inf, np.inf, 0.0
    for k in rows:
        continuous = np.zeros((2 * n, 2 * n))
        continuous[:n, n:] = np.eye(n)
        continuous[n:] = loop.drift[k] - loop.mass_inverse[k] @ loop.feedback[k]
        found = np.linalg.eigvals(continuous)
        slowest = max(slowest, float(found.real.max()))
        damping = min(damping, float((-found.real / np.abs(found)).min()))
        # State: x, then the delayed efforts.
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
