# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Obstacles that come while a simulated robot moves, in virtual time."""

from __future__ import annotations

import re
from concurrent.futures import CancelledError

import numpy as np
import pytest
from support import served_arm
from support.arm import JOINTS, arm_robot
from support.served_arm import GOAL, HALF, START, Node, model
from support.worlds import plain_distances

from mp_pca_planner.exceptions import RobotError, WorldError
from mp_pca_planner.motion.collision import CollisionModel
from mp_pca_planner.motion.interpolation import interpolate
from mp_pca_planner.robot.world import Obstacle, Sphere, World

MARGIN, RADIUS = 0.01, 0.03
MODEL = model(collision=True, obstacle_margin=MARGIN)
SLOW = {name: {"max_velocity": 0.2, "max_acceleration": 3.0, "max_jerk": 60.0} for name in JOINTS}


@pytest.fixture
def node():
    return Node(MODEL)


def use(node, world):
    """Other obstacles; whether the motion would hit one."""
    return node.monitor.surroundings.replace(world, node._model)


def ball_at(positions):
    """A ball where the hand is in a configuration."""
    robot = arm_robot()
    hand = robot.frame_positions(np.atleast_2d(positions), [robot.frame_names[-1]])[0, 0]
    return World([Obstacle("ball", Sphere(RADIUS, hand))])


def place_on_motion(node, share):
    _, trajectory, *_ = node.sent[-1]
    return trajectory.positions[int(share * trajectory.n_steps)]


def clearance(node, world, since):
    """Least distance of the commanded robot from a ball since a time."""
    record = node.robot.record
    return plain_distances(world, record.q[record.times >= since]).min()


def not_cancelled():
    return False


def test_place_of_the_robot_is_not_sought_where_there_are_no_obstacles(node, monkeypatch):
    node.ask(GOAL)
    node.run(0.3)
    follow, followed = node.follower.follow, []

    def counted(*arguments):
        followed.append(1)
        return follow(*arguments)

    monkeypatch.setattr(node.follower, "follow", counted)
    node.monitor.surroundings.look_ahead(node._model)
    assert not followed
    assert use(node, ball_at(place_on_motion(node, 0.6)))
    assert followed


def test_running_motion_leads_around_a_new_obstacle_without_a_jump(node):
    node.ask(GOAL, duration=4.0)
    node.run(0.8)
    world, came = ball_at(place_on_motion(node, 0.6)), node.now
    assert use(node, world)
    message, served = node.server.avoid_obstacle(node._model, not_cancelled)
    assert served is not None and node.monitor.surroundings.threat is None
    assert message.startswith("a new obstacle is on the path ('lower_arm' would hit 'ball')")
    node.run(8.0)
    node.assert_smooth()
    node.assert_rests_at(GOAL)
    assert clearance(node, world, came) >= MARGIN
    assert node.outcomes == ["replaced", "arrived"]
    first = node.execution_reports[0][1].message
    assert [report.continues for _, report in node.execution_reports] == [True, False]
    assert first.startswith("replaced by another motion, for a new obstacle is on the path")


def test_robot_stops_before_an_obstacle_that_covers_the_goal(node):
    node.ask(GOAL, duration=4.0)
    node.run(0.8)
    world, came = ball_at(GOAL), node.now
    assert use(node, world)
    message, served = node.server.avoid_obstacle(node._model, not_cancelled)
    assert served is None and "the goal is in collision" in message
    assert len(node.sent) == 1
    node.monitor.watch(node._model)
    assert len(node.sent) == 2
    node.run(5.0)
    node.assert_smooth()
    assert node.outcomes == ["stopped"]
    assert "'lower_arm' would hit 'ball'" in node.execution_reports[0][1].message
    assert clearance(node, world, came) >= MARGIN
    assert not node.robot.record.v[-1].any()


def test_obstacle_that_is_gone_before_the_robot_is_stopped_changes_nothing(node):
    node.ask(GOAL, duration=4.0)
    node.run(0.8)
    assert use(node, ball_at(GOAL))
    message, _ = node.server.avoid_obstacle(node._model, not_cancelled)
    assert "no other motion was found" in message
    assert not use(node, World())
    node.run(8.0)
    node.assert_rests_at(GOAL)
    assert node.outcomes == ["arrived"]


