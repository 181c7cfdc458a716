# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""`refine`: improve a planned motion by scaling and warping, and keep it as a new primitive."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..exceptions import LearningError
from ..files import exists_already
from ..learning.executions import measure_execution
from ..learning.family import family_around
from ..learning.refined_motion import RefinedMotion
from ..learning.refinement import AcceptedMotion, RefinementOptions, refine
from ..learning.trials import TrialLearner
from ..planning.planner import Plan, Planner
from ..primitives.file import save_primitive
from .common import DONE, FAILED, CommandParser, print_json, run
from .plan import (
    add_request_options,
    check_format,
    plan_request,
    trajectory_columns,
    write_trajectory,
)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit status."""
    return run(_parser(), _refine, argv)


def _parser() -> CommandParser:
    parser = CommandParser(
        "refine",
        "Plan a motion as `plan` does, then improve it by scaling its amplitude and duration and "
        "warping its timing: by the robot's model, or with --trials by what executions cost.",
    )
    add_request_options(parser)
    parser.add_argument(
        "--time-price",
        type=float,
        metavar="P",
        help="what a second costs, in units of ½∫‖τ‖²dt (default: the duration stays)",
    )
    parser.add_argument(
        "--min-gain",
        type=float,
        default=0.01,
        metavar="SHARE",
        help="by how much the cost must fall for a new primitive",
    )
    parser.add_argument("--name", help="name of the new primitive (default: OLD_refined)")
    parser.add_argument("--output", type=Path, metavar="FILE.npz", help="write the new primitive")
    parser.add_argument(
        "--trajectory",
        type=Path,
        metavar="FILE",
        help="write the refined motion, or the next trial: .csv, .json, .npz, or a bag",
    )
    trials = parser.add_argument_group(
        "trials",
        "Each call proposes one motion to execute, the next call is told what it cost. All "
        "other options must stay the same.",
    )
    trials.add_argument("--trials", type=Path, metavar="FILE.json", help="file that keeps them")
    cost = trials.add_mutually_exclusive_group()
    cost.add_argument("--cost", type=float, metavar="C", help="what the last proposal cost")
    cost.add_argument(
        "--executed",
        type=Path,
        metavar="BAG",
        help="recording of its execution, with efforts: its ½∫‖τ‖²dt is the cost",
    )
    trials.add_argument(
        "--tracking-price",
        type=float,
        default=0.0,
        metavar="P",
        help="of --executed: cost of ∫‖q − q_wanted‖²dt",
    )
    trials.add_argument("--seed", type=int, default=0, help="of the random numbers")
    parser.add_argument("--force", action="store_true", help="overwrite files")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    return parser


def _refine(arguments: argparse.Namespace) -> int:
    _check_options(arguments)
    planner, plan = plan_request(arguments)
    if not plan.is_executable:
        raise LearningError(f"there is no motion to refine: {plan.message}")
    options = RefinementOptions(
        time_price=arguments.time_price, sample_period=arguments.sample_period
    )
    if arguments.trials is None:
        return _refine_by_model(arguments, planner, plan, options)
    return _refine_by_trials(arguments, planner, plan, options)


def _check_options(arguments: argparse.Namespace) -> None:
    if arguments.trajectory is not None:
        check_format(arguments.trajectory)
    for path in (arguments.output, arguments.trajectory):
        if path is not None and path.exists() and not arguments.force:
            raise exists_already(path)
    if not 0.0 <= arguments.min_gain < 1.0:
        raise LearningError(f"--min-gain must be from 0 to 1, got {arguments.min_gain}")
    if not (np.isfinite(arguments.tracking_price) and arguments.tracking_price >= 0.0):
        raise LearningError(
            f"--tracking-price must be a number ≥ 0, got {arguments.tracking_price}"
        )
    told = arguments.cost is not None or arguments.executed is not None
    if told and arguments.trials is None:
        raise LearningError("--cost and --executed tell the cost of a trial: name --trials, too")


def _refine_by_model(
    arguments: argparse.Namespace, planner: Planner, plan: Plan, options: RefinementOptions
) -> int:
    found = refine([plan.motion], planner.robot, planner.limits, options)
    accepted = AcceptedMotion(found.motion, found.trajectory, found.check)
    facts = _facts(plan, accepted) | {
        "original_cost": found.original_cost,
        "cost": found.cost,
        "gain": found.gain,
        "original_effort_cost": found.original_effort,
        "effort_cost": found.effort,
        "iterations": found.iterations,
    }
    facts["kept"] = _keep(arguments, planner, plan, found.motion, facts)
    if arguments.trajectory is not None:
        _write(arguments, accepted, facts)
    if arguments.json:
        print_json(facts | trajectory_columns(found.trajectory))
    else:
        print(
            f"cost       {found.original_cost:.4g} → {found.cost:.4g} ({found.gain:.1%} less)\n"
            f"duration   {plan.motion.duration:.3f} → {found.motion.duration:.3f} s\n"
            f"primitive  {_kept_words(arguments, facts)}"
        )
    return DONE if facts["kept"] or arguments.output is None else FAILED


def _refine_by_trials(
    arguments: argparse.Namespace, planner: Planner, plan: Plan, options: RefinementOptions
) -> int:
    start = refine([plan.motion], planner.robot, planner.limits, options).motion.parameters
    learner = TrialLearner(
        [plan.motion],
        planner.robot,
        planner.limits,
        options,
        start=start,
        seed=arguments.seed,
        state=arguments.trials,
    )
    cost = arguments.cost
    if arguments.executed is not None:
        cost = _measured_cost(arguments, learner)
    if cost is not None:
        learner.tell(cost)
    best = learner.best
    facts = _facts(plan, learner.best_motion()) | {
        "n_trials": len(learner.trials),
        "original_cost": learner.trials[0].cost if learner.trials else None,
        "cost": None if best is None else best.cost,
        "gain": None if best is None else _gain(learner.trials[0].cost, best.cost),
    }
    facts["kept"] = best is not None and _keep(
        arguments, planner, plan, learner.best_motion().motion, facts
    )
    proposal = learner.propose()
    if arguments.trajectory is not None:
        _write(arguments, proposal, facts)
    if arguments.json:
        print_json(facts | trajectory_columns(proposal.trajectory))
    else:
        if best is not None:
            print(
                f"best of {len(learner.trials)} trials: {best.cost:.4g}, "
                f"{facts['gain']:.1%} less than the first one's\n"
                f"primitive: {_kept_words(arguments, facts)}"
            )
        print(
            f"execute trial {len(learner.trials) + 1} "
            f"({arguments.trajectory or 'name --trajectory to have it written'}), "
            "and tell its cost with --cost or --executed"
        )
    return DONE if facts["kept"] or arguments.output is None else FAILED


def _measured_cost(arguments: argparse.Namespace, learner: TrialLearner) -> float:
    trajectory = learner.propose().trajectory
    execution = measure_execution(arguments.executed, trajectory)
    missed = execution.tracking_error**2 * float(trajectory.times[-1])
    return execution.effort + float(arguments.tracking_price) * missed


def _gain(before: float, after: float) -> float:
    return 1.0 - after / before if before > 0.0 else 0.0


def _facts(plan: Plan, accepted: AcceptedMotion) -> dict[str, Any]:
    return {
        "primitive": plan.primitive,
        "joint_names": list(accepted.trajectory.joint_names),
        "duration": accepted.motion.duration,
        "parameters": accepted.motion.parameters,
        "limit_violation": accepted.check.worst_excess,
    }


def _keep(
    arguments: argparse.Namespace,
    planner: Planner,
    plan: Plan,
    motion: RefinedMotion,
    facts: dict[str, Any],
) -> bool:
    """Write the new primitive if it is wanted and worth it."""
    if arguments.output is None or not facts["gain"] >= arguments.min_gain:
        return False
    (old,) = (p for p in planner.primitives if p.name == plan.primitive)
    provenance = {key: facts[key] for key in ("original_cost", "cost", "duration")} | {
        "start": plan.motion.start.positions.tolist(),
        "goal": plan.motion.goal.positions.tolist(),
        "parameters": motion.parameters.tolist(),
    }
    name = arguments.name or f"{old.name}_refined"
    family = family_around(old, motion, name, provenance)
    save_primitive(family, arguments.output, overwrite=arguments.force)
    return True


def _kept_words(arguments: argparse.Namespace, facts: dict[str, Any]) -> str:
    if facts["kept"]:
        return f"written to {arguments.output}"
    if arguments.output is None:
        return "not kept (name --output to keep it)"
    return f"not kept: the cost fell by less than {arguments.min_gain:.1%}"


def _write(arguments: argparse.Namespace, accepted: AcceptedMotion, facts: dict[str, Any]) -> None:
    columns = trajectory_columns(accepted.trajectory)
    write_trajectory(accepted.trajectory, arguments.trajectory, facts | columns, arguments.force)
