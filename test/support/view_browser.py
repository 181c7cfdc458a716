# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A browser without a display that shows the page of `view`, and the mouse in it."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from mp_pca_planner.view.page import ViewPage
from mp_pca_planner.view.stage import HANDLE_LENGTH

SIZE = (1280, 800)
"""Width and height of a browser window [pixels]."""

_NAMES = ("chromium", "chromium-browser", "google-chrome")
_SOFTWARE_GL = ("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")


def chromium_path() -> str | None:
    """The installed Chromium or Chrome, if there is one."""
    return next(filter(None, map(shutil.which, _NAMES)), None)


@contextmanager
def chromium() -> Iterator[Any]:
    """Playwright's browser; it renders without a GPU."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        browser = driver.chromium.launch(
            executable_path=chromium_path(), args=["--no-sandbox", *_SOFTWARE_GL]
        )
        yield browser
        browser.close()


def on_screen(page: ViewPage, point: np.ndarray) -> tuple[float, float]:
    """Where a point of the scene, shape (3,) [m], is in the only open window [pixels]."""
    import viser

    (client,) = page.server.get_clients().values()
    camera = client.camera
    turn = viser.transforms.SO3(camera.wxyz).as_matrix()
    x, y, z = turn.T @ (point - camera.position)
    width, height = camera.image_width, camera.image_height
    focal = 0.5 * height / np.tan(0.5 * camera.fov)
    return float(width / 2 + focal * x / z), float(height / 2 + focal * y / z)


def handle_length(page: ViewPage, place: np.ndarray) -> float:
    """Length of the arrows of a handle at a point of the scene, shape (3,) [m]."""
    import viser

    (client,) = page.server.get_clients().values()
    camera = client.camera
    depth = viser.transforms.SO3(camera.wxyz).as_matrix()[:, 2] @ (place - camera.position)
    return float(HANDLE_LENGTH * depth * 2.0 * np.tan(0.5 * camera.fov) / camera.image_height)


def arrow_of(page: ViewPage) -> tuple[np.ndarray, np.ndarray]:
    """A point on the y arrow of the goal's handle, and its direction, each of shape (3,) [m]."""
    place = np.array(page.plan.handle.position)
    direction = np.array([0.0, 1.0, 0.0])
    return place + 0.6 * handle_length(page, place) * direction, direction
