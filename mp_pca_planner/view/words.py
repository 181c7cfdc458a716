# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Plans and the running node as HTML for the page."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape

import numpy as np

from ..arrays import FloatArray
from ..exceptions import printable
from ..motion.trajectory import Trajectory
from ..planning.plan import Plan
from ..planning.remarks import UNUSUAL_IN_SPAN_SCORE
from ..robot.limits import JointLimits
from .live import STALE, LiveView, NodeStatus
from .planning import PlanAnswer

GOOD, WARNING, BAD, GREY = "#009E73", "#E69F00", "#D9352B", "#8C8C8C"
"""Colours of verdicts, legible on light and on dark."""

LIKE_SCORE = 1.5
"""In-span score up to which a request is like the demonstrations; about 1 is usual."""

_NEAR_LIMIT = 0.9  # share of a limit from which its bar warns


def in_span_words(score: float) -> str:
    """How near a request is to the demonstrations, in words."""
    if score <= LIKE_SCORE:
        return "like the demonstrations"
    if score <= UNUSUAL_IN_SPAN_SCORE:
        return "at the edge of the demonstrations"
    return "unlike the demonstrations: the motion may look unlike them, too"


def limit_shares(trajectory: Trajectory, limits: JointLimits) -> dict[str, FloatArray]:
    """Largest share of each limit that a motion uses, by quantity.

    Returns
    -------
    shares : dict of array, shape (n_joints,)
        1 is at the limit; 0 where there is none. Positions count from the middle of their range.
    """
    bounded = np.isfinite(limits.lower) & np.isfinite(limits.upper)
    low, high = np.where(bounded, [limits.lower, limits.upper], [[-1.0], [1.0]])
    away = np.abs(trajectory.positions - 0.5 * (low + high)).max(axis=0)
    shares = {"position": np.where(bounded, away / (0.5 * (high - low)), 0.0)}
    values = {"velocity": trajectory.velocities, "acceleration": trajectory.accelerations}
    if trajectory.efforts is not None:
        values["effort"] = trajectory.efforts
    for quantity, value in values.items():
        limit = getattr(limits, quantity)
        if np.any(np.isfinite(limit)):
            shares[quantity] = np.abs(value).max(axis=0) / limit
    return shares


def answer_html(answer: PlanAnswer) -> str:
    """The verdict and the figures of an answer."""
    plan = answer.plan
    if plan is None or answer.problem:
        return verdict_html("No motion", answer.problem, BAD)
    unlike = plan.in_span_score > UNUSUAL_IN_SPAN_SCORE
    head = verdict_html(
        "Motion found" if plan.status == "solved" else "Motion found, not optimal",
        plan.message,
        WARNING if unlike or plan.status != "solved" else GOOD,
    )
    score = f"{in_span_words(plan.in_span_score)} (score {plan.in_span_score:.1f})"
    rows = [
        ("Primitive", plan.primitive),
        ("Duration", f"{plan.duration:.2f} s"),
        ("Effort", _effort(plan)),
        ("The goal is", score),
        ("Planned in", f"{1e3 * answer.seconds:.0f} ms"),
    ]
    if answer.comparison is not None:
        rows.append(("B-splines", _comparison(plan, answer.comparison)))
    elif answer.request.settings.compares:
        rows.append(("B-splines", "no motion"))
    return head + rows_html(rows)


def _effort(plan: Plan) -> str:
    effort = plan.effort_cost
    return f"{effort:.4g} N²m²s" if np.isfinite(effort) else "unknown: inertias are missing"


def _comparison(plan: Plan, other: Plan) -> str:
    """The effort of the motion of B-splines beside that of the components."""
    if not other.is_executable:
        return f"no motion within the limits: {other.message}"
    times = f"{1e3 * other.solve_time:.1f} ms, components {1e3 * plan.solve_time:.1f} ms"
    return f"effort {_effort(other)}, solved in {times}"


def verdict_html(title: str, text: str, colour: str) -> str:
    """A title and a sentence on a coloured ground."""
    return (
        f'<div style="margin:0.3em 0.6em;padding:0.5em 0.7em;border-left:5px solid {colour};'
        f'border-radius:4px;background:{colour}22;font-size:0.85em;line-height:1.35">'
        f'<b style="color:{colour}">{text_html(title)}</b><br>{text_html(text)}</div>'
    )


def rows_html(rows: Sequence[tuple[str, str]]) -> str:
    """A table of names and values."""
    cells = "".join(
        f'<tr><td style="opacity:0.7;padding:1px 0.8em 1px 0;white-space:nowrap;'
        f'vertical-align:top">{text_html(name)}</td><td>{text_html(value)}</td></tr>'
        for name, value in rows
    )
    table = f'<table style="font-size:0.82em;line-height:1.3">{cells}</table>'
    return padded_html(table)


def lines_html(lines: Sequence[str]) -> str:
    """Lines of small text."""
    text = "<br>".join(map(text_html, lines))
    return padded_html(f'<div style="font-size:0.8em;opacity:0.85">{text}</div>')


def padded_html(content: str) -> str:
    """Content with the margins of the page's widgets."""
    return f'<div style="padding:0.2em 0.6em">{content}</div>'


def bars_html(names: Sequence[str], shares: dict[str, FloatArray]) -> str:
    """Bars of the shares of the limits that a motion uses, a row per joint."""
    head = "".join(f'<td style="opacity:0.7">{quantity}</td>' for quantity in shares)
    rows = [f"<tr><td></td>{head}</tr>"]
    for i, name in enumerate(names):
        bars = "".join(f"<td>{bar_html(float(values[i]))}</td>" for values in shares.values())
        rows.append(f'<tr><td style="padding-right:0.6em">{text_html(name)}</td>{bars}</tr>')
    return f'<table style="width:100%;font-size:0.75em;line-height:1.25">{"".join(rows)}</table>'


def bar_html(share: float) -> str:
    """A bar that fills up to a share; red beyond 1."""
    colour = BAD if share > 1.0 + 1e-6 else WARNING if share >= _NEAR_LIMIT else GOOD
    width = 100.0 * min(max(share, 0.0), 1.0)
    return (
        f'<div title="{100.0 * share:.0f} %" style="height:0.7em;min-width:2.5em;margin-right:4px;'
        f'border-radius:3px;background:{GREY}44"><div style="height:100%;width:{width:.0f}%;'
        f'border-radius:3px;background:{colour}"></div></div>'
    )


def text_html(text: str) -> str:
    """Text without markup; what is not printable is escaped."""
    return escape(printable(text))


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
