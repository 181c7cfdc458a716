# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A planner of the arm, and requests of it."""

from support.arm import JOINTS, arm_primitive, arm_robot
from support.patience import EVER

from mp_pca_planner.execution.link import Planned
from mp_pca_planner.motion.goal import JointGoal, JointState
from mp_pca_planner.planning.options import PlannerOptions
from mp_pca_planner.planning.planner import Planner
from mp_pca_planner.recordings.synthetic import generate_motions

REQUESTS = [(m.positions[0], m.positions[-1]) for m in generate_motions(200, 123)]


def planner(coupling="arm", overrides=None, collision=False, **options):
    robot = arm_robot()
    options = PlannerOptions(**{"max_solve_time": EVER, **options})
    limits = robot.limits(overrides or {})
    return Planner(robot, [arm_primitive(coupling)], limits, options, collision)


def planned(trajectory, duration, goal=None):
    """What the planner answers with a motion, as far as what follows depends on it."""
    goal = goal or JointGoal(JointState(trajectory.joint_names, trajectory.positions[-1]))
    return Planned(1, goal, trajectory, None, "", (), {}, (), {}, duration, 0.0)


def request(i=0, **goal):
    start, end = REQUESTS[i]
    return JointGoal(JointState(JOINTS, end), **goal), JointState(JOINTS, start)
