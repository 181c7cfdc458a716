# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The animation at the top of the README: a goal and a box are dragged, and motions are played.

    PYTHONPATH=.:test python3 scripts/view_animation.py doc/panda.gif

It shows the page in a browser without a GPU, moved by its own mouse. Each frame is taken when
nothing changes any more, so it does not matter how slow the machine is.
"""

from __future__ import annotations

import argparse
import io
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from scipy.interpolate import CubicSpline
from support.view_browser import chromium, handle_length, on_screen

from mp_pca_planner.primitives.primitive import MovementPrimitive
from mp_pca_planner.recordings.demonstration import Demonstration
from mp_pca_planner.recordings.synthetic import progress
from mp_pca_planner.robot.examples import example_file
from mp_pca_planner.robot.model import Robot
from mp_pca_planner.robot.world import Box, Obstacle, World
from mp_pca_planner.view.content import PageContent, read_content
from mp_pca_planner.view.page import ViewPage
from mp_pca_planner.view.world_panel import NAME as WORLD

SIZE = (640, 480)
SCALE = 2  # of screenshots, which are made smaller for smooth edges
RATE = 12.0  # frames per second [Hz]
N_COLOURS = 80
N_GRABS = 5
PATIENCE = 60.0  # longest time for a plan [s]

CAMERA, AIM, VIEW = (2.6, -0.45, 1.6), (0.25, 0.03, 0.17), 0.51
GOAL_SHIFT = (-0.1, 0.25, 0.0)
BOX = Box((0.2, 0.1, 0.42), (0.88, 0.05, 0.21))
BOX_PLACE = (0.57, 0.05, 0.21)
# Where handles are gripped, as shares of their length: the square between x and y, the arrow of x.
SQUARE, ARROW = np.array([0.255, 0.255, 0.0]), np.array([0.7, 0.0, 0.0])
# From the right of the robot over the middle to its left, the hand downwards [rad].
WAY = np.array(
    [
        [-0.75, 0.45, 0.0, -1.95, 0.0, 2.4, 0.0],
        [-0.05, 0.05, 0.0, -2.05, 0.0, 2.1, 0.75],
        [0.65, 0.45, 0.0, -1.95, 0.0, 2.4, 1.5],
    ]
)

OVERLAY = """() => {
  let panel = [...document.querySelectorAll("button")].find(x => x.textContent.includes("Play"));
  while (!["absolute", "fixed"].includes(getComputedStyle(panel).position))
    panel = panel.parentElement;
  panel.style.display = "none";
  document.querySelectorAll(".mantine-Notifications-root").forEach(x => x.style.display = "none");
  const add = (id, style, html) => {
    const node = document.createElement("div");
    node.id = id; node.innerHTML = html;
    node.style.cssText = "position:fixed;z-index:9999;pointer-events:none;" + style;
    document.body.append(node);
  };
  add("caption", "left:0;bottom:0;width:100%;padding:10px 18px;background:#fff;color:#0b2a40;"
    + "font:600 21px sans-serif", "");
  add("pointer", "left:0;top:0", `<svg width="26" height="32" viewBox="0 0 13 16"><path
    d="M1 1v12.2l3.1-2.8 1.9 4.6 2.2-.9-1.9-4.5h4.2z" fill="#111" stroke="#fff"/></svg>`);
}"""
CAPTION = "text => document.getElementById('caption').textContent = text"
POINTER = """([x, y]) =>
  document.getElementById('pointer').style.transform = `translate(${x - 2}px, ${y - 2}px)`"""


class Camera:
    """Takes the frames of a page, and moves the mouse in it."""

    def __init__(self, page: ViewPage, tab: Any) -> None:
        self.page, self.tab = page, tab
        self.frames: list[Image.Image] = []
        self.mouse = np.array([SIZE[0] + 20.0, 0.8 * SIZE[1]])
        tab.evaluate(OVERLAY)
        self._move(self.mouse)

    def say(self, caption: str) -> None:
        """Change the caption."""
        self.tab.evaluate(CAPTION, caption)

    def take(self, n: int = 1) -> None:
        """Add a frame, n times, as soon as the page has drawn all."""
        if not wait_until(lambda: self.page.plan.is_settled):
            raise TimeoutError(f"no plan within {PATIENCE:.0f} s")
        self.page.server.flush()
        time.sleep(0.1)
        last, now = b"", self.tab.screenshot()
        while last != now:
            last, now = now, self.tab.screenshot()
        picture = Image.open(io.BytesIO(now)).convert("RGB").resize(SIZE, Image.Resampling.LANCZOS)
        self.frames += [picture] * n

    def play(self) -> None:
        """Play the motion of the page."""
        n = round(RATE * self.page.player.motion.duration)
        for i in range(n + 1):
            self.page.player.seek(i / n)
            self.take()

    def point(self, place: np.ndarray, n: int = 6) -> None:
        """Move the mouse to a point of the scene, shape (3,) [m], in n frames."""
        begin, end = self.mouse, self._pixel(place)
        for share in eased(n):
            self._move(begin + share * (end - begin))
            self.take()

    def drag(self, handle: Any, grip: np.ndarray, shift: np.ndarray, n: int = 24) -> None:
        """Drag a handle by a point, as shares of its length, by a shift [m], in n frames."""
        place = np.array(handle.position)
        place += grip * handle_length(self.page, place)
        self.point(place)
        self._grab(handle, place, shift)
        for share in eased(n):
            before = np.array(handle.position)
            self._move(self._pixel(place + share * shift))
            wait_until(lambda before=before: np.any(handle.position != before), 1.0)
            self.take()
        self.tab.mouse.up()

    def _grab(self, handle: Any, place: np.ndarray, shift: np.ndarray) -> None:
        """Press the button on a handle; on a slow machine, the mouse may miss it."""
        (client,) = self.page.server.get_clients().values()
        before = np.array(handle.position)
        for _ in range(N_GRABS):
            self._move(self._pixel(place))
            time.sleep(0.5)
            self.tab.mouse.down()
            self._move(self._pixel(place + 0.03 * shift))
            if wait_until(lambda: np.any(handle.position != before), 5.0):
                return
            self.tab.mouse.up()
            client.camera.position, client.camera.look_at = CAMERA, AIM  # it was turned instead
            time.sleep(1.0)
        raise TimeoutError("the mouse missed the handle")

    def click(self) -> None:
        """Press and release the button of the mouse."""
        self.tab.mouse.down()
        self.tab.mouse.up()

    def _pixel(self, place: np.ndarray) -> np.ndarray:
        return np.array(on_screen(self.page, place)) / SCALE

    def _move(self, pixel: np.ndarray) -> None:
        self.mouse = pixel
        self.tab.mouse.move(*pixel)
        self.tab.evaluate(POINTER, pixel.tolist())


def main() -> None:
    """Write the animation."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("animation", type=Path, help="GIF file to write")
    parser.add_argument("--frames", type=Path, help="folder for the frames as PNG files")
    arguments = parser.parse_args()
    with ViewPage(panda(), port=0) as page, chromium() as browser:
        page.player.seek(0.0)
        page.server.gui.main_panel.float()  # it is hidden: the scene fills the picture
        view = page.server.initial_camera
        view.position, view.look_at, view.fov = CAMERA, AIM, VIEW
        window = {"width": SIZE[0], "height": SIZE[1]}
        tab = browser.new_page(viewport=window, device_scale_factor=SCALE)
        tab.set_default_timeout(60e3)
        tab.goto(page.url)
        tab.get_by_text("Motion found").wait_for(state="attached")
        time.sleep(12.0)  # the scene fades in
        frames = film(Camera(page, tab))
    if arguments.frames:
        arguments.frames.mkdir(exist_ok=True)
        for i, frame in enumerate(frames):
            frame.save(arguments.frames / f"{i:03d}.png")
    write(arguments.animation, frames)
    size = arguments.animation.stat().st_size
    print(f"{len(frames)} frames, {len(frames) / RATE:.1f} s, {size / 1e6:.2f} MB")


