# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Learning by trials: scaling and warping improved by the measured cost of executed motions.

CMA-ES (Hansen and Ostermeier, Evolutionary Computation 9(2), 2001; the package `cmaes`)
proposes the parameters of a :class:`.RefinedMotion`; a trial is one of them that the
validator accepted, executed and measured. One file keeps all trials; after a crash, learning
resumes from it with the same results.

Measured costs are noisy, and the least of many is too low. So the original motion and the best
candidate are repeated after each generation. A candidate is judged by its repetitions, without the
measurement that it was chosen for.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import FloatArray, frozen_array
from ..exceptions import LearningError, TrajectoryError, require
from ..files import check_form, read_text, reading, write_whole
from ..motion.collision import CollisionModel
from ..planning.motion import Motion
from ..robot.limits import JointLimits
from ..robot.model import Robot
from .refined_motion import LOG_DURATION, N_PARAMETERS, RefinedMotion
from .refinement import AcceptedMotion, ExecutableMotions, RefinementOptions, parameter_bounds

_FORMAT = "mp_pca_planner/trials"
_VERSION = 1
_FORM = {"motion": str, "trials": [{"parameters": [float], "cost": float, "repeat?": bool}]}
# Repetitions before the search and after each generation; every third is of the original motion,
# the others are of the best candidate.
_N_REPEATED = 6
# A gain counts from this many standard errors on. With 1, chance makes one gain of six.
_MIN_ERRORS = 2.0
# Standard deviation of the parameters of the first trials.
_FIRST_STEP = 0.2
# A proposed trial that violates limits is moved half-way to the best motion at most this often;
# then the best motion itself is proposed.
_MAX_HALVINGS = 8


@dataclass(frozen=True)
class Trial:
    """One executed motion.

    Attributes
    ----------
    parameters : tuple of float
        Those of the :class:`.RefinedMotion` that was executed, segment by segment.
    cost : float
        Its measured cost.
    repeat : bool
        Whether it repeats an earlier one to measure the noise.
    """

    parameters: tuple[float, ...]
    cost: float
    repeat: bool = False


@dataclass(frozen=True)
class Gain:
    """What trials say of the best motion in comparison with the original.

    Attributes
    ----------
    parameters : tuple of float
        The best motion, see :class:`Trial`.
    original_cost, cost : float
        Mean costs of the original, and of the repetitions of the best motion.
    error : float
        Standard error of their difference, from the scatter of all repetitions. It is widened as
        Student's t distribution is, because few repetitions say little about their scatter.
    """

    parameters: tuple[float, ...]
    original_cost: float
    cost: float
    error: float

    @property
    def share(self) -> float:
        """Share by which the cost is lower."""
        return 1.0 - self.cost / self.original_cost if self.original_cost > 0.0 else 0.0

    @property
    def share_error(self) -> float:
        """The standard error as a share of the original cost."""
        return self.error / self.original_cost if self.original_cost > 0.0 else 0.0

    @property
    def is_certain(self) -> bool:
        """Whether the best motion costs less beyond the noise."""
        return self.original_cost - self.cost > _MIN_ERRORS * self.error


