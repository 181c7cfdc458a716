# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Figures as PNG files, drawn without pyplot."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from ..exceptions import PlannerError
from ..files import write_whole
from .style import require_matplotlib, styled_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["picture", "require_matplotlib"]


@contextmanager
def picture(path: str | Path | io.BytesIO, *, force: bool = False) -> Iterator[Figure]:
    """Make an empty figure that is written as a PNG when the block ends without an error.

    Parameters
    ----------
    path :
        The PNG file to write, or the buffer that takes its content.
    force :
        Whether an existing file may be overwritten.

    Raises
    ------
    PlannerError
        If the file name does not end in .png, or the file can't be written.
    MissingDependencyError
        If matplotlib is not installed.
    """
    content = path if isinstance(path, io.BytesIO) else io.BytesIO()
    if not isinstance(path, io.BytesIO) and Path(path).suffix.lower() != ".png":
        raise PlannerError(f"pictures are PNG files: the name of '{path}' must end in .png")
    with styled_figure() as figure:
        yield figure
        figure.savefig(content, format="png")
    if not isinstance(path, io.BytesIO):
        write_whole(Path(path), content.getvalue(), overwrite=force)
