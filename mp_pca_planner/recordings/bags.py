# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Bag files of ROS 1 and ROS 2: find, read and write them. The only module that imports rosbags."""

from __future__ import annotations

import bz2
import glob
import hashlib
import os
import re
import sqlite3
import struct
import tempfile
from collections import Counter
from collections.abc import Callable, Collection, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cache, partial
from itertools import pairwise
from pathlib import Path, PurePath
from typing import Any, Literal, TypeVar
from urllib.parse import quote
from zlib import crc32

import numpy as np
from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]
from numpy.typing import ArrayLike
from rosbags.interfaces import Connection, MessageDefinition, MessageDefinitionFormat, Nodetype
from rosbags.rosbag1 import Reader as Reader1
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag1.reader import Chunk, Header, RecordType
from rosbags.rosbag2 import ReaderError, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.rosbag2 import reader as reader2
from rosbags.rosbag2.storage_mcap import DECOMPRESSORS, ChunkInfo, McapReader
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.msg import normalize_msgtype
from rosbags.typesys.store import Typestore

from ..arrays import FloatArray, frozen_array, unique_names
from ..exceptions import DamagedRecordingError, RecordingError, quote_names, unknown_name
from ..files import (
    exists_already,
    load_yaml,
    read_bytes,
    replace_path,
    take_free_name,
    workspace_beside,
)
from ..motion.trajectory import Trajectory
from .byte_layout import ENCAPSULATION, most_spare_bytes
from .byte_layout import NS_PER_S as NS_PER_S
from .joint_states import IntArray as IntArray
from .joint_states import JointStateCollector, RawJointStates, joined
from .mcap_records import CHUNK_HEAD, chunk_messages
from .salvage import (
    Found,
    opened_sqlite3,
    salvaged_mcap,
    salvaged_rosbag1,
    salvaged_sqlite3,
)
from .unpacking import MAX_UNPACKED, check_unpacked_size, copy_unpacked, unpacked

BagFormat = Literal["rosbag1", "sqlite3", "mcap"]

JOINT_STATE = "sensor_msgs/msg/JointState"
JOINT_TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
MARKER_ARRAY = "visualization_msgs/msg/MarkerArray"
METADATA = "metadata.yaml"
METADATA_VERSION = 9
FORMAT_OF_SUFFIX: dict[str, BagFormat] = {".bag": "rosbag1", ".db3": "sqlite3", ".mcap": "mcap"}
PACKED_SUFFIXES = (".zstd", ".zst")
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"

_SQLITE_LIMIT_LENGTH = 0
"""Of sqlite: which limit is that of the length of a value."""

MAX_STAMP = 1 << 63
"""Stamps are stored in 64 bits, but not all that these can hold is a time [ns]."""

MAX_DEFINITION = 1 << 17
"""Definitions of messages have at most so many characters; large ones of ROS have a third."""

PART_MESSAGES = 1 << 16
"""Joint states are handed on in parts of so many messages."""

# Of visualization_msgs/Marker.
_SPHERE, _ADD = 2, 0

Result = TypeVar("Result")


@dataclass(frozen=True)
class Topic:
    """A topic of a bag; one that carries several types appears once for each.

    Attributes
    ----------
    name, type : str
        Its name, and the type of its messages as ROS 2 writes it (``pkg/msg/Name``).
    count : int
        How many messages there are.
    """

    name: str
    type: str
    count: int


Stored = tuple[Topic, int, bytes]
"""Topic, time of reception [ns] and a message as it is stored."""


def find_recordings(paths: str | Path | Iterable[str | Path]) -> tuple[Path, ...]:
    """Expand files, rosbag2 folders, folders of bags and glob patterns to single recordings.

    One path stands for a list of it alone. A folder is searched with its subfolders. A rosbag2
    folder (one with a metadata.yaml) is one recording. A file that is given by its name is taken
    whatever its suffix, so that it can be refused by name.

    Raises
    ------
    RecordingError
        If a path does not exist or holds no recording.
    """
    found: dict[Path, Path] = {}
    for path in [paths] if isinstance(paths, str | Path) else paths:
        with _translated_os_errors(path):
            recordings = [item for match in _glob(path) for item in _recordings_in(match)]
        if not recordings:
            raise RecordingError(
                f"no recording at '{path}': wanted is a .bag, .db3 or .mcap file, a rosbag2 "
                "folder, or a folder that holds some of these"
            )
        for recording in recordings:
            # Links and overlapping patterns may lead to the same place.
            found.setdefault(recording.resolve(), recording)
    return tuple(found.values())


def recording_names(paths: Sequence[Path]) -> tuple[str, ...]:
    """Name recordings by their file or folder; those of the same name with their parents too."""
    names = [_own_name(path) for path in paths]
    counts = Counter(names)
    return tuple(
        name if counts[name] == 1 else f"{path.resolve().parent.name}/{name}"
        for path, name in zip(paths, names, strict=True)
    )


def recording_format(path: Path) -> BagFormat:
    """Tell the storage format of a recording.

    Raises
    ------
    RecordingError
        If it is neither a bag file nor a rosbag2 folder.
    """
    with _translated_os_errors(path):
        path.stat()
        suffixes = {_suffix(file) for file in _bag_files(path)}
    if len(suffixes) != 1:
        raise RecordingError(
            f"'{path}' is no recording: expected a regular .bag, .db3 or .mcap file, or a rosbag2 "
            "folder"
        )
    return FORMAT_OF_SUFFIX[suffixes.pop()]