class TrialLearner:
    """Proposes motions and learns from their costs.

    Parameters
    ----------
    segments : sequence of Motion
        The motion to improve.
    robot : Robot
        The model, for the limits of effort.
    limits : JointLimits
        Limits that every trial keeps.
    options : RefinementOptions, optional
        Bounds, seed and price of time; without the latter the total duration is kept.
    start : array, shape (n_segments, N_PARAMETERS), optional
        Parameters around which to search, those of an off-line refinement for example. The
        first trial is the unchanged motion, the second one these.
    state : Path, optional
        File that keeps the trials; those in it are not repeated.
    request : mapping, optional
        The request that the motion serves, of JSON types: kept for :func:`read_request`.
    collision : CollisionModel, optional
        Collision model of the same robot; no trial has a collision.

    Raises
    ------
    LearningError
        If the state can't be read, or belongs to another motion.
    MissingDependencyError
        If `cmaes` is not installed.
    TrajectoryError
        If the motion to start from is not executable.
    """

    def __init__(
        self,
        segments: Sequence[Motion],
        robot: Robot,
        limits: JointLimits,
        options: RefinementOptions | None = None,
        *,
        start: FloatArray | None = None,
        state: Path | None = None,
        request: Mapping[str, Any] | None = None,
        collision: CollisionModel | None = None,
    ) -> None:
        options = options or RefinementOptions()
        original, first = RefinedMotion(segments), RefinedMotion(segments, start)
        self._segments = original.segments
        self._judge = ExecutableMotions(segments, robot, limits, options, collision)
        # Trials before the search begins.
        self._first = [self._judge.accept(original)]
        if np.any(first.parameters):
            self._first.append(self._judge.accept(first))
        self._keeps_duration = options.time_price is None
        self._free = np.ones(first.parameters.shape, dtype=bool)
        if self._keeps_duration and len(segments) == 1:
            self._free[:, LOG_DURATION] = False
        self._centre = first.parameters
        self._duration = first.duration
        bounds = parameter_bounds(len(segments))[self._free]
        self._search = _search(first.parameters[self._free], bounds, options.seed)
        self._proposal: AcceptedMotion | None = None
        self._generation: list[tuple[FloatArray, float]] = []
        self._trials: list[Trial] = []
        self._state, self._request = state, request
        self._identity = _identity(first, options)
        if state is not None and state.exists():
            for trial in _read(state, self._identity, parameter_bounds(len(segments))):
                if not trial.repeat and self._n_searched >= len(self._first):
                    self._search.ask()  # advances the random numbers as this trial did
                self._learn(trial)

    @property
    def trials(self) -> tuple[Trial, ...]:
        """All trials so far."""
        return tuple(self._trials)

    @property
    def best(self) -> Trial | None:
        """The best candidate with its mean cost; before it is repeated, the trial of least cost."""
        gain = self.gain()
        if gain is not None:
            return Trial(gain.parameters, gain.cost)
        return min(self._trials, key=lambda trial: trial.cost, default=None)

    def gain(self) -> Gain | None:
        """The gain of the best candidate; None until the original and a candidate are repeated."""
        costs = self._costs()
        repeated = {x: c[1:] for x, c in list(costs.items())[1:] if len(c) > 1}
        original = next(iter(costs.values()), [])
        if len(original) < 2 or not repeated:
            return None
        noise, freedom = _noise(list(costs.values()))
        widened = noise * np.sqrt(max(freedom, 3) / (max(freedom, 3) - 2.0))
        mean, n = float(np.mean(original)), len(original)
        gains = [
            Gain(x, mean, float(np.mean(c)), float(widened * np.sqrt(1.0 / n + 1.0 / len(c))))
            for x, c in repeated.items()
        ]
        return min(gains, key=lambda one: one.cost + one.error)

    def best_motion(self) -> AcceptedMotion:
        """The motion of the best candidate; before any, the one to search around."""
        return self._judge.accept(RefinedMotion(self._segments, self._best_parameters()))

    def propose(self) -> AcceptedMotion:
        """The motion to try next, within all limits; the same one until its cost is reported."""
        if self._proposal is None:
            repeated, n = self._to_repeat(), self._n_searched
            if repeated is not None:
                motion = RefinedMotion(self._segments, np.reshape(repeated, self._centre.shape))
                self._proposal = self._judge.accept(motion)
            elif n < len(self._first):
                self._proposal = self._first[n]
            else:
                self._proposal = self._repaired(self._search.ask())
        return self._proposal

    @property
    def _n_searched(self) -> int:
        """Number of trials that are no repetitions."""
        return sum(not trial.repeat for trial in self._trials)

    def _costs(self) -> dict[tuple[float, ...], list[float]]:
        """Costs of each motion, in order; the original motion is the first."""
        costs: dict[tuple[float, ...], list[float]] = {}
        for trial in self._trials:
            costs.setdefault(trial.parameters, []).append(trial.cost)
        return costs

    def _to_repeat(self) -> tuple[float, ...] | None:
        """The motion to repeat next; None if none is due.

        Of the candidates, the one that may be best: with the least mean minus its standard error.
        """
        n_searched = self._n_searched - len(self._first)
        if n_searched < 0:
            return None
        n_rounds = 1 + n_searched // self._search.population_size
        n_repeated = len(self._trials) - self._n_searched
        if n_repeated >= n_rounds * _N_REPEATED:
            return None
        costs = self._costs()
        original, *others = costs
        if n_repeated % 3 == 0 or not others:
            return original
        noise, _ = _noise(list(costs.values()))
        return min(others, key=lambda x: float(np.mean(costs[x])) - noise / np.sqrt(len(costs[x])))

    def record(self, cost: float, executed: FloatArray | None = None, *, keep: bool = True) -> None:
        """Report the cost of the proposed motion.

        Parameters
        ----------
        cost : float
            The cost.
        executed : array, shape (n_segments, N_PARAMETERS), optional
            The parameters of the motion that was executed, if not those of the proposed one.
        keep : bool
            Whether to write the file now; otherwise :meth:`keep_trials` writes it.

        Raises
        ------
        LearningError
            If the cost is no finite number.
        PlannerError
            If the file can't be written. In both cases the learner is unchanged.
        """
        if not np.isfinite(cost):
            raise LearningError(f"the cost of a trial must be a finite number, got {cost}")
        tried = self.propose().motion.parameters if executed is None else executed
        is_repeat = self._to_repeat() is not None
        trial = Trial(tuple(tried.ravel().tolist()), float(cost), is_repeat)
        if keep:
            self.keep_trials(trial)
        self._learn(trial)

    def keep_trials(self, *more: Trial) -> None:
        """Write the file of trials, if there is one, with some more of them.

        Raises
        ------
        PlannerError
            If it can't be written.
        """
        if self._state is None:
            return
        content = {
            "format": _FORMAT,
            "version": _VERSION,
            "motion": self._identity,
            "request": self._request,
            "trials": [asdict(trial) for trial in (*self._trials, *more)],
        }
        write_whole(self._state, json.dumps(content, indent=1).encode(), overwrite=True)

    def _learn(self, trial: Trial) -> None:
        if not trial.repeat and self._n_searched >= len(self._first):
            free = np.reshape(trial.parameters, self._free.shape)[self._free]
            self._generation.append((free, trial.cost))
        self._trials.append(trial)
        self._proposal = None
        if len(self._generation) == self._search.population_size:
            self._search.tell(self._generation)
            self._generation = []

    def _best_parameters(self) -> FloatArray:
        best = self.best
        return self._centre if best is None else np.reshape(best.parameters, self._centre.shape)

    def _repaired(self, proposed: FloatArray) -> AcceptedMotion:
        parameters = self._centre.copy()
        parameters[self._free] = proposed
        best = self._best_parameters()
        for _ in range(_MAX_HALVINGS):
            motion = RefinedMotion(self._segments, parameters)
            if self._keeps_duration:
                motion = motion.lasting(self._duration)
            try:
                return self._judge.accept(motion)
            except TrajectoryError:
                parameters = (parameters + best) / 2.0
        try:
            return self._judge.accept(RefinedMotion(self._segments, best))
        except TrajectoryError:
            # The best motion was executed from another start.
            return self._first[0]


