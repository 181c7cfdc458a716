# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Bags of joint states or of a trajectory."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from ...arrays import frozen_array, unique_names
from ...exceptions import RecordingError
from ...files import exists_already, replace_path, take_free_name, workspace_beside
from ...motion.trajectory import Trajectory
from ..byte_layout import NS_PER_S
from .discovery import FORMAT_OF_SUFFIX, BagFormat, recordings_in
from .serialisation import (
    JOINT_STATE,
    JOINT_TRAJECTORY,
    header,
    known_types,
    write_messages,
)


def write_joint_states(
    path: str | Path,
    bag_format: BagFormat,
    joint_names: Sequence[str],
    stamps_ns: ArrayLike,
    positions: ArrayLike,
    velocities: ArrayLike | None = None,
    efforts: ArrayLike | None = None,
    *,
    overwrite: bool = False,
) -> None:
    """Write joint states as a bag on the topic /joint_states, atomically.

    Parameters
    ----------
    path :
        Where to write. For `bag_format` "rosbag1" a file. For the others a rosbag2 folder, or
        only its storage file if the path ends in .db3 or .mcap.
    bag_format :
        The format: "rosbag1", "sqlite3" or "mcap".
    joint_names :
        Names of the joints.
    stamps_ns : array of int, shape (n_steps,)
        Header stamps and times of reception [ns].
    positions, velocities, efforts : array, shape (n_steps, n_joints)
        Joint positions [rad or m], velocities [/s] and efforts [N·m or N]; the last two stay
        empty unless given.
    overwrite :
        Whether an existing file or folder may be replaced.

    Raises
    ------
    RecordingError
        If the shapes disagree.
    PlannerError
        If there is something at the path already, or it can't be written.
    """
    names = unique_names(joint_names, "joints to write", RecordingError)
    stamps = np.asarray(stamps_ns, dtype=np.int64)
    if stamps.ndim != 1:
        raise RecordingError("stamps to write must be one list of nanoseconds, one for each step")
    fields = [
        np.empty((stamps.size, 0))
        if values is None
        else frozen_array(values, (stamps.size, len(names)), what, RecordingError)
        for what, values in (
            ("positions to write", positions),
            ("velocities to write", velocities),
            ("efforts to write", efforts),
        )
    ]
    kind = known_types(bag_format).types[JOINT_STATE]
    messages = (
        (int(stamp), kind(header(bag_format, int(stamp)), list(names), *rows))
        for stamp, *rows in zip(stamps, *fields, strict=True)
    )
    _write(Path(path), bag_format, "/joint_states", JOINT_STATE, messages, overwrite)


def write_joint_trajectory(
    path: str | Path,
    trajectory: Trajectory,
    topic: str = "/joint_trajectory",
    *,
    overwrite: bool = False,
) -> None:
    """Write a trajectory as a bag that holds it as one JointTrajectory message at time 0.

    Parameters
    ----------
    path :
        Where to write: a ROS 1 bag if it ends in .bag, a bare storage file if it ends in .db3 or
        .mcap, else a rosbag2 folder (mcap).
    trajectory :
        The trajectory.
    topic :
        Name of the topic.
    overwrite :
        Whether an existing file or folder may be replaced.

    Raises
    ------
    PlannerError
        If there is something at the path already, or it can't be written.
    """
    target = Path(path)
    bag_format = FORMAT_OF_SUFFIX.get(target.suffix, "mcap")
    types = known_types(bag_format).types
    empty = np.empty(0)
    points = [
        types["trajectory_msgs/msg/JointTrajectoryPoint"](
            positions=trajectory.positions[step],
            velocities=trajectory.velocities[step],
            accelerations=trajectory.accelerations[step],
            effort=empty if trajectory.efforts is None else trajectory.efforts[step],
            time_from_start=types["builtin_interfaces/msg/Duration"](
                *divmod(round(float(time) * NS_PER_S), NS_PER_S)
            ),
        )
        for step, time in enumerate(trajectory.times)
    ]
    message = types[JOINT_TRAJECTORY](header(bag_format, 0), list(trajectory.joint_names), points)
    _write(target, bag_format, topic, JOINT_TRAJECTORY, [(0, message)], overwrite)


def _write(
    target: Path,
    bag_format: BagFormat,
    topic: str,
    kind: str,
    messages: Iterable[tuple[int, object]],
    overwrite: bool,
) -> None:
    """Write a bag under a temporary name and rename it when it is complete."""
    if target.exists() and not overwrite:
        raise exists_already(target)
    if target.is_dir() and any(target.iterdir()) and recordings_in(target) != [target]:
        raise RecordingError(f"'{target}' is a folder, but no recording: it is not overwritten")
    if bag_format == "sqlite3" and set(str(target.absolute())) & set("?#%"):
        raise RecordingError(
            f"'{target}' can't be written as sqlite3: choose a path without '?', '#' and '%'"
        )
    try:
        with workspace_beside(target) as workspace:
            written = write_messages(workspace / target.name, bag_format, topic, kind, messages)
            _keep_on_disk(written)
            (replace_path if overwrite else take_free_name)(written, target)
            _sync(target.parent)
    except FileExistsError:
        raise exists_already(target) from None
    except OSError as error:
        raise RecordingError(f"'{target}' can't be written: {error.strerror or error}") from None


def _keep_on_disk(path: Path) -> None:
    """Flush a complete bag to disk, so that it survives a loss of power."""
    for file in (*path.glob("*"), path):
        _sync(file)


def _sync(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