@pytest.mark.parametrize("delay", [0.18, 0.2])
def test_a_stop_whose_message_is_late_on_a_busy_machine_is_a_stop(delay):
    node = Node(model(collision=True, obstacle_margin=MARGIN, limits=SLOW))
    node.ask(GOAL)
    node.run(4.0)
    world = ball_at(GOAL)
    node.robot.faults.delay = delay
    assert use(node, world)
    node.server.avoid_obstacle(node._model, not_cancelled)
    node.run(3.0)
    assert len(node.robot.taken) > 1 and not node.robot.record.v[-1].any()
    node.robot.faults.delay = 0.0
    use(node, World())
    node.run(9.0)
    assert not node.robot.record.v[-1].any()
    assert node.outcomes == ["stopped"]


@pytest.mark.parametrize("delay", [0.25, 0.5, 0.7])
def test_a_stop_is_taken_whose_messages_are_on_their_way_for_longer_than_it_lasts(delay):
    node = Node(model(limits=SLOW))
    node.ask(GOAL)
    node.run(2.0)
    node.robot.faults.delay = delay
    node.monitor.stop(node._model)
    assert node.sent[-1][1].duration < delay  # the first is rejected, because it is over
    node.run(3.0)
    assert node.robot.rejections and not node.robot.record.v[-1].any()
    assert node.outcomes == ["stopped"]
    assert np.abs(node.commanded - GOAL).max() > 0.5


@pytest.mark.parametrize("delay", [0.15, 0.3])
def test_a_detour_whose_message_is_late_on_a_busy_machine_is_followed(delay):
    node = Node(model(collision=True, obstacle_margin=MARGIN))
    node.ask(GOAL, duration=4.0)
    node.run(0.8)
    node.robot.faults.delay = delay
    use(node, ball_at(place_on_motion(node, 0.6)))
    _, served = node.server.avoid_obstacle(node._model, not_cancelled)
    assert served is not None
    node.run(delay + 0.05)
    node.robot.faults.delay = 0.0
    node.run(8.0)
    node.assert_rests_at(GOAL)
    assert node.outcomes == ["replaced", "arrived"]


def test_nothing_moves_after_a_stop_before_an_obstacle_until_a_new_goal(node):
    node.ask(GOAL, duration=4.0)
    node.run(0.5)
    assert use(node, ball_at(place_on_motion(node, 0.6)))
    node.run(3.0)
    assert node.outcomes == ["stopped"]
    use(node, World())
    n, rest = len(node.sent), node.commanded
    node.run(5.0)
    assert len(node.sent) == n and (node.commanded == rest).all()
    node.ask(GOAL)
    node.run(8.0)
    node.assert_rests_at(GOAL)


def test_search_that_ends_after_the_robot_was_stopped_changes_nothing(node, monkeypatch):
    node.ask(GOAL, duration=4.0)
    node.run(0.5)
    assert use(node, ball_at(place_on_motion(node, 0.6)))

    def serve(*_, **__):
        node.run(3.0)
        assert len(node.sent) == 2  # the thread that watches has stopped the robot
        raise CancelledError

    with monkeypatch.context() as patch:
        patch.setattr(node.server, "serve", serve)
        message, _ = node.server.avoid_obstacle(node._model, not_cancelled)
    assert "there was no time to plan one" in message
    node.run(1.0)
    assert len(node.sent) == 2 and node.outcomes == ["stopped"]


def test_robot_stops_at_once_where_there_is_no_time_to_plan(node):
    node.ask(GOAL, duration=4.0)
    node.run(1.8)
    assert use(node, ball_at(place_on_motion(node, 0.52)))
    message, served = node.server.avoid_obstacle(node._model, not_cancelled)
    assert served is None and "there was no time to plan one" in message
    node.run(5.0)
    node.assert_smooth()
    assert node.outcomes == ["stopped"]


def test_robot_stops_before_an_obstacle_while_a_sequence_is_planned(node):
    node.ask(GOAL, duration=4.0)
    node.run(0.5)
    world, came = ball_at(place_on_motion(node, 0.6)), node.now
    node.at(0.1, lambda: use(node, world))
    node._planning_time = 3.0, 3.0
    node.ask_sequence(HALF, START)
    node.run(6.0)
    node.assert_smooth()
    assert clearance(node, world, came) > 0.0
    assert node.outcomes[0] == "stopped"
    assert "'lower_arm' would hit 'ball'" in node.execution_reports[0][1].message


