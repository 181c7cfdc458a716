# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A teaching session: a recording that grows, the motions in it, and what they teach."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from queue import SimpleQueue
from typing import Protocol, Self

import numpy as np

from ..arrays import FloatArray
from ..exceptions import PlannerError, RecordingError
from ..files import reading, write_whole
from ..plotting.text import DEGREES, Unit, unit_of
from ..primitives.build import build_primitive
from ..recordings import cutting
from ..recordings.bags import choose_topic, from_cdr, open_bag, to_cdr, write_stored_states
from ..recordings.bags.bag import damage_reported
from ..recordings.demonstration import Demonstration
from ..recordings.joint_states import collect_joint_states
from ..recordings.options import MIN_REST, LoadOptions
from ..recordings.recording import Recording
from ..recordings.repair import repair
from ..recordings.segmentation import extent, least_extent_of_set
from ..robot.model import Robot

StoredStates = list[tuple[int, bytes]]
"""Serialised joint states (CDR) with their times of reception [ns]."""

KEYS = "d discards the last motion, b builds the primitive, q quits; the recording is kept"

# Pauses are at least so many times as long as an update of the session, and a silent source is
# named after so many pauses.
_IDLE_RATIO, _MAX_SILENCE = 4.0, 10

_Span = tuple[float, float]
"""Start and end of a motion in the recording [s]."""


def stored_states(path: Path, topic: str | None = None) -> tuple[str, StoredStates]:
    """Topic and messages of the joint states of a bag.

    Parameters
    ----------
    path : Path
        The bag.
    topic : str or None
        Their topic; by default the only one with joint states.

    Raises
    ------
    RecordingError
        If the bag can't be read, or has no such topic.
    """
    with open_bag(path) as bag, damage_reported(path, bag.format):
        chosen = choose_topic(bag.topics, topic)
        convert = to_cdr if bag.format == "rosbag1" else bytes
        return chosen.name, [(stamp, convert(x)) for _, stamp, x in bag.messages([chosen])]


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


class SessionWords:
    """Describes motions and what they teach; places of the end effector with a robot only.

    Parameters
    ----------
    robot : Robot or None
        The robot.
    """

    def __init__(self, robot: Robot | None = None) -> None:
        self._robot = robot

    def motion(self, number: int, motion: Demonstration) -> str:
        """What is said of a new motion."""
        unit = self._unit(motion.joint_names)
        length = f"{unit.number(extent(motion.positions))} {unit.name}"
        return f"motion {number}: {motion.duration:.2f} s, {length}, accepted"

    def learned(self, motions: Sequence[Demonstration]) -> list[str]:
        """What motions teach: the error of left-out motions, and the range of the goals."""
        try:
            facts = build_primitive(motions, "taught").summary() if len(motions) > 1 else {}
        except PlannerError as error:
            return [f"  nothing is learned yet: {error}"]
        if not facts:
            return ["  nothing is learned yet: two motions are needed"]
        names = motions[0].joint_names
        unit, goals = self._unit(names), np.array([motion.positions[-1] for motion in motions])
        left_out, straight = (
            f"{unit.number(facts[f'{name}_error'])} {unit.name}"
            for name in ("left_out", "minimum_jerk")
        )
        lines = [f"  left-out error {left_out} (straight motions: {straight})"]
        lines.append(f"  goals shown {self._si(names)}: {_ranges(names, goals)}")
        if self._robot is not None:
            frame, places = self._places(self._robot, names, goals)
            lines.append(f"  {frame} at goals [m]: {_ranges('xyz', places)}")
        return lines

    def place(self, joint_names: Sequence[str], q: FloatArray) -> str:
        """Positions of joints, shape (n_joints,), and the place of the end effector."""
        rounded = np.round(q, 2) + 0.0  # no minus before zero
        joints = ",".join(f"{name}={x:.2f}" for name, x in zip(joint_names, rounded, strict=True))
        text = f"{joints} {self._si(joint_names)}"
        if self._robot is not None:
            frame, places = self._places(self._robot, joint_names, q[None])
            text += f" ({frame} at {' '.join(f'{x:.2f}' for x in places[0])} m)"
        return text

    def _places(
        self, robot: Robot, joint_names: Sequence[str], q: FloatArray
    ) -> tuple[str, FloatArray]:
        """The end effector that these joints move, and its places [m], shape (n_steps, 3)."""
        robot = robot.with_joints(joint_names)  # of a gripper at rest, the hand
        return robot.end_effector, robot.frame_positions(q, [robot.end_effector])[:, 0]

    def _si(self, joint_names: Sequence[str]) -> str:
        """The unit of positions that commands read."""
        unit = self._unit(joint_names)
        return "[rad]" if unit is DEGREES else f"[{unit.name}]"

    def _unit(self, joint_names: Sequence[str]) -> Unit:
        return unit_of(joint_names, self._robot.prismatic_joints if self._robot else ())


