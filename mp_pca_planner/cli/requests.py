# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Motions planned from command-line arguments, and their reports as text and JSON."""

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
from ..motion.collision import CollisionModel
from ..motion.goal import JointState
from ..motion.trajectory import Trajectory
from ..planning.objectives import objective_weights, weighted_objectives
from ..planning.path_constraints import path_constraints
from ..planning.plan import AUTO, INFEASIBLE, STOPPED_EARLY, Plan, PlannerOptions
from ..planning.planner import Planner
from ..planning.report import collision_words, remarks
from ..primitives.library.library import load_primitives
from ..primitives.primitive import MovementPrimitive
from ..robot.collision import package_folders
from ..robot.limits import moveit_factors_note
from ..robot.model import Robot
from ..robot.world import World
from .goal_arguments import (
    angles_in_degrees,
    asked_texts,
    locked_at_start,
    planned_goal,
    sequence_goal,
    start_state,
    target,
)


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
            lines.append(f"{label:<12} {self._named(state, state.positions)}{unit}{pose}")
            for rate in ("velocities", "accelerations") if label in ("start", "goal") else ():
                values = getattr(state, rate)
                if np.any(values):
                    lines.append(f"{'':<12} {rate} {self._named(state, values)}")
        ends = (" ".join(f"{x:.3f}" for x in position) for position in self.end_positions)
        lines.append(f"end effector '{self.frame}' from {' to '.join(ends)} [m, base frame]")
        return lines

    def _named(self, state: JointState, values: FloatArray) -> str:
        found = by_name(state.joint_names, values)
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
    note = moveit_factors_note(arguments.limits)
    frame = getattr(arguments, "frame", None) or robot.end_effector
    if arguments.command == "sequence" or (arguments.command == "refine" and arguments.via):
        options = PlannerOptions(
            naturalness=arguments.naturalness,
            max_in_span_score=arguments.max_in_span_score,
            sample_period=arguments.sample_period,
            max_solve_time=math.inf,
        )
        planner = Planner(robot, primitives, limits, options, collision)
        read = partial(target, robot, angles)
        goal, asked = sequence_goal(arguments, read, "--goal"), [*arguments.via, arguments.goal]
        plan = planner.plan(goal, start, arguments.mode)
        return PlannedRequest(planner, plan, asked, frame, angles, note)
    options = _options(arguments, robot)
    single = Planner(robot, primitives, limits, options, collision)
    plan = single.plan(planned_goal(arguments, robot), start)
    return PlannedRequest(single, plan, asked_texts(arguments, robot), frame, angles, note)


def _options(arguments: argparse.Namespace, robot: Robot) -> PlannerOptions:
    is_named = isinstance(arguments.duration, str)
    weights = objective_weights(arguments.objective, "--objective")
    if arguments.frame and arguments.goal_pose is None and "straightness" not in weights:
        raise GoalError("--frame is for --goal-pose and the objective straightness: remove it")
    # No controller executes the motion, so its final velocity may be nonzero.
    return PlannerOptions(
        basis=arguments.basis,
        objectives=weighted_objectives(weights, robot, arguments.frame),
        constraints=path_constraints(arguments.constraint, "--constraint", robot),
        timing=arguments.duration if is_named else AUTO,
        naturalness=arguments.naturalness,
        max_in_span_score=arguments.max_in_span_score,
        n_starts=arguments.starts,
        sample_period=arguments.sample_period,
        allow_nonzero_end_velocity=getattr(arguments, "goal_velocity", None) is not None,
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


def effort_words(effort: float, expected: float = math.nan) -> str:
    """An effort and that of the predicted motion as text; either may be unknown."""
    if math.isnan(effort):
        return "unknown: the robot description lacks inertias"
    beside = "" if math.isnan(expected) else f" (predicted motion: {expected:.4g})"
    return f"{effort:.4g} N²m²s{beside}"


def collision_line(facts: Mapping[str, Any]) -> str:
    """The line of text on collisions, checked or not."""
    unchecked = "self-collision is not checked: --collision avoids it"
    return f"collision    {facts.get('collision', unchecked)}"
