# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Discovery of recordings: their paths, names, formats and files, here or at an address."""

from __future__ import annotations

import glob
import hashlib
import os
import re
import shutil
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path, PurePath, PurePosixPath
from typing import Any, Literal, NamedTuple, TypeVar
from urllib.parse import unquote, urlsplit

from ...exceptions import MissingDependencyError, RecordingError

Value = TypeVar("Value")

SCHEMES = {"s3": "s3fs", "gs": "gcsfs", "https": "aiohttp", "http": "aiohttp"}
"""Kinds of URLs other than file://, and the module that reads them."""


FILE_URL = "file://"
"""Start of URLs of this machine."""


# Times between attempts after an error [s].
_WAITS = (0.5, 1.0, 2.0, 4.0, 8.0)
# Bytes that are copied at a time.
_BLOCK = 4 << 20
# Largest size of a file whose server does not state it.
_UNKNOWN_BYTES = 4 << 30
# Space that stays free beside a copy [bytes].
_DISK_RESERVE = 256 << 20
# Time [s] after which a copy must have had this rate on average [bytes/s].
_PATIENCE = 60.0
_SLOWEST = 1e4


# Errors of the libraries after which another attempt is of no use.
_FINAL = ("NoCredentialsError", "PartialCredentialsError")


class RemoteFile(NamedTuple):
    """A file in a storage: its path, its size [bytes], and what differs when its content does."""

    path: str
    size: int
    version: str


@dataclass(frozen=True)
class RemoteRecording:
    """A recording that has a URL.

    Attributes
    ----------
    url : str
        URL of its storage, with the query if it has one.
    path : str
        Its path in the storage.
    files : tuple of RemoteFile
        Its files.
    is_folder : bool
        Whether it is a rosbag2 folder.
    """

    url: str = field(repr=False)
    path: str = field(repr=False)
    files: tuple[RemoteFile, ...] = field(repr=False)
    is_folder: bool

    def __str__(self) -> str:
        parts = urlsplit(self.url)
        place = "" if parts.scheme in ("http", "https") else f"{parts.scheme}://"
        return f"{place}{self.path.partition('?')[0]}"

    @property
    def location(self) -> PurePosixPath:
        """Its path in the storage, without a query."""
        return PurePosixPath(unquote(self.path.partition("?")[0]))

    @property
    def size(self) -> int:
        """Size of its files [bytes]."""
        return sum(file.size for file in self.files)

    @contextmanager
    def copied(self) -> Iterator[Path]:
        """A copy that is removed afterwards.

        Raises
        ------
        RecordingError
            If it can't be read, or there is no space for it.
        """
        with tempfile.TemporaryDirectory(prefix="mp_pca_planner-") as folder:
            free = shutil.disk_usage(folder).free
            if self.size > free:
                raise RecordingError(
                    f"'{self}' has {self.size >> 20} MiB, but there are {free >> 20} MiB free for "
                    f"its copy in '{folder}': set TMPDIR to a folder with more space"
                )
            copy = Path(folder, self.location.name)
            if self.is_folder:
                copy.mkdir()
            storage = _storage(self.url)
            for file in self.files:
                target = copy / PurePosixPath(file.path).name if self.is_folder else copy
                _patiently(partial(_copy, storage, file, target), str(self))
            yield copy


def is_url(path: str) -> bool:
    """Whether a path is a URL."""
    return "://" in path


def list_remote(url: str) -> list[RemoteFile]:
    """The files at a URL.

    Parameters
    ----------
    url : str
        An object, a prefix, or a pattern with asterisks; of a web server, a file.

    Raises
    ------
    RecordingError
        If there is none, the URL can't be read, or it holds credentials.
    MissingDependencyError
        If a module for it is not installed.
    """
    shown = check_url(url)
    storage = _storage(url)
    root = storage._strip_protocol(url)
    is_web = urlsplit(url).scheme in ("http", "https")

    def listed() -> list[RemoteFile]:
        storage.invalidate_cache()
        if is_web:
            return [_remote_file(root, storage.info(root))]
        roots = storage.glob(root) if "*" in root else [root]
        found = {path: x for r in roots for path, x in storage.find(r, detail=True).items()}
        return [_remote_file(path, entry) for path, entry in found.items()]

    files = _patiently(listed, shown)
    if not files:
        raise RecordingError(f"there is nothing at '{shown}'")
    return files


