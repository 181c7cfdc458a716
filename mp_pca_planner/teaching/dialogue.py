# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The dialogue of a teaching session, and what it says of motions."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from typing import Protocol

import numpy as np

from ..arrays import FloatArray
from ..exceptions import PlannerError
from ..plotting.text import DEGREES, Unit, unit_of
from ..primitives.build import build_primitive
from ..recordings.demonstration import Demonstration
from ..recordings.segmentation import extent
from ..robot.model import Robot
from .session import SessionUpdate, StoredStates, TeachingSession

KEYS = "d discards the last motion, b builds the primitive, q quits; the recording is kept"

# Pauses are at least so many times as long as an update of the session, and a silent source is
# named after so many pauses.
_IDLE_RATIO, _MAX_SILENCE = 4.0, 10


class Source(Protocol):
    """Joint states that come while a session goes on.

    Attributes
    ----------
    pause : float
        Least time between two updates of the session [s].
    """

    pause: float

    def feed(self, record: Callable[[StoredStates], None]) -> None:
        """Pass on what has come, or start to pass on what comes."""

    def silence(self) -> str:
        """Why nothing has come, as far as that is known."""


def hold_dialogue(
    session: TeachingSession,
    source: Source | None,
    pressed: Callable[[float | None], str | None],
    words: SessionWords,
    say: Callable[..., None],
) -> bool:
    """Show motions as they end, until a person ends the session.

    Parameters
    ----------
    session :
        The session.
    source :
        Where its joint states come from; None if all are there.
    pressed :
        Returns the next key; '' if none is pressed within a time [s], None if none can be any more.
    words :
        Describes the motions.
    say :
        Prints lines.

    Returns
    -------
    is_built :
        Whether the primitive is to be built.
    """
    n_silent, n_known = 0, session.n_messages
    while True:
        started = time.monotonic()
        if source is not None:
            source.feed(session.record)
        update = session.update(is_over=source is None)
        say(*words.update_lines(update, session.motions))
        timeout = None
        if source is not None:
            n_silent = n_silent + 1 if session.n_messages == n_known else 0
            if n_silent == _MAX_SILENCE:
                say(source.silence())
            timeout = max(source.pause, _IDLE_RATIO * (time.monotonic() - started))
        key = pressed(timeout)
        if key is None or key == "q":
            return False
        if key == "b":
            say(*words.update_lines(session.update(is_over=True), session.motions))
            if session.motions:
                return True
            say("there is no motion to build a primitive from")
        elif key == "d":
            n = len(session.motions)
            is_done = session.discard_last() is not None
            discarded = f"motion {n} is discarded: {n - 1} left"
            say(discarded if is_done else "there is no motion to discard")
        elif key:
            say(f"'{key}' does nothing: {KEYS}")


class SessionWords:
    """Describes motions and what they teach; places of the end effector with a robot only.

    Parameters
    ----------
    robot : Robot or None
        The robot.
    frame : str
        Its end effector; by default the link that most joints move.
    """

    def __init__(self, robot: Robot | None = None, frame: str = "") -> None:
        self._robot, self._frame = robot, frame

    def update_lines(
        self, update: SessionUpdate, motions: Sequence[Demonstration]
    ) -> Iterator[str]:
        """What an update of a session with these motions says."""
        for note in update.notes:
            yield f"left out: {note}" if motions else f"no motion yet: {note}"
        if update.n_lost:
            yield f"{update.n_lost} earlier motions now have other cuts"
        for motion in update.found:
            unit = self._unit(motion.joint_names)
            length = f"{unit.number(extent(motion.positions))} {unit.name}"
            if self._robot is not None:
                frame, path = self._places(motion.joint_names, motion.positions)
                metres = np.linalg.norm(np.diff(path, axis=0), axis=1).sum()
                length += f", {frame} over {metres:.2f} m"
            number = motions.index(motion) + 1
            yield f"motion {number}: {motion.duration:.2f} s, {length}, accepted"
        if update.found:
            yield from self._learned_lines(motions)

    def _learned_lines(self, motions: Sequence[Demonstration]) -> Iterator[str]:
        """What motions teach: the error of left-out motions, and the range of the goals."""
        if len(motions) < 2:
            yield "  nothing is learned yet: two motions are needed"
            return
        try:
            facts = build_primitive(motions, "taught").summary()
        except PlannerError as error:
            yield f"  nothing is learned yet: {error}"
            return
        names = motions[0].joint_names
        unit, goals = self._unit(names), np.array([motion.positions[-1] for motion in motions])
        left_out, straight = (
            f"{unit.number(facts[name])} {unit.name}"
            for name in ("left_out_error", "minimum_jerk_error")
        )
        yield f"  left-out error {left_out} (straight motions: {straight})"
        yield f"  goals shown {self._si(names)}: {_ranges(names, goals)}"
        if self._robot is not None:
            frame, places = self._places(names, goals)
            yield f"  {frame} at goals [m]: {_ranges('xyz', places)}"

    def place(self, joint_names: Sequence[str], q: FloatArray) -> str:
        """Positions of joints, shape (n_joints,), and the place of the end effector."""
        rounded = np.round(q, 2) + 0.0  # no minus before zero
        joints = ",".join(f"{name}={x:.2f}" for name, x in zip(joint_names, rounded, strict=True))
        text = f"{joints} {self._si(joint_names)}"
        if self._robot is not None:
            frame, places = self._places(joint_names, q[None])
            text += f" ({frame} at {' '.join(f'{x:.2f}' for x in places[0])} m)"
        return text

    def _places(self, joint_names: Sequence[str], q: FloatArray) -> tuple[str, FloatArray]:
        """The end effector that these joints move, and its places [m], shape (n_steps, 3)."""
        assert self._robot is not None
        robot = self._robot.with_joints(joint_names)
        frame = self._frame or robot.end_effector  # of a gripper at rest, the hand
        return frame, robot.frame_positions(q, [frame])[:, 0]

    def _si(self, joint_names: Sequence[str]) -> str:
        """The unit of positions that commands read."""
        unit = self._unit(joint_names)
        return "[rad]" if unit is DEGREES else f"[{unit.name}]"

    def _unit(self, joint_names: Sequence[str]) -> Unit:
        return unit_of(joint_names, self._robot.prismatic_joints if self._robot else ())


def _ranges(names: Sequence[str], values: FloatArray) -> str:
    """Lowest and highest values of each name, given values of shape (n_values, n_names)."""
    bounds = np.round([values.min(axis=0), values.max(axis=0)], 2) + 0.0  # no minus before zero
    rows = zip(names, *bounds, strict=True)
    return ", ".join(f"{name} {a:.2f} to {b:.2f}" for name, a, b in rows)
