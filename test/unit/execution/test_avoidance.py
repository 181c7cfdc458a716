# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Obstacles that come while a simulated robot moves, in virtual time."""

from __future__ import annotations

import numpy as np
import pytest
from support import served_arm
from support.arm import JOINTS, arm_robot
from support.served_arm import GOAL, HALF, START, Node, model
from support.worlds import plain_distances

from mp_pca_planner.execution.link import Place, Watch, WatchedRobot
from mp_pca_planner.execution.watching import Watcher
from mp_pca_planner.motion.trajectory import Trajectory
from mp_pca_planner.robot.world import Obstacle, Sphere, World

MARGIN, RADIUS = 0.01, 0.03
MODEL = model(collision=True, obstacle_margin=MARGIN)


@pytest.fixture(params=[False, True], ids=["seen", "stated"])
def node(request):
    node = Node(MODEL)
    node.has_controller_state = request.param
    return node


def ball_at(positions, radius=RADIUS):
    """A ball where the hand is in a configuration."""
    robot = arm_robot()
    hand = robot.frame_positions(np.atleast_2d(positions), [robot.frame_names[-1]])[0, 0]
    return World([Obstacle("ball", Sphere(radius, hand))])


def place_on_motion(node, share):
    _, trajectory, *_ = node.sent[-1]
    return trajectory.positions[int(share * trajectory.n_steps)]


def clearance(node, world, since):
    """Least distance of the commanded robot from a ball since a time."""
    record = node.robot.record
    path = np.unique(record.q[record.times >= since], axis=0)  # most of the time, it rests
    return plain_distances(world, path).min()


@pytest.mark.parametrize("is_sequence", [False, True])  # a goal with a duration is one of a target
def test_running_motion_leads_around_a_new_obstacle_without_a_jump(node, is_sequence):
    if is_sequence:
        node.ask_sequence(GOAL, times=(4.0,))
    else:
        node.ask(GOAL, duration=4.0)
    node.run(0.8)
    world, came = ball_at(place_on_motion(node, 0.6)), node.now
    node.use_world(world)
    node.run(8.0)
    (said,) = node.logged
    assert said.startswith("a new obstacle is on the path ('lower_arm' would hit 'ball')")
    assert said.endswith("another motion leads to the goal")
    node.assert_smooth()
    node.assert_rests_at(GOAL)
    assert clearance(node, world, came) >= MARGIN
    # The goal is the same, and gets one report.
    assert node.outcomes == ["arrived"] and node.statuses == ["served"]
    assert "detour" in node.execution_reports[0][1].message


def test_robot_stops_before_an_obstacle_that_covers_the_goal_until_a_new_goal(node):
    node.ask(GOAL, duration=4.0)
    node.run(0.8)
    world, came = ball_at(GOAL), node.now
    node.use_world(world)
    node.run(7.0)
    node.assert_smooth()
    assert node.outcomes == ["stopped"]
    said = node.execution_reports[0][1].message
    assert "'lower_arm' would hit 'ball'" in said
    assert said.endswith("no other motion was found in time; send the goal again")
    assert "no other motion was found" in node.logged[0] and "in collision" in node.logged[0]
    assert clearance(node, world, came) >= MARGIN
    node.use_world(World())
    n, rest = len(node.sent), node.commanded
    node.run(5.0)
    assert len(node.sent) == n and (node.commanded == rest).all()
    node.ask(GOAL)
    node.run(8.0)
    node.assert_rests_at(GOAL)


@pytest.mark.parametrize("delay", [0.18, 0.3])
def test_a_stop_or_detour_whose_message_is_late_on_a_busy_machine_is_followed(node, delay):
    for share, expected in ((1.0, "stopped"), (0.6, "arrived")):
        node.ask(GOAL, duration=4.0)
        node.run(0.8)
        node.robot.faults.delay = delay
        node.use_world(ball_at(place_on_motion(node, min(share, 0.99))))
        node.run(3.0 if share == 1.0 else delay + 0.1)
        node.robot.faults.delay = 0.0
        node.run(5.0)
        assert node.outcomes[-1] == expected
        assert not node.robot.record.v[-1].any()
        node.use_world(World())
        node.ask(START)
        node.run(4.0)
    np.testing.assert_allclose(node.commanded, START, atol=1e-9)


