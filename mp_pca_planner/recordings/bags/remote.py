# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Recordings in object storage and on web servers, by URL.

Recordings are copied by the process that reads them, one at a time. Credentials come from the
environment of each process alone. A URL that holds some is rejected, and neither the query of a URL
nor the text of an error of a library is repeated, since these may hold signatures.
"""

from __future__ import annotations

import shutil
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple, TypeVar
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
