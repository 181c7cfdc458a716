# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The case study of [P], Section 4: arm motions, their components, and a planned motion."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from ..exceptions import PrimitiveError
from ..primitives.pca import PrincipalComponents
from ..recordings.demonstration import Demonstration
from ..robot.model import Robot
from .naturalness import BSPLINES, DEFAULT_RHO, Comparison, Prediction, compare, planned
from .paper import PAPER_OPTIONS, angle_components, free_bsplines, paper_method

PAPER = "components as in the paper"
FREE_BSPLINES = "B-splines, free end velocities"
OURS = planned(DEFAULT_RHO)
TABLE_3_METHODS = (BSPLINES, FREE_BSPLINES, PAPER, planned(0.0), OURS)
FREE_ENDS = (FREE_BSPLINES, PAPER)
"""Methods that leave velocities and accelerations at the ends free; others end at rest."""


@dataclass(frozen=True, eq=False)
class Raising:
    """One motion planned by several methods.

    Attributes
    ----------
    motion : Demonstration
        The person's motion.
    predictions : dict of str to Prediction
        By method.
    """

    motion: Demonstration
    predictions: dict[str, Prediction]


@dataclass(frozen=True, eq=False)
class CaseStudy:
    """Results of the case study.

    Attributes
    ----------
    motions : tuple of Demonstration
        The motions chosen.
    components : tuple of PrincipalComponents
        Of the joint angles, joint by joint: [P] Table 2 and Fig. 2.
    shares_by_activity : dict of str to array, shape (n_joints, 4)
        Shares of the variance for all motions of each activity.
    raising : Raising
        [P] Table 3, Figs. 3 and 4.
    held_out : Comparison
        Each of the motions planned with primitives of the others.
    other_activities : Comparison or None
        Each of them planned with primitives of other activities, if there are any.
    """

    motions: tuple[Demonstration, ...]
    components: tuple[PrincipalComponents, ...]
    shares_by_activity: dict[str, FloatArray]
    raising: Raising
    held_out: Comparison
    other_activities: Comparison | None

    def closer_than_bsplines(self, quantity: str) -> float:
        """Share of the motions for which the plan is nearer to the demonstration than B-splines."""
        ours, theirs = (self.held_out.column(name, quantity) for name in (OURS, BSPLINES))
        return float(np.mean(ours < theirs))

    def time_ratio(self, method: str) -> float:
        """Median ratio of a method's solve time to that of B-splines."""
        ours, theirs = (self.held_out.column(name, "solve_time") for name in (method, BSPLINES))
        return float(np.median(ours / theirs))


def choose_motions(motions: Sequence[Demonstration], number: int) -> list[Demonstration]:
    """Choose motions from all activities in turn, evenly spread over each activity.

    Parameters
    ----------
    motions :
        All motions; their labels are the activities.
    number :
        Number of motions to choose.

    Raises
    ------
    PrimitiveError
        If there are fewer motions.
    """
    if not 3 <= number <= len(motions):
        raise PrimitiveError(
            f"{number} motions can't be chosen: the recordings hold {len(motions)}, and the case "
            "study needs at least 3"
        )
    activities = [
        [i for i, m in enumerate(motions) if m.label == label]
        for label in sorted({m.label for m in motions})
    ]
    quotas = [0] * len(activities)
    while sum(quotas) < number:
        for k, members in enumerate(activities):
            quotas[k] += int(quotas[k] < len(members) and sum(quotas) < number)
    chosen = [
        members[(2 * i + 1) * len(members) // (2 * quota)]
        for members, quota in zip(activities, quotas, strict=True)
        for i in range(quota)
    ]
    return [motions[i] for i in sorted(chosen)]


def study(
    motions: Sequence[Demonstration],
    number: int,
    robot: Robot,
    tip: str,
    progress: Callable[[int, int], None] | None = None,
    min_of_activity: int = 5,
) -> CaseStudy:
    """Run the case study.

    Parameters
    ----------
    motions :
        All motions.
    number :
        Number of motions to choose, see :func:`choose_motions`.
    robot :
        Model of the arm.
    tip :
        The frame at its end.
    progress :
        Called with motions done and in all.
    min_of_activity :
        Least number of motions for a table of an activity.

    Raises
    ------
    PrimitiveError
        If there are too few motions.
    """
    chosen = choose_motions(motions, number)
    activities = [motion.label for motion in chosen]
    groupings = [None, activities] if len(set(activities)) > 1 else [None]
    n_done = 0

    def count(*_: int) -> None:
        """Report the motions of all comparisons."""
        nonlocal n_done
        n_done += 1
        if progress is not None:
            progress(n_done, number * len(groupings))

    more = {PAPER: paper_method(robot), FREE_BSPLINES: free_bsplines(robot)}
    held_out, *other_activities = (
        compare(chosen, groups, robot=robot, tip=tip, more=more, progress=count)
        for groups in groupings
    )
    sets: dict[str, list[Demonstration]] = {}
    for motion in motions:
        sets.setdefault(motion.label, []).append(motion)
    return CaseStudy(
        motions=tuple(chosen),
        components=tuple(angle_components(chosen)),
        shares_by_activity={
            label: variance_shares(angle_components(members))
            for label, members in sorted(sets.items())
            if label and len(members) >= min_of_activity
        },
        raising=_highest_rise(held_out, robot, tip),
        held_out=held_out,
        other_activities=other_activities[0] if other_activities else None,
    )


def variance_shares(components: Sequence[PrincipalComponents]) -> FloatArray:
    """Shares of the variance of the first four, shape (n_joints, 4); zero where there are fewer."""
    shares = np.zeros((len(components), PAPER_OPTIONS.n_components))
    for row, found in zip(shares, components, strict=True):
        ratio = found.explained_variance_ratio[: PAPER_OPTIONS.n_components]
        row[: ratio.size] = ratio
    return shares


def _highest_rise(held_out: Comparison, robot: Robot, tip: str) -> Raising:
    """The motion with the largest rise of the hand."""
    motions = held_out.motions
    heights = [robot.frame_positions(m.positions[[0, -1]], [tip])[:, 0, 2] for m in motions]
    highest = int(np.argmax([end - start for start, end in heights]))
    found = held_out.predictions[highest]
    return Raising(motions[highest], {name: found[name] for name in TABLE_3_METHODS})
