# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Statuses and messages of plans: what was found, what was conceded, why goals are refused."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..exceptions import TrajectoryError
from ..motion.collision import NOT_CHECKED, CollisionModel
from ..motion.validation import check_executable
from ..robot.limits import JointLimits
from .attempt import Attempt
from .fallback import Fallback
from .objectives import Effort
from .plan import DEMONSTRATED, INFEASIBLE, SOLVED, STOPPED_EARLY, PlannerOptions
from .pose_search import POSE_TOLERANCE


@dataclass(frozen=True)
class StatedDuration:
    """A feasible duration to report [s], or NaN; the shortest if there was time to find it."""

    seconds: float = float("nan")
    is_shortest: bool = True


@dataclass(frozen=True, eq=False)
class Outcome:
    """What a planner found for a goal.

    Attributes
    ----------
    attempt : Attempt
        The best motion.
    fallback : Fallback
        What came of the search for a slow motion, if there was one.
    stated : StatedDuration
        The duration to report.
    ran_out : bool
        Whether time ran out before a motion within the limits was found by optimisation.
    """

    attempt: Attempt
    fallback: Fallback
    stated: StatedDuration
    ran_out: bool


class Judge:
    """Says of outcomes whether they may be executed, in a sentence.

    Parameters
    ----------
    limits, options, collision
        The planner's.
    """

    def __init__(
        self, limits: JointLimits, options: PlannerOptions, collision: CollisionModel | None
    ) -> None:
        self._limits, self._options, self._collision = limits, options, collision

    def verdict(self, outcome: Outcome, missed: float) -> tuple[str, str]:
        """Status and message.

        Parameters
        ----------
        outcome : Outcome
            What was found.
        missed : float
            Largest distance of the motion from what it must pass [rad or m].
        """
        attempt, options = outcome.attempt, self._options
        try:
            check_executable(
                attempt.trajectory,
                attempt.check,
                attempt.request.start,
                allow_nonzero_end_velocity=options.allow_nonzero_end_velocity,
            )
        except TrajectoryError as error:
            return INFEASIBLE, self._refusal(outcome, "within the limits", str(error))
        if attempt.collisions:
            met = str(attempt.collisions[0])
            return INFEASIBLE, self._refusal(outcome, "without self-collision", met)
        if missed > POSE_TOLERANCE:
            nearest = f"the nearest one is {missed:.3g} rad or m off"
            return INFEASIBLE, self._refusal(outcome, "that passes where it was asked to", nearest)
        concessions = self._concessions(attempt)
        if attempt is outcome.fallback.attempt:
            return STOPPED_EARLY, self._slow(outcome) + concessions
        if not attempt.solution.converged:
            found = "time or iterations ran out before the least was found"
            return STOPPED_EARLY, found + concessions
        if np.isfinite(outcome.stated.seconds):
            return SOLVED, "shortest motion within the limits found" + concessions
        effort_alone = [type(objective) for _, objective in options.objectives] == [Effort]
        least = "effort" if effort_alone else "cost"
        return SOLVED, f"motion of least {least} found{concessions}"

    def _search(self, outcome: Outcome, kind: str) -> str:
        """How the search for a kind of motion ended."""
        if outcome.ran_out:
            limit = f"max_solve_time = {self._options.max_solve_time:g} s"
            return f"time ran out ({limit}) before a motion {kind} was found"
        return f"no motion {kind} was found"

    def _slow(self, outcome: Outcome) -> str:
        """The message of a slow motion."""
        request = outcome.attempt.request
        brakes = np.any([request.start.velocities, request.start.accelerations])
        motion = "brakes, then follows" if brakes else "follows"
        rests = " with a rest at each via" if request.n_vias else ""
        return (
            f"{self._search(outcome, 'optimised within the limits')}; this one {motion} a "
            f"minimum-jerk path{rests}, keeps the limits and may be executed"
        )

    def _refusal(self, outcome: Outcome, kind: str, why: str) -> str:
        """The message of a motion that must not be executed."""
        attempt, stated = outcome.attempt, outcome.stated
        message = f"{self._search(outcome, kind)}: {why}"
        if not attempt.request.duration_is_free:
            message = self._impossible(attempt) or message
        if np.isfinite(stated.seconds):
            known = "a feasible duration"
            if stated.is_shortest:
                known = "the shortest duration that the limits allow"
            return f"{message}; {known} is {stated.seconds:.4g} s"
        if outcome.fallback.reason:
            return f"{message}; nor was a slow one found: {outcome.fallback.reason}"
        return message

    def _impossible(self, attempt: Attempt) -> str:
        """Why there is no motion in the duration asked for, empty if that is not known."""
        request, asked = attempt.request, attempt.request.expected.duration
        way = np.abs(request.goal.positions - request.start.positions)
        least = way / self._limits.velocity
        j = int(least.argmax())
        if request.pose is not None or not least[j] > asked:
            return ""
        return (
            f"no motion within the limits takes {asked:.4g} s: at its limit of velocity, "
            f"{self._limits.velocity[j]:.4g}, joint '{self._limits.joint_names[j]}' alone needs "
            f"{least[j]:.4g} s"
        )

    def _concessions(self, attempt: Attempt) -> str:
        """What had to be given up to do what was asked, as the end of a sentence."""
        options, collision = self._options, self._collision
        usual, duration = attempt.request.expected.duration, attempt.motion.duration
        given_up = []
        if duration > usual and options.timing == DEMONSTRATED:
            given_up.append(f"the duration was lengthened from {usual:.3g} to {duration:.3g} s")
        if attempt.naturalness > options.naturalness:
            given_up.append(
                f"the naturalness was raised from {options.naturalness:g} "
                f"to {attempt.naturalness:g}"
            )
        why = "to keep the limits"
        if collision is not None and collision.has_geometry:
            why += " without self-collision"
        kept = f"; {why}, {' and '.join(given_up)}" if given_up else ""
        if attempt.kept_apart:
            kept += "; links that would meet otherwise are kept apart"
        if collision is not None and not collision.has_geometry:
            kept += NOT_CHECKED
        if options.basis == "pca" and attempt.family.is_corrected:
            kept += (
                f"; beyond the components of the primitive it took B-splines, "
                f"{correction(attempt):.2g} rad or m in the mean"
            )
        return kept


def correction(attempt: Attempt) -> float:
    """Root of the mean square of what B-splines add to components [rad or m]."""
    family = attempt.family
    if not family.is_corrected:
        return 0.0
    only = np.where(np.arange(family.expected.size) < family.n_components, 0.0, 1.0)
    phases = np.linspace(0.0, 1.0, 101)
    added = family.basis.shape(only * attempt.motion.weights, phases)
    return float(np.sqrt(np.mean((added - family.basis.shape(0.0 * only, phases)) ** 2)))
