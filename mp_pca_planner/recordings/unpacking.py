# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Bounded decompression: what is compressed in a bag never unpacks to more than is stated here."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, BinaryIO

MAX_UNPACKED = 256 << 20
"""A chunk or a message has at most so many bytes."""

MAX_RATIO = 200
"""A file unpacks to at most so many times its size, or to :data:`MAX_UNPACKED` if that is more;
joint states of a robot that stands still reach a hundred times."""

MAX_DISK_SHARE = 0.5
"""A file that must be unpacked beside the recording takes at most that share of the free space."""

_BLOCK = 1 << 16

Decompressors = Mapping[str, Callable[[], Any]]
"""Makers of incremental decompressors, as those of the standard library are, by compression."""


class UnpackingError(Exception):
    """Compressed content that is cut off, or larger than it may be."""


def unpacked(
    decompressors: Decompressors, kind: str, data: bytes, declared: int | None = None
) -> bytes:
    """Unpack what is compressed as a whole.

    Parameters
    ----------
    decompressors :
        The compressions that are known; "" and "none" are none.
    kind :
        The name of the compression.
    data :
        What is stored.
    declared :
        The size that it has unpacked, by its own account [bytes].

    Raises
    ------
    UnpackingError
        If the compression is unknown, the content is cut off, or it is larger than declared or
        than :data:`MAX_UNPACKED`.
    """
    if kind in ("", "none"):
        return data
    if kind not in decompressors:
        raise UnpackingError(f"compression '{kind}' is not known")
    limit = MAX_UNPACKED if declared is None else declared
    if limit > MAX_UNPACKED:
        raise UnpackingError(f"{limit:,} bytes are declared: accepted are {MAX_UNPACKED:,}")
    parts, size = [], 0
    while data:
        decompressor = decompressors[kind]()
        parts.append(decompressor.decompress(data, max_length=limit - size + 1))
        size += len(parts[-1])
        if size > limit:
            raise UnpackingError(f"it unpacks to more than {limit:,} bytes")
        if not decompressor.eof:
            raise UnpackingError("what is compressed is cut off")
        data = decompressor.unused_data
    return b"".join(parts)


def check_unpacked_size(size: int, stored: int) -> None:
    """Refuse a file that would unpack to too much.

    Parameters
    ----------
    size, stored :
        Its size unpacked, as declared or as found so far, and as stored [bytes].

    Raises
    ------
    UnpackingError
        If it is too large.
    """
    limit = max(MAX_UNPACKED, MAX_RATIO * stored)
    if size > limit:
        raise UnpackingError(
            f"its {stored:,} bytes unpack to {size:,} or more: accepted are {limit:,}"
        )


def copy_unpacked(packed: BinaryIO, target: Path, stored: int) -> None:
    """Unpack a file to another one, which may stay incomplete.

    Parameters
    ----------
    packed :
        Reads what is unpacked.
    target :
        The file to write.
    stored :
        Size of the file as stored [bytes].

    Raises
    ------
    UnpackingError
        If it is too large, see :func:`check_unpacked_size`, or there is no room for it.
    """
    room = int(MAX_DISK_SHARE * shutil.disk_usage(target.parent).free)
    size = 0
    with target.open("wb") as file:
        while block := packed.read(_BLOCK):
            size += len(block)
            check_unpacked_size(size, stored)
            if size > room:
                raise UnpackingError(
                    f"it unpacks to more than {room:,} bytes, for which there is no room in "
                    f"'{target.parent}'"
                )
            file.write(block)
