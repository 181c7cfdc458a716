# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Goals, stops and replacements, judged by what a simulated controller commands after them.

Time is virtual; planning takes as long as the tests say.
"""

from __future__ import annotations

import numpy as np
import pytest
from support.arm import GRIPPER_URDF, JOINTS, URDF, arm_primitive
from support.served_arm import GOAL, HALF, LIMITS, MODEL, START, WAIT, Node, model

from mp_pca_planner.execution.link import WorkerDied
from mp_pca_planner.execution.outcomes import MotionOutcome
from mp_pca_planner.execution.parameters import Settings
from mp_pca_planner.execution.planning import assemble_model
from mp_pca_planner.execution.server import GoalStatistics, NodeModel
from mp_pca_planner.motion.goal import JointGoal, Pose, PoseGoal, SequenceGoal


@pytest.fixture
def node():
    return Node()


@pytest.fixture(params=[False, True], ids=["seen", "stated"])
def either(request):
    """A node that sees its robot, and one whose controller states its command, too."""
    node = Node()
    node.has_controller_state = request.param
    return node


LARGEST = 2e-4  # jump that remains where a controller does not state its speed [rad]


def reasons(node):
    return [report.message for report in node.plan_reports]


# Goals


@pytest.mark.parametrize(
    ("has_velocities", "is_split", "may_stamp", "planning_time"),
    [(True, False, True, 0.01), (False, True, True, 0.15), (True, False, False, 0.01)],
)
def test_planned_motions_replace_each_other_without_a_jump(
    either, has_velocities, is_split, may_stamp, planning_time
):
    """Slower planning than expected serves a moving robot, too."""
    either.has_velocities, either.is_split = has_velocities, is_split
    either.use(model(stamp_trajectories=may_stamp))
    either.ask(GOAL)
    either.run(0.4)
    either._planning_time = planning_time, planning_time
    for positions in (START, HALF, GOAL):
        either.ask(positions)
        either.run(0.4)
    either.run(5.0)
    assert either.statuses == ["served"] * 4
    assert either.outcomes == ["replaced"] * 3 + ["arrived"]
    assert all((stamp is None) != may_stamp for _, _, stamp, _ in either.sent)
    either.assert_smooth()
    either.assert_rests_at(GOAL)


def test_goal_whose_planning_is_late_three_times_is_refused(node):
    node.ask(GOAL, duration=30.0)
    node.run(0.3)
    times = iter([0.5, 2.0, 8.0, 99.0])
    node.draw_planning_time = lambda: next(times)
    node.ask(START)
    node.run(12.0)
    assert node.statuses == ["served", "refused"]
    assert reasons(node)[-1].startswith("planning took too long")
    assert next(times) == 99.0


def test_motion_from_rest_is_stamped_and_waits_until_any_message_is_received(node):
    node.robot.faults.delay = 0.9 * WAIT
    node.ask(GOAL)
    node.run(5.0)
    ((time, trajectory, stamp, last_point_only),) = node.sent
    assert (stamp, last_point_only) == (time, False)
    q = trajectory.positions[trajectory.times <= WAIT + 1e-9]
    assert len(q) == 2 and (q == q[0]).all()
    node.assert_smooth()


def test_motion_that_continues_another_one_is_stamped_with_the_moment_it_was_joined_for(either):
    either.ask(GOAL)
    either.run(0.4)
    either.robot.faults.delay = 0.5 * WAIT
    either.ask(START)
    either.run(5.0)
    time, trajectory, stamp, _ = either.sent[-1]
    assert stamp == pytest.approx(time, abs=3e-4)
    tick = int(np.argmin(np.abs(either.robot.record.times - stamp)))
    np.testing.assert_allclose(trajectory.positions[0], either.robot.record.q[tick - 1], atol=1e-3)
    either.assert_smooth()


def test_goal_that_repeats_is_under_way_and_then_there_and_publishes_nothing(either):
    either.ask(GOAL)
    either.run(0.3)
    either.ask(GOAL)
    assert either.statuses == ["served", "under_way"]
    assert "arrives in" in reasons(either)[-1]
    either.run(3.0)
    either.ask(GOAL)
    assert reasons(either)[-1].startswith("the robot is at the goal")
    either.ask(GOAL[:2], JOINTS[:2])
    either.run(0.1)
    assert either.statuses == ["served"] + ["under_way"] * 3
    assert reasons(either)[-1].startswith("already there")
    assert len(either.sent) == 1
    assert either.outcomes == ["arrived"]


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


def test_joints_that_goals_leave_out_keep_their_commanded_position_under_a_load(either):
    either.ask(HALF)
    either.run(4.0)
    either.robot.faults.payload = 1.0
    either.run(1.0)
    assert np.abs(either.robot.measured_state()[0] - HALF).max() > 1e-3
    for k in range(6):
        either.ask([HALF[0] + 0.1 * (-1) ** k], JOINTS[:1])
        either.run(3.0)
    assert either.statuses == ["served"] * 7
    np.testing.assert_array_equal(either.commanded[1:], HALF[1:])
    either.assert_smooth()


def test_robot_that_rests_slightly_outside_its_limits_is_led_inwards():
    sign = np.sign(GOAL - START)
    limit = START + 5e-4 * sign
    sides = ["min_position" if inwards > 0.0 else "max_position" for inwards in sign]
    bounds = zip(JOINTS, sides, limit, strict=True)
    node = Node(model(limits={name: {**LIMITS[name], side: x} for name, side, x in bounds}))
    began = len(node.robot.record.q)
    node.ask(GOAL)
    node.run(0.06)  # the first joints are still outside
    node.stop()
    node.run(2.0)
    node.ask(GOAL)
    node.run(5.0)
    node.assert_rests_at(GOAL)
    assert set(node.statuses) == {"served"}
    within = sign * (node.robot.record.q[began:] - limit)
    assert within[0].max() < 0.0  # all joints begin outside
    assert np.all(within >= np.minimum(np.maximum.accumulate(within), 0.0) - 1e-5)
    jumps = np.abs(np.diff(node.robot.record.q[began:], axis=0))
    assert jumps.max() < 3.1e-3  # of the largest velocity


# Goals that come faster than they are served


def test_flood_of_goals_does_not_keep_all_from_being_served(node):
    """At least every second goal that is begun is finished, and the newest one is reached."""
    node._planning_time, random = (0.03, 0.03), np.random.default_rng(1)
    for _ in range(200):
        node.ask(START + random.uniform(size=4) * (GOAL - START))
        node.run(0.004)
    node.ask(HALF)
    node.run(5.0)
    counts = {status: node.statuses.count(status) for status in set(node.statuses)}
    assert counts.keys() == {"served", "overtaken"}
    assert sum(counts.values()) == 201
    # A goal is cancelled after 5 ms, and the next one takes 30 ms.
    assert counts["served"] >= 0.9 * 1.0 / 0.035
    node.assert_smooth()
    node.assert_rests_at(HALF)


def test_newer_goal_preempts_the_one_that_is_planned_and_a_stop_both(node):
    node._planning_time = 1.0, 1.0
    node.ask(GOAL)
    node.run(0.5)
    node.ask(START)
    node.run(0.5)
    assert node.statuses == ["overtaken"]
    node.ask(HALF)
    node.stop()
    node.run(3.0)
    assert node.statuses == ["overtaken"] * 3
    assert all(text.startswith("preempted") for text in reasons(node))
    assert node.server.is_idle
    node.assert_rests_at(START)


@pytest.mark.parametrize("is_stated", [False, True])
@pytest.mark.parametrize("kind", ["drifting", "alternating"])
def test_stream_at_20_hz_is_served(kind, is_stated):
    node = Node(planning_time=(0.005, 0.03))
    node.has_controller_state = is_stated
    for k in range(200):
        share = 0.5 + 0.5 * np.sin(0.1 * k) if kind == "drifting" else k // 20 % 2
        node.ask(START + share * (GOAL - START))
        node.run(0.049)
    node.run(0.5)
    n_good = sum(status in ("served", "under_way") for status in node.statuses)
    assert n_good >= 0.95 * 200
    node.assert_smooth()


# Set-up


def test_goal_without_a_robot_or_whose_set_up_changes_is_refused_with_the_reason(node):
    node.server.use(None, tuple(JOINTS))
    node.ask(GOAL)
    node.use(MODEL)
    node.server.hold = "the primitives are being read"
    node.ask(GOAL)
    node.server.hold = ""
    node.ask(GOAL)
    node.use(MODEL)
    node.run(1.0)
    assert node.statuses == ["refused"] * 3 and not node.sent
    assert reasons(node)[:2] == [
        "the robot model is not known yet",
        "the primitives are being read",
    ]
    assert "changed during planning; send the goal again" in reasons(node)[2]


@pytest.mark.parametrize("event", ["other joints", "release"])
def test_motion_that_is_no_longer_monitored_is_stopped(node, event):
    node.ask(GOAL)
    node.run(0.3)
    if event == "release":
        node.server.release("it is deactivated")
    else:
        node.server.use(None, ("other",))
    assert len(node.sent) == 2
    for _ in range(1500):
        node.robot.step()
    node.assert_smooth()
    assert not node.robot.record.v[-1].any()
    assert np.abs(node.commanded - GOAL).max() > 0.1
    node.server.release("it is stopped already")
    assert len(node.sent) == 2


LIFT = (
    '<link name="floor"/><joint name="lift" type="prismatic"><parent link="floor"/>'
    '<child link="{}"/><axis xyz="0 0 1"/>'
    '<limit lower="0" upper="1" velocity="1" effort="1000"/></joint>'
)


@pytest.mark.parametrize(("joint", "is_served"), [("finger", True), ("lift", False)])
def test_gripper_may_close_while_the_arm_plans_and_a_lift_may_not_move(joint, is_served):
    root = URDF.partition('<parent link="')[2].partition('"')[0]
    urdf = GRIPPER_URDF.replace("</robot>", LIFT.format(root) + "</robot>")
    here = {"finger": 0.1, "lift": 0.1}
    settings = Settings(limits=LIMITS, max_solve_time=60.0, limits_file="")
    node = Node(assemble_model(urdf, [arm_primitive()], settings, here))
    assert node.model.facts.carriers == ("lift",)
    node._planning_time = 0.03, 0.03

    def move():
        here[joint] -= 2e-4
        node.tracker.measured.receive(tuple(here), tuple(here.values()))
        if here[joint] > 0.0:
            node.at(0.002, move)

    move()
    for positions in (GOAL, 0.9 * GOAL, HALF):
        node.ask(positions)
        node.run(0.3)
    assert node.statuses == (["served"] * 3 if is_served else ["refused"] * 3)
    if not is_served:
        assert "joint 'lift', which carries the arm, moved" in reasons(node)[0]


# Workers


def test_goal_whose_planner_dies_is_refused_and_the_next_one_served(node):
    node._planning_time = 1.0, 1.0
    node.ask(GOAL)
    node.server.answer(WorkerDied("signal 11"))
    assert node.statuses == ["refused"]
    assert reasons(node) == ["the planner has ended (signal 11)"]
    node._planning_time = 0.01, 0.01
    node.ask(GOAL)
    node.run(5.0)
    assert node.statuses == ["refused", "served"]
    node.assert_rests_at(GOAL)


def test_robot_stops_along_its_path_when_nobody_looks_out_for_obstacles(node):
    node.ask(GOAL)
    node.run(0.4)
    node.server.release("the watcher has ended")
    (said,) = node.logged
    assert "the watcher has ended" in said and "on its path" in said
    node.run(3.0)
    node.assert_smooth()
    assert node.outcomes == ["stopped"]
    assert np.abs(node.commanded - GOAL).max() > 0.05
    node.server.release("the watcher has ended")
    assert len(node.sent) == 2


def test_slowed_robot_stops_after_the_time_of_its_motion_when_nobody_looks_out(either):
    either.ask(GOAL)
    either.run(0.2)
    duration = either.server.execution.motion.duration
    either.robot.faults.speed_scaling = 0.3
    either.run(duration)
    assert either.robot.record.v[-1].any()
    either.server.release("the watcher has ended")
    either.robot.faults.speed_scaling = 1.0
    either.run(3.0)
    assert either.outcomes == ["stopped"]
    assert np.abs(either.commanded - GOAL).max() > 0.05


# What becomes of motions


def test_motion_that_a_controller_does_not_take_is_reported_and_the_next_goal_served(either):
    either.ask(GOAL, duration=4.0)
    either.run(0.3)
    either.robot.faults.drop = 1.0
    either.ask(START)
    either.run(0.05)
    either.robot.faults.drop = 0.0
    either.run(5.0)
    assert either.outcomes[:2] == ["replaced", "never_started"]
    report = either.execution_reports[1][1]
    assert "the controller may be inactive" in report.message and report.progress == 0.0
    either.ask(START)
    either.run(5.0)
    assert either.outcomes[2:] == ["arrived"]
    np.testing.assert_allclose(either.commanded, START, atol=1e-9)


def test_stop_after_a_motion_that_was_rejected_is_on_the_one_before(either):
    either.ask(GOAL, duration=2.0)
    either.run(0.8)
    before = either.server.execution.motion
    either.robot.faults.drop = 1.0
    either.ask(START)
    either.run(0.1)
    sent = either.sent[-1][1]
    either.server.hear(sent, "rejected the goal", MotionOutcome.NEVER_STARTED)
    either.robot.faults.drop = 0.0
    assert either.tracker.motion is before
    assert "on its path" in either.stop()
    either.run(3.0)
    assert either.verdict().is_clean
    assert either.outcomes[1] == "never_started"


def test_robot_that_is_held_arrives_when_it_is_released_in_time(either):
    either.ask(GOAL)
    either.run(0.5)
    either.robot.faults.held = True
    either.run(8.0)
    assert not either.outcomes
    either.robot.faults.held = False
    either.run(5.0)
    assert either.outcomes == ["arrived"]
    either.ask(START)
    either.run(0.5)
    either.robot.faults.held = True
    either.run(12.0)
    assert either.outcomes == ["arrived", "not_followed"]
    assert "has rested at" in either.execution_reports[1][1].message


@pytest.mark.parametrize("scaling", [0.3, 0.1])
def test_slowed_robot_arrives_late_and_gets_one_report(either, scaling):
    either.robot.faults.speed_scaling = scaling
    either.run(0.5)
    either.ask(GOAL, duration=1.2)
    either.run(0.7 * 1.2 / scaling)
    assert not either.outcomes
    either.run(1.2 / scaling)
    assert either.outcomes == ["arrived"]


def test_answer_of_a_controller_ends_the_motion_that_it_is_about(node):
    node.ask(GOAL)
    node.run(0.3)
    old = node.server.execution.motion.sent
    node.ask(START)
    node.run(0.1)
    for sent in (old, node.server.execution.motion.sent):
        node.server.hear(sent, "aborted the goal", MotionOutcome.NOT_FOLLOWED)
    assert node.outcomes == ["replaced", "not_followed"]
    assert "the controller aborted the goal" in node.execution_reports[-1][1].message


@pytest.mark.parametrize(("change", "reason"), [("joints", "joints"), ("clock", "set back")])
def test_motion_that_can_no_longer_be_followed_is_reported(node, monkeypatch, change, reason):
    node.ask(GOAL)
    node.run(0.2)
    if change == "joints":
        robot = MODEL.robot
        node.server.use(NodeModel(robot, MODEL.facts, MODEL.settings), tuple(JOINTS))  # the same
        node.run(0.1)
        assert not node.outcomes
        node.server.use(None, ())
        assert node.server.execution is None
    else:
        monkeypatch.setattr(node.tracker, "clock", lambda: node.now - 100.0)
    node.run(0.2)
    ((_, report),) = node.execution_reports
    assert report.outcome == "not_followed" and reason in report.message


# Robots that are slowed or held


@pytest.mark.parametrize("states_scaling", [True, False])
@pytest.mark.parametrize("fault", [("speed_scaling", 0.4), ("held", True)])
@pytest.mark.parametrize("event", ["goal", "stop"])
def test_stated_command_of_a_slowed_or_held_robot_is_continued_without_a_jump(
    fault, event, states_scaling
):
    node = Node()
    node.has_controller_state, node.states_scaling = True, states_scaling
    for wait in (0.05, 0.2, 0.5, 1.0) if states_scaling else (0.5, 1.0):
        node.ask(GOAL, duration=2.0)
        node.run(0.7)
        usual = getattr(node.robot.faults, fault[0])
        setattr(node.robot.faults, *fault)
        node.run(wait)
        if event == "stop":
            node.stop()
        else:
            node.ask(START)
        node.run(1.0)
        setattr(node.robot.faults, fault[0], usual)
        node.run(2.5)
        node.ask(START)
        node.run(3.0)
    assert node.statuses.count("refused") == 0
    if states_scaling:
        node.assert_smooth()
    else:  # how slow it is follows from two commands
        assert node.verdict().largest_jump < LARGEST


def test_goal_of_a_slowed_robot_is_refused_where_its_command_is_not_stated(node):
    node.robot.faults.speed_scaling = 0.4
    node.run(0.5)
    node.ask(GOAL, duration=2.0)
    node.run(2.0)
    node.ask(START)
    assert node.statuses == ["served", "refused"]
    assert "not at its time (a slowed controller?)" in reasons(node)[1]
    assert "With control_msgs and the topic 'controller_state'" in reasons(node)[1]
    node.run(8.0)
    assert node.outcomes == ["arrived"]


# Stops


def test_stop_follows_the_path_and_ends_at_rest_within_the_limits(either):
    assert "at rest" in either.stop()
    ((_, trajectory, stamp, _),) = either.sent
    assert (stamp, trajectory.positions.tolist()) == (None, [START.tolist()])
    either.ask(GOAL)
    either.run(0.5)
    path = either.sent[1][1].positions
    assert "comes to rest on its path" in either.stop()
    either.run(3.0)
    either.assert_smooth()
    assert not either.robot.record.v[-1].any()
    for q in either.robot.record.q[-3000::20]:
        assert np.abs(path - q).max(axis=1).min() < 0.02
    assert np.abs(either.commanded - GOAL).max() > 0.05
    either.ask(GOAL)
    either.run(4.0)
    assert either.statuses == ["served"] * 2
    assert either.outcomes == ["stopped", "arrived"]
    either.assert_rests_at(GOAL)


def test_stop_of_a_motion_of_another_node_continues_the_command_or_leads_to_a_point(either):
    either.ask(GOAL, duration=4.0)
    either.run(1.5)
    either.restart()  # the motion is not known any more
    either.run(0.3)
    said = "comes to rest off its path" if either.has_controller_state else "to a single point"
    assert said in either.stop()
    either.run(3.0)
    # The controller leads to a single point from the measured state.
    either.assert_smooth([tick for tick, n_points in either.robot.taken if n_points == 1])
    assert not either.robot.record.v[-1].any()
    assert np.abs(either.commanded - GOAL).max() > 0.05


@pytest.mark.parametrize("silence", [0.6, 1.0])
def test_stop_of_a_robot_that_is_not_heard_of_keeps_the_limits_and_says_what_is_not_known(
    node, silence
):
    node.ask(GOAL, duration=3.0)
    node.run(0.4)
    node.robot.faults.silent = True
    node.run(silence)
    said = node.stop()
    assert "not known whether the robot stops" in said and "old" in said
    assert node.sent[-1][-1]
    node.run(4.0)
    node.assert_smooth([tick for tick, n_points in node.robot.taken if n_points == 1])
    assert not node.robot.record.v[-1].any()
    assert np.abs(node.commanded - GOAL).max() > 0.05


@pytest.mark.parametrize("is_lost", [False, True])
def test_stop_at_a_point_is_sent_again_only_if_the_robot_is_seen_not_to_go_there(node, is_lost):
    node.ask(GOAL, duration=2.0)
    node.run(0.3)
    node.robot.faults.silent = True
    node.run(0.55)
    node.robot.faults.drop = float(is_lost)
    node.stop()
    n_sent = len(node.sent)
    node.run(0.1)
    node.robot.faults.silent, node.robot.faults.drop = False, 0.0
    node.run(2.0)
    assert (len(node.sent) > n_sent) is is_lost
    assert node.outcomes[-1] == "stopped"
    n_sent = len(node.sent)
    node.robot.faults.payload = 3.0
    node.run(1.0)
    assert len(node.sent) == n_sent


def test_stop_that_no_state_has_shown_yet_is_not_sent_again(node):
    node.ask(GOAL)
    node.run(0.6)
    node.robot.faults.silent = True
    node.run(0.4)  # longer than the part of the motion that a stop repeats
    node.stop()
    n_sent = len(node.sent)
    node.run(0.09)
    assert len(node.sent) == n_sent
    node.stop()
    node.robot.faults.silent = False
    node.run(3.0)
    assert node.verdict().is_clean
    assert node.outcomes[-1] == "stopped"


@pytest.mark.parametrize(("wait", "loss"), [(0.03, 0.01), (0.5, 0.01), (0.5, 0.5), (0.03, 1.0)])
def test_stop_that_is_lost_is_sent_until_the_robot_rests(either, wait, loss):
    either.ask(GOAL, duration=4.0)
    either.run(0.8)
    either.ask(HALF, duration=4.0)
    either.run(wait)  # it is known, or not, that the second motion was taken
    either.robot.faults.drop = 1.0
    either.stop()
    either.run(loss)
    either.robot.faults.drop = 0.0
    either.run(3.0)
    assert not either.robot.record.v[-1].any()
    assert np.abs(either.commanded - HALF).max() > 0.05
    assert either.outcomes[-1] == "stopped"
    n_sent = len(either.sent)
    either.run(3.0)
    assert len(either.sent) == n_sent


@pytest.mark.parametrize("left", [0.6, 0.75, 1.1])
def test_goal_after_stops_that_were_all_lost_begins_where_the_motion_ended(node, left):
    node.ask(GOAL, duration=3.0)
    node.run(3.0 - left)
    node.robot.faults.drop = 1.0
    node.stop()  # as it is repeated, stops end near the end of the motion
    node.run(2.5)
    node.robot.faults.drop = 0.0
    node.ask(HALF)
    node.run(4.0)
    assert node.verdict().is_clean
    node.assert_rests_at(HALF)


def test_goal_of_a_robot_that_was_slowed_in_its_first_motion_waits_until_it_rests(node):
    node.robot.faults.speed_scaling = 0.9
    node.run(1.0)
    node.ask(GOAL, duration=2.0)
    node.run(0.9)
    node.robot.faults.speed_scaling = 1.0
    node.run(0.4)  # it lags by 0.1 s from now on, as one with slow servos
    node.ask(HALF)
    node.run(6.0)
    assert node.verdict().largest_jump < 1e-3
    node.assert_rests_at(HALF)


SLOW = {name: {"max_velocity": 0.2, "max_acceleration": 3.0, "max_jerk": 60.0} for name in JOINTS}


@pytest.mark.parametrize("delay", [0.25, 0.5, 0.7])
def test_a_stop_is_taken_whose_messages_are_on_their_way_for_longer_than_it_lasts(delay):
    node = Node(model(limits=SLOW))
    node.ask(GOAL)
    node.run(2.0)
    node.robot.faults.delay = delay
    node.stop()
    assert node.sent[-1][1].duration < delay  # the first is rejected, because it is over
    node.run(4.0)
    assert node.robot.rejections and not node.robot.record.v[-1].any()
    assert node.outcomes == ["stopped"]
    assert np.abs(node.commanded - GOAL).max() > 0.5


def test_stop_of_a_robot_that_was_never_heard_of_is_refused(node):
    node.robot.faults.silent = True
    node.restart()
    said = node.stop()
    assert said.startswith("nothing was published: the present state is not known")
    assert "joint_states" in said and not node.sent


# Counts and times of goals


def test_fast_goals_do_not_make_slow_ones_seem_fast():
    statistics = GoalStatistics()
    assert statistics.expected_latency(JointGoal) > 0.0
    assert statistics.solve_time_percentiles() == {}
    statistics.served(SequenceGoal, 1.0, 1.0)
    for _ in range(200):
        statistics.served(JointGoal, 0.01, 0.01)
    assert statistics.expected_latency(SequenceGoal) >= 1.0
    assert statistics.expected_latency(JointGoal) < 0.1


def test_percentiles_are_those_of_the_solve_times():
    statistics = GoalStatistics()
    for k in range(101):
        statistics.served(JointGoal, k / 100, k / 50)
    assert statistics.solve_time_percentiles() == {
        "solve_time_p50_s": pytest.approx(0.5),
        "solve_time_p90_s": pytest.approx(0.9),
        "solve_time_p99_s": pytest.approx(0.99),
    }
