# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Where motions start, by clocks that the tests set."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pytest

from mp_pca_planner.exceptions import GoalError, TrajectoryError
from mp_pca_planner.goal import JointState
from mp_pca_planner.ros.start_state import (
    LATE_TOLERANCE,
    START_TOLERANCE,
    StartStates,
    TooLateError,
)
from mp_pca_planner.trajectory import Trajectory

JOINTS = ("a", "b")


class Reader:
    """Messages are bytes in a notation that tests can write: ``a=1.0,b=2.0``."""

    def names_all(self, message: bytes, joint_names: Sequence[str]) -> bool:
        return set(joint_names) <= set(self._values(message))

    def read(self, message: bytes, joint_names: Sequence[str]) -> JointState:
        values = self._values(message)
        velocities = [values.get(f"v_{name}", 0.0) for name in joint_names]
        return JointState(joint_names, [values[name] for name in joint_names], velocities)

    def _values(self, message: bytes) -> dict[str, float]:
        pairs = (pair.split("=") for pair in message.decode().split(","))
        return {name: float(value) for name, value in pairs}


@dataclass
class World:
    """Two clocks and the object under test."""

    receipt: float = 100.0
    motion: float = 5.0

    def __post_init__(self) -> None:
        self.states = StartStates(Reader(), lambda: self.receipt, lambda: self.motion)
        self.states.expect(JOINTS)

    def pass_time(self, seconds: float) -> None:
        self.receipt += seconds
        self.motion += seconds


@pytest.fixture
def world() -> World:
    return World()


def message(*positions: float, names: tuple[str, ...] = JOINTS) -> bytes:
    return ",".join(f"{n}={q}" for n, q in zip(names, positions, strict=True)).encode()


def motion(goal: float = 1.0, duration: float = 2.0) -> Trajectory:
    """From 0 to the goal and its opposite, by the minimum-jerk polynomial."""
    times = np.linspace(0.0, duration, 201)
    s = times / duration
    q, v, a = (
        np.outer(values, [goal, -goal]) / duration**order
        for order, values in enumerate(
            (
                10 * s**3 - 15 * s**4 + 6 * s**5,
                30 * s**2 - 60 * s**3 + 30 * s**4,
                60 * s - 180 * s**2 + 120 * s**3,
            )
        )
    )
    return Trajectory(JOINTS, times, q, v, a)


def test_measured_start_is_the_newest_message_at_rest_in_acceleration(world: World) -> None:
    world.states.receive(message(1.0, 2.0))
    world.states.receive(message(4.0, 3.0, names=("b", "a")))
    start = world.states.choose("measured", 0.5, 0.0)
    assert start.state.positions.tolist() == [3.0, 4.0]
    assert start.state.accelerations.tolist() == [0.0, 0.0]


def test_state_is_too_old_after_the_timeout_and_never_if_that_is_zero(world: World) -> None:
    world.states.receive(message(1.0, 2.0))
    world.pass_time(0.5)
    assert world.states.age == pytest.approx(0.5)
    world.states.choose("measured", 0.6, 0.0)
    world.states.choose("measured", 0.0, 0.0)
    with pytest.raises(GoalError, match=r"0.5 s old, at most 0.4 s"):
        world.states.choose("measured", 0.4, 0.0)


def test_missing_state_is_refused_with_the_joints_it_should_have(world: World) -> None:
    world.states.receive(message(1.0, names=("gripper",)))
    with pytest.raises(GoalError, match=r"'a', 'b' has arrived \(1 without them were ignored\)"):
        world.states.choose("measured", 0.5, 0.0)
    assert world.states.age is None


def test_message_of_other_joints_does_not_replace_a_good_one(world: World) -> None:
    world.states.receive(message(1.0, 2.0))
    world.states.receive(message(7.0, names=("gripper",)))
    assert world.states.choose("measured", 0.5, 0.0).state.positions.tolist() == [1.0, 2.0]
    assert world.states.n_incomplete == 1


