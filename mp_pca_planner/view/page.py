# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The page in the browser: its server, its scene, its panels and their tabs."""

from __future__ import annotations

import numpy as np

from ..robot.model import Robot
from .content import PageContent, first_ends
from .learned import NAME as COMPONENTS
from .learned import ComponentsPanel
from .plan_panel import NAME as PLAN
from .plan_panel import PlanPanel
from .planning import InteractivePlanner, ViewRequest
from .robot_shapes import Rgb, RobotShapes
from .server import PageServer
from .stage import Player, ShownMotion, Stage, part
from .world_panel import NAME as WORLD
from .world_panel import WorldPanel

_BRAND: Rgb = (0, 82, 130)


class ViewPage:
    """A page in the browser, served until it is closed; a context manager.

    Parameters
    ----------
    content : PageContent
        What it shows.
    port : int
        Port, or the first free one after it; 0: any free one.

    Attributes
    ----------
    server : PageServer
        Its server.
    stage : Stage
        Its scene.
    plan : PlanPanel
        The panel of the plan.
    player : Player
        Plays motions.
    """

    def __init__(self, content: PageContent, port: int = 8080) -> None:
        self._content = content
        # Planning and drawing happen in different threads, each with a robot of its own.
        robot = Robot(content.robot.urdf, content.robot.joint_names)
        shapes = RobotShapes(robot, content.folders)
        self.server = PageServer(port)
        self.stage = Stage(self.server, robot, content.limits, shapes)
        try:
            with self.stage.lock:
                self._add_panels()
        except BaseException:
            self.server.stop()
            raise

    def open(self, name: str) -> None:
        """Open a tab: show its subject, and the handles of that only."""
        for tab, folder in self._folders.items():
            folder.visible = tab == name
        self._marks.content = part("tabs_style", list(self._folders).index(name) + 1)
        self.components.set_open(name == COMPONENTS)
        self.world.set_open(name == WORLD)
        # Obstacles change the plan.
        self._verdict.visible = name in (PLAN, WORLD)
        self.plan.set_open(name in (PLAN, WORLD), with_handle=name == PLAN)

    def _add_panels(self) -> None:
        stage, gui, content = self.stage, self.server.gui, self._content
        gui.set_panel_label(content.robot.name or "Robot")
        gui.configure_theme(
            control_width="large", show_logo=False, show_share_button=False, brand_color=_BRAND
        )
        # Beside the scene, which it must not cover.
        gui.main_panel.dock_right()
        start, goal = content.ends or first_ends(content.primitives[0], content.limits)
        stage.arrange(np.array([start, goal]))
        gui.add_html(part("page_style"))
        self._marks = gui.add_html("")
        names = (PLAN, COMPONENTS, WORLD)
        tabs = gui.add_button_group("Tabs", names)
        stage.on_click(tabs, lambda: self.open(tabs.value))
        if stage.shapes.notes:
            gui.add_html(
                part("folded", f"{len(stage.shapes.notes)} shapes are missing", stage.shapes.notes)
            )
        self._verdict = gui.add_html("")
        self.player = Player(stage, ShownMotion(np.zeros(1), start[None]))
        self._folders = {name: gui.add_folder(None) for name in names}
        with self._folders[PLAN]:
            planner = InteractivePlanner(content)
            request = ViewRequest(start, goal, world=content.world)
            self.plan = PlanPanel(stage, self.player, planner, request, self._verdict)
        with self._folders[COMPONENTS]:
            self.components = ComponentsPanel(stage, self.player, content.primitives)
        with self._folders[WORLD]:
            self.world = WorldPanel(
                stage,
                content.world,
                lambda: self.plan.motion,
                lambda world: self.plan.submit(world=world),
            )
        self.open(PLAN)

    @property
    def url(self) -> str:
        """Address of the page."""
        return self.server.url

    def close(self) -> None:
        """End the threads and the server."""
        self.plan.close()
        self.player.close()
        self.server.stop()

    def __repr__(self) -> str:
        return f"ViewPage: {self.url}"

    def __enter__(self) -> ViewPage:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
