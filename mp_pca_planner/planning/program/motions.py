# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""From the unknowns of a problem back to motions."""

from __future__ import annotations

from itertools import pairwise

from ...arrays import FloatArray
from ...motion.goal import JointState
from ..configurations import nearest_configuration
from ..context import Context
from ..motion import Motion
from ..request import Request
from .problem import Problem
from .setting import Setting
from .unknowns import GOAL_POSITION


def motions_at(
    context: Context, request: Request, setting: Setting, problem: Problem, x: FloatArray
) -> tuple[Motion, ...]:
    """The motions that unknowns stand for, with ends that are corrected to reach poses exactly."""
    if problem.links is None:
        unknowns, goal = problem.segments[0].unknowns, request.goal
        n = unknowns.n_weights
        weights = [x[:n] * unknowns.scales[:n]]
        if request.pose is not None:
            boundary, _ = unknowns.boundary_at(x)
            goal = JointState(goal.joint_names, boundary[GOAL_POSITION])
        states = [(request.start, 0.0), (goal, unknowns.duration_at(x))]
    else:
        states, weights = problem.links.states(x), problem.links.weights(x)
    for i, segment in enumerate(request.segments):
        if segment.pose is not None:
            state, time = states[i + 1]
            search = context.options.poses
            q, _ = nearest_configuration(
                context.robot, context.limits, segment.pose, state.positions, search
            )
            states[i + 1] = JointState(state.joint_names, q, *state.values[1:]), time
    motions = []
    for ((here, began), (there, ended)), basis, own in zip(
        pairwise(states), setting.bases, weights, strict=True
    ):
        motions.append(Motion(here, there, ended - began, basis.tables.basis, own))
    return tuple(motions)
