# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Repeated goals, the trials by which their motions are improved, and motions that are kept.

Two goals are the same if they have the same target and start near each other, at rest. The
parameters of a scaling and warping are learned. They are applied to the motion that is planned
from the actual start. This module is independent of ROS.
"""

from __future__ import annotations

import hashlib
import json
import re
import threading
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from ...arrays import FloatArray
from ...exceptions import GoalError, LearningError, PlannerError, TrajectoryError
from ...learning.refined_motion import RefinedMotion, primitive_around
from ...learning.refinement import ExecutableMotions, RefinementOptions, refine
from ...learning.trials import TrialLearner, read_request
from ...motion.goal import JointGoal, JointState
from ...planning.plan import Plan
from ...primitives.file import save_primitive
from ...robot.model import Robot
from .assembly import Model
from .execution import Served
from .motion_server import AdaptedPlan


@dataclass(eq=False)
class _LearnedGoal:
    """A goal that is learned. Costs are reported and trials proposed in different threads."""

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
        1-based index of the trial among those of its goal.
    parameters : array, shape (1, N_PARAMETERS)
        How the planned motion was varied.
    """

    number: int
    parameters: FloatArray
    learned: _LearnedGoal

    def record(self, cost: float) -> None:
        """Report the cost of the trial.

        Raises
        ------
        PlannerError
            If the cost is known already, not finite, or can't be written; the learner is unchanged.
        """
        with self.learned.lock:
            if self.learned.is_over:
                raise LearningError("the trials of this goal are over: the best one was kept")
            if len(self.learned.learner.trials) >= self.number:
                raise LearningError(f"the cost of trial {self.number} was reported before")
            self.learned.learner.record(cost, self.parameters)

    def to_keep(self) -> tuple[FloatArray, dict[str, Any]]:
        """Parameters of the best trial, or of this one before any cost, and facts about it.

        Raises
        ------
        LearningError
            If no trial costs less than the planned motion beyond the noise of repeated trials.
        """
        with self.learned.lock:
            gain, n_trials = self.learned.learner.gain(), len(self.learned.learner.trials)
        if n_trials == 0:
            return self.parameters, {}
        if gain is None or not gain.is_certain:
            found = "" if gain is None else f" ({gain.share:.1%} ± {gain.share_error:.1%})"
            raise LearningError(
                f"there is nothing to keep: none of {n_trials} trials costs less than the planned "
                f"motion beyond the noise{found}; report the costs of more trials"
            )
        facts = {
            "trial_cost": gain.cost,
            "planned_cost": gain.original_cost,
            "gain_error": gain.share_error,
            "n_trials": n_trials,
        }
        return np.reshape(gain.parameters, self.parameters.shape), facts

    def close(self) -> None:
        """End the trials of this goal after the best one was kept.

        Raises
        ------
        PlannerError
            If their file can't be removed.
        """
        learned = self.learned
        with learned.lock:
            if not learned.learner.trials:
                return
            learned.is_over = True
            try:
                learned.file.unlink(missing_ok=True)
            except OSError as error:
                reason = f"'{learned.file}' can't be removed: {error.strerror}"
                raise PlannerError(reason) from None


