# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""`refine`: improvement of a planned motion or sequence, stored as new primitives."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..exceptions import LearningError
from ..learning.refined_motion import RefinedMotion, demonstrated_distance, primitive_around
from ..learning.refinement import Refinement, refine
from ..primitives.file import save_primitive
from .common import check_output, show
from .options import add_file, add_report, add_request, number
from .plan import PlannedRequest, plan_request
from .terminal import DONE, FAILED, PROGRAM, complain

_LEAST_GAIN = 0.01  # share of the cost; a primitive of less is not worth its place


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.description = (
        "Plan a motion or, with --via, a sequence. Then change the amplitude, the duration and the "
        "timing of each segment to reduce its cost."
    )
    add_request(parser)
    help_text = "cost of 1 s, in units of ½∫‖τ‖²dt (default: the duration stays)"
    parser.add_argument("--time-price", metavar="P", type=number(0.0, 1e12), help=help_text)
    parser.add_argument("--name", help="name of the new primitive (default: OLD_refined)")
    add_file(parser, "--output", "FILE.npz", "new primitive to write; numbered for a sequence")
    add_report(parser)


def run(arguments: argparse.Namespace) -> int:
    """Run the command; returns the exit status."""
    outputs = _outputs(arguments)
    for path in outputs:
        check_output(path, ".npz", force=arguments.force)
    if arguments.constraint:
        raise LearningError("--constraint is not accepted: a refined motion would not keep it")
    timed = any("@" in text for text in (*arguments.via, arguments.goal or ""))
    if arguments.via and (timed or arguments.duration is not None):
        raise LearningError(
            "times (@ or --duration) are not accepted with --via, because refinement moves time "
            "between segments"
        )
    request = plan_request(arguments)
    plan, planner = request.plan, request.planner
    if not plan.is_executable:
        raise LearningError(f"there is no motion to refine: {plan.message}")
    problem = plan.motions, planner.robot, planner.limits, planner.collision
    found = refine(*problem, time_price=arguments.time_price)
    is_kept = bool(outputs) and found.gain >= _LEAST_GAIN
    if is_kept:
        _keep(arguments, request, found, outputs)
    elif outputs:
        complain(f"{PROGRAM} refine: not kept: the cost fell by less than {_LEAST_GAIN:.0%}")
    before, after = (
        demonstrated_distance(motion, request.primitives)
        for motion in (RefinedMotion(plan.motions), found.motion)
    )
    unit = planner.robot.position_unit
    facts = {
        "message": f"saves {found.gain:.1%} of the cost; RMS distance in path from what the "
        f"demonstrations predict: {before:.3g} {unit} before, {after:.3g} {unit} after",
        **request.facts(),
        "in_span_score": plan.in_span_score,
        "primitive": plan.primitive,
        "original_duration": plan.duration,
        "duration": found.motion.duration,
        "parameters": found.motion.parameters,
        "limit_violation": found.check.worst_excess,
        "original_cost": found.original_cost,
        "cost": found.cost,
        "gain": found.gain,
        "original_demonstrated_distance": before,
        "demonstrated_distance": after,
        "original_effort_cost": found.original_effort,
        "effort_cost": found.effort,
        "iterations": found.iterations,
        "kept": is_kept,
        "written": outputs if is_kept else [],
    }
    show(arguments, facts | found.trajectory.columns())
    return DONE if is_kept or not outputs else FAILED


def _outputs(arguments: argparse.Namespace) -> list[Path]:
    """Files of the new primitives, one for each segment."""
    path, n_segments = arguments.output, len(arguments.via) + 1
    if path is None or n_segments == 1:
        return [] if path is None else [path]
    return [path.with_stem(f"{path.stem}_{k}") for k in range(1, n_segments + 1)]


def _keep(
    arguments: argparse.Namespace, request: PlannedRequest, found: Refinement, outputs: list[Path]
) -> None:
    """Write the new primitives."""
    segments = zip(request.plan.motions, request.primitives, found.motion.parameters, strict=True)
    for k, (segment, old, parameters) in enumerate(segments):
        provenance = {
            "original_cost": found.original_cost,
            "cost": found.cost,
            "duration": found.motion.duration,
            "start": segment.start.positions.tolist(),
            "goal": segment.goal.positions.tolist(),
            "parameters": parameters.tolist(),
        }
        name = arguments.name or f"{old.name}_refined"
        name += f"_{k + 1}" if len(outputs) > 1 else ""
        new = primitive_around(old, RefinedMotion([segment], parameters), name, provenance)
        save_primitive(new, outputs[k], overwrite=arguments.force)
