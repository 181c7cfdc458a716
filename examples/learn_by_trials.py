# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Improve a motion by 12 or more trials on a robot: joint states give the cost (extra `learn`).

Arguments: PRIMITIVE.npz ROBOT.urdf TRIALS. Robot (500 Hz, with efforts) and node are running.
"""

import sys

import numpy as np
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory

import mp_pca_planner as mp
from mp_pca_planner.learning.refined_motion import primitive_around
from mp_pca_planner.learning.trials import improve_by_trials
from mp_pca_planner.ros.client import GoalClient

reach = mp.MovementPrimitive.load(sys.argv[1])
planner = mp.Planner(mp.Robot.from_file(sys.argv[2], reach.joint_names), [reach])
start, goal = reach.boundary_states[0, [0, 3]]
rest, states = dict(zip(reach.joint_names, start, strict=True)), []
with GoalClient("trials") as client:
    client.node.create_subscription(JointState, "joint_states", states.append, 5000)
    controller = client.node.create_publisher(JointTrajectory, "mp_pca_planner/joint_trajectory", 1)

    def execute(trajectory):
        """Execute a trial; returns its measured effort ½∫‖τ‖²dt [N²m²s]."""
        client.execution(client.move(reach.name, rest, 30.0))  # the node moves it to the start
        states.clear()
        controller.publish(trajectory.to_message())
        client.wait(lambda: len(states) >= 500 * trajectory.duration + 100, 60.0, "is alone")
        cost = 0.001 * np.sum(np.square([state.effort for state in states]))
        return cost or sys.exit("joint_states hold no efforts, from which the cost is computed")

    plan = planner.plan(start=start, goal=goal)
    best = improve_by_trials(planner, plan, execute, int(sys.argv[3]))
print(f"planned: {best.planned_cost:.2f}, learned: {best.cost:.2f} ± {best.noise:.2f} N²m²s")
primitive_around(reach, best.motion, "learned", {}).save("learned.npz", overwrite=True)