class TeachingSession:
    """Records joint states, and cuts them into motions as `build_primitives` does.

    The whole recording is cut again each time, because the thresholds depend on all motions. It is
    written whole with every new motion and at the end, so a process that is killed loses the
    motions that were not shown yet. The next session of the same output continues it.

    Parameters
    ----------
    output : Path
        File of the primitive that it teaches, beside which its own files are; existing ones are
        continued.
    topic : str
        Topic of the joint states.
    joints : sequence of str or None
        Names of the joints; by default all that every message lists. Those that are not listed or
        never move are left out, such as a gripper's.
    words : SessionWords
        Describes the motions.

    Attributes
    ----------
    recording, segments : Path
        The recording, and the table of the motions that are used.
    motions : tuple of Demonstration
        The motions up to the last rest, without those that were discarded.

    Raises
    ------
    RecordingError
        If an existing file was not made by a session with this topic.
    """

    def __init__(
        self,
        output: Path,
        topic: str,
        joints: Sequence[str] | None,
        *,
        words: SessionWords | None = None,
    ) -> None:
        self.recording, self.segments, self._discarded = (
            output.with_name(output.stem + end)
            for end in (".mcap", "_segments.csv", "_discarded.csv")
        )
        self.motions: tuple[Demonstration, ...] = ()
        self._name, self._topic, self._joints = output.stem, topic, joints
        self._words = words or SessionWords()
        self._said = set[str]()
        self._waiting: SimpleQueue[StoredStates] = SimpleQueue()
        self._messages: StoredStates = []
        self._states = collect_joint_states(topic, [])
        if self.recording.exists():
            written, messages = stored_states(self.recording)
            if written != topic:
                raise RecordingError(
                    f"'{self.recording}' holds other topics than '{topic}': choose another --output"
                )
            self.record(messages)
            self._take()
        self._n_written = len(self._messages)
        self._discarded_spans: list[_Span] = []
        if self._discarded.exists():
            rows = cutting.read_segments(self._discarded, [self._name]).get(self._name, [])
            self._discarded_spans = [(row.start, row.end) for row in rows]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._take()
        self._write_recording()

    def record(self, messages: StoredStates) -> None:
        """Take messages in the order of their reception; from any thread."""
        self._waiting.put(messages)

    @property
    def n_messages(self) -> int:
        """Number of messages in the recording, as of the last update."""
        return len(self._messages)

    @property
    def last_stamp(self) -> int:
        """When the last message of the recording was received [ns]; 0 if there is none."""
        return self._messages[-1][0] if self._messages else 0

    def update(self, *, is_over: bool = False) -> list[str]:
        """Cut the recording as it is now; returns lines on new motions and on what is left out.

        Parameters
        ----------
        is_over : bool
            Whether nothing follows. Otherwise the motions stay as they were while the arm moves:
            its last motions may still be cut in another way.
        """
        self._take()
        try:
            cuts, clean = self._cut()
        except RecordingError as error:
            is_known = self._messages or is_over
            return self._news([f"no motion yet: {error}"] if is_known else [])
        if cuts and not is_over:
            ended = cuts[-1].piece.times[cuts[-1].last]
            if clean.pieces[-1].times[-1] - ended <= MIN_REST:
                return []
        self._present = clean.pieces[-1].positions[-1]
        whole = [cut for cut in cuts if not any(cut.is_cut_off)]
        every = (cut.demonstration(clean.joint_names, recording=self._name) for cut in whole)
        before = _spans(self.motions)
        self.motions = tuple(x for x in every if not _is_among(x, self._discarded_spans))
        n_torn, n_rest = len(cuts) - len(whole), clean.repairs.get("rest", 0)
        left_out = [f"{n_rest} movement(s) within the extent of noise and sway"] * bool(n_rest)
        left_out += [f"{n_torn} motion(s) that lack their start or end"] * bool(n_torn)
        left_out += [note for note in clean.notes if "left out" in note]
        lines = self._news(f"left out: {note}" for note in left_out)
        numbered = enumerate(self.motions, 1)
        if new := [(k, motion) for k, motion in numbered if not _is_among(motion, before)]:
            self._write_recording()
            lines += [self._words.motion(k, motion) for k, motion in new]
            lines += self._words.learned(self.motions)
        return lines

    def _cut(self) -> tuple[list[cutting.Cut], Recording]:
        """The motions of the recording, as :func:`.load_recordings` cuts it when it is alone."""
        joints, known = self._joints, self._states.joint_names
        if joints is not None:
            joints = [name for name in joints if name in known] or joints
        clean = repair(self._states, joints)
        if joints is not None:
            moving = [name for name in clean.joint_names if name not in clean.still_joints]
            clean = clean.with_joints(moving)
        pieces, thresholds = cutting.smoothed(clean)
        cuts, clean = cutting.cut_motions(clean, pieces, thresholds, LoadOptions())
        least = least_extent_of_set([cut.extent for cut in cuts]) if cuts else 0.0
        large = [cut for cut in cuts if cut.extent > least]
        return large, clean.noted(rest=len(cuts) - len(large))

    def discard_last(self) -> Demonstration | None:
        """Discard the last motion for good; returns it, None if there is none."""
        if not self.motions:
            return None
        *others, last = self.motions
        self.motions = tuple(others)
        self._discarded_spans += _spans([last])
        self._write_table(self._discarded, self._discarded_spans)
        return last

    def first_goal(self) -> tuple[tuple[str, ...], FloatArray, str]:
        """Goal of the motion that starts nearest to the present positions.

        Returns
        -------
        joint_names : tuple of str
            The joints.
        goal : array, shape (n_joints,)
            Their positions [rad or m].
        words : str
            The same as text.
        """
        starts = np.array([motion.positions[0] for motion in self.motions])
        nearest = np.linalg.norm(starts - self._present, axis=1).argmin()
        motion = self.motions[int(nearest)]
        names, goal = motion.joint_names, np.asarray(motion.positions[-1])
        return names, goal, self._words.place(names, goal)

    def write_segments(self) -> None:
        """Write the table of the motions, for `build_primitives --segments`."""
        self._write_table(self.segments, _spans(self.motions))

    def _take(self) -> None:
        """Add the messages that have come since the last time."""
        new: StoredStates = []
        while not self._waiting.empty():
            new += self._waiting.get()
        if new:
            with reading("the joint states", RecordingError):
                states = ((stamp, from_cdr(data)) for stamp, data in new)
                self._states = self._states.followed_by(collect_joint_states(self._topic, states))
            self._messages += new

    def _write_recording(self) -> None:
        if len(self._messages) > self._n_written:
            write_stored_states(self.recording, self._topic, self._messages)
            self._n_written = len(self._messages)

    def _write_table(self, file: Path, spans: Sequence[_Span]) -> None:
        """Write a table of motions; those of a session have no labels."""
        table = cutting.segments_table((self._name, start, end, "") for start, end in spans)
        write_whole(file, table, overwrite=True)

    def _news(self, notes: Iterable[str]) -> list[str]:
        """Those that differ from all earlier ones in more than numbers."""
        keys = {re.sub(r"\d\S*", "", note): note for note in notes}
        new = [note for key, note in keys.items() if key not in self._said]
        self._said |= keys.keys()
        return new


