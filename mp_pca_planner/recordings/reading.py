# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""One recording, read and repaired: joint states of a bag or of a table."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..exceptions import RecordingError, UnusableRecordingError, quote_names, unknown_name
from ..files import read_text, reading
from ..renaming import notes_on_rename
from . import bags
from .continuity import LARGEST_ANGLE
from .joint_states import JointStates
from .options import LoadOptions
from .recording import Recording
from .recording_set import NORMALISED
from .repair import repair
from .tables import FORMATS, Episodes, names_of_positions, read_table, whole_episodes


def read_recording(path: Path, options: LoadOptions) -> Recording:
    """Read the joint states of a bag or a table, or those of markers, and repair them.

    Raises
    ------
    RecordingError
        If the recording can't be read or repaired.
    """
    if options.markers is not None:
        states, residuals = options.markers.joint_states(path, salvage=options.salvage)
        recording = repair(states, None, options.max_gap)
        return replace(recording, marker_residuals=residuals)
    joints = options.joints
    if joints is not None and bags.recording_format(path) in FORMATS:
        joints = names_of_positions(joints)
    states, episodes = _read(path, replace(options, joints=joints))
    if joints is None and len(options.topics) > 1:
        joints = states.joint_names
    missing = [name for name in joints or () if name not in states.joint_names]
    if options.moving_only and len(missing) < len(joints or ()):
        joints = [name for name in joints or () if name not in missing]
    try:
        recording = repair(states, joints, options.max_gap)
    except UnusableRecordingError as error:
        if episodes:  # whose borders are no gaps
            error.findings["repairs"].pop("gaps", None)
        raise
    reach = np.rad2deg(max(np.abs(piece.positions).max() for piece in recording.pieces))
    if options.degrees and reach < LARGEST_ANGLE:
        raise RecordingError(
            f"its positions are {reach:.3g} at most, which are radians rather than degrees: leave "
            "out --degrees (degrees=True in Python)"
        )
    if missing:
        recording = recording.noted(
            f"joints left out, as the recording lacks them: {quote_names(missing)}"
        )
    return whole_episodes(recording, episodes) if episodes else recording


def _read(path: Path, options: LoadOptions) -> tuple[JointStates, Episodes]:
    """Joint states by their new names, in rad (or m), and the episodes of a table."""
    table_format = bags.recording_format(path)
    if table_format in FORMATS:
        if options.state_field is not None:
            raise RecordingError("--field is for messages of bags: a table has columns")
        states, episodes = read_table(path, options)
        return in_si_units(states, options, are_normalised=table_format == "lerobot"), episodes
    if options.episodes is not None:
        raise RecordingError("a bag holds no episodes: they are chosen from tables only")
    with bags.open_bag(path, salvage=options.salvage) as bag:
        topics: list[str] = options.topics
        if not topics or options.state_field is None:
            topics = [_chosen_topic(bag, topic) for topic in topics or (None,)]
        several = [bag.joint_states(topic, options.state_field) for topic in topics]
    notes = notes_on_rename(options.rename, {x.topic: x.joint_names for x in several})
    states = together([x.renamed(options.rename) for x in several])
    return in_si_units(replace(states, notes=(*states.notes, *notes)), options), ()


def _chosen_topic(bag: bags.Bag, topic: str | None) -> str:
    """The topic to read; an error lists the messages that have joint states as a field."""
    try:
        return bags.choose_topic(bag.topics, topic).name
    except RecordingError as error:
        embedded = [x for x in bag.embedded_states() if topic in (None, x[0])]
        hints = [f"--topic {name} --field {field}" for name, field in embedded]
        if not hints:
            raise
        raise RecordingError(
            f"{error}; other messages hold joint states: read them by {' or '.join(hints)}"
        ) from None


def together(states: Sequence[JointStates]) -> JointStates:
    """Joint states of several topics.

    Raises
    ------
    RecordingError
        If two of them list the same joint.
    """
    whole = states[0]
    for following in states[1:]:
        if both := [name for name in following.joint_names if name in whole.joint_names]:
            raise RecordingError(
                f"'{whole.topic}' and '{following.topic}' list the same joints, "
                f"{quote_names(both)}: rename some, as by --rename '{following.topic}/*=second_*'"
            )
        topic = f"{whole.topic},{following.topic}"
        whole = replace(whole.followed_by(following), topic=topic)
    return whole


