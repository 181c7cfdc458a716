# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Common types and functions of the readers of all storage formats; bounded decompression."""

from __future__ import annotations

import bz2
import mmap
import shutil
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import pairwise
from operator import itemgetter
from pathlib import Path
from typing import Any, NamedTuple

from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]

from ...input_limits import INPUT_LIMITS

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

Buffer = bytes | mmap.mmap


class Channel(NamedTuple):
    """A topic and the type of its messages, as ROS 2 writes it (``pkg/msg/Name``)."""

    topic: str
    type: str


StoredMessage = tuple[Channel, int, bytes]
"""Channel, time of reception [ns] and the message as stored."""


CLOCK_STEP = 50_000_000
"""A clock was set back if the times of reception of a topic step back by more than this [ns]."""


class DamageError(Exception):
    """A file that can't be read from here on, such as one that unpacks to too many bytes."""


def by_reception(messages: Iterator[StoredMessage]) -> Iterator[StoredMessage]:
    """Messages of a chunk in order of reception; those before the damage come before its error.

    Where the clock was set back, its times don't show the order: the messages are left as written.
    """
    found: list[StoredMessage] = []
    try:
        for message in messages:
            found.append(message)
    finally:
        yield from found if _was_set_back(found) else sorted(found, key=itemgetter(1))


def _was_set_back(messages: Sequence[StoredMessage]) -> bool:
    """Whether the times of reception step back between messages of a topic."""
    if all(before[1] <= message[1] for before, message in pairwise(messages)):
        return False
    latest: dict[Channel, int] = {}
    for channel, stamp, _ in messages:
        if stamp < latest.get(channel, stamp) - CLOCK_STEP:
            return True
        latest[channel] = stamp
    return False


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


ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"

_DECOMPRESSORS: Mapping[str, Callable[[], Any]] = {
    "bz2": bz2.BZ2Decompressor,
    "lz4": LZ4FrameDecompressor,
    "zstd": zstd.ZstdDecompressor,
}


def unpacked(kind: str, data: bytes, declared: int | None = None) -> bytes:
    """Unpack a chunk or a message.

    Parameters
    ----------
    kind :
        Name of the compression; "" and "none" are no compression.
    data :
        The stored bytes.
    declared :
        Unpacked size as stated in the file [bytes].

    Raises
    ------
    DamageError
        If the compression is unknown, the content is cut off, or it is larger than declared or
        than is accepted.
    """
    if kind in ("", "none"):
        return data
    if kind not in _DECOMPRESSORS:
        raise DamageError(f"compression '{kind}' is not known")
    accepted = INPUT_LIMITS.unpacked_bytes
    limit = accepted if declared is None else declared
    if limit > accepted:
        raise DamageError(f"{limit:,} bytes are declared; accepted are {accepted:,}")
    parts, size = [], 0
    while data:
        decompressor = _DECOMPRESSORS[kind]()
        parts.append(decompressor.decompress(data, max_length=limit - size + 1))
        size += len(parts[-1])
        if size > limit:
            raise DamageError(f"it unpacks to more than {limit:,} bytes")
        if not decompressor.eof:
            raise DamageError("the compressed content is cut off")
        data = decompressor.unused_data
    return b"".join(parts)


def copy_unpacked(source: Path, target: Path) -> None:
    """Unpack a zstd file to another file, which stays incomplete if this fails.

    Raises
    ------
    DamageError
        If the content is too large for its file, or for the disk.
    """
    stored = source.stat().st_size
    room = int(INPUT_LIMITS.disk_share * shutil.disk_usage(target.parent).free)
    size = 0
    with zstd.open(source, "rb") as packed, target.open("wb") as file:
        while block := packed.read(1 << 16):
            size += len(block)
            check_size(size, stored)
            if size > room:
                raise DamageError(
                    f"it unpacks to more than {room:,} bytes, too many for '{target.parent}'"
                )
            file.write(block)


def check_size(size: int, stored: int) -> None:
    """Raise a DamageError if `stored` bytes unpack to so many that no recording does."""
    limit = max(INPUT_LIMITS.unpacked_bytes, INPUT_LIMITS.unpacked_ratio * stored)
    if size > limit:
        raise DamageError(
            f"its {stored:,} bytes unpack to {size:,} or more; accepted are {limit:,}"
        )
