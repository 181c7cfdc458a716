# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Measured states of the last moments, by clocks that the tests set."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from mp_pca_planner.exceptions import GoalError
from mp_pca_planner.execution.states import MeasuredState, MeasuredStates, UnconfirmedError

JOINTS = ("a", "b")
REST_VELOCITY = 0.01  # reported by robots at rest at most [rad/s]


class World:
    """Two clocks and the object under test."""

    def __init__(self) -> None:
        self.receipt, self.now = 100.0, 5.0
        self.states = MeasuredStates(lambda: self.receipt, lambda: self.now)
        self.states.expect(JOINTS)

    def pass_time(self, seconds: float) -> None:
        self.receipt += seconds
        self.now += seconds

    def receive(self, *, stamp: float = 0.0, age: float = 0.0, v: Any = (), **q: float) -> None:
        self.states.receive(tuple(q), tuple(q.values()), v, stamp, age)

    def move(
        self,
        velocity: float,
        seconds: float = 0.4,
        period: float = 0.004,
        *,
        noise: float = 0.0,
        delay: float | None = None,
        v: Any = (),
    ) -> None:
        """Joint a moves evenly; its stamps lie behind by the delay, if there is one."""
        random = np.random.default_rng(0)
        for _ in range(round(seconds / period)):
            self.pass_time(period)
            stamp = 0.0 if delay is None else self.now - delay
            q = velocity * (self.now - (delay or 0.0)) + noise * random.normal()
            self.receive(a=q, b=0.0, stamp=stamp, v=v)

    @property
    def newest(self) -> MeasuredState:
        return self.states.newest(0.5)


@pytest.fixture
def world() -> World:
    return World()


def test_state_is_too_old_after_the_timeout_and_never_if_that_is_zero(world: World) -> None:
    world.receive(b=2.0, a=1.0, age=0.25)
    world.pass_time(0.25)
    assert world.states.age == pytest.approx(0.5)
    assert world.states.newest(0.6).time == pytest.approx(world.now - 0.5)
    assert world.states.newest(0.0).positions.tolist() == [1.0, 2.0]
    with pytest.raises(UnconfirmedError, match=r"0.5 s old, at most 0.4 s"):
        world.states.newest(0.4)


def test_missing_state_is_refused_with_the_joints_it_should_have(world: World) -> None:
    world.receive(gripper=1.0)
    ignored = r"joints 'a', 'b', each once, has arrived \(1 without them were ignored\)"
    with pytest.raises(GoalError, match=ignored):
        _ = world.newest
    assert world.states.age is None
    world.states.receive(("a", "b", "b"), (1.0, 2.0, 3.0))
    with pytest.raises(GoalError, match="with the joints 'b', each once, has arrived"):
        _ = world.newest


@pytest.mark.parametrize(
    ("q", "v"),
    [((1.0, np.nan), ()), ((np.inf, 0.0), ()), ((1.0,), ()), ((1.0, 2.0), (0.0,))],
)
def test_message_that_can_not_be_used_is_named_until_a_better_one_comes(
    world: World, q: Any, v: Any
) -> None:
    world.receive(a=1.0, b=2.0)
    world.states.receive(JOINTS, q, v)
    with pytest.raises(GoalError, match="can't be used; expected one finite position per joint"):
        _ = world.newest
    assert world.states.n_unusable == 1
    world.receive(a=1.0, b=2.0)
    assert world.newest.at_rest


# Velocities


@pytest.mark.parametrize("v", [(), (0.05, -0.02), (np.nan, np.inf)])
@pytest.mark.parametrize("velocity", [0.05, 0.5])
@pytest.mark.parametrize("period", [0.001, 0.1])
def test_positions_say_how_fast_a_robot_moves(
    world: World, velocity: float, v: Any, period: float
) -> None:
    world.move(velocity, period=period, v=v)
    assert world.newest.velocities == pytest.approx([velocity, 0.0], abs=1e-9)
    assert not world.newest.at_rest


def test_velocity_is_that_of_the_newest_moment_of_a_robot_that_slows_down(world: World) -> None:
    for _ in range(200):
        world.pass_time(0.004)
        world.receive(a=0.9 * world.now - 0.075 * world.now**2, b=0.0)
    assert world.newest.velocities == pytest.approx([0.9 - 0.15 * world.now, 0.0], abs=1e-9)


def test_reported_velocity_counts_where_positions_do_not_say_it_yet(world: World) -> None:
    world.receive(a=0.0, b=0.0, v=(0.9 * REST_VELOCITY, 1.1 * REST_VELOCITY))
    assert world.newest.velocities.tolist() == [0.0, 1.1 * REST_VELOCITY]
    world.move(0.0)
    world.receive(a=0.0, b=0.0, v=(0.0, 0.5))
    assert world.newest.velocities.tolist() == [0.0, 0.5]


