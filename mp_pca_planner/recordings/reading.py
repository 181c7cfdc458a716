# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""One recording, read and repaired: joint states, a table, or the motions of commands.

A JointTrajectory message is sampled as the controller executes it. It starts at the stamp of its
header or, if that is not set, when it was received. The joint_trajectory_controller interpolates
between its points, and leaves it for a later one at once when that one starts.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import FloatArray
from ..exceptions import RecordingError, UnusableRecordingError, quote_names
from ..input_limits import INPUT_LIMITS
from ..motion.interpolation import interpolate_at, segment_ends
from . import bags
from .bags import Bag, Stored, Topic
from .joint_states import NS_PER_S, JointLayout, RawJointStates, listed_names
from .repair import repair
from .repair.messages import SIMULATION_TIME, choose_joints, is_simulation_time
from .repair.motion import LARGEST_ANGLE
from .repair.recording import (
    MIN_SAMPLES,
    CleanRecording,
    Piece,
    findings,
    findings_on_refusal,
    motion_findings,
)
from .tables import FORMATS, read_table, whole_episodes

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


def read_recording(
    path: Path,
    topic: str | None = None,
    joints: Sequence[str] | None = None,
    state_field: str | None = None,
    *,
    salvage: bool = False,
    listed_only: bool = False,
    degrees: bool = False,
    max_gap: float | None = None,
    episodes: Sequence[int | str] | None = None,
    progress: Callable[[float], None] | None = None,
) -> CleanRecording:
    """Read the joint states or commanded motions of a bag or a table, and repair them.

    Parameters
    ----------
    path :
        The recording.
    topic :
        Topic of the joint states; by default the only one. Of a LeRobot dataset its column.
    joints :
        Names of the joints; by default all that every message lists.
    state_field :
        The field of the topic's messages that is a JointState; needs `topic`.
    salvage :
        Reads the messages before the damage of a damaged bag.
    listed_only :
        Takes only those of `joints` that messages list, and notes the others.
    degrees :
        Whether the positions are in degrees.
    max_gap :
        Longest time without messages that is no gap [s], see :func:`.repair.repair`.
    episodes :
        The episodes of a table to read; all by default.
    progress :
        Called with the share of the messages that is read.

    Raises
    ------
    RecordingError
        If the recording can't be read or repaired.
    """
    table_format = bags.recording_format(path)
    if table_format in FORMATS:
        if state_field is not None:
            raise RecordingError("--field is for messages of bags: a table has columns")
        raw, found = read_table(path, table_format, topic, joints, max_gap or 0.0, episodes)
        clean = _repaired(raw, joints, max_gap, listed_only=listed_only, degrees=degrees)
        return whole_episodes(clean, found) if found else clean
    if episodes is not None:
        raise RecordingError("a bag holds no episodes: they are chosen from tables only")
    with bags.open_bag(path, salvage=salvage) as bag:
        if topic is None or state_field is None:
            chosen = _chosen_topic(bag, topic)
            if chosen.type == bags.JOINT_TRAJECTORY:
                if degrees:
                    raise RecordingError("--degrees is for joint states, not for commanded motions")
                motions = read_trajectories(bag, chosen)
                taken = _listed(joints, motions.listed_joints) if listed_only else joints
                return _noted(repair_trajectories(motions, taken), joints)
            topic = chosen.name
        raw = bag.joint_states(topic, field=state_field, progress=progress)
    return _repaired(raw, joints, max_gap, listed_only=listed_only, degrees=degrees)


def _repaired(
    raw: RawJointStates,
    joints: Sequence[str] | None,
    max_gap: float | None,
    *,
    listed_only: bool,
    degrees: bool,
) -> CleanRecording:
    if degrees:
        raw = replace(raw, layouts=tuple(map(_in_radians, raw.layouts)))
    taken = _listed(joints, raw.listed_joints) if listed_only else joints
    clean = repair(raw, taken, max_gap)
    reach = np.rad2deg(max(np.abs(piece.positions).max() for piece in clean.pieces))
    if degrees and reach < LARGEST_ANGLE:
        raise RecordingError(
            f"its positions are {reach:.3g} at most, which are radians rather than degrees: leave "
            "out --degrees (degrees=True in Python)"
        )
    return _noted(clean, joints)


