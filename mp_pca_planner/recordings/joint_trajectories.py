# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Commanded motions: JointTrajectory messages, each sampled as the controller executes it.

A message starts at the stamp of its header or, if that is not set, when it was received. The
joint_trajectory_controller interpolates between its points, and leaves it for a later one at once
when that one starts.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import FloatArray
from ..exceptions import RecordingError
from ..input_limits import INPUT_LIMITS
from ..motion.interpolation import interpolate_at, segment_ends
from .bags import Bag, Stored, Topic
from .joint_states import NS_PER_S, listed_names
from .repair.messages import SIMULATION_TIME, choose_joints, is_simulation_time
from .repair.recording import (
    MIN_SAMPLES,
    CleanRecording,
    Piece,
    findings,
    findings_on_refusal,
    motion_findings,
)

# Rate at which commanded motions are sampled [Hz]; smoothing keeps no higher rate.
_COMMANDED_RATE = 200.0


@dataclass(frozen=True, eq=False)
class CommandedMotion:
    """A message as recorded.

    Attributes
    ----------
    joint_names : tuple of str
        Names of the joints.
    header_stamp, receive_stamp : int
        Time in the header (0: not set) and time of reception [ns].
    times : array, shape (n_points,)
        Times of its points since its start [s].
    positions, velocities, accelerations : array, shape (n_points, n_joints)
        Of the points [rad or m, /s, /s²]; NaN where a point has no velocities or accelerations.
    """

    joint_names: tuple[str, ...]
    header_stamp: int
    receive_stamp: int
    times: FloatArray
    positions: FloatArray
    velocities: FloatArray
    accelerations: FloatArray


@dataclass(frozen=True, eq=False)
class RawTrajectories:
    """Everything a topic of JointTrajectory holds, as recorded, in the order of reception.

    Attributes
    ----------
    topic : str
        Name of the topic.
    motions : tuple of CommandedMotion
        Its well-formed messages.
    n_malformed : int
        Messages that no controller would accept: without points, with times that don't increase,
        or without one number for each joint.
    notes : tuple of str
        Notes on the reading, one sentence each.
    """

    topic: str
    motions: tuple[CommandedMotion, ...]
    n_malformed: int
    notes: tuple[str, ...] = ()

    @property
    def n_messages(self) -> int:
        """Number of messages."""
        return len(self.motions) + self.n_malformed

    @property
    def listed_joints(self) -> tuple[str, ...]:
        """All joints that messages list, in the order of first appearance."""
        return listed_names(motion.joint_names for motion in self.motions)


def read_trajectories(bag: Bag, topic: Topic) -> RawTrajectories:
    """Read all trajectories of a topic.

    Raises
    ------
    RecordingError
        If the recording can't be read, wholly or in part.
    """

    def gathered(stored: Iterator[Stored]) -> RawTrajectories:
        found = [_commanded(bag.deserialise(source, data), stamp) for source, stamp, data in stored]
        good = tuple(motion for motion in found if motion is not None)
        return RawTrajectories(topic.name, good, len(found) - len(good), bag.notes)

    return bag.read([topic], gathered)


def _commanded(message: Any, receive_stamp: int) -> CommandedMotion | None:
    names, points = tuple(message.joint_names), message.points
    times = [p.time_from_start.sec + p.time_from_start.nanosec / NS_PER_S for p in points]
    shapes = [(len(p.positions), len(p.velocities), len(p.accelerations)) for p in points]
    n = len(names)
    if (
        not points
        or not names
        or len(set(names)) < n
        or times[0] < 0.0
        or any(later <= earlier for earlier, later in pairwise(times))
        # Accelerations without velocities make the controller command 0.
        or any(shape not in ((n, 0, 0), (n, n, 0), (n, n, n)) for shape in shapes)
    ):
        return None
    stamp = message.header.stamp
    return CommandedMotion(
        names,
        stamp.sec * NS_PER_S + stamp.nanosec,
        receive_stamp,
        np.array(times),
        *(
            np.array([_row(getattr(point, field), n) for point in points])
            for field in ("positions", "velocities", "accelerations")
        ),
    )


def _row(values: ArrayLike, n_joints: int) -> FloatArray:
    """Numbers of a point; NaN for those it does not have, infinite for those that are NaN."""
    row = np.asarray(values, dtype=np.float64)
    return np.where(np.isnan(row), np.inf, row) if row.size else np.full(n_joints, np.nan)


