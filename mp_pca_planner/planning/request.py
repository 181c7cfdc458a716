# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Requests: resolved goals, with nothing left open.

Between two targets, a motion is a segment q(s) = h(s) + μ(s) + Σ wₖ φₖ(s) of one primitive. Shapes
vanish with two derivatives at both ends. Therefore segments are continuous in position, velocity
and acceleration for any weights if their boundary parts h are.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from operator import attrgetter

from ..arrays import set_frozen
from ..motion.goal import JointState, Pose
from ..primitives.in_span import UNUSUAL_IN_SPAN_SCORE
from ..primitives.prediction import ConditionalDistribution
from ..primitives.primitive import MovementPrimitive
from .options import AUTO, DEMONSTRATED, FREE, SHORTEST, PlannerOptions

NATURAL = 1.0
"""Naturalness ρ of motions like the demonstrations."""


@dataclass(frozen=True, eq=False)
class RequestSegment:
    """The motion to one target.

    Attributes
    ----------
    start, goal : JointState
        States of all joints; at a target that is passed, and of a pose, an initial value.
    pose : Pose or None
        The pose to reach, if the target is one.
    stops : bool
        Whether the motion rests at the target, or ends there.
    primitive : MovementPrimitive
        The primitive of the motion.
    expected : ConditionalDistribution
        Prediction from the demonstrations.
    duration : float
        Predicted duration [s], scaled to fixed times.
    """

    start: JointState
    goal: JointState
    pose: Pose | None
    stops: bool
    primitive: MovementPrimitive
    expected: ConditionalDistribution
    duration: float


@dataclass(frozen=True, eq=False)
class Request:
    """A resolved goal of n ≥ 1 segments; a single goal has one.

    Attributes
    ----------
    segments : tuple of RequestSegment
        The segments.
    groups : tuple
        The segments between fixed times, and whether the sum of their durations is fixed: for all
        groups except the segments after the last fixed time.
    mode : {'', 'optimal', 'real_time'}
        How the segments of a sequence are joined, with or without optimisation; empty for a single
        goal.
    naturalness : float
        ρ, see :func:`naturalness_for`.
    timing : {'demonstrated', 'shortest', 'free'}
        Timing of a free duration of a single goal.
    n_passed : int
        Initial targets of the goal that are left out, because the robot is there.
    start, goal : JointState
        States at the start and at the last target.
    pose : Pose or None
        The pose to reach, if the last target is one.
    duration : float
        The requested duration, or the predicted one [s].
    duration_is_free, is_shortest : bool
        Whether the duration of the whole is not specified, and whether the shortest is searched.
    """

    segments: tuple[RequestSegment, ...]
    groups: tuple[tuple[tuple[int, ...], bool], ...]
    mode: str = ""
    naturalness: float = NATURAL
    timing: str = DEMONSTRATED
    n_passed: int = 0
    start: JointState = field(init=False)
    goal: JointState = field(init=False)
    pose: Pose | None = field(init=False)
    duration: float = field(init=False)
    duration_is_free: bool = field(init=False)
    is_shortest: bool = field(init=False)

    @property
    def target_names(self) -> list[str]:
        """How messages name the targets of the segments."""
        n = self.n_passed + len(self.segments)
        return [*(f"target {i}" for i in range(self.n_passed + 1, n)), "the goal"]

    def __post_init__(self) -> None:
        first, last = self.segments[0], self.segments[-1]
        is_free = not self.groups[-1][1]
        set_frozen(
            self,
            start=first.start,
            goal=last.goal,
            pose=last.pose,
            duration=sum(map(attrgetter("duration"), self.segments)),
            duration_is_free=is_free,
            is_shortest=is_free and self.timing == SHORTEST,
        )


def naturalness_for(options: PlannerOptions, score: float) -> float:
    """Naturalness ρ: that of the options, else 1 up to a score of 3, (3 / score)³ above.

    The prediction holds for requests like the demonstrations. For others, its error grows with the
    in-span score, and cost counts more.

    Parameters
    ----------
    options : PlannerOptions
        The options.
    score : float
        In-span score of the request.
    """
    if options.naturalness is not None:
        return options.naturalness
    share = UNUSUAL_IN_SPAN_SCORE / max(score, UNUSUAL_IN_SPAN_SCORE)
    return float(NATURAL * share**3)


def timing_for(options: PlannerOptions, score: float, *, is_detour: bool = False) -> str:
    """Timing: that of the options, else 'free' for scores above 3 and detours, else predicted.

    Parameters
    ----------
    options : PlannerOptions
        The options.
    score : float
        In-span score of the request.
    is_detour : bool
        Whether the motion follows a collision-free path, because the predicted one collides.
    """
    if options.timing != AUTO:
        return options.timing
    return FREE if is_detour or score > UNUSUAL_IN_SPAN_SCORE else DEMONSTRATED
