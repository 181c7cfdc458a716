# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The metadata.yaml of a rosbag2 folder."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path, PurePath

from ...exceptions import quote_names
from ...files import load_yaml, read_bytes
from .discovery import METADATA
from .storage import DamageError, Key

VERSION = 9
"""Newest version of metadata.yaml that is known."""


@dataclass(frozen=True)
class FolderMetadata:
    """What metadata.yaml says of a folder.

    Attributes
    ----------
    files : tuple of Path
        The storage files, in order.
    counts : Counter
        Number of messages by topic and type.
    packs_messages : bool
        Whether each message is compressed by itself.
    """

    files: tuple[Path, ...]
    counts: Counter[Key]
    packs_messages: bool


def read_metadata(folder: Path) -> FolderMetadata | None:
    """Read metadata.yaml; None if there is none.

    The metadata of rosbags parses YAML in pure Python, which takes longer than reading a short
    recording.

    Raises
    ------
    DamageError
        If a file is missing, or the folder is stored in a way that is not known.
    """
    try:
        text = read_bytes(folder / METADATA)
    except FileNotFoundError:
        return None
    content = load_yaml(text)["rosbag2_bagfile_information"]
    if content["version"] > VERSION:
        raise DamageError(f"version {content['version']} of {METADATA} is not known")
    counts: Counter[Key] = Counter()
    for topic in content["topics_with_message_count"]:
        about = topic["topic_metadata"]
        if about["serialization_format"] != "cdr":
            raise DamageError(f"messages are stored as {about['serialization_format']}")
        counts[about["name"], about["type"]] += topic["message_count"]
    files = tuple(folder / PurePath(name).name for name in content["relative_file_paths"])
    missing = [file.name for file in files if not file.is_file()]
    if missing:
        raise DamageError(f"files are missing: {quote_names(missing)}")
    mode = (content.get("compression_mode") or "none").lower()
    if mode != "none" and content.get("compression_format") != "zstd":
        raise DamageError(f"compression by {content.get('compression_format')!r} is not known")
    return FolderMetadata(files, counts, mode == "message")
