# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""One recording, read and repaired: joint states of a bag or of a table."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ..arrays import is_number, unique_names
from ..exceptions import RecordingError, UnusableRecordingError, quote_names, unknown_name
from ..files import read_text, reading
from ..renaming import Rename, check_rename, new_name
from . import bags
from .bags import Bag, Topic
from .joint_states import JointLayout, RawJointStates, joined
from .recording_set import NORMALISED
from .repair import repair
from .repair.motion import LARGEST_ANGLE
from .repair.recording import CleanRecording
from .segmentation import SegmentationOptions
from .tables import FORMATS, Episodes, names_of_positions, read_table, whole_episodes

SEGMENTATIONS = ("auto", "none")


@dataclass(frozen=True)
class LoadOptions:
    """Choice of the motions to load, and how they are repaired and cut.

    Attributes
    ----------
    topic : str or None
        Topic of the joint states; by default the only one. Of a LeRobot dataset the column; by
        default :data:`.tables.STATE`. Several, separated by commas, are taken together.
    joints : sequence of str or None
        Names of the joints; by default all that every message lists.
    moving_only : bool
        Leaves out those of `joints` that a recording does not list, or that never move in any
        recording, such as a gripper's. They are noted. Without effect on `markers`.
    rename : mapping of str to str
        New names of joints by patterns of recorded ones, see :data:`.renaming.Rename`. All other
        options use the new names. Of several topics, a pattern may be ``TOPIC/NAME``.
    scale : mapping of str to float
        Factors by joint, from recorded values to rad (or m).
    degrees : bool
        Whether recorded positions are in degrees, but those of `prismatic` joints, of joints with a
        `scale`, and of grippers of LeRobot datasets, which are percentages.
    segment : str
        "auto" cuts at rests and valleys of the speed, "none" takes each recording as one motion
        and only trims the stillness at both ends (a recording with gaps: one motion per piece).
    segments_csv : path or None
        A table of motions cut by hand, see :func:`.cutting.read_segments`; instead of
        `segment`.
    segmentation : SegmentationOptions
        Shortest rest and motion of "auto".
    labels : sequence of str or None
        Labels in `segments_csv` of the motions to take; by default all.
    markers : MarkerSource or None
        Finds the joint states from markers, see :func:`.marker_joint_states.marker_source`;
        `topic` and `joints` are not used then.
    state_field : str or None
        The field of the topic's messages that is a JointState, with dots where it is a field of a
        field; needs `topic`. By default the messages themselves are.
    episodes : sequence of int or str, or None
        The episodes of LeRobot datasets or of CSV files to take; by default all.
    max_gap : float or None
        Longest time without messages that doesn't cut a recording [s], over 0. By default 0.5 s, or
        5 usual periods where these are longer.
    prismatic : sequence of str
        Joints that `degrees` doesn't convert, because they are measured in metres.
    position_limits : mapping of str to tuple of float
        Least and largest position of joints by name [rad or m]; none unless given. Motions beyond
        them are noted. See :func:`.load.facts_of_robot`.
    salvage : bool
        Takes the messages before the damage of a damaged recording.
    overviews : bool
        Adds overviews of the recordings to the reports.

    Raises
    ------
    RecordingError
        If `segment` is unknown, `state_field` is given without `topic`, or a factor is 0.
    """

    topic: str | None = None
    joints: Sequence[str] | None = None
    moving_only: bool = False
    rename: Rename = field(default_factory=dict)
    scale: Mapping[str, float] = field(default_factory=dict)
    degrees: bool = False
    segment: Literal["auto", "none"] = "auto"
    segments_csv: str | Path | None = None
    segmentation: SegmentationOptions = field(default_factory=SegmentationOptions)
    labels: Sequence[str] | None = None
    markers: Any = None
    state_field: str | None = None
    episodes: Sequence[int | str] | None = None
    max_gap: float | None = None
    prismatic: Collection[str] = ()
    position_limits: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    salvage: bool = False
    overviews: bool = False

    def __post_init__(self) -> None:
        if self.segment not in SEGMENTATIONS:
            raise RecordingError(unknown_name("segmentation", self.segment, SEGMENTATIONS))
        check_rename(self.rename)
        for name, factor in self.scale.items():
            if not (is_number(factor) and np.isfinite(factor) and factor != 0.0):
                raise RecordingError(
                    f"the scale of joint '{name}' must be a number that is not 0, got {factor!r}"
                )
        if self.state_field is not None and self.topic is None:
            raise RecordingError(
                f"the field '{self.state_field}' needs a topic whose messages have this field"
            )


