# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A sampled joint motion, the result of planning, and its files."""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import FloatArray, check_type, frozen_array, set_frozen, unique_names
from ..exceptions import PlannerError, TrajectoryError, require
from ..files import as_path, read_bytes, reading, write_whole
from ..input_limits import INPUT_LIMITS


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Samples of a joint motion, immutable.

    Attributes
    ----------
    joint_names : tuple of str
        Names of the joints, n_joints of them.
    times : array, shape (n_steps,)
        Times since the start [s]; the first is 0, strictly increasing.
    positions, velocities, accelerations : array, shape (n_steps, n_joints)
        Joint positions [rad or m] and their derivatives [/s, /s²].
    efforts : array, shape (n_steps, n_joints), or None
        Joint torques [N·m] or forces [N], if they were computed.

    Raises
    ------
    TrajectoryError
        If shapes disagree, a number is not finite, or the times don't increase from 0.

    Examples
    --------
    >>> import mp_pca_planner as mp
    >>> zero = [[0.0], [0.0]]
    >>> mp.Trajectory(["elbow"], [0.0, 1.0], [[0.0], [0.5]], zero, zero)
    Trajectory: 1 joints, 2 points, 1 s
    """

    joint_names: tuple[str, ...]
    times: FloatArray
    positions: FloatArray
    velocities: FloatArray
    accelerations: FloatArray
    efforts: FloatArray | None = None

    def __init__(
        self,
        joint_names: Sequence[str],
        times: ArrayLike,
        positions: ArrayLike,
        velocities: ArrayLike,
        accelerations: ArrayLike,
        efforts: ArrayLike | None = None,
    ) -> None:
        names = unique_names(joint_names, "joints of a trajectory", TrajectoryError)
        stamps = frozen_array(times, (None,), "times", TrajectoryError)
        shape = (stamps.size, len(names))
        if stamps.size == 0:
            raise TrajectoryError("a trajectory needs at least one point, got none")
        if stamps[0] != 0.0 or np.any(np.diff(stamps) <= 0.0):
            raise TrajectoryError("times must start at 0 and strictly increase")
        set_frozen(self, joint_names=names, times=stamps, efforts=None)
        columns = {"positions": positions, "velocities": velocities, "accelerations": accelerations}
        if efforts is not None:
            columns["efforts"] = efforts
        for field, values in columns.items():
            set_frozen(self, **{field: frozen_array(values, shape, field, TrajectoryError)})

    def __repr__(self) -> str:
        return f"Trajectory: {self.n_joints} joints, {self.n_steps} points, {self.duration:.3g} s"

    @property
    def n_joints(self) -> int:
        """Number of joints."""
        return len(self.joint_names)

    @property
    def n_steps(self) -> int:
        """Number of points."""
        return int(self.times.size)

    @property
    def duration(self) -> float:
        """Time from the first to the last point [s]."""
        return float(self.times[-1])

    @property
    def states(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Positions, velocities and accelerations."""
        return self.positions, self.velocities, self.accelerations

    @property
    def effort_cost(self) -> float:
        """J = ½∫‖τ‖²dt [N²·m²·s], by the trapezoidal rule; NaN without efforts."""
        if self.efforts is None:
            return float("nan")
        power = np.square(self.efforts).sum(axis=1)
        return float(0.25 * np.diff(self.times) @ (power[1:] + power[:-1]))

    def columns(self) -> dict[str, FloatArray]:
        """Times and values of all points, by the names of the public interface.

        Values have the shape (n_steps, n_joints); :meth:`table` has a column for each joint.
        """
        names = ("times", "positions", "velocities", "accelerations", "efforts")
        columns = {name: getattr(self, name) for name in names}
        return {name: values for name, values in columns.items() if values is not None}

    def table(self) -> dict[str, FloatArray]:
        """Columns of the CSV file, each of shape (n_steps,), as of ``pandas.DataFrame(table)``.

        They are called time [s], NAME.positions [rad or m], NAME.velocities and so on.
        """
        blocks = self.columns()
        columns = {"time": blocks.pop("times")}
        for kind, values in blocks.items():
            names = [f"{name}.{kind}" for name in self.joint_names]
            columns |= dict(zip(names, values.T, strict=True))
        return columns

    def with_efforts(self, efforts: FloatArray | None) -> Trajectory:
        """The same points with efforts [N·m or N], shape (n_steps, n_joints), or without any."""
        other, shape = copy(self), self.positions.shape
        if efforts is not None:
            efforts = frozen_array(efforts, shape, "efforts", TrajectoryError)
        set_frozen(other, efforts=efforts)
        return other

    def plot(self, axes: Any = None) -> Any:
        """Plot the motion on Matplotlib Axes; return an array of these.

        Without `axes`, a new pyplot figure is drawn: ``plt.savefig("motion.png")`` writes it.
        With the array of another motion's figure, this motion is drawn over the other.
        """
        figures = import_module("..plotting.motion", __package__)
        return figures.plot_trajectory(self, axes)

    def save(self, path: str | Path, *, overwrite: bool = False) -> None:
        """Write the trajectory to a .csv, .json or .npz file, or to a bag.

        The columns are those of the command ``plan --output``; bags are .bag and .mcap files, and
        folders of rosbag2, which have no ending.

        Raises
        ------
        PlannerError
            If the format is unknown, the file exists and may not be overwritten, or it can't be
            written.
        """
        path = as_path(path)
        content = {".csv": _csv, ".json": _json, ".npz": _npz}.get(path.suffix)
        if content is not None:
            write_whole(path, content(self), overwrite=overwrite)
            return
        check_format(path)
        # Imported late, because `motion` must not depend on `recordings` at import.
        from ..recordings.bags import write_joint_trajectory

        write_joint_trajectory(path, self, overwrite=overwrite)

    @classmethod
    def load(cls, path: str | Path) -> Trajectory:
        """Read a trajectory that :meth:`save` wrote as a .csv, .json or .npz file.

        Raises
        ------
        TrajectoryError
            If it can't be read, or holds no trajectory.

        Examples
        --------
        >>> import mp_pca_planner as mp
        >>> zero = [[0.0], [0.0]]
        >>> motion = mp.Trajectory(["elbow"], [0.0, 1.0], [[0.0], [0.5]], zero, zero)
        >>> motion.save("motion.csv", overwrite=True)
        >>> mp.Trajectory.load("motion.csv")
        Trajectory: 1 joints, 2 points, 1 s
        """
        path = as_path(path, TrajectoryError)
        read = {".csv": _from_csv, ".json": _from_json, ".npz": _from_npz}.get(path.suffix)
        if read is None:
            raise TrajectoryError(f"'{path}' is not a .csv, .json or .npz file of a trajectory")
        with reading(f"the trajectory '{path}'", TrajectoryError):
            content = read(read_bytes(path, INPUT_LIMITS.primitive_bytes))
            names, columns = content.pop("joint_names"), content
            return cls(names, **{name: columns[name] for name in _COLUMNS if name in columns})

    def to_message(self, *, with_efforts: bool = False) -> Any:
        """Convert the trajectory to a ``trajectory_msgs/JointTrajectory``.

        Parameters
        ----------
        with_efforts : bool
            Whether points carry efforts; a controller without an effort interface refuses them.

        Raises
        ------
        MissingDependencyError
            If ROS 2 is not installed.
        TrajectoryError
            If efforts are requested and the trajectory has none, or that is no truth value.
        """
        check_type(with_efforts, "with_efforts", TrajectoryError, bool)
        names = ("rclpy.serialization", "trajectory_msgs.msg")
        serialization, messages = (require(name, "ros", "a message") for name in names)
        from ..ros.serialised import serialize_trajectory

        content = serialize_trajectory(self, with_efforts=with_efforts)
        return serialization.deserialize_message(content, messages.JointTrajectory)


