# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Files that the planning commands write motions to: CSV, JSON, NumPy arrays and bags."""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import FloatArray
from ..exceptions import PlannerError
from ..files import check_writable, write_whole
from ..motion.trajectory import Trajectory
from ..recordings.bags import FORMAT_OF_SUFFIX, write_joint_trajectory
from .common import json_text


def check_motion_file(path: Path | None, *, force: bool) -> None:
    """Refuse a file of a motion that could not be written, before the work.

    Raises
    ------
    PlannerError
        If its format is unknown, or it could not be written.
    """
    if path is None:
        return
    formats = (".csv", ".json", ".npz", *FORMAT_OF_SUFFIX)
    if path.suffix not in ("", *formats):
        raise PlannerError(
            f"the output '{path}' must end in {', '.join(formats)}, "
            "or have no ending for the folder of a rosbag2"
        )
    check_writable(path, overwrite=force)


def trajectory_columns(trajectory: Trajectory) -> dict[str, FloatArray]:
    """Values at every point, by the names of the public interface."""
    efforts = trajectory.efforts
    return {
        "times": trajectory.times,
        "positions": trajectory.positions,
        "velocities": trajectory.velocities,
        "accelerations": trajectory.accelerations,
        **({} if efforts is None else {"efforts": efforts}),
    }


def write_motion(
    path: Path | None, trajectory: Trajectory, facts: Mapping[str, Any], *, force: bool
) -> None:
    """Write a motion in the format of the file's name.

    Parameters
    ----------
    path : Path or None
        The file, accepted by :func:`check_motion_file`; None writes nothing.
    trajectory : Trajectory
        The motion.
    facts : mapping
        Content of a .json file.
    force : bool
        Whether an existing file may be overwritten.

    Raises
    ------
    PlannerError
        If the file can't be written.
    """
    if path is None:
        return
    contents = {
        ".csv": lambda: _csv(trajectory),
        ".json": lambda: json_text(facts).encode(),
        ".npz": lambda: _npz(trajectory),
    }
    if path.suffix in contents:
        write_whole(path, contents[path.suffix](), overwrite=force)
    else:
        write_joint_trajectory(path, trajectory, overwrite=force)


def _npz(trajectory: Trajectory) -> bytes:
    content = io.BytesIO()
    arrays: dict[str, Any] = {**trajectory_columns(trajectory)}
    np.savez(content, joint_names=np.array(trajectory.joint_names), **arrays)
    return content.getvalue()


def _csv(trajectory: Trajectory) -> bytes:
    columns = trajectory_columns(trajectory)
    times = columns.pop("times")
    header = ["time", *(f"{name}.{kind}" for kind in columns for name in trajectory.joint_names)]
    content = io.BytesIO()
    np.savetxt(
        content,
        np.column_stack([times, *columns.values()]),
        fmt="%.17g",  # brings every number back to the last bit
        delimiter=",",
        header=",".join(header),
        comments="",
        encoding="utf-8",
    )
    return content.getvalue()