def in_si_units(
    states: JointStates, options: LoadOptions, *, are_normalised: bool = False
) -> JointStates:
    """Joint states in rad (or m).

    Parameters
    ----------
    states :
        As recorded.
    options :
        With `degrees`, `prismatic` and `scale`.
    are_normalised :
        Whether they are those of a LeRobot dataset, whose grippers are in per cent.

    Raises
    ------
    RecordingError
        If a joint with a scale is unknown.
    """
    for name in options.scale:
        if name not in states.joint_names:
            raise RecordingError(f"--scale: {unknown_name('joint', name, states.joint_names)}")
    factors, notes = {name: float(x) for name, x in options.scale.items()}, []
    if options.degrees:
        left = {name for name in options.prismatic if name in states.joint_names}
        grippers = {x for x in states.joint_names if are_normalised and "gripper" in x.lower()}
        left = (left | grippers) - factors.keys()
        angles = [x for x in states.joint_names if x not in left and x not in factors]
        shares = states.positions[:, states.columns(angles)]
        if are_normalised and angles and not (np.abs(shares) > 100.5).any():
            notes.append(NORMALISED)
        is_arm = (options.joints is None or options.moving_only) and angles
        gone = grippers & left if is_arm else set()
        if left - gone:
            notes.append(f"not converted from degrees: {quote_names(sorted(left - gone))}")
        if gone:
            states = states.without(gone)
            notes.append(
                f"left out, as LeRobot states grippers in per cent: {quote_names(sorted(gone))}; "
                "--scale or --joints takes them (scale=, joints=)"
            )
        factors |= dict.fromkeys(angles, np.pi / 180.0)
    states = states.scaled(factors) if factors else states
    return replace(states, notes=(*states.notes, *notes), were_degrees=options.degrees)


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


def inspect_recording(path: str | Path, **options: Any) -> dict[str, Any]:
    """Inspect a recording; defects that make it unusable are reported, not raised.

    Parameters
    ----------
    path :
        The recording.
    **options :
        Fields of :class:`.LoadOptions`, such as `topic` and `degrees`.

    Returns
    -------
    facts : dict
        Its `name`, `path` and `format`; all `topics` of a bag with their types and counts; of its
        joint states `topic`, `n_messages`, `joint_names`, `rate` [Hz], `duration` [s], the number
        of `episodes`, `repairs` that are needed and `notes`; `refusal`, the reason why they can't
        be used, if so.

    Raises
    ------
    RecordingError
        If there is nothing at the path, more than one recording, or something else.
    """
    paths = bags.find_recordings([path])
    if len(paths) > 1:
        raise RecordingError(f"there are {len(paths)} recordings at '{path}': inspect one of them")
    (recording,), settings = paths, LoadOptions(**options)
    facts: dict[str, Any] = {
        **{"name": bags.recording_names(paths)[0], "path": str(recording)},
        **{"format": bags.recording_format(recording), "topics": (), "topic": None},
        **{"n_messages": 0, "joint_names": (), "rate": None, "duration": None},
        **{"episodes": None},
        **{"repairs": {}, "notes": (), "refusal": None},
    }
    try:
        if facts["format"] not in FORMATS:
            with bags.open_bag(recording, salvage=settings.salvage) as bag:
                facts["topics"] = tuple(asdict(topic) for topic in bag.topics)
        clean = read_recording(recording, settings)
        found = vars(clean) | {"notes": clean.all_notes}
        facts["episodes"] = len(clean.episodes) or None
    except UnusableRecordingError as error:
        found = error.findings
        facts["refusal"] = str(error)
    except RecordingError as error:
        return facts | {"refusal": str(error)}
    of_states = ("topic", "n_messages", "rate", "duration", "repairs", "notes")
    facts |= {name: found[name] for name in of_states if name in found}
    return facts | {"joint_names": found["listed_joints"]}
