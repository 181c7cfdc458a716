# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""What is said of motions: exactly one report of each, whatever happens to it."""

from __future__ import annotations

import numpy as np
import pytest
from support.dense import minimum_jerk_motion

from mp_pca_planner.execution.serving.execution import Execution
from mp_pca_planner.execution.tracking.estimation import Progress
from mp_pca_planner.execution.tracking.following import Following, How
from mp_pca_planner.execution.tracking.published_motion import PublishedMotion

DURATION, PERIOD = 2.0, 0.05


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
        old, self.execution = self.execution, Execution(goal, self.motion())
        if old is not None:
            self.note(old.replaced(self.execution))

    def stop(self):
        self.execution = Execution.of_stop(self.execution, self.motion())

    def run(self, duration, how=How.ON_TIME, place=None, distance=0.001, motion=None):
        """The robot follows for some time: as the clock says, or stays at a place."""
        for _ in range(round(duration / PERIOD)):
            self.now += PERIOD
            motion = motion or self.current
            there = self.now - motion.began if place is None else place
            at_rest = how is How.HELD or there >= DURATION
            progress = Progress(motion, self.now, there)
            following = Following(how, progress, distance, "b", at_rest)
            self.note(self.execution.update(following, self.now))

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


def test_motion_that_lags_arrives_when_it_comes_to_its_end(world):
    world.run(20.0, How.LAGGING, place=1.5)
    assert not world.reports
    world.run(PERIOD)
    assert world.only_report().outcome == "arrived"


def test_motion_that_is_replaced_is_reported_before_the_newer_one(world):
    world.run(0.5)
    world.begin("newer")
    (replaced,) = world.reports
    assert (replaced.goal, replaced.outcome, replaced.outcome.is_good) == ("goal", "replaced", True)
    assert replaced.progress == pytest.approx(0.25)
    world.run(3.0)
    assert [report.goal for report in world.reports] == ["goal", "newer"]
    assert world.reports[1].outcome == "arrived"


def test_motion_that_is_stopped_is_reported_once_when_the_robot_rests(world):
    world.run(0.5)
    world.stop()
    assert not world.reports
    world.run(DURATION + PERIOD)
    report = world.only_report()
    assert (report.goal, report.outcome, report.outcome.is_good) == ("goal", "stopped", True)


def test_stop_that_a_newer_goal_replaces_is_a_stop(world):
    world.run(0.5)
    world.stop()
    world.run(0.2)
    world.begin("newer")
    assert [report.outcome for report in world.reports] == ["stopped"]
    world.run(3.0)
    assert [report.outcome for report in world.reports] == ["stopped", "arrived"]


def test_stop_without_a_motion_is_not_reported():
    world = World()
    world.stop()
    world.run(3.0)
    assert not world.reports


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


def test_robot_that_comes_back_to_its_path_in_time_follows(world):
    for _ in range(5):
        world.run(0.15, How.OFF)
        world.run(0.1)
    assert not world.reports


def test_robot_that_is_held_on_its_path_for_long_does_not_follow(world):
    world.run(1.0)
    world.run(9.0, How.HELD, place=1.0)
    assert not world.reports
    world.run(2.0, How.HELD, place=1.0)
    report = world.only_report()
    assert report.outcome == "not_followed" and "50%" in report.message


def test_robot_that_is_released_in_time_arrives(world):
    world.run(1.0)
    world.run(9.0, How.HELD, place=1.0)
    world.run(0.5, How.LAGGING, place=1.5)
    world.run(9.0, How.HELD, place=1.7)
    world.run(PERIOD)
    assert world.only_report().outcome == "arrived"


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
    world.run(0.95, motion=before)  # on a busy machine, the message comes late
    assert [report.outcome for report in world.reports] == ["replaced"]
    world.run(2 * PERIOD, motion=before)
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
                how = (How.ON_TIME, How.LAGGING, How.HELD, How.OFF)[event - 2]
                world.run(random.uniform(0.0, 3.0), how, distance=random.uniform(0.0, 0.1))
    world.begin("last")
    assert [report.goal for report in world.reports] == list(range(200))
    outcomes = {report.outcome for report in world.reports}
    assert outcomes == {"arrived", "replaced", "stopped", "not_followed"}
    assert {r.goal for r in world.reports if r.outcome == "stopped"} <= stopped