def checksum(path: Path) -> str:
    """SHA-256 of the stored bytes, of all storage files one after the other in order of name.

    Raises
    ------
    RecordingError
        If they can't be read.
    """
    digest = hashlib.sha256()
    with _translated_os_errors(path):
        for file in _storage_files(path):
            with file.open("rb") as stream:
                while block := stream.read(1 << 20):
                    digest.update(block)
    return digest.hexdigest()


def stored_size(path: Path) -> int:
    """Size of what is stored [bytes].

    Raises
    ------
    RecordingError
        If that can't be found out.
    """
    with _translated_os_errors(path):
        return sum(file.stat().st_size for file in _storage_files(path))


@contextmanager
def open_bag(path: Path, *, salvage: bool = False) -> Iterator[Bag]:
    """Open a recording, once for all that is read from it.

    Parameters
    ----------
    path :
        The recording.
    salvage :
        If it is damaged, let what is before the damage be read.

    Raises
    ------
    RecordingError
        If it can't be read.
    """
    _check_readable(path)
    bag_format = recording_format(path)
    with _hint_at_salvage(salvage), ExitStack() as stack:
        reader: _Reader | None = None
        failure: DamagedRecordingError | None = None
        try:
            with _damage_told(path, bag_format):
                reader = stack.enter_context(_opened(path, bag_format))
                _check_connections(reader.connections)
        except DamagedRecordingError as error:
            reader, failure = None, error
        if failure is not None and not salvage:
            raise failure
        bag = Bag(path, bag_format, reader, salvage=salvage)
        if failure is not None and not bag.topics:
            raise failure
        yield bag


