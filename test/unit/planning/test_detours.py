# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Paths around obstacles, and the motions along them."""

import math
import sys
from dataclasses import replace
from itertools import count

import numpy as np
import pytest
from support.arm import JOINTS, arm_primitive, arm_robot
from support.arm_plans import planner as arm_planner
from support.arm_plans import request
from support.dense import assert_keeps, spline
from support.motion_referee import RigidArm, SceneReferee
from support.obstacle_scenes import WALL, write_scene

import mp_pca_planner as mp
from mp_pca_planner.files import config_file
from mp_pca_planner.motion.collision import CollisionModel
from mp_pca_planner.motion.goal import JointGoal, JointState
from mp_pca_planner.planning.options import PlannerOptions
from mp_pca_planner.planning.plan import SOLVED
from mp_pca_planner.planning.planner import Planner
from mp_pca_planner.planning.search.detours import sampled_path
from mp_pca_planner.robot.world import World

BOUNDS = np.array([-1.0, -1.0]), np.array([1.0, 1.0])
ENDS = np.array([-0.8, 0.0]), np.array([0.8, 0.0])
# A post in the middle of a motion of the primitive: descent ends at it.
POST = ("post", "box", [0.04, 0.04, 1.2], [0.374, -0.384, 0.14])


def in_maze(q: np.ndarray) -> bool:
    """Two walls with gaps on different sides: no path has a single corner."""
    first, second = abs(q[0] + 0.4) < 0.1 and q[1] < 0.6, abs(q[0] - 0.4) < 0.1 and q[1] > -0.6
    return bool(first or second)


def dense(path: np.ndarray, n: int = 2001) -> np.ndarray:
    lengths = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1)))
    along = np.linspace(0.0, lengths[-1], n)
    return np.stack([np.interp(along, lengths, q) for q in path.T], axis=1)


def test_search_finds_the_way_through_a_maze():
    pytest.importorskip("ompl", reason="OMPL is not installed")
    path = sampled_path(in_maze, BOUNDS, ENDS, step=0.01)
    np.testing.assert_allclose(path[[0, -1]], ENDS)
    # Corners of walls are cut by less than the distance between the configurations checked.
    assert sum(map(in_maze, dense(path))) < 20
    np.testing.assert_array_equal(sampled_path(in_maze, BOUNDS, ENDS, step=0.01), path)
    other = sampled_path(in_maze, BOUNDS, ENDS, seed=2, step=0.01)
    assert other.shape != path.shape or not np.array_equal(other, path)


def test_search_ends_on_request_or_after_enough_checks():
    pytest.importorskip("ompl", reason="OMPL is not installed")
    closed = lambda q: bool(abs(q[0]) < 0.1)  # noqa: E731
    assert sampled_path(closed, BOUNDS, ENDS, max_checks=500) is None
    assert sampled_path(closed, BOUNDS, ENDS, lambda: True) is None


@pytest.fixture
def post(tmp_path):
    """A scene with a post, a planner there, and a motion's ends on both sides of it."""
    scene = write_scene(tmp_path / "scene0001.yaml", [POST])
    robot, primitive = arm_robot(), arm_primitive()
    options = PlannerOptions(max_solve_time=math.inf)
    collision = CollisionModel(robot, world=World.from_file(scene))
    planner = Planner(robot, [primitive], None, options, collision)
    start, goal = primitive.boundary_states[0, [0, 3]]
    return scene, planner, start, goal


def test_detour_avoids_what_descent_does_not(post):
    pytest.importorskip("ompl", reason="OMPL is not installed")
    scene, planner, start, goal = post
    plan = planner.plan(goal, start)
    assert plan.status == "solved"
    assert "a detour, because" in plan.message
    assert "a goal like your demonstrations" in plan.message
    assert plan.facts["correction"] > 0.0
    urdf = config_file("human_arm.urdf")
    referee = SceneReferee(RigidArm(urdf, JOINTS), urdf, scene)
    collision, _ = referee.contacts(plan.trajectory)
    assert collision == ""
    assert_keeps(spline(plan.trajectory), planner.limits)
    np.testing.assert_allclose(plan.trajectory.positions[[0, -1]], [start, goal], atol=1e-12)


