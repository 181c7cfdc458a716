# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The picture of the page in the guide.

PYTHONPATH=.:test python3 scripts/view_picture.py doc/view.png
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace

from support.view_browser import SIZE, chromium
from view_animation import panda

from mp_pca_planner.robot.world import Box, Obstacle, World
from mp_pca_planner.view.page import ViewPage


def main() -> None:
    """Write the picture."""
    in_the_way = World([Obstacle("box", Box((0.15, 0.1, 0.3), (0.57, 0.05, 0.15)))])
    with ViewPage(replace(panda(), world=in_the_way), port=0) as page, chromium() as browser:
        page.player.seek(0.4)  # without a GPU, a browser is slow while the robot moves
        tab = browser.new_page(viewport={"width": SIZE[0], "height": SIZE[1]})
        tab.set_default_timeout(180e3)
        tab.goto(page.url)
        tab.get_by_text("Motion found").wait_for()
        for button in tab.locator("button.mantine-Notification-closeButton").all():
            button.click()
        time.sleep(12.0)  # the scene fades in
        tab.screenshot(path=sys.argv[1])


if __name__ == "__main__":
    main()
