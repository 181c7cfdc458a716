# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""`refine`: improve a planned motion or sequence, and keep it as new primitives."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..exceptions import LearningError
from ..files import check_writable
from ..learning.executions import measure_execution
from ..learning.family import family_around
from ..learning.refined_motion import RefinedMotion
from ..learning.refinement import AcceptedMotion, RefinementOptions, refine
from ..learning.trials import TrialLearner
from ..motion.collision import NOT_CHECKED, CollisionModel
from ..planning.motion import Motion
from ..planning.plan import Plan
from ..planning.planner import Planner
from ..planning.remarks import remarks
from ..planning.sequence import OPTIMAL, SequencePlan, SequencePlanner
from ..primitives.file import save_primitive
from ..primitives.primitive import MovementPrimitive
from ..robot.limits import JointLimits
from ..robot.model import Robot
from .common import (
    CommandParser,
    check_output,
    number,
    print_json,
    run,
    seed,
)
from .motion_files import check_format, trajectory_columns, write_trajectory
from .plan import add_request_options, asked, plan_request
from .sequence import sequence_request
from .states import (
    collision_facts,
    collision_lines,
    passed,
    passed_lines,
    remark_lines,
    states_by_name,
    status_line,
)
from .terminal import DONE, FAILED, complain, flush, say, written_lines

_PRICE = number(0.0, 1e12)
# Options of `plan` that sequences don't have.
_NOT_OF_SEQUENCES = (
    "goal_pose",
    "frame",
    "start_velocity",
    "start_acceleration",
    "goal_velocity",
    "goal_acceleration",
    "duration",
    "objective",
    "basis",
    "starts",
)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit status."""
    return run(_parser(), _refine, argv)


def _parser() -> CommandParser:
    parser = CommandParser(
        "refine",
        "Plan a motion as `plan` does, or with --via as `sequence` does, then improve it by "
        "scaling its amplitude and duration and warping its timing, segment by segment: by the "
        "robot's model, or with --trials by what executions cost.",
    )
    add_request_options(parser, via_form="V", via_time="as in `sequence`, but at any time")
    parser.add_argument(
        "--time-price",
        type=_PRICE,
        metavar="P",
        help="what a second costs, in units of ½∫‖τ‖²dt (default: the duration stays)",
    )
    parser.add_argument(
        "--min-gain",
        type=number(0.0, 0.999),
        default=0.01,
        metavar="SHARE",
        help="by how much the cost must fall for a new primitive",
    )
    parser.add_argument("--name", help="name of the new primitive (default: OLD_refined)")
    parser.add_argument(
        "--output",
        type=Path,
        metavar="FILE.npz",
        help="write the new primitive; those of a sequence, one for each segment, are numbered",
    )
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
    cost.add_argument(
        "--cost", type=number(-1e12, 1e12), metavar="C", help="what the last proposal cost"
    )
    cost.add_argument(
        "--executed",
        type=Path,
        metavar="BAG",
        help="recording of its execution, with efforts: its ½∫‖τ‖²dt is the cost",
    )
    trials.add_argument(
        "--tracking-price",
        type=_PRICE,
        default=0.0,
        metavar="P",
        help="of --executed: cost of ∫‖q − q_wanted‖²dt",
    )
    trials.add_argument("--seed", type=seed, default=0, help="of the random numbers")
    parser.add_argument("--force", action="store_true", help="overwrite files")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    return parser


@dataclass(frozen=True, eq=False)
class _Planned:
    """What is refined: one motion or those of a sequence, and what each is made from."""

    plan: Plan | SequencePlan
    robot: Robot
    limits: JointLimits
    collision: CollisionModel | None
    motions: tuple[Motion, ...]
    primitives: tuple[MovementPrimitive, ...]


def _refine(arguments: argparse.Namespace) -> int:
    _check_options(arguments)
    planned = _planned(arguments)
    options = RefinementOptions(
        time_price=arguments.time_price,
        sample_period=arguments.sample_period,
        seed=arguments.seed,
    )
    if arguments.trials is None:
        return _refine_by_model(arguments, planned, options)
    return _refine_by_trials(arguments, planned, options)


def _planned(arguments: argparse.Namespace) -> _Planned:
    planner: Planner | SequencePlanner
    plan: Plan | SequencePlan
    if arguments.via:
        planner, plan = sequence_request(arguments, OPTIMAL)
        motions, names = plan.motions, plan.primitives
    else:
        planner, plan = plan_request(arguments)
        motions, names = (plan.motion,), (plan.primitive,)
    if not plan.is_executable:
        raise LearningError(f"there is no motion to refine: {plan.message}")
    collision = planner.collision
    if collision is not None and not collision.has_geometry:
        complain(f"mp_pca_planner refine: {NOT_CHECKED.removeprefix('; ')}")
    known = {primitive.name: primitive for primitive in planner.primitives}
    made_from = tuple(known[name] for name in names)
    return _Planned(plan, planner.robot, planner.limits, collision, motions, made_from)


def _check_options(arguments: argparse.Namespace) -> None:
    if arguments.trajectory is not None:
        check_format(arguments.trajectory)
        check_writable(arguments.trajectory, overwrite=arguments.force)
    for path in _outputs(arguments):
        check_output(path, ".npz", force=arguments.force)
    if arguments.trials is not None:
        check_writable(arguments.trials, overwrite=True)
    if arguments.via:
        _check_sequence_options(arguments)
    told = arguments.cost is not None or arguments.executed is not None
    if told and arguments.trials is None:
        raise LearningError("--cost and --executed tell the cost of a trial: name --trials, too")


def _check_sequence_options(arguments: argparse.Namespace) -> None:
    """Refuse options of `plan` that a sequence doesn't have."""
    usual = _parser()
    for name in _NOT_OF_SEQUENCES:
        if getattr(arguments, name) != usual.get_default(name):
            option = f"--{name.replace('_', '-')}"
            raise LearningError(f"{option} can't be given with --via, which makes a sequence")
    if any("@" in text for text in (*arguments.via, arguments.goal)):
        raise LearningError(
            "times (@) can't be given: refinement takes time from one segment for another"
        )


