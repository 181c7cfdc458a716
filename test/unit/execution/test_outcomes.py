# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""What is said of motions: exactly one report of each, whatever happens to it."""

from __future__ import annotations

import numpy as np
import pytest
from support.arm_plans import planned
from support.dense import minimum_jerk_motion

from mp_pca_planner.execution.motions import PublishedMotion
from mp_pca_planner.execution.outcomes import ACCEPTED, Execution, is_same_goal
from mp_pca_planner.execution.tracking import Following, How
from mp_pca_planner.motion.goal import JointGoal, JointState, Pose, PoseGoal, SequenceGoal

DURATION, PERIOD = 2.0, 0.05


def execution(motion, goal=None, name="goal"):
    return Execution(name, motion, planned(motion.trajectory, DURATION, goal))


class World:
    """A robot of which the tests say how it follows its motion."""

    def __init__(self):
        self.reports = []
        self.execution, self.now = None, 100.0

    def motion(self):
        trajectory = minimum_jerk_motion(("a", "b"), [0.0, 0.0], [1.0, -0.5], DURATION)
        self.current = PublishedMotion(trajectory, self.now)
        return self.current

    def note(self, report):
        self.reports += [] if report is None else [report]

    def begin(self, goal="goal"):
        old, motion = self.execution, self.motion()
        self.execution = execution(motion, name=goal)
        if old is not None:
            self.note(old.replaced())

    def stop(self):
        self.execution = Execution.of_stop(self.execution, self.motion())

    def run(self, duration, how=How.ON_TIME, place=None, distance=0.001, motion=None):
        """The robot follows for some time: as the clock says, or stays at a place."""
        for _ in range(round(duration / PERIOD)):
            self.now += PERIOD
            motion = motion or self.current
            there = self.now - motion.began if place is None else place
            at_rest = how is How.HELD or there >= DURATION
            seen = Following(motion, how, self.now, there, 1.0, distance, "b", at_rest)
            self.note(self.execution.update(seen, self.now))
            self.is_lost = self.execution.is_lost(seen, self.now)

    def silence(self, duration):
        for _ in range(round(duration / PERIOD)):
            self.now += PERIOD
            self.note(self.execution.update(None, self.now))

    def only_report(self):
        """The report, which stays the only one whatever comes after."""
        for how in (How.ON_TIME, How.HELD, How.OFF):
            self.run(30.0, how)
        self.silence(30.0)
        (report,) = self.reports
        return report


@pytest.fixture
def world():
    world = World()
    world.begin()
    return world


def test_motion_that_is_followed_to_its_end_has_arrived_with_its_error(world):
    world.run(DURATION - PERIOD)
    assert not world.reports
    world.run(2 * PERIOD, distance=0.0123)
    report = world.only_report()
    assert (report.goal, report.outcome, report.outcome.is_good) == ("goal", "arrived", True)
    assert "0.0123" in report.message and "'b'" in report.message
    assert (report.progress, report.error) == (1.0, 0.0123)


def test_robot_that_leaves_its_path_does_not_follow_with_the_largest_deviation(world):
    world.run(0.5)
    world.run(PERIOD, How.OFF, distance=0.4)
    world.run(0.1, How.OFF, distance=0.3)
    assert not world.reports
    world.run(0.2, How.OFF, distance=0.3)
    report = world.only_report()
    assert (report.outcome, report.outcome.is_good) == ("not_followed", False)
    assert (report.largest_deviation, report.error) == (0.4, 0.3)
    assert report.deviation_time == pytest.approx(0.5 + PERIOD)
    assert "0.4" in report.message


def test_motion_at_whose_start_the_robot_rests_never_started(world):
    world.run(1.6, How.HELD, place=0.0)  # at a tenth of the speed, it would not have left
    assert not world.reports
    world.run(0.3, How.HELD, place=0.0)
    report = world.only_report()
    assert (report.outcome, report.outcome.is_good, report.progress) == (
        "never_started",
        False,
        0.0,
    )
    assert "controller" in report.message


def test_motion_never_started_if_the_robot_follows_the_one_before(world):
    before = world.current
    world.run(0.5)
    world.begin("newer")
    world.run(1.6, motion=before)  # on a busy machine, the message comes late
    assert [report.outcome for report in world.reports] == ["replaced"]
    world.run(0.3, motion=before)
    assert [report.outcome for report in world.reports] == ["replaced", "never_started"]
    world.run(30.0)
    assert len(world.reports) == 2


def test_robot_that_is_silent_is_waited_for_until_long_after_the_end(world):
    world.run(0.5)
    world.silence(DURATION - 0.5 + 9.0)
    assert not world.reports
    world.silence(2.0)
    report = world.only_report()
    assert report.outcome == "not_followed" and "silent" in report.message


