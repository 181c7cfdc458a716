# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""`plan` and `sequence`: one motion, offline, from primitive files."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from typing import Any

import numpy as np

from ..plotting.motion import plan_figure
from ..plotting.page import picture
from ..plotting.text import primitive_unit
from .common import check_motion_file, check_output, report, write_motion
from .requests import PlannedRequest, collision_line, effort_words, plan_request, status_line
from .terminal import DONE, FAILED, written_lines


def run(arguments: argparse.Namespace) -> int:
    """Run the command; returns the exit status."""
    output, plot, force = arguments.output, arguments.plot, arguments.force
    check_motion_file(output, force=force)
    check_output(plot, ".png", force=force)
    request = plan_request(arguments)
    plan = request.plan
    facts = _facts(request)
    if plan.is_executable:
        write_motion(output, plan.trajectory, facts, force=force)
    if plot is not None:
        with picture(plot, force=force) as figure:
            plan_figure(figure, plan)
    not_written = [] if plan.is_executable or output is None else [output]
    written = written_lines(file for file in (output, plot) if file not in not_written)
    files = [*(f"not written  {file}" for file in not_written), *written]
    report(arguments, facts, *_text(request, facts), *files)
    return DONE if plan.is_executable else FAILED


def _facts(request: PlannedRequest) -> dict[str, Any]:
    plan = request.plan
    own: dict[str, Any] = {"weights": plan.solution.weights, "via_phases": list(plan.via_phases)}
    if plan.mode:
        own = {"durations": [motion.duration for motion in plan.motions]}
    columns = plan.trajectory.columns()
    return plan.summary() | request.facts(plan.trajectory) | own | columns


def _text(request: PlannedRequest, facts: Mapping[str, Any]) -> list[str]:
    plan, unlimited = request.plan, request.planner.limits.unlimited
    own = _sequence_lines(request, facts) if plan.mode else _plan_lines(request, facts)
    without = f"; some joints have no limit of {', '.join(unlimited)}: use --limits"
    return [
        status_line(plan),
        *request.lines(),
        *own,
        collision_line(facts),
        f"worst limit violation  {facts['limit_violation']:.2g} (relative, 1 ms grid)"
        f"{without if unlimited else ''}",
    ]


def _plan_lines(request: PlannedRequest, facts: Mapping[str, Any]) -> list[str]:
    plan = request.plan
    lines = [
        f"primitive    {facts['primitive']} (in-span score {facts['in_span_score']:.2f}, "
        "about 1 is like the demonstrations)",
        f"prediction   {_expected_error_words(request)}",
        f"selection    {facts['selection']}",
        f"duration     {facts['duration']:.3f} s{plan.could_take}",
        f"effort       {effort_words(plan.solution.effort_cost, plan.solution.start_cost)}",
        f"solve time   {1e3 * plan.solve_time:.2f} ms, {facts['iterations']} iterations",
        f"goal error   {facts['goal_error']:.2g} rad or m",
    ]
    if plan.correction > 0.0:
        lines.append(
            f"correction   {plan.correction:.2g} rad or m beside "
            f"{plan.n_components_used} components"
        )
    return lines


def _sequence_lines(request: PlannedRequest, facts: Mapping[str, Any]) -> list[str]:
    plan = request.plan
    durations = ", ".join(f"{duration:.3f}" for duration in facts["durations"])
    return [
        f"primitives   {facts['primitive']} (in-span score {facts['in_span_score']:.2f})",
        f"prediction   {_expected_error_words(request)}",
        f"duration     {facts['duration']:.3f} s ({durations}){plan.could_take}",
        f"effort       {effort_words(plan.effort_cost)}",
        f"solve time   {1e3 * plan.solve_time:.2f} ms, {facts['iterations']} iterations",
        f"target error {max(plan.via_error, plan.goal_error):.2g} rad or m",
    ]


def _expected_error_words(request: PlannedRequest) -> str:
    error, primitive = request.plan.expected_error, request.primitives[0]
    if np.isnan(error):
        return "learned from one demonstration, so its error is unknown"
    unit = primitive_unit(primitive)
    return f"the predicted motion's expected error is {unit.number(error)} {unit.name} RMS"