def check_format(path: Path) -> None:
    """Reject a file whose ending is not that of a trajectory format."""
    from ..recordings.bags import FORMAT_OF_SUFFIX

    formats = (".csv", ".json", ".npz", *FORMAT_OF_SUFFIX)
    if path.suffix not in ("", *formats):
        raise PlannerError(
            f"the output '{path}' must end in {', '.join(formats)}, "
            "or have no ending for the folder of a rosbag2"
        )


_COLUMNS = ("times", "positions", "velocities", "accelerations", "efforts")


def _csv(trajectory: Trajectory) -> bytes:
    columns = trajectory.table()
    table, header = np.column_stack(list(columns.values())), ",".join(columns)
    text = io.StringIO()
    # 17 digits restore every number exactly.
    np.savetxt(text, table, "%.17g", delimiter=",", header=header, comments="")
    return text.getvalue().encode()


def _from_csv(content: bytes) -> dict[str, Any]:
    head, _, rows = content.decode().partition("\n")
    _, *header = head.split(",")
    if not header or not rows.strip():
        raise ValueError("it has no columns or no rows")
    table = np.loadtxt(io.StringIO(rows), delimiter=",", ndmin=2)
    kinds = list(dict.fromkeys(name.rpartition(".")[2] for name in header))
    names = [name.rpartition(".")[0] for name in header[: len(header) // len(kinds)]]
    blocks = np.split(table[:, 1:], len(kinds), axis=1)
    return {"joint_names": names, "times": table[:, 0], **dict(zip(kinds, blocks, strict=True))}


def _from_json(content: bytes) -> dict[str, Any]:
    return dict(json.loads(content))


def _from_npz(content: bytes) -> dict[str, Any]:
    with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
        return {name: arrays[name] for name in arrays.files if name in ("joint_names", *_COLUMNS)}


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
