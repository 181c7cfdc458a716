# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Demonstrations from recordings, and a recording to try it on, for use from Python."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from types import NoneType
from typing import Any

from ..arrays import as_list, check_number, check_type
from ..exceptions import RecordingError, RobotError
from ..files import as_path
from ..robot.model import Robot
from .bags import write_joint_states
from .load import load_recordings
from .recording_set import RecordingSet
from .synthetic import continuous_recording, generate_motions


def load_demonstrations(
    paths: str | Path | Iterable[str | Path],
    *,
    robot: Robot | str | Path | None = None,
    **options: Any,
) -> RecordingSet:
    """Load the demonstrated motions of recordings.

    Parameters
    ----------
    paths :
        Bag files, rosbag2 folders, CSV files, datasets of LeRobot, folders of bags and datasets,
        glob patterns; one of them or several.
    robot : Robot or path of a URDF file, optional
        Its joints are taken, in its order; by default all that every message lists. Of a file,
        the joints that never move in the recordings are left out and noted, such as a gripper's;
        `joints` or a `Robot` choose them all the same.
    **options :
        As of :func:`.load_recordings`: topic, joints, degrees, segment, segments_csv, jobs, …

    Returns
    -------
    recordings : RecordingSet
        A sequence of demonstrations; its `report` says what was repaired, cut and rejected.

    Raises
    ------
    RecordingError
        If no recording holds a usable motion, or an option is out of its range.
    RobotError
        If the URDF can't be read or lacks one of the joints.

    Examples
    --------
    >>> import mp_pca_planner as mp
    >>> bag = mp.write_example_recording("motions.mcap", 6)
    >>> mp.load_demonstrations(bag, robot=mp.config_file("human_arm.urdf"))
    RecordingSet: 11 demonstrations of 1 recording(s), 0 rejected
    """
    check_type(paths, "the paths of recordings", RecordingError, str, Path, Iterable)
    check_type(robot, "robot", RobotError, Robot, str, Path, NoneType)
    several = (
        [paths]
        if isinstance(paths, (str, Path))
        else as_list(paths, "the paths of recordings are needed", RecordingError)
    )
    for one in several:
        if not isinstance(one, str):  # an address, or a pattern
            as_path(one, RecordingError)
    joints = options.pop("joints", None)
    options.setdefault("moving_only", joints is None and isinstance(robot, (str, Path)))
    if isinstance(robot, (str, Path)):
        robot = Robot.from_file(robot, joints)
    joints = robot.joint_names if robot else joints
    options.setdefault("position_limits", position_limits(robot))
    recordings = load_recordings(several, joints=joints, same_joints=True, **options)
    recordings.require_motion()
    return recordings


def position_limits(robot: Robot | None) -> dict[str, tuple[float, float]]:
    """Least and largest position of a robot's joints by name [rad or m]; none without a robot."""
    if robot is None:
        return {}
    limits = robot.limits()
    pairs = zip(limits.lower.tolist(), limits.upper.tolist(), strict=True)
    return dict(zip(robot.joint_names, pairs, strict=True))


def write_example_recording(path: str | Path, n_motions: int = 40, *, seed: int = 1) -> Path:
    """Write a bag of arm-raising motions of the arm in ``config/human_arm.urdf``.

    Parameters
    ----------
    path : str or Path
        A file name ending in .mcap, or a rosbag2 folder; an existing one is replaced.
    n_motions : int
        Number of motions, at least 1.
    seed : int
        Selects the motions.

    Raises
    ------
    RecordingError
        If the number of motions is too small, or the file can't be written.

    Examples
    --------
    >>> import mp_pca_planner as mp
    >>> mp.write_example_recording("motions.mcap", 6).name
    'motions.mcap'
    """
    file = as_path(path, RecordingError)
    check_number(n_motions, "the number of motions", RecordingError, 1, 10_000, is_whole=True)
    check_number(seed, "the seed", RecordingError, 0, is_whole=True)
    recording = continuous_recording(generate_motions(n_motions, seed), seed=seed)
    names, stamps = recording.joint_names, recording.stamps
    write_joint_states(file, "mcap", names, stamps, recording.positions, overwrite=True)
    return file
