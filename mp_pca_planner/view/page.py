# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The page in the browser: its server, its scene and its panels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..arrays import FloatArray
from ..exceptions import RobotError
from ..files import read_text, reading
from ..motion.collision import CollisionModel, package_folders
from ..primitives.primitive import MovementPrimitive
from ..recordings.reports import RecordingSet
from ..robot.limits import JointLimits
from ..robot.model import Robot
from ..robot.world import World
from .components_panel import NAME as COMPONENTS
from .components_panel import ComponentsPanel
from .demonstrations import recorded, reproduced
from .demonstrations_panel import NAME as DEMONSTRATIONS
from .demonstrations_panel import DemonstrationsPanel
from .motion import ShownMotion
from .plan_panel import NAME as PLAN
from .plan_panel import PlanPanel
from .planning import InteractivePlanner, PlanRequest
from .player import Player
from .robot_shapes import RobotShapes
from .server import PageServer
from .stage import Stage
from .words import lines_html
from .world_panel import NAME as WORLD
from .world_panel import WorldPanel

_BRAND = (0, 82, 130)


@dataclass(frozen=True, eq=False)
class PageContent:
    """What a page shows.

    Attributes
    ----------
    robot : Robot
        The robot of the primitives.
    urdf : str
        Its description, XML text.
    primitives : tuple of MovementPrimitive
        At least one.
    limits : JointLimits
        Limits of its joints.
    folders : sequence of Path
        Folders with the packages of meshes.
    collision : CollisionModel or None
        Collision model of the robot; None: self-collisions are not checked.
    frame : str
        The link that the handle moves; empty: the last one.
    recordings : RecordingSet or None
        Demonstrations; those that the primitives reproduce unless given.
    world : World
        The obstacles at the beginning.
    """

    robot: Robot
    urdf: str
    primitives: Sequence[MovementPrimitive]
    limits: JointLimits
    folders: Sequence[Path] = ()
    collision: CollisionModel | None = None
    frame: str = ""
    recordings: RecordingSet | None = None
    world: World = field(default_factory=World)


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

    Attributes
    ----------
    server : PageServer
        Its server.
    plan : PlanPanel
        The panel of the plan.
    player : Player
        Plays motions.

    Raises
    ------
    PlannerError
        If the address is not one of this machine.
    """

    def __init__(self, content: PageContent, host: str = "127.0.0.1", port: int = 8080) -> None:
        self.server = PageServer(host, port)
        self._content = content
        # Planning and drawing happen in different threads, each with a robot of its own.
        robot = Robot(content.urdf, content.robot.joint_names)
        shapes = RobotShapes(robot, content.urdf, content.folders)
        frame = content.frame or robot.frame_names[-1]
        self.stage = Stage(self.server, robot, content.limits, shapes, frame)
        with self.stage.lock:
            self._add_panels()

    def _add_panels(self) -> None:
        gui, content = self.server.gui, self._content
        gui.set_panel_label(content.robot.name or "Robot")
        self._theme(is_dark=False)
        start, goal = first_ends(content.primitives[0], content.limits)
        self.stage.arrange(start)
        if self.stage.shapes.notes:
            gui.add_html(lines_html(self.stage.shapes.notes[:3]))
        first = ShownMotion(PLAN, np.array([0.0]), start[None])
        self.player = Player(self.stage, PLAN, first)
        tabs = gui.add_tab_group()
        with tabs.add_tab(PLAN):
            planner = InteractivePlanner(
                content.robot, content.primitives, content.limits, content.collision
            )
            request = PlanRequest(start, goal, world=content.world)
            self.plan = PlanPanel(self.stage, self.player, planner, request)
        with tabs.add_tab(COMPONENTS):
            ComponentsPanel(self.stage, self.player, content.primitives)
        with tabs.add_tab(DEMONSTRATIONS):
            self._add_demonstrations()
        with tabs.add_tab(WORLD):
            WorldPanel(self.stage, content.world, lambda world: self.plan.submit(world=world))
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
            brand_color=_BRAND,
        )

    @property
    def url(self) -> str:
        """Address of the page."""
        return self.server.url

    def close(self) -> None:
        """End the threads and the server."""
        self.plan.close()
        self.player.close()
        self.server.stop()

    def __enter__(self) -> ViewPage:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def read_content(
    urdf: Path,
    primitives: Sequence[MovementPrimitive],
    package_dirs: Sequence[Path] = (),
) -> PageContent:
    """The content of a page for primitives and the URDF file of their robot.

    Self-collisions are checked if the robot's collision geometry can be read.

    Parameters
    ----------
    urdf : Path
        The URDF file.
    primitives : sequence of MovementPrimitive
        At least one.
    package_dirs : sequence of Path
        Folders of packages with meshes; searched before ROS's and those above the URDF.

    Raises
    ------
    RobotError
        If the URDF can't be used.
    """
    with reading(f"the URDF file '{urdf}'", RobotError):
        text = read_text(urdf)
    robot = Robot(text, primitives[0].joint_names, source=f"URDF file '{urdf}'")
    folders = package_folders(package_dirs, urdf)
    try:
        collision = CollisionModel(robot, package_dirs=folders)
    except RobotError:  # meshes are missing, which the page states for the visual ones
        collision = None
    return PageContent(robot, text, tuple(primitives), robot.limits(), folders, collision)


def first_ends(primitive: MovementPrimitive, limits: JointLimits) -> tuple[FloatArray, FloatArray]:
    """Start and goal of the demonstration nearest to the mean, within the limits."""
    ends = primitive.boundary_states[:, [0, 3]]
    spread = ends.std(axis=0) + 1e-9
    nearest = np.argmin(np.sum(((ends - ends.mean(axis=0)) / spread) ** 2, axis=(1, 2)))
    start, goal = np.clip(ends[nearest], limits.lower, limits.upper)
    return start, goal
