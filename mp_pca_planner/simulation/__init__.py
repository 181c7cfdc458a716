# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A simulated robot behind a controller with the semantics of ``joint_trajectory_controller``.

A robot in virtual time, whose clock advances by 1 ms with each step::

    robot = SimulatedRobot(Robot.from_file("arm.urdf"), start, seed=1)
    robot.send(trajectory)
    robot.faults.held = True
    while robot.time < 1002.0:
        robot.step()
    robot.record.q, robot.record.clock, robot.rejections
"""
