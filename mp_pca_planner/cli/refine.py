# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""`refine`: improvement of a planned motion or sequence, stored as new primitives."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..exceptions import LearningError
from ..files import check_writable
from ..learning.refined_motion import RefinedMotion, primitive_around
from ..learning.refinement import AcceptedMotion, Refinement, RefinementOptions, refine
from ..learning.trials import TrialLearner
from ..motion.collision import NOT_CHECKED
from ..primitives.file import save_primitive
from .common import check_motion_file, check_output, report, write_motion
from .plan import PlannedRequest, collision_line, plan_request, status_line
from .terminal import DONE, FAILED, PROGRAM, complain, flush, written_lines

# Options that sequences don't have, with their defaults.
_ONLY_OF_SINGLE_MOTIONS = {
    "goal_pose": None,
    "frame": None,
    "duration": None,
    "objective": "effort=1",
}


def run(arguments: argparse.Namespace) -> int:
    """Run the command; returns the exit status."""
    _check_options(arguments)
    request = _request(arguments)
    planner = request.planner
    options = RefinementOptions(
        time_price=arguments.time_price, sample_period=arguments.sample_period
    )
    problem = request.plan.motions, planner.robot, planner.limits, options
    found = refine(*problem, planner.collision)
    if arguments.trials is None:
        facts = _refine_by_model(arguments, request, found)
    else:
        learner = TrialLearner(
            *problem,
            start=found.motion.parameters,
            collision=planner.collision,
            state=arguments.trials,
        )
        facts = _refine_by_trials(arguments, request, learner)
    return DONE if facts["kept"] or arguments.output is None else FAILED


def _check_options(arguments: argparse.Namespace) -> None:
    check_motion_file(arguments.trajectory, force=arguments.force)
    for path in _outputs(arguments):
        check_output(path, ".npz", force=arguments.force)
    if arguments.trials is not None:
        check_writable(arguments.trials, overwrite=True)
    elif arguments.cost is not None:
        raise LearningError("--cost reports the cost of a trial: also pass --trials")
    if arguments.constraint:
        raise LearningError("--constraint is not accepted: a refined motion would not keep it")
    if not arguments.via:
        return
    for name, usual in _ONLY_OF_SINGLE_MOTIONS.items():
        if getattr(arguments, name) != usual:
            option = f"--{name.replace('_', '-')}"
            raise LearningError(f"{option} can't be given with --via, which makes a sequence")
    if any("@" in text for text in (*arguments.via, arguments.goal)):
        raise LearningError(
            "times (@) are not accepted, because refinement moves time between segments"
        )


def _request(arguments: argparse.Namespace) -> PlannedRequest:
    request = plan_request(arguments)
    if not request.plan.is_executable:
        raise LearningError(f"there is no motion to refine: {request.plan.message}")
    collision = request.planner.collision
    if collision is not None and not collision.has_geometry:
        complain(f"{PROGRAM} refine: {NOT_CHECKED.removeprefix('; ')}")
    return request


def _outputs(arguments: argparse.Namespace) -> list[Path]:
    """Files of the new primitives, one for each segment."""
    path, n_segments = arguments.output, len(arguments.via) + 1
    if path is None or n_segments == 1:
        return [] if path is None else [path]
    return [path.with_stem(f"{path.stem}_{k}") for k in range(1, n_segments + 1)]


def _refine_by_model(
    arguments: argparse.Namespace, request: PlannedRequest, found: Refinement
) -> dict[str, Any]:
    before, after = RefinedMotion(request.plan.motions).duration, found.motion.duration
    facts = _facts(request, found) | {
        "original_cost": found.original_cost,
        "cost": found.cost,
        "gain": found.gain,
        "original_effort_cost": found.original_effort,
        "effort_cost": found.effort,
        "iterations": found.iterations,
    }
    facts["kept"] = _keep(arguments, request, found.motion, facts)
    lines = [
        f"cost         {found.original_cost:.4g} → {found.cost:.4g} ({found.gain:.1%} less)",
        f"duration     {before:.3f} → {after:.3f} s",
        collision_line(facts),
        f"primitive    {_kept_words(arguments, facts)}",
        *written_lines([arguments.trajectory]),
    ]
    _write_and_print(arguments, request, found, facts, lines)
    return facts


