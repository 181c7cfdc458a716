# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Names of kinds of motions, by what distinguishes them."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

import numpy as np

from ...arrays import FloatArray
from ...robot.model import Robot
from ..motion_statistics import MotionStatistics

# Both ends of the axes of a base frame: x forward, y to the left, z up (REP 103).
_DIRECTIONS = (
    ("back", "forward", "back_and_forth"),
    ("right", "left", "left_and_right"),
    ("down", "up", "up_and_down"),
)
_REGIONS = (("near", "far"), ("at_right", "at_left"), ("low", "high"))
_REACH = "reach"
_FALLS, _RISES, _BOTH = range(3)


@dataclass(frozen=True)
class NameOptions:
    """Thresholds of what names say.

    Attributes
    ----------
    majority : float
        A kind has a direction or a label if this share of its motions has it.
    least_apart : float
        Shortest distance from the middle of all kinds at which a kind is called low or high, near
        or far [m or rad].
    least_share : float
        The same as a share of the largest such distance.
    max_bytes : int
        Length of a name, which leaves space for a number and for the ending of a file.
    """

    majority: float = 0.75
    least_apart: float = 0.05
    least_share: float = 0.35
    max_bytes: int = 150


_OPTIONS = NameOptions()


@dataclass(frozen=True)
class _Space:
    """The coordinates in which motions are described, and the words for them.

    Attributes
    ----------
    place : callable
        Coordinates of configurations of shape (n, n_joints), shape (n, n_coordinates).
    region : callable
        Where these coordinates are, of the same shape.
    directions, regions : sequence of tuple of str
        Words for each coordinate.
    middle : array, shape (n_coordinates,)
        1 where regions are relative to the mean of all kinds, 0 where they are absolute.
    verb : tuple of str
        What a motion without a label is called first.
    """

    place: Callable[[FloatArray], FloatArray]
    region: Callable[[FloatArray], FloatArray]
    directions: Sequence[tuple[str, str, str]]
    regions: Sequence[tuple[str, str]]
    middle: FloatArray
    verb: tuple[str, ...]


def kind_names(
    kinds: Sequence[MotionStatistics], taken: Collection[str] = (), robot: Robot | None = None
) -> list[str]:
    """Distinct names of kinds, each valid as the name of a file, such as ``reach_left_low``.

    A kind is called by the label of its motions. Otherwise its name says where the end effector
    goes and, if that differs between the kinds, where it ends, both in the robot's base frame.
    Names that would be equal get further words, then numbers.

    Parameters
    ----------
    kinds :
        The statistics of the motions of each kind.
    taken :
        Names not to use.
    robot : Robot, optional
        The robot. Without it, names say which joint moves most, and which way.
    """
    if not kinds:
        return []
    described = _described(kinds, robot)
    lengths = [n for _, n in described]
    while True:
        names = [_joined(words[:n]) for (words, _), n in zip(described, lengths, strict=True)]
        counts = Counter([*names, *taken])
        longer = [
            min(n + (counts[name] > 1), len(words))
            for name, n, (words, _) in zip(names, lengths, described, strict=True)
        ]
        if longer == lengths:
            return _numbered(names, taken)
        lengths = longer


def plain_name(words: str) -> str:
    """Words as the name of a file: everything but letters and digits is replaced."""
    return re.sub(r"\W+", "_", words).strip("_")[:60] or "motions"


def _joined(words: Sequence[str]) -> str:
    """Words as a name, cut where it would be too long for a file."""
    name = "_".join(dict.fromkeys(map(plain_name, words)))
    return name.encode()[: _OPTIONS.max_bytes].decode(errors="ignore")


def _space(joint_names: Sequence[str], robot: Robot | None) -> _Space:
    if robot is None:
        directions = [(f"{x}_minus", f"{x}_plus", f"{x}_both_ways") for x in joint_names]
        regions = [(f"{x}_low", f"{x}_high") for x in joint_names]
        middle = np.ones(len(joint_names))
        return _Space(lambda q: q, lambda x: x, directions, regions, middle, ())
    arm = robot.with_joints(joint_names)
    tip = [arm.end_effector]

    def reach(x: FloatArray) -> FloatArray:
        """Distance from the axis of the base in place of x."""
        return np.column_stack([np.hypot(x[:, 0], x[:, 1]), x[:, 1:]])

    def place(q: FloatArray) -> FloatArray:
        return np.asarray(arm.frame_positions(q, tip)[:, 0])

    middle = np.array([1.0, 0.0, 1.0])  # left and right are sides of the base
    return _Space(place, reach, _DIRECTIONS, _REGIONS, middle, (_REACH,))


def _described(
    kinds: Sequence[MotionStatistics], robot: Robot | None
) -> list[tuple[tuple[str, ...], int]]:
    """Words for each kind, the most telling ones first, and how many of them a name needs."""
    n = len(kinds[0].joint_names)
    space = _space(kinds[0].joint_names, robot)
    requests = [x.requests() for x in kinds]
    ends = [(space.place(rows[:, :n]), space.place(rows[:, n : 2 * n])) for rows in requests]
    moves = [_direction(goal - start) for start, goal in ends]
    last = [
        space.region(np.concatenate([start, goal]) if side == _BOTH else goal).mean(axis=0)
        for (start, goal), (_, side) in zip(ends, moves, strict=True)
    ]
    apart = np.array(last) - space.middle * np.mean(last, axis=0)
    least = np.maximum(_OPTIONS.least_apart, _OPTIONS.least_share * np.abs(apart).max(axis=0))
    usual = np.median(np.concatenate([x.durations for x in kinds]))
    described = []
    for kind, (axis, side), offsets in zip(kinds, moves, apart, strict=True):
        notable = [i for i in np.argsort(-np.abs(offsets)) if abs(offsets[i]) > least[i]]
        # The direction nearly says where a kind ends along it.
        notable.sort(key=lambda i: bool(i == axis))
        places = [space.regions[i][int(offsets[i] > 0.0)] for i in notable]
        pace = "slow" if np.median(kind.durations) > usual else "fast"
        motion = (*space.verb, space.directions[axis][side])
        label = _label(kind)
        # Joints have long names: where they are is said of kinds that move the same one only.
        n_words = 1 if label else len(motion) + bool(robot and notable and notable[0] != axis)
        words = (label, motion[-1]) if label else motion
        described.append(((*words, *places, pace), n_words))
    return described


def _label(kind: MotionStatistics) -> str:
    """The label that most motions have, if any."""
    counts = Counter(motion.label for motion in kind.motions)
    label, count = counts.most_common(1)[0]
    return label if count >= _OPTIONS.majority * len(kind.motions) else ""


def _direction(displacements: FloatArray) -> tuple[int, int]:
    """The coordinate that changes most, and whether it falls, rises, or does both in turns."""
    axis = int(np.abs(displacements).sum(axis=0).argmax())
    positive = float(np.mean(displacements[:, axis] > 0.0))
    if positive >= _OPTIONS.majority:
        return axis, _RISES
    return axis, _FALLS if positive <= 1.0 - _OPTIONS.majority else _BOTH


def _numbered(names: Sequence[str], taken: Collection[str]) -> list[str]:
    found: list[str] = []
    for name in names:
        number, free = 1, name
        while free in found or free in taken:
            number += 1
            free = f"{name}_{number}"
        found.append(free)
    return found