@pytest.mark.parametrize("fault", ["silent", "held", "refused"])
def test_obstacle_is_avoided_that_came_while_the_robot_was_not_seen_to_move(node, fault):
    node.ask(GOAL, duration=4.0)
    node.run(0.8)
    world, came = ball_at(place_on_motion(node, 0.6)), node.now
    if fault == "refused":
        node.robot.faults.drop = 1.0  # of the next motion alone
        node.ask(HALF, duration=4.0)
        node.run(0.02)
    else:
        setattr(node.robot.faults, fault, True)
        node.run(0.7)
    use(node, world)
    node.run(0.1)
    node.robot.faults.drop = 0.0
    if fault != "refused":
        setattr(node.robot.faults, fault, False)
    node.run(8.0)
    assert clearance(node, world, came) > 0.0
    assert not node.robot.record.v[-1].any()
    expected = ["replaced", "stopped"] if fault == "refused" else ["stopped"]
    assert node.outcomes == expected


def test_threat_to_a_held_robot_is_not_postponed(node):
    # It may move on at any time.
    node.ask(GOAL, duration=4.0)
    node.run(0.8)
    node.robot.faults.held = True
    node.run(0.7)
    node.monitor.surroundings.replace(ball_at(place_on_motion(node, 0.9)), node._model)
    assert node.monitor.surroundings.threat.time <= node.follower.motion_time


def test_motion_around_an_obstacle_does_not_begin_behind_it(node):
    node.ask(GOAL, duration=4.0)
    node.run(0.5)
    world, came = ball_at(place_on_motion(node, 0.6)), node.now
    assert use(node, world)
    # The second attempt expects to take as long as the first one.
    node._planning_time = 1.0, 1.0
    node.at(0.9, lambda: setattr(node, "_planning_time", (0.01, 0.01)))
    node.server.avoid_obstacle(node._model, not_cancelled)
    node.run(8.0)
    node.assert_smooth()
    assert clearance(node, world, came) > 0.0


def test_obstacles_beside_or_behind_the_motion_change_nothing(node):
    node.ask(GOAL, duration=4.0)
    node.run(2.5)
    for world in (ball_at(START), World([Obstacle("far", Sphere(0.1, (3.0, 0.0, 0.0)))]), World()):
        assert not use(node, world)
        assert node.server.avoid_obstacle(node._model, not_cancelled) == ("", None)
    node.run(5.0)
    assert node.outcomes == ["arrived"]
    assert len(node.sent) == 1


def test_rest_of_a_sequence_leaves_out_the_targets_that_were_passed(node):
    early = START + 0.25 * (GOAL - START)
    node.ask_sequence(early, GOAL, times=(2.0, 6.0))
    first = node.monitor.served.plan.motions[0].duration
    rest = node.monitor.served.rest_of_goal(0.5 * first)
    np.testing.assert_array_equal([target.positions for target in rest.targets], [early, GOAL])
    np.testing.assert_array_equal(
        node.monitor.served.rest_of_goal(1.1 * first).state.positions, GOAL
    )
    node.run(1.1 * first)
    world, came = ball_at(place_on_motion(node, 0.58)), node.now
    assert use(node, world)
    message, served = node.server.avoid_obstacle(node._model, not_cancelled)
    assert served is not None, message
    node.run(8.0)
    node.assert_smooth()
    node.assert_rests_at(GOAL)
    assert clearance(node, world, came) >= MARGIN
    assert node.outcomes == ["replaced", "arrived"]


def test_joints_that_the_goal_leaves_out_end_where_they_were_to(node):
    node.ask(GOAL[:2], JOINTS[:2], duration=4.0)
    node.run(0.8)
    rest = node.monitor.served.rest_of_goal(0.8)
    np.testing.assert_array_equal(rest.state.positions, [*GOAL[:2], *START[2:]])
    assert rest.duration is None


def test_motion_that_was_planned_among_older_obstacles_is_planned_again(node):
    node.ask(GOAL)
    node.run(5.0)
    through = place_on_motion(node, 0.5)
    node.ask(START)
    node.run(5.0)
    world = ball_at(through)
    node._planning_time = 0.2, 0.2
    node.at(0.1, lambda: use(node, world))
    came = node.now
    node.ask(GOAL)
    node.run(8.0)
    node.assert_rests_at(GOAL)
    assert clearance(node, world, came) >= MARGIN


