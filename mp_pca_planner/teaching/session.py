# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A teaching session: a recording that grows, and the motions that are cut out of it."""

from __future__ import annotations

import fcntl
import re
import struct
import threading
from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Self

import numpy as np

from ..arrays import FloatArray
from ..exceptions import RecordingError, quote_names
from ..files import reading, write_whole
from ..recordings import cutting
from ..recordings.bags import from_cdr, open_bag
from ..recordings.bags.formats import (
    CHANNEL,
    DATA_END,
    FOOTER,
    HEADER,
    MCAP_HEAD,
    MCAP_MAGIC,
    MCAP_MESSAGE_HEAD,
    MESSAGE,
    SCHEMA,
    mapped,
    mcap_records,
    mcap_text,
)
from ..recordings.bags.serialisation import JOINT_STATE, message_definition
from ..recordings.cutting import read_segments, segments_table
from ..recordings.demonstration import Demonstration
from ..recordings.joint_states import collect_joint_states, joined
from ..recordings.repair import CleanRecording
from ..recordings.segmentation import SegmentationOptions

_ONE = struct.pack("<H", 1)
"""Identifier of the only schema and of the only channel."""


def _text(content: str) -> bytes:
    data = content.encode()
    return struct.pack("<I", len(data)) + data


def _record(kind: int, *content: bytes) -> bytes:
    data = b"".join(content)
    return MCAP_HEAD.pack(kind, len(data)) + data


_START = MCAP_MAGIC + _record(HEADER, _text("ros2"), _text("mp_pca_planner teach"))
_END = _record(DATA_END, bytes(4)) + _record(FOOTER, bytes(20)) + MCAP_MAGIC


class GrowingBag:
    """An mcap file of joint states, which another process may continue.

    Messages are written without chunks, and the end of the file when it is closed. A process that
    is killed leaves a file that is cut off, which the next process continues.

    Parameters
    ----------
    path : Path
        The file; one that exists is continued.
    topic : str
        Name of the topic of the joint states.

    Raises
    ------
    RecordingError
        If the file can't be written, another process writes it, or it was not written by this
        class with this topic.
    """

    def __init__(self, path: Path, topic: str) -> None:
        self.path, self.topic = path, topic
        try:
            self._file = path.open("r+b" if path.exists() else "w+b")
        except OSError as error:
            raise RecordingError(f"'{path}' can't be written: {error.strerror}") from None
        try:
            self._start()
        except BaseException:
            self._file.close()
            raise

    def append(self, messages: Iterable[tuple[int, bytes]]) -> None:
        """Write serialised messages (CDR) with their times of reception [ns].

        Raises
        ------
        RecordingError
            If they can't be written.
        """
        heads = ((MCAP_MESSAGE_HEAD.pack(1, 0, stamp, stamp), data) for stamp, data in messages)
        self._write(b"".join(_record(MESSAGE, *parts) for parts in heads))

    def close(self) -> None:
        """Write the end of the file, and close it."""
        with self._file:
            self._write(_END)

    def _start(self) -> None:
        """Lock the file, and find or write what comes before the messages."""
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise RecordingError(f"'{self.path}' is being recorded by another process") from None
        end = self._end_of_messages() if self.path.stat().st_size else 0
        self._file.truncate(end)
        self._file.seek(end)
        if not end:
            schema = (JOINT_STATE, "ros2msg", message_definition(JOINT_STATE))
            self._write(
                _START
                + _record(SCHEMA, _ONE, *map(_text, schema))
                + _record(CHANNEL, _ONE, _ONE, _text(self.topic), _text("cdr"), _text(""))
            )

    def _end_of_messages(self) -> int:
        """Position behind the last whole record of the data; 0 if there is no topic yet."""
        topic, position = None, 0
        with mapped(self.path) as content:
            if content[: len(_START)] != _START[: len(content)]:
                raise RecordingError(
                    f"'{self.path}' was not recorded by 'teach': choose another --output"
                )
            with suppress(ValueError, struct.error):  # the last record is cut off
                for kind, start, end in mcap_records(content, len(MCAP_MAGIC)):
                    if kind == DATA_END:
                        break
                    if kind == CHANNEL:
                        topic, _ = mcap_text(content, start + 4)
                    position = end
        if topic not in (None, self.topic):
            raise RecordingError(
                f"'{self.path}' was recorded from the topic '{topic}', not '{self.topic}': choose "
                "another --output"
            )
        return position if topic else 0

    def _write(self, content: bytes) -> None:
        try:
            self._file.write(content)
            self._file.flush()
        except OSError as error:
            raise RecordingError(f"'{self.path}' can't be written: {error.strerror}") from None


