# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The simulated robot in virtual time: its faults, its record, its chance."""

from __future__ import annotations

import numpy as np
import pytest
from support.arm import JOINTS, arm_robot
from support.referee import judge

from mp_pca_planner.exceptions import PlannerError
from mp_pca_planner.motion.trajectory import Trajectory
from mp_pca_planner.simulation.controller import to_message
from mp_pca_planner.simulation.robot import Faults, SimulatedRobot

START = np.array([0.1, 0.2, 0.0, 0.8])
SHIFT = np.array([0.6, -0.4, 0.5, 0.7])
DURATION = 1.0
# Of the minimum-jerk motion.
LIMITS = {
    "velocity": 1.875 * np.abs(SHIFT) / DURATION,
    "acceleration": 5.7735 * np.abs(SHIFT) / DURATION**2,
    "jerk": 60.0 * np.abs(SHIFT) / DURATION**3,
}


def robot(**options):
    return SimulatedRobot(arm_robot(), START, **options)


def motion(start=START, shift=SHIFT):
    """The minimum-jerk motion: a quintic, which one segment already holds."""
    zero = np.zeros((2, 4))
    return Trajectory(JOINTS, [0.0, DURATION], [start, start + shift], zero, zero)


def steps(simulated, n):
    for _ in range(n):
        simulated.step()
    return simulated


def commands(simulated):
    return judge(simulated.record.q, simulated.record.clock, LIMITS, cuts=simulated.record.cuts)


def test_motion_is_commanded_as_it_was_sent_and_followed():
    simulated = steps(robot(), 10)
    simulated.send(motion())
    steps(simulated, 1500)
    record = simulated.record
    s = np.clip((record.times - record.times[10] + 1e-3) / DURATION, 0.0, 1.0)[:, None]
    s[:10] = 0.0
    np.testing.assert_allclose(
        record.q, START + SHIFT * s**3 * (10 - 15 * s + 6 * s * s), atol=1e-9
    )
    np.testing.assert_allclose(record.v, SHIFT * 30 * s**2 * (1 - s) ** 2, atol=1e-9)
    np.testing.assert_allclose(record.a, SHIFT * (60 * s - 180 * s**2 + 120 * s**3), atol=1e-8)
    assert np.abs(record.q - record.measured).max() < 0.01
    np.testing.assert_allclose(simulated.measured_state()[0], START + SHIFT, atol=1e-6)
    assert commands(simulated).is_clean
    assert (simulated.n_received, simulated.rejections) == (1, [])
    assert len(record) == 1510 and simulated.time == pytest.approx(record.times[-1])
    simulated.record.clear()
    assert len(simulated.record.q) == 0


@pytest.mark.parametrize("rate", [500.0, 125.0])
def test_joint_states_come_at_their_rate_and_stop_when_they_are_silent(rate):
    simulated = robot(state_rate=rate)
    simulated.send(motion())
    steps(simulated, 8)
    stamps = []
    for _ in range(400):
        simulated.step()
        stamps.append(simulated.newest_state()[0])
    assert len(set(stamps)) in (400 * rate / 1000, 400 * rate / 1000 + 1)
    simulated.faults.silent = True
    silent = simulated.newest_state()
    steps(simulated, 100)
    assert simulated.newest_state()[0] == silent[0]
    np.testing.assert_array_equal(simulated.newest_state()[1], silent[1])
    simulated.faults.silent = False
    assert steps(simulated, 10).newest_state()[0] > silent[0]


