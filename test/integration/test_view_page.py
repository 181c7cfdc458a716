# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The page in a real browser: it loads, the plan follows the handle, and people share it."""

import os
import socket
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest
from support.arm import arm_demonstrations, arm_primitive, arm_robot
from support.patience import HANG

from mp_pca_planner.exceptions import PlannerError, RobotError
from mp_pca_planner.files import config_file
from mp_pca_planner.planning.planner import Planner
from mp_pca_planner.recordings.recording_set import RecordingSet
from mp_pca_planner.robot.model import Robot
from mp_pca_planner.robot.world import Obstacle, Sphere, World
from mp_pca_planner.view.content import PageContent, first_ends, read_content, show

pytest.importorskip("playwright", reason="playwright is not installed")
pytest.importorskip("viser", reason="the extra 'view' is not installed")

from playwright.sync_api import expect
from view_browser import SIZE, arrow_of, chromium, chromium_path, on_screen

from mp_pca_planner.view.content import LiveView
from mp_pca_planner.view.page import ViewPage

if chromium_path() is None:
    pytest.skip("chromium is not installed (apt-get install chromium)", allow_module_level=True)

WIDE, PHONE = SIZE, (390, 780)

PICTURES = os.environ.get("VIEW_PICTURES")  # folder for screenshots
FOUND, REFUSED = "text=Motion found", "text=No motion"


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as started:
        yield started


def content(**changes: Any) -> PageContent:
    return replace(read_content(config_file("human_arm.urdf"), [arm_primitive()]), **changes)


@pytest.fixture
def page() -> Iterator[ViewPage]:
    """A page that rests: a browser without a GPU is slow while the robot moves."""
    with ViewPage(content(recordings=RecordingSet(arm_demonstrations())), port=0) as served:
        served.player.play(False)
        yield served


def opened(browser: Any, page: ViewPage, size: tuple[int, int] = WIDE, text: str = FOUND) -> Any:
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


def drag(tab: Any, page: ViewPage, distance: float) -> None:
    """Drag the handle of the goal until it has moved; the scene may still be loading at first."""
    handle, (grip, direction) = page.plan.handle, arrow_of(page)
    before = np.array(handle.position)
    deadline = time.monotonic() + HANG
    while np.array_equal(handle.position, before):
        assert time.monotonic() < deadline
        (x, y), (to_x, to_y) = (on_screen(page, grip + x * direction) for x in (0.0, distance))
        tab.mouse.move(x - 3.0, y)
        tab.mouse.move(x, y)
        tab.wait_for_timeout(500)
        tab.mouse.down()
        tab.wait_for_timeout(200)
        for share in np.linspace(0.0, 1.0, 12)[1:]:
            tab.mouse.move(x + share * (to_x - x), y + share * (to_y - y))
            tab.wait_for_timeout(30)
        tab.mouse.up()
        tab.wait_for_timeout(200)


def wrist(page: ViewPage) -> np.ndarray:
    """Position of the end effector at the goal of the present plan [m]."""
    return page.stage.shapes.frame_pose(page.plan.answer.goal, page.stage.frame)[0]


# Loading


@pytest.mark.parametrize("size", [WIDE, PHONE])
def test_the_page_loads_without_errors_and_without_the_internet(browser, page, size):
    tab = browser.new_page(viewport={"width": size[0], "height": size[1]})
    tab.set_default_timeout(1e3 * HANG)
    errors, requests = [], []
    tab.on("console", lambda message: message.type == "error" and errors.append(message.text))
    tab.on("pageerror", lambda error: errors.append(str(error)))
    tab.on("request", lambda request: requests.append(request.url))
    tab.goto(page.url)
    tab.wait_for_selector(FOUND)
    until(page.server.get_clients)
    keep(tab, f"plan_{size[0]}")
    assert errors == []
    assert {url for url in requests if not url.startswith((page.url, f"blob:{page.url}"))} == set()
    tab.close()


def test_every_tab_and_the_dark_page_are_shown(browser, page):
    tab = opened(browser, page)
    for name, text in (
        ("Components", "Back to the demonstration"),
        ("Demonstrations", "20 motions in 0 usable"),
        ("World", "Add an obstacle"),
    ):
        tab.get_by_role("button", name=name, exact=True).click()
        tab.get_by_text(text).wait_for()
        keep(tab, name.lower())
    tab.get_by_role("button", name="Dark", exact=True).click()
    tab.wait_for_selector('[data-mantine-color-scheme="dark"]')
    keep(tab, "dark")
    tab.close()


