# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Verification of an error bound by many perturbed simulations of the closed loop."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from .closed_loop import ControlLoop, simulate
from .errors import ErrorModel
from .stability import Stability


@dataclass(frozen=True, eq=False)
class Verification:
    """Result of perturbed simulations of a closed loop.

    Attributes
    ----------
    errors : array, shape (n_trials, n_joints)
        Largest |q_d − q| of each simulation [rad or m].
    worst_share : array, shape (n_trials,)
        Largest error as a share of its bound at that time; infinite without a bound.
    saturated : int
        Simulations in which an effort was cut to its limit.
    """

    errors: FloatArray
    worst_share: FloatArray
    saturated: int

    @property
    def bound_held(self) -> int:
        """Number of simulations in which no error exceeded its bound."""
        return int(np.count_nonzero(self.worst_share <= 1.0))


def verify(
    loop: ControlLoop,
    errors: ErrorModel,
    stability: Stability,
    n_trials: int,
    *,
    seed: int = 0,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Verification:
    """Simulate the loop with robots that differ from the controller's model.

    Parameters
    ----------
    loop : ControlLoop
        The law and the motion.
    errors : ErrorModel
        Every second simulation draws from within these errors, the others have each of them at
        its largest magnitude.
    stability : Stability
        The bound to verify.
    n_trials : int
        Simulations.
    seed : int
        Seed of the errors.
    progress : callable
        Called with (done, total).
    """
    rng = np.random.default_rng(seed)
    worst = np.empty((n_trials, loop.model.n_joints))
    shares = np.full(n_trials, np.inf)
    saturated = 0
    for trial in range(n_trials):
        result = simulate(loop, *errors.sample(loop.model, rng, extreme=trial % 2 == 0))
        magnitude = np.abs(result.errors)
        worst[trial] = magnitude.max(axis=0)
        if stability.error_bound is not None:
            floor = np.finfo(float).tiny
            shares[trial] = float((magnitude / np.maximum(stability.error_bound, floor)).max())
        saturated += result.saturated > 0
        progress(trial + 1, n_trials)
    return Verification(worst, shares, saturated)