def _noise(costs: Sequence[Sequence[float]]) -> tuple[float, int]:
    """Standard deviation of repeated costs about their means, and its degrees of freedom."""
    squares = sum(float(np.sum((np.array(x) - np.mean(x)) ** 2)) for x in costs)
    freedom = sum(len(x) - 1 for x in costs)
    return float(np.sqrt(squares / max(freedom, 1))), freedom


def _search(centre: FloatArray, bounds: FloatArray, seed: int) -> Any:
    box = np.column_stack([-bounds, bounds])
    # A refinement that ends at a bound may lie beyond it by a rounding error.
    return require("cmaes", "learn", "learning by trials").CMA(
        mean=np.clip(centre, -bounds, bounds),
        sigma=_FIRST_STEP,
        bounds=box,
        seed=seed,
    )


def _identity(first: RefinedMotion, options: RefinementOptions) -> str:
    """A digest of the motion and the options, which a file of trials must match."""
    times = np.linspace(0.0, first.duration, 11)
    facts = [options.seed, options.time_price, first.duration, first.parameters.ravel().tolist()]
    # Nine digits: processors round differently.
    path = [f"{x:.9e}" for x in np.ravel(first.evaluate(times))]
    return hashlib.sha256(json.dumps([facts, path]).encode()).hexdigest()


def read_request(path: Path) -> Any:
    """The request that the motion of the trials in a file serves; None if the file has none.

    Raises
    ------
    LearningError
        If the file can't be read.
    """
    return _content(path).get("request")


def _content(path: Path) -> dict[str, Any]:
    with reading(f"the trials in '{path}'", LearningError):
        content = json.loads(read_text(path))
        check_form(content, {"format": str, "version": int}, "the file")
        if content["format"] != _FORMAT or content["version"] != _VERSION:
            raise LearningError(f"'{path}' is not a file of trials of this release")
        check_form(content, _FORM, "the file")
        return dict(content)


def _read(path: Path, identity: str, bounds: FloatArray) -> list[Trial]:
    content = _content(path)
    if content["motion"] != identity:
        raise LearningError(
            f"the trials in '{path}' are of another motion, or with other options: "
            "remove it, name another file, or repeat the request that it was made for"
        )
    trials = [
        Trial(tuple(x["parameters"]), x["cost"], x.get("repeat", False)) for x in content["trials"]
    ]
    # Keeping the total duration shifts a logarithm of a duration by twice its bound at most.
    largest = (bounds * np.where(np.arange(N_PARAMETERS) == LOG_DURATION, 3.0, 1.0)).ravel()
    for trial in trials:
        what = f"parameters of the trials in '{path}'"
        values = frozen_array(trial.parameters, largest.shape, what, LearningError)
        frozen_array(trial.cost, (), f"a cost of the trials in '{path}'", LearningError)
        excess = np.abs(values) / largest
        if excess.max() > 1.0 + 1e-6:  # of rounding
            worst = int(excess.argmax())
            raise LearningError(
                f"{what} must be within ±{largest[worst]:g} at index {worst}, got "
                f"{values[worst]:g}: the file was changed, remove it"
            )
    return trials
