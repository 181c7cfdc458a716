# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A node of the arm in virtual time."""

from __future__ import annotations

import numpy as np
from support.arm import JOINTS, URDF, arm_primitive
from support.patience import NODE_EVER
from support.virtual_node import VirtualNode

from mp_pca_planner.execution.parameters import Settings
from mp_pca_planner.execution.planning import assemble_model
from mp_pca_planner.execution.server import NodeModel
from mp_pca_planner.motion.goal import JointGoal, JointState, SequenceGoal

MOTION = arm_primitive().boundary_states[0]
START, GOAL = MOTION[0], MOTION[3]
HALF = 0.5 * (START + GOAL)
LIMITS = {
    name: {"max_velocity": 3.0, "max_acceleration": 12.0, "max_jerk": 200.0} for name in JOINTS
}
WAIT = 0.02  # of motions from rest, in which any message is received [s]


def model(**settings):
    options = Settings(**{"limits": LIMITS, "max_solve_time": NODE_EVER, **settings})
    return assemble_model(URDF, [arm_primitive()], options)


MODEL = model()


class Node(VirtualNode):
    """A node, of the arm unless given, whose goals are numbered from 1."""

    def __init__(self, model=MODEL, start=START, **options):
        super().__init__(model, start, **{"planning_time": (0.01, 0.01), **options})
        self.model = model
        self.n_goals = 0
        self.run(0.3)

    def use(self, model):
        """Have another model of the same joints."""
        self.server.use(NodeModel(model.robot, model.facts, model.settings), tuple(JOINTS))

    def ask(self, positions, names=JOINTS, **options):
        self.n_goals += 1
        self.goal(JointGoal(JointState(names, positions), **options), self.n_goals)
        self.run(0.001)

    def ask_sequence(self, *targets, times=()):
        self.n_goals += 1
        states = tuple(JointState(JOINTS, q) for q in targets)
        self.goal(SequenceGoal(states, times), self.n_goals)
        self.run(0.001)

    @property
    def statuses(self):
        return [report.status for report in self.plan_reports]

    @property
    def outcomes(self):
        return [report.outcome for _, report in self.execution_reports]

    @property
    def commanded(self):
        return self.robot.record.q[-1]

    def assert_smooth(self, cuts=()):
        """No command is beyond a limit, and none jumps."""
        assert not self.robot.rejections
        verdict = self.verdict(cuts)
        assert verdict.is_clean, verdict

    def assert_rests_at(self, positions, atol=1e-9):
        np.testing.assert_allclose(self.commanded, positions, atol=atol)
        assert not self.robot.record.v[-1].any()