def read_recording(path: Path, options: LoadOptions) -> CleanRecording:
    """Read the joint states of a bag or a table, and repair them.

    Raises
    ------
    RecordingError
        If the recording can't be read or repaired.
    """
    joints = options.joints
    if joints is not None and bags.recording_format(path) in FORMATS:
        joints = names_of_positions(joints)
        options = replace(options, joints=joints)
    raw, episodes = _read(path, options)
    if joints is None and len(_topics(options)) > 1:
        joints = raw.listed_joints
    taken = _listed(joints, raw.listed_joints) if options.moving_only else joints
    try:
        clean = repair(raw, taken, options.max_gap)
    except UnusableRecordingError as error:
        if episodes:  # whose borders are no gaps
            error.findings["repairs"].pop("gaps", None)
        raise
    reach = np.rad2deg(max(np.abs(piece.positions).max() for piece in clean.pieces))
    if options.degrees and reach < LARGEST_ANGLE:
        raise RecordingError(
            f"its positions are {reach:.3g} at most, which are radians rather than degrees: leave "
            "out --degrees (degrees=True in Python)"
        )
    clean = _noted(clean, joints)
    return whole_episodes(clean, episodes) if episodes else clean


def _read(path: Path, options: LoadOptions) -> tuple[RawJointStates, Episodes]:
    """Joint states by their new names, in rad (or m), and the episodes of a table."""
    table_format = bags.recording_format(path)
    topics = _topics(options)
    if table_format in FORMATS:
        if options.state_field is not None:
            raise RecordingError("--field is for messages of bags: a table has columns")
        raw, episodes = read_table(
            path,
            table_format,
            topics,
            options.joints,
            rename=options.rename,
            max_gap=options.max_gap or 0.0,
            episodes=options.episodes,
        )
        is_lerobot = table_format == "lerobot"
        return in_si_units(raw, options, are_normalised=is_lerobot), episodes
    if options.episodes is not None:
        raise RecordingError("a bag holds no episodes: they are chosen from tables only")
    with bags.open_bag(path, salvage=options.salvage) as bag:
        if not topics or options.state_field is None:
            chosen = [_chosen_topic(bag, topic) for topic in topics or (None,)]
            topics = [topic.name for topic in chosen]
        states = [bag.joint_states(topic, field=options.state_field) for topic in topics]
    raw = together([renamed(one, options.rename) for one in states])
    return in_si_units(raw, options), ()


def _topics(options: LoadOptions) -> list[str]:
    return [] if options.topic is None else [topic.strip() for topic in options.topic.split(",")]


def renamed(raw: RawJointStates, rename: Rename) -> RawJointStates:
    """Joint states by their new names.

    Raises
    ------
    RecordingError
        If two joints of a message get the same name.
    """
    layouts = []
    for layout in raw.layouts:
        names = tuple(new_name(name, rename, raw.topic) for name in layout.joint_names)
        layouts.append(
            replace(layout, joint_names=unique_names(names, "renamed joints", RecordingError))
        )
    return replace(raw, layouts=tuple(layouts)) if rename else raw


def together(states: Sequence[RawJointStates]) -> RawJointStates:
    """Joint states of several topics.

    Raises
    ------
    RecordingError
        If two of them list the same joint.
    """
    whole = states[0]
    for one in states[1:]:
        if both := [name for name in one.listed_joints if name in whole.listed_joints]:
            raise RecordingError(
                f"'{whole.topic}' and '{one.topic}' list the same joints, {quote_names(both)}: "
                f"rename some, as by --rename '{one.topic}/*=second_*'"
            )
        topic = f"{whole.topic},{one.topic}"
        whole = replace(joined(whole, one), topic=topic, notes=(*whole.notes, *one.notes))
    return whole


