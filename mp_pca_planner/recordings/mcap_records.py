# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Records of mcap, the storage format, as far as reading messages needs them."""

from __future__ import annotations

import struct
from collections.abc import Container

MESSAGE = 0x05

CHUNK_HEAD = 41
"""Bytes of a chunk up to the name of its compression."""

_HEAD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<BQHIQQ")


def chunk_messages(chunk: bytes, channels: Container[int]) -> list[tuple[int, int, bytes]]:
    """Find the messages of some channels in a chunk.

    Parameters
    ----------
    chunk :
        The records of the chunk, decompressed.
    channels :
        Numbers of the channels.

    Returns
    -------
    messages : list of (receive_stamp, channel, message)
        In the order of reception; the stamp in nanoseconds.

    Raises
    ------
    ValueError
        If a record ends behind the chunk.
    """
    messages = []
    position, end = 0, len(chunk)
    try:
        while position < end:
            kind, size = _HEAD.unpack_from(chunk, position)
            following = position + _HEAD.size + size
            if following > end:
                raise ValueError(f"a record of mcap ends {following - end} bytes too late")
            if kind == MESSAGE:
                _, _, channel, _, stamp, _ = _MESSAGE.unpack_from(chunk, position)
                if channel in channels:
                    messages.append((stamp, channel, chunk[position + _MESSAGE.size : following]))
            position = following
    except struct.error as error:
        raise ValueError(f"a record of mcap is incomplete: {error}") from None
    messages.sort(key=lambda message: message[0])
    return messages