def test_unusable_state_is_counted_each_time_it_is_needed(world: World) -> None:
    world.states.receive(message(1.0, float("nan")))
    for _ in range(2):
        with pytest.raises(GoalError, match="nan"):
            world.states.choose("measured", 0.5, 0.0)
    assert world.states.n_unusable == 2


def test_state_of_former_joints_is_forgotten(world: World) -> None:
    world.states.receive(message(1.0, 2.0))
    world.states.expect(JOINTS)
    assert world.states.age == 0.0
    world.states.expect(("a",))
    assert world.states.age is None


def test_commanded_start_is_on_the_running_motion_ahead_by_the_latency(world: World) -> None:
    running = motion()
    world.states.command(running)
    world.pass_time(0.5)
    world.states.receive(message(0.1, -0.1))
    start = world.states.choose("commanded", 0.5, 0.1)
    expected = [x[60] for x in (running.positions, running.velocities, running.accelerations)]
    found = [start.state.positions, start.state.velocities, start.state.accelerations]
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    assert np.abs(start.state.velocities).min() > 0.1


@pytest.mark.parametrize("away", [0.09, 0.11])
def test_robot_that_rests_away_from_the_running_motion_starts_where_it_is(
    world: World, away: float
) -> None:
    world.states.command(motion())
    world.pass_time(1.0)
    world.states.receive(message(0.5 - away, -0.5))
    start = world.states.choose("commanded", 0.5, 0.0, 0.1)
    has_left = away > 0.1
    assert (start.commanded is None) == has_left
    assert (world.states.running is None) == has_left
    assert start.state.positions[0] == pytest.approx(0.5 - away * has_left)
    assert (start.state.velocities[0] == 0.0) == has_left


def test_robot_that_moves_away_from_the_running_motion_is_refused_a_goal(world: World) -> None:
    world.states.command(motion())
    world.pass_time(1.0)
    world.states.receive(message(0.3, -0.5) + b",v_b=0.2")
    with pytest.raises(GoalError, match="joint 'a' is 0.2 .* commanded_tolerance"):
        world.states.choose("commanded", 0.5, 0.0, 0.1)
    assert world.states.running is not None


@pytest.mark.parametrize(("away", "moving"), [(0.09, b""), (0.11, b""), (0.11, b",v_b=0.2")])
def test_stop_is_from_where_a_robot_is_that_has_left_its_motion(
    world: World, away: float, moving: bytes
) -> None:
    world.states.command(motion())
    world.pass_time(1.0)
    world.states.receive(message(0.5 - away, -0.5) + moving)
    here = world.states.present(0.5, 0.1)
    assert here.positions[0] == pytest.approx(0.5 - away * (away > 0.1))


def test_stop_of_a_robot_that_nobody_hears_of_is_on_its_motion(world: World) -> None:
    world.states.command(motion())
    world.states.receive(message(3.0, 3.0))
    world.pass_time(1.0)
    assert world.states.present(0.5, 0.1).positions[0] == pytest.approx(0.5)


def test_old_measurement_is_compared_with_where_the_motion_was_then(world: World) -> None:
    world.states.command(motion())
    world.pass_time(1.0)
    world.states.receive(message(0.5, -0.5))
    world.pass_time(0.4)
    assert world.states.choose("commanded", 0.5, 0.0, 0.1).commanded is not None


def test_start_beyond_the_end_of_the_running_motion_is_its_goal_at_rest(world: World) -> None:
    world.states.command(motion())
    world.pass_time(1.95)
    world.states.receive(message(1.0, -1.0))
    start = world.states.choose("commanded", 0.5, 0.1)
    assert start.state.positions.tolist() == [1.0, -1.0]
    assert start.state.velocities.tolist() == [0.0, 0.0]


@pytest.mark.parametrize("seconds", [2.0, -1.0])
def test_measured_state_counts_when_the_motion_is_over_or_time_was_set_back(
    world: World, seconds: float
) -> None:
    world.states.command(motion())
    world.motion += seconds
    world.states.receive(message(1.1, -1.1))
    start = world.states.choose("commanded", 0.5, 0.1)
    assert start.state.positions.tolist() == [1.1, -1.1]