def hold_dialogue(
    session: TeachingSession,
    source: Source | None,
    pressed: Callable[[float | None], str | None],
    say: Callable[..., None],
) -> bool:
    """Show motions as they end, until a person ends the session.

    Parameters
    ----------
    session : TeachingSession
        The session.
    source : Source or None
        Where its joint states come from; None if all are there.
    pressed : callable
        Returns the next key; '' if none is pressed within a time [s], None if none can be any more.
    say : callable
        Prints lines.

    Returns
    -------
    is_built : bool
        Whether the primitive is to be built.
    """
    n_silent, n_known, timeout = 0, session.n_messages, None
    while True:
        started = time.monotonic()
        if source is not None:
            source.feed(session.record)
        say(*session.update(is_over=source is None))
        if source is not None:
            n_silent = n_silent + 1 if session.n_messages == n_known else 0
            if n_silent == _MAX_SILENCE:
                say(source.silence())
            timeout = max(source.pause, _IDLE_RATIO * (time.monotonic() - started))
        key = pressed(timeout)
        if key is None or key == "q":
            return False
        if key == "b":
            say(*session.update(is_over=True))
            if session.motions:
                return True
            say("there is no motion to build a primitive from")
        elif key == "d":
            n = len(session.motions)
            discarded = f"motion {n} is discarded: {n - 1} left"
            say(discarded if session.discard_last() else "there is no motion to discard")
        elif key:
            say(f"'{key}' does nothing: {KEYS}")


def _spans(motions: Sequence[Demonstration]) -> list[_Span]:
    return [(motion.start_time, motion.end_time) for motion in motions]


def _is_among(motion: Demonstration, spans: Sequence[_Span]) -> bool:
    """Whether a span is that of the same motion: most of the shorter one is common to both."""
    return any(
        min(motion.end_time, end) - max(motion.start_time, start)
        > 0.5 * min(motion.end_time - motion.start_time, end - start)
        for start, end in spans
    )


def _ranges(names: Sequence[str], values: FloatArray) -> str:
    """Lowest and highest values of each name, given values of shape (n_values, n_names)."""
    bounds = np.round([values.min(axis=0), values.max(axis=0)], 2) + 0.0  # no minus before zero
    rows = zip(names, *bounds, strict=True)
    return ", ".join(f"{name} {a:.2f} to {b:.2f}" for name, a, b in rows)