@contextmanager
def _hint_at_salvage(salvage: bool) -> Iterator[None]:
    """Say of damage, wherever it shows, what could be done."""
    try:
        yield
    except DamagedRecordingError as error:
        if salvage:
            raise
        hint = "salvaging it takes what is before the damage, if there is any"
        raise DamagedRecordingError(f"{error}; {hint}") from error.__cause__


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
        What is worth knowing about how the messages were read last, one sentence each.
    """

    def __init__(
        self, path: Path, bag_format: BagFormat, reader: _Reader | None, *, salvage: bool
    ) -> None:
        self.path, self.format = path, bag_format
        self.notes: tuple[str, ...] = ()
        self._reader, self._salvage = reader, salvage
        self._definitions: dict[tuple[str, str], MessageDefinition] = {}
        self._stores: dict[Topic, Typestore] = {}
        counts: Counter[tuple[str, str]] = Counter()
        if reader is not None:
            for connection in reader.connections:
                key = (connection.topic, connection.msgtype)
                counts[key] += connection.msgcount
                if connection.msgdef.data:
                    self._definitions[key] = connection.msgdef
        else:
            counts.update((found.topic, found.type) for found in self._before_damage([]))
        self.topics = tuple(Topic(*key, count) for key, count in sorted(counts.items()))

    def read(self, topics: Collection[Topic], use: Callable[[Iterator[Stored]], Result]) -> Result:
        """Hand the messages of some topics to a function; of a damaged bag those before the damage.

        Parameters
        ----------
        topics :
            Some of :attr:`topics`.
        use :
            A function of the messages: topic, time of reception [ns], and the message as stored. It
            is called again where damage shows only while reading and salvage was asked for.

        Raises
        ------
        RecordingError
            If the messages can't be read, wholly or in part.
        """
        if self._reader is not None:
            try:
                return use(self._indexed(self._reader, topics))
            except DamagedRecordingError:
                if not self._salvage or not any(True for _ in self._salvaged(topics)):
                    raise
        return use(self._salvaged(topics))

    def deserialise(self, topic: Topic, data: bytes) -> Any:
        """Deserialise a message of a type that rosbags knows.

        Raises
        ------
        RecordingError
            If it does not hold such a message.
        """
        with _damage_told(self.path, self.format):
            return _decoder(self.format)(data, topic.type)

    def joint_states(
        self,
        topic: str,
        use: Callable[[Iterator[RawJointStates]], Result],
        *,
        field: str | None = None,
        progress: Callable[[float], None] | None = None,
    ) -> Result:
        """Hand the joint states of a topic to a function, part by part.

        Types of other topics don't matter, known or not: the definition of JointState has never
        changed, so those stored in the bag are not needed, except for `field`.

        Parameters
        ----------
        topic :
            Name of the topic.
        use :
            A function of the parts, each of :data:`PART_MESSAGES` messages or, the last one, fewer;
            there is at least one. See :meth:`read`.
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
        chosen = [
            item
            for item in self.topics
            if item.name == topic and (field or item.type == JOINT_STATE)
        ]
        if field is not None and not chosen:
            raise RecordingError(
                f"there is no topic '{topic}'; topics: "
                f"{quote_names(sorted({item.name for item in self.topics}))}"
            )
        unpack = {} if field is None else {t: self._field_reader(t, field) for t in chosen}
        n_all = max(1, sum(item.count for item in chosen))
        state = Topic(topic, JOINT_STATE, 0)

        def parts(messages: Iterator[Stored]) -> Iterator[RawJointStates]:
            ros1 = self.format == "rosbag1"
            collector = JointStateCollector(lambda data: self.deserialise(state, data), ros1=ros1)
            for count, (source, receive_stamp, data) in enumerate(messages, start=1):
                collector.add(receive_stamp, unpack[source](data) if unpack else data)
                if count % PART_MESSAGES == 0:
                    if progress is not None:
                        progress(count / n_all)
                    yield collector.taken(topic)
            yield replace(collector.taken(topic), notes=self.notes)

        return self.read(chosen, lambda messages: use(parts(messages)))

    def _indexed(self, reader: _Reader, topics: Collection[Topic]) -> Iterator[Stored]:
        """Messages by the index, which must be as many as it says."""
        wanted = {(topic.name, topic.type): topic for topic in topics}
        connections = [c for c in reader.connections if (c.topic, c.msgtype) in wanted]
        count = 0
        with _damage_told(self.path, self.format):
            if connections:
                for connection, receive_stamp, data in reader.messages(connections):
                    _check_message(receive_stamp, data)
                    count += 1
                    yield wanted[connection.topic, connection.msgtype], receive_stamp, data
        n_stored = _stored_count(reader, connections)
        if count != n_stored:
            raise DamagedRecordingError(
                f"'{self.path}' is damaged: its index says {n_stored} messages on the topic, "
                f"{count} can be read"
            )
        self.notes = _folder_notes(reader, {(topic.name, topic.type) for topic in topics})

    def _salvaged(self, topics: Collection[Topic]) -> Iterator[Stored]:
        """Messages without an index; the damage may also be in one of those that are wanted."""
        wanted = {(topic.name, topic.type): topic for topic in topics}
        reasons: list[str] = []
        count = 0
        for found in self._before_damage(reasons):
            topic = wanted.get((found.topic, found.type))
            if topic is None:
                continue
            try:
                self._check(topic, found.data)
            except RecordingError as error:
                reasons.append(f"message {count + 1} can't be deserialised: {error.__cause__}")
                break
            count += 1
            yield topic, found.receive_stamp, found.data
        why = reasons[0] if reasons else "its index"
        self.notes = (
            f"it is damaged ({why}): only the {count} messages before the damage are used",
        )

    def _check(self, topic: Topic, data: bytes) -> None:
        if topic.type in _typestore(self.format).types:
            self.deserialise(topic, data)
        else:
            store = self._own_types(topic)
            with _damage_told(self.path, self.format):
                _decoder_of(store, self.format)(data, topic.type)

    def _before_damage(self, reasons: list[str]) -> Iterator[Found]:
        """Find messages without an index, in the order of writing; say why it ends early."""
        for file in _bag_files(self.path):
            try:
                with ExitStack() as stack:
                    (whole_file,) = _unpacked_files([file], stack, salvage=True)
                    for found in _salvaged_messages(whole_file):
                        _check_message(found.receive_stamp, found.data)
                        whole = found._replace(
                            type=normalize_msgtype(found.type), data=_unpacked_message(found.data)
                        )
                        _check_text(whole.topic, whole.type)
                        if found.definition:
                            self._definitions[whole.topic, whole.type] = MessageDefinition(
                                MessageDefinitionFormat.MSG, found.definition
                            )
                        yield whole
            # Whatever goes wrong in a damaged file is the damage; see `_damage_told`.
            except Exception as error:
                reasons.append(f"{file.name}: {error}" if str(error) else file.name)
                return

    def _field_reader(self, topic: Topic, field: str) -> Callable[[bytes], bytes]:
        """A function from a message to the joint states in it, both serialised."""
        decode = _decoder_of(self._own_types(topic), self.format)
        known = _typestore(self.format)
        encode = known.serialize_ros1 if self.format == "rosbag1" else known.serialize_cdr

        def unpacked(data: bytes) -> bytes:
            with _damage_told(self.path, self.format):
                return bytes(encode(_field(decode(data, topic.type), field), JOINT_STATE))

        return unpacked

    def embedded_states(self) -> list[tuple[str, str]]:
        """Topics whose messages have joint states in a field, and the name of this field."""
        found = []
        for topic in self.topics:
            with suppress(RecordingError):
                field = _field_of_states(self._own_types(topic), topic.type)
                if field:
                    found.append((topic.name, field))
        return found

    def _own_types(self, topic: Topic) -> Typestore:
        """Types as the bag itself defines them."""
        if topic in self._stores:
            return self._stores[topic]
        definition = self._definitions.get((topic.name, topic.type))
        if definition is None or definition.format != MessageDefinitionFormat.MSG:
            raise RecordingError(
                f"'{topic.name}' has messages of type {topic.type}, which the bag does not define "
                "as .msg text: only fields of defined messages can be read"
            )
        if len(definition.data) > MAX_DEFINITION:
            raise RecordingError(
                f"the definition of {topic.type} has {len(definition.data):,} characters: accepted "
                f"are {MAX_DEFINITION:,}"
            )
        store = get_typestore(Stores.EMPTY)
        with _damage_told(self.path, self.format):
            store.register(get_types_from_msg(definition.data, topic.type))
        self._stores[topic] = store
        return store


def list_topics(path: Path, *, salvage: bool = False) -> tuple[Topic, ...]:
    """List the topics of a recording, in order of name, see :func:`open_bag`."""
    with open_bag(path, salvage=salvage) as bag:
        return bag.topics


def read_joint_states(
    path: Path, topic: str, *, field: str | None = None, salvage: bool = False
) -> RawJointStates:
    """Read all joint states of a topic at once, see :meth:`Bag.joint_states`."""
    with open_bag(path, salvage=salvage) as bag:
        return bag.joint_states(topic, joined, field=field)


