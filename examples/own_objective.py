# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""An objective of one's own: keep the elbow near an angle, against the effort that it takes."""

from tempfile import mkdtemp

import numpy as np

import mp_pca_planner as mp
from mp_pca_planner.planning.objectives import Residuals, effort

ANGLE = -0.4  # of the elbow [rad]


def near_angle(nodes):
    """The distance r of the elbow from the angle at every node, and its derivative [rad].

    ½∫‖r‖²dt is added to the objective.
    """
    elbow = nodes.robot.joint_names.index("elbow")
    by_position = np.zeros((len(nodes.positions), 1, nodes.robot.n_joints))
    by_position[:, 0, elbow] = 1.0
    return Residuals(nodes.positions[:, [elbow]] - ANGLE, {"positions": by_position})


urdf = mp.config_file("human_arm.urdf")
demonstrations = mp.load_demonstrations(mp.write_example_recording(f"{mkdtemp()}/motions.mcap"))
reach = mp.MovementPrimitive.fit(demonstrations)
robot = mp.Robot.from_file(urdf, reach.joint_names)
for weight in (1e-3, 10.0, 1000.0):
    options = mp.PlannerOptions(objectives=((1.0, effort), (weight, near_angle)), naturalness=1e-4)
    shown = demonstrations[0].positions
    plan = mp.Planner(robot, [reach], options=options).plan(start=shown[0], goal=shown[-1])
    elbow = plan.trajectory.positions[:, robot.joint_names.index("elbow")]
    away = np.sqrt(np.mean((elbow - ANGLE) ** 2))
    print(f"weight {weight:g}: {away:.3f} rad from {ANGLE}, effort {plan.effort_cost:.1f} N²m²s")
