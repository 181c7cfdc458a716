# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""From a recording to a motion in a few lines; as an executed notebook: notebook.ipynb."""

import matplotlib.pyplot as plt

import mp_pca_planner as mp

urdf = mp.config_file("human_arm.urdf")
bag = mp.write_example_recording("motions.mcap")  # yours: ros2 bag record /joint_states
demonstrations = mp.load_demonstrations(bag, robot=urdf)
print(demonstrations.report)

raise_arm = mp.MovementPrimitive.fit(demonstrations, name="raise_arm")
raise_arm.save("raise_arm.npz", overwrite=True)
robot = mp.Robot.from_file(urdf, raise_arm.joint_names)
planner = mp.Planner(robot, [raise_arm])
plan = planner.plan(
    start=demonstrations[0].positions[0], goal={"shoulder1": -1.8, "shoulder3": 0.6}
)
print(plan)
plan.plot(planner)
plt.savefig("motion.png")
plan.trajectory.save("motion.csv", overwrite=True)
