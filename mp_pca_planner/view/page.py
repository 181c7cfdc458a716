# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The page in the browser: its server, its scene and its panels."""

from __future__ import annotations

import numpy as np

from ..robot.model import Robot
from .components import NAME as COMPONENTS
from .components import ComponentsPanel
from .content import PageContent, first_ends
from .demonstrations import NAME as DEMONSTRATIONS
from .demonstrations import DemonstrationsPanel, recorded, reproduced
from .live import LiveLink
from .live_panel import NAME as LIVE
from .live_panel import LivePanel
from .options import PAGE
from .plan_panel import NAME as PLAN
from .plan_panel import PlanPanel
from .planning import InteractivePlanner, ViewRequest
from .player import Player, ShownMotion
from .robot_shapes import RobotShapes
from .server import PageServer
from .stage import Stage
from .words import part
from .world_panel import NAME as WORLD
from .world_panel import WorldPanel


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

    def _add_panels(self) -> None:
        gui, content = self.server.gui, self._content
        gui.set_panel_label(content.robot.name or "Robot")
        self._theme(is_dark=False)
        start, goal = content.ends or first_ends(content.primitives[0], content.limits)
        self.stage.arrange(np.array([start, goal]))
        if self.stage.shapes.notes:
            gui.add_html(part("lines", self.stage.shapes.notes[:3]))
        if self.live is not None:
            self.live.add_stop()
        first = ShownMotion(PLAN, np.array([0.0]), start[None])
        self.player = Player(self.stage, PLAN, first)
        tabs = gui.add_tab_group()
        with tabs.add_tab(PLAN):
            planner = InteractivePlanner(
                content.robot, content.primitives, content.limits, content.collision
            )
            request = ViewRequest(start, goal, world=content.world)
            self.plan = PlanPanel(self.stage, self.player, planner, request, self.live)
        with tabs.add_tab(COMPONENTS):
            ComponentsPanel(self.stage, self.player, content.primitives)
        with tabs.add_tab(DEMONSTRATIONS):
            self._add_demonstrations()
        with tabs.add_tab(WORLD):
            WorldPanel(self.stage, content.world, lambda world: self.plan.submit(world=world))
        if self.live is not None:
            with tabs.add_tab(LIVE):
                self.live.add_tab()
            self.live.when_sent(lambda: self.plan.goal)
        dark = gui.add_checkbox("Dark", False)
        self.stage.on_change(dark, lambda: self._theme(is_dark=dark.value))

    def _add_demonstrations(self) -> None:
        recordings = self._content.recordings
        if recordings is None:
            groups = reproduced(self._content.primitives)
            remarks = [
                "As the components reproduce them; --demonstrations BAG shows the recorded ones."
            ]
        else:
            groups, remarks = recorded(recordings), recordings.report.splitlines()
        DemonstrationsPanel(self.stage, self.player, groups, remarks)

    def _theme(self, *, is_dark: bool) -> None:
        self.server.gui.configure_theme(
            dark_mode=is_dark,
            control_width="large",
            show_logo=False,
            show_share_button=False,
            brand_color=PAGE.brand,
        )

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
