# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Discovery of recordings: their paths, names, formats and files."""

from __future__ import annotations

import glob
import hashlib
import os
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path, PurePath
from typing import Literal

from ...exceptions import RecordingError
from ...files import reading

BagFormat = Literal["rosbag1", "sqlite3", "mcap"]
RecordingFormat = BagFormat | Literal["csv", "lerobot"]

METADATA = "metadata.yaml"
FORMAT_OF_SUFFIX: dict[str, BagFormat] = {
    ".bag": "rosbag1",
    ".db3": "sqlite3",
    ".mcap": "mcap",
}
TABLE_SUFFIX = ".csv"
DATASET_INFO = Path("meta/info.json")
"""The file that makes a folder a dataset of LeRobot."""
PACKED_SUFFIXES = (".zstd", ".zst")


def find_recordings(paths: str | Path | Iterable[str | Path]) -> tuple[Path, ...]:
    """Expand files, rosbag2 folders, folders of bags, and patterns to single recordings.

    A folder is searched with its subfolders, for bags and datasets of LeRobot; the CSV files of a
    folder without these are taken. A rosbag2 folder (one with a metadata.yaml) is one recording,
    and so is a dataset. A file that is named itself is taken whatever its suffix; loading rejects
    it with a reason.

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
        with reading(f"'{path}'", RecordingError):
            recordings = [x for one in _glob(path) for x in recordings_in(one) or _tables(one)]
        if not recordings:
            raise RecordingError(
                f"no recording at '{path}' on this machine: expected a .bag, .db3, .mcap or .csv "
                "file, a rosbag2 folder, a downloaded LeRobot dataset (the folder that holds "
                "meta/info.json), or a folder of some of these"
            )
        for recording in recordings:
            # Links and overlapping patterns may lead to the same place.
            found.setdefault(_location(recording), recording)
    return tuple(found.values())


def files_left_out(paths: Iterable[str | Path], found: Iterable[Path]) -> list[Path]:
    """The files in the folders among the paths that are in none of the recordings found there."""
    taken = {_location(path) for path in found}
    folders = [one for path in paths for one in _glob(path) if one.is_dir()]
    left: list[Path] = []
    while folders:
        folder = folders.pop()
        if _location(folder) not in taken:
            taken.add(_location(folder))  # a link may lead back to it
            children = [x for x in sorted(folder.iterdir()) if not x.name.startswith(".")]
            folders += [child for child in children if child.is_dir()]
            files = [child for child in children if child.is_file()]
            left += [file for file in files if _location(file) not in taken]
    return left


def recording_names(paths: Sequence[Path]) -> tuple[str, ...]:
    """Name recordings by their file or folder; equal names get suffixes or parent folders."""
    locations = [_location(path) for path in paths]
    names = [_own_name(path) for path in paths]
    beside = Counter((place.parent, name) for place, name in zip(locations, names, strict=True))
    own = [
        name if beside[place.parent, name] == 1 else place.name
        for place, name in zip(locations, names, strict=True)
    ]
    names = own
    for n_parents in range(1, max((len(place.parts) for place in locations), default=1)):
        counts = Counter(names)
        names = [
            name if counts[name] == 1 else "/".join((*place.parent.parts[-n_parents:], last))
            for name, place, last in zip(names, locations, own, strict=True)
        ]
    return tuple(names)


def recording_format(path: Path) -> RecordingFormat:
    """Format of a recording: of a bag, a CSV file, or a dataset of LeRobot.

    Raises
    ------
    RecordingError
        If it is none of these.
    """
    with reading(f"'{path}'", RecordingError):
        if is_dataset(path):
            return "lerobot"
        if path.suffix == TABLE_SUFFIX and path.is_file():
            return "csv"
    return bag_format(path)


def is_dataset(path: Path) -> bool:
    """Whether a folder is a dataset of LeRobot."""
    return (path / DATASET_INFO).is_file()


def bag_format(path: Path) -> BagFormat:
    """Storage format of a bag.

    Raises
    ------
    RecordingError
        If it is neither a bag file nor a rosbag2 folder.
    """
    with reading(f"'{path}'", RecordingError):
        path.stat()
        suffixes = {_suffix(file) for file in bag_files(path)}
    if len(suffixes) != 1:
        raise RecordingError(
            f"'{path}' is not a recording: expected a regular .bag, .db3, .mcap or .csv file, a "
            "rosbag2 folder, or the folder of a LeRobot dataset, which holds meta/info.json"
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
    with reading(f"'{path}'", RecordingError):
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
    with reading(f"'{path}'", RecordingError):
        return sum(file.stat().st_size for file in _storage_files(path))


def recordings_in(path: Path) -> list[Path]:
    """The path itself if it is one recording, else the recordings in the folder."""
    if not path.is_dir():
        return [path]
    if is_dataset(path):
        return [path]
    children = sorted(path.iterdir())
    if _is_recording(path.resolve().name, [child.name for child in children]):
        return [path]
    return [
        recording
        for child in children
        if child.is_dir() or _suffix(child) in FORMAT_OF_SUFFIX
        for recording in recordings_in(child)
    ]


def _tables(folder: Path) -> list[Path]:
    """The CSV files that a folder itself holds."""
    return sorted(file for file in folder.iterdir() if file.suffix == TABLE_SUFFIX)


def bag_files(path: Path) -> list[Path]:
    """Files of a recording that hold messages; those of a split one in order of their numbers."""
    return sorted(
        (file for file in _storage_files(path) if _suffix(file) in FORMAT_OF_SUFFIX),
        key=lambda file: [int(t) if t.isdecimal() else t for t in re.split(r"(\d+)", file.name)],
    )


def _glob(path: str | Path) -> list[Path]:
    # An existing path is taken literally, even with brackets in its name.
    if Path(path).exists():
        return [Path(path)]
    return [Path(match) for match in sorted(glob.glob(str(path), recursive=True))]


def _location(path: Path) -> Path:
    # Path.resolve raises errors at links that lead to themselves.
    return Path(os.path.realpath(path))


def _own_name(path: Path) -> str:
    return _location(path).name if path.is_dir() else _location(path).stem


def _storage_files(path: Path) -> list[Path]:
    if not path.is_dir():
        # Reading a pipe or a device may never end.
        return [path] if path.is_file() else []
    if is_dataset(path):
        return [path / DATASET_INFO, *sorted(path.glob("data/*/*.parquet"))]
    return sorted(file for file in path.iterdir() if file.is_file() and file.name != METADATA)


def _suffix(file: PurePath) -> str:
    """Suffix of a file without that of its compression, or of a recorder that did not finish."""
    return (file.with_suffix("") if file.suffix in (*PACKED_SUFFIXES, ".active") else file).suffix


def _is_recording(folder: str, names: Sequence[str]) -> bool:
    """Whether a folder with these files is a rosbag2 folder, also without its metadata.yaml."""
    if METADATA in names:
        return True
    ours = re.compile(re.escape(folder) + r"_\d+\.(db3|mcap)(\.zstd|\.zst)?")
    bags = [name for name in names if _suffix(PurePath(name)) in FORMAT_OF_SUFFIX]
    return bool(bags) and all(ours.fullmatch(name) for name in bags)
