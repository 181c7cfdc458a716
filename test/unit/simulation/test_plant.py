# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The simulated arm and its drives, against statics and energy computed by Pinocchio itself."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import numpy as np
import pinocchio as pin
import pytest
from support.arm import JOINTS, arm_robot

from mp_pca_planner.files import config_file
from mp_pca_planner.robot.model import Robot
from mp_pca_planner.simulation.robot import PERIOD, Plant

URDF = config_file("human_arm.urdf").read_text(encoding="utf-8")
START = np.array([0.3, 0.4, -0.2, 0.9])
SIGNS = np.array([1.0, 1.0, 1.0, -1.0])


def limited(effort: float) -> Robot:
    """The arm with other effort limits."""
    root = ET.fromstring(URDF)
    for limit in root.iter("limit"):
        limit.set("effort", str(effort))
    return Robot(ET.tostring(root, encoding="unicode"), JOINTS)


def gravity_with(mass: float, q: np.ndarray) -> np.ndarray:
    """Efforts of gravity on the arm with a point mass at its last link, by its potential energy."""
    model = pin.buildModelFromXML(URDF)
    data, h = model.createData(), 1e-6
    frame = model.getFrameId(arm_robot().frame_names[-1])

    def energy(q):
        pin.framesForwardKinematics(model, data, q)
        return (
            pin.computePotentialEnergy(model, data, q)
            + mass * 9.81 * (data.oMf[frame].translation[2])
        )

    return np.array([(energy(q + h * e) - energy(q - h * e)) / (2 * h) for e in np.eye(len(q))])


@pytest.mark.parametrize("mass", [1.0, 3.0])
def test_payload_makes_the_arm_sag_by_its_statics(mass):
    plant = Plant(arm_robot(), START)
    plant.set_payload(mass)
    for _ in range(3000):
        plant.step(START)
    missing = gravity_with(mass, plant.q) - gravity_with(0.0, plant.q)
    np.testing.assert_allclose(plant.kp * (START - plant.q), missing, atol=1e-3)
    assert np.abs(plant.q - START).max() > 1e-4


def test_energy_of_a_disturbed_arm_only_falls():
    """Kinetic energy and that of the drives' springs; gravity is compensated."""
    plant = Plant(arm_robot(), START)
    plant.q, plant.v = START + 0.05 * SIGNS, np.array([0.5, -1.0, 1.0, 0.4])
    model = pin.buildModelFromXML(URDF)
    data = model.createData()

    def energy():
        M = np.triu(pin.crba(model, data, plant.q))
        M = M + np.triu(M, 1).T + np.diag(plant.inertia)
        e = plant.q - START
        return 0.5 * plant.v @ M @ plant.v + 0.5 * e @ (plant.kp * e)

    energies = []
    for _ in range(500):
        energies.append(energy())
        plant.step(START)
    # While it is more than rounding.
    assert np.all(np.diff(energies) < 1e-9 * energies[0])
    assert energies[-1] < 1e-9 * energies[0]


def test_drives_give_no_more_than_their_limits():
    robot = limited(12.0)
    plant = Plant(robot, START)
    model = pin.buildModelFromXML(URDF)
    data = model.createData()
    acting = []
    for _ in range(200):
        q, v = plant.q, plant.v
        plant.step(START + 0.8 * SIGNS)
        a = (plant.v - v) / PERIOD
        acting.append(pin.rnea(model, data, q, v, a) + plant.inertia * a)
    # The state at the start of a step stands for that in it.
    assert 11.5 < np.abs(acting).max() < 13.5
