# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The dialogue of a teaching session: what it says of motions, and recordings played into it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

from ..arrays import FloatArray
from ..exceptions import PlannerError
from ..plotting.text import DEGREES, Unit, unit_of
from ..primitives.build import PrimitiveOptions
from ..primitives.differences import leave_one_out
from ..recordings.bags import choose_topic, from_cdr, open_bag, to_cdr
from ..recordings.bags.bag import damage_reported
from ..recordings.demonstration import Demonstration
from ..recordings.segmentation import extent
from ..robot.model import Robot
from .session import SessionUpdate, TeachingSession

KEYS = "d discards the last motion, b builds the primitive, q quits; the recording is kept"

# Pauses are at least so many times as long as an update of the session, and a silent source is
# named after so many pauses.
_IDLE_RATIO, _MAX_SILENCE = 4.0, 10

Record = Callable[[Sequence[tuple[int, bytes]]], None]
"""Stores serialised messages with their times of reception [ns]."""


def hold_dialogue(
    session: TeachingSession,
    feed: Callable[[Record], bool],
    pressed: Callable[[float | None], str | None],
    words: SessionWords,
    say: Callable[..., None],
    *,
    pause: float = 0.0,
    silence: Callable[[], str] = lambda: "",
) -> bool:
    """Show motions as they end, until a person ends the session.

    Parameters
    ----------
    session :
        The session.
    feed :
        Records what has come; returns whether more may follow.
    pressed :
        Returns the next key; '' if none is pressed within a time [s], None if none can be any more.
    words :
        Describes the motions.
    say :
        Prints lines.
    pause :
        Least time between two looks at what was recorded [s]; 0: keys count when nothing follows.
    silence :
        Returns why nothing has come, as far as that is known.

    Returns
    -------
    is_built :
        Whether the primitive is to be built.
    """
    is_fed, n_silent, n_known = True, 0, session.n_messages
    while True:
        started = time.monotonic()
        is_fed = is_fed and feed(session.record)
        update = session.update(is_over=not is_fed, explains=not is_fed or pause > 0.0)
        say(*words.update_lines(update, session.motions))
        if is_fed and not pause:
            continue
        n_silent = n_silent + 1 if session.n_messages == n_known else 0
        if n_silent == _MAX_SILENCE and is_fed:
            say(silence())
        idle = max(pause, _IDLE_RATIO * (time.monotonic() - started))
        key = pressed(idle if is_fed else None)
        if key is None or key == "q":
            return False
        if key == "b":
            say(*words.update_lines(session.update(is_over=True), session.motions))
            if session.motions:
                return True
            say("there is no motion to build a primitive from")
        elif key == "d":
            discarded = session.discard_last()
            say("there is no motion to discard" if discarded is None else _discarded(session))
        elif key:
            say(f"'{key}' does nothing: {KEYS}")


def _discarded(session: TeachingSession) -> str:
    n = len(session.motions)
    return f"motion {n + 1} is discarded: {n} left"


