# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The simulated trajectory controller, against closed forms and the original's own rules."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.polynomial import Polynomial

from mp_pca_planner.motion.trajectory import Trajectory
from mp_pca_planner.simulation.controller import (
    RESULT_CODES,
    TrajectoryController,
    TrajectoryMessage,
    TrajectoryPoint,
    to_message,
)

NAMES = ("shoulder", "elbow")
NOW, MS = 1_000_000_000_000, 1_000_000
S = 1000 * MS
START = np.array([0.2, -0.1])
ASTRAY = np.array([0.35, -0.1])


class Loop:
    """A controller whose robot is wherever it is put."""

    def __init__(self, continuous=None):
        self.controller = TrajectoryController(NAMES, START, continuous)
        self.now = NOW
        self.measured = (START.copy(), np.zeros(2))

    def send(self, *points, stamp=0, names=NAMES, goal=None):
        message = TrajectoryMessage(names, points, stamp)
        return self.controller.receive(message, self.now, goal)

    @property
    def results(self):
        """The goals that have ended, each with its outcome and the code of that."""
        ended = self.controller.results
        return [(goal, outcome, RESULT_CODES[outcome]) for goal, outcome, _ in ended]

    def cycle(self, n=1, period=MS):
        """Run cycles; the last command as rows q, v, a."""
        for _ in range(n):
            self.now += period
            command = self.controller.update(self.now, period, self.measured)
        return command.reshape(3, 2)


def solved(t0, state0, t1, state1):
    """The polynomial with given values and derivatives at two times, by its linear equations."""
    n = 2 * len(state0)
    rows, right = [], []
    for t, state in ((t0, state0), (t1, state1)):
        for d, value in enumerate(state):
            powers = [Polynomial.basis(p).deriv(d)(t) if d else t**p for p in range(n)]
            rows.append(powers)
            right.append(value)
    return Polynomial(np.linalg.solve(rows, right))


def moving(time, q, v=None, a=None):
    return TrajectoryPoint(int(time * S), *(() if x is None else x for x in (q, v, a)))


A = ([0.2, -0.1], [0.3, -0.2], [1.0, 0.5])
B = ([0.9, 0.4], [0.0, 0.0], [-0.7, 0.2])


@pytest.mark.parametrize("n_given", [1, 2, 3], ids=["linear", "cubic", "quintic"])
def test_degree_of_the_spline_is_that_of_what_is_given(n_given):
    loop = Loop()
    assert loop.send(moving(0.0, *A[:n_given]), moving(0.5, *B[:n_given])) is None
    first = loop.now + MS
    for _ in range(520):
        command = loop.cycle()
        # What is commanded is due at the next cycle.
        t = min((loop.now + MS - first) / S, 0.5)
        for j in range(2):
            curve = solved(0.0, [x[j] for x in A[:n_given]], 0.5, [x[j] for x in B[:n_given]])
            q, v, a = (curve.deriv(d)(t) if d else curve(t) for d in range(3))
            if t == 0.5:  # the last point is held as it was sent
                v, a = 0.0, B[2][j] if n_given == 3 else 0.0
            np.testing.assert_allclose(command[:, j], [q, v, a], atol=1e-9)


def test_first_point_that_lies_ahead_is_approached_from_the_measured_state():
    loop = Loop()
    loop.measured = (START + 0.01, np.array([0.5, 0.0]))
    loop.send(moving(0.4, *B))
    curve = solved(0.0, (START[0] + 0.01, 0.5, 0.0), 0.4, [x[0] for x in B])
    command = loop.cycle()
    expected = [curve(1e-3), curve.deriv()(1e-3), curve.deriv(2)(1e-3)]
    np.testing.assert_allclose(command[:, 0], expected, atol=1e-9)


@pytest.mark.parametrize("goal", [0.3, 0.1])
def test_continuous_joints_take_the_shorter_direction(goal):
    loop = Loop(continuous=np.array([True, False]))
    loop.measured = (np.array([0.2 + 4 * np.pi, -0.1]), np.zeros(2))
    loop.send(moving(0.5, [goal, 0.0]))
    np.testing.assert_allclose(loop.cycle(250)[0], [(0.2 + goal) / 2.0, -0.05], atol=1e-3)


def test_stamp_in_the_past_enters_the_trajectory_where_it_is_by_now():
    loop = Loop()
    start = loop.now + MS - 200 * MS
    assert loop.send(moving(0.0, *A[:2]), moving(0.5, *B[:2]), stamp=start) is None
    curve = solved(0.0, (A[0][0], A[1][0]), 0.5, (B[0][0], B[1][0]))
    assert loop.cycle()[0, 0] == pytest.approx(curve(0.201), abs=1e-9)


def test_new_message_replaces_the_running_one_in_the_next_cycle():
    loop = Loop()
    loop.send(moving(0.0, *A[:2]), moving(0.5, *B[:2]))
    loop.cycle(250)
    loop.send(moving(0.0, [0.5, 0.5]), moving(0.5, [0.7, 0.5]))
    # The newest of those that wait is taken.
    loop.send(moving(0.0, [0.6, 0.5]), moving(0.5, [0.8, 0.5]))
    assert loop.cycle()[0, 0] == pytest.approx(0.6 + 0.2 * 1e-3 / 0.5, abs=1e-12)
    np.testing.assert_array_equal(loop.cycle(1000), [[0.8, 0.5], [0, 0], [0, 0]])