class TrialStore:
    """The trials of all goals, in the parameter ``save_folder``; for the planning thread alone."""

    def __init__(self) -> None:
        self._open: dict[Path, _LearnedGoal] = {}

    def vary(self, goal: JointGoal, plan: Plan, model: Model) -> tuple[Plan, ServedTrial]:
        """Replace a planned motion by the next trial of its goal.

        Parameters
        ----------
        goal : JointGoal
            The goal.
        plan : Plan
            An executable plan for it, from rest.
        model : Model
            The model it was planned with.

        Returns
        -------
        plan : Plan
            With the trajectory of the trial, which is executable, too.
        trial : ServedTrial
            The trial.

        Raises
        ------
        PlannerError
            If trials can't be read or stored.
        """
        learned = self._learned(goal, plan, model)
        with learned.lock:
            proposed = learned.learner.propose().motion.parameters
            number = len(learned.learner.trials) + 1
        segments, options, collision = [plan.motion], _options(model), model.planner.collision
        judge = ExecutableMotions(segments, learned.robot, model.limits, options, collision)
        trajectory, check, parameters = plan.trajectory, plan.limit_check, 0.0 * proposed
        # A proposal may break limits from another start nearby. Then a share of it is tried.
        for share in (1.0, 0.5, 0.25):
            try:
                accepted = judge.accept(RefinedMotion(segments, share * proposed))
            except TrajectoryError:
                continue
            trajectory, check = accepted.trajectory, accepted.check
            parameters = accepted.motion.parameters
            break
        effort = RefinedMotion(segments, parameters).effort(learned.robot)
        varied = replace(
            plan,
            message=f"trial {number}, a variation of the planned motion",
            trajectory=trajectory,
            limit_check=check,
            solution=replace(plan.solution, effort_cost=effort),
        )
        return varied, ServedTrial(number, parameters, learned)

    def _learned(self, goal: JointGoal, plan: Plan, model: Model) -> _LearnedGoal:
        """The learner of a goal: from memory, else from a file, else a new one."""
        folder = Path(model.settings.save_folder)
        if not folder.is_dir():
            raise LearningError(
                f"trials can't be kept: there is no folder '{folder}' (parameter 'save_folder')"
            )
        request = _request(goal)
        stem = "trials_" + hashlib.sha256(json.dumps(request).encode()).hexdigest()[:16]
        start = plan.motion.start
        known = {f for f in self._open if f.parent == folder and f.name.startswith(stem)}
        files = known.union(folder.glob(f"{stem}_*.json"))
        for file in sorted(files):
            learned = self._open.get(file)
            if learned is not None and learned.model is model and not learned.is_over:
                if _is_near(learned.start, start):
                    return learned
            elif file.exists():
                former = _start_in(file, start.joint_names)
                if _is_near(former, start):
                    return self._begin(file, model.planner.plan(goal, former), request, model)
        numbered = (folder / f"{stem}_{number}.json" for number in count(1))
        return self._begin(next(f for f in numbered if f not in files), plan, request, model)

    def _begin(self, file: Path, plan: Plan, request: dict[str, Any], model: Model) -> _LearnedGoal:
        """Learn around a plan, or continue with the trials in its file."""
        if not plan.is_executable:
            raise LearningError(f"the trials in '{file}' can't be continued: {plan.message}")
        # The learner has its own robot, because costs are reported in another thread than that of
        # planning.
        robot = Robot(model.urdf, model.robot.joint_names)
        motion = [plan.motion], robot, model.limits, _options(model)
        start = plan.motion.start
        stored = {
            **request,
            "start": start.positions.tolist(),
            "start_velocities": start.velocities.tolist(),
        }
        best = refine(*motion).motion.parameters
        learner = TrialLearner(*motion, start=best, state=file, request=stored)
        self._open[file] = _LearnedGoal(learner, robot, model, start, file)
        if len(self._open) > 16:
            # Its trials are in its file.
            del self._open[next(iter(self._open))]
        return self._open[file]


def _options(model: Model) -> RefinementOptions:
    settings = model.settings
    return RefinementOptions(
        sample_period=settings.sample_period,
        allow_nonzero_end_velocity=settings.allow_nonzero_end_velocity,
    )


def _request(goal: JointGoal) -> dict[str, Any]:
    """The facts that make two goals the same, of JSON types."""
    state = goal.state
    order = np.argsort(state.joint_names)
    return {
        "joints": [state.joint_names[i] for i in order],
        "positions": state.positions[order].tolist(),
        "velocities": state.velocities[order].tolist(),
        "duration": goal.duration,
        "primitive": goal.primitive,
    }


def _start_in(file: Path, joint_names: tuple[str, ...]) -> JointState:
    """The start of the trials in a file."""
    request = read_request(file)
    try:
        return JointState(joint_names, request["start"], request["start_velocities"])
    except (KeyError, TypeError, GoalError):
        raise LearningError(
            f"the trials in '{file}' have no start of their motions: remove the file"
        ) from None


def _is_near(one: JointState, other: JointState) -> bool:
    """Whether two starts are near enough for trials of the same goal."""
    return bool(np.abs(one.positions - other.positions).max() <= 0.02)


def keep_motion(served: Served, folder: Path, provenance: Mapping[str, Any]) -> Path:
    """Write a primitive of the motions around a published one to a new file.

    If the goal is learned by trials, the best trial is kept, and its trials end.

    Parameters
    ----------
    served : Served
        The published motion.
    folder : Path
        Folder of the file, which is named after the primitive with the first free number.
    provenance : mapping
        Origin of the motion, of JSON types.

    Raises
    ------
    PlannerError
        If the motion is a sequence, no trial was better than the planned motion, or the file
        can't be written.
    """
    plan, trial = served.plan, served.trial
    if isinstance(plan, Plan) and plan.mode:
        reason = "it is a sequence, and a primitive is made of the motion to a single goal"
        raise GoalError(f"the last motion can't be kept: {reason}")
    if isinstance(plan, AdaptedPlan):
        reason = "it continues a running motion; send the goal again when the robot is at rest"
        raise GoalError(f"the last motion can't be kept: {reason}")
    library = served.model.planner.primitives
    primitive = library.named(plan.primitive)
    # Names may contain any characters, a path for example.
    stem = re.sub(r"[^A-Za-z0-9_-]+", "_", primitive.name)[:100]
    names = ((f"{primitive.name}_{k}", folder / f"{stem}_{k}.npz") for k in count(1))
    name, file = next((n, f) for n, f in names if n not in library.names and not f.exists())
    parameters = None
    if trial is not None:
        parameters, facts = trial.to_keep()
        provenance = {**provenance, **facts}
    motion = RefinedMotion([plan.motion], parameters)
    save_primitive(primitive_around(primitive, motion, name, provenance), file)
    if trial is not None:
        trial.close()
    return file