def _refine_by_trials(
    arguments: argparse.Namespace, request: PlannedRequest, learner: TrialLearner
) -> dict[str, Any]:
    cost = arguments.cost
    if cost is not None:
        learner.record(cost, keep=False)
    facts = _facts_of_trials(request, learner)
    best, motion_file = learner.best_motion().motion, arguments.trajectory
    gain = learner.gain()
    is_certain = gain is not None and gain.is_certain
    facts["kept"] = is_certain and _keep(arguments, request, best, facts)
    where = motion_file or "pass --trajectory to write it"
    lines = [
        *_trial_lines(arguments, facts),
        *written_lines([arguments.trials if cost is not None else None, motion_file]),
        f"execute trial {facts['n_trials'] + 1} ({where}), and report its cost with --cost",
    ]
    _write_and_print(arguments, request, learner.propose(), facts, lines)
    if cost is not None:
        # This file is written last: if another output can't be written, the command can be
        # repeated.
        flush()
        learner.keep_trials()
    return facts


def _write_and_print(
    arguments: argparse.Namespace,
    request: PlannedRequest,
    accepted: AcceptedMotion,
    facts: dict[str, Any],
    lines: Sequence[str],
) -> None:
    content = facts | accepted.trajectory.columns()
    write_motion(arguments.trajectory, accepted.trajectory, content, force=arguments.force)
    planned = f"planned      {status_line(request.plan)}"
    report(arguments, content, planned, *request.lines(), *lines)


def _facts(request: PlannedRequest, accepted: AcceptedMotion) -> dict[str, Any]:
    return request.facts(accepted.trajectory) | {
        "in_span_score": request.plan.in_span_score,
        "primitive": ", ".join(primitive.name for primitive in request.primitives),
        "duration": accepted.motion.duration,
        "parameters": accepted.motion.parameters,
        "limit_violation": accepted.check.worst_excess,
    }


def _facts_of_trials(request: PlannedRequest, learner: TrialLearner) -> dict[str, Any]:
    best, first = learner.best, learner.trials[0].cost if learner.trials else None
    gain = learner.gain()
    return _facts(request, learner.best_motion()) | {
        "n_trials": len(learner.trials),
        "original_cost": first if gain is None else gain.original_cost,
        "cost": None if best is None else best.cost,
        "gain": None if gain is None else gain.share,
        "gain_error": None if gain is None else gain.share_error,
    }


def _trial_lines(arguments: argparse.Namespace, facts: dict[str, Any]) -> list[str]:
    if facts["cost"] is None:
        return []
    if facts["gain"] is None:
        return [
            f"best of {facts['n_trials']} trials: {facts['cost']:.4g}; the next trials repeat the "
            "planned motion and the best one, to measure the noise"
        ]
    return [
        f"best of {facts['n_trials']} trials: {facts['cost']:.4g}, "
        f"{facts['gain']:.1%} less than the planned motion, "
        f"standard error {facts['gain_error']:.1%}",
        f"primitive    {_kept_words(arguments, facts)}",
    ]


def _keep(
    arguments: argparse.Namespace,
    request: PlannedRequest,
    motion: RefinedMotion,
    facts: dict[str, Any],
) -> bool:
    """Write the new primitives, if requested and their gain suffices."""
    outputs = _outputs(arguments)
    if not outputs or not facts["gain"] >= arguments.min_gain:
        return False
    segments = zip(
        outputs, request.plan.motions, request.primitives, motion.parameters, strict=True
    )
    for k, (path, segment, old, parameters) in enumerate(segments, start=1):
        provenance = {key: facts[key] for key in ("original_cost", "cost", "duration")} | {
            "start": segment.start.positions.tolist(),
            "goal": segment.goal.positions.tolist(),
            "parameters": parameters.tolist(),
        }
        name = arguments.name or f"{old.name}_refined"
        if len(outputs) > 1:
            name += f"_{k}"
        new = primitive_around(old, RefinedMotion([segment], parameters), name, provenance)
        save_primitive(new, path, overwrite=arguments.force)
    return True


def _kept_words(arguments: argparse.Namespace, facts: dict[str, Any]) -> str:
    if facts["kept"]:
        return f"written to {', '.join(map(str, _outputs(arguments)))}"
    if arguments.output is None:
        return "not kept (pass --output to keep it)"
    if facts["gain"] >= arguments.min_gain:
        return "not kept: the gain is not larger than the noise; report more trials"
    return f"not kept: the cost fell by less than {arguments.min_gain:.1%}"