_NOTHING = re.compile(r"(?!)")  # never matches


SessionUpdate = tuple[tuple[Demonstration, ...], int, tuple[str, ...]]
"""What is new in the recording: see :meth:`TeachingSession.update`."""


_Span = tuple[float, float]
"""Start and end of a motion in the recording [s]."""


class TeachingSession:
    """Records joint states, and cuts them into motions as `build_primitives` does.

    The whole recording is cut again each time, because the thresholds depend on all motions. All
    that the session knows is in its files, so the next session continues it.

    Parameters
    ----------
    output : Path
        File of the primitive that it teaches, beside which its own files are; existing ones are
        continued.
    topic : str
        Topic of the joint states.
    joints : sequence of str or None
        Names of the joints; by default all that every message lists.
    moving_only : bool
        Leaves out those of `joints` that are not listed or never move, such as a gripper's.

    Attributes
    ----------
    recording, segments : Path
        The recording, and the table of the motions that are used.
    motions : tuple of Demonstration
        The motions up to the last rest, without those that were discarded.
    present : array, shape (n_joints,), or None
        Newest positions of the joints of the motions [rad or m].

    Raises
    ------
    RecordingError
        If a file can't be used.
    """

    def __init__(
        self,
        output: Path,
        topic: str,
        joints: Sequence[str] | None,
        *,
        moving_only: bool = False,
    ) -> None:
        self.recording, self.segments, self._discarded_file = (
            output.with_name(output.stem + end)
            for end in (".mcap", "_segments.csv", "_discarded.csv")
        )
        self._joints, self._moving_only = joints, moving_only
        self.motions: tuple[Demonstration, ...] = ()
        self.present: FloatArray | None = None
        self._name, self._notes = output.stem, set[str]()
        self._lock = threading.Lock()
        self._waiting: list[tuple[int, bytes]] = []
        self._bag = GrowingBag(self.recording, topic)
        try:
            with open_bag(self.recording, salvage=True) as bag:
                self._raw = bag.joint_states(topic)
            self._discarded = self._read_discarded()
        except BaseException:
            self._bag.close()
            raise

    def joined_from(self, names: Sequence[str]) -> int:
        """When the last message of the recording was received [ns]; 0 if there is none.

        Parameters
        ----------
        names : sequence of str
            Joints of the messages that are to follow.

        Raises
        ------
        RecordingError
            If the recording has none of these joints.
        """
        known = self._raw.listed_joints
        if known and not set(known) & set(names):
            raise RecordingError(
                f"'{self.recording}' is of the joints {quote_names(known)}, not of "
                f"{quote_names(names)}: give another --output for another robot"
            )
        return int(self._raw.receive_stamps.max(initial=0))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._bag.close()

    def record(self, messages: Sequence[tuple[int, bytes]]) -> None:
        """Store serialised joint states with their times of reception [ns]; from any thread."""
        if messages:
            self._bag.append(messages)
            with self._lock:
                self._waiting += messages

    @property
    def n_messages(self) -> int:
        """Number of messages in the recording, as of the last update."""
        return self._raw.n_messages

    def update(self, *, is_over: bool = False, explains: bool = True) -> SessionUpdate:
        """Cut the recording as it is now.

        Parameters
        ----------
        is_over : bool
            Whether nothing follows. Otherwise the motions stay as they were while the arm moves:
            its last motions may still be cut in another way.
        explains : bool
            Whether to say why a recording holds no motion.

        Returns
        -------
        found : tuple of Demonstration
            Motions that were not there at the update before.
        n_lost : int
            Number of motions that were, and are no longer cut in this way.
        notes : tuple of str
            What is left out and why, one sentence each.
        """
        self._take()
        try:
            cuts, clean = cutting.cut_joint_states(
                self._raw, self._joints, moving_only=self._moving_only
            )
        except RecordingError as error:
            reasons = [str(error)] if explains and (self.n_messages or is_over) else []
            return (), 0, self._new_notes(reasons, re.compile(r"\d\S*"))
        if not is_over and not _is_at_rest(cuts, clean):
            return (), 0, ()
        self.present = clean.pieces[-1].positions[-1]
        whole = [cut for cut in cuts if not cut.is_cut_off]
        every = [cut.demonstration(clean.joint_names, self._name, "") for cut in whole]
        before = self.motions
        self.motions = tuple(one for one in every if not _is_among(one, self._discarded))
        return (
            tuple(one for one in self.motions if not _is_among(one, _spans(before))),
            sum(not _is_among(one, _spans(self.motions)) for one in before),
            self._new_notes(_left_out(clean, len(cuts) - len(whole))),
        )

    def discard_last(self) -> Demonstration | None:
        """Discard the last motion for good; returns it, None if there is none."""
        if not self.motions:
            return None
        last = self.motions[-1]
        discarded = [*self._discarded, *_spans([last])]
        self._write(self._discarded_file, discarded)
        self._discarded, self.motions = discarded, self.motions[:-1]
        return last

    def first_goal(self) -> FloatArray:
        """Goal of the motion that starts nearest to the present positions, shape (n_joints,)."""
        starts = np.array([motion.positions[0] for motion in self.motions])
        nearest = np.linalg.norm(starts - self.present, axis=1).argmin()
        return np.asarray(self.motions[int(nearest)].positions[-1])

    def write_segments(self) -> None:
        """Write the table of the motions, for `build_primitives --segments`."""
        self._write(self.segments, _spans(self.motions))

    def _write(self, file: Path, spans: Sequence[_Span]) -> None:
        """Write a table of motions; those of a session have no labels."""
        table = segments_table((self._name, start, end, "") for start, end in spans)
        write_whole(file, table, overwrite=True)

    def _take(self) -> None:
        """Read the messages that have come since the last time."""
        with self._lock:
            new, self._waiting = self._waiting, []
        if new:
            with reading("the joint states", RecordingError):
                states = ((stamp, from_cdr(data)) for stamp, data in new)
                part = collect_joint_states(self._bag.topic, states)
            self._raw = joined(self._raw, part)

    def _read_discarded(self) -> list[_Span]:
        if not self._discarded_file.exists():
            return []
        rows = read_segments(self._discarded_file, [self._name]).get(self._name, [])
        return [(row.start, row.end) for row in rows]

    def _new_notes(
        self, notes: Sequence[str], ignored: re.Pattern[str] = _NOTHING
    ) -> tuple[str, ...]:
        """Those that differ from all earlier ones, in other parts than the ignored ones."""
        keys = {ignored.sub("", note): note for note in notes}
        new = [note for key, note in keys.items() if key not in self._notes]
        self._notes |= keys.keys()
        return tuple(new)


