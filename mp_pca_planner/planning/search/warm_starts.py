# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Precomputed motions between the ends of demonstrations, as warm starts of similar ones."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from ...exceptions import GoalError
from ...motion.goal import JointGoal, JointState
from ...primitives.primitive import MovementPrimitive
from ..context import Context
from ..program.bases import WarmStarts
from ..requests.resolve import resolve
from ..requests.selection import Selector
from .budget import Budget
from .candidate import attempt
from .settings import first_setting


def warm_starts(
    context: Context, selector: Selector, primitive: MovementPrimitive, deadline: float
) -> WarmStarts:
    """Motions of a primitive between the ends of its demonstrations.

    Parameters
    ----------
    context, selector
        Of the planner.
    primitive : MovementPrimitive
        The primitive.
    deadline : float
        When no further motion is begun, by the clock of `time.perf_counter` [s].
    """
    names, states = primitive.joint_names, primitive.boundary_states
    n_chosen = min(len(states), context.options.search.n_warm_starts)
    ends, weights, memories = [], [], []
    for i in np.linspace(0, len(states) - 1, n_chosen).astype(int):
        if Budget(deadline).is_over():
            break
        here, there = (JointState(names, states[i, k]) for k in (0, 3))
        goal = JointGoal(there, float(primitive.durations[i]), primitive=primitive.name)
        try:
            request = next(resolve(context, selector, goal, here))
        except GoalError:  # demonstrations may lie outside the limits
            continue
        setting = first_setting(context, request, shortest=False)
        budget = Budget(time.perf_counter() + context.options.max_solve_time)
        found = attempt(context, request, replace(setting, is_timed=False), budget)
        if found.is_valid and found.solution.converged and found.memory is not None:
            ends.append(states[i, [0, 3]].ravel())
            weights.append(found.solution.weights)
            memories.append(found.memory.curvature_alone())
    return WarmStarts(np.array(ends), np.array(weights), memories)
