# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The player of the page: what the robot shows, its controls, and the thread that plays it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

import viser

from .drawing import DrawnRobot
from .motion import Playback, ShownMotion
from .stage import Stage

_PERIOD = 1.0 / 30.0  # time between two configurations [s]
_SLIDER_STEPS = 4  # the slider follows every so many of them
_GHOST = (120, 144, 176)
_N_GHOSTS = 4
_SPEEDS = ("0.1", "0.25", "0.5", "1", "2")


class Player:
    """Shows one of the motions that the panels offer.

    Parameters
    ----------
    stage : Stage
        The scene.
    source : str
        Name of the panel that offers the first motion.
    motion : ShownMotion
        That motion.
    """

    def __init__(self, stage: Stage, source: str, motion: ShownMotion) -> None:
        self._stage = stage
        self._offers = {source: motion}
        self._reactions: dict[str, Callable[[bool], None]] = {}
        self.playback = Playback(motion)
        gui = stage.server.gui
        self._source: Any = gui.add_dropdown("Showing", (source,), initial_value=source)
        self._button = gui.add_button("Pause", icon=viser.Icon.PLAYER_PAUSE)
        self._slider: Any = gui.add_slider("Time [%]", 0, 100, 1, 0)
        self._speed = gui.add_dropdown("Speed", _SPEEDS, initial_value="1")
        self._with_ghosts = gui.add_checkbox("Ghosts", False)
        self._ghosts: list[DrawnRobot] = []
        stage.on_change(self._source, self._on_source)
        stage.on_click(self._button, lambda: self.play(not self.playback.is_playing))
        stage.on_change(self._slider, lambda: self.seek(0.01 * self._slider.value))
        stage.on_change(self._speed, self._on_speed)
        stage.on_change(self._with_ghosts, self._draw_ghosts)
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._run, name="player", daemon=True)
        self._thread.start()

    def offer(self, source: str, motion: ShownMotion | None, *, take: bool = True) -> None:
        """Offer a motion of a panel, or None if it has none at present.

        Parameters
        ----------
        source : str
            Name of the panel.
        motion : ShownMotion or None
            The motion.
        take : bool
            Whether it is shown at once, rather than only if the panel's last one was shown.
        """
        if motion is None:
            return
        self._offers[source] = motion
        if set(self._source.options) != set(self._offers):
            self._source.options = tuple(self._offers)
        if take:
            self.take(source)
        if self._source.value == source:
            self.playback.show(motion)
            self._draw()
            self._draw_ghosts()

    def take(self, source: str) -> None:
        """Show the motion that a panel has offered."""
        if self._source.value != source:
            self._source.value = source
            self._on_source()

    def offered(self, source: str) -> ShownMotion:
        """The motion that a panel has offered."""
        return self._offers[source]

    def when_shown(self, source: str, react: Callable[[bool], None]) -> None:
        """Call a function with whether the motion of a panel is shown, when that changes."""
        self._reactions[source] = react
        react(self._source.value == source)

    def play(self, is_playing: bool) -> None:
        """Play or pause."""
        if is_playing and self.playback.share >= 1.0:
            self.playback.seek(0.0)
        self.playback.is_playing = is_playing
        self._button.label = "Pause" if is_playing else "Play"
        self._button.icon = viser.Icon.PLAYER_PAUSE if is_playing else viser.Icon.PLAYER_PLAY

    def seek(self, share: float) -> None:
        """Pause at a share of the motion, 0 to 1."""
        self.play(False)
        self.playback.seek(share)
        self._slider.value = round(100 * share)
        self._draw()

    def close(self) -> None:
        """End the thread."""
        self._closed.set()
        self._thread.join()

    def _announce(self) -> None:
        for source, react in self._reactions.items():
            react(self._source.value == source)

    def _on_source(self) -> None:
        self._announce()
        self.playback.show(self._offers[self._source.value])
        self._draw()
        self._draw_ghosts()

    def _on_speed(self) -> None:
        self.playback.speed = float(self._speed.value)

    def _draw(self) -> None:
        with self._stage.server.atomic():
            self._stage.drawn.show(self.playback.configuration)

    def _draw_ghosts(self) -> None:
        is_shown = self._with_ghosts.value
        if is_shown and not self._ghosts:
            scene, shapes = self._stage.server.scene, self._stage.shapes
            self._ghosts = [
                DrawnRobot(scene, f"/ghosts/{i}", shapes, _GHOST, 0.2) for i in range(_N_GHOSTS)
            ]
        for ghost in self._ghosts:
            ghost.visible = is_shown
        if is_shown:
            configurations = self.playback.motion.thinned(_N_GHOSTS)
            for ghost, q in zip(self._ghosts, configurations, strict=True):
                ghost.show(q)

    def _run(self) -> None:
        last, steps = time.monotonic(), 0
        while not self._closed.wait(_PERIOD):
            now = time.monotonic()
            with self._stage.lock:
                if self.playback.advance(now - last):
                    self._draw()
                    steps += 1
                    if steps % _SLIDER_STEPS == 0 or self.playback.share in (0.0, 1.0):
                        self._slider.value = round(100 * self.playback.share)
            last = now
