# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""`plan` and `sequence`: one motion, offline, from primitive files.

Other commands that begin with a planned motion use :func:`plan_request`, too.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from ..arrays import FloatArray, by_name, name_values
from ..exceptions import GoalError, PlannerError, quote_names
from ..motion.collision import CollisionModel, package_folders
from ..motion.goal import JointState
from ..motion.trajectory import Trajectory
from ..planning.objectives import objective_weights, weighted_objectives
from ..planning.path_constraints import path_constraints
from ..planning.plan import AUTO, INFEASIBLE, OPTIMAL, STOPPED_EARLY, Plan, PlannerOptions
from ..planning.planner import Planner
from ..planning.report import collision_words, remarks
from ..plotting.motion import plan_figure
from ..plotting.style import picture
from ..plotting.text import primitive_unit
from ..primitives.library import load_primitives
from ..primitives.primitive import MovementPrimitive
from ..robot.limits import moveit_factors_note
from ..robot.model import Robot
from ..robot.world import World
from .common import check_motion_file, check_output, report, write_motion
from .goal_arguments import (
    angles_in_degrees,
    asked_texts,
    locked_at_start,
    planned_goal,
    sequence_goal,
    start_state,
    target,
)
from .terminal import DONE, FAILED, written_lines


def run(arguments: argparse.Namespace) -> int:
    """Run the command; returns the exit status."""
    output, plot, force = arguments.output, arguments.plot, arguments.force
    check_motion_file(output, force=force)
    check_output(plot, ".png", force=force)
    request = plan_request(arguments)
    plan = request.plan
    own: dict[str, Any] = {"weights": plan.solution.weights, "via_phases": list(plan.via_phases)}
    if plan.mode:
        own = {"durations": [motion.duration for motion in plan.motions]}
    columns = plan.trajectory.columns()
    facts = plan.summary() | request.facts(plan.trajectory) | own | columns
    if plan.is_executable:
        write_motion(output, plan.trajectory, facts, force=force)
    if plot is not None:
        with picture(plot, force=force) as figure:
            plan_figure(figure, plan)
    not_written = [] if plan.is_executable or output is None else [output]
    written = written_lines(file for file in (output, plot) if file not in not_written)
    files = [*(f"not written  {file}" for file in not_written), *written]
    lines = [status_line(plan), *request.lines(), *_plan_lines(request, facts)]
    report(arguments, facts, *lines, *files)
    return DONE if plan.is_executable else FAILED


def _plan_lines(request: PlannedRequest, facts: Mapping[str, Any]) -> list[str]:
    plan, unlimited = request.plan, request.planner.limits.unlimited
    primitive = f"{facts['primitive']} (in-span score {facts['in_span_score']:.2f}"
    duration = f"duration     {facts['duration']:.3f} s"
    prediction = f"prediction   {_expected_error_words(request)}"
    solved = f"solve time   {1e3 * plan.solve_time:.2f} ms, {facts['iterations']} iterations"
    if plan.mode:
        durations = ", ".join(f"{each:.3f}" for each in facts["durations"])
        lines = [
            f"primitives   {primitive})",
            prediction,
            f"{duration} ({durations}){plan.could_take}",
            f"effort       {_effort_words(plan.effort_cost)}",
            solved,
            f"target error {max(plan.via_error, plan.goal_error):.2g} rad or m",
        ]
    else:
        efforts = plan.solution.effort_cost, plan.solution.start_cost
        lines = [
            f"primitive    {primitive}, about 1 is like the demonstrations)",
            prediction,
            f"selection    {facts['selection']}",
            f"{duration}{plan.could_take}",
            f"effort       {_effort_words(*efforts)}",
            solved,
            f"goal error   {facts['goal_error']:.2g} rad or m",
        ]
        if plan.correction > 0.0:
            lines.append(
                f"correction   {plan.correction:.2g} rad or m beside "
                f"{plan.n_components_used} components"
            )
    without = f"; some joints have no limit of {', '.join(unlimited)}: use --limits"
    return [
        *lines,
        collision_line(facts),
        f"worst limit violation  {facts['limit_violation']:.2g} (relative, 1 ms grid)"
        f"{without if unlimited else ''}",
    ]


