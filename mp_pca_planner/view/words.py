# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Plans as HTML for the page: a verdict, figures in words, and limits as bars."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

import numpy as np

from ..arrays import FloatArray
from ..exceptions import printable
from ..motion.trajectory import Trajectory
from ..planning.plan import Plan
from ..planning.remarks import UNUSUAL_IN_SPAN_SCORE
from ..robot.limits import JointLimits
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