def test_measured_state_counts_by_default_while_a_motion_runs(world: World) -> None:
    world.states.command(motion())
    world.pass_time(1.0)
    world.states.receive(message(0.4, -0.4))
    start = world.states.choose("measured", 0.5, 0.1)
    assert start.state.positions.tolist() == [0.4, -0.4]


def rest_from(start: object) -> Trajectory:
    """A second of standing still, from where a motion is to start."""
    here = start.state  # type: ignore[attr-defined]
    zero = np.zeros((2, 2))
    return Trajectory(JOINTS, [0.0, 1.0], [here.positions] * 2, zero, zero)


def test_commanded_start_is_led_to_by_what_is_left_of_the_running_motion(world: World) -> None:
    running = motion()
    world.states.command(running)
    world.states.receive(message(0.0, 0.0))
    world.pass_time(1.0)
    start = world.states.choose("commanded", 9.0, 0.1)
    world.pass_time(0.03)
    joined = world.states.join(rest_from(start), start, 9.0)
    assert joined.duration == pytest.approx(1.0 + 0.07)
    np.testing.assert_allclose(joined.positions[0], running.positions[103], rtol=1e-9)
    np.testing.assert_allclose(joined.velocities[0], running.velocities[103], rtol=1e-9)
    for time, q in zip(joined.times[:-2], joined.positions, strict=False):
        k = round((1.03 + time) * 100)
        np.testing.assert_allclose(q, running.positions[k], rtol=1e-9)
    np.testing.assert_allclose(joined.positions[-2], running.positions[110], rtol=1e-9)


def test_start_is_refused_when_planning_took_so_long_that_the_robot_has_passed_it(
    world: World,
) -> None:
    world.states.command(motion())
    world.states.receive(message(0.0, 0.0))
    world.pass_time(1.0)
    start = world.states.choose("commanded", 9.0, 0.01)
    world.pass_time(0.01 + LATE_TOLERANCE / 2)
    assert world.states.join(rest_from(start), start, 9.0).duration == 1.0
    world.pass_time(LATE_TOLERANCE)
    with pytest.raises(TooLateError, match="planning took too long"):
        world.states.join(rest_from(start), start, 9.0)


def test_start_is_refused_when_another_motion_was_published_meanwhile(world: World) -> None:
    world.states.command(motion())
    world.states.receive(message(0.0, 0.0))
    start = world.states.choose("commanded", 0.5, 0.0)
    world.states.command(motion())
    with pytest.raises(TooLateError, match="another motion"):
        world.states.join(rest_from(start), start, 0.5)


def test_old_state_is_refused_while_a_motion_runs_too(world: World) -> None:
    world.states.command(motion())
    world.states.receive(message(0.0, 0.0))
    world.pass_time(1.0)
    with pytest.raises(GoalError, match="old"):
        world.states.choose("commanded", 0.5, 0.0)


def test_message_is_as_old_as_it_was_when_it_was_handed_over(world: World) -> None:
    world.states.receive(message(0.0, 0.0), 0.25)
    assert world.states.age == pytest.approx(0.25)


@pytest.mark.parametrize(("moved", "accepted"), [(0.9, True), (1.1, False)])
def test_measured_start_may_move_by_the_tolerance_while_planning(
    world: World, moved: float, accepted: bool
) -> None:
    world.states.receive(message(0.0, 0.0))
    start = world.states.choose("measured", 0.5, 0.0)
    world.states.receive(message(0.0, moved * START_TOLERANCE))
    if accepted:
        world.states.join(rest_from(start), start, 0.5)
    else:
        with pytest.raises(TrajectoryError, match="joint 'b'"):
            world.states.join(rest_from(start), start, 0.5)


def test_measured_start_is_refused_when_the_state_became_too_old(world: World) -> None:
    world.states.receive(message(0.0, 0.0))
    start = world.states.choose("measured", 0.5, 0.0)
    world.pass_time(0.6)
    with pytest.raises(GoalError, match="old"):
        world.states.join(rest_from(start), start, 0.5)
