# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Stated error bounds against simulations that share no code with the analysis.

The true robots are built by Pinocchio from descriptions in which the mass and the principal moments
of inertia of every link are wrong by their own share; the closed loop is written out again, with
finer steps.
"""

import xml.etree.ElementTree as ET

import numpy as np
import pinocchio as pin
import pytest
from scipy.interpolate import BPoly
from support.arm import arm_robot
from support.reaches import arm_reach, reach

from mp_pca_planner.control.closed_loop import ControlLoop, ErrorModel, simulate
from mp_pca_planner.control.law import COMPUTED_TORQUE, FEEDFORWARD_PD, KINDS, ControlLaw
from mp_pca_planner.control.stability import analyse
from mp_pca_planner.files import config_file
from mp_pca_planner.motion.trajectory import Trajectory
from mp_pca_planner.robot.model import Robot

ARM = config_file("human_arm.urdf").read_text(encoding="utf-8")

BALANCED = """<robot name="balanced">
  <link name="world"/>
  <link name="beam"><inertial><origin xyz="0.5 0 0"/><mass value="2"/>
    <inertia ixx="0.01" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="counterweight"><inertial><mass value="4"/>
    <inertia ixx="0.02" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="hinge" type="revolute"><parent link="world"/><child link="beam"/>
    <axis xyz="0 1 0"/><limit lower="-3" upper="3" velocity="10" effort="200"/></joint>
  <joint name="weld" type="fixed"><parent link="beam"/><child link="counterweight"/>
    <origin xyz="-0.25 0 0"/></joint>
