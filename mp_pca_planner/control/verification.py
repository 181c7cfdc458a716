# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Whether what is known of a control law holds: many perturbed simulations of the closed loop."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from ..motion.trajectory import Trajectory
from ..robot.model import Robot
from .closed_loop import DEFAULT_SAMPLING, Sampling, simulate
from .errors import ErrorModel
from .law import ControlLaw
from .stability import Stability


@dataclass(frozen=True, eq=False)
class Verification:
    """What simulations of a closed loop showed.

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
        """Simulations in which no error left its bound."""
        return int(np.count_nonzero(self.worst_share <= 1.0))


def verify(
    model: Robot,
    law: ControlLaw,
    trajectory: Trajectory,
    errors: ErrorModel,
    stability: Stability,
    *,
    effort_limits: FloatArray,
    n_trials: int,
    seed: int = 0,
    sampling: Sampling = DEFAULT_SAMPLING,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Verification:
    """Simulate the loop with robots that the controller's model is wrong about.

    Parameters
    ----------
    model : Robot
        What the controller believes.
    law : ControlLaw
        Its law.
    trajectory : Trajectory
        The motion.
    errors : ErrorModel
        Every second simulation draws from within these errors, the others have each of them at
        its largest magnitude.
    stability : Stability
        What is claimed.
    effort_limits : array, shape (n_joints,)
        Where efforts saturate.
    n_trials : int
        Simulations.
    seed : int
        Seed of the errors.
    sampling : Sampling
        Timing of the loop.
    progress : callable
        Called with (done, total).
    """
    rng = np.random.default_rng(seed)
    worst = np.empty((n_trials, model.n_joints))
    shares = np.full(n_trials, np.inf)
    saturated = 0
    for trial in range(n_trials):
        robot, position, velocity = errors.sample(model, rng, extreme=trial % 2 == 0)
        result = simulate(
            robot,
            model,
            law,
            trajectory,
            start_error=position,
            start_velocity_error=velocity,
            effort_limits=effort_limits,
            sampling=sampling,
        )
        magnitude = np.abs(result.errors)
        worst[trial] = magnitude.max(axis=0)
        if stability.error_bound is not None:
            floor = np.finfo(float).tiny
            shares[trial] = float((magnitude / np.maximum(stability.error_bound, floor)).max())
        saturated += result.saturated > 0
        progress(trial + 1, n_trials)
    return Verification(worst, shares, saturated)