def in_si_units(
    raw: RawJointStates, options: LoadOptions, *, are_normalised: bool = False
) -> RawJointStates:
    """Joint states in rad (or m).

    Raises
    ------
    RecordingError
        If a joint with a scale is unknown.
    """
    for name in options.scale:
        if name not in raw.listed_joints:
            raise RecordingError(f"--scale: {unknown_name('joint', name, raw.listed_joints)}")
    factors, notes = {name: float(x) for name, x in options.scale.items()}, raw.notes
    if options.degrees:
        left = {name for name in options.prismatic if name in raw.listed_joints}
        if are_normalised:
            grippers = {name for name in raw.listed_joints if "gripper" in name.lower()}
            left |= grippers
            notes += _normalised_note(raw, left.union(factors))
        left -= factors.keys()
        if left:
            notes += (f"not converted from degrees: {quote_names(sorted(left))}",)
        if are_normalised and (options.joints is None or options.moving_only):
            raw = _without(raw, grippers & left)
        angles = (x for x in raw.listed_joints if x not in left and x not in factors)
        factors |= dict.fromkeys(angles, np.pi / 180.0)
    if not factors:
        return raw
    layouts = tuple(_scaled(layout, factors) for layout in raw.layouts)
    return replace(raw, layouts=layouts, notes=tuple(dict.fromkeys((*notes, *raw.notes))))


def _without(raw: RawJointStates, joints: Collection[str]) -> RawJointStates:
    """The states of a table without some joints, and a note on them."""
    (layout,) = raw.layouts
    kept = [i for i, name in enumerate(layout.joint_names) if name not in joints]
    if not joints or not kept:
        return raw
    note = (
        f"left out, as LeRobot states grippers in per cent: {quote_names(sorted(joints))}; "
        "--scale or --joints takes them"
    )
    names = tuple(layout.joint_names[i] for i in kept)
    layout = replace(layout, joint_names=names, positions=layout.positions[:, kept])
    return replace(raw, layouts=(layout,), notes=(*raw.notes, note))


def _normalised_note(raw: RawJointStates, others: Collection[str]) -> tuple[str, ...]:
    """A note if values of a LeRobot dataset that shall be degrees may be shares of ranges."""
    layout = raw.layouts[0]
    columns = [i for i, name in enumerate(layout.joint_names) if name not in others]
    if not columns or (np.abs(layout.positions[:, columns]) > 100.5).any():
        return ()
    return (NORMALISED,)


def _scaled(layout: JointLayout, factors: Mapping[str, float]) -> JointLayout:
    own = np.array([factors.get(name, 1.0) for name in layout.joint_names])
    velocities = None if layout.velocities is None else layout.velocities * own.astype(np.float32)
    return replace(layout, positions=layout.positions * own, velocities=velocities)


_ENCODER_STEPS = 4095  # of a turn, as LeRobot counts those of its motors


def scale_of_calibration(path: str | Path) -> dict[str, float]:
    """Factors of LeRobot's normalised values [rad], by joint, from its calibration file.

    Joints are from -100 to 100 over their calibrated ranges, and grippers from 0 to 100.

    Raises
    ------
    RecordingError
        If the file can't be read.
    """
    with reading(f"the calibration '{path}'", RecordingError):
        motors = json.loads(read_text(path))
        return {
            name: 2.0
            * np.pi
            / _ENCODER_STEPS
            * (float(one["range_max"]) - float(one["range_min"]))
            / (100.0 if "gripper" in name else 200.0)
            for name, one in motors.items()
        }


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
    path: str | Path,
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
    inspection = RecordingInspection(
        bags.recording_names(paths)[0], str(recording), bags.recording_format(recording)
    )
    try:
        if inspection.format not in FORMATS:
            with bags.open_bag(recording, salvage=salvage) as bag:
                inspection = replace(inspection, topics=bag.topics)
        options = LoadOptions(topic=topic, state_field=state_field, salvage=salvage)
        clean = read_recording(recording, options)
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
