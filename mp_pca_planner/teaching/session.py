# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A teaching session: a recording that grows, and the motions that are cut out of it."""

from __future__ import annotations

import re
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, Self

import numpy as np

from ..arrays import FloatArray
from ..exceptions import RecordingError, quote_names
from ..files import reading, write_whole
from ..recordings import cutting
from ..recordings.bags import open_bag
from ..recordings.demonstration import Demonstration
from ..recordings.joint_states import joined, slice_joint_states
from ..recordings.repair import CleanRecording
from ..recordings.segmentation import SegmentationOptions
from ..recordings.segments_file import read_segments, segments_table
from .growing_bag import GrowingBag

_NOTHING = re.compile(r"(?!)")  # never matches
_SEGMENTATION = SegmentationOptions()
"""As in `build_primitives`."""


class SessionFiles(NamedTuple):
    """Files of a session beside the primitive that it teaches.

    Attributes
    ----------
    bag : Path
        The recording.
    segments, discarded : Path
        Tables of the motions that are used, and of those that a person discarded.
    """

    bag: Path
    segments: Path
    discarded: Path

    @classmethod
    def beside(cls, output: Path) -> SessionFiles:
        """The files beside a primitive file."""
        names = (".mcap", "_segments.csv", "_discarded.csv")
        return cls(*(output.with_name(output.stem + name) for name in names))


@dataclass(frozen=True, eq=False)
class SessionUpdate:
    """What is new in the recording.

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


class _Span(NamedTuple):
    """A row of a table of segments."""

    recording: str
    start_time: float
    end_time: float
    label: str = ""


class TeachingSession:
    """Records joint states, and cuts them into motions as `build_primitives` does.

    The whole recording is cut again each time, because the thresholds depend on all motions. All
    that the session knows is in its files, so the next session continues it.

    Parameters
    ----------
    files : SessionFiles
        The files; existing ones are continued.
    topic : str
        Topic of the joint states.
    joints : sequence of str or None
        Names of the joints; by default all that every message lists.
    moving_only : bool
        Leaves out those of `joints` that are not listed or never move, such as a gripper's.

    Attributes
    ----------
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
        files: SessionFiles,
        topic: str,
        joints: Sequence[str] | None,
        *,
        moving_only: bool = False,
    ) -> None:
        self.files, self._joints, self._moving_only = files, joints, moving_only
        self.motions: tuple[Demonstration, ...] = ()
        self.present: FloatArray | None = None
        self._name, self._notes = files.bag.stem, set[str]()
        self._lock = threading.Lock()
        self._waiting: list[tuple[int, bytes]] = []
        self._bag = GrowingBag(files.bag, topic)
        try:
            with open_bag(files.bag) as bag:
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
                f"'{self.files.bag}' is of the joints {quote_names(known)}, not of "
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
        """
        self._take()
        try:
            cuts, clean = cutting.cut_joint_states(
                self._raw, self._joints, _SEGMENTATION, moving_only=self._moving_only
            )
        except RecordingError as error:
            reasons = [str(error)] if explains and (self.n_messages or is_over) else []
            return SessionUpdate(notes=self._new_notes(reasons, re.compile(r"\d\S*")))
        if not is_over and not _is_at_rest(cuts, clean):
            return SessionUpdate()
        self.present = clean.pieces[-1].positions[-1]
        whole = [cut for cut in cuts if not cut.is_cut_off(_SEGMENTATION)]
        every = [cut.demonstration(clean.joint_names, self._name, "") for cut in whole]
        before = self.motions
        self.motions = tuple(one for one in every if not _is_among(one, self._discarded))
        return SessionUpdate(
            tuple(one for one in self.motions if not _is_among(one, before)),
            sum(not _is_among(one, self.motions) for one in before),
            self._new_notes(_left_out(clean, len(cuts) - len(whole))),
        )

    def discard_last(self) -> Demonstration | None:
        """Discard the last motion for good; returns it, None if there is none."""
        if not self.motions:
            return None
        last = self.motions[-1]
        discarded = [*self._discarded, _Span(self._name, last.start_time, last.end_time)]
        write_whole(self.files.discarded, segments_table(discarded), overwrite=True)
        self._discarded, self.motions = discarded, self.motions[:-1]
        return last

    def first_goal(self) -> FloatArray:
        """Goal of the motion that starts nearest to the present positions, shape (n_joints,)."""
        starts = np.array([motion.positions[0] for motion in self.motions])
        nearest = np.linalg.norm(starts - self.present, axis=1).argmin()
        return np.asarray(self.motions[int(nearest)].positions[-1])

    def write_segments(self) -> None:
        """Write the table of the motions, for `build_primitives --segments`."""
        write_whole(self.files.segments, segments_table(self.motions), overwrite=True)

    def _take(self) -> None:
        """Slice the messages that have come since the last time."""
        with self._lock:
            new, self._waiting = self._waiting, []
        if new:
            messages = ((None, stamp, data) for stamp, data in new)
            with reading("the joint states", RecordingError):
                part = slice_joint_states(self._bag.topic, messages, ros1=False)
            self._raw = joined(self._raw, part)

    def _read_discarded(self) -> list[_Span]:
        if not self.files.discarded.exists():
            return []
        rows = read_segments(self.files.discarded, [self._name]).get(self._name, [])
        return [_Span(self._name, row.start, row.end) for row in rows]

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
    return float(clean.pieces[-1].times[-1] - last.piece.times[last.last]) > _SEGMENTATION.min_rest


def _left_out(clean: CleanRecording, n_cut_off: int) -> list[str]:
    """What was cut, and is no motion."""
    n_rest = clean.repairs.get("rest", 0)
    rest = f"{n_rest} movement(s) within the extent of noise and sway"
    cut_off = f"{n_cut_off} motion(s) of which the recording lacks the start or the end"
    counted = [(n_rest, rest), (n_cut_off, cut_off)]
    notes = [note for note in clean.notes if "left out" in note]
    return [*(text for n, text in counted if n), *notes]


def _is_among(motion: Demonstration, others: Sequence[Demonstration | _Span]) -> bool:
    """Whether one of the others is the same motion: most of the shorter one is common to both."""
    return any(
        min(motion.end_time, one.end_time) - max(motion.start_time, one.start_time)
        > 0.5 * min(motion.end_time - motion.start_time, one.end_time - one.start_time)
        for one in others
    )