def _expected_error_words(request: PlannedRequest) -> str:
    error, primitive = request.plan.expected_error, request.primitives[0]
    if np.isnan(error):
        return "learned from one demonstration, so its error is unknown"
    unit = primitive_unit(primitive)
    return f"the predicted motion's expected error is {unit.number(error)} {unit.name} RMS"


def _effort_words(effort: float, expected: float = math.nan) -> str:
    """An effort and that of the predicted motion as text; either may be unknown."""
    if math.isnan(effort):
        return "unknown: the robot description lacks inertias"
    beside = "" if math.isnan(expected) else f" (predicted motion: {expected:.4g})"
    return f"{effort:.4g} N²m²s{beside}"


@dataclass(frozen=True, eq=False)
class PlannedRequest:
    """A planned motion or sequence, and its planner.

    Attributes
    ----------
    planner : Planner
        The planner.
    plan : Plan
        Its plan.
    asked : list of str
        The texts of the vias and the goal.
    frame : str
        The link whose positions are reported.
    angles : tuple of str
        Joints that are printed in degrees, as they were given.
    note : str
        A remark on the limits file, if there is one.
    """

    planner: Planner
    plan: Plan
    asked: list[str]
    frame: str
    angles: tuple[str, ...] = ()
    note: str = ""

    @property
    def primitives(self) -> list[MovementPrimitive]:
        """The primitive of each segment."""
        return [self.planner.primitives.named(name) for name in self.plan.primitives]

    @property
    def passed(self) -> list[JointState]:
        """The start, the configurations at the vias, and the goal."""
        motions = self.plan.motions
        return [motions[0].start, *(motion.goal for motion in motions)]

    @property
    def end_positions(self) -> FloatArray:
        """Positions of the frame at the start and the goal in the base frame, shape (2, 3) [m]."""
        ends = self.plan.trajectory.positions[[0, -1]]
        return self.planner.robot.frame_positions(ends, [self.frame])[:, 0]

    @property
    def remarks(self) -> list[str]:
        """What is unusual about the motion and shapes, and joints whose position was not given."""
        robot, collision = self.planner.robot, self.planner.collision
        found = [*remarks(self.plan), *(() if collision is None else collision.notes)]
        found += [self.note] if self.note else []
        links = [] if collision is None else [obstacle.frame for obstacle in collision.world]
        links += [constraint.frame for constraint in self.planner.options.constraints]
        relevant = robot.relevant_joints(pairs=collision is not None, links=links)
        found += robot.mimicry(relevant)
        placed = {*robot.locked_positions, *robot.mimicking_joints}
        unknown = [name for name in relevant if name not in placed]
        if not unknown:
            return found
        text = (
            f"joints {quote_names(unknown)} count as 0: to place them, name all joints in --start, "
            f"as in 'joint=…,{unknown[0]}=…'"
        )
        return [*found, text]

    def facts(self, trajectory: Trajectory) -> dict[str, Any]:
        """Values of the JSON report on the request and on a motion planned for it."""
        start, *vias, goal = [by_name(s.joint_names, s.positions) for s in self.passed]
        check = self.planner.collision
        return {
            "start": start,
            "goal": goal,
            **({"vias": vias} if vias else {}),
            "end_effector": {
                "frame": self.frame,
                **dict(zip(("start", "goal"), self.end_positions, strict=True)),
            },
            "remarks": self.remarks,
            "joint_names": list(trajectory.joint_names),
            **({} if check is None else {"collision": collision_words(check, trajectory)}),
        }

    def lines(self) -> list[str]:
        """Lines of text: remarks; start, vias and goal by joint name; the end effector's ends."""
        passed = self.passed
        unit = " [deg or m]" if self.angles else ""
        labels = ["start", *(f"via {k}" for k in range(1, len(passed) - 1)), "goal"]
        poses = ["", *(f" (for the pose {text})" if ":" in text else "" for text in self.asked)]
        lines = [f"remark       {remark}" for remark in self.remarks if remark != self.plan.message]
        for label, state, pose in zip(labels, passed, poses, strict=True):
            lines.append(f"{label:<12} {self._named(state)}{unit}{pose}")
        ends = (" ".join(f"{x:.3f}" for x in position) for position in self.end_positions)
        lines.append(f"end effector '{self.frame}' from {' to '.join(ends)} [m, base frame]")
        return lines

    def _named(self, state: JointState) -> str:
        found = by_name(state.joint_names, state.positions)
        found |= {name: math.degrees(found[name]) for name in self.angles}
        return name_values({name: found[name] for name in self.planner.robot.described_joints})