def check_url(url: str) -> str:
    """Reject a URL that can't be used; returns it without its query, for messages.

    Raises
    ------
    RecordingError
        If its kind is not known, or it holds credentials.
    """
    try:
        parts = urlsplit(url)
        host, _ = parts.hostname, parts.port  # that of a port may raise
        if parts.scheme in SCHEMES and not host:
            raise ValueError("it has no host")
    except ValueError as error:  # its parts are not known, and any may be secret
        reason = f"a URL of {url.partition('://')[0]:.20}:// is malformed ({error})"
        raise RecordingError(f"{reason}: expected scheme://host/path") from None
    shown = f"{parts.scheme}://{parts.netloc.rpartition('@')[2]}{parts.path}"
    if "@" in parts.netloc:
        raise RecordingError(
            f"the URL '{shown}' holds a user name or a password: remove them, and set "
            "credentials in the environment"
        )
    if parts.scheme not in SCHEMES and not url.startswith(FILE_URL):
        raise RecordingError(f"'{shown}' is not a URL of {'://, '.join(SCHEMES)}:// or file://")
    return shown


def _storage(url: str) -> Any:
    scheme = urlsplit(url).scheme
    try:
        import fsspec

        return fsspec.filesystem(scheme)
    except ImportError:
        module = SCHEMES[scheme]
        raise MissingDependencyError(module, "cloud", f"reading {scheme}:// URLs") from None


def _remote_file(path: str, entry: Mapping[str, Any]) -> RemoteFile:
    versions = (entry.get(key) for key in ("ETag", "etag", "LastModified", "updated"))
    return RemoteFile(path, entry["size"] or 0, str(next(filter(None, versions), "")))


def _copy(storage: Any, file: RemoteFile, target: Path) -> None:
    most, began = file.size or _UNKNOWN_BYTES, time.monotonic()
    with storage.open(file.path, "rb", cache_type="none") as source, target.open("wb") as copy:
        while block := source.read(_BLOCK):
            copy.write(block)
            n_bytes, seconds = copy.tell(), time.monotonic() - began
            if n_bytes > most:
                break
            if shutil.disk_usage(target.parent).free < _DISK_RESERVE:
                raise RecordingError(
                    f"there are less than {_DISK_RESERVE >> 20} MiB left in "
                    f"'{target.parent}': set TMPDIR to a folder with more space"
                )
            if seconds > _PATIENCE and n_bytes < _SLOWEST * seconds:
                raise RecordingError(f"it arrives at {n_bytes / seconds:.0f} bytes per second")
    n_bytes = target.stat().st_size
    if not file.size and n_bytes > most:
        raise RecordingError(f"its server states no size, and it has more than {most >> 20} MiB")
    if file.size and n_bytes != file.size:
        raise ConnectionError("the file has changed")


def _patiently(action: Callable[[], Value], shown: str) -> Value:
    """The result of an action that is repeated after errors of the network."""
    for wait in (*_WAITS, None):
        try:
            return action()
        except RecordingError as error:
            raise RecordingError(f"'{shown}' can't be read: {error}") from None
        except Exception as error:  # each library has its own
            # A file of a web server that can't be reached is "not found", too.
            cause = error.__cause__ if isinstance(error.__cause__, OSError) else error
            kind = type(cause).__name__
            status = getattr(error.__cause__ or error, "status", None)
            if status in (401, 403):
                reason = f"access is forbidden (HTTP status {status})"
            elif isinstance(cause, FileNotFoundError):
                raise RecordingError(f"there is nothing at '{shown}'") from None
            elif isinstance(cause, PermissionError) or kind in _FINAL:
                reason = f"access is denied ({kind}): set credentials in the environment"
            elif wait is not None:
                time.sleep(wait)
                continue
            else:
                reason = f"{kind}, {len(_WAITS) + 1} times"
            raise RecordingError(f"'{shown}' can't be read: {reason}") from None
    raise AssertionError


BagFormat = Literal["rosbag1", "sqlite3", "mcap"]
RecordingFormat = BagFormat | Literal["csv", "lerobot"]
Recording = Path | RemoteRecording

METADATA = "metadata.yaml"
FORMAT_OF_SUFFIX: dict[str, BagFormat] = {".bag": "rosbag1", ".db3": "sqlite3", ".mcap": "mcap"}
TABLE_SUFFIX = ".csv"
DATASET_INFO = Path("meta/info.json")
"""The file that makes a folder a dataset of LeRobot."""
PACKED_SUFFIXES = (".zstd", ".zst")


