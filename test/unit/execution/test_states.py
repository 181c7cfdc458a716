# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Measured states of the last moments, by clocks that the tests set."""

from __future__ import annotations

from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mp_pca_planner.exceptions import GoalError
from mp_pca_planner.execution.options import Tracking
from mp_pca_planner.execution.tracking.measured import MeasuredStates
from mp_pca_planner.motion.goal import JointState

JOINTS = ("a", "b")
REST_VELOCITY = Tracking.rest_velocity


def receive(states, stamp=0.0, age=0.0, number=0, **values):
    def read(names):
        velocities = [values.get(f"v_{name}", 0.0) for name in names]
        return JointState(names, [float(values[name]) for name in names], velocities)

    states.receive(values, read, stamp, age, number)


class World:
    """Two clocks and the object under test."""

    def __init__(self):
        self.receipt, self.motion = 100.0, 5.0
        self.states = MeasuredStates(lambda: self.receipt, lambda: self.motion)
        self.states.expect(JOINTS)

    def pass_time(self, seconds):
        self.receipt += seconds
        self.motion += seconds

    def receive(self, age=0.0, **values):
        receive(self.states, age=age, **values)

    def move(self, velocity, seconds=0.4, period=0.004, *, noise=0.0, delay=None, **reported):
        """Joint a moves evenly; its stamps lie behind by the delay, if there is one."""
        random = np.random.default_rng(0)
        for _ in range(round(seconds / period)):
            self.pass_time(period)
            stamp = {} if delay is None else {"stamp": self.motion - delay}
            q = velocity * self.motion + noise * random.normal()
            self.receive(a=q, b=0.0, **stamp, **reported)


@pytest.fixture
def world():
    return World()


def test_newest_message_counts_in_the_order_of_the_joints(world):
    world.receive(a=1.0, b=2.0)
    world.receive(b=2.02, a=1.01)
    assert world.states.newest(0.5).positions.tolist() == [1.01, 2.02]


@pytest.mark.parametrize("period", [0.002, 0.01, 0.05, 0.15])
@pytest.mark.parametrize("size", [0.01, 0.1, 1.0])
@pytest.mark.parametrize("every", [2, 3, 5])
def test_state_of_another_publisher_is_not_that_of_a_robot_at_rest(world, period, size, every):
    """The robot moves, or the two contradict each other."""
    for k in range(1, round(0.6 / period)):
        world.pass_time(period)
        is_other = k % every == 0
        world.receive(a=size * is_other, b=0.0)
        if is_other:
            with suppress(GoalError):
                assert world.states.velocities(world.states.newest(0.5)).any()


@pytest.mark.parametrize("period", [0.002, 0.01, 0.03])
def test_states_of_other_publishers_contradict_those_of_the_robot_for_the_window(world, period):
    def states(duration, q):
        for _ in range(round(duration / period)):
            world.pass_time(period)
            world.receive(a=q, b=0.0)

    states(0.4, 0.0)
    world.states.newest(0.5)
    states(period, 0.5)
    with pytest.raises(GoalError, match=r"joint 'a' is at 0 and 0\.5 rad .* only one node"):
        world.states.newest(0.5)
    states(period, 0.0)
    with pytest.raises(GoalError, match="contradict each other"):
        world.states.newest(0.5)
    states(Tracking.window + 0.1, 0.0)
    assert not world.states.velocities(world.states.newest(0.5)).any()


