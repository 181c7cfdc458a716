# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Control laws against closed forms, and their error bounds against simulations."""

import numpy as np
import pytest
from support.arm import JOINTS, arm_robot
from support.reaches import arm_reach, reach

from mp_pca_planner.control.closed_loop import ControlLoop, ErrorModel, simulate, verify
from mp_pca_planner.control.law import (
    COMPUTED_TORQUE,
    FEEDFORWARD_PD,
    ControlLaw,
)
from mp_pca_planner.control.stability import analyse
from mp_pca_planner.robot.model import Robot

PENDULUM = """<robot name="pendulum">
  <link name="world"/>
  <link name="rod"><inertial><origin xyz="0 0 -0.5"/><mass value="2"/>
    <inertia ixx="0.1" iyy="0.1" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="hinge" type="revolute"><parent link="world"/><child link="rod"/>
    <axis xyz="0 1 0"/><limit lower="-3" upper="3" velocity="10" effort="100"/></joint>
</robot>"""


def test_error_of_computed_torque_decays_as_the_chosen_second_order_system() -> None:
    loop = pendulum_loop(period=1e-4, delay=0)
    errors, _ = simulate(loop, loop.model, np.array([0.1]))
    times = np.arange(len(errors)) * 1e-4
    exact = 0.1 * (1.0 + 10.0 * times) * np.exp(-10.0 * times)
    assert np.abs(errors[:, 0] - exact).max() < 2e-4


def test_poles_of_computed_torque_are_those_asked_for() -> None:
    robot = arm_robot()
    motion = arm_reach()
    law = ControlLaw(COMPUTED_TORQUE, JOINTS, np.full(4, 400.0), np.full(4, 32.0))
    known = analyse(ControlLoop(robot, law, motion, delay=0), ErrorModel())
    assert known.slowest_pole == pytest.approx(-16.0, rel=0.02)
    assert known.least_damping == pytest.approx(0.8, rel=0.02)
    assert known.sampled_radius == pytest.approx(np.exp(-16.0 * 1e-3), abs=1e-3)


@pytest.mark.parametrize("kind", [FEEDFORWARD_PD, COMPUTED_TORQUE])
def test_bound_holds_in_perturbed_simulations_and_is_not_vacuous(kind: str) -> None:
    robot = arm_robot()
    motion = arm_reach()
    law = ControlLaw.from_frequency(kind, robot, motion, 30.0)
    errors, limits = ErrorModel(), robot.limits().effort
    loop = ControlLoop(robot, law, motion, limits)
    known = analyse(loop, errors)
    assert known.holds
    found = verify(loop, errors, known.error_bound, 12, seed=3)
    assert found.bound_held == 12
    assert found.saturated == 0
    assert known.error_bound is not None
    assert np.all(known.error_bound.max(axis=0) < 10.0 * found.errors.max(axis=0))


def test_efforts_stay_within_the_bound_that_tells_whether_they_saturate() -> None:
    robot = arm_robot()
    motion = arm_reach()
    law = ControlLaw.from_frequency(FEEDFORWARD_PD, robot, motion, 30.0)
    errors = ErrorModel()
    known = analyse(ControlLoop(robot, law, motion, robot.limits().effort), errors)
    assert known.effort_bound is not None
    rng = np.random.default_rng(0)
    loop = ControlLoop(robot, law, motion)
    _, efforts = simulate(loop, *errors.sample(robot, rng, extreme=True))
    # Efforts act one sample after the one that they are computed for.
    assert np.all(np.abs(efforts[1:]) <= known.effort_bound[:-1] + 1e-9)
    tight = known.effort_bound.max(axis=0) * 0.9
    assert analyse(ControlLoop(robot, law, motion, tight), errors).effort_reserve < 0.0


def test_bound_without_model_errors_is_what_the_delay_costs() -> None:
    robot, motion = arm_robot(), arm_reach(0.5)
    law = ControlLaw.from_frequency(FEEDFORWARD_PD, robot, motion, 20.0)
    loop = ControlLoop(robot, law, motion, delay=4)
    known = analyse(loop, ErrorModel(inertia=0.0, position=0.0))
    errors, _ = simulate(loop, robot, np.zeros(4))
    assert known.error_bound is not None
    ratio = known.error_bound.max(axis=0) / np.abs(errors).max(axis=0)
    assert np.all((ratio >= 1.0) & (ratio < 1.1))


def test_loop_that_delay_makes_unstable_has_no_bound() -> None:
    robot = arm_robot()
    motion = arm_reach(0.3)
    law = ControlLaw.from_frequency(FEEDFORWARD_PD, robot, motion, 30.0)
    known = analyse(ControlLoop(robot, law, motion, delay=60), ErrorModel())
    assert known.sampled_radius > 1.0
    assert not known.holds


def pendulum_loop(**sampling: float) -> ControlLoop:
    robot = Robot(PENDULUM)
    motion = reach(robot, [0.0], [1.0], 1.0)
    law = ControlLaw.from_frequency(COMPUTED_TORQUE, robot, motion, 10.0)
    return ControlLoop(robot, law, motion, **sampling)  # type: ignore[arg-type]
