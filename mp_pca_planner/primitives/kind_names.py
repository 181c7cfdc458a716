# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Names of kinds of motions, by what distinguishes them."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from ..robot.model import Robot
from .motion_statistics import MotionStatistics

# Both ends of the axes of a base frame: x forward, y to the left, z up (REP 103).
_DIRECTIONS = (
    ("back", "forward", "back_and_forth"),
    ("right", "left", "right_and_left"),
    ("down", "up", "up_and_down"),
)
_REGIONS = (("behind", "in_front"), ("at_right", "at_left"), ("low", "high"))


@dataclass(frozen=True)
class NameOptions:
    """Thresholds of what names say.

    Attributes
    ----------
    majority : float
        A kind has a direction or a label if this share of its motions has it.
    least_moving : float
        A joint moves if its mean distance is above this share of the largest one.
    """

    majority: float = 0.75
    least_moving: float = 0.2


_OPTIONS = NameOptions()

Place = Callable[[FloatArray], FloatArray]
"""Coordinates of configurations of shape (n, n_joints), in which motions are described."""


def kind_names(
    kinds: Sequence[MotionStatistics], taken: Collection[str] = (), robot: Robot | None = None
) -> list[str]:
    """Distinct names of kinds, each valid as the name of a file.

    Parameters
    ----------
    kinds :
        The statistics of the motions of each kind.
    taken :
        Names not to use.
    robot : Robot, optional
        Its last frame says where motions are and where they go; otherwise their joints do.
    """
    attributes = _attributes(kinds, robot) if kinds else []
    lengths = [1] * len(kinds)
    while True:
        names = ["_".join(dict.fromkeys(x[:n])) for x, n in zip(attributes, lengths, strict=True)]
        counts = Counter([*names, *taken])
        longer = [
            min(n + (counts[name] > 1), len(x))
            for name, n, x in zip(names, lengths, attributes, strict=True)
        ]
        if longer == lengths:
            return _numbered(names, taken)
        lengths = longer


def plain_name(words: str) -> str:
    """Words as the name of a file: everything but letters and digits is replaced."""
    return re.sub(r"\W+", "_", words).strip("_")[:60] or "motions"


def _attributes(kinds: Sequence[MotionStatistics], robot: Robot | None) -> list[tuple[str, ...]]:
    """Label, direction, region and duration of each kind; the most telling ones first."""
    place: Place = lambda q: q  # noqa: E731  # as the joints are
    joints = kinds[0].joint_names
    directions = [(f"{name}_minus", f"{name}_plus", f"{name}_both_ways") for name in joints]
    regions = [(f"{name}_low", f"{name}_high") for name in joints]
    if robot is not None:
        robot = robot.with_joints(kinds[0].joint_names)
        tip = robot.end_effector
        place = lambda q: robot.frame_positions(q, [tip])[:, 0]  # noqa: E731
        directions, regions = list(_DIRECTIONS), list(_REGIONS)
    n = len(joints)
    requests = [x.requests() for x in kinds]
    ends = [(place(rows[:, :n]), place(rows[:, n : 2 * n])) for rows in requests]
    centers = np.array([(start + goal).mean(axis=0) / 2.0 for start, goal in ends])
    # Joints that hardly move say nothing about motions, wherever they are.
    travelled = np.mean([np.abs(goal - start).mean(axis=0) for start, goal in ends], axis=0)
    is_moving = travelled > _OPTIONS.least_moving * travelled.max()
    usual = np.median(np.concatenate([x.durations for x in kinds]))
    found = []
    for kind, (start, goal), center in zip(kinds, ends, centers, strict=True):
        apart = (center - centers.mean(axis=0)) * is_moving
        axis = int(np.abs(apart).argmax())
        pace = "slow" if np.median(kind.durations) > usual else "fast"
        words = (
            _label(kind),
            _direction(goal - start, directions),
            regions[axis][int(apart[axis] > 0.0)],
            pace,
        )
        found.append(tuple(plain_name(word) for word in words if word))
    return found


def _label(kind: MotionStatistics) -> str:
    """The label that most motions have, if any."""
    counts = Counter(motion.label for motion in kind.motions)
    label, count = counts.most_common(1)[0]
    return label if count >= _OPTIONS.majority * len(kind.motions) else ""


def _direction(displacements: FloatArray, words: Sequence[tuple[str, str, str]]) -> str:
    axis = int(np.abs(displacements).sum(axis=0).argmax())
    positive = float(np.mean(displacements[:, axis] > 0.0))
    minus, plus, both = words[axis]
    if positive >= _OPTIONS.majority:
        return plus
    return minus if positive <= 1.0 - _OPTIONS.majority else both


def _numbered(names: Sequence[str], taken: Collection[str]) -> list[str]:
    found: list[str] = []
    for name in names:
        number, free = 1, name
        while free in found or free in taken:
            number += 1
            free = f"{name}_{number}"
        found.append(free)
    return found