def test_robot_stops_before_an_obstacle_while_a_sequence_is_planned(node):
    node.ask(GOAL, duration=4.0)
    node.run(0.5)
    world, came = ball_at(place_on_motion(node, 0.6)), node.now
    node.at(0.1, lambda: node.use_world(world))
    node._planning_time = 3.0, 3.0
    node.ask_sequence(HALF, START)
    node.run(6.0)
    node.assert_smooth()
    assert clearance(node, world, came) > 0.0
    assert node.outcomes[0] == "stopped"
    assert node.statuses == ["served", "refused"]
    assert "on the path" in node.plan_reports[-1].message


@pytest.mark.parametrize("fault", ["silent", "held", "refused", "refused twice"])
def test_obstacle_is_avoided_that_came_while_the_robot_was_not_seen_to_move(node, fault):
    node.ask(GOAL, duration=4.0)
    node.run(0.8)
    world, came = ball_at(place_on_motion(node, 0.6)), node.now
    if fault.startswith("refused"):
        node.robot.faults.drop = 1.0  # of the next motion, and of the one around the obstacle
        node.ask(HALF, duration=4.0)
        node.run(0.02)
        node.robot.faults.drop = float(fault == "refused twice")
    else:
        setattr(node.robot.faults, fault, True)
        node.run(0.7)
    node.use_world(world)
    node.run(0.1)
    node.robot.faults.drop = 0.0
    if not fault.startswith("refused"):
        setattr(node.robot.faults, fault, False)
    node.run(8.0)
    assert clearance(node, world, came) > 0.0
    assert not node.robot.record.v[-1].any()
    assert node.outcomes[-1] in ("stopped", "arrived", "not_followed")


def test_held_robot_is_stopped_before_an_obstacle_at_once(node):
    """When it moves on is unknown: how long its motion would take does not count."""
    node.ask(GOAL, duration=8.0)
    node.run(0.8)
    node.robot.faults.held = True
    node.run(0.7)
    held = node.commanded
    node.use_world(ball_at(place_on_motion(node, 0.6)))
    node.run(0.1)
    node.robot.faults.held = False
    node.run(1.0)
    assert node.outcomes == ["stopped"]
    np.testing.assert_allclose(node.commanded, held, atol=1e-6)


def test_robot_stops_in_an_obstacle_of_which_a_busy_machine_hears_late(node):
    node.ask(GOAL, duration=4.0)
    node.run(0.5)
    node.use_world(World([Obstacle("far", Sphere(0.1, (3.0, 0.0, 0.0)))]))
    node.run(1.0)
    node.watcher.delay = 0.3
    node.use_world(ball_at(node.commanded, radius=0.1))
    node.run(6.0)
    assert node.outcomes == ["stopped"]
    assert "on the robot ('lower_arm' is in collision with 'ball')" in node.logged[0]


def test_goal_whose_motion_would_begin_behind_an_obstacle_is_refused(node):
    node._planning_time = 1.2, 1.2
    node.ask_sequence(HALF, START)  # sequences are expected to take as long
    node.run(8.0)
    node._planning_time = 0.02, 0.02
    node.ask(GOAL, duration=4.0)
    node.run(0.5)
    node.ask_sequence(HALF, START)
    node.run(0.005)
    node.use_world(ball_at(place_on_motion(node, 0.34)))
    node.run(0.05)
    assert node.statuses == ["served", "served", "refused"]
    assert "before another motion could begin" in node.plan_reports[-1].message


def test_obstacles_beside_or_behind_the_motion_change_nothing(node):
    node.ask(GOAL, duration=4.0)
    node.run(2.5)
    for world in (ball_at(START), World([Obstacle("far", Sphere(0.1, (3.0, 0.0, 0.0)))]), World()):
        node.use_world(world)
        node.run(0.1)
    node.run(5.0)
    assert node.outcomes == ["arrived"]
    assert len(node.sent) == 1 and not node.logged