class PlayedBag:
    """Joint states of a bag, part by part and as fast as they are taken.

    Parameters
    ----------
    path : Path
        The recording.
    topic : str or None
        Topic of the joint states; by default the only one.
    n_parts : int
        Number of parts.

    Attributes
    ----------
    topic : str
        Topic of the joint states.

    Raises
    ------
    RecordingError
        If it can't be read, or has no such topic of joint states.
    """

    def __init__(self, path: Path, topic: str | None = None, n_parts: int = 50) -> None:
        with open_bag(path) as bag, damage_reported(path, bag.format):
            chosen = choose_topic(bag.topics, topic)
            convert = to_cdr if bag.format == "rosbag1" else bytes
            self._left = [(stamp, convert(x)) for _, stamp, x in bag.messages([chosen])]
        self.topic = chosen.name
        self._n = -(-len(self._left) // n_parts)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Joints of its first message."""
        return tuple(from_cdr(self._left[0][1]).name)

    def skip_until(self, stamp: int) -> int:
        """Leave out what was received up to a time [ns]; returns the number of these messages."""
        before = len(self._left)
        self._left = [message for message in self._left if message[0] > stamp]
        return before - len(self._left)

    def feed(self, record: Record) -> bool:
        """Record the next part; returns whether another one follows."""
        part, self._left = self._left[: self._n], self._left[self._n :]
        record(part)
        return bool(self._left)


# Largest number of demonstrations that are left out, one by one.
_MAX_LEFT_OUT = 20


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
        self._robot = robot
        self._frame = frame

    def update_lines(
        self, update: SessionUpdate, motions: Sequence[Demonstration]
    ) -> Iterator[str]:
        """What an update of a session with these motions says."""
        found, n_lost, notes = update
        for note in notes:
            yield f"left out: {note}" if motions else f"no motion yet: {note}"
        if n_lost:
            yield f"{n_lost} earlier motions now have other cuts"
        for motion in found:
            number = motions.index(motion) + 1
            yield f"motion {number}: {motion.duration:.2f} s, {self._length(motion)}, accepted"
        if found:
            yield from self.learned_lines(motions)

    def learned_lines(self, motions: Sequence[Demonstration]) -> Iterator[str]:
        """What motions teach: the error of left-out motions, and the range of the goals."""
        if len(motions) < 2:
            yield "  nothing is learned yet: two motions are needed"
            return
        every = -(-len(motions) // _MAX_LEFT_OUT)
        try:
            errors = leave_one_out(motions, PrimitiveOptions(), range(0, len(motions), every)).rms()
        except PlannerError as error:
            yield f"  nothing is learned yet: {error}"
            return
        names = motions[0].joint_names
        unit, goals = self._unit(names), np.array([motion.positions[-1] for motion in motions])
        yield (
            f"  left-out error {unit.number(errors[2, 0])} {unit.name} (straight motions: "
            f"{unit.number(errors[0, 0])} {unit.name})"
        )
        shown = _ranges(names, goals.min(axis=0), goals.max(axis=0))
        yield f"  goals shown {self._si(names)}: {shown}"
        if self._robot is not None:
            frame, places = self._places(names, goals)
            shown = _ranges("xyz", places.min(axis=0), places.max(axis=0))
            yield f"  {frame} at goals [m]: {shown}"

    def place(self, joint_names: Sequence[str], q: FloatArray) -> str:
        """Positions of joints, shape (n_joints,), and the place of the end effector."""
        rounded = np.round(q, 2) + 0.0  # no minus before zero
        joints = ",".join(f"{name}={x:.2f}" for name, x in zip(joint_names, rounded, strict=True))
        joints = f"{joints} {self._si(joint_names)}"
        if self._robot is None:
            return joints
        frame, places = self._places(joint_names, q[None])
        x, y, z = (f"{value:.2f}" for value in places[0])
        return f"{joints} ({frame} at {x} {y} {z} m)"

    def _places(self, joint_names: Sequence[str], q: FloatArray) -> tuple[str, FloatArray]:
        """The end effector that these joints move, and its places [m], shape (n_steps, 3)."""
        assert self._robot is not None
        robot = self._robot.with_joints(joint_names)
        frame = self._frame or robot.end_effector  # of a gripper at rest, the hand
        return frame, robot.frame_positions(q, [frame])[:, 0]

    def _length(self, motion: Demonstration) -> str:
        unit = self._unit(motion.joint_names)
        text = f"{unit.number(extent(motion.positions))} {unit.name}"
        if self._robot is None:
            return text
        frame, path = self._places(motion.joint_names, motion.positions)
        length = np.linalg.norm(np.diff(path, axis=0), axis=1).sum()
        return f"{text}, {frame} over {length:.2f} m"

    def _si(self, joint_names: Sequence[str]) -> str:
        """The unit of positions that commands read."""
        unit = self._unit(joint_names)
        return "[rad]" if unit is DEGREES else f"[{unit.name}]"

    def _unit(self, joint_names: Sequence[str]) -> Unit:
        return unit_of(joint_names, self._robot.prismatic_joints if self._robot else ())


def _ranges(names: Sequence[str], low: FloatArray, high: FloatArray) -> str:
    rows = zip(names, *(np.round([low, high], 2) + 0.0), strict=True)  # no minus before zero
    return ", ".join(f"{name} {a:.2f} to {b:.2f}" for name, a, b in rows)