def repair_trajectories(
    raw: RawTrajectories, joints: Sequence[str] | None = None
) -> CleanRecording:
    """Sample commanded motions, a piece each, and count every repair.

    Parameters
    ----------
    raw :
        What was recorded.
    joints :
        Names of the joints to take; by default those that all messages list.

    Raises
    ------
    UnusableRecordingError
        If a joint is unknown, no message is a motion, or nothing moves.
    """
    repairs: Counter[str] = Counter(malformed=raw.n_malformed)
    with findings_on_refusal(raw, repairs):
        names = choose_joints([motion.joint_names for motion in raw.motions], raw.topic, joints)
        motions = [m for m in raw.motions if set(names) <= set(m.joint_names)]
        repairs["missing_joints"] += len(raw.motions) - len(motions)
        if not motions:
            raise RecordingError("no trajectory lists all of the chosen joints together")
        finite = [motion for motion in motions if _is_finite(motion)]
        repairs["non_finite"] += len(motions) - len(finite)
        started, notes = _started(finite)
        pieces = _pieces(started, names, repairs)
        if not pieces:
            raise RecordingError(
                f"none of the {raw.n_messages} trajectories on '{raw.topic}' is a motion; expected "
                "two points or more, finite numbers, and no other trajectory that starts at once"
            )
        still, of_motions = motion_findings(names, pieces)
        notes = (*notes, *of_motions)
        return CleanRecording(
            joint_names=names,
            pieces=tuple(pieces),
            rate=_COMMANDED_RATE,
            sample_rate=_COMMANDED_RATE,
            pieces_are_motions=True,
            still_joints=still,
            **findings(raw, repairs, notes),
        )


def _pieces(
    started: Sequence[tuple[float, CommandedMotion]],
    names: Sequence[str],
    repairs: Counter[str],
) -> list[Piece]:
    """Sample each motion up to its end or to the start of the next one."""
    pieces = []
    nexts = [start for start, _ in started[1:]]
    for (start, motion), following in zip(started, [*nexts, math.inf], strict=True):
        end = start + float(motion.times[-1])
        repairs["replaced"] += following < end
        piece = _sampled(motion, names, start, min(end, following))
        if piece is not None:
            pieces.append(piece)
        else:
            repairs["single_points" if motion.times.size == 1 else "short_pieces"] += 1
    return pieces


def _is_finite(motion: CommandedMotion) -> bool:
    """Whether all numbers are finite, and the duration and positions plausible."""
    return bool(
        motion.times[-1] - motion.times[0] < INPUT_LIMITS.commanded_duration
        and (np.abs(motion.positions) < INPUT_LIMITS.position).all()
        and not np.isinf(motion.velocities).any()
        and not np.isinf(motion.accelerations).any()
    )


def _started(
    motions: Sequence[CommandedMotion],
) -> tuple[list[tuple[float, CommandedMotion]], tuple[str, ...]]:
    """Motions with their starts [s] since the first one's, in this order; with notes."""
    stamped = [m for m in motions if m.header_stamp > 0]
    notes: tuple[str, ...] = ()
    starts = [m.header_stamp if m.header_stamp > 0 else m.receive_stamp for m in motions]
    if any(is_simulation_time(m.header_stamp, m.receive_stamp) for m in stamped):
        if len(stamped) == len(motions):
            notes = (SIMULATION_TIME,)
        else:
            starts = [m.receive_stamp for m in motions]
    order = sorted(range(len(motions)), key=lambda index: starts[index])
    first = min(starts, default=0)
    return [((starts[index] - first) / NS_PER_S, motions[index]) for index in order], notes


def _sampled(
    motion: CommandedMotion, names: Sequence[str], start: float, end: float
) -> Piece | None:
    """Samples of a motion from its first point to its end; None if these are too few."""
    first = start + float(motion.times[0])
    n_samples = round((end - first) * _COMMANDED_RATE) + 1
    if motion.times.size < 2 or n_samples < MIN_SAMPLES:
        return None
    columns = [motion.joint_names.index(name) for name in names]
    times = np.linspace(first, end, n_samples)
    points = (motion.positions, motion.velocities, motion.accelerations)
    ends = segment_ends(motion.times, *(values[:, columns] for values in points))
    instants = np.clip(times - start, motion.times[0], motion.times[-1])
    positions, _, _ = interpolate_at(instants, motion.times, ends)
    return Piece(times, positions)