def _field(message: Any, field: str) -> Any:
    for name in field.split("."):
        valid = [item.name for item in fields(message)] if is_dataclass(message) else []
        if name not in valid:
            raise RecordingError(unknown_name(f"field of '{field}'", name, valid))
        message = getattr(message, name)
    kind = getattr(message, "__msgtype__", type(message).__name__)
    if kind != JOINT_STATE:
        raise RecordingError(f"the field '{field}' is a {kind}: wanted is a {JOINT_STATE}")
    return message


def _field_of_states(store: Typestore, kind: str) -> str:
    """Name of the first field that is a JointState, with dots where it is within others, or ''."""
    paths = {kind: ""}
    waiting = [kind]
    for current in waiting:
        _, fields_of_type = store.fielddefs.get(current, ((), ()))
        for name, description in fields_of_type:
            # Every type is searched once: types of types would take forever.
            inner = str(description[1])
            if description[0] == Nodetype.NAME and inner not in paths:
                paths[inner] = f"{paths[current]}.{name}".lstrip(".")
                waiting.append(inner)
    return "" if kind == JOINT_STATE else paths.get(JOINT_STATE, "")


def choose_topic(topics: Sequence[Topic], topic: str | None = None) -> Topic:
    """Choose the topic to read: the one asked for, else the only one with joint states.

    Where there are no joint states, the only one with commanded motions (JointTrajectory).

    Raises
    ------
    RecordingError
        If there is no such topic, or several and none was asked for.
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
                "one of them"
            )
        if found:
            return found[0]
    raise RecordingError(
        f"no topic holds joint states ({JOINT_STATE}) or commanded motions ({JOINT_TRAJECTORY}); "
        "topics: " + (", ".join(f"'{item.name}' ({item.type})" for item in topics) or "none")
    )


def write_joint_states(
    path: str | Path,
    bag_format: BagFormat,
    joint_names: Sequence[str],
    stamps_ns: ArrayLike,
    positions: ArrayLike,
    velocities: ArrayLike | None = None,
    efforts: ArrayLike | None = None,
    *,
    topic: str = "/joint_states",
    receive_stamps_ns: ArrayLike | None = None,
    overwrite: bool = False,
) -> None:
    """Write joint states as a bag, whole or not at all.

    Parameters
    ----------
    path :
        Where to write. For `bag_format` "rosbag1" a file. For the others a rosbag2 folder, or
        only its storage file if the path ends in .db3 or .mcap.
    bag_format :
        The format: "rosbag1", "sqlite3" or "mcap".
    joint_names :
        Names of the joints.
    stamps_ns : array of int, shape (n_steps,)
        Header stamps [ns].
    positions, velocities, efforts : array, shape (n_steps, n_joints)
        Joint positions [rad or m], velocities [/s] and efforts [N·m or N]; the last two stay
        empty unless given.
    topic :
        Name of the topic.
    receive_stamps_ns : array of int, shape (n_steps,)
        Times of reception [ns]; the header stamps unless given.
    overwrite :
        Replace what is there.

    Raises
    ------
    RecordingError
        If the shapes disagree.
    PlannerError
        If there is something at the path already, or it can't be written.
    """
    names = unique_names(joint_names, "joints to write", RecordingError)
    stamps = np.asarray(stamps_ns, dtype=np.int64)
    receive = stamps if receive_stamps_ns is None else np.asarray(receive_stamps_ns, dtype=np.int64)
    if stamps.ndim != 1 or receive.shape != stamps.shape:
        raise RecordingError("stamps to write must be one list of nanoseconds, one for each step")
    fields = [
        np.empty((stamps.size, 0))
        if values is None
        else frozen_array(values, (stamps.size, len(names)), what, RecordingError)
        for what, values in (
            ("positions to write", positions),
            ("velocities to write", velocities),
            ("efforts to write", efforts),
        )
    ]
    types = _typestore(bag_format).types
    messages = (
        (int(received), types[JOINT_STATE](_header(bag_format, int(stamp)), list(names), *rows))
        for received, stamp, *rows in zip(receive, stamps, *fields, strict=True)
    )
    _write(Path(path), bag_format, topic, JOINT_STATE, messages, overwrite)


def write_joint_trajectory(
    path: str | Path,
    trajectory: Trajectory,
    topic: str = "/joint_trajectory",
    *,
    overwrite: bool = False,
) -> None:
    """Write a trajectory as a bag that holds it as one JointTrajectory message at time 0.

    Parameters
    ----------
    path :
        Where to write: a ROS 1 bag if it ends in .bag, a bare storage file if it ends in .db3 or
        .mcap, else a rosbag2 folder (mcap).
    trajectory :
        What to write.
    topic :
        Name of the topic.
    overwrite :
        Replace what is there.

    Raises
    ------
    PlannerError
        If there is something at the path already, or it can't be written.
    """
    target = Path(path)
    bag_format = FORMAT_OF_SUFFIX.get(target.suffix, "mcap")
    types = _typestore(bag_format).types
    empty = np.empty(0)
    points = [
        types["trajectory_msgs/msg/JointTrajectoryPoint"](
            positions=trajectory.positions[step],
            velocities=trajectory.velocities[step],
            accelerations=trajectory.accelerations[step],
            effort=empty if trajectory.efforts is None else trajectory.efforts[step],
            time_from_start=types["builtin_interfaces/msg/Duration"](
                *divmod(round(float(time) * NS_PER_S), NS_PER_S)
            ),
        )
        for step, time in enumerate(trajectory.times)
    ]
    header = _header(bag_format, 0)
    message = types[JOINT_TRAJECTORY](header, list(trajectory.joint_names), points)
    _write(target, bag_format, topic, JOINT_TRAJECTORY, [(0, message)], overwrite)


def write_markers(
    path: str | Path,
    names: Sequence[str],
    stamps_ns: ArrayLike,
    positions: ArrayLike,
    topic: str = "/markers",
    *,
    frame_id: str = "world",
    overwrite: bool = False,
) -> None:
    """Write positions of markers as a rosbag2 folder (mcap) of MarkerArray, whole or not at all.

    Parameters
    ----------
    path :
        Where to write.
    names :
        Namespaces of the markers.
    stamps_ns : array of int, shape (n_frames,)
        Header stamps [ns].
    positions : array, shape (n_frames, n_markers, 3)
        Positions [m]; a marker of which one is NaN is left out of that frame.
    topic :
        Name of the topic.
    frame_id :
        The frame of the positions.
    overwrite :
        Replace what is there.

    Raises
    ------
    RecordingError
        If the shapes disagree.
    PlannerError
        If there is something at the path already, or it can't be written.
    """
    stamps, places = np.asarray(stamps_ns, dtype=np.int64), np.asarray(positions, dtype=np.float64)
    if stamps.ndim != 1 or places.shape != (stamps.size, len(names), 3):
        raise RecordingError(
            f"positions of markers to write must have the shape ({stamps.size}, {len(names)}, 3), "
            f"got {places.shape}"
        )
    types = _typestore("mcap").types
    nothing = np.empty(0, dtype=np.uint8)
    point, vector = types["geometry_msgs/msg/Point"], types["geometry_msgs/msg/Vector3"]
    pose, upright = types["geometry_msgs/msg/Pose"], types["geometry_msgs/msg/Quaternion"]
    kind = types["visualization_msgs/msg/Marker"]
    unstamped = _header("mcap", 0)
    same_for_all: dict[str, Any] = {
        "type": _SPHERE,
        "action": _ADD,
        "scale": vector(0.02, 0.02, 0.02),
        "color": types["std_msgs/msg/ColorRGBA"](1.0, 1.0, 1.0, 1.0),
        "lifetime": types["builtin_interfaces/msg/Duration"](0, 0),
        "frame_locked": False,
        "points": [],
        "colors": [],
        "texture_resource": "",
        "texture": types["sensor_msgs/msg/CompressedImage"](unstamped, "", nothing),
        "uv_coordinates": [],
        "text": "",
        "mesh_resource": "",
        "mesh_file": types["visualization_msgs/msg/MeshFile"]("", nothing),
        "mesh_use_embedded_materials": False,
    }

    def frame(stamp: int, seen: FloatArray) -> object:
        header = _header("mcap", stamp, frame_id)
        return types[MARKER_ARRAY](
            [
                kind(
                    header=header,
                    ns=name,
                    id=number,
                    pose=pose(point(*place), upright(0.0, 0.0, 0.0, 1.0)),
                    **same_for_all,
                )
                for number, (name, place) in enumerate(zip(names, seen.tolist(), strict=True))
                if np.isfinite(place).all()
            ]
        )

    messages = ((int(t), frame(int(t), seen)) for t, seen in zip(stamps, places, strict=True))
    _write(Path(path), "mcap", topic, MARKER_ARRAY, messages, overwrite)


def _glob(path: str | Path) -> list[Path]:
    # An existing path is meant as it is, also with brackets in its name.
    if Path(path).exists():
        return [Path(path)]
    return [Path(match) for match in sorted(glob.glob(str(path), recursive=True))]


def _recordings_in(path: Path) -> list[Path]:
    if not path.is_dir() or (path / METADATA).exists():
        return [path]
    children = sorted(path.iterdir())
    if _has_lost_its_metadata(path, children):
        return [path]
    return [
        recording
        for child in children
        if child.is_dir() or child.suffix in FORMAT_OF_SUFFIX
        for recording in _recordings_in(child)
    ]


def _own_name(path: Path) -> str:
    resolved = path.resolve()
    return resolved.name if resolved.is_dir() else resolved.stem


def _storage_files(path: Path) -> list[Path]:
    if not path.is_dir():
        # Reading a pipe or a device may never end.
        return [path] if path.is_file() else []
    return sorted(file for file in path.iterdir() if file.is_file() and file.name != METADATA)


def _check_readable(path: Path) -> None:
    """Refuse what isn't there or may not be read, which readers would call damaged."""
    with _translated_os_errors(path):
        for file in _storage_files(path):
            with file.open("rb") as stream:
                stream.read(1)


