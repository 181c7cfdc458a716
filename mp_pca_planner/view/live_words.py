# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The running node as HTML for the page."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ..robot.limits import JointLimits
from .live import STALE, LiveView, NodeStatus
from .words import BAD, GOOD, GREY, WARNING, padded_html, rows_html, text_html, verdict_html

_COLOURS = (GOOD, WARNING, BAD, GREY)
_FIGURES = ("effort_cost", "solve_time_s", "duration", "primitive", "in_span_score", "outcome")


def node_html(view: LiveView, now: float) -> str:
    """Whether the node runs, and what it says of itself."""
    if view.diagnostics is None:
        return verdict_html("No node yet", "waiting for a planner node", GREY)
    if not view.has_node(now):
        age = now - view.diagnostics.time
        return verdict_html("The node is gone", f"nothing was heard of it for {age:.0f} s", BAD)
    return _status_html("Node", view.diagnostics, now)


def reports_html(view: LiveView, now: float) -> str:
    """The goal, the obstacles, the report of the plan, and that of its execution."""
    goal = "none yet" if view.goal is None else f"{view.goal[0]} ({_age(view.goal[1], now)})"
    obstacles = ", ".join(view.world.names) or "none"
    parts = [rows_html([("Last goal", goal), ("Obstacles", obstacles)])]
    for title, status in (("Plan", view.report), ("Execution", view.execution)):
        if status is not None:
            parts.append(_status_html(title, status, now, _FIGURES))
    return "".join(parts)


def figures_html(view: LiveView) -> str:
    """All figures of the node."""
    if view.diagnostics is None:
        return ""
    return rows_html([(name, _short(value)) for name, value in view.diagnostics.values.items()])


def states_html(view: LiveView, limits: JointLimits, now: float) -> str:
    """The measured joint states within their limits; old ones are pale, those outside are red."""
    if not view.states:
        return padded_html("no joint states yet")
    ends = zip(limits.lower.tolist(), limits.upper.tolist(), strict=True)
    bounds = dict(zip(limits.joint_names, ends, strict=True))
    rows = [
        _state_row(name, state, bounds.get(name, (-math.inf, math.inf)), now)
        for name, state in view.states.items()
    ]
    head = "".join(f"<td style='opacity:0.7'>{x}</td>" for x in ("", "position", "", "velocity"))
    return padded_html(
        f'<table style="width:100%;font-size:0.78em"><tr>{head}</tr>{"".join(rows)}</table>'
    )


def _state_row(
    name: str, state: tuple[float, float, float], bounds: Sequence[float], now: float
) -> str:
    q, v, received = state
    low, high = bounds
    colour = "inherit" if low <= q <= high else BAD
    pale = "opacity:0.4;" if now - received > STALE else ""
    age = f"{now - received:.1f} s old" if pale else ""
    velocity = f"{v:.3f}" if math.isfinite(v) else ""
    return (
        f'<tr style="{pale}color:{colour}"><td>{text_html(name)}</td><td>{q:.3f}</td>'
        f"<td>{_place_html(q, low, high)}</td><td>{velocity} {age}</td></tr>"
    )


def _place_html(q: float, low: float, high: float) -> str:
    """A mark at the place of a position between its limits; nothing without limits."""
    if not (math.isfinite(high - low) and math.isfinite(q)):
        return ""
    share = 100.0 * float(np.clip((q - low) / (high - low), 0.0, 1.0))
    return (
        f'<div title="{low:.2f} to {high:.2f}" style="position:relative;height:0.7em;width:7em;'
        f'border-radius:3px;background:{GREY}44"><div style="position:absolute;height:100%;'
        f'width:4px;border-radius:2px;background:{GOOD};left:calc({share:.0f}% - 2px)"></div></div>'
    )


def _status_html(title: str, status: NodeStatus, now: float, figures: Sequence[str] = ()) -> str:
    colour = _COLOURS[min(status.level, len(_COLOURS) - 1)]
    head = verdict_html(f"{title}, {_age(status.time, now)}", status.message, colour)
    known = [(name, status.values[name]) for name in figures if name in status.values]
    rows = [(name, _short(value)) for name, value in known if value != "nan"]
    return head + (rows_html(rows) if rows else "")


def _age(time: float, now: float) -> str:
    return f"{now - time:.0f} s ago"


def _short(value: str) -> str:
    """A value, with four digits if it is a number that is not whole."""
    try:
        return value if value.lstrip("-").isdigit() else f"{float(value):.4g}"
    except ValueError:
        return value