def film(camera: Camera) -> list[Image.Image]:
    """The frames of the story."""
    page = camera.page
    camera.say("1. Drag the goal: the plan follows")
    camera.take(3)
    camera.drag(page.plan.handle, SQUARE, np.array(GOAL_SHIFT))
    camera.take(3)
    camera.say("2. The motion plays")
    camera.play()
    camera.take(5)
    camera.say("3. Put a box in the way: the plan takes a detour")
    page.open(WORLD)
    page.plan.submit(start=page.plan.answer.goal, goal=WAY[0], pose=None)
    page.player.seek(0.0)
    camera.take(3)
    camera.point(np.array(BOX.position))
    camera.click()
    shift = np.array(BOX_PLACE) - BOX.position
    camera.drag(page.world.handle, ARROW, shift)
    camera.take(3)
    camera.play()
    camera.take(8)
    return camera.frames


def panda() -> PageContent:
    """A panda that was shown how to reach over the middle, to and fro, and a box beside it."""
    urdf, joints = example_file("panda")
    random = np.random.default_rng(1)
    times = np.linspace(0.0, 2.0, 201)
    curve = CubicSpline([0.0, 0.5, 1.0], np.eye(3), bc_type="natural")(progress(times / 2.0, 0.5))
    demonstrations = []
    for i in range(24):
        way = WAY[:: 1 if i % 2 else -1] + random.normal(0.0, 0.12, WAY.shape)
        demonstrations.append(Demonstration.from_arrays(joints, times, curve @ way))
    primitive = MovementPrimitive.fit(demonstrations, name="reach_over")
    content = read_content(Robot.from_file(urdf, joints), [primitive])
    world = World([Obstacle("box", BOX)])
    return replace(content, world=world, ends=(WAY[0], WAY[-1]))


def eased(n: int) -> Iterator[float]:
    """Shares of a movement that begins and ends at rest, above 0 and up to 1."""
    for i in range(1, n + 1):
        yield 0.5 - 0.5 * float(np.cos(np.pi * i / n))


def wait_until(is_true: Callable[[], bool], longest: float = PATIENCE) -> bool:
    """Wait for a condition, at most a time [s]; returns whether it holds."""
    ends = time.monotonic() + longest
    while not (is_held := is_true()) and time.monotonic() < ends:
        time.sleep(0.02)
    return is_held


def write(path: Path, frames: list[Image.Image]) -> None:
    """Write frames as a GIF that repeats, all with the colours of a few of them."""
    chosen = frames[:: max(1, len(frames) // 12)]
    sheet = Image.new("RGB", (SIZE[0], SIZE[1] * len(chosen)))
    for i, frame in enumerate(chosen):
        sheet.paste(frame, (0, i * SIZE[1]))
    palette = sheet.quantize(N_COLOURS, method=Image.Quantize.MEDIANCUT)
    first, *rest = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    first.save(
        path, save_all=True, append_images=rest, duration=round(1e3 / RATE), loop=0, optimize=True
    )


if __name__ == "__main__":
    main()
