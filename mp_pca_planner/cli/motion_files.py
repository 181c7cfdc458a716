# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Files that the planning commands write motions to."""

from __future__ import annotations

import argparse
import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import FloatArray
from ..exceptions import PlannerError
from ..files import check_writable, write_whole
from ..motion.trajectory import Trajectory
from ..planning.plan import Plan
from ..planning.sequence import SequencePlan
from ..plotting.drawing import require_matplotlib
from ..recordings.bags import FORMAT_OF_SUFFIX, write_joint_trajectory
from .common import check_output, json_text
from .terminal import written_lines


def check_outputs(arguments: argparse.Namespace) -> None:
    """Refuse a motion's output or plot that could not be written, before any work.

    Raises
    ------
    PlannerError
        If a format is unknown, a file exists already, a folder doesn't, or matplotlib is missing.
    """
    if arguments.output is not None:
        check_format(arguments.output)
        check_writable(arguments.output, overwrite=arguments.force)
    if arguments.plot is not None:
        require_matplotlib()
        check_output(arguments.plot, ".png", force=arguments.force)


def output_lines(arguments: argparse.Namespace, plan: Plan | SequencePlan) -> list[str]:
    """Which files the command wrote, and which it did not."""
    if plan.is_executable or arguments.output is None:
        return written_lines([arguments.output, arguments.plot])
    return [f"not written  {arguments.output}", *written_lines([arguments.plot])]


def trajectory_columns(trajectory: Trajectory) -> dict[str, FloatArray]:
    """What is known at every point, by the names of the public interface."""
    efforts = trajectory.efforts
    return {
        "times": trajectory.times,
        "positions": trajectory.positions,
        "velocities": trajectory.velocities,
        "accelerations": trajectory.accelerations,
        **({} if efforts is None else {"efforts": efforts}),
    }


def write_trajectory(
    trajectory: Trajectory, path: Path, facts: Mapping[str, Any], overwrite: bool
) -> None:
    """Write a motion in the format that the file's name asks for.

    Parameters
    ----------
    trajectory : Trajectory
        The motion.
    path : Path
        Where to.
    facts : mapping
        What a .json file says.
    overwrite : bool
        Whether an existing file may be overwritten.

    Raises
    ------
    PlannerError
        If the format is unknown or the file can't be written.
    """
    if path.suffix == ".csv":
        write_whole(path, _csv(trajectory), overwrite=overwrite)
    elif path.suffix == ".json":
        write_whole(path, json_text(facts).encode(), overwrite=overwrite)
    elif path.suffix == ".npz":
        buffer = io.BytesIO()
        np.savez(
            buffer,
            joint_names=np.array(trajectory.joint_names),
            **trajectory_columns(trajectory),  # type: ignore[arg-type]  # its stub takes bool only
        )
        write_whole(path, buffer.getvalue(), overwrite=overwrite)
    else:
        check_format(path)
        write_joint_trajectory(path, trajectory, overwrite=overwrite)


def check_format(path: Path) -> None:
    """Refuse a file of a format that motions can't be written in."""
    formats = (".csv", ".json", ".npz", *FORMAT_OF_SUFFIX)
    if path.suffix not in ("", *formats):
        raise PlannerError(
            f"the output '{path}' must end in {', '.join(formats)}, "
            "or have no ending for the folder of a rosbag2"
        )


def _csv(trajectory: Trajectory) -> bytes:
    columns = trajectory_columns(trajectory)
    times = columns.pop("times")
    header = ["time", *(f"{name}.{kind}" for kind in columns for name in trajectory.joint_names)]
    text = io.StringIO()
    # 17 digits bring every number back to the last bit.
    np.savetxt(
        text,
        np.column_stack([times, *columns.values()]),
        fmt="%.17g",
        delimiter=",",
        header=",".join(header),
        comments="",
    )
    return text.getvalue().encode()