</robot>"""
"""A beam on whose hinge gravity has no effect, unless one of its two links is heavier."""


def wrong_model(urdf: str, share: float, rng: np.random.Generator) -> pin.Model:
    """Every mass and principal moment of inertia off by plus or minus a share."""
    root = ET.fromstring(urdf)
    for inertial in root.iter("inertial"):
        mass, tensor = inertial.find("mass"), inertial.find("inertia")
        assert mass is not None
        assert tensor is not None
        assert all(float(tensor.get(key, "0")) == 0.0 for key in ("ixy", "ixz", "iyz"))
        for element, key in ((mass, "value"), *((tensor, key) for key in ("ixx", "iyy", "izz"))):
            factor = 1.0 + share * float(rng.choice([-1.0, 1.0]))
            element.set(key, repr(float(element.get(key, "0")) * factor))
    return pin.buildModelFromXML(ET.tostring(root, encoding="unicode"))


def simulated_errors(
    true: pin.Model,
    nominal: pin.Model,
    law: ControlLaw,
    motion: Trajectory,
    start_error: np.ndarray,
    sampling: tuple[float, int],
    friction: float = 0.0,
) -> np.ndarray:
    """q_d − q at the instants of control, shape (n_samples, n_joints)."""
    curve = BPoly.from_derivatives(
        motion.times.copy(),
        np.stack([motion.positions, motion.velocities, motion.accelerations], axis=1),
    )
    period, delay = sampling
    n_substeps, believed, data = 4, nominal.createData(), true.createData()
    h = period / n_substeps
    n_steps = int(np.ceil(motion.duration / period))
    times = np.minimum(np.arange(n_steps + 1) * period, motion.duration)
    desired = np.stack([curve(times, nu) for nu in range(3)], axis=1)

    def command(k: int, x: np.ndarray) -> np.ndarray:
        d = desired[k]
        feedback = law.position_gains * (d[0] - x[0]) + law.velocity_gains * (d[1] - x[1])
        if law.kind == COMPUTED_TORQUE:
            return pin.rnea(nominal, believed, x[0], x[1], d[2] + feedback).copy()
        return pin.rnea(nominal, believed, *d).copy() + feedback

    def rate(x: np.ndarray, tau: np.ndarray) -> np.ndarray:
        drag = friction * np.tanh(x[1] / 0.005)
        return np.array([x[1], pin.aba(true, data, x[0], x[1], tau - drag)])

    x = np.array([desired[0, 0] - start_error, desired[0, 1]])
    waiting = [command(0, x)] * delay
    errors = []
    for k in range(n_steps + 1):
        errors.append(desired[k, 0] - x[0])
        waiting.append(command(k, x))
        tau = waiting.pop(0)
        for _ in range(n_substeps):
            k1 = rate(x, tau)
            k2 = rate(x + 0.5 * h * k1, tau)
            k3 = rate(x + 0.5 * h * k2, tau)
            k4 = rate(x + h * k3, tau)
            x = x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    return np.array(errors)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("share", "offset", "sampling"),
    [
        (0.0, 0.0, (1e-3, 1)),
        (0.0, 0.001, (2e-3, 1)),
        (1e-4, 0.0, (1e-3, 0)),
        (0.05, 0.001, (1e-3, 1)),
    ],
)
def test_no_error_leaves_the_bound_when_inertias_vary_independently(
    kind: str, share: float, offset: float, sampling: tuple[float, int]
) -> None:
    for urdf, robot, motion in (
        (ARM, arm_robot(), arm_reach(0.6)),
        (BALANCED, Robot(BALANCED), reach(Robot(BALANCED), [0.0], [1.2], 0.6)),
    ):
        law = ControlLaw.from_frequency(kind, robot, motion, 30.0)
        errors = ErrorModel(inertia=share, position=offset)
        known = analyse(ControlLoop(robot, law, motion, np.array(np.inf), *sampling), errors)
        assert known.error_bound is not None
        nominal = pin.buildModelFromXML(urdf)
        for seed in range(3 if share else 1):
            rng = np.random.default_rng(seed)
            start = offset * rng.choice([-1.0, 1.0], robot.n_joints)
            true = wrong_model(urdf, share, rng)
            found = simulated_errors(true, nominal, law, motion, start, sampling)
            assert np.all(np.abs(found) <= known.error_bound)


@pytest.mark.parametrize("kind", KINDS)
def test_no_error_leaves_the_bound_with_friction(kind: str) -> None:
    robot, motion, friction, sampling = arm_robot(), arm_reach(0.6), 0.02, (1e-3, 1)
    law = ControlLaw.from_frequency(kind, robot, motion, 30.0)
    loop, nominal = ControlLoop(robot, law, motion), pin.buildModelFromXML(ARM)
    bounds = [
        analyse(loop, ErrorModel(position=0.0, inertia=0.01, friction=x)).error_bound
        for x in (friction, 0.0)
    ]
    shares = []
    for seed in range(3):
        true = wrong_model(ARM, 0.01, np.random.default_rng(seed))
        found = simulated_errors(true, nominal, law, motion, np.zeros(4), sampling, friction)
        shares.append([np.max(np.abs(found) / np.maximum(x, 1e-9)) for x in bounds])
    within, without = np.max(shares, axis=0)
    assert within <= 1.0 < without  # without friction, the bound is another one


def test_simulations_hold_friction_that_lets_a_joint_rest() -> None:
    """A start error that friction can hold against the proportional gain remains."""
    robot = Robot(BALANCED)
    motion = reach(robot, [0.2], [0.2 + 1e-9], 0.5)
    law = ControlLaw(FEEDFORWARD_PD, robot.joint_names, np.array([10.0]), np.array([5.0]))
    loop, start = ControlLoop(robot, law, motion), np.array([0.01])
    held = simulate(loop, robot, start, 1.0)[0]
    free = simulate(loop, robot, start)[0]
    assert held[-1, 0] > 0.009 and abs(free[-1, 0]) < 0.8 * held[-1, 0]


def test_a_common_factor_is_not_all_that_the_bound_covers() -> None:
    """The beam stays balanced under a common factor; links of their own make it heavy."""
    robot = Robot(BALANCED)
    motion = reach(robot, [0.0], [0.3], 1.0)
    law = ControlLaw.from_frequency(FEEDFORWARD_PD, robot, motion, 30.0)
    errors = ErrorModel(inertia=0.05, position=0.0)
    known = analyse(ControlLoop(robot, law, motion), errors)
    assert known.error_bound is not None
    # At most, both weights are wrong by 5 % in opposite senses: 2 · 0.05 · 2 kg · 0.5 m · g.
    heaviest = 0.1 * 9.81 / law.position_gains[0]
    assert known.error_bound[-1, 0] > 0.9 * heaviest