def _bag_files(path: Path) -> list[Path]:
    """The files of a recording that hold messages, those of a split one by their numbers."""
    return sorted(
        (file for file in _storage_files(path) if _suffix(file) in FORMAT_OF_SUFFIX),
        key=lambda file: [int(t) if t.isdecimal() else t for t in re.split(r"(\d+)", file.name)],
    )


def _suffix(file: Path) -> str:
    """Suffix of a file, but not that of its compression."""
    return (file.with_suffix("") if file.suffix in PACKED_SUFFIXES else file).suffix


def _has_lost_its_metadata(folder: Path, children: Sequence[Path]) -> bool:
    """Tell a rosbag2 folder without metadata.yaml by the names of its files."""
    ours = re.compile(re.escape(folder.resolve().name) + r"_\d+\.(db3|mcap)(\.zstd|\.zst)?")
    bags = [file.name for file in children if _suffix(file) in FORMAT_OF_SUFFIX]
    return bool(bags) and all(ours.fullmatch(name) for name in bags)


@contextmanager
def _translated_os_errors(path: str | Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise RecordingError(f"'{path}' can't be read: {error.strerror or error}") from None


@contextmanager
def _damage_told(path: Path, bag_format: BagFormat) -> Iterator[None]:
    """Make whatever goes wrong in reading a RecordingError that names the recording."""
    try:
        yield
    except RecordingError:
        raise
    except PermissionError as error:
        raise RecordingError(f"'{path}' can't be read: {error.strerror}") from None
    # rosbags reports some damage itself, but for the rest lets through what its lower layers
    # raise: struct, lz4, zstd, bz2, apsw, yaml, KeyError, AssertionError, MemoryError for a
    # huge length ... That list is open, and only reading happens inside.
    except Exception as error:
        reason = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
        raise DamagedRecordingError(
            f"'{path}' can't be read: damaged, cut off or no {bag_format} recording ({reason})"
        ) from error


def _opened(path: Path, bag_format: BagFormat) -> AbstractContextManager[_Reader]:
    if bag_format == "rosbag1":
        return _Rosbag1Reader(path)
    return _FolderReader(path) if path.is_dir() else _FileReader(path)


def _check_connections(connections: Iterable[Connection]) -> None:
    for connection in connections:
        _check_text(connection.topic, connection.msgtype)


def _check_text(*names: object) -> None:
    for name in names:
        if not isinstance(name, str):
            raise ReaderError(f"a topic or a type is called {name!r:.40}, which is no text")


def _check_message(receive_stamp: object, data: object) -> None:
    """Refuse what sqlite lets through: it takes any value in any column."""
    if not isinstance(receive_stamp, int) or not 0 <= receive_stamp < MAX_STAMP:
        raise ReaderError(f"a message was received at {receive_stamp!r:.40} ns")
    if not isinstance(data, bytes):
        raise ReaderError(f"a message is stored as {type(data).__name__}, not as bytes")


def _stored_count(reader: _Reader, connections: Sequence[Connection]) -> int:
    """Count the messages by the index of the storage."""
    if isinstance(reader, Reader1):
        return sum(
            chunk.connection_counts.get(c.id, 0)
            for chunk in reader.chunk_infos
            for c in connections
        )
    return sum(c.msgcount for c in connections)


def _folder_notes(reader: _Reader, wanted: Collection[tuple[str, str]]) -> tuple[str, ...]:
    if not isinstance(reader, _FolderReader):
        return ()
    if reader.told is None:
        return (f"{METADATA} is missing: the files are read in the order of their numbers",)
    told = sum(count for key, count in reader.told.items() if key in wanted)
    stored = sum(c.msgcount for c in reader.connections if (c.topic, c.msgtype) in wanted)
    if told == stored:
        return ()
    return (f"{METADATA} tells of {told} messages on the topic, {stored} are stored: all are used",)


DECOMPRESSORS_BY_NAME = {
    "bz2": bz2.BZ2Decompressor,
    "lz4": LZ4FrameDecompressor,
    "zstd": reader2.zstd.ZstdDecompressor,  # type: ignore[attr-defined]
}

_unpacked = partial(unpacked, DECOMPRESSORS_BY_NAME)

# Chunks of mcap are decompressed in several places of rosbags, all of them through this table.
DECOMPRESSORS.update({kind: partial(_unpacked, kind) for kind in DECOMPRESSORS if kind})


class _Rosbag1Reader(Reader1):
    """A reader that holds chunks to the sizes they declare."""

    _n_declared = 0

    def read_chunk(self) -> Chunk:
        """Read the header of a chunk from the current position."""
        assert self.bio is not None
        start = self.bio.tell()
        header = Header.read(self.bio, RecordType.CHUNK)
        kind, size = header.get_string("compression"), header.get_uint32("size")
        self._n_declared += size
        check_unpacked_size(self._n_declared, self.path.stat().st_size)
        self.bio.seek(start)
        return super().read_chunk()._replace(decompressor=partial(_unpacked, kind, declared=size))


class _Sqlite3Reader(Sqlite3Reader):
    """A reader for paths of any letters: rosbags puts them into a URI as they are."""

    def __init__(self, path: Path) -> None:
        super().__init__(Path(quote(str(path.resolve()))))
        self._plain_path = path

    def open(self) -> None:
        """Open the file, with the bounds of :func:`.salvage.opened_sqlite3`."""
        with opened_sqlite3(self._plain_path):
            super().open()
        assert self.dbconn is not None
        self.dbconn.limit(_SQLITE_LIMIT_LENGTH, MAX_UNPACKED)


class _McapReader(McapReader):
    """A reader that is faster where chunks follow each other in time, as recorders write them."""

    def open(self) -> None:
        """Open the file, and hold its index to what may be."""
        super().open()
        if len({chunk.chunk_start_offset for chunk in self.chunks}) < len(self.chunks):
            raise ReaderError("its index lists a chunk twice")
        check_unpacked_size(
            sum(chunk.uncompressed_size for chunk in self.chunks), self.path.stat().st_size
        )

    def messages(
        self,
        connections: Collection[Connection],
        start: int | None = None,
        stop: int | None = None,
    ) -> Generator[tuple[Connection, int, bytes], None, None]:
        in_turn = all(
            before.message_end_time <= after.message_start_time
            and before.chunk_start_offset < after.chunk_start_offset
            for before, after in pairwise(self.chunks)
        )
        if start is not None or stop is not None or not self.chunks or not in_turn:
            yield from super().messages(connections, start, stop)
            return
        by_channel = {connection.id: connection for connection in connections}
        for chunk in self.chunks:
            for stamp, channel, data in chunk_messages(self._records(chunk), by_channel):
                yield by_channel[channel], stamp, data

    def _records(self, chunk: ChunkInfo) -> bytes:
        """Read and decompress a chunk, and hold it to its checksum where it has one."""
        assert self.bio is not None
        self.bio.seek(chunk.chunk_start_offset)
        head = self.bio.read(CHUNK_HEAD + len(chunk.compression) + 8)
        stored = self.bio.read(chunk.compressed_size)
        records = DECOMPRESSORS[chunk.compression](stored, chunk.uncompressed_size)
        checksum_stored = int.from_bytes(head[33:37], "little")
        if len(records) != chunk.uncompressed_size or (
            checksum_stored and crc32(records) != checksum_stored
        ):
            raise ReaderError(f"the chunk at byte {chunk.chunk_start_offset} is not as written")
        return records


_Storage = McapReader | Sqlite3Reader


class _FileReader:
    """A single file of rosbag2."""

    def __init__(self, path: Path) -> None:
        self._storage: _Storage = _STORAGES[path.suffix](path)

    def __enter__(self) -> _FileReader:
        self._storage.open()
        return self

    def __exit__(self, *_: object) -> None:
        self._storage.close()

    @property
    def connections(self) -> list[Connection]:
        return self._storage.connections

    def messages(
        self, connections: Collection[Connection]
    ) -> Iterator[tuple[Connection, int, bytes]]:
        return self._storage.messages(connections)


class _FolderReader:
    """A rosbag2 folder: its files one after the other, also without its metadata.yaml.

    The counts are those of the storage, not of the metadata. (rosbags parses YAML in pure Python,
    which takes longer than reading a short recording.)
    """

    def __init__(self, path: Path) -> None:
        self.connections: list[Connection] = []
        self.told: dict[tuple[str, str], int] | None = None
        self._path = path
        self._storages: list[_Storage] = []
        # Who knows, as long as there is no metadata.
        self._messages_packed = True
        self._stack = ExitStack()

    def __enter__(self) -> _FolderReader:
        with ExitStack() as stack:
            for file in _unpacked_files(self._files(), stack):
                storage: _Storage = _STORAGES[file.suffix](file)
                storage.open()
                stack.callback(storage.close)
                self._storages.append(storage)
                self.connections += storage.connections
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def messages(
        self, connections: Collection[Connection]
    ) -> Iterator[tuple[Connection, int, bytes]]:
        for storage in self._storages:
            own = [c for c in connections if c.owner is storage]
            if own and self._messages_packed:
                for connection, receive_stamp, data in storage.messages(own):
                    yield connection, receive_stamp, _unpacked_message(data)
            elif own:
                yield from storage.messages(own)

    def _files(self) -> list[Path]:
        try:
            text = read_bytes(self._path / METADATA)
        except FileNotFoundError:
            return _bag_files(self._path)
        content = load_yaml(text)["rosbag2_bagfile_information"]
        if content["version"] > METADATA_VERSION:
            raise ReaderError(f"version {content['version']} of {METADATA} is not known")
        self.told = {}
        for topic in content["topics_with_message_count"]:
            about = topic["topic_metadata"]
            if about["serialization_format"] != "cdr":
                raise ReaderError(f"messages are stored as {about['serialization_format']}")
            key = (about["name"], about["type"])
            self.told[key] = self.told.get(key, 0) + topic["message_count"]
        files = [self._path / PurePath(name).name for name in content["relative_file_paths"]]
        missing = [file.name for file in files if not file.is_file()]
        if missing:
            raise ReaderError(f"files are missing: {quote_names(missing)}")
        mode = (content.get("compression_mode") or "none").lower()
        if mode != "none" and content.get("compression_format") != "zstd":
            raise ReaderError(f"compression by {content.get('compression_format')!r} is not known")
        self._messages_packed = mode == "message"
        return files


def _unpacked_message(message: bytes) -> bytes:
    """Unpack a message that was compressed by itself; CDR never begins as those do."""
    return _unpacked("zstd", message) if message[:4] == ZSTD_MAGIC else message


def _unpacked_files(
    files: Iterable[Path], stack: ExitStack, *, salvage: bool = False
) -> Iterator[Path]:
    """Unpack files that were compressed as a whole; a damaged one as far as it goes."""
    for file in files:
        if file.suffix not in PACKED_SUFFIXES:
            yield file
            continue
        folder = stack.enter_context(tempfile.TemporaryDirectory())
        target = Path(folder, file.stem)
        with ExitStack() as opened:
            packed = opened.enter_context(reader2.zstd.open(file, "rb"))  # type: ignore[attr-defined]
            if salvage:
                opened.enter_context(suppress(Exception))
            copy_unpacked(packed, target, file.stat().st_size)
        yield target


_STORAGES: Mapping[str, Any] = {".mcap": _McapReader, ".db3": _Sqlite3Reader}
_Reader = Reader1 | _FolderReader | _FileReader


def _salvaged_messages(file: Path) -> Iterator[Found]:
    if file.suffix == ".db3":
        return salvaged_sqlite3(file)
    if file.suffix == ".mcap":
        return salvaged_mcap(file, _unpacked)
    return salvaged_rosbag1(file, _unpacked)


@cache
def _typestore(bag_format: BagFormat) -> Typestore:
    if bag_format != "rosbag1":
        return get_typestore(Stores.ROS2_JAZZY)
    store = get_typestore(Stores.ROS1_NOETIC)
    # Those of /tf are the only common ones that rosbags does not know of ROS 1.
    for name in ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage"):
        store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", name))
    return store


def _decoder(bag_format: BagFormat) -> Callable[[bytes, str], object]:
    return _decoder_of(_typestore(bag_format), bag_format)


def _decoder_of(store: Typestore, bag_format: BagFormat) -> Callable[[bytes, str], object]:
    if bag_format == "rosbag1":
        return store.deserialize_ros1

    def decode(data: bytes, message_type: str) -> object:
        try:
            return store.deserialize_cdr(data, message_type)
        except SerdeError:
            message = _decoded_with_spare_bytes(store, data, message_type)
            if message is None:
                raise
            return message

    return decode


def _decoded_with_spare_bytes(store: Typestore, data: bytes, message_type: str) -> object | None:
    """A message that no more bytes follow than may; rosbags allows for the padding only."""
    definition = store.get_msgdef(message_type)
    read = definition.deserialize_cdr_le if data[1:2] == b"\x01" else definition.deserialize_cdr_be
    try:
        message, end = read(data[ENCAPSULATION:], 0, definition.cls, store)
    except (struct.error, UnicodeDecodeError, ValueError):
        return None
    spare = len(data) - ENCAPSULATION - end
    return message if 0 <= spare <= most_spare_bytes(_n_empty(message)) else None


def _n_empty(value: Any) -> int:
    """How many sequences of numbers in a message are empty."""
    if isinstance(value, np.ndarray):
        return int(value.size == 0)
    if isinstance(value, list):
        return sum(map(_n_empty, value))
    return sum(map(_n_empty, vars(value).values())) if hasattr(value, "__msgtype__") else 0


def _header(bag_format: BagFormat, stamp_ns: int, frame_id: str = "") -> Any:
    types = _typestore(bag_format).types
    stamp = types["builtin_interfaces/msg/Time"](*divmod(stamp_ns, NS_PER_S))
    fields: dict[str, Any] = {"stamp": stamp, "frame_id": frame_id}
    if bag_format == "rosbag1":
        fields["seq"] = 0
    return types["std_msgs/msg/Header"](**fields)


def _write(
    target: Path,
    bag_format: BagFormat,
    topic: str,
    kind: str,
    messages: Iterable[tuple[int, object]],
    overwrite: bool,
) -> None:
    """Write a bag beside its place and move it there when it is complete."""
    if target.exists() and not overwrite:
        raise exists_already(target)
    if target.is_dir() and any(target.iterdir()) and _recordings_in(target) != [target]:
        raise RecordingError(f"'{target}' is a folder, but no recording: it is not overwritten")
    if bag_format == "sqlite3" and set(str(target.absolute())) & set("?#%"):
        raise RecordingError(
            f"'{target}' can't be written as sqlite3: choose a path without '?', '#' and '%'"
        )
    try:
        with workspace_beside(target) as workspace:
            written = _write_new(workspace / target.name, bag_format, topic, kind, messages)
            _keep_on_disk(written)
            (replace_path if overwrite else take_free_name)(written, target)
            _sync(target.parent)
    except FileExistsError:
        raise exists_already(target) from None
    except (OSError, sqlite3.Error) as error:
        raise RecordingError(
            f"'{target}' can't be written: {getattr(error, 'strerror', None) or error}"
        ) from None


def _keep_on_disk(path: Path) -> None:
    """Make sure that a bag is not lost if the power is, once it has got its name."""
    if path.is_dir():
        for file in path.iterdir():
            _sync(file)
    _sync(path)


def _sync(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _write_new(
    path: Path, bag_format: BagFormat, topic: str, kind: str, messages: Iterable[tuple[int, object]]
) -> Path:
    store = _typestore(bag_format)
    if bag_format == "rosbag1":
        with Writer1(path) as writer1:
            connection = writer1.add_connection(topic, kind, typestore=store)
            for stamp, message in messages:
                writer1.write(connection, stamp, store.serialize_ros1(message, kind))
        return path
    bare = path.suffix in FORMAT_OF_SUFFIX
    folder = path.with_suffix("") if bare else path
    plugin = StoragePlugin.MCAP if bag_format == "mcap" else StoragePlugin.SQLITE3
    with Writer2(folder, version=Writer2.VERSION_LATEST, storage_plugin=plugin) as writer2:
        connection = writer2.add_connection(topic, kind, typestore=store)
        for stamp, message in messages:
            writer2.write(connection, stamp, store.serialize_cdr(message, kind))
    return folder / f"{folder.name}{path.suffix}" if bare else folder
