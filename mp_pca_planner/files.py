# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Files that are written whole or not at all."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from .exceptions import PlannerError


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
