# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Learning by trials: scaling and warping improved by the measured cost of executed motions.

The planned motion, and its refinement by the model, are measured several times: the better one is
the best known motion, and the scatter is the noise of a measurement. CMA-ES (Hansen and Ostermeier,
Evolutionary Computation 9(2), 2001; the package `cmaes`) proposes the parameters of
:class:`.RefinedMotion` around the best known. The least of many noisy costs is too low, so the
motion that it finds is measured anew, and kept only if it beats the best known beyond the noise.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ..exceptions import LearningError, RobotError, TrajectoryError, require
from ..motion.trajectory import Trajectory
from ..planning.plan import Plan
from ..planning.planner import Planner
from .refined_motion import LOG_DURATION, RefinedMotion
from .refinement import AcceptedMotion, ExecutableMotions, parameter_bounds, refine

MIN_TRIALS = 12
"""Trials that measure the motions that are compared, and a few that search."""

# Measurements of each motion that is compared.
_N_REPEATS = 3
# Standard errors of a difference beyond which it is more than noise.
_BEYOND = 2.0
# Standard deviation of the parameters of the first trials.
_FIRST_STEP = 0.2
# A proposed trial that violates limits is moved half-way to the best motion at most this often.
_MAX_HALVINGS = 8


@dataclass(frozen=True, eq=False)
class LearnedMotion(AcceptedMotion):
    """The best motion known after trials.

    Attributes
    ----------
    cost : float
        Mean of its measured costs.
    planned_cost : float
        That of the planned motion.
    noise : float
        Standard deviation of one measurement.
    """

    cost: float
    planned_cost: float
    noise: float


def improve_by_trials(
    planner: Planner,
    plan: Plan,
    run: Callable[[Trajectory], float],
    n_trials: int = 60,
    seed: int = 0,
) -> LearnedMotion:
    """Improve a planned motion by the measured costs of variations with the same duration.

    Parameters
    ----------
    planner : Planner
        The planner of the motion, without constraints.
    plan : Plan
        The motion to improve.
    run : callable
        Executes a trajectory, which was checked as plans are, and returns its measured cost.
    n_trials : int
        Number of trials, at least 12.
    seed : int
        The same seed and costs give the same trials.

    Returns
    -------
    motion : LearnedMotion
        The planned motion, its refinement by the model, or the motion that trials found, if the
        costs differ by more than their noise; else the first of refinement and plan.

    Raises
    ------
    LearningError
        If the planner has constraints, there is no motion, or a cost is not finite.
    MissingDependencyError
        If `cmaes` is not installed.
    TrajectoryError
        If the plan is not executable.
    """
    if planner.options.constraints:
        raise LearningError("a motion with path constraints can't be improved by trials")
    if not plan.motions:
        raise LearningError(f"there is no motion to improve: {plan.message}")
    if n_trials < MIN_TRIALS:
        raise LearningError(f"n_trials must be at least {MIN_TRIALS}, got {n_trials}")
    cmaes = require("cmaes", "learn", "learning by trials")
    problem = plan.motions, planner.robot, planner.limits, planner.collision
    period = planner.options.sample_period
    judge = ExecutableMotions(*problem, sample_period=period)
    planned = judge.accept(RefinedMotion(plan.motions))
    groups = [(planned, [_measured(run, planned) for _ in range(_N_REPEATS)])]
    try:
        refined: AcceptedMotion = refine(*problem, sample_period=period)
    except RobotError:  # the model has no inertias
        refined = planned
    best, known = groups[0]
    if refined.motion.parameters.any():
        groups.append((refined, [_measured(run, refined) for _ in range(_N_REPEATS)]))
        if not _is_beaten(groups[1][1], groups[0][1], groups):
            best, known = groups[1]
    n_search = n_trials - _N_REPEATS * (len(groups) + 1)
    free = np.ones(best.motion.parameters.shape, dtype=bool)
    free[:, LOG_DURATION] = len(plan.motions) > 1
    bounds = parameter_bounds(len(plan.motions))[free]
    box = np.column_stack([-bounds, bounds])
    search = cmaes.CMA(best.motion.parameters[free], _FIRST_STEP, bounds=box, seed=seed)
    cheapest, least = best, float(np.mean(known))
    generation = []
    for _ in range(n_search):
        parameters = np.zeros(free.shape)
        parameters[free] = search.ask()
        trial = _executable(judge, parameters, best)
        cost = _measured(run, trial)
        generation.append((np.clip(trial.motion.parameters[free], -bounds, bounds), cost))
        if cost < least:
            cheapest, least = trial, cost
        if len(generation) == search.population_size:
            search.tell(generation)
            generation = []
    groups.append((cheapest, [_measured(run, cheapest) for _ in range(_N_REPEATS)]))
    if _is_beaten(known, groups[-1][1], groups):
        best, known = groups[-1]
    planned_cost = float(np.mean(groups[0][1]))
    cost, noise = float(np.mean(known)), _noise(groups)
    return LearnedMotion(best.motion, best.trajectory, best.check, cost, planned_cost, noise)


_Groups = Sequence[tuple[AcceptedMotion, Sequence[float]]]
"""Motions, and repeated measurements of the cost of each."""


def _executable(
    judge: ExecutableMotions, parameters: np.ndarray, best: AcceptedMotion
) -> AcceptedMotion:
    """The proposed motion, moved towards the best one until it may be executed."""
    for _ in range(_MAX_HALVINGS):
        motion = RefinedMotion(judge.segments, parameters).lasting(best.motion.duration)
        try:
            return judge.accept(motion)
        except TrajectoryError:
            parameters = (parameters + best.motion.parameters) / 2.0
    return best


def _is_beaten(known: Sequence[float], costs: Sequence[float], groups: _Groups) -> bool:
    """Whether costs are lower than those of a known motion by more than noise."""
    error = _noise(groups) * np.sqrt(1.0 / len(known) + 1.0 / len(costs))
    return bool(np.mean(known) - np.mean(costs) > _BEYOND * error)


def _noise(groups: _Groups) -> float:
    """Standard deviation of one measurement, pooled over the motions."""
    return float(np.sqrt(np.mean([np.var(costs, ddof=1) for _, costs in groups])))


def _measured(run: Callable[[Trajectory], float], trial: AcceptedMotion) -> float:
    cost = float(run(trial.trajectory))
    if not np.isfinite(cost):
        raise LearningError(f"the cost of a trial must be a finite number, got {cost}")
    return cost
