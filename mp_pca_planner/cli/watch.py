# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""`watch`: the running node in the terminal, live."""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Mapping, Sequence

from diagnostic_msgs.msg import DiagnosticStatus
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from ..exceptions import printable
from ..ros.monitor import Monitor, NodeView
from .common import REPORTED, known, short
from .terminal import DONE

_BAR_WIDTH = 24  # [characters]
_STALE_AGE = 0.5  # age above which joint states are dimmed [s]
_LEVELS = (("OK", "green"), ("WARN", "yellow"), ("ERROR", "red"), ("STALE", "red"))


def run(arguments: argparse.Namespace) -> int:
    """Run the command until its time has passed or Ctrl-C; returns the exit status."""
    duration = arguments.duration
    end = math.inf if duration is None else time.monotonic() + duration
    with (
        Monitor(arguments.namespace, arguments.node) as monitor,
        Live(console=Console(), auto_refresh=False, screen=duration is None) as live,
    ):
        try:
            while time.monotonic() < end:
                live.update(frame(monitor.look(), time.monotonic()), refresh=True)
                time.sleep(0.2)  # 5 frames per second
        except KeyboardInterrupt:  # the usual end
            pass
    return DONE


def frame(seen: NodeView, now: float) -> RenderableType:
    """Content of the terminal.

    Parameters
    ----------
    seen : NodeView
        The newest messages.
    now : float
        The time, by :func:`time.monotonic` [s].
    """
    goal = Text("none yet")
    if seen.goal is not None:
        goal = Text(f"{printable(seen.goal[0])}   ({now - seen.goal[1]:.0f} s ago)")
    return Group(
        Panel(_joints(seen, now), title="joint states", title_align="left"),
        Panel(goal, title="last goal", title_align="left"),
        Panel(_status(seen.report, now, REPORTED), title="last report", title_align="left"),
        Panel(_status(seen.diagnostics, now), title="diagnostics", title_align="left"),
    )


def _joints(seen: NodeView, now: float) -> RenderableType:
    if not seen.states:
        return Text("none yet")
    bounds = {}
    if seen.limits is not None:
        pairs = zip(seen.limits.lower.tolist(), seen.limits.upper.tolist(), strict=True)
        bounds = dict(zip(seen.limits.joint_names, pairs, strict=True))
    table = Table(box=None)
    for title in ("joint", "position", "lower", "", "upper", "velocity", "age"):
        table.add_column(title, justify="left" if title in ("joint", "") else "right")
    for name, (q, v, when) in seen.states.items():
        low, high = bounds.get(name, (-math.inf, math.inf))
        style = "red" if not low <= q <= high else "dim" if now - when > _STALE_AGE else ""
        ends = [f"{x:.2f}" if math.isfinite(x) else "" for x in (low, high)]
        velocity = f"{v:.3f}" if math.isfinite(v) else ""
        age = f"{now - when:.1f} s"
        bar = _bar(q, low, high)
        # Names come from messages, so markup in them is escaped.
        cells = (printable(name), f"{q:.3f}", ends[0], bar, ends[1], velocity, age)
        table.add_row(*(Text(cell) for cell in cells), style=style)
    return table


def _bar(value: float, low: float, high: float) -> str:
    """A bar with the value's position between its limits; empty without limits."""
    if not (math.isfinite(high - low) and high > low and math.isfinite(value)):
        return ""
    place = round((_BAR_WIDTH - 1) * min(max((value - low) / (high - low), 0.0), 1.0))
    return "─" * place + "●" + "─" * (_BAR_WIDTH - 1 - place)


def _status(
    heard: tuple[DiagnosticStatus, float] | None, now: float, names: Sequence[str] | None = None
) -> RenderableType:
    if heard is None:
        return Text("none yet")
    status, when = heard
    word, colour = _LEVELS[min(int.from_bytes(status.level, "little"), len(_LEVELS) - 1)]
    head = Text.assemble(
        (word, colour), f"  {printable(status.message)}   ({now - when:.0f} s ago)"
    )
    values = {pair.key: pair.value for pair in status.values}
    shown = known(values, names)
    return Group(head, _values(shown)) if shown else head


def _values(values: Mapping[str, str]) -> Table:
    table = Table.grid(padding=(0, 2))
    for name, value in values.items():
        table.add_row(Text(printable(name), style="cyan"), Text(printable(short(value))))
    return table
