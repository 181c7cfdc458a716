# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The panel of the running node: what it does, goals for it, and the stop button."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Sequence
from queue import SimpleQueue
from typing import Any

import numpy as np
import viser

from ..arrays import FloatArray, short
from ..exceptions import PlannerError
from ..robot.limits import JointLimits
from ..robot.world import World
from .content import LiveLink, LiveView, NodeStatus
from .robot_shapes import DrawnRobot, Rgb, add_paths, show_paths
from .stage import BAD, GOOD, GREY, WARNING, Stage, part
from .world_panel import DrawnWorld, WorldEditor

NAME = "Live"
_COLOURS = (GOOD, WARNING, BAD, GREY)
_FIGURES = ("effort_cost", "solve_time_s", "duration", "primitive", "in_span_score", "outcome")
_MEASURED: Rgb = (230, 159, 0)
_PERIOD = 0.05  # between two looks at the node [s]
_TEXT_STEPS = 4  # its text follows every so many
_STALE = 0.5  # age above which joint states count as old [s]


class LivePanel:
    """The running node on the page.

    Parameters
    ----------
    stage : Stage
        The scene.
    link : LiveLink
        The connection to the node; used by the thread of this panel only.
    limits : JointLimits
        Limits of all joints that are shown.

    Attributes
    ----------
    view : LiveView
        What was received up to now.
    """

    def __init__(self, stage: Stage, link: LiveLink, limits: JointLimits) -> None:
        self._stage, self._link, self.view = stage, link, LiveView()
        self._limits = limits
        self._goals: SimpleQueue[dict[str, float]] = SimpleQueue()
        self._drawn_motion: Any = None
        scene = stage.server.scene
        self._measured = DrawnRobot(scene, "/measured", stage.shapes, _MEASURED, 0.6)
        self._measured.visible = False
        self._path = add_paths(scene, "/commanded", _MEASURED, 4.0)
        self._drawn_world, self._obstacles = World(), DrawnWorld(stage, lambda _: None, "/measured")
        self._closed, self._stopping = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._run, name="live", daemon=True)

    def add_stop(self) -> None:
        """Add the stop buttons and their key.

        One is in a window of its own, which stays where the panels are scrolled. Phones have no
        windows: there, the other one stays at the bottom of the screen.
        """
        gui = self._stage.server.gui
        window = gui.add_panel()
        with window.add_tab("Robot"):
            beside = gui.add_button("Stop (S)", color="red", icon=viser.Icon.HAND_STOP)
        window.float(x=15, y=-15, width=200)
        on_top = gui.add_button("Stop the robot", color="red", icon=viser.Icon.HAND_STOP)
        gui.add_html(part("style_on_phones"))
        self._answer = gui.add_html("")
        key = gui.add_command("Stop the robot", hotkey="S", icon=viser.Icon.HAND_STOP)
        # Without the lock of the page: nothing may delay a stop.
        for button in (beside, on_top):
            button.on_click(lambda _: self._stopping.set())
        key.on_trigger(lambda _: self._stopping.set())

    def add_tab(self) -> None:
        """Add the content of the tab, and start."""
        gui = self._stage.server.gui
        self._node = gui.add_html("")
        self._armed: Any = gui.add_checkbox(
            "Armed", False, hint="The handle sends its goals to the robot when it is released"
        )
        self._send = gui.add_button("Send the goal", icon=viser.Icon.SEND, disabled=True)
        self._stage.on_change(self._armed, self._show_armed)
        self._reports = gui.add_html("")
        with gui.add_folder("Joint states"):
            self._states = gui.add_html("")
        with gui.add_folder("Figures of the node", expand_by_default=False):
            self._figures = gui.add_html("")
        self._thread.start()

    def when_sent(self, goal: Callable[[], FloatArray | None]) -> None:
        """Set where the button takes its goal from."""
        self._stage.on_click(self._send, lambda: self.send(goal()))

    def send(self, goal: FloatArray | None) -> None:
        """Send a goal, shape (n_joints,), to the node, if the page is armed."""
        if goal is not None and self._armed.value and not self._stopping.is_set():
            names = self._stage.robot.joint_names
            self._goals.put(dict(zip(names, goal.tolist(), strict=True)))

    @property
    def start(self) -> FloatArray | None:
        """The measured configuration, shape (n_joints,), if there is one."""
        return self.view.configuration(self._stage.robot.joint_names)

    def close(self) -> None:
        """End the thread."""
        self._closed.set()
        if self._thread.is_alive():
            self._thread.join()

    def _show_armed(self) -> None:
        self._send.disabled = not self._armed.value

    def _disarm(self) -> None:
        self._armed.value = False
        self._show_armed()

    def _serve(self) -> None:
        """Stop the robot if a person wants that, else send the goals that wait."""
        if self._stopping.is_set():
            answer = self._link.stop()
            with self._stage.lock:
                self._disarm()
                self._answer.content = part("lines", [answer])
            while not self._goals.empty():
                self._goals.get()
            self._stopping.clear()
        while not (self._goals.empty() or self._stopping.is_set()):
            self._link.send_goal(self._goals.get())

    def _run(self) -> None:
        steps = 0
        while not self._closed.wait(_PERIOD):
            with self._stage.caught():  # the stop button must outlive every error
                try:
                    self._serve()
                    self.view = self._link.view()
                except PlannerError as error:
                    with self._stage.lock:
                        self._answer.content = part("lines", [str(error)])
                # A page that is busy must not delay a stop.
                if self._stage.lock.acquire(timeout=_PERIOD):
                    try:
                        self._show(with_text=steps % _TEXT_STEPS == 0)
                    finally:
                        self._stage.lock.release()
            steps += 1

    def _show(self, *, with_text: bool) -> None:
        with self._stage.server.atomic():
            self._draw()
            if with_text:
                self._write()

    def _draw(self) -> None:
        q, motion = self.start, self.view.motion
        if q is not None and not np.array_equal(q, self._measured.configuration):
            self._measured.show(q)
            self._measured.visible = True
        if motion is not self._drawn_motion:
            self._drawn_motion = motion
            show_paths(self._path, *self._commanded())
        if self.view.world is not self._drawn_world:
            self._draw_world()

    def _draw_world(self) -> None:
        """Draw the obstacles of the node that have changed; those of unknown links are skipped."""
        before = {one.name: one for one in self._drawn_world}
        self._drawn_world = self.view.world
        editor = WorldEditor(self._drawn_world)
        known = ("", *self._stage.robot.frame_names)
        for one in self._drawn_world:
            if before.pop(one.name, None) is not one and one.frame in known:
                self._obstacles.draw(one, editor.place(one.name), editor.parts(one.name))
        for name in before:
            self._obstacles.remove(name)

    def _commanded(self) -> list[FloatArray]:
        """The path of the commanded motion, if it is one of the robot's joints."""
        names, motion = self._stage.robot.joint_names, self.view.motion
        if motion is None or set(motion.joint_names) != set(names):
            return []
        order = [motion.joint_names.index(name) for name in names]
        return [self._stage.path(motion.positions[:, order])]

    def _write(self) -> None:
        now = time.monotonic()
        if self._armed.value and not self.view.has_node(now):
            self._disarm()  # a node that comes back must not get goals unasked
        self._node.content = node_html(self.view, now)
        self._reports.content = reports_html(self.view, now)
        self._states.content = states_html(self.view, self._limits, now)
        self._figures.content = figures_html(self.view)