@pytest.mark.parametrize("scaling", [0.5, 0.0])
def test_speed_scaling_slows_the_clock_of_the_trajectory(scaling):
    loop = Loop()
    loop.send(moving(0.0, [0.0, 0.0]), moving(1.0, [1.0, -1.0]))
    loop.cycle()
    clock = loop.controller.clock_ns
    loop.controller.speed_scaling = scaling
    assert loop.cycle(500)[0, 0] == pytest.approx(1e-3 + 0.5 * scaling, abs=1e-12)
    assert loop.controller.clock_ns - clock == pytest.approx(500 * MS * scaling)


def test_controller_that_is_not_active_holds_its_command_and_rejects():
    loop = Loop()
    loop.send(moving(0.0, *A[:1]), moving(1.0, *B[:1]))
    last = loop.cycle(500)[0]
    loop.controller.deactivate()
    assert "not active" in loop.send(moving(0.0, [1.0, 1.0]))
    np.testing.assert_array_equal(loop.cycle(100), [last, [0, 0], [0, 0]])
    loop.controller.activate()
    np.testing.assert_array_equal(loop.cycle(100)[0], last)
    assert loop.send(moving(0.0, [1.0, 1.0])) is None


def test_message_of_a_trajectory_in_any_order_of_joints_starts_at_its_stamp():
    t, zero = [0.0, 0.5], np.zeros((2, 2))
    trajectory = Trajectory(NAMES[::-1], t, [[-0.1, 0.2], [0.4, 0.9]], zero, zero)
    message, loop = to_message(trajectory, stamp=(NOW + MS + 100 * MS) / S), Loop()
    assert loop.controller.receive(message, loop.now) is None
    np.testing.assert_allclose(loop.cycle(99)[0], START, atol=1e-9)
    half = solved(0.0, (0.2, 0.0, 0.0), 0.5, (0.9, 0.0, 0.0))(0.25)
    assert loop.cycle(251)[0, 0] == pytest.approx(half, abs=1e-9)
    np.testing.assert_allclose(loop.cycle(300)[0], [0.9, 0.4])
    (last,) = to_message(trajectory, last_point_only=True).points
    assert (last.time_from_start_ns, last.positions) == (S // 2, [0.4, 0.9])


GOOD = (moving(0.0, *A), moving(0.5, *B))


@pytest.mark.parametrize(
    ("points", "names", "stamp", "reason"),
    [
        ((), NAMES, 0, "no points"),
        (GOOD, ("shoulder", "wrist"), 0, "'wrist'"),
        (GOOD, ("elbow", "elbow"), 0, "'elbow' given more than once"),
        ((moving(0.0, A[0], [1.2e-7, 0.0]),), NAMES, 0, "moves joint 'shoulder' at 1.2e-07"),
        (GOOD, NAMES, NOW - S, "ended 0.5 s before"),
        (GOOD[::-1] + GOOD[1:], NAMES, 0, "points 0 and 1 are 500000000 and 0"),
        ((moving(0.0, [0.1]),), NAMES, 0, "1 positions for 2 joints"),
        ((TrajectoryPoint(0, A[0], effort=(1.0, 1.0)),), NAMES, 0, "no effort interface"),
    ],
)
def test_message_is_rejected_with_the_reason_and_changes_nothing(points, names, stamp, reason):
    loop = Loop()
    assert reason in loop.send(*points, names=names, stamp=stamp)
    np.testing.assert_array_equal(loop.cycle(100), [START, [0, 0], [0, 0]])


def test_reference_is_the_command_of_the_cycle_before_with_its_time_on_the_trajectory():
    loop = Loop()
    loop.send(moving(0.0, *A), moving(0.5, *B))
    last = loop.cycle(100)
    _, since_ns = loop.controller.stated()
    assert since_ns == 99 * MS
    loop.cycle()
    reference, _ = loop.controller.stated()
    assert np.allclose(reference, last)
    loop.controller.speed_scaling = 0.5
    loop.cycle(10)
    _, since_ns = loop.controller.stated()
    assert since_ns == 105 * MS
    assert loop.controller.speed_scaling == 0.5


def test_goal_of_the_action_ends_once_by_its_end_its_successor_or_its_cancellation():
    end = moving(0.1, START, [0.0, 0.0], [0.0, 0.0])
    loop = Loop()
    assert loop.send(end, goal="reached") is None
    loop.cycle(98)
    assert loop.results == []
    loop.cycle(5)
    assert loop.results == [("reached", "succeeded", 0)]
    loop.send(end, goal="replaced")
    loop.cycle()
    loop.send(end, goal="cancelled")
    assert loop.results[1:] == [("replaced", "aborted", -1)]
    # A message by topic moves the robot, and leaves the goal as it is.
    loop.send(end)
    loop.cycle()
    assert not loop.controller.cancel("replaced")
    loop.measured = (ASTRAY, np.zeros(2))
    loop.cycle()
    assert loop.controller.cancel("cancelled")
    assert np.array_equal(loop.cycle()[0], ASTRAY)
    assert loop.results[2:] == [("cancelled", "canceled", 0)]
    loop.send(moving(0.1, START), names=NAMES[:1], goal="rejected")
    assert loop.results[3:] == [("rejected", "aborted", -1)]
    loop.send(end, goal="interrupted")
    loop.controller.deactivate()
    assert loop.results[4:] == [("interrupted", "aborted", -1)]