@pytest.mark.parametrize("period", [0.001, 0.004])
@pytest.mark.parametrize(("offset", "is_refused"), [(0.0, False), (0.002, True), (-0.01, True)])
def test_publishers_that_differ_slightly_are_distinguished_by_their_numbers(
    world, period, offset, is_refused
):
    random = np.random.default_rng(1)
    for k in range(1, 101):
        world.pass_time(period)
        world.receive(a=world.motion + 1e-4 * random.normal(), b=0.0, number=1000 + k)
        if k % 5 == 0:
            world.pass_time(0.3 * period)
            world.receive(a=world.motion + offset, b=0.0, number=k // 5)
    assert not world.states.history().contradiction(JOINTS)
    if is_refused:
        with pytest.raises(GoalError, match="joint 'a' .* only one node"):
            world.states.newest(0.5)
    # One that restarts counts from 1 again; the other one has ended.
    for k in range(1, round(0.4 / period)):
        world.pass_time(period)
        world.receive(a=world.motion, b=0.0, number=k)
    world.states.newest(0.5)


@given(st.floats(0.1, 3.0), st.floats(0.5, 10.0), st.floats(0.0, 1e-3), st.floats(0.002, 0.03))
def test_states_of_a_robot_never_contradict_each_other(speed, rate, noise, period):
    """It swings at 30 rad/s² at most."""
    world, random = World(), np.random.default_rng(0)
    rate = min(rate, 30.0 / speed)
    for _ in range(round(0.4 / period)):
        world.pass_time(period)
        q = speed / rate * np.sin(rate * world.motion)
        world.receive(a=q + noise * random.normal(), b=0.0)
        world.states.newest(0.5)


def test_state_is_too_old_after_the_timeout_and_never_if_that_is_zero(world):
    world.receive(a=1.0, b=2.0)
    world.pass_time(0.5)
    assert world.states.age == pytest.approx(0.5)
    world.states.newest(0.6)
    world.states.newest(0.0)
    with pytest.raises(GoalError, match=r"0.5 s old, at most 0.4 s"):
        world.states.newest(0.4)


def test_missing_state_is_refused_with_the_joints_it_should_have(world):
    world.receive(gripper=1.0)
    with pytest.raises(
        GoalError, match=r"joints 'a', 'b' has arrived \(1 without them were ignored\)"
    ):
        world.states.newest(0.5)
    assert (world.states.age, world.states.newest_time) == (None, 0.0)


def test_message_of_other_joints_does_not_replace_a_good_one(world):
    world.receive(a=1.0, b=2.0)
    world.receive(gripper=7.0)
    assert world.states.newest(0.5).positions.tolist() == [1.0, 2.0]
    assert world.states.n_incomplete == 1


def test_unusable_state_is_counted_each_time_it_is_needed_and_left_out_of_the_history(world):
    world.receive(a=1.0, b=2.0)
    world.pass_time(0.01)
    world.receive(a=1.0, b="nan")
    for _ in range(2):
        with pytest.raises(GoalError, match="nan"):
            world.states.newest(0.5)
    assert world.states.n_unusable == 2
    assert len(world.states.history().times) == 1


def test_state_of_former_joints_is_forgotten(world):
    world.receive(a=1.0, b=2.0)
    world.states.expect(("a",))
    assert world.states.age is None
    assert world.states.history().positions.shape == (0, 1)


def test_states_that_still_wait_are_forgotten_with_the_others():
    waiting = []

    def fetch():
        while waiting:
            receive(states, **waiting.pop())

    states = MeasuredStates(lambda: 0.0, lambda: 0.0, fetch)
    states.expect(JOINTS)
    waiting.append({"a": 1.0, "b": 1.0})
    states.expect(("a",))
    with pytest.raises(GoalError, match="no joint_states message"):
        states.newest(0.5)


def test_messages_that_wait_are_read_first_unless_they_are_to_wait():
    positions = iter([1.0, 1.01])
    states = MeasuredStates(
        lambda: 0.0, lambda: 0.0, lambda: receive(states, a=next(positions), b=0.0)
    )
    states.expect(JOINTS)
    assert states.newest(1.0).positions[0] == 1.0
    assert states.newest(1.0, fetch=False).positions[0] == 1.0
    assert states.newest(1.0).positions[0] == 1.01


def test_message_is_as_old_as_it_was_when_it_was_handed_over(world):
    world.receive(0.25, a=0.0, b=0.0)
    assert world.states.age == pytest.approx(0.25)
    assert world.states.newest_time == pytest.approx(world.motion - 0.25)


def test_history_holds_the_last_moments_and_the_newest_state(world):
    world.move(1.0, seconds=1.0, period=0.002)
    samples = world.states.history()
    times, positions = samples.times, samples.positions
    np.testing.assert_allclose(positions[:, 0], times)
    assert times[-1] == pytest.approx(world.motion)
    assert 0.25 < times[-1] - times[0] <= 0.3
    assert np.diff(times)[:-1].min() > 0.0079


@pytest.mark.parametrize("reported", [{}, {"v_a": 0.05, "v_b": -0.02}])
def test_positions_say_how_fast_a_robot_moves(world, reported):
    world.move(0.05, **reported)
    v = world.states.velocities(world.states.newest(0.5))
    assert v == pytest.approx([0.05, 0.0], abs=1e-9)


def test_velocity_is_that_of_the_newest_moment_of_a_robot_that_slows_down(world):
    for _ in range(200):
        world.pass_time(0.004)
        world.receive(a=0.9 * world.motion - 0.075 * world.motion**2, b=0.0)
    v = world.states.velocities(world.states.newest(0.5))
    assert v == pytest.approx([0.9 - 0.15 * world.motion, 0.0], abs=1e-9)


def test_velocities_below_the_noise_of_encoders_count_as_none(world):
    world.move(0.0, noise=1e-4, v_a=0.9 * REST_VELOCITY, v_b=-5.0 * REST_VELOCITY)
    assert not world.states.velocities(world.states.newest(0.5)).any()
    world.move(0.002)
    assert not world.states.velocities(world.states.newest(0.5)).any()


def test_reported_velocity_counts_where_positions_do_not_say_it_yet(world):
    world.receive(a=0.0, b=0.0, v_a=0.9 * REST_VELOCITY, v_b=1.1 * REST_VELOCITY)
    v = world.states.velocities(world.states.newest(0.5))
    assert v.tolist() == [0.0, 1.1 * REST_VELOCITY]


def test_clear_velocity_counts_though_the_robot_has_only_begun_to_move(world):
    world.move(0.0)
    world.receive(a=0.0, b=0.0, v_b=0.5)
    assert world.states.velocities(world.states.newest(0.5)).tolist() == [0.0, 0.5]


def test_stamps_say_when_a_state_was_measured_if_clocks_agree(world):
    world.move(1.0, delay=0.003)
    assert world.states.clock.is_usable
    assert world.states.newest_time == pytest.approx(world.motion - 0.003)
    np.testing.assert_allclose(world.states.history().times[-1], world.motion - 0.003)


@pytest.mark.parametrize("delay", [-3.0, -0.02, 0.2, 1e9])
def test_stamps_of_a_clock_with_a_constant_difference_are_times_of_that_clock(world, delay):
    world.move(1.0, delay=delay)
    clock = world.states.clock
    assert not clock.is_usable
    assert clock.estimate == pytest.approx(delay)
    assert world.states.newest_time == pytest.approx(world.motion)
    clock.settle(is_idle=False)
    assert not clock.is_usable, "a motion is being executed in the time of the node"
    clock.settle(is_idle=True)
    assert clock.is_usable
    assert clock.now() == pytest.approx(world.motion - delay)
    assert world.states.newest_time == pytest.approx(world.motion - delay)


@pytest.mark.parametrize("rate", [0.0, 0.5, 1.1])
def test_stamps_that_advance_at_another_rate_are_not_used(world, rate):
    for _ in range(300):
        world.pass_time(0.01)
        world.receive(a=0.0, b=0.0, stamp=77.0 + rate * world.motion)
        world.states.clock.settle(is_idle=True)
    assert not world.states.clock.is_usable
    assert world.states.newest_time == pytest.approx(world.motion)


@pytest.mark.parametrize("stall", [0.3, 1.0])
def test_clocks_agree_while_and_after_a_machine_stalls(world, stall):
    """What was sent meanwhile arrives at the end, or in its turn, ever less late."""
    usable = []
    for k in range(400):
        world.pass_time(0.004)
        late = max(stall - 0.004 * (k - 200), 0.0) if k >= 200 else 0.0
        world.receive(a=0.0, b=0.0, stamp=world.motion - 0.001 - late)
        world.states.clock.settle(is_idle=True)
        usable.append(world.states.clock.is_usable and world.states.clock.offset == 0.0)
    assert all(usable)


def test_first_stamps_are_no_certain_judgement_of_the_clocks(world):
    """The machine stalls while the processes start."""
    usable = []
    for k in range(40):
        world.pass_time(0.03)
        world.receive(a=0.0, b=0.0, stamp=world.motion - (0.25 if k < 5 else 0.001))
        usable.append(world.states.clock.is_usable)
        assert world.states.clock.is_certain == (k >= 19)
    assert not any(usable[:5])
    assert all(usable[19:])


def test_judgement_of_clocks_is_taken_back(world):
    """The clock of the robot is set at 3 s, and again at 15 s."""
    offsets = []
    for k in range(2500):
        world.pass_time(0.01)
        ahead = 2.0 if 300 <= k < 1500 else 0.0
        world.receive(a=0.0, b=0.0, stamp=world.motion - 0.001 + ahead)
        world.states.clock.settle(is_idle=True)
        offsets.append(world.states.clock.offset if world.states.clock.is_usable else None)
    assert set(offsets[:300]) == {0.0}
    assert offsets[1400] == pytest.approx(-2.0, abs=0.01)
    assert offsets[-1] == 0.0


@pytest.mark.parametrize(
    ("period", "rate"),
    [(p, r) for p in (0.001, 0.004, 0.01) for r in (0.2, 1.0, 3.0)] + [(0.05, 1.0), (0.05, 3.0)],
)
def test_stamps_are_used_where_simulated_time_comes_in_steps(period, rate):
    """The node sees the clock late, in steps; states at 500 Hz carry the exact time."""
    real, receipt, states = 0.0, [], None
    simulated = lambda: 50.0 + period * (rate * max(real - 0.0015, 0.0) // period)  # noqa: E731
    states = MeasuredStates(lambda: real, simulated)
    states.expect(JOINTS)
    for k in range(1, 1500):
        real = 0.002 * k
        receipt.append(real)
        if k % 25 == 0:  # polled at 20 Hz
            for when in receipt:
                stamp = 50.0 + rate * (when - 0.0003)
                receive(states, stamp=stamp, age=real - when, a=0.0, b=0.0)
            receipt.clear()
            states.clock.settle(is_idle=True)
            if k > 500:
                assert states.clock.is_usable
                assert abs(states.clock.now() - (50.0 + rate * real)) <= 2.0 * period + 0.01


def test_late_messages_do_not_make_clocks_differ(world):
    for k in range(50):
        world.pass_time(0.01)
        world.receive(a=0.0, b=0.0, stamp=world.motion - (0.15 if k % 3 else 0.002))
    assert world.states.clock.is_usable


def test_clocks_agree_where_no_message_has_a_stamp(world):
    world.move(1.0)
    assert world.states.clock.is_usable
    assert world.states.newest_time == pytest.approx(world.motion)


def send_in_turn(world, position, seconds=0.4, period=0.002, **others):
    """Joint a in one message, b in another one halfway in between, both with stamps."""
    for _ in range(round(seconds / period)):
        for name in JOINTS:
            world.pass_time(period / 2.0)
            stamp = world.motion - 2e-4
            world.receive(stamp=stamp, **{name: position(name, stamp)}, **others)


def swing(name, time):
    return 0.5 * np.sin(3.0 * time + (name == "b"))


def test_states_in_several_messages_are_merged_at_a_common_time(world):
    send_in_turn(world, swing)
    state, time = world.states.newest(0.5), world.states.newest_time
    np.testing.assert_allclose(state.positions, [swing(n, time) for n in JOINTS], atol=5e-5)
    samples = world.states.history()
    assert len(samples.times) > 20
    there = np.array([[swing(n, t) for n in JOINTS] for t in samples.times])
    np.testing.assert_allclose(samples.positions, there, atol=5e-5)
    speed = [1.5 * np.cos(3.0 * time + k) for k in range(2)]
    np.testing.assert_allclose(world.states.velocities(state), speed, atol=0.02)
    assert world.states.n_incomplete == 0


def test_each_joint_has_its_own_age(world):
    send_in_turn(world, lambda *_: 0.0)
    for _ in range(100):
        world.pass_time(0.006)
        world.receive(a=0.0)
    with pytest.raises(GoalError, match=r"message with 'b' is 0\.6 s old"):
        world.states.newest(0.5)
    assert world.states.age == pytest.approx(0.6)
    world.receive(b=0.0)
    world.states.newest(0.5)


def test_joint_that_no_message_has_is_named(world):
    world.receive(a=1.0)
    with pytest.raises(GoalError, match="with the joints 'b' has arrived"):
        world.states.newest(0.5)
    assert (world.states.age, world.states.newest_time) == (None, 0.0)


def test_publishers_of_the_same_joint_in_different_messages_contradict_each_other(world):
    send_in_turn(world, lambda *_: 0.2)
    for _ in range(10):
        world.pass_time(0.002)
        world.receive(a=0.2)
        world.receive(a=0.2, b=0.0)
        world.receive(b=0.2)
    with pytest.raises(GoalError, match="joint 'b' is at .* only one node"):
        world.states.newest(0.5)


def test_message_of_a_whole_robot_and_one_of_its_part_may_both_come(world):
    for k in range(200):
        world.pass_time(0.002)
        q = swing("a", world.motion)
        world.receive(a=q, stamp=world.motion)
        if k % 10 == 0:
            world.receive(a=q, b=0.0, stamp=world.motion)
        if k > 100:
            world.states.newest(0.5)


def test_sets_of_joints_that_come_and_go_are_not_kept_for_ever(world):
    names = [f"j{k}" for k in range(12)]
    world.states.expect(names)
    for k in range(1, 2**12):
        world.receive(**{name: 0.0 for j, name in enumerate(names) if k >> j & 1})
    assert len(world.states._sources) <= world.states.max_sources
    assert world.states.newest(0.5).positions.tolist() == [0.0] * 12


@pytest.mark.parametrize("stall", [0.1, 1.0])
def test_states_that_come_at_once_after_a_stall_are_as_good_as_others(world, stall):
    world.move(0.5, delay=0.001)
    began = world.motion
    world.pass_time(stall)
    for time in np.arange(began, world.motion, 0.002):
        world.receive(a=0.5 * time, b=0.0, stamp=time - 0.001)
    samples = world.states.history()
    assert len(samples.times) > 30
    assert samples.times[-1] - samples.times[0] == pytest.approx(0.3, abs=0.02)
    np.testing.assert_allclose(samples.positions[:, 0], 0.5 * (samples.times + 0.001))
    assert world.states.velocities(world.states.newest(0.5)) == pytest.approx([0.5, 0.0])


def test_positions_of_further_joints_are_kept_however_old(world):
    world.receive(a=0.0, b=0.0, finger=0.02)
    world.pass_time(60.0)
    world.receive(a=0.0, b=0.0, lift="nan")
    assert world.states.others == {"finger": 0.02}
    world.receive(finger=0.03)
    assert world.states.others == {"finger": 0.03}


def test_further_joints_are_not_kept_without_bound(world):
    for k in range(100):
        world.receive(**{f"x{j}": 0.0 for j in range(20 * k, 20 * k + 20)})
    assert len(world.states.others) <= 500
    assert "x1999" in world.states.others


def test_states_that_wait_elsewhere_are_fetched_before_the_newest_is_used():
    states = MeasuredStates(lambda: 0.0, lambda: 0.0, lambda: receive(states, a=7.0))
    states.expect(("a",))
    assert states.newest(0.5).positions.tolist() == [7.0]