def find_recordings(paths: str | Recording | Iterable[str | Recording]) -> tuple[Recording, ...]:
    """Expand files, rosbag2 folders, folders of bags, patterns and URLs to single recordings.

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
    found: dict[str, Recording] = {}
    recordings: list[Recording]
    for path in [paths] if isinstance(paths, str | Recording) else paths:
        if isinstance(path, RemoteRecording):
            shown, recordings = str(path), [path]
        elif isinstance(path, str) and is_url(path):
            shown, recordings = check_url(path), _at_url(path)
        else:
            shown = str(path)
            with translated_os_errors(path):
                matches = _glob(path)
                recordings = [x for one in matches for x in recordings_in(one) or _tables(one)]
        if not recordings:
            raise RecordingError(
                f"no recording at '{shown}': expected a .bag, .db3, .mcap or .csv file, a "
                "rosbag2 folder, a LeRobot dataset, or a folder that holds some of these"
            )
        for recording in recordings:
            # Links and overlapping patterns may lead to the same place.
            same = _location(recording) if isinstance(recording, Path) else recording
            found.setdefault(str(same), recording)
    return tuple(found.values())


def recording_names(paths: Sequence[Recording]) -> tuple[str, ...]:
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


@contextmanager
def local_copy(recording: Recording) -> Iterator[Path]:
    """A recording as a file or folder of this machine; of a remote one, a temporary copy.

    Raises
    ------
    RecordingError
        If it can't be copied.
    """
    if isinstance(recording, Path):
        yield recording
    else:
        with recording.copied() as path:
            yield path


def recording_format(path: Path) -> RecordingFormat:
    """Format of a recording: of a bag, a CSV file, or a dataset of LeRobot.

    Raises
    ------
    RecordingError
        If it is none of these.
    """
    with translated_os_errors(path):
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
    with translated_os_errors(path):
        path.stat()
        suffixes = {_suffix(file) for file in bag_files(path)}
    if len(suffixes) != 1:
        raise RecordingError(
            f"'{path}' is not a recording: expected a regular .bag, .db3, .mcap or .csv file, a "
            "rosbag2 folder, or a LeRobot dataset"
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


def stored_size(path: Recording) -> int:
    """Size of the storage files [bytes].

    Raises
    ------
    RecordingError
        If their sizes can't be read.
    """
    if isinstance(path, RemoteRecording):
        return path.size
    with translated_os_errors(path):
        return sum(file.stat().st_size for file in _storage_files(path))


def stored_state(path: Recording) -> tuple[object, ...]:
    """What differs when a recording has changed: sizes and times of its files.

    Raises
    ------
    RecordingError
        If they can't be read.
    """
    if isinstance(path, RemoteRecording):
        return path.files
    with translated_os_errors(path):
        states = [(file.name, file.stat()) for file in _storage_files(path)]
    return tuple((name, state.st_size, state.st_mtime_ns) for name, state in states)


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
        if child.is_dir() or child.suffix in FORMAT_OF_SUFFIX
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


def _at_url(url: str) -> list[Recording]:
    if url.startswith(FILE_URL):
        local = Path(unquote(urlsplit(url).path))
        return [item for match in _glob(local) for item in recordings_in(match)]
    folders: dict[PurePosixPath, dict[str, RemoteFile]] = {}
    files = list_remote(url)
    for file in files:
        place = PurePosixPath(file.path)
        folders.setdefault(place.parent, {})[place.name] = file
    found = []
    for folder, content in folders.items():
        if _is_recording(folder.name, sorted(content)):
            every = tuple(content[name] for name in sorted(content))
            found.append(RemoteRecording(url, str(folder), every, is_folder=True))
            continue
        for name, file in content.items():
            if len(files) == 1 or PurePosixPath(name).suffix in FORMAT_OF_SUFFIX:
                found.append(RemoteRecording(url, file.path, (file,), is_folder=False))
    return [*sorted(found, key=lambda recording: recording.location.parts)]


def _location(recording: Recording) -> PurePath:
    # Path.resolve raises errors at links that lead to themselves.
    return Path(os.path.realpath(recording)) if isinstance(recording, Path) else recording.location


def _own_name(recording: Recording) -> str:
    is_folder = recording.is_dir() if isinstance(recording, Path) else recording.is_folder
    return _location(recording).name if is_folder else _location(recording).stem


def _storage_files(path: Path) -> list[Path]:
    if not path.is_dir():
        # Reading a pipe or a device may never end.
        return [path] if path.is_file() else []
    if is_dataset(path):
        return [path / DATASET_INFO, *sorted(path.glob("data/*/*.parquet"))]
    return sorted(file for file in path.iterdir() if file.is_file() and file.name != METADATA)


def _suffix(file: PurePath) -> str:
    """Suffix of a file without that of its compression."""
    return (file.with_suffix("") if file.suffix in PACKED_SUFFIXES else file).suffix


def _is_recording(folder: str, names: Sequence[str]) -> bool:
    """Whether a folder with these files is a rosbag2 folder, also without its metadata.yaml."""
    if METADATA in names:
        return True
    ours = re.compile(re.escape(folder) + r"_\d+\.(db3|mcap)(\.zstd|\.zst)?")
    bags = [name for name in names if _suffix(PurePath(name)) in FORMAT_OF_SUFFIX]
    return bool(bags) and all(ours.fullmatch(name) for name in bags)