def test_velocities_below_the_noise_of_encoders_count_as_none(world: World) -> None:
    world.move(0.0, noise=1e-4, v=(0.9 * REST_VELOCITY, -5.0 * REST_VELOCITY))
    assert world.newest.at_rest
    world.move(0.002)
    assert world.newest.at_rest


# Stamps


def test_stamps_say_when_a_state_was_measured_if_clocks_agree(world: World) -> None:
    world.move(1.0, delay=0.003)
    assert world.states.stamps.is_usable
    assert world.newest.time == pytest.approx(world.now - 0.003)


@pytest.mark.parametrize("delay", [-1e9, -3.0, -0.03, 0.15, 3.0, 1e9])
def test_stamps_of_a_clock_that_differs_are_not_used(world: World, delay: float) -> None:
    world.move(1.0, seconds=1.0, delay=delay)
    stamps = world.states.stamps
    assert stamps.is_certain and not stamps.is_usable
    assert stamps.difference == pytest.approx(delay)
    assert world.newest.time == pytest.approx(world.now)


@pytest.mark.parametrize("stall", [0.3, 1.0])
def test_clocks_agree_while_and_after_a_machine_stalls(world: World, stall: float) -> None:
    """What was sent meanwhile arrives at the end, or in its turn, ever less late."""
    for k in range(400):
        world.pass_time(0.004)
        late = max(stall - 0.004 * (k - 200), 0.0) if k >= 200 else 0.0
        world.receive(a=0.0, b=0.0, stamp=world.now - 0.001 - late)
        assert world.states.stamps.is_usable


def test_judgement_of_clocks_is_taken_back(world: World) -> None:
    """The clock of the robot is set at 3 s, and again at 15 s."""
    is_usable = []
    for k in range(3000):
        world.pass_time(0.01)
        ahead = 2.0 if 300 <= k < 1500 else 0.0
        world.receive(a=0.0, b=0.0, stamp=world.now - 0.001 + ahead)
        is_usable.append(world.states.stamps.is_usable)
    assert all(is_usable[:300]) and not is_usable[1400] and is_usable[-1]


@pytest.mark.parametrize("period", [0.001, 0.004, 0.01])
def test_stamps_are_used_where_simulated_time_comes_in_steps(period: float) -> None:
    """The node sees the clock late, in steps; states at 500 Hz carry the exact time."""
    real = 0.0
    states = MeasuredStates(
        lambda: real, lambda: 50.0 + period * (max(real - 0.0015, 0.0) // period)
    )
    states.expect(JOINTS)
    for k in range(1, 1500):
        real = 0.002 * k
        states.receive(JOINTS, (0.0, 0.0), (), 50.0 + real - 0.0003)
        assert states.stamps.is_usable


# Robots that send their joints in several messages


def send_in_turn(world: World, seconds: float = 0.4, period: float = 0.002) -> None:
    """Joint a in one message, b in another one halfway in between."""
    for _ in range(round(seconds / period)):
        for name, position in (("a", np.sin), ("b", np.cos)):
            world.pass_time(period / 2.0)
            world.receive(stamp=world.now - 2e-4, **{name: position(world.now - 2e-4)})


def test_states_in_several_messages_are_merged(world: World) -> None:
    send_in_turn(world)
    q, t = world.newest.positions, world.now - 2e-4
    np.testing.assert_allclose(q, [np.sin(t), np.cos(t)], atol=2e-3)
    np.testing.assert_allclose(world.newest.velocities, [np.cos(t), -np.sin(t)], atol=0.01)
    assert world.states.n_incomplete == 0
    assert world.newest.time == pytest.approx(world.now - 2e-4 - 1e-3)


def test_each_joint_has_its_own_age(world: World) -> None:
    send_in_turn(world)
    for _ in range(100):
        world.pass_time(0.006)
        world.receive(a=0.0)
    with pytest.raises(UnconfirmedError, match=r"message with 'b' is 0\.6 s old"):
        _ = world.newest
    assert world.states.age == pytest.approx(0.6)
    world.receive(b=0.0)
    assert world.newest.positions.tolist() == [0.0, 0.0]


def test_complete_messages_count_before_a_second_publisher_of_some_joints(world: World) -> None:
    for _ in range(60):
        world.pass_time(0.005)
        world.receive(a=1.0, b=2.0)
        world.pass_time(0.005)
        world.receive(a=0.0)
        assert world.newest.positions.tolist() == [1.0, 2.0] and world.newest.at_rest
    for _ in range(35):  # the complete ones end
        world.pass_time(0.01)
        world.receive(a=0.0)
    assert world.newest.positions.tolist() == [0.0, 2.0]


def test_positions_of_further_joints_are_kept_however_old(world: World) -> None:
    world.receive(a=0.0, b=0.0, finger=0.02)
    world.pass_time(60.0)
    world.receive(a=0.0, b=0.0, lift=np.nan)
    assert world.states.others == {"finger": 0.02}
    world.receive(finger=0.03)
    assert world.states.others == {"finger": 0.03}