def test_newer_goal_takes_the_place_of_the_avoidance(node):
    node.ask(GOAL, duration=4.0)
    node.run(0.8)
    assert use(node, ball_at(GOAL))
    with pytest.raises(CancelledError):
        node.server.avoid_obstacle(node._model, lambda: True)
    assert node.monitor.surroundings.threat is not None
    node.ask(START)
    assert node.monitor.surroundings.threat is None
    node.run(8.0)
    node.assert_smooth()
    node.assert_rests_at(START)
    assert node.outcomes == ["replaced", "arrived"]


def least(motion, world):
    return plain_distances(world, interpolate(motion).q[::5]).min()


def test_stop_leaves_its_path_where_that_alone_keeps_clear_of_an_obstacle(node):
    node.ask(GOAL, duration=1.2)
    node.run(0.55)
    _, motion, _ = node.monitor._stops.find(node._model)
    along = motion.sent
    robot, random, n_clear = arm_robot(), np.random.default_rng(1), 0
    ends = robot.frame_positions(along.positions[-1:], [robot.frame_names[-1]])[0, 0]
    now = plain_distances(World([Obstacle("ball", Sphere(RADIUS, ends))]), node.commanded[None])
    assert now.min() > MARGIN
    for off in random.normal(0.0, 0.03, (12, 3)):
        world = World([Obstacle("ball", Sphere(RADIUS, ends + off))])
        on_path = least(along, world)
        if plain_distances(world, node.commanded[None]).min() < MARGIN:
            continue
        use(node, world)
        _, motion, collision = node.monitor._stops.find(node._model)
        distance = least(motion.sent, world)
        assert distance >= on_path - 1e-3
        named = re.search(r"'ball' (collide|are nearer than the margin)", collision)
        assert (distance >= MARGIN - 1e-4) != bool(named)
        n_clear += on_path < MARGIN <= distance
    assert n_clear > 0


def test_stop_at_a_point_names_the_bodies_that_it_can_not_keep_apart(node):
    node.ask(GOAL, duration=2.5)
    node.run(0.5)
    node.robot.faults.silent = True
    node.run(0.7)
    said, motion, collision = node.monitor._stops.find(node._model)
    assert "single point" in said and not collision
    use(node, ball_at(motion.sent.positions[-1]))
    message = node.stop()
    assert "no stop without a collision was found: 'lower_arm' and 'ball'" in message
    node.robot.faults.silent = False
    node.run(5.0)
    assert node.outcomes == ["stopped"]
    assert "'lower_arm' and 'ball'" in node.execution_reports[0][1].message


def test_stop_is_not_delayed_by_the_check_of_a_motion_in_another_thread(node):
    node.ask(GOAL, duration=1.2)
    node.run(0.55)
    use(node, ball_at(place_on_motion(node, 0.9)))
    with node.monitor.surroundings._lock:
        assert "comes to rest on its path" in node.stop()


def test_stop_comes_whatever_prevents_its_check(node, monkeypatch):
    node.ask(GOAL, duration=1.2)
    node.run(0.55)
    use(node, ball_at(place_on_motion(node, 0.9)))

    def fail(*_):
        raise RuntimeError("an error of the library")

    monkeypatch.setattr(CollisionModel, "collisions", fail)
    assert "comes to rest on its path" in node.stop()
    node.run(5.0)
    assert node.outcomes == ["stopped"]


def test_obstacles_that_do_not_fit_the_robot_are_refused(node):
    kept = ball_at(START)
    use(node, kept)
    wrong = World([Obstacle("ball", Sphere(0.1), "moon")])
    with pytest.raises(WorldError, match="no link is called 'moon'"):
        use(node, wrong)
    assert node.monitor.surroundings.world is kept


def test_goals_are_refused_among_obstacles_that_can_not_be_avoided(monkeypatch):
    bare = served_arm.URDF.replace("collision", "visual")
    monkeypatch.setattr(served_arm, "URDF", bare)
    node = Node(model(collision=True))
    with pytest.raises(RobotError, match="has no collision geometry"):
        use(node, ball_at(START))
    node.ask(GOAL)
    assert node.statuses == ["refused"]
    assert "obstacles can't be avoided" in node.plan_reports[0].message
    use(node, World())
    node.ask(GOAL)
    assert node.statuses[-1] == "served"
