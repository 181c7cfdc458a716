# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Files of trajectories."""

from __future__ import annotations

import io
import json
from pathlib import Path

import numpy as np

from ..arrays import FloatArray
from ..exceptions import PlannerError
from ..files import write_whole
from .trajectory import Trajectory


def trajectory_columns(trajectory: Trajectory) -> dict[str, FloatArray]:
    """Times and values of all points, by the names of the public interface."""
    names = ("times", "positions", "velocities", "accelerations", "efforts")
    columns = {name: getattr(trajectory, name) for name in names}
    return {name: values for name, values in columns.items() if values is not None}


def write_trajectory(trajectory: Trajectory, path: Path, *, overwrite: bool = False) -> None:
    """Write a trajectory in the format of the file's ending.

    Parameters
    ----------
    trajectory : Trajectory
        The trajectory.
    path : Path
        A .csv, .json or .npz file, or a bag.
    overwrite : bool
        Whether an existing file may be replaced.

    Raises
    ------
    PlannerError
        If the format is unknown or the file can't be written.
    """
    content = {".csv": _csv, ".json": _json, ".npz": _npz}.get(path.suffix)
    if content is not None:
        write_whole(path, content(trajectory), overwrite=overwrite)
        return
    check_format(path)
    # Imported late, because `motion` must not depend on `recordings` at import.
    from ..recordings.bags import write_joint_trajectory

    write_joint_trajectory(path, trajectory, overwrite=overwrite)


def check_format(path: Path) -> None:
    """Reject a file whose ending is not that of a trajectory format."""
    from ..recordings.bags import FORMAT_OF_SUFFIX

    formats = (".csv", ".json", ".npz", *FORMAT_OF_SUFFIX)
    if path.suffix not in ("", *formats):
        raise PlannerError(
            f"the output '{path}' must end in {', '.join(formats)}, "
            "or have no ending for the folder of a rosbag2"
        )


def _csv(trajectory: Trajectory) -> bytes:
    columns = trajectory_columns(trajectory)
    table = np.column_stack(list(columns.values()))
    kinds = list(columns)[1:]
    header = ["time", *(f"{name}.{kind}" for kind in kinds for name in trajectory.joint_names)]
    text = io.StringIO()
    # 17 digits restore every number exactly.
    np.savetxt(text, table, "%.17g", delimiter=",", header=",".join(header), comments="")
    return text.getvalue().encode()


def _json(trajectory: Trajectory) -> bytes:
    columns = {name: values.tolist() for name, values in trajectory_columns(trajectory).items()}
    return json.dumps({"joint_names": trajectory.joint_names, **columns}, indent=2).encode()


def _npz(trajectory: Trajectory) -> bytes:
    buffer = io.BytesIO()
    np.savez(
        buffer,
        joint_names=np.array(trajectory.joint_names),
        **trajectory_columns(trajectory),  # type: ignore[arg-type]  # its stub takes bool only
    )
    return buffer.getvalue()