def test_every_motion_of_a_random_history_gets_exactly_one_report():
    random = np.random.default_rng(2)
    world, stopped = World(), set()
    for goal in range(200):
        world.begin(goal)
        for _ in range(random.integers(0, 4)):
            event = random.integers(6)
            if event == 0:
                world.stop()
                stopped.add(goal)
            elif event == 1:
                world.silence(random.uniform(0.0, 15.0))
            else:
                how = (How.ON_TIME, How.SCALED, How.HELD, How.OFF)[event - 2]
                world.run(random.uniform(0.0, 3.0), how, distance=random.uniform(0.0, 0.1))
    world.begin("last")
    assert [report.goal for report in world.reports] == list(range(200))
    outcomes = {report.outcome for report in world.reports}
    assert outcomes == {"arrived", "replaced", "stopped", "not_followed"}
    assert {r.goal for r in world.reports if r.outcome == "stopped"} <= stopped


# Stops that are lost


def test_stop_that_the_robot_does_not_follow_is_lost_until_it_rests(world):
    before = world.current
    world.run(0.5)
    world.stop()
    world.run(0.05)
    assert not world.is_lost
    world.run(0.05, motion=before)
    assert world.is_lost  # it goes on along the old motion
    world.run(0.05, How.OFF)
    assert not world.is_lost
    world.run(0.2, How.OFF)
    assert world.is_lost
    world.run(0.05, How.HELD)
    assert not world.is_lost


def test_robot_that_moves_long_after_the_end_of_a_stop_has_lost_it(world):
    world.stop()
    world.run(DURATION + 0.2, How.SCALED, place=1.9)
    assert not world.is_lost
    world.run(0.2, How.SCALED, place=1.9)
    assert world.is_lost


def test_stop_at_whose_end_servos_follow_slowly_is_not_lost(world):
    world.stop()
    world.run(DURATION)
    end = world.current
    for _ in range(20):
        world.now += PERIOD
        seen = Following(end, How.ON_TIME, world.now, world.now - end.began, 1.0, 0.01, "b", False)
        assert not world.execution.is_lost(seen, world.now)


# Answers of a controller


def test_answers_of_a_controller_are_in_the_report(world):
    world.note(world.execution.answer(ACCEPTED, None))
    world.run(DURATION + 0.5)
    assert not world.reports  # its result comes soon
    world.note(world.execution.answer("reached the goal", None))
    world.run(0.1)
    report = world.only_report()
    assert (report.outcome, report.controller) == ("arrived", "accepted the goal; reached the goal")


# Rest of a goal


def test_rest_of_a_goal_is_for_all_joints_and_that_of_a_sequence_or_a_stop_is_none(world):
    motion, via = world.motion(), JointState(("a",), [0.5])
    part = JointGoal(JointState(("a",), [1.0]), duration=4.0, primitive="reach")
    rest = execution(motion, part).rest_of_goal()
    assert (rest.duration, rest.primitive) == (None, "reach")
    np.testing.assert_array_equal(rest.state.positions, motion.end)
    pose = execution(motion, PoseGoal(POSE, 2.0)).rest_of_goal()
    assert (pose.pose, pose.duration) == (POSE, None)
    sequence = SequenceGoal((via, JointState(("a",), [1.0])))
    assert execution(motion, sequence).rest_of_goal() is None
    world.stop()
    assert world.execution.rest_of_goal() is None


# Goals that ask for the same

STATE = JointState(("a", "b"), [0.1, 0.2])
POSE = Pose("hand", [0.1, 0.2, 0.3], [1.0, 0.0, 0.0, 0.0])
SAME = [
    (JointGoal(STATE), JointGoal(JointState(("a", "b"), [0.10009, 0.2]))),
    (PoseGoal(Pose("hand", [0, 0, 1])), PoseGoal(Pose("hand", [0, 0, 1.00009]))),
    (SequenceGoal((STATE, POSE), (None, 2.0)), SequenceGoal((STATE, POSE), (None, 2.0))),
]
DIFFERENT = [
    (JointGoal(STATE), JointGoal(JointState(("a", "b"), [0.10011, 0.2]))),
    (JointGoal(STATE), JointGoal(JointState(("a", "c"), [0.1, 0.2]))),
    (JointGoal(STATE), JointGoal(JointState(("a", "b"), [0.1, 0.2], [0.0, 0.1]))),
    (JointGoal(STATE), JointGoal(STATE, duration=2.0)),
    (JointGoal(STATE), SequenceGoal((STATE,))),
    (PoseGoal(POSE), PoseGoal(Pose("hand", POSE.position))),
    (PoseGoal(POSE), PoseGoal(Pose("elbow", POSE.position, POSE.orientation))),
    (SequenceGoal((STATE, POSE)), SequenceGoal((STATE,))),
]


@pytest.mark.parametrize(
    ("one", "other", "is_same"), [(*x, True) for x in SAME] + [(*x, False) for x in DIFFERENT]
)
def test_goals_are_the_same_if_they_ask_for_the_same_but_for_rounding(one, other, is_same):
    assert is_same_goal(one, other) == is_same_goal(other, one) == is_same
