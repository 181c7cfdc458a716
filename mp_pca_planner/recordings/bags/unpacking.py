# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Bounded decompression of files, chunks and messages of bags."""

from __future__ import annotations

import bz2
import shutil
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]

from ...input_limits import INPUT_LIMITS

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"

_DECOMPRESSORS: Mapping[str, Callable[[], Any]] = {
    "bz2": bz2.BZ2Decompressor,
    "lz4": LZ4FrameDecompressor,
    "zstd": zstd.ZstdDecompressor,
}


class UnpackingError(Exception):
    """Compressed content that is cut off or too large."""


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
    UnpackingError
        If the compression is unknown, the content is cut off, or it is larger than declared or
        than is accepted.
    """
    if kind in ("", "none"):
        return data
    if kind not in _DECOMPRESSORS:
        raise UnpackingError(f"compression '{kind}' is not known")
    accepted = INPUT_LIMITS.unpacked_bytes
    limit = accepted if declared is None else declared
    if limit > accepted:
        raise UnpackingError(f"{limit:,} bytes are declared; accepted are {accepted:,}")
    parts, size = [], 0
    while data:
        decompressor = _DECOMPRESSORS[kind]()
        parts.append(decompressor.decompress(data, max_length=limit - size + 1))
        size += len(parts[-1])
        if size > limit:
            raise UnpackingError(f"it unpacks to more than {limit:,} bytes")
        if not decompressor.eof:
            raise UnpackingError("the compressed content is cut off")
        data = decompressor.unused_data
    return b"".join(parts)


class ChunkUnpacker:
    """Unpacks the chunks of one file within a bound on their total size.

    Parameters
    ----------
    stored :
        Size of the file [bytes].
    """

    def __init__(self, stored: int) -> None:
        self._stored, self._declared = stored, 0

    def __call__(self, kind: str, data: bytes, declared: int) -> bytes:
        """Unpack a chunk, see :func:`unpacked`."""
        self._declared += declared
        _check_size(self._declared, self._stored)
        return unpacked(kind, data, declared)


def copy_unpacked(source: Path, target: Path) -> None:
    """Unpack a zstd file to another file, which stays incomplete if this fails.

    Raises
    ------
    UnpackingError
        If the content is too large for its file, or for the disk.
    """
    stored = source.stat().st_size
    room = int(INPUT_LIMITS.disk_share * shutil.disk_usage(target.parent).free)
    size = 0
    with zstd.open(source, "rb") as packed, target.open("wb") as file:
        while block := packed.read(1 << 16):
            size += len(block)
            _check_size(size, stored)
            if size > room:
                raise UnpackingError(
                    f"it unpacks to more than {room:,} bytes, too many for '{target.parent}'"
                )
            file.write(block)


def _check_size(size: int, stored: int) -> None:
    limit = max(INPUT_LIMITS.unpacked_bytes, INPUT_LIMITS.unpacked_ratio * stored)
    if size > limit:
        raise UnpackingError(
            f"its {stored:,} bytes unpack to {size:,} or more; accepted are {limit:,}"
        )
