# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The page in a real browser: it loads, and the plan follows the handle."""

import os
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.arm import arm_primitive, arm_robot
from support.patience import HANG

from mp_pca_planner.view.content import PageContent, read_content

pytest.importorskip("playwright", reason="playwright is not installed")
pytest.importorskip("viser", reason="the extra 'view' is not installed")

from support.view_browser import SIZE, arrow_of, chromium, chromium_path, on_screen

from mp_pca_planner.view.page import ViewPage

if chromium_path() is None:
    pytest.skip("chromium is not installed (apt-get install chromium)", allow_module_level=True)

PICTURES = os.environ.get("VIEW_PICTURES")  # folder for screenshots
pytestmark = [pytest.mark.browser, pytest.mark.slow]


FOUND = "text=Motion found"


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as started:
        yield started


def content(**changes: Any) -> PageContent:
    return replace(read_content(arm_robot(), [arm_primitive()]), **changes)


@pytest.fixture
def page() -> Iterator[ViewPage]:
    """A page that rests: a browser without a GPU is slow while the robot moves."""
    with ViewPage(content(), port=0) as served:
        served.player.play(False)
        yield served


def opened(browser: Any, page: ViewPage, text: str = FOUND, size: tuple[int, int] = SIZE) -> Any:
    """A tab of the browser with the page, once it shows an answer."""
    tab = browser.new_page(viewport={"width": size[0], "height": size[1]})
    tab.set_default_timeout(1e3 * HANG)
    tab.goto(page.url)
    tab.wait_for_selector(text)
    return tab


def until(holds: Callable[[], Any]) -> None:
    """Wait until a condition holds."""
    deadline = time.monotonic() + HANG
    while not holds():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def keep(tab: Any, name: str) -> None:
    if PICTURES is not None:
        tab.screenshot(path=str(Path(PICTURES) / f"{name}.png"))


def swipe(tab: Any, page: ViewPage, distance: float) -> None:
    """Press on the y arrow of the goal, and move along it [m]."""
    grip, direction = arrow_of(page)
    start, end = (np.array(on_screen(page, grip + x * direction)) for x in (0.0, distance))
    along = (end - start) / np.linalg.norm(end - start)
    tab.mouse.move(*(start - 3.0))
    tab.mouse.move(*start)
    tab.wait_for_timeout(500)
    tab.mouse.down()
    tab.wait_for_timeout(200)
    for share in np.linspace(0.0, 1.0, 12)[1:]:
        tab.mouse.move(*(start + share * np.linalg.norm(end - start) * along))
        tab.wait_for_timeout(30)
    tab.mouse.up()
    tab.wait_for_timeout(500)


def drag(tab: Any, page: ViewPage, distance: float) -> None:
    """Drag the handle of the goal until it has moved; the scene may still be loading at first."""
    before = np.array(page.plan.handle.position)
    deadline = time.monotonic() + HANG
    while np.array_equal(page.plan.handle.position, before):
        assert time.monotonic() < deadline
        swipe(tab, page, distance)


def wrist(page: ViewPage) -> np.ndarray:
    """Position of the end effector at the goal of the present plan [m]."""
    return page.stage.shapes.frame_pose(page.plan.answer.goal, page.stage.frame)[0]


# Loading


def test_the_page_loads_without_errors_and_without_the_internet(browser, page):
    tab = browser.new_page(viewport={"width": SIZE[0], "height": SIZE[1]})
    tab.set_default_timeout(1e3 * HANG)
    errors, requests = [], []
    tab.on("console", lambda message: message.type == "error" and errors.append(message.text))
    tab.on("pageerror", lambda error: errors.append(str(error)))
    tab.on("request", lambda request: requests.append(request.url))
    tab.goto(page.url)
    tab.wait_for_selector(FOUND)
    until(page.server.get_clients)
    keep(tab, "plan")
    assert errors == []
    assert {url for url in requests if not url.startswith((page.url, f"blob:{page.url}"))} == set()
    tab.close()


# Plans


def test_a_drag_of_the_handle_changes_the_plan_and_the_robot(browser, page):
    tab = opened(browser, page)
    page.player.seek(1.0)
    until(page.server.get_clients)
    before = page.plan.answer
    drag(tab, page, 0.06)
    until(lambda: np.allclose(wrist(page), page.plan.handle.position, rtol=0.0, atol=1e-6))
    after = page.plan.answer
    assert after.problem == ""
    assert np.abs(after.goal - before.goal).max() > 0.01
    until(lambda: np.allclose(page.stage.drawn.configuration, page.plan.answer.goal))
    keep(tab, "dragged")
    tab.close()


def test_a_motion_is_saved_as_the_browser_saves_files(browser, page, tmp_path):
    tab = opened(browser, page)
    with tab.expect_download() as download:
        tab.get_by_role("button", name="CSV").click()
    download.value.save_as(tmp_path / "motion.csv")
    table = np.loadtxt(tmp_path / "motion.csv", delimiter=",", skiprows=1)
    trajectory = page.plan.answer.plan.trajectory
    np.testing.assert_array_equal(table[:, 0], trajectory.times)
    np.testing.assert_array_equal(table[:, 1:5], trajectory.positions)
    tab.close()