def test_sequence_stops_before_an_obstacle(node):
    node.ask_sequence(START + 0.25 * (GOAL - START), GOAL, times=(2.0, 6.0))
    node.run(2.3)
    world, came = ball_at(place_on_motion(node, 0.58)), node.now
    node.use_world(world)
    node.run(10.0)
    node.assert_smooth()
    assert clearance(node, world, came) >= MARGIN
    assert node.outcomes == ["stopped"]


def test_newer_goal_takes_the_place_of_the_avoidance(node):
    node.ask(GOAL, duration=4.0)
    node.run(0.8)
    node._planning_time = 0.3, 0.3
    node.use_world(ball_at(GOAL))
    node.run(0.06)
    node._planning_time = 0.01, 0.01
    node.ask(START)
    node.run(8.0)
    node.assert_smooth()
    node.assert_rests_at(START)
    assert node.statuses == ["served"] * 2
    assert node.outcomes == ["replaced", "arrived"]


@pytest.mark.parametrize("is_asked_for", [False, True])
def test_stop_leaves_its_path_where_that_alone_is_quick_enough(node, is_asked_for):
    """Before the obstacle, the quickest stop is used."""
    n_off = 0
    for share in (0.45, 0.5, 0.55):
        node.ask(GOAL, duration=1.2)
        node.run(0.55)
        node.use_world(ball_at(place_on_motion(node, share)))
        node.run(0.002)
        said = node.stop() if is_asked_for else ""
        node.run(3.0)
        assert not node.robot.record.v[-1].any()
        n_off += any("off its path" in text for text in (said, *node.logged))
        node.use_world(World())
        node.ask(START)
        node.run(4.0)
    assert n_off
    node.assert_smooth()


# The watcher


def straight(duration=2.0, n=101):
    s = np.linspace(0.0, 1.0, n)[:, None]
    zero = np.zeros((n, 4))
    q = START + s * (GOAL - START)
    return Trajectory(JOINTS, s[:, 0] * duration, q, zero + (GOAL - START) / duration, zero)


@pytest.fixture
def watcher():
    watcher = Watcher()
    watcher.model = MODEL
    return watcher


def test_verdict_is_where_the_first_collision_begins(watcher):
    motion = straight()
    watcher.world = ball_at(HALF)
    watcher.receive(Watch(3, motion, 0.0))
    verdict = watcher.look()
    distances = plain_distances(watcher.world, motion.positions).min(axis=1)
    first = motion.times[np.flatnonzero(distances < MARGIN)[0]]
    assert (verdict.number, verdict.place) == (3, pytest.approx(first, abs=0.03))
    assert watcher.look() is None  # neither the motion nor the world has changed


def test_watcher_needs_no_primitives(watcher):
    watcher.model = None
    watcher.world = ball_at(HALF)
    watcher.receive(Watch(1, straight(), 0.0))
    assert watcher.look() is None
    watcher.receive(WatchedRobot(MODEL.urdf, JOINTS, {}, MODEL.settings))
    found = watcher.look()
    watcher.model = MODEL
    assert found.place == watcher.look().place < np.inf


def test_what_the_robot_has_passed_does_not_count(watcher):
    watcher.world = ball_at(START)
    watcher.receive(Watch(1, straight(), 0.0))
    assert watcher.look().place == 0.0
    watcher.receive(Place(1, 1.5))
    watcher.receive(Place(7, 0.0))  # of another motion
    watcher.world = ball_at(START)
    assert watcher.look().place == np.inf


def test_motions_that_can_not_be_checked_go_on(watcher, monkeypatch):
    bare = served_arm.URDF.replace("collision", "visual")
    monkeypatch.setattr(served_arm, "URDF", bare)
    watcher.model = model()
    watcher.world = ball_at(HALF)
    watcher.receive(Watch(1, straight(), 0.0))
    assert watcher.look().place == np.inf