def test_refusal_names_bodies_place_and_the_missing_extra(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "ompl", None)
    primitive = arm_primitive()
    start, goal = primitive.boundary_states[0, [0, 3]]
    scene = write_scene(tmp_path / "scene0001.yaml", [WALL])
    options = PlannerOptions(max_solve_time=math.inf)
    collision = CollisionModel(arm_robot(), world=World.from_file(scene))
    assert not (collision.collides(start) or collision.collides(goal))
    # Within these limits there is no way around the wall.
    low, high = np.minimum(start, goal) - 0.05, np.maximum(start, goal) + 0.05
    ranges = zip(low.tolist(), high.tolist(), strict=True)
    bounds = [{"min_position": least, "max_position": most} for least, most in ranges]
    limits = arm_robot().limits(dict(zip(JOINTS, bounds, strict=True)))
    planner = Planner(arm_robot(), [primitive], limits, options, collision)
    near = JointState(JOINTS, start + 0.01)
    for target in (goal, [near, goal]):
        plan = planner.plan(target, start)
        assert plan.status == "infeasible"
        assert "'lower_arm' and 'wall' collide from" in plan.message
        assert "needs the Python module 'ompl'" in plan.message


def test_speed_of_the_clock_changes_no_plan_that_is_not_cut_off(post, monkeypatch):
    _, detours, start, goal = post
    single = {"naturalness": 1e-3, "n_starts": 5}
    problems = {
        "single": (arm_planner(**single, max_solve_time=1.0), *request(2)),
        "shortest": (arm_planner(timing="shortest", max_solve_time=1.0), *request(3)),
        "sequence": (arm_planner(max_solve_time=1.0), [request(4)[0].state, goal], start),
        "detour": (Planner(*_parts(detours), detours.collision), goal, start),
    }
    for name, (subject, aim, begin) in problems.items():
        plans, outcomes = {}, set()
        for per_reading in (0.0, 1e-5, 1e-3, 1e-2, 0.05, 0.3):
            clock = count(0.0, per_reading)
            monkeypatch.setattr("time.perf_counter", lambda clock=clock: next(clock))
            plan = subject.plan(aim, begin)
            plans[per_reading] = plan
            outcomes.add(plan.status)
            if plan.status == SOLVED:
                same = plans[0.0].trajectory.positions
                np.testing.assert_array_equal(plan.trajectory.positions, same)
            else:
                assert "time ran out" in plan.message or "its share of the time" in plan.message
        assert plans[0.0].status == SOLVED and len(outcomes) > 1, name


def _parts(planner):
    options = replace(planner.options, max_solve_time=1.0)
    return planner.robot, planner.primitives, planner.limits, options


def test_legs_between_targets_lead_around_the_wall(tmp_path):
    pytest.importorskip("ompl", reason="OMPL is not installed")
    scene, primitive = write_scene(tmp_path / "scene0001.yaml", [WALL]), arm_primitive()
    start, goal = primitive.boundary_states[0, [0, 3]]
    collision = CollisionModel(arm_robot(), world=World.from_file(scene))
    options = PlannerOptions(max_solve_time=math.inf)
    planner = Planner(arm_robot(), [primitive], None, options, collision)
    plan = planner.plan([goal, start], start, "real_time")
    assert plan.is_executable
    urdf = config_file("human_arm.urdf")
    referee = SceneReferee(RigidArm(urdf, JOINTS), urdf, scene)
    collision, _ = referee.contacts(plan.trajectory)
    assert collision == ""
    passed = np.abs(plan.trajectory.positions - goal).max(axis=1).min()
    assert passed < 0.01
    assert "around obstacles with" in plan.message
    np.testing.assert_allclose(plan.trajectory.positions[[0, -1]], [start, start], atol=1e-12)


def test_goal_in_motion_is_refused_where_no_stop_after_it_is_clear():
    primitive, robot = arm_primitive(), arm_robot()
    start, goal = primitive.boundary_states[0][[0, 3]]
    velocity = 2.0 * (goal - start) / np.abs(goal - start).max()
    limits = robot.limits({joint: {"max_acceleration": 15.0} for joint in JOINTS})
    options = PlannerOptions(allow_nonzero_end_velocity=True)
    request = JointGoal(JointState(JOINTS, goal, velocity)), JointState(JOINTS, start)
    # The fastest stop covers half of v²/a at least.
    beyond = goal + velocity * np.abs(velocity).max() / 30.0
    hand = robot.frame_positions(beyond[None], [robot.frame_names[-1]])[0, 0]
    ball = mp.World([mp.Obstacle("ball", mp.Sphere(0.02, hand))])
    for world, may_execute in ((mp.World(), True), (ball, False)):
        collision = CollisionModel(robot, world=world)
        assert not collision.collides(goal)
        plan = Planner(robot, [primitive], limits, options, collision).plan(*request)
        assert plan.is_executable == may_execute, plan.message
    assert "the motion ends at a velocity, and in the stop after it" in plan.message
    assert "'ball' collide" in plan.message
