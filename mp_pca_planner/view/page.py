# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The page in the browser: its server, its scene, its panels and their tabs."""

from __future__ import annotations

from typing import Any

import numpy as np
import viser

from ..robot.model import Robot
from .content import LiveLink, PageContent, first_ends
from .learned import (
    COMPONENTS,
    DEMONSTRATIONS,
    ComponentsPanel,
    DemonstrationsPanel,
    recorded,
    reproduced,
)
from .live_panel import NAME as LIVE
from .live_panel import LivePanel
from .plan_panel import NAME as PLAN
from .plan_panel import PlanPanel
from .planning import InteractivePlanner, ViewRequest
from .robot_shapes import Rgb, RobotShapes
from .server import PageServer
from .stage import Player, ShownMotion, Stage, part
from .world_panel import NAME as WORLD
from .world_panel import WorldPanel

_BRAND: Rgb = (0, 82, 130)
_LIGHT, _DARK = "Light", "Dark"


class ViewPage:
    """A page in the browser, served until it is closed; a context manager.

    Parameters
    ----------
    content : PageContent
        What it shows.
    host : str
        Address to listen on.
    port : int
        Port, or the first free one after it; 0: any free one.
    link : LiveLink, optional
        A connection to a running node.

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
    live : LivePanel or None
        The panel of the running node.

    Raises
    ------
    PlannerError
        If the address is not one of this machine.
    """

    def __init__(
        self,
        content: PageContent,
        host: str = "127.0.0.1",
        port: int = 8080,
        link: LiveLink | None = None,
    ) -> None:
        self._content = content
        # Planning and drawing happen in different threads, each with a robot of its own.
        robot = Robot(content.urdf, content.robot.joint_names)
        shapes = RobotShapes(robot, content.urdf, content.folders)
        frame = content.frame or robot.end_effector
        self.server = PageServer(host, port)
        self.stage = Stage(self.server, robot, content.limits, shapes, frame)
        every = Robot(content.urdf).limits()
        self.live = None if link is None else LivePanel(self.stage, link, every)
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
        self.demonstrations.set_open(name == DEMONSTRATIONS)
        self.world.set_open(name == WORLD)
        # Obstacles change the plan, and a node gets its goal.
        self.plan.set_open(name in (PLAN, WORLD, LIVE), with_handles=name in (PLAN, LIVE))

    def _add_panels(self) -> None:
        stage, gui, content = self.stage, self.server.gui, self._content
        gui.set_panel_label(content.robot.name or "Robot")
        _set_theme(gui, is_dark=False)
        start, goal = content.ends or first_ends(content.primitives[0], content.limits)
        stage.arrange(np.array([start, goal]))
        gui.add_html(part("style", content.robot.name or "Robot", _LIGHT, _DARK))
        self._marks = gui.add_html("")
        names = (PLAN, COMPONENTS, DEMONSTRATIONS, WORLD, *(() if self.live is None else (LIVE,)))
        tabs = gui.add_button_group("Tabs", names)
        stage.on_click(tabs, lambda: self.open(tabs.value))
        if stage.shapes.notes:
            gui.add_html(part("lines", stage.shapes.notes[:3]))
        if self.live is not None:
            self.live.add_stop()
        self.player = Player(stage, ShownMotion(PLAN, np.zeros(1), start[None]))
        self._folders = {name: gui.add_folder(None) for name in names}
        with self._folders[PLAN]:
            planner = InteractivePlanner(
                content.robot, content.primitives, content.limits, content.collision
            )
            request = ViewRequest(start, goal, world=content.world)
            self.plan = PlanPanel(stage, self.player, planner, request, self.live)
        with self._folders[COMPONENTS]:
            self.components = ComponentsPanel(stage, self.player, content.primitives)
        with self._folders[DEMONSTRATIONS]:
            self.demonstrations = DemonstrationsPanel(stage, self.player, *self._demonstrations())
        with self._folders[WORLD]:
            self.world = WorldPanel(
                stage, content.world, lambda world: self.plan.submit(world=world)
            )
        if self.live is not None:
            with self._folders[LIVE]:
                self.live.add_tab()
            self.live.when_sent(lambda: self.plan.goal)
        colours = gui.add_button_group("Colours", (_LIGHT, _DARK))
        colours.on_click(_on_colours)
        self.open(PLAN)

    def _demonstrations(self) -> tuple[Any, list[str]]:
        """The demonstrations by label, and remarks on them."""
        recordings = self._content.recordings
        if recordings is not None:
            return recorded(recordings), recordings.report.splitlines()
        remark = "As the components reproduce them; --demonstrations BAG shows the recorded ones."
        return reproduced(self._content.primitives), [remark]

    @property
    def url(self) -> str:
        """Address of the page."""
        return self.server.url

    def close(self) -> None:
        """End the threads and the server."""
        if self.live is not None:
            self.live.close()
        self.plan.close()
        self.player.close()
        self.server.stop()

    def __repr__(self) -> str:
        return f"ViewPage: {self.url}"

    def _repr_html_(self) -> str:
        return f'<a href="{self.url}" target="_blank">{self.url}</a>'

    def __enter__(self) -> ViewPage:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _on_colours(event: viser.GuiEvent[Any]) -> None:
    """Give the browser that asked, by its owner or by its own preference, other colours."""
    if event.client is not None:
        _set_theme(event.client.gui, is_dark=event.target.value == _DARK)


def _set_theme(gui: viser.GuiApi, *, is_dark: bool) -> None:
    gui.configure_theme(
        dark_mode=is_dark,
        control_width="large",
        show_logo=False,
        show_share_button=False,
        brand_color=_BRAND,
    )
