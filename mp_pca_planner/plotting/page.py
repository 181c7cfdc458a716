# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Figures as PNG files, and self-contained HTML pages: Jinja2 templates with figures inside."""

from __future__ import annotations

import base64
import io
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .. import __version__
from ..exceptions import PlannerError, printable, require
from ..files import write_whole
from .style import require_matplotlib, styled_figure

if TYPE_CHECKING:
    from jinja2 import Environment
    from matplotlib.figure import Figure


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


def require_pages() -> None:
    """Check that pages with figures can be made.

    Raises
    ------
    MissingDependencyError
        If matplotlib or jinja2 is not installed.
    """
    require_matplotlib()
    require("jinja2", "plot", "making a page")


def render(template: str, **content: Any) -> str:
    """Fill a template of the folder `templates`; text is escaped.

    Raises
    ------
    MissingDependencyError
        If matplotlib or jinja2 is not installed.
    """
    require_pages()
    return environment().get_template(template).render(version=__version__, **content)


@cache
def environment() -> Environment:
    """The templates; text in them is escaped."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    made = Environment(
        loader=PackageLoader("mp_pca_planner", "plotting/templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.filters["printable"] = printable
    return made


def image_address(content: io.BytesIO) -> str:
    """A PNG image as a data URI."""
    return "data:image/png;base64," + base64.b64encode(content.getvalue()).decode("ascii")


def figure_address(plot: Callable[[Figure], object]) -> str:
    """A new figure, drawn by a function, as a data URI."""
    content = io.BytesIO()
    with picture(content) as figure:
        plot(figure)
    return image_address(content)
