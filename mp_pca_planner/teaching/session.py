# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A teaching session: a recording that grows, and the motions that are cut out of it."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from queue import SimpleQueue
from typing import NamedTuple, Self

import numpy as np

from ..arrays import FloatArray
from ..exceptions import RecordingError
from ..files import reading, write_whole
from ..recordings import cutting
from ..recordings.bags import choose_topic, from_cdr, open_bag, to_cdr, write_stored_states
from ..recordings.bags.bag import damage_reported
from ..recordings.demonstration import Demonstration
from ..recordings.joint_states import JointStates, collect_joint_states, joined
from ..recordings.recording import Recording
from ..recordings.segmentation import SegmentationOptions

StoredStates = list[tuple[int, bytes]]
"""Serialised joint states (CDR) with their times of reception [ns]."""


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


class SessionUpdate(NamedTuple):
    """What is new in the recording of a session.

    Attributes
    ----------
    found : tuple of Demonstration
        Motions that were not there at the update before.
    n_lost : int
        Number of motions that were, and are no longer cut in this way.
    notes : tuple of str
        What is left out and why, one sentence each.
    """

    found: tuple[Demonstration, ...] = ()
    n_lost: int = 0
    notes: tuple[str, ...] = ()


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
        Names of the joints; by default all that every message lists.
    moving_only : bool
        Leaves out those of `joints` that are not listed or never move, such as a gripper's.

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
        self, output: Path, topic: str, joints: Sequence[str] | None, *, moving_only: bool = False
    ) -> None:
        self.recording, self.segments, self._discarded = (
            output.with_name(output.stem + end)
            for end in (".mcap", "_segments.csv", "_discarded.csv")
        )
        self.motions: tuple[Demonstration, ...] = ()
        self._name, self._topic, self._joints = output.stem, topic, joints
        self._moving_only, self._notes = moving_only, set[str]()
        self._waiting: SimpleQueue[StoredStates] = SimpleQueue()
        self._messages: StoredStates = []
        if self.recording.exists():
            with open_bag(self.recording) as bag:
                if [found.name for found in bag.topics] != [topic]:
                    raise RecordingError(
                        f"'{self.recording}' holds other topics than '{topic}': choose another "
                        "--output"
                    )
            _, self._messages = stored_states(self.recording, topic)
        self._raw = collect_joint_states(topic, [])
        self._raw = self._decoded(self._messages)
        self._n_written = len(self._messages)
        self._discarded_spans = self._read_discarded()

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

    def update(self, *, is_over: bool = False) -> SessionUpdate:
        """Cut the recording as it is now.

        Parameters
        ----------
        is_over : bool
            Whether nothing follows. Otherwise the motions stay as they were while the arm moves:
            its last motions may still be cut in another way.
        """
        if new := self._take():
            self._raw = self._decoded(new)
        try:
            cuts, clean = cutting.cut_joint_states(
                self._raw, self._joints, moving_only=self._moving_only
            )
        except RecordingError as error:
            is_known = self._messages or is_over
            return SessionUpdate(notes=self._new_notes([str(error)] if is_known else []))
        if not is_over and not _is_at_rest(cuts, clean):
            return SessionUpdate()
        self._present = clean.pieces[-1].positions[-1]
        whole = [cut for cut in cuts if not cut.is_cut_off]
        every = [cut.demonstration(clean.joint_names, self._name, "") for cut in whole]
        before = self.motions
        self.motions = tuple(one for one in every if not _is_among(one, self._discarded_spans))
        found = tuple(one for one in self.motions if not _is_among(one, _spans(before)))
        if found:
            self._write_recording()
        n_lost = sum(not _is_among(one, _spans(self.motions)) for one in before)
        return SessionUpdate(found, n_lost, self._new_notes(_left_out(clean, cuts)))

    def discard_last(self) -> Demonstration | None:
        """Discard the last motion for good; returns it, None if there is none."""
        if not self.motions:
            return None
        last = self.motions[-1]
        self._discarded_spans += _spans([last])
        self._write_table(self._discarded, self._discarded_spans)
        self.motions = self.motions[:-1]
        return last

    def first_goal(self) -> FloatArray:
        """Goal of the motion that starts nearest to the present positions, shape (n_joints,)."""
        starts = np.array([motion.positions[0] for motion in self.motions])
        nearest = np.linalg.norm(starts - self._present, axis=1).argmin()
        return np.asarray(self.motions[int(nearest)].positions[-1])

    def write_segments(self) -> None:
        """Write the table of the motions, for `build_primitives --segments`."""
        self._write_table(self.segments, _spans(self.motions))

    def _take(self) -> StoredStates:
        """Add the messages that have come since the last time; returns them."""
        new: StoredStates = []
        while not self._waiting.empty():
            new += self._waiting.get()
        self._messages += new
        return new

    def _decoded(self, new: StoredStates) -> JointStates:
        with reading("the joint states", RecordingError):
            states = ((stamp, from_cdr(data)) for stamp, data in new)
            return joined(self._raw, collect_joint_states(self._topic, states))

    def _write_recording(self) -> None:
        if len(self._messages) > self._n_written:
            write_stored_states(self.recording, self._topic, self._messages)
            self._n_written = len(self._messages)

    def _write_table(self, file: Path, spans: Sequence[_Span]) -> None:
        """Write a table of motions; those of a session have no labels."""
        table = cutting.segments_table((self._name, start, end, "") for start, end in spans)
        write_whole(file, table, overwrite=True)

    def _read_discarded(self) -> list[_Span]:
        if not self._discarded.exists():
            return []
        rows = cutting.read_segments(self._discarded, [self._name]).get(self._name, [])
        return [(row.start, row.end) for row in rows]

    def _new_notes(self, notes: Sequence[str]) -> tuple[str, ...]:
        """Those that differ from all earlier ones in more than numbers."""
        keys = {re.sub(r"\d\S*", "", note): note for note in notes}
        new = [note for key, note in keys.items() if key not in self._notes]
        self._notes |= keys.keys()
        return tuple(new)


_Span = tuple[float, float]
"""Start and end of a motion in the recording [s]."""


def _is_at_rest(cuts: Sequence[cutting.Cut], clean: Recording) -> bool:
    """Whether the recording ends with a rest that cuts."""
    if not cuts:
        return True
    last = cuts[-1]
    rested = float(clean.pieces[-1].times[-1] - last.piece.times[last.last])
    return rested > SegmentationOptions.min_rest


def _left_out(clean: Recording, cuts: Sequence[cutting.Cut]) -> list[str]:
    """What was cut, and is no motion."""
    n_rest, n_cut_off = clean.repairs.get("rest", 0), sum(cut.is_cut_off for cut in cuts)
    notes = [note for note in clean.notes if "left out" in note]
    if n_cut_off:
        notes.insert(0, f"{n_cut_off} motion(s) of which the recording lacks the start or the end")
    if n_rest:
        notes.insert(0, f"{n_rest} movement(s) within the extent of noise and sway")
    return notes


def _spans(motions: Sequence[Demonstration]) -> list[_Span]:
    return [(motion.start_time, motion.end_time) for motion in motions]


def _is_among(motion: Demonstration, spans: Sequence[_Span]) -> bool:
    """Whether a span is that of the same motion: most of the shorter one is common to both."""
    return any(
        min(motion.end_time, end) - max(motion.start_time, start)
        > 0.5 * min(motion.end_time - motion.start_time, end - start)
        for start, end in spans
    )