def test_no_page_opens_it_to_the_internet(page):
    assert page.server.request_share_url() is None


def test_a_page_for_other_machines_works_by_its_whole_address_only(browser):
    with ViewPage(content(), "0.0.0.0", 0) as page:
        page.player.play(False)
        address = urlsplit(page.url)._replace(netloc=f"127.0.0.1:{page.server.get_port()}")
        tab = browser.new_page()
        tab.set_default_timeout(1e3 * HANG)
        assert tab.goto(address._replace(path="/").geturl()).status == 403
        tab.goto(address.geturl())
        tab.wait_for_selector(FOUND)
        tab.close()


def test_the_page_connects_to_no_server_that_its_address_names(browser, page):
    """That server could run scripts in the page, and these could arm it."""
    with socket.create_server(("127.0.0.1", 0)) as other:
        address = f"ws://127.0.0.1:{other.getsockname()[1]}"
        tab = browser.new_page()
        with tab.expect_console_message(lambda message: f"to: {address}" in message.text):
            tab.goto(f"{page.url}/?websocket={address}")
        tab.wait_for_timeout(2000)
        other.setblocking(False)
        with pytest.raises(BlockingIOError):  # nobody knocked
            other.accept()
        tab.close()


def test_an_address_of_another_machine_is_refused_in_a_sentence():
    with pytest.raises(PlannerError, match="can't be served at '192.0.2.1'"):
        ViewPage(content(), "192.0.2.1", 0)


def test_a_plan_is_shown_from_python():
    planner = Planner(arm_robot(), [arm_primitive()])
    goal, start = arm_primitive().boundary_states[3, [3, 0]]
    plan = planner.plan(goal, start)
    with plan.show(port=0) as page:
        until(lambda: page.plan.is_settled)
        request = page.plan.answer.request
        np.testing.assert_allclose([request.start, request.goal], [start, goal], atol=1e-9)
        assert page.url in repr(page) and page.url in page._repr_html_()
    robot = Robot(config_file("human_arm.urdf").read_text(), arm_robot().joint_names)
    with pytest.raises(RobotError, match=r"Robot\.from_file"):
        show(Planner(robot, [arm_primitive()]))


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


def test_a_goal_in_collision_turns_red_with_its_reason(browser):
    shown = content()
    _, goal = first_ends(arm_primitive(), shown.limits)
    wrist = shown.robot.frame_positions(goal[None], ["wrist"])[0, 0]
    ball = Obstacle("the big ball", Sphere(0.06, wrist))
    with ViewPage(replace(shown, world=World([ball])), port=0) as page:
        tab = opened(browser, page, text=REFUSED)
        title = tab.locator(REFUSED).first
        colour = title.evaluate("element => getComputedStyle(element).color")
        assert colour == "rgb(217, 53, 43)"
        assert "the big ball" in tab.inner_text("body")
        keep(tab, "refused")
        tab.get_by_role("button", name="World", exact=True).click()
        tab.get_by_role("combobox", name="Obstacle").click()
        tab.get_by_role("option", name="the big ball").click()
        tab.get_by_role("button", name="Remove").click()
        tab.get_by_role("button", name="Plan", exact=True).click()
        tab.wait_for_selector(FOUND)
        tab.close()


def test_an_added_obstacle_reaches_the_planner(browser, page):
    tab = opened(browser, page)
    tab.get_by_role("button", name="World", exact=True).click()
    tab.get_by_role("button", name="Sphere", exact=True).click()
    until(lambda: page.plan.answer.request.world.names == ("sphere 1",))
    keep(tab, "obstacle")
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


# Motions


def test_play_moves_the_robot_and_pause_stops_it(browser, page):
    tab = opened(browser, page)
    start = page.stage.drawn.configuration
    still = tab.locator("canvas").first.screenshot()
    tab.get_by_role("button", name="Play").click()
    until(lambda: np.abs(page.stage.drawn.configuration - start).max() > 0.1)
    tab.get_by_role("button", name="Pause").click()
    until(lambda: not page.player.playback.is_playing)
    stopped = page.stage.drawn.configuration
    until(lambda: tab.locator("canvas").first.screenshot() != still)
    np.testing.assert_array_equal(page.stage.drawn.configuration, stopped)
    tab.close()


