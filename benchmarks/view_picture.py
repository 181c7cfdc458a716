# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The picture of the page in the guide.

python benchmarks/view_picture.py doc/view.png
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path

from view_browser import SIZE, chromium
from view_latency import content_of

from mp_pca_planner.planning.planner import Planner
from mp_pca_planner.robot.world import Box, Obstacle, World
from mp_pca_planner.view.content import PageContent, first_ends
from mp_pca_planner.view.page import ViewPage


def main() -> None:
    """Write the picture."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("picture", type=Path, help="PNG file to write")
    parser.add_argument("--robot", default="panda", help="human_arm, panda, ur5 or kinova")
    arguments = parser.parse_args()
    content = content_of(arguments.robot)
    content = replace(content, world=wall(content), frame=content.robot.frame_names[-1])
    with ViewPage(content, port=0) as page, chromium() as browser:
        page.player.seek(0.4)  # without a GPU, a browser is slow while the robot moves
        tab = browser.new_page(viewport={"width": SIZE[0], "height": SIZE[1]})
        tab.set_default_timeout(180e3)
        tab.goto(page.url)
        tab.get_by_text("Motion found").wait_for()
        tab.get_by_text("Playback", exact=True).click()
        tab.get_by_role("checkbox", name="Ghosts").check()
        for button in tab.locator("button.mantine-Notification-closeButton").all():
            button.click()
        time.sleep(12.0)  # the scene fades in
        tab.screenshot(path=str(arguments.picture))


def wall(content: PageContent) -> World:
    """A box in the way of the end effector."""
    robot = content.robot
    start, goal = first_ends(content.primitives[0], content.limits)
    plan = Planner(robot, content.primitives).plan(goal, start)
    path = robot.frame_positions(plan.trajectory.positions, [robot.frame_names[-1]])[:, 0]
    return World([Obstacle("box", Box((0.1, 0.1, 0.1), path[len(path) // 2] + [0.0, 0.0, -0.12]))])


if __name__ == "__main__":
    main()
