# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""`plan`: one motion or sequence, offline, from primitive files.

Other commands that begin with a planned motion use :func:`plan_request`, too.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ..arrays import by_name
from ..exceptions import GoalError, PlannerError, RobotError, quote_names
from ..files import check_writable, write_whole
from ..motion.collision import CollisionModel
from ..planning.demonstrated import robot_collision
from ..planning.objectives import objective_weights, weighted_objectives
from ..planning.options import MOST_STARTS, PlannerOptions
from ..planning.path_constraints import path_constraints
from ..planning.plan import ALREADY_THERE, Plan
from ..primitives.library import load_primitives
from ..primitives.primitive import MovementPrimitive
from ..recordings.trajectory_files import check_format
from ..robot.limits import limits_file_note
from ..robot.locked import mimicking_joints, mimicry, relevant_joints
from ..robot.meshes import package_folders
from ..robot.model import Robot
from ..robot.world import World
from .common import check_output, json_text, robot_of, show
from .goal_arguments import planned_goal, start_positions
from .options import add_file, add_report, add_request, limits_given
from .terminal import DONE, FAILED, PROGRAM, complain

if TYPE_CHECKING:
    from ..planning.planner import Planner

_MAX_SOLVE_TIME = 5.0  # s; a sequence has no limit of time
# What the text has; costs, residuals and columns are left to --json.
_SHOWN = (
    *("status", "message", "primitive", "duration", "durations", "limits", "collision"),
    *("start", "goal", "vias", "end_effector", "remarks", "written"),
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.description = "Plan a motion like the demonstrations, or a sequence with --via."
    add_request(parser)
    add_file(parser, "--output", "FILE", "motion to write: .csv, .json, .npz, or a bag")
    add_file(parser, "--plot", "FILE.png", "picture to write")
    add_report(parser)


def run(arguments: argparse.Namespace) -> int:
    """Run the command; returns the exit status."""
    output, plot, force = arguments.output, arguments.plot, arguments.force
    if output is not None:
        check_format(output)
        check_writable(output, overwrite=force)
    check_output(plot, ".png", force=force)
    request = plan_request(arguments)
    plan = request.plan
    facts = plan.summary() | request.facts()
    facts |= {
        "weights": [x for motion in plan.motions for x in motion.weights.tolist()],
        "via_phases": list(plan.via_phases),
        "durations": [motion.duration for motion in plan.motions] if plan.mode else [],
    }
    facts |= plan.trajectory.columns()
    written = []
    if plan.is_executable and output is not None:
        if output.suffix == ".json":
            write_whole(output, json_text(facts).encode(), overwrite=force)
        else:
            plan.trajectory.save(output, overwrite=force)
        written.append(output)
    elif output is not None:
        complain(f"{PROGRAM} plan: '{output}' is not written: there is no motion to execute")
    if plot is not None and plan.motions:
        from ..plotting.motion import plan_figure
        from ..plotting.style import picture

        with picture(plot, force=force) as figure:
            plan_figure(figure, plan, request.planner)
        written.append(plot)
    show(arguments, facts | {"written": written}, _SHOWN)
    return DONE if plan.is_executable or plan.status == ALREADY_THERE else FAILED


@dataclass(frozen=True, eq=False)
class PlannedRequest:
    """A planned motion or sequence, and its planner.

    Attributes
    ----------
    planner : Planner
        The planner.
    plan : Plan
        Its plan.
    frame : str
        The link whose positions are reported.
    remarks : tuple of str
        What is unusual about the motion, what is not checked, and joints without a position.
    """

    planner: Planner
    plan: Plan
    frame: str
    remarks: tuple[str, ...]

    @property
    def primitives(self) -> list[MovementPrimitive]:
        """The primitive of each segment."""
        return [self.planner.primitives.named(name) for name in self.plan.primitives]

    def facts(self) -> dict[str, Any]:
        """What is printed of the request."""
        plan, names = self.plan, list(self.plan.trajectory.joint_names)
        ends = plan.trajectory.positions[[0, -1]]
        hand = self.planner.robot.frame_positions(ends, [self.frame])[:, 0]
        vias = [by_name(x.goal.joint_names, x.goal.positions) for x in plan.motions[:-1]]
        return {
            "start": by_name(names, ends[0]),
            "goal": by_name(names, ends[1]),
            **({"vias": vias} if vias else {}),
            "end_effector": {"frame": self.frame, "start": hand[0], "goal": hand[1]},
            "remarks": self.remarks,
            "joint_names": names,
            "collision": plan.facts.get("collision", ""),
        }


def plan_request(arguments: argparse.Namespace) -> PlannedRequest:
    """Plan the motion or the sequence that command-line options specify.

    Raises
    ------
    PlannerError
        If a file can't be read or an option can't be served.
    """
    primitives = load_primitives(arguments.primitives)
    joint_names = primitives.joint_names
    robot = robot_of(arguments.robot, primitives)
    start = start_positions(arguments, robot)
    robot = robot.locked_at({name: q for name, q in start.items() if name not in joint_names})
    given = limits_given(arguments, robot)
    robot = robot.with_drives(given)
    goal, options = planned_goal(arguments, robot), _options(arguments, robot)
    limits, (collision, remarks) = robot.limits(given), _collision(arguments, robot, primitives)
    from ..planning.planner import Planner  # after the arguments and files were read

    planner = Planner(robot, primitives, limits, options, collision or False)
    plan = planner.plan(goal, {name: start[name] for name in joint_names}, arguments.mode)
    notes = [*plan.remarks, *remarks, limits_file_note(arguments.limits)]
    if plan.motions and planner.default_accelerations and not any(goal.times):
        source = "the URDF has no limits of them; --limits gives others"
        if arguments.limits:
            source = "neither the URDF nor the limits file has limits of them"
        notes.append(
            f"accelerations are limited to {arguments.demonstrated_margin:g} times the "
            f"demonstrated, as {source}"
        )
    notes += _notes_on_joints(planner)
    frame = arguments.frame or robot.end_effector
    return PlannedRequest(planner, plan, frame, tuple(filter(None, notes)))


def _notes_on_joints(planner: Planner) -> list[str]:
    """Joints that matter for the plan, and that mimic others or have no position."""
    robot, collision = planner.robot, planner.collision
    links = [] if collision is None else [obstacle.frame for obstacle in collision.world]
    links += [constraint.frame for constraint in planner.options.constraints]
    relevant = relevant_joints(robot, pairs=collision is not None, links=links)
    placed = {*robot.locked_positions, *mimicking_joints(robot)}
    notes = mimicry(robot, relevant)
    if unknown := [name for name in relevant if name not in placed]:
        notes.append(
            f"joints {quote_names(unknown)} count as 0: to place them, name all joints in --start, "
            f"as in 'joint=…,{unknown[0]}=…'"
        )
    return notes


def _options(arguments: argparse.Namespace, robot: Robot) -> PlannerOptions:
    weights = objective_weights(arguments.objective, "--objective")
    if arguments.frame and arguments.goal_pose is None and "straightness" not in weights:
        raise GoalError("--frame is for --goal-pose and the objective straightness: remove it")
    return PlannerOptions(
        basis=arguments.basis,
        objectives=weighted_objectives(weights, robot, arguments.frame),
        constraints=path_constraints(arguments.constraint, "--constraint", robot),
        timing=arguments.timing,
        naturalness=arguments.naturalness,
        max_in_span_score=arguments.max_in_span_score,
        demonstrated_margin=arguments.demonstrated_margin,
        max_solve_time=arguments.max_solve_time or (math.inf if arguments.via else _MAX_SOLVE_TIME),
        n_starts=MOST_STARTS,
    )


def _collision(
    arguments: argparse.Namespace, robot: Robot, primitives: Sequence[MovementPrimitive]
) -> tuple[CollisionModel | None, tuple[str, ...]]:
    """The collision model, and what it does not check."""
    if arguments.obstacles is None and arguments.margin is not None:
        raise PlannerError("--margin is the clearance from --obstacles: also pass --obstacles")
    if arguments.collision is False and arguments.srdf is not None:
        raise PlannerError("--srdf is for self-collision: remove --no-collision")
    model, remarks = robot_collision(
        robot,
        primitives,
        self_collision=arguments.collision is not False,
        srdf=arguments.srdf,
        package_dirs=package_folders(arguments.package_dirs, arguments.robot),
        world=None if arguments.obstacles is None else World.from_file(arguments.obstacles),
        margin=arguments.margin or 0.0,
    )
    if arguments.collision and model is None:
        raise RobotError(f"--collision: {remarks[0]}")
    return model, remarks
