# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Files of planned motions: tables, JSON, NumPy archives and bags."""

from __future__ import annotations

import io
import json
from pathlib import Path

import numpy as np

from ..exceptions import PlannerError
from ..files import write_whole
from ..motion.trajectory import Trajectory
from .bags import FORMAT_OF_SUFFIX, write_joint_trajectory


def save_trajectory(trajectory: Trajectory, path: Path, *, overwrite: bool = False) -> None:
    """Write a trajectory to a file, see :meth:`.Trajectory.save`.

    Raises
    ------
    PlannerError
        If the format is unknown, the file exists and may not be overwritten, or it can't be
        written.
    """
    check_format(path)
    if content := {".csv": _csv, ".json": _json, ".npz": _npz}.get(path.suffix):
        write_whole(path, content(trajectory), overwrite=overwrite)
    else:
        write_joint_trajectory(path, trajectory, overwrite=overwrite)


def check_format(path: Path) -> None:
    """Reject a file whose ending is not that of a trajectory format."""
    formats = (".csv", ".json", ".npz", *FORMAT_OF_SUFFIX)
    if path.suffix not in ("", *formats):
        raise PlannerError(
            f"the output '{path}' must end in {', '.join(formats)}, "
            "or have no ending for the folder of a rosbag2"
        )


def _csv(trajectory: Trajectory) -> bytes:
    blocks = trajectory.columns()
    names = [f"{joint}.{kind}" for kind in list(blocks)[1:] for joint in trajectory.joint_names]
    table, header = np.column_stack(list(blocks.values())), ",".join(["time", *names])
    text = io.StringIO()
    # 17 digits restore every number exactly.
    np.savetxt(text, table, "%.17g", delimiter=",", header=header, comments="")
    return text.getvalue().encode()


def _json(trajectory: Trajectory) -> bytes:
    columns = {name: values.tolist() for name, values in trajectory.columns().items()}
    return json.dumps({"joint_names": trajectory.joint_names, **columns}, indent=2).encode()


def _npz(trajectory: Trajectory) -> bytes:
    buffer = io.BytesIO()
    np.savez(
        buffer,
        joint_names=np.array(trajectory.joint_names),
        **trajectory.columns(),  # type: ignore[arg-type]  # its stub takes bool only
    )
    return buffer.getvalue()
