# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Files of users, read with bounds; files that are written whole or not at all."""

from __future__ import annotations

import os
import stat
import tempfile
import tokenize
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import yaml

from .exceptions import PlannerError

MAX_TEXT_BYTES = 16 << 20
"""Largest text file that is read: URDF, SRDF, CSV, JSON."""
MAX_YAML_BYTES = 1 << 20
"""Largest YAML text that is parsed."""
MAX_YAML_DEPTH = 20
"""How deeply mappings and lists of YAML may be nested."""
MAX_YAML_SCALAR = 1 << 16
"""Most characters of one value of YAML; constructing an integer takes the square of them."""

_MAX_REASON = 200
# What parsers raise on unexpected content, by their documentation or by experience.
_CONTENT_ERRORS = (
    ArithmeticError,
    AttributeError,
    EOFError,
    LookupError,
    MemoryError,
    OSError,
    RuntimeError,  # RecursionError and NotImplementedError, too
    SyntaxError,
    TypeError,
    ValueError,  # UnicodeError and JSONDecodeError, too
    tokenize.TokenError,
    yaml.YAMLError,
    zipfile.BadZipFile,
    zlib.error,
)


@contextmanager
def reading(what: str, error: type[PlannerError]) -> Iterator[None]:
    """Turn whatever foreign content raises while it is read into the error of its format.

    Parameters
    ----------
    what : str
        What is read, the subject of "… can't be read: reason".
    error : type of PlannerError
        The error of the format. Any PlannerError passes as it is.
    """
    try:
        yield
    except _CONTENT_ERRORS as problem:
        raise error(f"{what} can't be read: {_reason(problem)}") from None


def open_regular(path: str | Path) -> BinaryIO:
    """Open a regular file for reading.

    Raises
    ------
    OSError
        If it can't be opened.
    ValueError
        If it is a folder, a pipe or a device: these may block or never end.
    """
    # Opening a pipe waits for its writer unless told not to.
    file = os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), "rb")
    if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
        file.close()
        raise ValueError("it is no regular file")
    return file


def read_bytes(path: str | Path, max_bytes: int = MAX_TEXT_BYTES) -> bytes:
    """Read a regular file of at most `max_bytes`.

    Raises
    ------
    OSError
        If it can't be read.
    ValueError
        If it is no regular file, or larger.
    """
    with open_regular(path) as file:
        content = file.read(max_bytes + 1)
    if len(content) > max_bytes:
        raise ValueError(f"it is larger than {max_bytes:,} bytes, the largest size accepted")
    return content


def read_text(path: str | Path, max_bytes: int = MAX_TEXT_BYTES) -> str:
    """Read a regular file of UTF-8 text, see :func:`read_bytes`; a byte order mark is left out."""
    return read_bytes(path, max_bytes).decode("utf-8-sig")


def load_yaml(text: str | bytes) -> Any:
    """Parse YAML without aliases and dates, with bounded values and nesting.

    Raises
    ------
    yaml.YAMLError, ValueError, …
        If it is something else: call it within :func:`reading`.
    """
    if len(text) > MAX_YAML_BYTES:
        raise ValueError(f"it is larger than {MAX_YAML_BYTES:,} bytes, the largest size accepted")
    depth = 0
    for event in yaml.parse(text, Loader=_Loader):
        depth += isinstance(event, yaml.CollectionStartEvent)
        depth -= isinstance(event, yaml.CollectionEndEvent)
        if depth > MAX_YAML_DEPTH:
            raise ValueError(f"it is nested more than {MAX_YAML_DEPTH} levels deep")
        if isinstance(event, yaml.AliasEvent):
            raise ValueError(f"aliases of YAML (*{event.anchor:.40}) are not accepted")
        if isinstance(event, yaml.ScalarEvent) and len(event.value) > MAX_YAML_SCALAR:
            raise ValueError(f"a value has more than {MAX_YAML_SCALAR:,} characters")
    return yaml.load(text, Loader=_Loader)


class _Loader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]
    """PyYAML's safe loader, fast where it can be, that takes dates for text."""

    yaml_implicit_resolvers = {  # noqa: RUF012  # as in PyYAML
        first: [pair for pair in pairs if pair[0] != "tag:yaml.org,2002:timestamp"]
        for first, pairs in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }


def _reason(error: BaseException) -> str:
    """One line that says what is wrong with some content."""
    if isinstance(error, UnicodeDecodeError):
        return "it is not UTF-8 text"
    if isinstance(error, RecursionError):
        return "it is nested too deeply"
    if isinstance(error, MemoryError):
        return "it needs more memory than there is"
    reason: str = getattr(error, "strerror", None) or " ".join(str(error).split())
    if isinstance(error, KeyError) or not reason:
        reason = f"{type(error).__name__} {reason}".strip()
    return reason if len(reason) <= _MAX_REASON else reason[:_MAX_REASON] + "…"


def write_whole(path: str | Path, content: bytes, *, overwrite: bool = False) -> None:
    """Write a file so that its name never shows a part of it, whatever happens.

    The content goes to a hidden file in the same folder first, which takes the name in one
    step when it is complete and on disk.

    Raises
    ------
    PlannerError
        If the file exists and may not be overwritten, or can't be written.
    """
    target = Path(path)
    if target.exists() and not overwrite:
        raise exists_already(target)
    try:
        handle, name = tempfile.mkstemp(prefix=f".{target.name}.", suffix=".tmp", dir=target.parent)
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
            umask = os.umask(0)
            os.umask(umask)
            os.chmod(name, 0o666 & ~umask)
            if overwrite:
                os.replace(name, target)
            else:
                # Unlike a rename, a link fails if somebody else was faster.
                os.link(name, target)
        finally:
            Path(name).unlink(missing_ok=True)
    except FileExistsError:
        raise exists_already(target) from None
    except OSError as error:
        raise PlannerError(f"'{target}' can't be written: {error.strerror or error}") from None


def check_writable(path: Path, *, overwrite: bool) -> None:
    """Refuse a file that could not be written, before the work that makes its content.

    Raises
    ------
    PlannerError
        If it exists and may not be overwritten, or its folder doesn't exist or is read-only.
    """
    if path.exists() and not overwrite:
        raise exists_already(path)
    if not path.parent.is_dir():
        raise PlannerError(f"'{path}' can't be written: there is no folder '{path.parent}'")
    if not os.access(path.parent, os.W_OK):
        raise PlannerError(f"'{path}' can't be written: its folder may not be changed")


def exists_already(path: Path) -> PlannerError:
    """Error for an output that would overwrite something."""
    return PlannerError(f"'{path}' exists already: choose another name, or use --force")