def _is_at_rest(cuts: Sequence[cutting.Cut], clean: CleanRecording) -> bool:
    """Whether the recording ends with a rest that cuts."""
    if not cuts:
        return True
    last = cuts[-1]
    rested = float(clean.pieces[-1].times[-1] - last.piece.times[last.last])
    return rested > SegmentationOptions.min_rest


def _left_out(clean: CleanRecording, n_cut_off: int) -> list[str]:
    """What was cut, and is no motion."""
    n_rest = clean.repairs.get("rest", 0)
    rest = f"{n_rest} movement(s) within the extent of noise and sway"
    cut_off = f"{n_cut_off} motion(s) of which the recording lacks the start or the end"
    counted = [(n_rest, rest), (n_cut_off, cut_off)]
    notes = [note for note in clean.notes if "left out" in note]
    return [*(text for n, text in counted if n), *notes]


def _spans(motions: Sequence[Demonstration]) -> list[_Span]:
    return [(motion.start_time, motion.end_time) for motion in motions]


def _is_among(motion: Demonstration, spans: Sequence[_Span]) -> bool:
    """Whether a span is that of the same motion: most of the shorter one is common to both."""
    return any(
        min(motion.end_time, end) - max(motion.start_time, start)
        > 0.5 * min(motion.end_time - motion.start_time, end - start)
        for start, end in spans
    )
