# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Time from a movement of the mouse to the plan that the page shows.

The handle of the goal is dragged in a browser without a GPU. The time is measured in the page: from
the event of the mouse to the change of the figures of the plan in the document. The time of
planning alone is that of the answer. All limits are kept; with obstacles, collisions are avoided.

    python benchmarks/view_latency.py [--moves 60] [--robot human_arm] [--window 1280 800]
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace

import numpy as np
from view_browser import SIZE, arrow_of, chromium, on_screen

from mp_pca_planner.arrays import text_table
from mp_pca_planner.evaluation.problems import robot_file
from mp_pca_planner.primitives.primitive import MovementPrimitive
from mp_pca_planner.recordings.reaches import random_reaches
from mp_pca_planner.recordings.synthetic import generate_motions
from mp_pca_planner.robot.model import Robot
from mp_pca_planner.robot.world import Obstacle, Sphere, World
from mp_pca_planner.view.content import PageContent, first_ends, read_content
from mp_pca_planner.view.page import ViewPage

PAUSE = 0.4  # between two movements [s], so that each answer belongs to one of them
OBSERVE = """() => {
  window.moves = []; window.shown = []; window.drawn = [];
  addEventListener("pointermove", () => window.moves.push(performance.now()), true);
  const figures = [...document.querySelectorAll("table")].find(
    table => table.textContent.includes("Planned in")).closest("div").parentElement;
  new MutationObserver(() => window.shown.push(performance.now())).observe(
    figures, {childList: true, subtree: true, characterData: true});
  let last;
  const look = () => {
    let path;
    window.__viserMutable.nodeRefFromName["/plan/path"].traverse(
      node => { if (node.geometry) path = node.geometry.uuid; });
    if (path !== last) window.drawn.push(performance.now());
    last = path;
    requestAnimationFrame(look);
  };
  look();
}"""


def main() -> None:
    """Print a row without and with obstacles."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--moves", type=int, default=60, help="movements of the mouse")
    parser.add_argument("--window", type=int, nargs=2, default=SIZE, help="its size [pixels]")
    parser.add_argument("--robot", default="human_arm", help="human_arm, panda, ur5 or kinova")
    arguments = parser.parse_args()
    content = content_of(arguments.robot)
    rows = []
    for n_obstacles in (0, 10):
        world = obstacles(content, n_obstacles)
        times = measured(replace(content, world=world), arguments.moves, tuple(arguments.window))
        numbers = [f"{1e3 * value:.0f}" for one in times for value in quantiles(one)]
        rows.append([str(n_obstacles), str(len(times[0])), *numbers])
    header = [
        "obstacles",
        "movements",
        "shown: median [ms]",
        "90 %",
        "drawn: median [ms]",
        "90 %",
        "planned: median [ms]",
        "90 %",
    ]
    print(text_table(rows, header=header))


def content_of(name: str) -> PageContent:
    """The page of a robot with a primitive of generated motions."""
    _, urdf, joints = robot_file(name)
    robot = Robot.from_file(urdf, joints)
    if name == "human_arm":
        demonstrations = generate_motions(30, 1)
    else:
        demonstrations = random_reaches(robot, robot.limits(), 30, 1)
    return read_content(urdf, [MovementPrimitive.fit(demonstrations, name=name)])


def obstacles(content: PageContent, n: int) -> World:
    """Balls on a circle around the goal of the end effector."""
    robot = content.robot
    _, goal = first_ends(content.primitives[0], content.limits)
    centre = robot.frame_positions(goal[None], [robot.frame_names[-1]])[0, 0]
    angles = 2.0 * np.pi * np.arange(n) / max(n, 1)
    places = centre + 0.35 * np.stack([np.cos(angles), np.sin(angles), 0.5 * np.ones(n)], axis=1)
    return World(Obstacle(f"ball {i}", Sphere(0.05, place)) for i, place in enumerate(places))


def measured(
    content: PageContent, n_moves: int, window: tuple[int, int]
) -> tuple[list[float], list[float], list[float]]:
    """Times to figures, to the path and of planning alone for movements to and fro [s]."""
    planned: list[float] = []
    with ViewPage(content, port=0) as page, chromium() as browser:
        page.player.play(False)
        tab = browser.new_page(viewport={"width": window[0], "height": window[1]})
        tab.goto(page.url)
        tab.wait_for_selector("text=Planned in")
        time.sleep(5.0)
        grip, direction = arrow_of(page)
        start, end = (np.array(on_screen(page, grip + x * direction)) for x in (0.0, 0.08))
        tab.mouse.move(*start)
        time.sleep(1.0)
        tab.mouse.down()
        tab.mouse.move(*(start + 0.1 * (end - start)))
        time.sleep(1.0)
        tab.evaluate(OBSERVE)
        for i in range(n_moves):
            share = 0.5 - 0.4 * np.cos(0.4 * i)
            tab.mouse.move(*(start + share * (end - start)))
            time.sleep(PAUSE)
            answer = page.plan.answer
            planned.append(np.nan if answer is None else answer.seconds)
        moves, shown, drawn = (
            np.array(tab.evaluate(f"window.{x}")) for x in ("moves", "shown", "drawn")
        )
        tab.mouse.up()
    return first_after(moves, shown), first_after(moves, drawn), planned


def first_after(moves: np.ndarray, changes: np.ndarray) -> list[float]:
    """Times from movements to the first change after each [s]; one without a change has none."""
    later = [changes[(changes > moved) & (changes < moved + 1e3 * PAUSE)] for moved in moves]
    return [1e-3 * (c[0] - m) for c, m in zip(later, moves, strict=True) if c.size]


def quantiles(values: list[float]) -> tuple[float, float]:
    """Median and 90 %; NaN if nothing was measured."""
    return (
        (float(np.median(values)), float(np.quantile(values, 0.9))) if values else (np.nan, np.nan)
    )


if __name__ == "__main__":
    main()
