# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Common style of all figures: palette, lines, titles, legends and panels.

Matplotlib is imported when a figure is drawn.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from math import ceil
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any

from .. import __version__
from ..exceptions import printable, require
from ..files import write_whole

if TYPE_CHECKING:
    from jinja2 import Environment
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.legend import Legend


# The palette of Okabe and Ito, which is safe for all kinds of colour vision, without its yellow,
# which is too pale for lines. Line styles differ too, for printing without colour.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
STYLES = ("-", "--", "-.", (0, (1, 1)), (0, (5, 1, 1, 1, 1, 1)), (0, (8, 3)))
BLACK, GREY = "#000000", "#8C8C8C"


# Most panels beside each other, and widths of panels where they are few or many [inches].
MAX_COLUMNS, FEW_COLUMNS = 7, 4
WIDE, NARROW = 3.5, 2.4
# Most demonstrations behind a segment of a plan; more hide each other.
MAX_BEHIND = 8
# Most obstacles with colours and names of their own.
MAX_NAMED = 5
# Room around the arm and the paths of its hand, as a share of their extent. Larger obstacles end at
# the frame of the picture: a floor would make the paths small.
ROOM = 0.2
# Most components around one mean; more curves are not distinguishable.
MAX_COMPONENTS = 3
# A limit is drawn if it is nearer to the curves than this share of their range; a farther one would
# flatten them.
NEAR_LIMIT = 0.5
# Smallest range of a vertical axis [rad or m]: rounding errors of joints at rest stay invisible.
MIN_SPAN = 0.02

# Share of a figure's width up to which its header reaches: letters are wider at other resolutions.
_WIDEST = 0.97


def line(label: str, colour: str, style: Any = "-", width: float = 2.2, **marker: Any) -> Line:
    """Properties of a line."""
    return {"label": label, "color": colour, "linestyle": style, "linewidth": width, **marker}


def palette_line(label: str, index: int, width: float = 2.2) -> Line:
    """Properties of the line of that index, each with a colour and a style of its own."""
    n = len(COLOURS)
    return line(label, COLOURS[index % n], STYLES[(index + index // n) % len(STYLES)], width)


LINES = {
    "planned": line("planned", COLOURS[0]),
    "limit": line("limit", BLACK, (0, (2, 2)), 1.5),
    "behind": line("nearest demonstrations, re-timed", GREY, "-", 0.8, zorder=1.5, alpha=0.6),
    "minimum jerk": line("minimum jerk", BLACK, (0, (1, 1.5)), 1.5, zorder=1.7),
    "arm": line("arm at start and goal", GREY, width=5.0, zorder=1.4, alpha=0.35, marker="o"),
    "obstacle": line("other obstacles", GREY, width=8.0, alpha=0.4),
    "via": line("via", BLACK, "", marker="D", markersize=8, markerfacecolor="white", zorder=3),
    "demonstration": line("demonstrations", GREY, "-", 0.8),
    "motion": line("motion", "#CFE6F5", width=8.0),
    "rest": line("rest", "#E6E6E6", width=8.0),
}
"""Lines of several figures, by what they show."""


def require_matplotlib() -> None:
    """Check that figures can be drawn.

    Raises
    ------
    MissingDependencyError
        If matplotlib is not installed.
    """
    require("matplotlib.figure", "plot", "drawing a picture")


@contextmanager
def styled_figure(*, interactive: bool = False) -> Iterator[Figure]:
    """Make an empty figure in the common style.

    Parameters
    ----------
    interactive :
        Whether pyplot makes the figure, which shows it in notebooks and windows.

    Raises
    ------
    MissingDependencyError
        If matplotlib is not installed.
    """
    require_matplotlib()
    from matplotlib import style

    with style.context(Path(__file__).with_name("style.mplstyle")):
        if interactive:
            from matplotlib import pyplot

            figure = pyplot.figure(layout="constrained")
        else:
            from matplotlib.figure import Figure

            figure = Figure(layout="constrained")
        yield figure


def add_header(figure: Figure, title: str, lines: Sequence[Line]) -> None:
    """Put a title and a legend above the panels of a figure.

    The figure grows by the height of the header. Long texts are broken into several lines.

    Parameters
    ----------
    figure :
        A figure with constrained layout, of the size of its panels.
    title :
        Its title.
    lines :
        Entries of the legend.
    """
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    width, height = figure.get_size_inches()
    for n_columns in range(len(lines), 0, -1):
        for earlier in [*figure.legends]:
            earlier.remove()
        box = _legend(figure, title, lines, int(9 * width), n_columns).get_window_extent()
        if box.width <= _WIDEST * figure.bbox.width:
            break
    total = height + box.height / figure.dpi
    figure.set_size_inches(width, total)
    rect = (0.0, 0.0, 1.0, height / total)
    figure.set_layout_engine(ConstrainedLayoutEngine(rect=rect, h_pad=0.08, w_pad=0.08))


def _legend(
    figure: Figure, title: str, lines: Sequence[Line], n_letters: int, n_columns: int
) -> Legend:
    """A legend with lines of at most that many letters; four fifths of it for the larger title."""
    from matplotlib.lines import Line2D

    handles = [
        Line2D([], [], **entry | {"label": fill(printable(entry["label"]), n_letters)})
        for entry in lines
    ]
    return figure.legend(
        handles=handles,
        loc="upper center",
        ncols=n_columns,
        title=fill(printable(title), n_letters * 4 // 5),
        borderaxespad=0.2,
    )


def joint_panels(figure: Figure, names: Sequence[str], n_rows: int) -> list[list[Axes]]:
    """Make a column of panels per joint, in several bands if there are many joints.

    Sets the size of the figure.

    Returns
    -------
    panels :
        By joint: its `n_rows` Axes, from top to bottom.
    """
    n_bands = ceil(len(names) / MAX_COLUMNS)
    n_columns = ceil(len(names) / n_bands)
    width = WIDE if n_columns <= FEW_COLUMNS else NARROW
    figure.set_size_inches(width * max(n_columns, 2), 2.3 * n_bands * n_rows)
    grid = figure.subplots(n_bands * n_rows, n_columns, squeeze=False)
    panels = []
    for j in range(n_bands * n_columns):
        band, column = divmod(j, n_columns)
        panel = list(grid[band * n_rows : (band + 1) * n_rows, column])
        if j < len(names):
            panel[0].set_title(printable(names[j]))
            panels.append(panel)
        else:
            for axes in panel:
                axes.remove()
    return panels


def label_left(axes: Axes) -> None:
    """Remove the label of the vertical axis, unless the Axes are in the first column."""
    place = axes.get_subplotspec()
    if place is not None and not place.is_first_col():
        axes.set_ylabel("")


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
        If the file can't be written.
    MissingDependencyError
        If matplotlib is not installed.
    """
    content = io.BytesIO()
    with styled_figure() as figure:
        yield figure
        figure.savefig(content, format="png")
    if isinstance(path, io.BytesIO):
        path.write(content.getvalue())
    else:
        write_whole(path, content.getvalue(), overwrite=force)


def render(template: str, **content: Any) -> str:
    """Fill a template of the folder `templates`; text is escaped.

    Raises
    ------
    MissingDependencyError
        If matplotlib or jinja2 is not installed.
    """
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


def figure_address(plot: Callable[[Figure], object]) -> str:
    """A new figure, drawn by a function, as a data URI."""
    content = io.BytesIO()
    with picture(content) as figure:
        plot(figure)
    return "data:image/png;base64," + base64.b64encode(content.getvalue()).decode("ascii")


Line = dict[str, Any]
"""Properties of a line or a text, as Matplotlib names them."""