def test_transport_takes_its_delay_and_keeps_the_order():
    simulated = robot(seed=3)
    simulated.faults.delay, simulated.faults.jitter = 0.01, 0.02
    arrivals = []
    for k in range(20):
        simulated.send(motion(START + 0.01 * k, np.zeros(4)))
        sent, n = simulated.time, simulated.n_received
        while simulated.n_received == n:
            simulated.step()
        arrivals.append(simulated.time - sent)
        steps(simulated, 3)
    same, other = (robot(seed=seed) for seed in (3, 4))
    for one in (same, other):
        one.faults.delay, one.faults.jitter = 0.01, 0.02
        one.send(motion(START, np.zeros(4)))
        while not one.n_received:
            one.step()
    assert same.time - 1000.0 == arrivals[0] != other.time - 1000.0
    assert 0.009 < min(arrivals) < 0.015 < 0.025 < max(arrivals) < 0.032
    for k in range(20):
        simulated.send(motion(START + 0.01 * k, np.zeros(4)))
    steps(simulated, 50)
    np.testing.assert_allclose(simulated.record.q[-1], START + 0.19)


def test_hold_and_release_leave_the_motion_smooth_and_let_it_end():
    simulated = robot()
    simulated.send(motion())
    steps(simulated, 400)
    simulated.faults.held = True
    steps(simulated, 1500)
    held = simulated.record.q[-1]
    assert simulated.record.scaling[-1] == 0.0
    steps(simulated, 500)
    np.testing.assert_array_equal(simulated.record.q[-1], held)
    simulated.faults.held = False
    simulated.faults.speed_scaling = 0.5
    steps(simulated, 1000)
    assert simulated.record.scaling[-1] == pytest.approx(0.5)
    assert np.any(simulated.record.v[-1] != 0.0)
    steps(simulated, 1000)
    np.testing.assert_array_equal(simulated.record.q[-1], START + SHIFT)
    assert commands(simulated).is_clean


def test_lost_and_rejected_messages_are_known_with_their_reasons():
    simulated = robot()
    simulated.faults.drop = 1.0
    simulated.send(motion())
    simulated.faults.drop, simulated.faults.active = 0.0, False
    steps(simulated, 10)
    simulated.send(motion())
    steps(simulated, 10)
    reasons = [reason for _, reason in simulated.rejections]
    assert reasons == ["the message was lost", "the controller is not active"]
    assert [when for when, _ in simulated.rejections] == [1000.0, 1000.011]
    np.testing.assert_array_equal(simulated.record.q[-1], START)


def test_controller_that_is_restarted_holds_and_the_step_is_marked():
    simulated = robot()
    simulated.send(motion())
    steps(simulated, 500)
    simulated.restart_controller()
    steps(simulated, 500)
    assert simulated.record.cuts == [500]
    np.testing.assert_array_equal(simulated.record.q[500:], simulated.record.q[[499] * 500])
    assert commands(simulated).is_clean
    assert not judge(simulated.record.q, simulated.record.clock, LIMITS).is_clean
    simulated.send(motion(simulated.record.q[-1].copy(), np.zeros(4)))
    assert steps(simulated, 10).rejections == []


def test_faults_that_can_not_be_are_refused():
    for name, value in (("speed_scaling", 1.5), ("delay", -0.1), ("noise", float("nan"))):
        with pytest.raises(PlannerError, match=f"{name} is {value}, expected a number from 0 to"):
            setattr(Faults(), name, value)


def test_robot_is_held_while_its_clock_is_set():
    moved, jumped = robot(), robot()
    for one in (moved, jumped):
        one.faults.delay = 0.01
        one.send(motion())
        steps(one, 5)  # the message is on its way
    for offset in (10**12, -(10**11), 0):
        jumped.set_time(moved.time_ns + offset)
        n, published = len(jumped.record), jumped.state_time_ns
        assert published <= jumped.time_ns
        for one in (moved, jumped):
            steps(one, 300)
        np.testing.assert_array_equal(jumped.record.q[n:], moved.record.q[n:])
        assert jumped.state_time_ns > published


def test_goal_that_is_cancelled_before_the_next_cycle_moves_nothing():
    simulated = steps(robot(), 10)
    simulated.send_message(to_message(motion()), goal="cancelled")
    assert simulated.cancel("cancelled")
    steps(simulated, 1500)
    assert [result[:2] for result in simulated.controller.results] == [("cancelled", "canceled")]
    assert np.allclose(simulated.record.q, START, atol=1e-3)
