# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Statuses and messages of plans: results, concessions, and reasons of rejection."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from ..arrays import FloatArray
from ..exceptions import TrajectoryError
from ..motion.collision import NOT_CHECKED, Collision
from ..motion.goal import JointState
from ..motion.trajectory import Trajectory
from ..motion.validation import check_executable
from .attempt import Attempt
from .bases import MotionBasis
from .conditions import JointTarget
from .fallback import Fallback
from .motion import Motion
from .objectives import Effort
from .plan import (
    DEMONSTRATED,
    INFEASIBLE,
    REAL_TIME,
    SOLVED,
    STOPPED_EARLY,
)
from .pose_search import POSE_TOLERANCE
from .request import Request
from .sequence_request import SequenceRequest
from .setup import Setup
from .stop_and_go import brakes

# Points of a detour at which clearances are computed, and the largest that is reported [m].
_N_CHECKED, _NEAR = 50, 0.05
# Time before and after a collision in which it may begin or end, where it is known roughly [s].
_AROUND = 0.05
# Share of the planning time up to which there is time for the precise search.
_SHARE_OF_SOLVING = 0.5


@dataclass(frozen=True)
class StatedDuration:
    """A feasible duration to report [s], or NaN; the shortest if there was time to find it."""

    seconds: float = float("nan")
    is_shortest: bool = True


@dataclass(frozen=True, eq=False)
class Planned:
    """The outcome of planning for a goal, before its status is determined.

    Attributes
    ----------
    attempt : Attempt
        The best motion.
    fallback : Fallback
        Result of the search for a slow motion, if there was one.
    ran_out : bool
        Whether time ran out before a motion within the limits was found by optimisation.
    stated : StatedDuration
        The duration to report.
    mode : str
        Mode of joining segments, see :class:`.Plan`.
    improved : Attempt or None
        An optimal motion through several targets that must not be executed.
    hint : str
        What would help the search; empty if nothing is known.
    """

    attempt: Attempt
    fallback: Fallback
    ran_out: bool
    stated: StatedDuration = field(default_factory=StatedDuration)
    mode: str = ""
    improved: Attempt | None = None
    hint: str = ""