def _outputs(arguments: argparse.Namespace) -> list[Path]:
    """Where new primitives are written, one for each segment."""
    path, n_segments = arguments.output, len(arguments.via) + 1
    if path is None or n_segments == 1:
        return [] if path is None else [path]
    return [path.with_stem(f"{path.stem}_{k}") for k in range(1, n_segments + 1)]


def _refine_by_model(
    arguments: argparse.Namespace, planned: _Planned, options: RefinementOptions
) -> int:
    found = refine(planned.motions, planned.robot, planned.limits, options, planned.collision)
    before, after = RefinedMotion(planned.motions).duration, found.motion.duration
    accepted = AcceptedMotion(found.motion, found.trajectory, found.check)
    facts = _facts(planned, accepted) | {
        "original_cost": found.original_cost,
        "cost": found.cost,
        "gain": found.gain,
        "original_effort_cost": found.original_effort,
        "effort_cost": found.effort,
        "iterations": found.iterations,
    }
    facts["kept"] = _keep(arguments, planned, found.motion, facts)
    if arguments.trajectory is not None:
        _write(arguments, accepted, facts)
    if arguments.json:
        print_json(facts | trajectory_columns(found.trajectory))
    else:
        say(
            *_request_lines(planned, arguments),
            f"cost         {found.original_cost:.4g} → {found.cost:.4g} ({found.gain:.1%} less)",
            f"duration     {before:.3f} → {after:.3f} s",
            *collision_lines(facts),
            f"primitive    {_kept_words(arguments, facts)}",
            *written_lines([arguments.trajectory]),
        )
    return DONE if facts["kept"] or arguments.output is None else FAILED


