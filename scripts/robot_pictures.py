#!/usr/bin/env python3
# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The arms of the gallery: each with a motion like its demonstrations, as the page shows it.

PYTHONPATH=.:test python3 scripts/robot_pictures.py doc/gallery/robots.png
"""

from __future__ import annotations

import io
import sys
import tempfile
import time
from pathlib import Path

from PIL import Image, ImageDraw, ImageFont
from support.view_browser import chromium

import mp_pca_planner as mp
from mp_pca_planner.cli.example_robots import write_example
from mp_pca_planner.robot.examples import EXAMPLE_ROBOTS, example_file
from mp_pca_planner.view.content import read_content
from mp_pca_planner.view.page import ViewPage

SIZE = (400, 340)
N_COLUMNS = 3
PANEL = 388  # width of the panel beside the scene [pixels]
N_COLOURS = 128


def picture(name: str, browser: object) -> Image.Image:
    """An arm and its first motion, without the panel of the page."""
    with tempfile.TemporaryDirectory() as text:
        folder = Path(text)
        write_example(name, folder, force=True)
        urdf, (_, joints) = folder / "arm.urdf", example_file(name)
        motions = mp.load_demonstrations(folder / "session.mcap", joints=joints)
        robot = mp.Robot.from_file(urdf, joints)
        content = read_content(robot, [mp.MovementPrimitive.fit(motions, name=name)])
        with ViewPage(content, port=0) as page:
            page.player.seek(0.4)
            tab = browser.new_page(viewport={"width": SIZE[0] + PANEL, "height": SIZE[1]})
            tab.set_default_timeout(180e3)
            tab.goto(page.url)
            tab.get_by_text("Motion found").wait_for(state="attached")
            for button in tab.locator("button.mantine-Notification-closeButton").all():
                button.click()
            time.sleep(12.0)  # the scene fades in
            shot = tab.screenshot(clip={"x": 0, "y": 0, "width": SIZE[0], "height": SIZE[1]})
            tab.close()
    found = Image.open(io.BytesIO(shot)).convert("RGB")
    ImageDraw.Draw(found).text((12, 8), name, fill="#0b2a40", font=ImageFont.load_default(20))
    return found


def main() -> None:
    """Write the pictures of all arms into one file."""
    with chromium() as browser:
        found = [picture(name, browser) for name in EXAMPLE_ROBOTS]
    n_rows = -(-len(found) // N_COLUMNS)
    sheet = Image.new("RGB", (N_COLUMNS * SIZE[0], n_rows * SIZE[1]), "white")
    for i, one in enumerate(found):
        sheet.paste(one, (i % N_COLUMNS * SIZE[0], i // N_COLUMNS * SIZE[1]))
    sheet.quantize(N_COLOURS).save(sys.argv[1], optimize=True)


if __name__ == "__main__":
    main()