class Judge:
    """Determines the status and the message of outcomes.

    Parameters
    ----------
    setup : Setup
        Robot, limits and options of the planner.
    """

    def __init__(self, setup: Setup) -> None:
        self._setup = setup

    def verdict(self, outcome: Planned, missed: float, solve_time: float) -> tuple[str, str]:
        """Status and message.

        Parameters
        ----------
        outcome : Planned
            The outcome.
        missed : float
            Largest distance of the motion from its goal and vias [rad or m].
        solve_time : float
            Time taken until then [s].
        """
        attempt, options = outcome.attempt, self._setup.options
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
            kind = f"without {self._collision_kind}"
            deepest = attempt.collisions[0]
            if solve_time < _SHARE_OF_SOLVING * options.max_solve_time:
                deepest = self._precise(deepest, attempt.trajectory)
            return INFEASIBLE, self._refusal(outcome, kind, str(deepest))
        if met := self._met_beyond(attempt.trajectory):
            return INFEASIBLE, self._refusal(outcome, f"without {self._collision_kind}", met)
        if missed > POSE_TOLERANCE:
            nearest = f"the nearest one is {missed:.3g} rad or m off"
            return INFEASIBLE, self._refusal(outcome, "that passes where it was asked to", nearest)
        concessions = self._concessions(attempt)
        if attempt is outcome.fallback.attempt:
            return STOPPED_EARLY, self._slow(outcome) + concessions
        if outcome.mode == REAL_TIME:
            status, note = self._joined(outcome)
            return status, note + concessions
        if not attempt.solution.converged:
            found = "time or iterations ran out before the least was found"
            return STOPPED_EARLY, found + concessions
        if np.isfinite(outcome.stated.seconds):
            return SOLVED, "shortest motion within the limits found" + concessions
        effort_alone = [type(objective) for _, objective in options.objectives] == [Effort]
        least = "effort" if effort_alone else "cost"
        return SOLVED, f"motion of least {least} found{concessions}"

    @property
    def _collision_kind(self) -> str:
        collision = self._setup.collision
        return "collision" if collision is not None and len(collision.world) else "self-collision"

    def _met_beyond(self, trajectory: Trajectory) -> str:
        """Text on the collision of all stops beyond a goal in motion; empty if one is clear."""
        q, v, a = (values[-1] for values in trajectory.states)
        if self._setup.collision is None or not v.any():
            return ""
        met, end = "", JointState(trajectory.joint_names, q, v, a)
        request = self._setup.robot, self._setup.limits, end, self._setup.options.sample_period
        for stop, check in brakes(*request):
            if check.violations:
                continue
            found = self._setup.collisions(stop)
            if not found:
                return ""
            met = met or f"the goal is passed at a velocity, and in the stop after it {found[0]}"
        return met

    def _search(self, outcome: Planned, kind: str) -> str:
        """Text on the end of the search for a kind of motion."""
        if outcome.ran_out:
            limit = f"max_solve_time = {self._setup.options.max_solve_time:g} s"
            return f"time ran out ({limit}) before a motion {kind} was found"
        return f"no motion {kind} was found"

    def _joined(self, outcome: Planned) -> tuple[str, str]:
        """Status and message of a motion that was joined without optimisation."""
        note, improved = "motion concatenated in real time", outcome.improved
        if improved is None:
            return SOLVED, note
        if improved.collisions:
            return SOLVED, f"{note}, for in the optimal one {improved.collisions[0]}"
        if improved.solution.converged:
            return SOLVED, f"{note}, for no cheaper one within the limits was found"
        return STOPPED_EARLY, (
            f"{note}, for time or iterations ran out before a cheaper one within the limits was "
            "found"
        )

    def _slow(self, outcome: Planned) -> str:
        """The message of a slow motion."""
        request, n_corners = outcome.attempt.request, outcome.fallback.n_corners
        around = f" around obstacles with {n_corners} stops" if n_corners else ""
        if outcome.mode:
            return (
                f"{self._search(outcome, 'without stops within the limits')}; this one rests at "
                f"each target{around}, keeps the limits and may be executed"
            )
        brakes = np.any([request.start.velocities, request.start.accelerations])
        motion = "brakes, then follows" if brakes else "follows"
        rests = around or (" with a rest at each via" if request.n_vias else "")
        return (
            f"{self._search(outcome, 'optimised within the limits')}; this one {motion} a "
            f"minimum-jerk path{rests}, keeps the limits and may be executed"
        )

    def _refusal(self, outcome: Planned, kind: str, why: str) -> str:
        """The message of a motion that must not be executed."""
        attempt, stated = outcome.attempt, outcome.stated
        if cause := self._end_in_collision(attempt.request):
            return cause
        message = f"{self._search(outcome, kind)}: {why}"
        if isinstance(attempt.request, Request) and not attempt.request.duration_is_free:
            message = self._impossible(attempt) or message
        if np.isfinite(stated.seconds):
            known = "a feasible duration"
            if stated.is_shortest:
                known = "the shortest duration that the limits allow"
            return f"{message}; {known} is {stated.seconds:.4g} s"
        reason = outcome.fallback.reason
        if reason:
            message = f"{message}; nor was a slow one found: {reason}"
        is_blocked = bool(attempt.collisions) or "collide" in reason
        return f"{message}; {outcome.hint}" if is_blocked and outcome.hint else message

    def _end_in_collision(self, request: Request | SequenceRequest) -> str:
        """Text on the first configuration of a request that is in collision; empty if none is."""
        names, zero = self._setup.robot.joint_names, np.zeros((1, self._setup.robot.n_joints))
        for name, q in _fixed_configurations(request):
            found = self._setup.collisions(Trajectory(names, [0.0], [q], zero, zero))
            if found:
                return f"{name} is in collision: {found[0].bodies} {found[0].place}"
        return ""

    def _precise(self, rough: Collision, points: Trajectory) -> Collision:
        """The deepest collision of a motion about the time of one that is known roughly.

        Only this part of the motion is searched again, because that takes longer than planning.
        """
        first = int(np.searchsorted(points.times, rough.first_time - _AROUND))
        last = int(np.searchsorted(points.times, rough.last_time + _AROUND))
        began, part = points.times[first], slice(first, last + 1)
        states = (x[part] for x in points.states)
        section = Trajectory(points.joint_names, points.times[part] - began, *states)
        found = self._setup.collisions(section, precisely=True)
        return found[0].within(-began, np.inf) or rough if found else rough

    def _impossible(self, attempt: Attempt) -> str:
        """The reason why the requested duration has no motion; empty if unknown."""
        request, asked = attempt.request, attempt.request.usual_duration
        displacement = np.abs(request.goal.positions - request.start.positions)
        limits = self._setup.limits
        least = displacement / limits.velocity
        j = int(least.argmax())
        if request.pose is not None or not least[j] > asked:
            return ""
        return (
            f"no motion within the limits takes {asked:.4g} s: at its limit of velocity, "
            f"{limits.velocity[j]:.4g}, joint '{limits.joint_names[j]}' alone needs "
            f"{least[j]:.4g} s"
        )

    def _detour(self, attempt: Attempt) -> str:
        """Text on a detour: the bodies that come nearest to each other."""
        text = "; near a collision-free path, because the expected motion collides"
        if self._setup.collision is None:
            return text
        positions = attempt.trajectory.positions
        chosen = np.linspace(0, len(positions) - 1, min(_N_CHECKED, len(positions))).astype(int)
        near = self._setup.collision.near(positions[chosen], _NEAR)
        if not near.distances.size:
            return f"{text}; bodies stay {1e3 * _NEAR:g} mm apart"
        k = int(near.distances.argmin())
        names = "' and '".join(self._setup.collision.pairs[near.pairs[k]])
        return f"{text}; the least clearance is {1e3 * near.distances[k]:.1f} mm, of '{names}'"

    def _concessions(self, attempt: Attempt) -> str:
        """The concessions that were made for the goal, as the end of a sentence."""
        options, collision = self._setup.options, self._setup.collision
        usual, duration = attempt.request.usual_duration, attempt.duration
        given_up = []
        if duration > usual * (1.0 + 1e-9) and options.timing == DEMONSTRATED:
            given_up.append(f"the duration was lengthened from {usual:.3g} to {duration:.3g} s")
        is_detour = any(basis.is_detour for basis in attempt.bases)
        if attempt.naturalness > options.naturalness and not is_detour:
            given_up.append(
                f"the naturalness was raised from {options.naturalness:g} "
                f"to {attempt.naturalness:g}"
            )
        why = "to keep the limits"
        if collision is not None and collision.has_geometry:
            why += f" without {self._collision_kind}"
        kept = f"; {why}, {' and '.join(given_up)}" if given_up else ""
        if is_detour:
            kept += self._detour(attempt)
        elif attempt.has_clearances:
            kept += "; bodies that would collide otherwise are kept apart"
        if collision is not None and not collision.has_geometry:
            kept += NOT_CHECKED
        added = max(map(correction, attempt.bases, attempt.motions))
        if options.basis == "pca" and any(basis.is_corrected for basis in attempt.bases):
            kept += (
                "; beyond the components of the primitive it took B-splines, "
                f"{added:.2g} rad or m in the mean"
            )
        return kept


def _fixed_configurations(
    request: Request | SequenceRequest,
) -> Iterator[tuple[str, FloatArray]]:
    """The configurations that a request gives for all joints, with their names."""
    yield "the start", request.start.positions
    if request.pose is None:
        yield "the goal", request.goal.positions
    kind = "via" if isinstance(request, Request) else "target"
    for number, condition in enumerate(request.conditions[: request.n_vias], start=1):
        target = condition.target
        if isinstance(target, JointTarget) and target.index.size == target.n_joints:
            yield f"{kind} {number}", target.positions[target.index.argsort()]


def correction(basis: MotionBasis, motion: Motion) -> float:
    """RMS of the correction that B-splines add to components [rad or m]."""
    if not basis.is_corrected:
        return 0.0
    only = np.where(np.arange(basis.expected.size) < basis.n_components, 0.0, 1.0)
    phases = np.linspace(0.0, 1.0, 101)
    added = basis.basis.shape(only * motion.weights, phases)
    return float(np.sqrt(np.mean((added - basis.basis.shape(0.0 * only, phases)) ** 2)))