def test_a_slider_of_a_component_bends_the_motion_that_is_played(browser, page):
    tab = opened(browser, page)
    tab.get_by_role("button", name="Components", exact=True).click()
    slider = tab.get_by_role("slider").filter(visible=True).nth(1)
    before = page.components.motion.positions
    slider.focus()
    for _ in range(10):
        slider.press("ArrowRight")
    until(lambda: np.abs(page.components.motion.positions - before).max() > 0.05)
    until(lambda: page.player.playback.motion is page.components.motion)
    keep(tab, "bent")
    tab.close()


class Link:
    """A connection to a node that only counts stops."""

    def __init__(self) -> None:
        self.n_stops = 0

    def view(self) -> LiveView:
        ball = Obstacle("a ball", Sphere(0.1, [0.3, 0.4, 0.2]))
        return LiveView(world=World([ball]))

    def send_goal(self, positions: object) -> None:
        raise AssertionError("the page is not armed")

    def stop(self) -> str:
        self.n_stops += 1
        return "stopped"


def test_the_stop_button_stays_on_the_screen_of_a_phone(browser):
    link = Link()
    with ViewPage(content(), port=0, link=link) as page:
        page.player.play(False)
        tab = opened(browser, page, PHONE)
        tab.get_by_role("button", name="Live", exact=True).click()
        tab.get_by_text("a ball").wait_for()
        tab.get_by_role("button", name="Dark", exact=True).scroll_into_view_if_needed()
        box = tab.get_by_role("button", name="Stop the robot").bounding_box()
        assert box["width"] == PHONE[0] and box["height"] >= 36.0
        assert box["y"] + box["height"] <= PHONE[1]
        tab.get_by_role("button", name="Stop the robot").click()
        until(lambda: link.n_stops == 1)
        keep(tab, "live_390")
        tab.close()


# Colours and phones


def test_a_page_has_the_colours_that_its_browser_prefers(browser, page):
    tabs = {}
    for scheme in ("dark", "light"):
        tab = tabs[scheme] = browser.new_page(color_scheme=scheme)
        tab.set_default_timeout(1e3 * HANG)
        tab.goto(page.url)
        tab.wait_for_selector(FOUND)
    for scheme, tab in tabs.items():
        tab.wait_for_selector(f'[data-mantine-color-scheme="{scheme}"]')
    assert tabs["light"].title() == "human_arm"
    tabs["light"].emulate_media(color_scheme="dark")
    tabs["light"].wait_for_selector('[data-mantine-color-scheme="dark"]')
    for tab in tabs.values():
        tab.close()


def test_on_a_phone_the_panel_is_a_sheet_that_folds_to_one_row(browser, page):
    tab = opened(browser, page, PHONE)
    sheet = tab.locator('.mantine-Paper-root[style*="max-height: 60%"]')
    box = sheet.bounding_box()
    assert (box["x"], box["width"]) == (0, PHONE[0])
    assert box["y"] + box["height"] == PHONE[1] and box["height"] < 0.6 * PHONE[1]
    names = [tab.get_by_role("button", name=name, exact=True) for name in ("Plan", "World")]
    assert len({name.bounding_box()["y"] for name in names}) == 1  # the tabs are one row
    tab.get_by_role("button", name="Dark", exact=True).scroll_into_view_if_needed()
    tab.get_by_text("human_arm", exact=True).first.click()
    until(lambda: sheet.bounding_box()["height"] < 64.0)
    keep(tab, "folded_390")
    tab.close()


def test_on_a_phone_the_whole_robot_is_above_the_sheet(browser, page):
    tab = opened(browser, page, PHONE)
    until(page.server.get_clients)
    sheet = tab.locator('.mantine-Paper-root[style*="max-height: 60%"]').bounding_box()
    robot, request = page.stage.robot, page.plan.answer.request
    ends = np.array([request.start, request.goal])
    places = robot.frame_positions(ends, robot.frame_names).reshape(-1, 3)
    until(lambda: max(on_screen(page, place)[1] for place in places) < sheet["y"])
    pixels = np.array([on_screen(page, place) for place in places])
    assert np.all(pixels > 0.0) and np.all(pixels[:, 0] < PHONE[0])
    tab.close()


# Several people


def test_two_browsers_share_the_page_and_a_reload_keeps_it(browser, page):
    first, second = opened(browser, page), opened(browser, page, PHONE)
    boxes = [tab.get_by_role("checkbox", name="Orientation too") for tab in (first, second)]
    boxes[0].check()
    expect(boxes[1]).to_be_checked(timeout=1e3 * HANG)
    until(lambda: page.plan.answer.request.pose is not None)
    first.reload()
    expect(boxes[0]).to_be_checked(timeout=1e3 * HANG)
    first.wait_for_selector(FOUND)
    second.close()
    first.close()
