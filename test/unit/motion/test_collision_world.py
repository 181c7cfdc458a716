# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Motions among obstacles, checked on a grid of 1 ms by plain calls of Pinocchio."""

import json
import re

import numpy as np
import pytest
import yaml
from support.arm import arm_demonstrations, arm_primitive, arm_robot
from support.patience import PATIENT
from support.worlds import plain_distances, random_world

import mp_pca_planner as mp
from mp_pca_planner.cli.main import main
from mp_pca_planner.files import config_file
from mp_pca_planner.learning.refinement import refine
from mp_pca_planner.motion.collision import CollisionModel
from mp_pca_planner.motion.interpolation import interpolate
from mp_pca_planner.motion.trajectory import Trajectory
from mp_pca_planner.planning.plan import INFEASIBLE
from mp_pca_planner.primitives.file import save_primitive

SHOWN = arm_demonstrations(8, 3)


def between(k: int) -> tuple[np.ndarray, np.ndarray]:
    return SHOWN[k].positions[0], SHOWN[k].positions[-1]


def planner(world: mp.World, margin: float = 0.0) -> mp.Planner:
    robot = arm_robot()
    model = CollisionModel(robot, world=world, margin=margin)
    return mp.Planner(robot, [arm_primitive()], robot.limits(), PATIENT, model)


def ball_on_path(trajectory: Trajectory, radius: float = 0.03, share: float = 0.55) -> mp.Sphere:
    """A sphere where the hand is on a motion."""
    robot = arm_robot()
    hand = robot.frame_positions(trajectory.positions, [robot.frame_names[-1]])[:, 0]
    return mp.Sphere(radius, hand[round(share * (len(hand) - 1))])


def clearance(trajectory: Trajectory, world: mp.World) -> float:
    """Least distance of the arm from all obstacles, every millisecond."""
    return float(plain_distances(world, interpolate(trajectory).q).min())


@pytest.mark.parametrize("margin", [0.0, 0.03])
def test_collisions_of_motions_are_those_on_the_grid(margin: float) -> None:
    rng, n_found = np.random.default_rng(5), 0
    free = mp.Planner(arm_robot(), [arm_primitive()], options=PATIENT)
    for k in range(3):
        start, goal = between(k)
        trajectory, world = free.plan(goal, start).trajectory, random_world(rng)
        model = CollisionModel(arm_robot(), world=world, margin=margin, self_collision=False)
        all_found = model.collisions(trajectory)
        found = {one.links[1]: one for one in all_found}
        dense = interpolate(trajectory)
        plain = plain_distances(world, dense.q) - margin
        for name, distances in zip(world.names, plain.T, strict=True):
            assert (name in found) == bool((distances < 0.0).any())
            if name in found:
                n_found += 1
                times = dense.times[distances < 0.0]
                first = min(one.first_time for one in all_found if one.links[1] == name)
                assert first == pytest.approx(times[0], abs=1e-9)
                assert found[name].margin == margin
    assert n_found >= 2


def test_planned_motions_keep_the_margin_from_obstacles_on_their_path() -> None:
    free, n_around = planner(mp.World()), 0
    for k in range(4):
        start, goal = between(k)
        through = free.plan(goal, start).trajectory
        world = mp.World([mp.Obstacle("ball", ball_on_path(through))])
        plan = planner(world, margin=0.01).plan(goal, start)
        assert clearance(through, world) < 0.0
        if plan.is_executable:
            n_around += 1
            assert clearance(plan.trajectory, world) >= 0.01
            assert "kept apart" in plan.message
            assert plan.facts["start_error"] == plan.goal_error == 0.0
    assert n_around >= 3


def test_sequences_and_refinements_keep_clear_of_obstacles() -> None:
    (start, via), (_, goal) = between(0), between(1)
    bare = planner(mp.World()).plan([via, goal], start)
    ball = ball_on_path(bare.trajectory, share=0.2)
    world = mp.World([mp.Obstacle("ball", ball)])
    careful = planner(world)
    plan = careful.plan([via, goal], start)
    assert clearance(bare.trajectory, world) < 0.0
    assert plan.is_executable and clearance(plan.trajectory, world) >= 0.0
    robot = arm_robot()
    found = refine(plan.motions, robot, robot.limits(), collision=careful.collision)
    assert clearance(found.trajectory, world) >= 0.0


def test_refusal_names_both_bodies_and_the_end_in_collision() -> None:
    start, goal = between(2)
    robot = arm_robot()
    hand = robot.frame_positions(np.array([start, goal]), [robot.frame_names[-1]])[:, 0]
    for name, place in zip(("start", "goal"), hand, strict=True):
        world = mp.World([mp.Obstacle("ball", mp.Sphere(0.02, place))])
        plan = planner(world, margin=0.005).plan(goal, start)
        assert plan.status == INFEASIBLE
        assert plan.message.startswith(f"the {name} is in collision: ")
        (deep,) = re.findall(r"'ball' collide by (\S+) mm", plan.message)
        bare = planner(world).plan(goal, start).message
        assert f"'ball' collide by {deep} mm" in bare  # the margin is no depth
        assert ("move the robot or the obstacle first" in plan.message) == (name == "start")


def test_plan_avoids_the_obstacles_of_a_file(tmp_path, capsys) -> None:
    start, goal = between(0)
    through = planner(mp.World()).plan(goal, start).trajectory
    ball = ball_on_path(through)
    one = {
        "id": "ball",
        "primitives": [{"type": "sphere", "dimensions": [ball.radius]}],
        "primitive_poses": [{"position": ball.position.tolist()}],
    }
    scene = tmp_path / "scene.yaml"
    scene.write_text(yaml.safe_dump({"world": {"collision_objects": [one]}}), encoding="utf-8")
    save_primitive(arm_primitive(), tmp_path / "arm.npz")
    ends = [",".join(map(str, q)) for q in (start, goal)]
    arguments = ["plan", str(tmp_path / "arm.npz"), "--robot", str(config_file("human_arm.urdf"))]
    arguments += [f"--start={ends[0]}", f"--goal={ends[1]}", "--json"]
    assert main([*arguments, "--obstacles", str(scene), "--margin", "0.01"]) == 0
    facts = json.loads(capsys.readouterr().out)
    columns = (np.array(facts[key]) for key in ("times", "positions", "velocities"))
    trajectory = Trajectory(facts["joint_names"], *columns, np.array(facts["accelerations"]))
    assert clearance(trajectory, mp.World([mp.Obstacle("ball", ball)])) >= 0.01
    assert facts["collision"].startswith("none; ")
    assert main([*arguments, "--margin", "0.01"]) == 2
    assert "--margin is the clearance from --obstacles" in capsys.readouterr().err
    assert main([*arguments, "--obstacles", str(tmp_path / "no.yaml")]) == 2
    assert "no.yaml' can't be read" in capsys.readouterr().err
