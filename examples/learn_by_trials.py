# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Improve a motion by trials on a robot whose masses differ from the model (extra `learn`)."""

from tempfile import mkdtemp

import numpy as np

import mp_pca_planner as mp
from mp_pca_planner.control.closed_loop import ControlLoop, simulate
from mp_pca_planner.control.law import FEEDFORWARD_PD, ControlLaw
from mp_pca_planner.learning.refined_motion import primitive_around
from mp_pca_planner.learning.trials import improve_by_trials

demonstrations = mp.load_demonstrations(mp.write_example_recording(f"{mkdtemp()}/motions.mcap"))
reach = mp.MovementPrimitive.fit(demonstrations)
model = mp.Robot.from_file(mp.config_file("human_arm.urdf"), reach.joint_names)
planner = mp.Planner(model, [reach])
start, goal = demonstrations[0].positions[[0, -1]]
plan = planner.plan(start=start, goal=goal)
law = ControlLaw.from_frequency(FEEDFORWARD_PD, model, plan.trajectory, 30.0)

factors = 1.0 + 0.3 * np.random.default_rng(0).uniform(-1.0, 1.0, len(model.link_inertias.links))
robot = model.with_link_inertias(np.repeat(factors[:, None], 4, axis=1))


def execute(trajectory):
    """Measured effort ½∫‖τ‖²dt of the robot under the control law; 1 kHz."""
    loop = ControlLoop(model, law, trajectory)
    return 0.5e-3 * np.sum(simulate(loop, robot, np.zeros(4))[1] ** 2)


best = improve_by_trials(plan, execute, 30)
cost = execute(best.trajectory)
print(f"planned motion: {execute(plan.trajectory):.2f}, best of 30: {cost:.2f} N²m²s")
primitive_around(reach, best.motion, "learned", {}).save("learned.npz")
