# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Collisions of motions, of links with each other and with obstacles."""

import re

import numpy as np
import pinocchio as pin
import pytest
from support.arm import arm_demonstrations, arm_primitive, arm_robot
from support.chain import CHAIN, LENGTH, NAMES, RADIUS, chain, chain_planner, motion
from support.patience import PATIENT
from support.worlds import plain_distances, random_world

import mp_pca_planner as mp
from mp_pca_planner.learning.refinement import refine
from mp_pca_planner.motion.collision import CollisionModel
from mp_pca_planner.motion.interpolation import interpolate
from mp_pca_planner.motion.trajectory import Trajectory
from mp_pca_planner.planning.plan import INFEASIBLE
from mp_pca_planner.robot.model import Robot

WATCHED = [("base", "b"), ("base", "c"), ("a", "c")]
SHOWN = arm_demonstrations(8, 3)


def worst(model, trajectory):
    return next(iter(model.collisions(trajectory)), None)


def chain_distances(trajectory):
    """Distances of the watched pairs by Pinocchio, shape (n_samples, n_pairs)."""
    model = pin.buildModelFromXML(CHAIN)
    geometry = pin.buildGeomFromUrdfString(model, CHAIN, pin.GeometryType.COLLISION)
    for links in WATCHED:
        first, second = (["base", "a", "b", "c"].index(name) for name in links)
        geometry.addCollisionPair(pin.CollisionPair(first, second))
    data, found = (model.createData(), geometry.createData()), []
    for q in interpolate(trajectory).q:
        pin.computeDistances(model, data[0], geometry, data[1], q)
        found.append([result.min_distance for result in data[1].distanceResults])
    return np.array(found)


# The check


def test_spheres_meet_where_geometry_says():
    # The third joint alone folds the ends of `a` and `c` onto each other.
    three, model = np.linspace(0.0, 3.0, 100_001), CollisionModel(chain())
    apart = LENGTH * np.sqrt(2.0 * (1.0 + np.cos(three))) - 2.0 * RADIUS
    meeting = three[np.flatnonzero(apart <= 0.0)[0]]
    folding = motion([0.0, 0.9, 0.0], [0.0, 0.9, 3.0])
    dense = interpolate(folding)
    first = dense.times[np.flatnonzero(dense.q[:, 2] >= meeting)[0]]
    # Joints may be in another order, and others locked.
    other = CollisionModel(Robot(CHAIN, ("three", "one"), locked={"two": 0.9}))
    swapped = [x[:, [2, 0]] for x in folding.states]
    for found in (
        worst(model, folding),
        worst(other, Trajectory(("three", "one"), folding.times, *swapped)),
    ):
        assert found.links == ("a", "c")
        assert found.first_time == pytest.approx(first, abs=1.1e-3)
        assert found.time == found.last_time == 1.0
        assert found.penetration == pytest.approx(-apart[-1], abs=1e-5)
    assert worst(model, motion([0.0, 0.9, 0.0], [0.0, 0.9, meeting - 0.01])) is None


def test_bodies_that_meet_between_two_milliseconds_are_found():
    sweep = motion([-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], 0.6)
    dense = interpolate(sweep)
    k = len(dense.times) // 2
    angle, tip = dense.q[k : k + 2, 0].mean(), 3 * LENGTH + RADIUS
    for gap, is_found in ((-1e-5, True), (2e-3, False)):
        at = (tip + 1e-3 + gap) * np.array([np.cos(angle), np.sin(angle), 0.0])
        world = mp.World([mp.Obstacle("speck", mp.Sphere(1e-3, at))])
        with_speck = CollisionModel(chain(), world=world)
        assert not any(map(with_speck.collides, dense.q))
        assert bool(with_speck.collisions(sweep)) == is_found


def test_collisions_of_links_are_those_on_the_grid():
    rng, outcomes, model = np.random.default_rng(4), [], CollisionModel(chain())
    for _ in range(12):
        fold = motion(*rng.uniform([-1.0, 1.5, 1.5], 3.0, (2, 3)), rng.uniform(0.2, 0.6))
        found, clearance, times = worst(model, fold), chain_distances(fold), interpolate(fold).times
        outcomes.append(found is not None)
        assert (found is not None) == (clearance.min() < 1e-6)
        if found is not None:
            assert found.penetration == pytest.approx(-clearance.min(), abs=1e-5)
            pair = clearance[:, WATCHED.index(found.links)]
            assert pair.min() == pytest.approx(clearance.min(), abs=1e-5)
            touching = times[pair < 1e-6]
            assert found.first_time == pytest.approx(touching[0], abs=1e-9)
            assert found.last_time == pytest.approx(touching[-1], abs=1e-9)
    assert 2 < sum(outcomes) < 10


@pytest.mark.parametrize("margin", [0.0, 0.03])
def test_collisions_with_obstacles_are_those_on_the_grid(margin):
    rng, n_found = np.random.default_rng(5), 0
    for shown in SHOWN[:3]:
        columns = shown.times, shown.positions, shown.velocities, shown.accelerations
        trajectory, world = Trajectory(shown.joint_names, *columns), random_world(rng)
        model = CollisionModel(arm_robot(), world=world, margin=margin, self_collision=False)
        found = model.collisions(trajectory)
        dense = interpolate(trajectory)
        plain = plain_distances(world, dense.q) - margin
        for name, distances in zip(world.names, plain.T, strict=True):
            of_it = [one for one in found if one.links[1] == name]
            assert bool(of_it) == bool((distances < 0.0).any())
            if of_it:
                n_found += 1
                first = min(one.first_time for one in of_it)
                assert first == pytest.approx(dense.times[distances < 0.0][0], abs=1e-9)
                assert {one.margin for one in of_it} == {margin}
    assert n_found >= 2