def plan_request(arguments: argparse.Namespace) -> PlannedRequest:
    """Plan the motion or the sequence that command-line options specify.

    Raises
    ------
    PlannerError
        If a file can't be read or an option can't be served.
    """
    primitives = load_primitives(arguments.primitives)
    joint_names = primitives[0].joint_names
    robot = Robot.from_file(arguments.robot, joint_names)
    whole = Robot.from_file(arguments.robot, robot.movable_joints)
    if locked := locked_at_start(arguments, robot, whole):
        robot = Robot.from_file(arguments.robot, joint_names, locked=locked)
    limits, collision = robot.limits(arguments.limits or {}), _collision_model(arguments, robot)
    start, angles = start_state(arguments, robot), angles_in_degrees(arguments, robot)
    command = arguments.command
    if command == "sequence" or (command == "refine" and arguments.via):
        # A sequence has no limit of time, and none of the options of a single goal.
        options = PlannerOptions(
            naturalness=arguments.naturalness,
            max_in_span_score=arguments.max_in_span_score,
            sample_period=arguments.sample_period,
            max_solve_time=math.inf,
        )
        goal: Any = sequence_goal(arguments, partial(target, robot, angles), "--goal")
        mode = arguments.mode
    else:
        options, mode = _options(arguments, robot), OPTIMAL
        goal = planned_goal(arguments, robot)
    planner = Planner(robot, primitives, limits, options, collision)
    plan = planner.plan(goal, start, mode)
    frame = getattr(arguments, "frame", None) or robot.end_effector
    note, asked = moveit_factors_note(arguments.limits), asked_texts(arguments, robot)
    return PlannedRequest(planner, plan, asked, frame, angles, note)


def _options(arguments: argparse.Namespace, robot: Robot) -> PlannerOptions:
    is_named = isinstance(arguments.duration, str)
    weights = objective_weights(arguments.objective, "--objective")
    if arguments.frame and arguments.goal_pose is None and "straightness" not in weights:
        raise GoalError("--frame is for --goal-pose and the objective straightness: remove it")
    return PlannerOptions(
        basis=arguments.basis,
        objectives=weighted_objectives(weights, robot, arguments.frame),
        constraints=path_constraints(arguments.constraint, "--constraint", robot),
        timing=arguments.duration if is_named else AUTO,
        naturalness=arguments.naturalness,
        max_in_span_score=arguments.max_in_span_score,
        n_starts=arguments.starts,
        sample_period=arguments.sample_period,
        max_solve_time=arguments.max_solve_time,
    )


def _collision_model(arguments: argparse.Namespace, robot: Robot) -> CollisionModel | None:
    if arguments.obstacles is None and arguments.margin is not None:
        raise PlannerError("--margin is the clearance from --obstacles: also pass --obstacles")
    if not arguments.collision and arguments.srdf is not None:
        raise PlannerError("--srdf is for --collision: also pass --collision")
    if not arguments.collision and arguments.obstacles is None:
        if arguments.package_dirs:
            raise PlannerError(
                "--package-dirs is for --collision or --obstacles: also pass one of them"
            )
        return None
    return CollisionModel(
        robot,
        srdf=arguments.srdf,
        package_dirs=package_folders(arguments.package_dirs, arguments.robot),
        world=None if arguments.obstacles is None else World.from_file(arguments.obstacles),
        margin=arguments.margin or 0.0,
        self_collision=arguments.collision,
    )


def status_line(plan: Plan) -> str:
    """The status of a plan, its meaning for the motion, and the plan's own sentence."""
    meaning = {
        STOPPED_EARLY: " (the motion may be executed, but is not optimal)",
        INFEASIBLE: " (the motion must not be executed)",
    }
    return f"{plan.status}{meaning.get(plan.status, '')}: {plan.message}"


def collision_line(facts: Mapping[str, Any]) -> str:
    """The line of text on collisions, checked or not."""
    unchecked = "self-collision is not checked: --collision avoids it"
    return f"collision    {facts.get('collision', unchecked)}"
