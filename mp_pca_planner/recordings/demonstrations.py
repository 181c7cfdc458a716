# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Demonstrations from recordings, for use from Python."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from ..robot.model import Robot
from .load import RecordingSet, load_recordings


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
        Bag files, rosbag2 folders, folders of bags, glob patterns; one of them or several.
    robot : Robot or path of a URDF file, optional
        Its joints are taken, in its order; by default all that every message lists.
    **options :
        As of :func:`.load_recordings`: topic, joints, segment, segments_csv, jobs, …

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
    """
    joints = options.pop("joints", None)
    if isinstance(robot, (str, Path)):
        robot = Robot.from_file(robot, joints)
    recordings = load_recordings(paths, joints=robot.joint_names if robot else joints, **options)
    recordings.require_motion()
    return recordings
