# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Pass a configuration and a pose without a stop, and compare with stopping at each."""

from tempfile import mkdtemp

import mp_pca_planner as mp

demonstrations = mp.load_demonstrations(mp.write_example_recording(f"{mkdtemp()}/motions.mcap"))
reach = mp.MovementPrimitive.fit(demonstrations)
robot = mp.Robot.from_file(mp.config_file("human_arm.urdf"), reach.joint_names)
planner = mp.Planner(robot, [reach])

start, raised = demonstrations[0].positions[[0, -1]]
hand = robot.frame_positions(demonstrations[2].positions[-1:], ["wrist"])[0, 0]
there = mp.Pose("wrist", hand)
targets = [raised, there, start]
passing = planner.plan(start=start, goal=targets)
print(passing)

stopping, here = 0.0, start
for target in targets:
    plan = planner.plan(start=here, goal=target)
    stopping, here = stopping + plan.effort_cost, plan.trajectory.positions[-1]
print(f"effort {passing.effort_cost:.1f} N²m²s without stops, {stopping:.1f} with a stop at each")
