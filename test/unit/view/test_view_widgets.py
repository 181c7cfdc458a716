# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The page without a browser: its tabs, its widgets, and threads that outlive every error."""

import logging
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from support.arm import arm_primitive, arm_robot
from support.patience import HANG

pytest.importorskip("viser", reason="the extra 'view' is not installed")

import mp_pca_planner as mp
from mp_pca_planner.motion.goal import Pose
from mp_pca_planner.planning.planner import Planner
from mp_pca_planner.robot.limits import JointLimits
from mp_pca_planner.view.content import PageContent, read_content
from mp_pca_planner.view.page import ViewPage


def content(**changes: Any) -> PageContent:
    return replace(read_content(arm_robot(), [arm_primitive()]), **changes)


@pytest.fixture
def page() -> Iterator[ViewPage]:
    with ViewPage(content(), port=0) as served:
        served.player.play(False)
        until(lambda: served.plan.is_settled)
        yield served


def until(holds: Callable[[], Any]) -> None:
    deadline = time.monotonic() + HANG
    while not holds():
        assert time.monotonic() < deadline
        time.sleep(0.01)


# Widgets


def test_joint_sliders_have_the_range_of_the_joint_and_its_unit():
    shown = content()
    names, low, high = shown.robot.joint_names, -3.0, np.array([3.2, np.inf, 2.9, 3.0])
    limits = {
        name: {"min_position": low, "max_position": top} if np.isfinite(top) else {}
        for name, top in zip(names, high.tolist(), strict=True)
    }
    limits = JointLimits(names, limits)
    with ViewPage(replace(shown, limits=limits), port=0) as page:
        found = [(s.label, s.min, s.max) for s in page.plan._sliders]
    turn = 2.0 * np.pi
    ends = [(low, 3.2), (-turn, turn), (low, 2.9), (low, 3.0)]
    assert found == [(f"{name} [rad]", *end) for name, end in zip(names, ends, strict=True)]


def test_a_handle_that_is_released_out_of_reach_returns_to_the_end_effector(page):
    far = np.add(page.plan.handle.position, [0.0, 0.0, 3.0])
    page.plan.handle.position = far
    page.plan.submit(pose=Pose(page.stage.frame, far), is_final=True)
    until(lambda: page.plan.is_settled and page.plan.answer.distance > 0.0)
    place = page.stage.path(page.plan.answer.goal[None])[0]
    until(lambda: np.allclose(page.plan.handle.position, place, atol=1e-9))
    assert page.plan.answer.plan.is_executable


@pytest.mark.parametrize("kind", ["Box", "Sphere", "Cylinder"])
def test_a_new_obstacle_is_on_the_path_chosen_and_avoided(page, kind):
    positions = page.plan.motion.positions
    path = page.stage.path(positions)
    page.open("World")
    page.world._on_add(kind)
    until(lambda: page.plan.is_settled and len(page.plan.answer.request.world))
    (obstacle,) = page.plan.answer.request.world
    place = obstacle.shapes[0].position
    assert np.linalg.norm(path - place, axis=1).min() < 2e-3
    assert page.world.handle.visible and not page.plan.handle.visible
    np.testing.assert_allclose(page.world.handle.position, place)
    answer = page.plan.answer
    assert answer.problem == "" and answer.plan.facts["clearance"] > 0.0
    assert f"clear of '{kind.lower()} 1'" in answer.plan.message
    assert answer.plan.message.split(",")[0] in page.plan._verdict.content


def test_a_plan_is_shown_from_python():
    robot, primitive = arm_robot(), arm_primitive()
    planner = Planner(robot, [primitive])
    goal, start = primitive.boundary_states[3, [3, 0]]
    with mp.show(planner, planner.plan(goal, start), port=0) as page:
        until(lambda: page.plan.is_settled)
        request = page.plan.answer.request
        np.testing.assert_allclose([request.start, request.goal], [start, goal], atol=1e-9)
        assert page.url in repr(page)


def test_a_goal_at_the_start_is_no_error(page):
    page.plan._on_start("At the goal")
    until(lambda: page.plan.is_settled and "Already there" in page.plan._verdict.content)
    assert page.plan.answer.problem == ""


# Threads


class SurprisingError(Exception):
    """What no code expects."""


@pytest.mark.parametrize("part", ["answer", "words"])
def test_the_planning_thread_outlives_every_error_logs_and_shows_it(
    page, caplog, monkeypatch, part
):
    def fail(*_: object) -> None:
        raise SurprisingError("a surprise")

    subject = page.plan._planner if part == "answer" else page.plan._ghost
    monkeypatch.setattr(subject, "answer" if part == "answer" else "show", fail)
    with caplog.at_level(logging.ERROR):
        page.plan.submit()
        until(lambda: page.plan.is_settled and caplog.records)
    assert "SurprisingError: a surprise" in caplog.text and "Traceback" in caplog.text
    if part == "answer":
        assert "internal error" in page.plan._verdict.content and page.plan.answer.problem
    monkeypatch.undo()
    page.plan.submit()
    until(lambda: page.plan.is_settled and not page.plan.answer.problem)
    assert "Motion found" in page.plan._verdict.content
