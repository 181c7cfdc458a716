# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Discovery of recordings: their paths, names, formats and files."""

from __future__ import annotations

import glob
import hashlib
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Literal

from ...exceptions import RecordingError

BagFormat = Literal["rosbag1", "sqlite3", "mcap"]

METADATA = "metadata.yaml"
FORMAT_OF_SUFFIX: dict[str, BagFormat] = {".bag": "rosbag1", ".db3": "sqlite3", ".mcap": "mcap"}
PACKED_SUFFIXES = (".zstd", ".zst")


def find_recordings(paths: str | Path | Iterable[str | Path]) -> tuple[Path, ...]:
    """Expand files, rosbag2 folders, folders of bags and glob patterns to single recordings.

    A folder is searched with its subfolders. A rosbag2 folder (one with a metadata.yaml) is one
    recording. A file that is named itself is taken whatever its suffix; loading rejects it with a
    reason.

    Parameters
    ----------
    paths :
        One path or several.

    Raises
    ------
    RecordingError
        If a path does not exist or holds no recording.
    """
    found: dict[Path, Path] = {}
    for path in [paths] if isinstance(paths, str | Path) else paths:
        with translated_os_errors(path):
            recordings = [item for match in _glob(path) for item in recordings_in(match)]
        if not recordings:
            raise RecordingError(
                f"no recording at '{path}': expected a .bag, .db3 or .mcap file, a rosbag2 "
                "folder, or a folder that holds some of these"
            )
        for recording in recordings:
            # Links and overlapping patterns may lead to the same place.
            found.setdefault(recording.resolve(), recording)
    return tuple(found.values())


def recording_names(paths: Sequence[Path]) -> tuple[str, ...]:
    """Name recordings by their file or folder, and by its parent where several have that name."""
    names = [_own_name(path) for path in paths]
    counts = Counter(names)
    return tuple(
        name if counts[name] == 1 else f"{path.resolve().parent.name}/{name}"
        for path, name in zip(paths, names, strict=True)
    )


def recording_format(path: Path) -> BagFormat:
    """Storage format of a recording.

    Raises
    ------
    RecordingError
        If it is neither a bag file nor a rosbag2 folder.
    """
    with translated_os_errors(path):
        path.stat()
        suffixes = {_suffix(file) for file in bag_files(path)}
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
    with translated_os_errors(path):
        for file in _storage_files(path):
            with file.open("rb") as stream:
                while block := stream.read(1 << 20):
                    digest.update(block)
    return digest.hexdigest()


def stored_size(path: Path) -> int:
    """Size of the storage files [bytes].

    Raises
    ------
    RecordingError
        If their sizes can't be read.
    """
    with translated_os_errors(path):
        return sum(file.stat().st_size for file in _storage_files(path))


def recordings_in(path: Path) -> list[Path]:
    """The path itself if it is one recording, else the recordings in the folder."""
    if not path.is_dir() or (path / METADATA).exists():
        return [path]
    children = sorted(path.iterdir())
    if _has_lost_its_metadata(path, children):
        return [path]
    return [
        recording
        for child in children
        if child.is_dir() or child.suffix in FORMAT_OF_SUFFIX
        for recording in recordings_in(child)
    ]


def bag_files(path: Path) -> list[Path]:
    """Files of a recording that hold messages; those of a split one in order of their numbers."""
    return sorted(
        (file for file in _storage_files(path) if _suffix(file) in FORMAT_OF_SUFFIX),
        key=lambda file: [int(t) if t.isdecimal() else t for t in re.split(r"(\d+)", file.name)],
    )


@contextmanager
def translated_os_errors(path: str | Path) -> Iterator[None]:
    """Turn errors of the operating system into a RecordingError that names the path."""
    try:
        yield
    except OSError as error:
        raise RecordingError(f"'{path}' can't be read: {error.strerror or error}") from None


def _glob(path: str | Path) -> list[Path]:
    # An existing path is taken literally, even with brackets in its name.
    if Path(path).exists():
        return [Path(path)]
    return [Path(match) for match in sorted(glob.glob(str(path), recursive=True))]


def _own_name(path: Path) -> str:
    resolved = path.resolve()
    return resolved.name if resolved.is_dir() else resolved.stem


def _storage_files(path: Path) -> list[Path]:
    if not path.is_dir():
        # Reading a pipe or a device may never end.
        return [path] if path.is_file() else []
    return sorted(file for file in path.iterdir() if file.is_file() and file.name != METADATA)


def _suffix(file: Path) -> str:
    """Suffix of a file without that of its compression."""
    return (file.with_suffix("") if file.suffix in PACKED_SUFFIXES else file).suffix


def _has_lost_its_metadata(folder: Path, children: Sequence[Path]) -> bool:
    """Whether a folder is a rosbag2 folder without metadata.yaml, by the names of its files."""
    ours = re.compile(re.escape(folder.resolve().name) + r"_\d+\.(db3|mcap)(\.zstd|\.zst)?")
    bags = [file.name for file in children if _suffix(file) in FORMAT_OF_SUFFIX]
    return bool(bags) and all(ours.fullmatch(name) for name in bags)