def _in_radians(layout: JointLayout) -> JointLayout:
    velocities = None if layout.velocities is None else np.deg2rad(layout.velocities)
    return replace(layout, positions=np.deg2rad(layout.positions), velocities=velocities)


def _listed(joints: Sequence[str] | None, listed: Sequence[str]) -> Sequence[str] | None:
    """The joints that are listed; all of them if none is, which is an error later."""
    return [name for name in joints or () if name in listed] or joints


def _noted(clean: CleanRecording, joints: Sequence[str] | None) -> CleanRecording:
    """The recording with a note on the joints that it lacks."""
    missing = [name for name in joints or () if name not in clean.joint_names]
    if not missing:
        return clean
    note = f"joints left out, as the recording lacks them: {quote_names(missing)}"
    return replace(clean, notes=(*clean.notes, note))


def _chosen_topic(bag: Bag, topic: str | None) -> Topic:
    """The topic to read; an error lists the messages that have joint states as a field."""
    try:
        return bags.choose_topic(bag.topics, topic)
    except RecordingError as error:
        hints = [
            f"field '{field}' of topic '{name}'"
            for name, field in bag.embedded_states()
            if topic in (None, name)
        ]
        if not hints:
            raise
        raise RecordingError(
            f"{error}; other messages hold joint states: read them with {' or '.join(hints)}"
        ) from None


@dataclass(frozen=True)
class RecordingInspection:
    """Content of a recording, also of one that can't be used.

    Attributes
    ----------
    name, path : str
        The recording.
    format : str
        Its storage format.
    topics : tuple of Topic
        All topics with their types and counts; empty if it can't be read.
    topic : str or None
        The topic of joint states that was inspected.
    n_messages : int
        Messages on it.
    joint_names : tuple of str
        All joints that its messages list.
    rate, duration : float or None
        Usual rate [Hz] and duration [s], if its time is usable.
    repairs : dict
        Counts of the repairs that are needed, by their names in :data:`.repair.REPAIRS`.
    notes : tuple of str
        Other findings, one sentence each.
    refusal : str or None
        Reason why its joint states can't be used, if so.
    """

    name: str
    path: str
    format: bags.RecordingFormat
    topics: tuple[Topic, ...] = ()
    topic: str | None = None
    n_messages: int = 0
    joint_names: tuple[str, ...] = ()
    rate: float | None = None
    duration: float | None = None
    repairs: dict[str, int] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    refusal: str | None = None


def inspect_recording(
    path: str | bags.Recording,
    topic: str | None = None,
    *,
    state_field: str | None = None,
    salvage: bool = False,
) -> RecordingInspection:
    """Inspect a recording; defects that make it unusable are reported, not raised.

    Parameters
    ----------
    path :
        The recording.
    topic :
        Topic of the joint states; by default the only one.
    state_field :
        The field of the topic's messages that is a JointState; needs `topic`.
    salvage :
        Inspects the messages before the damage of a damaged recording.

    Raises
    ------
    RecordingError
        If there is nothing at the path, more than one recording, or something else.
    """
    paths = bags.find_recordings([path])
    if len(paths) > 1:
        raise RecordingError(f"there are {len(paths)} recordings at '{path}': inspect one of them")
    (recording,) = paths
    with bags.local_copy(recording) as copy:
        inspection = RecordingInspection(
            bags.recording_names(paths)[0], str(recording), bags.recording_format(copy)
        )
        try:
            if inspection.format not in FORMATS:
                with bags.open_bag(copy, salvage=salvage) as bag:
                    inspection = replace(inspection, topics=bag.topics)
            clean = read_recording(copy, topic, state_field=state_field, salvage=salvage)
            found, refusal = vars(clean) | {"duration": clean.duration}, None
        except UnusableRecordingError as error:
            found, refusal = error.findings, str(error)
        except RecordingError as error:
            return replace(inspection, refusal=str(error))
    facts = ("topic", "n_messages", "rate", "duration", "repairs", "notes")
    return replace(
        inspection,
        joint_names=found["listed_joints"],
        refusal=refusal,
        **{fact: found[fact] for fact in facts if fact in found},
    )
