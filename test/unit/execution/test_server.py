# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Goals, stops and replacements, judged by what a simulated controller commands after them.

Time is virtual; planning takes as long as the tests say.
"""

from __future__ import annotations

import gc
import threading
import weakref
from concurrent.futures import CancelledError
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest
from mp_pca_planner.execution.options import Serving
from mp_pca_planner.execution.serving import motion_server
from mp_pca_planner.execution.serving.assembly import assemble_model
from mp_pca_planner.execution.serving.execution import MotionOutcome
from mp_pca_planner.execution.serving.motion_monitor import MotionMonitor
from mp_pca_planner.execution.serving.motion_server import (
    AdaptedPlan,
    GoalRequest,
    GoalStatistics,
    MotionServer,
)
from mp_pca_planner.execution.threads import BusyError
from support.arm import JOINTS
from support.served_arm import GOAL, HALF, LIMITS, MODEL, START, URDF, WAIT, Node, model

from mp_pca_planner.exceptions import GoalError
from mp_pca_planner.motion.goal import JointGoal, JointState, Pose, PoseGoal, SequenceGoal
from mp_pca_planner.motion.trajectory import Trajectory


@pytest.fixture
def node():
    return Node()


# Goals


@pytest.mark.slow
def test_random_sequences_of_goals_and_stops_are_followed_without_a_jump(request):
    random = np.random.default_rng(3)
    low, high = np.minimum(START, GOAL), np.maximum(START, GOAL)
    n_moving = 0
    for seed in range(request.config.getoption("--planned-sequences")):
        node = Node(seed=seed, planning_time=(0.0, 0.1))
        for _ in range(random.integers(3, 6)):
            if random.random() < 0.15:
                node.stop()
            else:
                n_moving += bool(np.any(node.robot.record.v[-1]))
                node.ask(random.uniform(low, high))
            node.run(random.choice([0.0, random.uniform(0.0, 0.7), 3.0], p=[0.1, 0.7, 0.2]))
        node.run(5.0)
        node.ask(GOAL)
        node.run(5.0)
        node.assert_smooth()
        node.assert_rests_at(GOAL)
        assert set(node.statuses) <= {"served", "overtaken"}
        assert len(node.plan_reports) == node.n_goals
        assert len(node.outcomes) == node.statuses.count("served")
    assert n_moving > seed


def test_planned_motions_replace_each_other_without_a_jump(node):
    for positions in (GOAL, START, HALF, GOAL):
        node.ask(positions)
        node.run(0.4)
    node.run(5.0)
    assert node.statuses == ["served"] * 4
    assert node.outcomes == ["replaced"] * 3 + ["arrived"]
    node.assert_smooth()
    node.assert_rests_at(GOAL)


@pytest.mark.parametrize("goal", ["a sequence", "a stop"])
def test_displaced_motion_names_the_primitives_of_the_one_before_or_none(node, goal):
    node.ask_sequence(HALF, GOAL)
    node.run(0.3)
    if goal == "a stop":
        node.stop()
    commanded = node.follower.commanded.motion
    node.ask(commanded.end + 0.01)
    plan = node.monitor.served.plan
    assert isinstance(plan, AdaptedPlan)
    names = [primitive.name for primitive in MODEL.planner.primitives]
    assert plan.primitives == (() if goal == "a stop" else (names[0],) * 2)


def test_displaced_motion_keeps_its_primitives_when_the_library_is_replaced(node):
    node.ask(GOAL)
    old = list(MODEL.planner.primitives)
    node.run(0.4)
    renamed = replace(old[0], name="renamed")
    newer = assemble_model(URDF, [renamed], MODEL.settings)
    node._model = replace(newer, planner=node._slow(newer.planner, "plan"))
    node.ask(GOAL + 0.01)
    served = node.monitor.served
    assert isinstance(served.plan, AdaptedPlan)
    assert node.statuses == ["served"] * 2
    assert list(served.primitives) == old
    assert [one.name for one in served.primitives] == list(served.plan.primitives)


def test_of_the_planned_and_the_displaced_motion_the_one_of_less_effort_is_sent(node, monkeypatch):
    efforts, plan = {}, node._model.planner.plan

    def displaced(*request):
        found = usual(*request)
        efforts["displaced"] = np.inf if found is None else found[0].effort_cost
        return found

    def planned(*request):
        found = plan(*request)
        efforts["planned"] = found.trajectory.effort_cost if found.is_executable else np.inf
        return found

    usual = motion_server.displaced
    monkeypatch.setattr(motion_server, "displaced", displaced)
    node._model.planner.plan = planned
    node.ask(GOAL)
    kinds = set()
    for share in (0.0, 0.8, 0.3, 1.0, 0.1, 0.6):
        node.run(0.35)
        efforts.clear()
        node.ask(START + share * (GOAL - START))
        if len(efforts) == 2 and np.isfinite([*efforts.values()]).all():
            sent = node.monitor.served.plan
            assert sent.trajectory.effort_cost == min(efforts.values())
            kinds.add(type(sent))
    assert len(kinds) == 2


class Forbidden:
    """A constraint that no configuration keeps."""

    frame = "wrist"

    def values(self, robot, q):
        return -np.ones((len(q), 1)), np.zeros((len(q), 1, q.shape[1]))


def test_displaced_motion_keeps_the_constraints(node):
    node.ask(GOAL)
    node.run(0.4)
    node._model = replace(node._model, constraints=(Forbidden(),))
    node.ask(GOAL + 0.01)
    assert not isinstance(node.monitor.served.plan, AdaptedPlan)


@pytest.mark.parametrize("planning_time", [0.15, 0.6])
def test_planning_that_is_slower_than_expected_still_serves_a_moving_robot(node, planning_time):
    node.ask(GOAL)
    node.run(0.3)
    node._planning_time = planning_time, planning_time
    node.ask(START)
    node.run(5.0)
    assert node.statuses == ["served"] * 2
    node.assert_smooth()
    node.assert_rests_at(START)


def test_robot_may_be_simulated_faster_than_it_is_planned_for():
    node = Node(planning_time=(0.2, 0.2))
    node.monitor = MotionMonitor(node.follower, node._send, lambda: node.now / 20, node._report)
    node.server = MotionServer(node.monitor, GoalStatistics(), node.advance)
    for positions in (GOAL, START, GOAL):
        node.ask(positions)
        node.run(0.4)
    node.run(5.0)
    assert node.statuses == ["served"] * 3
    node.assert_smooth()


def test_motion_from_rest_is_stamped_and_waits_until_any_message_is_received(node):
    node.robot.faults.delay = 0.9 * WAIT
    node.ask(GOAL)
    ((time, trajectory, stamp, last_point_only),) = node.sent
    assert (stamp, last_point_only) == (time, False)
    q = trajectory.positions[trajectory.times <= WAIT + 1e-9]
    assert len(q) == 2 and (q == q[0]).all()
    node.run(5.0)
    node.assert_smooth()


def test_motion_that_continues_another_one_is_stamped_with_the_moment_it_was_joined_for(node):
    node.ask(GOAL)
    node.run(0.4)
    node.robot.faults.delay = 0.5 * WAIT
    node.ask(START)
    time, trajectory, stamp, _ = node.sent[-1]
    assert stamp == time
    tick = int(np.argmin(np.abs(node.robot.record.times - time)))
    np.testing.assert_allclose(trajectory.positions[0], node.robot.record.q[tick - 1], atol=5e-5)
    node.run(5.0)
    node.assert_smooth()


def test_no_motion_is_stamped_where_stamps_are_disabled():
    node = Node(model(stamp_trajectories=False))
    node.ask(GOAL)
    node.run(0.4)
    node.ask(START)
    assert [stamp for _, _, stamp, _ in node.sent] == [None, None]


def test_measured_serves_a_resting_robot_and_refuses_one_that_moves():
    node = Node(model(start_from="measured"))
    node.ask(GOAL)
    node.run(0.4)
    node.ask(START)
    assert node.statuses == ["served", "refused"]
    assert "start_from" in node.plan_reports[-1].message
    node.run(5.0)
    node.ask(START)
    node.run(5.0)
    assert node.statuses[-1] == "served"
    np.testing.assert_allclose(node.commanded, START, atol=1e-9)


def test_goal_where_the_robot_rests_publishes_nothing(node):
    node.ask(START)
    assert (node.statuses, node.sent) == (["under_way"], [])
    assert "already there" in node.plan_reports[-1].message


def test_goal_that_repeats_is_under_way_and_then_there_and_publishes_nothing(node):
    node.ask(GOAL)
    node.run(0.3)
    node.ask(GOAL)
    assert node.statuses == ["served", "under_way"]
    assert "arrives in" in node.plan_reports[-1].message
    node.run(3.0)
    node.ask(GOAL)
    node.ask(GOAL[:2], JOINTS[:2])
    assert node.statuses == ["served"] + ["under_way"] * 3
    assert len(node.sent) == 1
    assert node.outcomes == ["arrived"]


def test_motion_that_is_published_while_the_robot_is_watched_is_not_taken_for_another(node):
    node.ask(GOAL)
    node.run(0.3)
    command, watchers = node.follower.command, []

    def watch():
        with suppress(BusyError):  # it does not wait until the motion is published
            node.monitor.watch(MODEL)

    def watched(*motion):
        command(*motion)
        watchers.append(threading.Thread(target=watch))
        watchers[-1].start()
        watchers[-1].join(0.2)

    node.follower.command = watched
    node.ask(START)
    node.stop()
    assert len(watchers) == 2
    for watcher in watchers:
        watcher.join()
    node.run(5.0)
    assert node.outcomes == ["replaced", "stopped"]


def test_goal_is_served_again_after_a_stop(node):
    node.ask(GOAL)
    node.run(0.3)
    node.stop()
    node.run(2.0)
    node.ask(GOAL)
    node.run(4.0)
    assert node.statuses == ["served", "served"]
    assert node.outcomes == ["stopped", "arrived"]
    node.assert_rests_at(GOAL)


def test_pose_leads_a_moving_robot_to_a_configuration_that_reaches_it(node):
    hand = MODEL.end_effector
    there = MODEL.robot.frame_positions(HALF[None], [hand])[0, 0]
    node.ask(GOAL)
    node.run(0.3)
    node.goal(PoseGoal(Pose(hand, there)), 2)
    node.run(5.0)
    assert node.statuses == ["served"] * 2
    reached = MODEL.robot.frame_positions(node.commanded[None], [hand])[0, 0]
    np.testing.assert_allclose(reached, there, atol=1e-3)
    node.assert_smooth()


def test_joints_that_goals_leave_out_keep_their_commanded_position_under_a_load(node):
    node.ask(HALF)
    node.run(4.0)
    node.robot.faults.payload = 1.0
    node.run(1.0)
    assert np.abs(node.robot.measured_state()[0] - HALF).max() > 1e-3
    for k in range(6):
        node.ask([HALF[0] + 0.1 * (-1) ** k], JOINTS[:1])
        node.run(3.0)
    assert node.statuses == ["served"] * 7
    np.testing.assert_array_equal(node.commanded[1:], HALF[1:])
    node.assert_smooth()


def test_second_goal_waits_until_it_is_seen_that_the_first_was_taken(node):
    node.ask(GOAL)
    node.run(0.3)
    node.ask(START)
    node.ask(HALF)
    second, third = (time for time, *_ in node.sent[1:])
    assert third - second > 0.05
    node.run(5.0)
    node.assert_smooth()
    node.assert_rests_at(HALF)


def test_motion_whose_message_is_lost_is_reported_and_the_next_goal_served(node):
    node.ask(GOAL)
    node.run(0.3)
    node.robot.faults.drop = 1.0
    node.ask(START)
    node.robot.faults.drop = 0.0
    node.run(5.0)
    assert node.outcomes[:2] == ["replaced", "never_started"]
    node.ask(START)
    node.run(5.0)
    assert node.outcomes[2:] == ["arrived"]
    np.testing.assert_allclose(node.commanded, START, atol=1e-9)


def test_motion_that_the_controller_rejects_leaves_the_robot_on_the_one_before(node):
    node.ask(GOAL)
    node.run(0.4)
    old = node.follower.commanded.motion
    node.robot.faults.drop = 1.0
    node.ask(START)
    node.robot.faults.drop = 0.0
    node.monitor.hear(node.sent[-1][1], "rejected the goal", MotionOutcome.NEVER_STARTED)
    assert node.outcomes == ["replaced", "never_started"]
    assert node.follower.commanded.motion is old
    began = node.now
    node.ask(HALF)
    assert node.sent[-1][0] - began < 0.04  # at once, because nothing has to be seen
    node.run(5.0)
    assert node.verdict().is_clean
    node.assert_rests_at(HALF)


@pytest.mark.parametrize("growth", [1.2, 1.9])
def test_planning_that_gets_slower_is_planned_for_in_the_next_attempt(node, growth):
    node.ask(GOAL, duration=5.0)
    node.run(0.3)
    plan, attempts = node._model.planner.plan, []

    def slow(*request):
        attempts.append(0.15 * growth ** len(attempts))
        node.advance(attempts[-1])
        return plan(*request)

    node._model.planner.plan = slow
    node.ask_sequence(HALF, START)
    assert node.statuses[-1] == "served"
    assert len(attempts) == 2


def test_cancelled_goal_publishes_nothing(node):
    goal = JointGoal(JointState(JOINTS, GOAL))
    with pytest.raises(CancelledError):
        node.server.serve(GoalRequest(goal, MODEL), lambda: True)
    assert not node.sent


@pytest.mark.parametrize(
    "goal",
    [
        JointGoal(JointState(JOINTS, GOAL)),
        SequenceGoal((JointState(JOINTS, GOAL), JointState(JOINTS, START))),
    ],
)
def test_goal_that_is_cancelled_during_the_solve_ends_it(node, goal):
    asked = iter([False] * 3)
    with pytest.raises(CancelledError):
        node.server.serve(GoalRequest(goal, MODEL), lambda: next(asked, True))
    assert next(asked, None) is None
    assert not node.sent


def test_model_that_served_a_goal_is_freed_with_its_last_name(node):
    """Left to a search for garbage, models stopped all threads for up to 20 ms."""

    def serve():
        own = GoalRequest(JointGoal(JointState(JOINTS, GOAL)), model())
        node.server.serve(own, lambda: own.name is node)
        return weakref.ref(own.model)

    gc.disable()
    try:
        served = serve()
        node.ask(START)
        node.run(5.0)
        assert served() is None
    finally:
        gc.enable()


def test_refused_goal_leaves_the_running_motion_alone(node):
    node.ask(GOAL)
    node.run(0.2)
    node.ask(GOAL + 100.0)
    assert node.statuses == ["served", "refused"]
    assert "outside its limits" in node.plan_reports[-1].message
    node.run(5.0)
    node.assert_rests_at(GOAL)
    assert node.outcomes == ["arrived"]


@pytest.mark.parametrize("wait", [0.0, 0.4])
def test_goal_above_the_largest_in_span_score_is_rejected_in_motion_as_at_rest(wait):
    ends = JointState(JOINTS, GOAL), JointState(JOINTS, START)
    usual = MODEL.planner.plan(*ends).in_span_score
    node = Node(model(max_in_span_score=usual + 1.0))
    if wait:
        node.ask(GOAL)
        node.run(wait)
    node.ask(GOAL + np.array([0.0, 0.9, -0.6, 0.0]))
    node.run(3.0)
    assert node.statuses[-1] == "refused"
    assert "in-span score is" in node.plan_reports[-1].message
    node.assert_rests_at(GOAL if wait else START)
    node.assert_smooth()


@pytest.mark.parametrize("event", ["other joints", "release"])
def test_motion_that_is_no_longer_monitored_is_stopped(node, event):
    node.ask(GOAL)
    node.run(0.3)
    if event == "release":
        node.monitor.release(node.model, "it is deactivated")
    else:
        assert node.monitor.expect(JOINTS[:2], node.model)
    n_sent = len(node.sent)
    assert n_sent == 2
    for _ in range(1500):
        node.robot.step()
    node.assert_smooth()
    assert not node.robot.record.v[-1].any()
    assert np.abs(node.commanded - GOAL).max() > 0.1
    node.monitor.release(node.model, "it is stopped already")
    assert len(node.sent) == n_sent


@pytest.mark.slow
@pytest.mark.parametrize("scaling", [0.3, 0.1])
def test_slow_motion_under_speed_scaling_is_not_taken_for_rest(node, scaling):
    node.robot.faults.speed_scaling = scaling
    node.run(0.5)
    node.ask(GOAL, duration=20.0)
    node.run(0.7 * 20.0 / scaling)
    assert node.outcomes == []


@pytest.mark.parametrize("wait", [0.03, 0.5])
def test_stop_that_is_lost_is_sent_again(node, wait):
    node.ask(GOAL, duration=4.0)
    node.run(0.8)
    node.ask(HALF, duration=4.0)
    node.run(wait)  # it is known, or not, that the second motion was taken
    node.robot.faults.drop = 1.0
    node.stop()
    node.robot.faults.drop = 0.0
    node.run(2.0)
    assert not node.robot.record.v[-1].any()
    assert np.abs(node.commanded - HALF).max() > 0.05


def test_robot_that_arrived_is_not_stopped_again(node):
    node.ask(GOAL)
    node.run(5.0)
    node.monitor.release(node.model, "it is deactivated")
    assert len(node.sent) == 1


@pytest.mark.parametrize(("change", "reason"), [("joints", "joints"), ("clock", "set back")])
def test_motion_that_can_no_longer_be_followed_is_reported(node, monkeypatch, change, reason):
    node.ask(GOAL)
    node.run(0.2)
    if change == "joints":
        node.monitor.expect(JOINTS)  # the same ones
        node.run(0.1)
        assert not node.outcomes
        node.monitor.expect(JOINTS[:2])
        assert node.monitor.served is None
    else:
        monkeypatch.setattr(node.follower.measured.clock, "now", lambda: node.now - 100.0)
    node.run(0.2)
    ((_, report),) = node.execution_reports
    assert report.outcome == "not_followed" and reason in report.message


@pytest.mark.parametrize("event", ["none", "stop", "goal"])
def test_robot_that_rests_slightly_outside_its_limits_is_led_inwards(event):
    sign = np.sign(GOAL - START)
    limit = START + 5e-4 * sign
    sides = ["min_position" if inwards > 0.0 else "max_position" for inwards in sign]
    bounds = zip(JOINTS, sides, limit, strict=True)
    node = Node(model(limits={name: {**LIMITS[name], side: x} for name, side, x in bounds}))
    began = len(node.robot.record.q)
    node.ask(GOAL)
    assert node.statuses == ["served"]
    node.run(0.05)  # the first joints are still outside
    if event == "stop":
        node.stop()
        node.run(2.0)
    if event != "none":
        node.ask(0.7 * GOAL + 0.3 * START)
        node.run(3.0)
        node.ask(GOAL)
    node.run(5.0)
    node.assert_rests_at(GOAL)
    assert set(node.statuses) == {"served"}
    within = sign * (node.robot.record.q[began:] - limit)
    assert within[0].max() < 0.0  # all joints begin outside
    assert within.min() >= -5.0001e-4
    # For a stop at a point, the controller starts from the measured state.
    error = 2e-4 if event == "stop" else 1e-5
    assert np.all(within >= np.minimum(np.maximum.accumulate(within), 0.0) - error)
    jumps = np.abs(np.diff(node.robot.record.q[began:], axis=0))
    assert jumps.max() < 3.1e-3  # of the largest velocity


# Sequences


def test_sequence_passes_its_vias_without_a_stop_or_a_jump(node):
    via = START + 0.6 * (GOAL - START)
    node.ask_sequence(via, GOAL, START, times=(None, 2.0, None))
    began = node.sent[0][0] + WAIT
    node.run(10.0)
    node.assert_smooth()
    record = node.robot.record
    passed = int(np.abs(record.q - via).max(axis=1).argmin())
    # As near as commands are to each other.
    assert np.abs(record.q[passed] - via).max() < 3e-3
    assert np.abs(record.v[passed]).max() > 0.1
    near = np.abs(record.times - began - 2.0) < 3.5e-3
    assert np.abs(record.q[near] - GOAL).max(axis=1).min() < 3e-3
    node.assert_rests_at(START)


def test_sequence_takes_a_moving_robot_over_though_single_goals_were_faster(node):
    node.ask(GOAL)
    node.run(0.3)
    node._planning_time = 0.3, 0.3
    node.ask_sequence(HALF, START)
    node.run(8.0)
    assert node.statuses == ["served", "served"]
    node.assert_smooth()
    node.assert_rests_at(START)


def test_sequence_that_breaks_limits_is_not_published(node):
    node.ask_sequence(GOAL, START, times=(0.05, 0.1))
    assert node.statuses == ["refused"]
    assert "no motion within the limits was found" in node.plan_reports[0].message
    assert not node.sent


# Stops


def test_stop_follows_the_path_and_ends_at_rest_within_the_limits(node):
    node.ask(GOAL)
    node.run(0.4)
    path = node.sent[0][1].positions
    assert "comes to rest on its path" in node.stop()
    node.run(3.0)
    node.assert_smooth()
    assert not node.robot.record.v[-1].any()
    for q in node.robot.record.q[-3000::20]:
        assert np.abs(path - q).max(axis=1).min() < 0.02
    assert np.abs(node.commanded - GOAL).max() > 0.05
    assert node.outcomes == ["stopped"]


@pytest.mark.parametrize("after", [0.0, 3.0])
def test_stop_of_a_robot_at_rest_stays_where_it_is(node, after):
    if after:
        node.ask(START)
        node.run(after)
    assert "at rest" in node.stop()
    _, trajectory, stamp, last_point_only = node.sent[-1]
    assert (stamp, last_point_only, trajectory.positions.tolist()) == (None, True, [START.tolist()])


def test_motion_is_ended_where_no_stop_keeps_the_limits(node):
    node.ask(GOAL)
    node.run(0.4)
    tight = MODEL.robot.limits({name: {"max_acceleration": 1e-6} for name in JOINTS})
    node.monitor.stop(replace(MODEL, limits=tight))
    node.run(3.0)
    node.assert_smooth()
    node.assert_rests_at(GOAL)


@pytest.mark.parametrize("silence", [0.6, 1.0])
def test_stop_of_a_robot_that_is_not_heard_of_keeps_the_limits_and_says_what_is_not_known(silence):
    node = Node()
    node.ask(GOAL, duration=3.0)
    node.run(0.4)
    node.robot.faults.silent = True
    node.run(silence)
    said = node.stop()
    assert "not known whether the robot stops" in said and "old" in said
    assert node.sent[-1][-1]
    node.run(4.0)
    # The controller leads to a single point from the measured state.
    node.assert_smooth([tick for tick, n_points in node.robot.taken if n_points == 1])
    assert not node.robot.record.v[-1].any()
    assert np.abs(node.commanded - GOAL).max() > 0.05


@pytest.mark.parametrize("away", [0.003, 0.011])
def test_goal_after_stops_starts_where_the_robot_rests_beside_their_point(node, away):
    node.ask(GOAL, duration=3.0)
    node.run(0.4)
    node.robot.faults.silent = True
    node.run(0.6)
    node.stop()
    node.robot.faults.silent = False
    node.run(0.2)
    # Something else ends the stop, and the next one is lost.
    stop = node.sent[-1][1]
    q, zero = stop.positions[[0, -1]] + away * np.array([0, 1, -1, 0]), np.zeros((2, 4))
    node.robot.send(Trajectory(JOINTS, [0.0, 0.5], q, zero, zero), last_point_only=True)
    node.run(4.0)
    node.robot.faults.drop = 1.0
    node.stop()
    node.run(0.5)
    node.robot.faults.drop, held = 0.0, node.commanded
    node.ask(START)
    node.run(0.1)
    np.testing.assert_allclose(node.sent[-1][1].positions[0], held, atol=1e-6)


def interrupt_stops(node, monkeypatch, n_interruptions):
    """The stops that are found from now on; a busy computer interrupts the first of them."""
    find, found = node.monitor._stops._find, []

    def interrupted(model, latency):
        found.append(find(model, latency))
        if len(found) <= n_interruptions:
            node.advance(0.15)
        return found[-1]

    monkeypatch.setattr(node.monitor._stops, "_find", interrupted)
    return found


@pytest.mark.parametrize("n_interruptions", [1, 100])
def test_stop_that_took_long_to_find_is_found_again_a_few_times(node, monkeypatch, n_interruptions):
    node.ask(GOAL, duration=3.0)
    node.run(0.4)
    node.robot.faults.silent = True
    node.run(0.6)
    found = interrupt_stops(node, monkeypatch, n_interruptions)
    monkeypatch.setattr(node.monitor, "watch", lambda _: None)
    node.stop()
    assert len(found) == min(n_interruptions + 1, Serving.max_attempts)
    _, motion, _ = found[-1]
    assert node.sent[-1][1] is motion.sent


@pytest.mark.parametrize("silent", [False, True])
def test_stop_of_a_resting_robot_is_found_once_however_long_that_takes(node, monkeypatch, silent):
    node.ask(GOAL)
    node.run(6.0)
    node.robot.faults.silent = silent
    node.run(1.0)
    found = interrupt_stops(node, monkeypatch, 1)
    node.stop()
    assert len(found) == 1


@pytest.mark.parametrize(("moves", "most"), [(False, 1), (True, 3)])
def test_stop_polls_the_joint_states_seldom(node, monkeypatch, moves, most):
    """Each poll takes a millisecond of the answer: there were up to seven."""
    if moves:
        node.ask(GOAL)
        node.run(0.4)
    polled = []
    monkeypatch.setattr(node.monitor.follower.measured, "_fetch", lambda: polled.append(1))
    node.stop()
    assert len(polled) <= most


def test_stop_at_rest_is_found_once_however_long_that_takes(node, monkeypatch):
    find, found = node.monitor._stops._find, []

    def interrupted(model, latency):
        node.advance(0.15)
        found.append(find(model, latency))
        return found[-1]

    monkeypatch.setattr(node.monitor._stops, "_find", interrupted)
    assert "at rest" in node.stop()
    assert len(found) == 1


def test_stop_of_a_robot_that_was_never_heard_of_is_refused(node):
    node.robot.faults.silent = True
    node.restart()
    assert node.stop().startswith("nothing was published: the present state is not known")
    with pytest.raises(GoalError, match="joint_states"):
        node.monitor.stop(MODEL)
    assert not node.sent


def test_stop_of_an_unknown_motion_is_allowed_from_where_the_robot_may_have_got_to(
    node, monkeypatch
):
    node.robot.faults.silent = True
    node.run(0.1)
    stops, measured, v = node.monitor._stops, node.follower.measured.newest(1.0), np.full(4, 0.5)
    since = node.follower.motion_time - node.follower.measured.newest_time
    assert since > 0.05
    monkeypatch.setattr(stops, "_stop_at_point", lambda states, *_: states)
    states = stops._stop_unknown(measured, v, node.model)
    farthest = max(states, key=lambda state: state.positions[0])
    np.testing.assert_allclose(farthest.positions, measured.positions + v * since)
    np.testing.assert_array_equal(farthest.velocities, v)