def node_html(view: LiveView, now: float) -> str:
    """Whether the node runs, and what it says of itself."""
    if view.diagnostics is None:
        return part("verdict", "No node yet", "waiting for a planner node", GREY)
    if not view.has_node(now):
        age = now - view.diagnostics.time
        return part("verdict", "The node is gone", f"nothing was heard of it for {age:.0f} s", BAD)
    return _status_html("Node", view.diagnostics, now)


def reports_html(view: LiveView, now: float) -> str:
    """The goal, the obstacles, the report of the plan, and that of its execution."""
    goal = "none yet" if view.goal is None else f"{view.goal[0]} ({_age(view.goal[1], now)})"
    obstacles = ", ".join(view.world.names) or "none"
    parts = [part("rows", [("Last goal", goal), ("Obstacles", obstacles)])]
    for title, status in (("Plan", view.report), ("Execution", view.execution)):
        if status is not None:
            parts.append(_status_html(title, status, now, _FIGURES))
    return "".join(parts)


def figures_html(view: LiveView) -> str:
    """All figures of the node."""
    if view.diagnostics is None:
        return ""
    return part("rows", [(name, short(value)) for name, value in view.diagnostics.values.items()])


def states_html(view: LiveView, limits: JointLimits, now: float) -> str:
    """The measured joint states within their limits; old ones are pale, those outside are red."""
    ends = zip(limits.lower.tolist(), limits.upper.tolist(), strict=True)
    bounds, rows = dict(zip(limits.joint_names, ends, strict=True)), []
    for name, (q, v, received) in view.states.items():
        low, high = bounds.get(name, (-math.inf, math.inf))
        is_bounded = math.isfinite(high - low) and math.isfinite(q)
        share = min(max((q - low) / (high - low), 0.0), 1.0) if is_bounded else None
        age = now - received if now - received > _STALE else None
        velocity = v if math.isfinite(v) else None
        rows.append((name, q, share, low, high, not low <= q <= high, velocity, age))
    return part("states", rows)


def _status_html(title: str, status: NodeStatus, now: float, figures: Sequence[str] = ()) -> str:
    colour = _COLOURS[min(status.level, len(_COLOURS) - 1)]
    head = part("verdict", f"{title}, {_age(status.time, now)}", status.message, colour)
    known = [(name, status.values[name]) for name in figures if name in status.values]
    rows = [(name, short(value)) for name, value in known if value != "nan"]
    return head + (part("rows", rows) if rows else "")


def _age(time: float, now: float) -> str:
    return f"{now - time:.0f} s ago"
