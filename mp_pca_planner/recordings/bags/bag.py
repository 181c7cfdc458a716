# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""An open recording: its topics and their messages."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

from ...exceptions import DamagedRecordingError, RecordingError, quote_names
from ..joint_states import RawJointStates, slice_joint_states
from .discovery import BagFormat
from .discovery import bag_format as format_of
from .files import RecordingFiles, damage_reported
from .serialisation import JOINT_STATE, JOINT_TRAJECTORY, BagTypes
from .storage import Channel, Key

Result = TypeVar("Result")


@dataclass(frozen=True)
class Topic:
    """A topic of a bag; one that carries several types appears once for each.

    Attributes
    ----------
    name, type : str
        Its name, and the type of its messages as ROS 2 writes it (``pkg/msg/Name``).
    count : int
        Number of messages.
    """

    name: str
    type: str
    count: int


Stored = tuple[Topic, int, bytes]
"""Topic, time of reception [ns] and a message as it is stored."""


@contextmanager
def open_bag(path: Path, *, salvage: bool = False) -> Iterator[Bag]:
    """Open a recording.

    Parameters
    ----------
    path :
        The recording.
    salvage :
        Reads the messages before the damage of a damaged recording.

    Raises
    ------
    RecordingError
        If it can't be read.
    """
    bag_format = format_of(path)
    with _hint_at_salvage(salvage), ExitStack() as stack:
        files = RecordingFiles(path, bag_format)
        try:
            counts, has_index = files.open_by_index(stack), True
        except DamagedRecordingError:
            counts, has_index = files.open_damaged(stack) if salvage else Counter(), False
            if not counts:
                raise
        yield Bag(path, bag_format, files, counts, salvage=salvage, has_index=has_index)


