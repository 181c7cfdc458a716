# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Common types and functions of the readers of all storage formats."""

from __future__ import annotations

import mmap
from collections import Counter
from collections.abc import Container, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from operator import itemgetter
from pathlib import Path
from typing import NamedTuple, Protocol

from .unpacking import ChunkUnpacker

Buffer = bytes | mmap.mmap

Key = tuple[str, str]
"""Topic and type."""


class Channel(NamedTuple):
    """A topic and the type of its messages.

    Attributes
    ----------
    topic : str
        Name of the topic.
    type : str
        Type of its messages as ROS 2 writes it (``pkg/msg/Name``).
    definition : str
        Definition of the type as .msg text, '' if the file has none.
    """

    topic: str
    type: str
    definition: str = ""

    @property
    def key(self) -> Key:
        """Topic and type."""
        return self.topic, self.type


StoredMessage = tuple[Channel, int, bytes]
"""Channel, time of reception [ns] and the message as stored."""


class DamageError(Exception):
    """A file that can't be read from here on."""


class StorageFile(Protocol):
    """A file of a recording."""

    def index(self) -> Counter[Channel]:
        """Number of messages of each channel, by the index of the file."""

    def messages(self, keys: Container[Key] | None = None) -> Iterator[StoredMessage]:
        """Messages of some channels (all by default), in order of writing up to the damage."""


@dataclass
class Pass:
    """State of one pass over a file.

    Attributes
    ----------
    keys : container of Key, or None
        Channels to read; None stands for all.
    unpack : ChunkUnpacker
        Unpacks the chunks.
    channels : dict
        Channels to read, by their identifier in the file.
    """

    keys: Container[Key] | None
    unpack: ChunkUnpacker
    channels: dict[int, Channel] = field(default_factory=dict)

    def add(self, identifier: int, channel: Channel) -> None:
        """Add a channel if it is to be read."""
        if self.keys is None or channel.key in self.keys:
            self.channels[identifier] = channel


def by_reception(messages: Iterator[StoredMessage]) -> Iterator[StoredMessage]:
    """Messages of a chunk in order of reception; those before the damage come before its error."""
    found = []
    try:
        for message in messages:
            found.append(message)
    finally:
        yield from sorted(found, key=itemgetter(1))


def total(channels: Mapping[int, Channel], counts: Mapping[int, int]) -> Counter[Channel]:
    """Number of messages of each channel, from those by identifier; also of empty channels."""
    found: Counter[Channel] = Counter()
    for identifier, channel in channels.items():
        found[channel] += counts.get(identifier, 0)
    return found


@contextmanager
def mapped(path: Path) -> Iterator[mmap.mmap]:
    """Map a file into memory."""
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        yield content


def ros2_type(name: str) -> str:
    """Name of a type as ROS 2 writes it: ROS 1 leaves out the part between the slashes."""
    package, slash, kind = name.partition("/")
    return name if not slash or "/" in kind else f"{package}/msg/{kind}"