# Plans


def arm_planner(world=None, margin=0.0):
    robot = arm_robot()
    model = CollisionModel(robot, world=world, margin=margin)
    return mp.Planner(robot, [arm_primitive()], robot.limits(), PATIENT, model)


def ball_on_path(trajectory, share=0.55):
    """A world of a sphere where the hand is on a motion."""
    hand = arm_robot().frame_positions(trajectory.positions, ["wrist"])[:, 0]
    at = hand[round(share * (len(hand) - 1))]
    return mp.World([mp.Obstacle("ball", mp.Sphere(0.03, at))])


def clearance(trajectory, world):
    """Least distance of the arm from all obstacles, every millisecond."""
    return float(plain_distances(world, interpolate(trajectory).q).min())


def test_plans_sequences_and_refinements_keep_the_margin_from_obstacles_on_their_path():
    free, n_around, robot = arm_planner(), 0, arm_robot()
    for k, shown in enumerate(SHOWN[:4]):
        start, goal = shown.positions[[0, -1]]
        targets = [SHOWN[1].positions[-1], goal] if k == 3 else goal
        through = free.plan(targets, start).trajectory
        world = ball_on_path(through, 0.2 if k == 3 else 0.55)
        careful = arm_planner(world, margin=0.01)
        plan = careful.plan(targets, start)
        assert clearance(through, world) < 0.0
        if plan.is_executable:
            n_around += 1
            assert clearance(plan.trajectory, world) >= 0.01
            assert "shaped to avoid" in plan.message
            assert plan.facts["start_error"] == plan.goal_error == 0.0
            if k == 3:
                limits = robot.limits()
                found = refine(plan.motions, robot, limits, collision=careful.collision)
                assert clearance(found.trajectory, world) >= 0.01
    assert n_around >= 3


def test_collision_at_an_end_is_infeasible_at_once_and_named():
    start, goal = SHOWN[2].positions[[0, -1]]
    hand = arm_robot().frame_positions(np.array([start, goal]), ["wrist"])[:, 0]
    for name, place in zip(("start", "goal"), hand, strict=True):
        world = mp.World([mp.Obstacle("ball", mp.Sphere(0.02, place))])
        messages = []
        for margin in (0.005, 0.0):
            plan = arm_planner(world, margin).plan(goal, start)
            assert plan.status == INFEASIBLE and not plan.is_executable
            assert plan.message.startswith(f"the {name} is in collision: ")
            messages.append(plan.message.partition("'ball' collide by ")[2].partition(" mm")[0])
        assert float(messages[0]) == float(messages[1]) > 0.0  # the margin is no depth
        assert ("move the robot or the obstacle first" in plan.message) == (name == "start")
    folded = dict(zip(NAMES, [0.0, 0.9, 3.0], strict=True))
    plan = chain_planner(CollisionModel(chain())).plan(folded, [0.0, 0.9, 0.0])
    assert plan.message.startswith("the goal is in collision: 'a' and 'c' collide by")
    assert "SRDF" in plan.message and "another duration" not in plan.message


def test_configuration_for_a_pose_is_one_without_collision():
    # The robot reaches a point before its base with the second link over it only from one side.
    robot = chain()
    point = robot.frame_positions(np.array([[0.3, 1.9, 2.3]]), ["c"])[0, 0]
    plan = chain_planner(CollisionModel(robot)).plan(mp.Pose("c", point), [0.0, 1.5, 1.6])
    assert plan.is_executable and chain_distances(plan.trajectory).min() > 0.0


@pytest.mark.parametrize("duration", [None, 12.0])
def test_clearance_of_the_headline_is_the_least_one_on_a_fine_grid_rounded_down(duration):
    rng, planner, n_near = np.random.default_rng(2), arm_planner(), 0
    for i in range(6):
        targets = [SHOWN[j].positions[-1] for j in rng.permutation(4)[: 1 if duration else 4]]
        motion = planner.plan(targets, SHOWN[i].positions[0], duration=duration).trajectory
        world = ball_on_path(motion, rng.uniform(0.2, 0.8))
        at = world.obstacles[0].shapes[0].position + rng.normal(0.0, 0.08, 3)
        world = mp.World([mp.Obstacle("ball", mp.Sphere(0.03, at))])
        plan = arm_planner(world).plan(targets, SHOWN[i].positions[0], duration=duration)
        least = clearance(plan.trajectory, world)
        if plan.is_executable and least < 0.19:
            n_near += 1
            assert plan.facts["clearance"] == pytest.approx(least - 1e-4, abs=1.1e-4)
            (said,) = re.findall("([0-9]+) mm clear of 'ball'", plan.message)
            assert 1e3 * least - 1.3 <= float(said) <= 1e3 * least + 1e-2
    assert n_near >= 3


@pytest.mark.parametrize("seconds", [1e-9, 5.0])
def test_a_pose_in_an_obstacle_is_named_however_much_time_there_is(seconds):
    start, goal = SHOWN[2].positions[[0, -1]]
    hand = arm_robot().frame_positions(goal[None], ["wrist"])[0, 0]
    world = mp.World([mp.Obstacle("ball", mp.Sphere(0.05, hand))])
    pose, via = mp.Pose("wrist", hand), SHOWN[3].positions[-1]
    for targets, name in ((pose, "the goal"), ([via, pose], "the goal"), ([pose, via], "target 1")):
        plan = arm_planner(world).plan(targets, start, budget=mp.Budget(seconds))
        assert plan.status == INFEASIBLE
        assert plan.message.startswith(f"{name} is in collision: ") and "'ball'" in plan.message
        assert "no configuration that reaches its pose" in plan.message
        assert plan.facts["clearance"] == 0.0 and plan.facts["nearest_obstacle"] == "ball"
