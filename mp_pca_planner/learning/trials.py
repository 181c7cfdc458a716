# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Learning by trials: scaling and warping improved by the measured cost of executed motions.

CMA-ES (Hansen and Ostermeier, Evolutionary Computation 9(2), 2001; the package `cmaes`)
proposes the parameters of a :class:`.RefinedMotion`.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..exceptions import LearningError, TrajectoryError, require
from ..motion.trajectory import Trajectory
from ..planning.plan import Plan
from .refined_motion import LOG_DURATION, RefinedMotion
from .refinement import AcceptedMotion, ExecutableMotions, RefinementOptions, parameter_bounds

# Standard deviation of the parameters of the first trials.
_FIRST_STEP = 0.2
# A proposed trial that violates limits is moved half-way to the best motion at most this often.
_MAX_HALVINGS = 8


def improve_by_trials(
    plan: Plan, run: Callable[[Trajectory], float], n_trials: int = 60, seed: int = 0
) -> AcceptedMotion:
    """Improve a planned motion by the measured costs of variations with the same duration.

    Parameters
    ----------
    plan : Plan
        The motion to improve, of :meth:`.Planner.plan`.
    run : callable
        Executes a trajectory, which was checked as plans are, and returns its measured cost.
    n_trials : int
        Number of trials; the first one is the planned motion.
    seed : int
        The same seed and costs give the same trials.

    Returns
    -------
    motion : AcceptedMotion
        The trial of least cost. The least of many noisy costs is too low: repeat it to know.

    Raises
    ------
    LearningError
        If no planner made the plan, it has constraints, or a cost is not finite.
    MissingDependencyError
        If `cmaes` is not installed.
    TrajectoryError
        If the plan is not executable.
    """
    planner = plan.planner
    if planner is None or planner.options.constraints:
        why = "a plan without constraints, made by Planner.plan, is expected"
        raise LearningError(f"the plan can't be improved by trials: {why}")
    if n_trials < 1:
        raise LearningError(f"n_trials must be ≥ 1, got {n_trials}")
    cmaes = require("cmaes", "learn", "learning by trials")
    options = RefinementOptions(sample_period=planner.options.sample_period)
    judge = ExecutableMotions(
        plan.motions, planner.robot, planner.limits, options, planner.collision
    )
    original = RefinedMotion(plan.motions)
    best = judge.accept(original)
    least = _measured(run, best)
    free = np.ones(original.parameters.shape, dtype=bool)
    free[:, LOG_DURATION] = len(plan.motions) > 1
    bounds = parameter_bounds(len(plan.motions))[free]
    box = np.column_stack([-bounds, bounds])
    search = cmaes.CMA(mean=np.zeros(bounds.size), sigma=_FIRST_STEP, bounds=box, seed=seed)
    generation = []
    for _ in range(n_trials - 1):
        parameters = np.zeros(free.shape)
        parameters[free] = search.ask()
        trial = best
        for _ in range(_MAX_HALVINGS):
            motion = RefinedMotion(plan.motions, parameters).lasting(original.duration)
            try:
                trial = judge.accept(motion)
                break
            except TrajectoryError:
                parameters = (parameters + best.motion.parameters) / 2.0
        cost = _measured(run, trial)
        generation.append((np.clip(trial.motion.parameters[free], -bounds, bounds), cost))
        if cost < least:
            best, least = trial, cost
        if len(generation) == search.population_size:
            search.tell(generation)
            generation = []
    return best


def _measured(run: Callable[[Trajectory], float], trial: AcceptedMotion) -> float:
    cost = float(run(trial.trajectory))
    if not np.isfinite(cost):
        raise LearningError(f"the cost of a trial must be a finite number, got {cost}")
    return cost
