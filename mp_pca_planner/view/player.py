# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The player of the page: a motion, its clock, and the thread that plays it."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
import viser

from ..arrays import FloatArray
from ..motion.trajectory import Trajectory
from .stage import DrawnRobot, Rgb, Stage

_SPEEDS = ("0.1", "0.25", "0.5", "1", "2")
_PERIOD = 1.0 / 30.0  # between two configurations [s]
_SLIDER_STEPS = 4  # the slider follows every so many
_N_GHOSTS = 4
_GHOST: Rgb = (120, 144, 176)


@dataclass(frozen=True, eq=False)
class ShownMotion:
    """A motion to show.

    Attributes
    ----------
    name : str
        What it is, for people.
    times : array, shape (n_steps,)
        Increasing times [s], the first 0.
    positions : array, shape (n_steps, n_joints)
        Joint positions [rad or m].
    """

    name: str
    times: FloatArray
    positions: FloatArray

    @classmethod
    def of(cls, name: str, trajectory: Trajectory) -> ShownMotion:
        """The motion of a trajectory."""
        return cls(name, trajectory.times, trajectory.positions)

    @property
    def duration(self) -> float:
        """Duration [s]."""
        return float(self.times[-1])

    def at(self, time: float) -> FloatArray:
        """The configuration at a time [s], shape (n_joints,); held before and after the motion."""
        return np.array([np.interp(time, self.times, column) for column in self.positions.T])

    def thinned(self, n: int) -> FloatArray:
        """At most n configurations, evenly spaced in time, ends included."""
        return np.array([self.at(t) for t in np.linspace(0.0, self.duration, n)])


class Playback:
    """The clock of the shown motion.

    Attributes
    ----------
    motion : ShownMotion
        The motion.
    time : float
        Present time in the motion [s].
    speed : float
        Seconds of the motion per second.
    is_playing : bool
        Whether the clock runs. It starts again after the end, with a rest between.
    """

    REST = 0.6
    """Rest at the end of the motion before it starts again [s]."""

    def __init__(self, motion: ShownMotion) -> None:
        self.motion, self.time, self.speed, self.is_playing = motion, 0.0, 1.0, True
        self._rested = 0.0

    @property
    def configuration(self) -> FloatArray:
        """The present configuration, shape (n_joints,)."""
        return self.motion.at(self.time)

    @property
    def share(self) -> float:
        """Share of the motion that has passed, 0 to 1."""
        duration = self.motion.duration
        return min(self.time / duration, 1.0) if duration > 0.0 else 0.0

    def show(self, motion: ShownMotion) -> None:
        """Show another motion, at the same share of its duration."""
        share = self.share
        self.motion = motion
        self.time = share * motion.duration

    def seek(self, share: float) -> None:
        """Go to a share of the motion."""
        self.time, self._rested = share * self.motion.duration, 0.0

    def advance(self, elapsed: float) -> bool:
        """Let time pass [s]; returns whether the configuration may have changed."""
        if not self.is_playing:
            return False
        if self.time < self.motion.duration:
            self.time = min(self.time + self.speed * elapsed, self.motion.duration)
            self._rested = 0.0
            return True
        self._rested += elapsed
        if self._rested < self.REST:
            return False
        self.seek(0.0)
        return True


class Player:
    """Plays one motion at a time.

    Parameters
    ----------
    stage : Stage
        The scene.
    motion : ShownMotion
        The first motion.
    """

    def __init__(self, stage: Stage, motion: ShownMotion) -> None:
        self._stage = stage
        self.playback = Playback(motion)
        gui = stage.server.gui
        self._button = gui.add_button("Pause", icon=viser.Icon.PLAYER_PAUSE)
        self._slider: Any = gui.add_slider("Time [%]", 0, 100, 1, 0)
        with gui.add_folder("Playback", expand_by_default=False):
            self._speed = gui.add_dropdown("Speed", _SPEEDS, initial_value="1")
            self._with_ghosts = gui.add_checkbox("Ghosts", False, hint="The robot on its way")
        self._ghosts: list[DrawnRobot] = []
        stage.on_click(self._button, lambda: self.play(not self.playback.is_playing))
        stage.on_change(self._slider, lambda: self.seek(0.01 * self._slider.value))
        stage.on_change(self._speed, self._on_speed)
        stage.on_change(self._with_ghosts, self._draw_ghosts)
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._run, name="player", daemon=True)
        self._thread.start()

    def show(self, motion: ShownMotion) -> None:
        """Show another motion, at the same share of its duration."""
        self.playback.show(motion)
        self._draw()
        self._draw_ghosts()

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
            with self._stage.caught(), self._stage.lock:
                if self.playback.advance(now - last):
                    self._draw()
                    steps += 1
                    if steps % _SLIDER_STEPS == 0 or self.playback.share in (0.0, 1.0):
                        self._slider.value = round(100 * self.playback.share)
            last = now
