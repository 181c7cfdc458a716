# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Plans of the page: the goal that is dragged, and why it is refused."""

from dataclasses import replace

import numpy as np
import pytest
from support.arm import JOINTS, arm_primitive, arm_robot
from support.patience import EVER

from mp_pca_planner.motion.collision import CollisionModel
from mp_pca_planner.motion.goal import Pose
from mp_pca_planner.robot.world import Obstacle, Sphere, World
from mp_pca_planner.view.content import PageContent, first_ends

pytest.importorskip("viser", reason="the extra 'view' is not installed")
from mp_pca_planner.view import planning
from mp_pca_planner.view.planning import InteractivePlanner, ViewRequest, answer_html

FRAME = "wrist"
START, GOAL = first_ends(arm_primitive(), arm_robot().limits())


def planner(*, with_collision: bool = False) -> InteractivePlanner:
    robot = arm_robot()
    collision = CollisionModel(robot) if with_collision else None
    content = PageContent(robot, [arm_primitive()], robot.limits(), collision=collision)
    return InteractivePlanner(content, EVER)


def wrist(q: np.ndarray) -> np.ndarray:
    return arm_robot().frame_positions(q[None], [FRAME])[0, 0]


def test_a_dragged_position_is_reached_and_the_configuration_follows_without_jumps():
    subject = planner()
    place, reached, steps = wrist(GOAL), GOAL, []
    for _ in range(15):
        place = np.add(place, [0.0, 0.005, -0.005])
        answer = subject.answer(ViewRequest(START, reached, Pose(FRAME, place)))
        assert answer.problem == ""
        np.testing.assert_allclose(wrist(answer.goal), place, atol=1e-6)
        steps.append(np.abs(answer.goal - reached).max())
        reached = answer.goal
    assert max(steps) < 0.1


@pytest.mark.parametrize("direction", [(0, 0, 1), (0.3, -1, 0.2)])
def test_a_drag_out_of_reach_is_followed_to_the_nearest_place(direction):
    subject, reached, far = planner(), GOAL, wrist(GOAL)
    for _ in range(25):
        far = far + 0.1 * np.array(direction) / np.linalg.norm(direction)
        answer = subject.answer(ViewRequest(START, reached, Pose(FRAME, far)))
        reached = answer.goal
    assert answer.problem == ""
    end = answer.plan.trajectory.positions[-1]
    np.testing.assert_array_equal(end, reached)
    assert np.linalg.norm(wrist(end) - far) == pytest.approx(answer.distance)
    # Random configurations within the limits come no nearer, whatever the search does.
    limits, rng = arm_robot().limits(), np.random.default_rng(0)
    others = rng.uniform(limits.lower, limits.upper, (20_000, len(JOINTS)))
    places = arm_robot().frame_positions(others, [FRAME])[:, 0]
    assert np.linalg.norm(places - far, axis=1).min() > answer.distance - 0.02


def test_distance_from_a_pose_out_of_reach_is_that_of_its_place():
    pose = Pose(FRAME, np.add(wrist(GOAL), [0.0, 0.0, 0.05]), [0.0, 0.0, 0.0, 1.0])
    answer = planner().answer(ViewRequest(START, GOAL, pose))
    missed = np.linalg.norm(wrist(answer.goal) - pose.position)
    assert answer.distance == pytest.approx(missed, rel=1e-6) and missed > 0.0
    assert f"{1e3 * missed:.0f} mm from the handle" in answer_html(answer)
    assert "turned otherwise" in answer_html(replace(answer, distance=1e-5))


def test_a_goal_in_an_obstacle_is_refused_by_its_name_and_served_again_without_it():
    ball = Obstacle("ball", Sphere(0.08, wrist(GOAL)))
    subject = planner(with_collision=True)
    refused = subject.answer(ViewRequest(START, GOAL, world=World([ball])))
    assert "ball" in refused.problem
    assert subject.answer(ViewRequest(START, GOAL)).problem == ""


def test_a_plan_is_cut_off_early_only_for_a_newer_request(monkeypatch):
    """A busy machine needs longer than a second for a detour; a drag must not wait for it."""
    monkeypatch.setattr(planning, "_TIME_OUTDATED", 1e-6)
    start, goal = arm_primitive().boundary_states[3, [0, 3]]
    path = arm_robot().frame_positions(arm_primitive().predict(start, goal).positions, [FRAME])[
        :, 0
    ]
    ball = Obstacle("ball", Sphere(0.05, path[len(path) // 2]))
    request, subject = ViewRequest(start, goal, world=World([ball])), planner(with_collision=True)
    for is_outdated in (False, True):
        answer = subject.answer(request, lambda outdated=is_outdated: outdated)
        is_cut = "time ran out" in (answer.problem or answer.plan.message)
        assert is_cut == is_outdated, answer


def test_obstacles_that_cannot_be_avoided_are_an_answer():
    ball = Obstacle("ball", Sphere(0.08, [9.0, 9.0, 9.0]))
    answer = planner().answer(ViewRequest(START, GOAL, world=World([ball])))
    assert answer.plan is None and "obstacles can't be avoided" in answer.problem


def test_text_from_files_is_no_markup():
    ball = Obstacle("<script>alert(1)</script>", Sphere(0.08, wrist(GOAL)))
    shown = answer_html(
        planner(with_collision=True).answer(ViewRequest(START, GOAL, world=World([ball])))
    )
    assert "No motion" in shown and "alert(1)" in shown and "<script>" not in shown