def _refine_by_trials(
    arguments: argparse.Namespace, planned: _Planned, options: RefinementOptions
) -> int:
    request = planned.motions, planned.robot, planned.limits, options
    learner = TrialLearner(
        *request,
        start=refine(*request, planned.collision).motion.parameters,
        collision=planned.collision,
        state=arguments.trials,
    )
    cost = arguments.cost
    if arguments.executed is not None:
        cost = _measured_cost(arguments, learner)
    if cost is not None:
        learner.tell(cost, keep=False)
    best = learner.best
    facts = _facts(planned, learner.best_motion()) | {
        "n_trials": len(learner.trials),
        "original_cost": learner.trials[0].cost if learner.trials else None,
        "cost": None if best is None else best.cost,
        "gain": None if best is None else _gain(learner.trials[0].cost, best.cost),
    }
    facts["kept"] = best is not None and _keep(
        arguments, planned, learner.best_motion().motion, facts
    )
    proposal = learner.propose()
    if arguments.trajectory is not None:
        _write(arguments, proposal, facts)
    if arguments.json:
        print_json(facts | trajectory_columns(proposal.trajectory))
    else:
        say(*_request_lines(planned, arguments))
        if best is not None:
            say(
                f"best of {len(learner.trials)} trials: {best.cost:.4g}, "
                f"{facts['gain']:.1%} less than the first one's",
                f"primitive    {_kept_words(arguments, facts)}",
            )
        say(*written_lines([arguments.trials if cost is not None else None, arguments.trajectory]))
        say(
            f"execute trial {len(learner.trials) + 1} "
            f"({arguments.trajectory or 'name --trajectory to have it written'}), "
            "and report its cost with --cost or --executed"
        )
    if cost is not None:
        # Last of all: if something else can't be written, the call can be repeated.
        flush()
        learner.keep_trials()
    return DONE if facts["kept"] or arguments.output is None else FAILED


def _measured_cost(arguments: argparse.Namespace, learner: TrialLearner) -> float:
    trajectory = learner.propose().trajectory
    execution = measure_execution(arguments.executed, trajectory)
    missed = execution.tracking_error**2 * float(trajectory.times[-1])
    return execution.effort + float(arguments.tracking_price) * missed


def _gain(before: float, after: float) -> float:
    return 1.0 - after / before if before > 0.0 else 0.0


def _request_lines(planned: _Planned, arguments: argparse.Namespace) -> list[str]:
    """The planned motion: its status, remarks, and the start, the vias and the goal by joint."""
    robot = planned.robot
    states = passed_lines(passed(planned.motions), robot.described_joints, asked(arguments, robot))
    return [f"planned      {status_line(planned.plan)}", *remark_lines(planned.plan), *states]


def _facts(planned: _Planned, accepted: AcceptedMotion) -> dict[str, Any]:
    return {
        **states_by_name(passed(planned.motions)),
        "in_span_score": planned.plan.in_span_score,
        "remarks": remarks(planned.plan),
        **collision_facts(planned.collision, accepted.trajectory),
        "primitive": ", ".join(primitive.name for primitive in planned.primitives),
        "joint_names": list(accepted.trajectory.joint_names),
        "duration": accepted.motion.duration,
        "parameters": accepted.motion.parameters,
        "limit_violation": accepted.check.worst_excess,
    }


def _keep(
    arguments: argparse.Namespace, planned: _Planned, motion: RefinedMotion, facts: dict[str, Any]
) -> bool:
    """Write the new primitives if they are wanted and worth it."""
    outputs = _outputs(arguments)
    if not outputs or not facts["gain"] >= arguments.min_gain:
        return False
    for k, path in enumerate(outputs):
        segment, old = planned.motions[k], planned.primitives[k]
        provenance = {key: facts[key] for key in ("original_cost", "cost", "duration")} | {
            "start": segment.start.positions.tolist(),
            "goal": segment.goal.positions.tolist(),
            "parameters": motion.parameters[k].tolist(),
        }
        name = arguments.name or f"{old.name}_refined"
        if len(outputs) > 1:
            name += f"_{k + 1}"
        part = RefinedMotion([segment], motion.parameters[k])
        save_primitive(family_around(old, part, name, provenance), path, overwrite=arguments.force)
    return True


def _kept_words(arguments: argparse.Namespace, facts: dict[str, Any]) -> str:
    if facts["kept"]:
        return f"written to {', '.join(map(str, _outputs(arguments)))}"
    if arguments.output is None:
        return "not kept (name --output to keep it)"
    return f"not kept: the cost fell by less than {arguments.min_gain:.1%}"


def _write(arguments: argparse.Namespace, accepted: AcceptedMotion, facts: dict[str, Any]) -> None:
    columns = trajectory_columns(accepted.trajectory)
    write_trajectory(accepted.trajectory, arguments.trajectory, facts | columns, arguments.force)
