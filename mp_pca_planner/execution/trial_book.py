# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Goals that come again, and the trials by which their motions are improved.

A goal is one of before if it asks for the same and starts near there, at rest. What is learned
are the parameters of a scaling and warping; they are applied to the motion that is planned from
where the robot really is. This module knows nothing of ROS.
"""

from __future__ import annotations

import hashlib
import json
import threading
from collections import OrderedDict
from dataclasses import dataclass, field, replace
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import FloatArray
from ..exceptions import GoalError, LearningError, PlannerError, TrajectoryError
from ..learning.refined_motion import RefinedMotion
from ..learning.refinement import ExecutableMotions, RefinementCost, RefinementOptions, refine
from ..learning.trials import TrialLearner, read_request
from ..motion.goal import JointGoal, JointState
from ..planning.plan import Plan
from ..robot.model import Robot
from .assembly import Model

# Goals whose learners are kept in memory; the others' trials are in their files.
_MOST_OPEN = 16
# Trials of the same goal start within this of each other [rad or m].
_NEAR = 0.02
# Of a proposal that breaks limits from where the robot is, less is tried; at last the plan itself.
_SHARES = (1.0, 0.5, 0.25)


@dataclass(eq=False)
class _Learned:
    """A goal that is learned: costs are told in another thread than trials are proposed in."""

    learner: TrialLearner
    robot: Robot
    model: Model
    start: JointState
    file: Path
    lock: threading.Lock = field(default_factory=threading.Lock)
    is_over: bool = False


@dataclass(frozen=True, eq=False)
class ServedTrial:
    """A trial that was published.

    Attributes
    ----------
    number : int
        The how-manieth of its goal, from 1.
    parameters : array, shape (1, N_PARAMETERS)
        What was done to the planned motion.
    best_cost : float or None
        The least cost of those before; None if there is none.
    """

    number: int
    parameters: FloatArray
    best_cost: float | None
    learned: _Learned

    @property
    def facts(self) -> dict[str, str | float | int]:
        """What the report says of it."""
        best = "none" if self.best_cost is None else self.best_cost
        return {"trial": self.number, "best_trial_cost": best}

    def tell(self, cost: float) -> None:
        """Say what it cost.

        Raises
        ------
        PlannerError
            If that is known already, no finite number, or can't be written; nothing was learned.
        """
        with self.learned.lock:
            if self.learned.is_over:
                raise LearningError("the trials of this goal are over: their best one was kept")
            if len(self.learned.learner.trials) >= self.number:
                raise LearningError(f"the cost of trial {self.number} was told before")
            self.learned.learner.tell(cost, self.parameters)

    def to_keep(self) -> tuple[FloatArray, dict[str, Any]]:
        """Parameters of the best trial, or of this one before any cost, and facts about it.

        Raises
        ------
        LearningError
            If no trial cost less than the planned motion.
        """
        with self.learned.lock:
            learner = self.learned.learner
            best, trials = learner.best, learner.trials
        if best is None:
            return self.parameters, {}
        if not best.cost < trials[0].cost:
            raise LearningError(
                f"there is nothing to keep: none of {len(trials)} trials cost less than the "
                f"planned motion, {trials[0].cost:g}"
            )
        facts = {"trial_cost": best.cost, "planned_cost": trials[0].cost, "n_trials": len(trials)}
        return np.reshape(best.parameters, self.parameters.shape), facts

    def close(self) -> None:
        """End the trials of this goal, if there are any costs, for the best one was kept.

        Raises
        ------
        PlannerError
            If their file can't be removed.
        """
        with self.learned.lock:
            if not self.learned.learner.trials:
                return
            self.learned.is_over = True
            try:
                self.learned.file.unlink(missing_ok=True)
            except OSError as error:
                raise PlannerError(
                    f"'{self.learned.file}' can't be removed: {error.strerror}"
                ) from None


class TrialBook:
    """The trials of all goals, in the parameter ``save_folder``; for the planning thread alone."""

    def __init__(self) -> None:
        self._open: OrderedDict[Path, _Learned] = OrderedDict()

    def vary(self, goal: JointGoal, plan: Plan, model: Model) -> tuple[Plan, ServedTrial]:
        """Replace a planned motion by the goal's next trial, which may be executed, too.

        Parameters
        ----------
        goal : JointGoal
            What was asked for.
        plan : Plan
            An executable plan for it, from rest.
        model : Model
            What it was made with.

        Returns
        -------
        plan : Plan
            With the trajectory of the trial.
        trial : ServedTrial
            The trial.

        Raises
        ------
        PlannerError
            If trials can't be read or kept.
        """
        learned = self._learned(goal, plan, model)
        with learned.lock:
            proposed = learned.learner.propose().motion.parameters
            number, best = len(learned.learner.trials) + 1, learned.learner.best
        trajectory, check, parameters = plan.trajectory, plan.limit_check, 0.0 * proposed
        judge = ExecutableMotions(
            [plan.motion],
            learned.robot,
            model.limits,
            _refinement_options(model),
            model.planner.collision,
        )
        # What may be executed from one start may break limits from another one near by.
        for share in _SHARES:
            try:
                accepted = judge.accept(RefinedMotion([plan.motion], share * proposed))
            except TrajectoryError:
                continue
            trajectory, check = accepted.trajectory, accepted.check
            parameters = accepted.motion.parameters
            break
        effort, _ = RefinementCost([plan.motion], learned.robot).effort_and_cost(parameters)
        varied = replace(
            plan,
            message=f"trial {number}, a variation of the planned motion",
            trajectory=trajectory,
            limit_check=check,
            solution=replace(plan.solution, effort_cost=effort),
        )
        best_cost = None if best is None else best.cost
        return varied, ServedTrial(number, parameters, best_cost, learned)

    def _learned(self, goal: JointGoal, plan: Plan, model: Model) -> _Learned:
        """What is learned of a goal: in memory, else from a file, else nothing so far."""
        folder = Path(model.settings.save_folder)
        if not folder.is_dir():
            raise LearningError(
                f"trials can't be kept: there is no folder '{folder}' (parameter 'save_folder')"
            )
        asked = _asked(goal)
        stem = "trials_" + hashlib.sha256(json.dumps(asked).encode()).hexdigest()[:16]
        here = plan.motion.start
        files = {*folder.glob(f"{stem}_*.json"), *(f for f in self._open if f.parent == folder)}
        for file in sorted(file for file in files if file.name.startswith(stem)):
            known = self._open.get(file)
            if known is not None and known.model is model and not known.is_over:
                if _is_near(known.start, here):
                    self._open.move_to_end(file)
                    return known
            elif file.exists():
                start = _start_in(file, here)
                if _is_near(start, here):
                    reference = model.planner.plan(goal, start)
                    return self._begin(file, reference, asked, model)
        numbered = (folder / f"{stem}_{number}.json" for number in count(1))
        return self._begin(next(f for f in numbered if f not in files), plan, asked, model)

    def _begin(self, file: Path, plan: Plan, asked: dict[str, Any], model: Model) -> _Learned:
        """Learn around a plan, or go on where its file ends."""
        if not plan.is_executable:
            raise LearningError(f"the trials in '{file}' can't go on: {plan.message}")
        # Of its own: costs are told in another thread than that of planning.
        robot = Robot(model.urdf, model.robot.joint_names)
        start = plan.motion.start
        request = [plan.motion], robot, model.limits, _refinement_options(model)
        learner = TrialLearner(
            *request,
            start=refine(*request).motion.parameters,
            state=file,
            request={
                **asked,
                "start": start.positions.tolist(),
                "start_velocities": start.velocities.tolist(),
            },
        )
        self._open[file] = _Learned(learner, robot, model, start, file)
        while len(self._open) > _MOST_OPEN:
            self._open.popitem(last=False)
        return self._open[file]


def _refinement_options(model: Model) -> RefinementOptions:
    settings = model.settings
    return RefinementOptions(
        sample_period=settings.sample_period,
        allow_nonzero_end_velocity=settings.allow_nonzero_end_velocity,
    )


def _asked(goal: JointGoal) -> dict[str, Any]:
    """What makes two goals the same, of JSON types."""
    state = goal.state
    order = np.argsort(state.joint_names)
    return {
        "joints": [state.joint_names[i] for i in order],
        "positions": state.positions[order].tolist(),
        "velocities": state.velocities[order].tolist(),
        "duration": goal.duration,
        "primitive": goal.primitive,
    }


def _start_in(file: Path, here: JointState) -> JointState:
    """The start that the trials of a file began at."""
    request = read_request(file)
    try:
        return JointState(here.joint_names, request["start"], request["start_velocities"])
    except (KeyError, TypeError, GoalError):
        raise LearningError(
            f"the trials in '{file}' don't say where their motions start: remove the file"
        ) from None


def _is_near(start: JointState, here: JointState) -> bool:
    return bool(np.abs(start.positions - here.positions).max() <= _NEAR)
