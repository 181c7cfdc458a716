# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The verdict on a primitive: for which goals it is good, and where it is weak."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..primitives.cross_validation import HeldOutErrors
from ..primitives.differences import MEASURES
from ..primitives.in_span import in_span_score
from ..primitives.primitive import MovementPrimitive
from ..robot.model import Robot
from .text import METRES, Unit, primitive_unit, prismatic_joints, unit_of

_PATH = MEASURES.index("path")
Feature = tuple[FloatArray, Unit]
"""Values of a quantity at the goals of motions [rad or m], and its unit."""


# Error above which a left-out motion counts as weak, in medians of the errors.
_WEAK_ERROR = 2.0
# Share of the weak motions in a region, less that of the others, above which the region is named.
_SEPARATION = 0.5
# Number of demonstrations below which more are recommended.
_FEW = 10
# Number of goals sampled for the region in span, and how far beyond a demonstrated goal, as a
# share of its distance from another one.
_N_SAMPLED = 3000
_REACH = 0.5


@dataclass(frozen=True, eq=False)
class PrimitiveVerdict:
    """What a primitive is good for.

    Attributes
    ----------
    good, weak : list of str
        Sentences.
    is_weak : array of bool, shape (n_demonstrations,)
        Whether a motion was left out and predicted badly.
    """

    good: list[str]
    weak: list[str]
    is_weak: NDArray[np.bool_]


def verdict_on(
    primitive: MovementPrimitive,
    errors: HeldOutErrors | None,
    left_out: Sequence[int],
    robot: Robot | None = None,
) -> PrimitiveVerdict:
    """Judge a primitive by its errors on left-out demonstrations and by the ranges of its goals.

    Parameters
    ----------
    primitive : MovementPrimitive
        The primitive.
    errors : HeldOutErrors or None
        Errors of the motions that were left out, if any were.
    left_out : sequence of int
        Indices of these motions.
    robot : Robot, optional
        The robot of its joints, which gives goals a place in space.
    """
    is_weak = np.zeros(len(primitive.durations), dtype=bool)
    good, weak = [], []
    features = _features(primitive, robot)
    if errors is not None:
        path, unit = errors.expected[:, _PATH], primitive_unit(primitive)
        limit = _WEAK_ERROR * float(np.median(path))
        is_weak[list(left_out)] = path > limit
        straight, _, expected = errors.rms()[:, _PATH]
        text = (
            f"left-out motions are predicted to {unit.number(expected)} {unit.name} RMS in path "
            "(timing left aside)"
        )
        if expected < straight:
            good.append(f"{text}, {1.0 - expected / straight:.0%} nearer than by minimum-jerk")
        else:
            weak.append(
                f"{text}, no nearer than by minimum-jerk: their end points say little about them"
            )
        if is_weak.any():
            tested = {name: (values[left_out], of) for name, (values, of) in features.items()}
            shown = f"{unit.number(limit)} {unit.name}"
            weak.append(_weak_goals(tested, is_weak[left_out], shown))
    ranges = [
        f"{name} {unit.text(values[~is_weak].min())} to {unit.text(values[~is_weak].max())}"
        f" {unit.name}"
        for name, (values, unit) in features.items()
    ]
    good.append("goals in the demonstrated ranges: " + ", ".join(ranges))
    weak.append("goals outside: the in-span score of a plan says how far (above 3: unlike)")
    if is_weak.size < _FEW:
        weak.append(f"there are only {is_weak.size} demonstrations: record ten to thirty")
    return PrimitiveVerdict(good, weak, is_weak)


def goals_in_span(primitive: MovementPrimitive) -> FloatArray:
    """Goals as like the demonstrations as the demonstrations are, shape (n_goals, n_joints).

    They are drawn along lines through two demonstrated goals. Each, with the start of the nearer
    one, has an in-span score of at most the largest of the demonstrations.
    """
    rng = np.random.default_rng(0)
    model, ends = primitive.model, primitive.boundary_states[:, [0, 3]]
    own = ends.reshape(len(ends), -1)
    i, j = rng.integers(len(ends), size=(2, _N_SAMPLED))
    reach = rng.uniform(-_REACH, 0.5, size=(_N_SAMPLED, 1))
    goals = ends[i, 1] + reach * (ends[j, 1] - ends[i, 1])

    def score(request: FloatArray) -> float:
        return in_span_score(request, model.mean, model.request_precision)

    largest = max(map(score, own))
    requests = np.concatenate([ends[i, 0], goals], axis=1)
    return np.array([goals[k] for k, request in enumerate(requests) if score(request) <= largest])


def _features(primitive: MovementPrimitive, robot: Robot | None) -> dict[str, Feature]:
    """The joints at the goals of the demonstrations, and the place of the robot's end effector."""
    goals, prismatic = primitive.boundary_states[:, 3], prismatic_joints(primitive)
    features = {
        name: (values, unit_of([name], prismatic))
        for name, values in zip(primitive.joint_names, goals.T, strict=True)
    }
    if robot is not None:
        tip = robot.end_effector
        place = robot.frame_positions(goals, [tip])[:, 0]
        features |= {f"{tip} {axis}": (x, METRES) for axis, x in zip("xyz", place.T, strict=True)}
    return features


def _weak_goals(features: Mapping[str, Feature], is_weak: NDArray[np.bool_], limit: str) -> str:
    """Where the goals of weak motions are: on one side of a value of one feature, or anywhere."""
    n_weak, n = int(is_weak.sum()), is_weak.size
    best, found = _SEPARATION, ""
    for name, (values, unit) in features.items():
        known = np.unique(values)
        for cut in 0.5 * (known[1:] + known[:-1]):
            for word, inside in (("above", values > cut), ("below", values < cut)):
                n_inside, n_there = int(inside.sum()), int((inside & is_weak).sum())
                share = n_there / n_weak - (n_inside - n_there) / max(n - n_weak, 1)
                if share > best:
                    best = share
                    found = (
                        f"goals with {name} {word} {unit.text(cut)} {unit.name}: {n_there} of "
                        f"{n_inside} motions there are off by over {limit} (twice the median), "
                        f"{n_weak - n_there} of {n - n_inside} elsewhere"
                    )
    nowhere = f"{n_weak} of {n} motions, in no region of their own, are off by over {limit}"
    return found or f"{nowhere} (twice the median)"