class Bag:
    """An open recording, see :func:`open_bag`.

    Attributes
    ----------
    path : Path
        The recording.
    format : str
        Its storage format.
    topics : tuple of Topic
        Its topics, in order of name; of a damaged one those with messages before the damage.
    notes : tuple of str
        Notes on the last reading of messages, one sentence each.
    """

    def __init__(
        self,
        path: Path,
        bag_format: BagFormat,
        files: RecordingFiles,
        counts: Counter[Channel],
        *,
        salvage: bool,
        has_index: bool,
    ) -> None:
        self.path, self.format = path, bag_format
        self.notes: tuple[str, ...] = ()
        self._files, self._salvage, self._has_index = files, salvage, has_index
        totals: Counter[Key] = Counter()
        for channel, count in counts.items():
            totals[channel.key] += count
        self.topics = tuple(Topic(*key, count) for key, count in sorted(totals.items()))
        self._types = BagTypes(bag_format, {c.key: c.definition for c in counts if c.definition})

    def read(self, topics: Collection[Topic], use: Callable[[Iterator[Stored]], Result]) -> Result:
        """Call a function with the messages of some topics, up to the damage of a damaged bag.

        Parameters
        ----------
        topics :
            Some of :attr:`topics`.
        use :
            A function of the messages: topic, time of reception [ns], and the message as stored. It
            is called again if damage is detected during reading and `salvage` is enabled.

        Raises
        ------
        RecordingError
            If the messages can't be read, wholly or in part.
        """
        if self._has_index:
            try:
                return use(self._all_messages(topics))
            except DamagedRecordingError:
                if not self._salvage or not any(True for _ in self._before_damage(topics)):
                    raise
        return use(self._before_damage(topics))

    def deserialise(self, topic: Topic, data: bytes) -> Any:
        """Deserialise a message of a common type, or of a type that the bag defines.

        Raises
        ------
        RecordingError
            If it does not hold such a message.
        """
        with self._damage_reported():
            return self._types.decode((topic.name, topic.type), data)

    def joint_states(
        self,
        topic: str,
        *,
        field: str | None = None,
        progress: Callable[[float], None] | None = None,
    ) -> RawJointStates:
        """Read all joint states of a topic.

        Types of other topics don't matter, known or not: the definition of JointState has never
        changed, so those stored in the bag are not needed, except for `field`.

        Parameters
        ----------
        topic :
            Name of the topic.
        field :
            If the joint states are a field of other messages, its name, with dots where it is a
            field of a field.
        progress :
            Called with the share of the messages that is read.

        Raises
        ------
        RecordingError
            If the recording can't be read, or there are no joint states of that name.
        """
        named = [item for item in self.topics if item.name == topic]
        chosen = [item for item in named if field or item.type == JOINT_STATE]
        if field is not None and not chosen:
            raise RecordingError(
                f"there is no topic '{topic}'; topics: "
                f"{quote_names(sorted({item.name for item in self.topics}))}"
            )
        extract = {} if field is None else {t: self._field_reader(t, field) for t in chosen}
        n_all = max(1, sum(item.count for item in chosen))

        def gathered(stored: Iterator[Stored]) -> RawJointStates:
            if extract:
                stored = ((source, t, extract[source](data)) for source, t, data in stored)
            with self._damage_reported():
                raw = slice_joint_states(
                    topic,
                    stored,
                    ros1=self.format == "rosbag1",
                    progress=lambda n_done: progress and progress(n_done / n_all),
                )
            return replace(raw, notes=self.notes)

        return self.read(chosen, gathered)

    def embedded_states(self) -> list[tuple[str, str]]:
        """Topics whose messages have joint states in a field, and the name of this field."""
        found = []
        for topic in self.topics:
            with suppress(RecordingError), self._damage_reported():
                found.append((topic.name, self._types.states_field((topic.name, topic.type))))
        return [(name, field) for name, field in found if field]

    def _all_messages(self, topics: Collection[Topic]) -> Iterator[Stored]:
        """Messages, whose number must be that of the index."""
        keys = {(topic.name, topic.type): topic for topic in topics}
        count = 0
        with self._damage_reported():
            for channel, stamp, data in self._files.messages(keys):
                count += 1
                yield keys[channel.key], stamp, data
        indexed = sum(topic.count for topic in topics)
        if count != indexed:
            raise DamagedRecordingError(
                f"'{self.path}' is damaged: its index says {indexed} messages on the topic, "
                f"{count} can be read"
            )
        self.notes = self._files.notes

    def _before_damage(self, topics: Collection[Topic]) -> Iterator[Stored]:
        """Messages before the damage; the damage may also be within a message."""
        keys = {(topic.name, topic.type): topic for topic in topics}
        count, reason = 0, "its index"
        try:
            for channel, stamp, data in self._files.messages(keys):
                self._types.decode(channel.key, data)
                count += 1
                yield keys[channel.key], stamp, data
        # Every error in a damaged file counts as damage, see `_damage_reported`.
        except Exception as error:
            reason = f"after message {count}: {error}"
        self.notes = (
            f"it is damaged ({reason}): only the {count} messages before the damage are used",
        )

    def _field_reader(self, topic: Topic, field: str) -> Callable[[bytes], bytes]:
        with self._damage_reported():
            read = self._types.field_reader((topic.name, topic.type), field)

        def extracted(data: bytes) -> bytes:
            with self._damage_reported():
                return read(data)

        return extracted

    def _damage_reported(self) -> AbstractContextManager[None]:
        return damage_reported(self.path, self.format)


@contextmanager
def _hint_at_salvage(salvage: bool) -> Iterator[None]:
    """Add advice to reports of damage."""
    try:
        yield
    except DamagedRecordingError as error:
        if salvage:
            raise
        hint = (
            "recovering it (--recover; salvage=True in Python) reads the part before the damage, "
            "if there is any"
        )
        raise DamagedRecordingError(f"{error}; {hint}") from error.__cause__


def choose_topic(topics: Sequence[Topic], topic: str | None = None) -> Topic:
    """Choose the topic to read: the given one, else the only one with joint states.

    Where there are no joint states, the only one with commanded motions (JointTrajectory).

    Raises
    ------
    RecordingError
        If there is no such topic, or there are several and none is given.
    """
    states = [item for item in topics if item.type == JOINT_STATE]
    commands = [item for item in topics if item.type == JOINT_TRAJECTORY]
    if topic is not None:
        for item in (*states, *commands):
            if item.name == topic:
                return item
        raise RecordingError(
            f"there are no joint states on '{topic}'; topics with joint states: "
            f"{quote_names(item.name for item in states)}; with commanded motions: "
            f"{quote_names(item.name for item in commands)}"
        )
    for found, what in ((states, "joint states"), (commands, "commanded motions")):
        if len(found) > 1:
            raise RecordingError(
                f"several topics hold {what}: {quote_names(item.name for item in found)}; choose "
                "one of these topics"
            )
        if found:
            return found[0]
    raise RecordingError(
        f"no topic holds joint states ({JOINT_STATE}) or commanded motions ({JOINT_TRAJECTORY}); "
        "topics: " + (", ".join(f"'{item.name}' ({item.type})" for item in topics) or "none")
    )
