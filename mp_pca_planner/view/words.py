# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Plans and the running node as HTML for the page."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from typing import Any

import jinja2  # noqa: F401  # missing, it is reported before the page is made
import numpy as np

from ..arrays import FloatArray, short
from ..motion.trajectory import Trajectory
from ..planning.plan import Plan
from ..planning.report import UNUSUAL_IN_SPAN_SCORE
from ..plotting.page import environment
from ..robot.limits import JointLimits
from .live import LiveView, NodeStatus
from .options import PAGE
from .planning import PlanAnswer

GOOD, WARNING, BAD, GREY = "#009E73", "#E69F00", "#D9352B", "#8C8C8C"
"""Colours of verdicts, legible on light and on dark."""


_COLOURS = (GOOD, WARNING, BAD, GREY)
_FIGURES = ("effort_cost", "solve_time_s", "duration", "primitive", "in_span_score", "outcome")


def part(macro: str, *content: Any) -> str:
    """HTML of a part of the page, by a macro of the template."""
    return str(getattr(_macros(), macro)(*content))


@cache
def _macros() -> Any:
    colours = {"GOOD": GOOD, "WARNING": WARNING, "BAD": BAD, "GREY": GREY}
    return environment().get_template("view.html", globals=colours).module


def in_span_words(score: float) -> str:
    """How near a request is to the demonstrations, in words."""
    if score <= PAGE.like_score:
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
        return part("verdict", "No motion", answer.problem, BAD)
    unlike = plan.in_span_score > UNUSUAL_IN_SPAN_SCORE
    head = part(
        "verdict",
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
    return head + part("rows", rows)


def _effort(plan: Plan) -> str:
    effort = plan.effort_cost
    return f"{effort:.4g} N²m²s" if np.isfinite(effort) else "unknown: inertias are missing"


def _comparison(plan: Plan, other: Plan) -> str:
    """The effort of the motion of B-splines beside that of the components."""
    if not other.is_executable:
        return f"no motion within the limits: {other.message}"
    times = f"{1e3 * other.solve_time:.1f} ms, components {1e3 * plan.solve_time:.1f} ms"
    return f"effort {_effort(other)}, solved in {times}"


def node_html(view: LiveView, now: float) -> str:
    """Whether the node runs, and what it says of itself."""
    if view.diagnostics is None:
        return part("verdict", "No node yet", "waiting for a planner node", GREY)
    if not view.has_node(now):
        age = now - view.diagnostics.time
        return part("verdict", "The node is gone", f"nothing was heard of it for {age:.0f} s", BAD)
    return _status_html("Node", view.diagnostics, now)


def reports_html(view: LiveView, now: float) -> str:
    """The goal, the obstacles, the report of the plan, and that of its execution."""
    goal = "none yet" if view.goal is None else f"{view.goal[0]} ({_age(view.goal[1], now)})"
    obstacles = ", ".join(view.world.names) or "none"
    parts = [part("rows", [("Last goal", goal), ("Obstacles", obstacles)])]
    for title, status in (("Plan", view.report), ("Execution", view.execution)):
        if status is not None:
            parts.append(_status_html(title, status, now, _FIGURES))
    return "".join(parts)


def figures_html(view: LiveView) -> str:
    """All figures of the node."""
    if view.diagnostics is None:
        return ""
    return part("rows", [(name, short(value)) for name, value in view.diagnostics.values.items()])


def states_html(view: LiveView, limits: JointLimits, now: float) -> str:
    """The measured joint states within their limits; old ones are pale, those outside are red."""
    ends = zip(limits.lower.tolist(), limits.upper.tolist(), strict=True)
    bounds, rows = dict(zip(limits.joint_names, ends, strict=True)), []
    for name, (q, v, received) in view.states.items():
        low, high = bounds.get(name, (-math.inf, math.inf))
        is_bounded = math.isfinite(high - low) and math.isfinite(q)
        share = min(max((q - low) / (high - low), 0.0), 1.0) if is_bounded else None
        age = now - received if now - received > PAGE.stale else None
        velocity = v if math.isfinite(v) else None
        rows.append((name, q, share, low, high, not low <= q <= high, velocity, age))
    return part("states", rows)


def _status_html(title: str, status: NodeStatus, now: float, figures: Sequence[str] = ()) -> str:
    colour = _COLOURS[min(status.level, len(_COLOURS) - 1)]
    head = part("verdict", f"{title}, {_age(status.time, now)}", status.message, colour)
    known = [(name, status.values[name]) for name in figures if name in status.values]
    rows = [(name, short(value)) for name, value in known if value != "nan"]
    return head + (part("rows", rows) if rows else "")


def _age(time: float, now: float) -> str:
    return f"{now - time:.0f} s ago"
