# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Levenberg-Marquardt iteration within bounds, for any structure of the normal equations."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray

BoolArray = NDArray[np.bool_]

Linearised = tuple[float, FloatArray, FloatArray]
"""Sum of squares; half its gradient, of the shape of x; half its Gauss-Newton matrix, in whatever
form the step function takes it."""

Step = Callable[[FloatArray, FloatArray, BoolArray, float], FloatArray]
"""Step for a gradient, a matrix, the variables that are held at a bound, and a damping."""

MIN_DAMPING = 1e-8
"""Damping at the start; the unit is that of the squares per squared unit of x."""


def minimise(
    x: FloatArray,
    linearise: Callable[[FloatArray], Linearised],
    step: Step,
    bounds: tuple[FloatArray, FloatArray],
    *,
    last_step: float,
    max_iterations: int,
) -> tuple[FloatArray, float]:
    """Minimise a sum of squares within bounds.

    The damping grows tenfold while a step would raise the sum, and falls tenfold otherwise.

    Parameters
    ----------
    x : array
        Where to start.
    linearise, step :
        The problem, see :data:`Linearised` and :data:`Step`.
    bounds : tuple of array
        Lower and upper bounds, which broadcast to the shape of `x`.
    last_step : float
        The iteration ends at a step whose entries are all smaller.
    max_iterations : int
        Largest number of steps.

    Returns
    -------
    x : array
        The minimum, or the best point found.
    cost : float
        The sum of squares there.
    """
    lower, upper = bounds
    x = np.clip(x, lower, upper)
    cost, gradient, matrix = linearise(x)
    damping = MIN_DAMPING
    for _ in range(max_iterations):
        held = ((x <= lower) & (gradient > 0.0)) | ((x >= upper) & (gradient < 0.0))
        trial = np.clip(x + step(gradient, matrix, held, damping), lower, upper)
        if np.abs(trial - x).max() < last_step:
            break
        found = linearise(trial)
        if found[0] <= cost:
            x, (cost, gradient, matrix) = trial, found
            damping = max(MIN_DAMPING, damping / 10.0)
        else:
            damping *= 10.0
    return x, cost
