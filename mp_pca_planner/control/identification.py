# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Recordings that hold efforts: what an execution cost, and friction and rotor inertias of joints.

Measured efforts minus the inverse dynamics of the model are taken, joint by joint, as

    offset + friction · sign(q̇) + viscous · q̇ + armature · q̈

by least squares. Standard errors are those of the jackknife over parts of the recordings, because
neighbouring samples are not independent.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.integrate import trapezoid

from ..arrays import FloatArray
from ..exceptions import ControlError, RecordingError, quote_names
from ..motion.interpolation import interpolate
from ..motion.trajectory import Trajectory
from ..recordings.bags import JOINT_STATE, Bag, Stored, choose_topic, open_bag
from ..recordings.joint_states import NS_PER_S
from ..recordings.repair import Piece
from ..recordings.segmentation import SmoothPiece, smooth
from ..robot.model import Robot

# Samples and seconds of a part that is used, and the gap that ends a part in usual intervals.
_MIN_SAMPLES, _MIN_SECONDS, _MAX_GAP = 50, 1.0, 5.0
# Resolution of the search for the start of a motion in a recording [s].
_STEP = 0.005


MeasuredMotion = tuple[SmoothPiece, FloatArray]
"""A part of a recording without interruption; its efforts [N·m or N], shape (n_steps, n_joints).

Efforts pass through the same low-pass as positions.
"""


def measured_states(
    path: Path, joint_names: Sequence[str]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Times from 0 [s], positions and efforts of a recording of joint states.

    Parameters
    ----------
    path :
        The recording, a bag.
    joint_names :
        Names of the n_joints joints; messages that lack one of them are left out.

    Returns
    -------
    times : array, shape (n_steps,)
        Strictly increasing.
    positions, efforts : array, shape (n_steps, n_joints)
        In [rad or m] and [N·m or N].

    Raises
    ------
    RecordingError
        If it can't be read, lacks positions or efforts of a joint, or holds numbers that aren't
        finite.
    """
    with open_bag(path) as bag:
        chosen = choose_topic([t for t in bag.topics if t.type == JOINT_STATE])
        rows = bag.read([chosen], lambda stored: _rows(bag, stored, joint_names))
    if len(rows) < 2:
        raise RecordingError(
            f"'{path}' has no joint states of {quote_names(joint_names)} on '{chosen.name}'"
        )
    stamps = np.array(sorted(rows), dtype=np.int64)
    values = np.array([rows[stamp] for stamp in stamps.tolist()])
    if not np.isfinite(values).all():
        raise RecordingError(
            f"positions or efforts on '{chosen.name}' of '{path}' are not all finite"
        )
    n_joints = len(joint_names)
    return (stamps - stamps[0]) * 1e-9, values[:, :n_joints], values[:, n_joints:]


def _rows(bag: Bag, stored: Iterator[Stored], joint_names: Sequence[str]) -> dict[int, FloatArray]:
    """Positions and efforts of the joints by stamp [ns]."""
    rows: dict[int, FloatArray] = {}
    for topic, received, data in stored:
        message = bag.deserialise(topic, data)
        if not set(joint_names) <= set(message.name):
            continue  # of other joints, a gripper's for example
        if len(message.effort) != len(message.name) or len(message.position) != len(message.name):
            raise RecordingError(
                f"the joint states on '{topic.name}' of '{bag.path}' lack positions or efforts: "
                "both are needed"
            )
        index = [message.name.index(name) for name in joint_names]
        stamp = message.header.stamp.sec * NS_PER_S + message.header.stamp.nanosec
        rows[stamp or received] = np.concatenate([message.position[index], message.effort[index]])
    return rows


def measured_motions(path: Path, joint_names: Sequence[str]) -> list[MeasuredMotion]:
    """Smooth motions with efforts, between the gaps of a recording.

    Parameters
    ----------
    path, joint_names :
        See :func:`measured_states`.

    Raises
    ------
    RecordingError
        As for these, or if all efforts are 0, or no part is long enough.
    """
    times, positions, efforts = measured_states(path, joint_names)
    if not efforts.any():
        raise RecordingError(f"all efforts in '{path}' are 0: expected measured efforts")
    intervals, found = np.diff(times), list[MeasuredMotion]()
    rate = 1.0 / float(np.median(intervals))
    gaps = np.flatnonzero(intervals > _MAX_GAP / rate) + 1
    angles = np.unwrap(positions, axis=0)
    for part in np.split(np.arange(times.size), gaps):
        if part.size >= _MIN_SAMPLES and times[part[-1]] - times[part[0]] >= _MIN_SECONDS:
            curve = smooth(Piece(times[part], angles[part]), rate)
            effort = smooth(Piece(times[part], efforts[part]), rate).positions
            found.append((curve, effort))
    if not found:
        raise RecordingError(
            f"'{path}' has no joint states for {_MIN_SECONDS:g} s without a gap; record longer "
            "motions"
        )
    return found


def measure_execution(path: Path, trajectory: Trajectory) -> tuple[float, float, float]:
    """Find a trajectory's execution in a recording, and measure it.

    It starts where the recorded positions follow the desired ones best.

    Parameters
    ----------
    path : Path
        The recording, with one topic of joint states with efforts.
    trajectory : Trajectory
        The executed motion.

    Returns
    -------
    effort : float
        Measured ½∫‖τ‖²dt over the time of the motion [N²·m²·s].
    tracking_error : float
        RMS over time of the distance ‖q − q_desired‖ [rad or m].
    started : float
        Start of the motion after the first joint state of the recording [s].

    Raises
    ------
    RecordingError
        If it can't be read, lacks positions or efforts of a joint, holds numbers that aren't
        finite, or is shorter than the trajectory.
    """
    times, q, tau = measured_states(path, trajectory.joint_names)
    duration = float(trajectory.times[-1])
    spare = float(times[-1]) - duration
    if spare < -_STEP:
        raise RecordingError(
            f"'{path}' lasts {times[-1]:.3f} s, but the executed motion {duration:.3f} s: "
            "record it from its start to its end"
        )
    desired = interpolate(trajectory, _STEP)
    starts = np.arange(0.0, max(spare, 0.0) + _STEP, _STEP)
    errors = [_distance(times - start, q, desired.times, desired.q) for start in starts]
    best = int(np.argmin(errors))
    grid = np.union1d(desired.times + starts[best], times)
    grid = grid[(grid >= starts[best]) & (grid <= starts[best] + duration)]
    squares = np.sum(_at(grid, times, tau) ** 2, axis=1)
    return 0.5 * float(trapezoid(squares, grid)), errors[best], float(starts[best])


def _distance(times: FloatArray, q: FloatArray, when: FloatArray, desired: FloatArray) -> float:
    squares = np.sum((_at(when, times, q) - desired) ** 2, axis=1)
    return float(np.sqrt(trapezoid(squares, when) / (when[-1] - when[0])))


def _at(when: FloatArray, times: FloatArray, values: FloatArray) -> FloatArray:
    return np.column_stack([np.interp(when, times, column) for column in values.T])


# Speed from which friction has its full size, as a share of the largest, and at least [rad/s].
_MOVING_SHARE, _MOVING = 0.05, 0.02
# Seconds of motion that are needed in each direction, and those around a reversal that are left out
# because efforts are filtered.
_MIN_MOVING, _REVERSAL = 1.0, 0.12
_N_PARTS = 12
# Standard errors within which a value may lie.
_SURE = 2.0


@dataclass(frozen=True, eq=False)
class Identification:
    """Friction and rotor inertias of joints.

    Attributes
    ----------
    joint_names : tuple of str
        The n_joints joints of the robot.
    values, errors : array, shape (3, n_joints)
        Coulomb friction [N·m or N], viscous friction [N·m·s/rad or N·s/m] and rotor inertia [kg·m²
        or kg], with their standard errors; NaN for joints that are rejected.
    unexplained : array, shape (n_joints,)
        RMS of the efforts that neither the model nor these values explain [N·m or N].
    rejected : dict of str to str
        By joint, why its recordings determine nothing.
    """

    joint_names: tuple[str, ...]
    values: FloatArray
    errors: FloatArray
    unexplained: FloatArray
    rejected: dict[str, str]

    def friction(self, speeds: FloatArray, otherwise: FloatArray) -> FloatArray:
        """Largest friction to expect, two standard errors above the identified one.

        Parameters
        ----------
        speeds : array, shape (n_joints,)
            Largest speeds of the motion [rad/s or m/s].
        otherwise : array, shape (n_joints,)
            Friction of joints that are rejected.
        """
        coulomb, viscous = np.maximum(self.values[:2], 0.0) + _SURE * self.errors[:2]
        found = coulomb + viscous * speeds
        return np.where(np.isnan(found), otherwise, found)

    @property
    def armature(self) -> FloatArray:
        """Rotor inertias; 0 where they are not significant, shape (n_joints,)."""
        sure = self.values[2] > _SURE * self.errors[2]
        return np.where(sure, self.values[2], 0.0)

    def summary(self) -> dict[str, Any]:
        """All results, of JSON types."""
        names = ("friction", "viscous_friction", "armature")
        return {
            **{name: row.tolist() for name, row in zip(names, self.values, strict=True)},
            "standard_errors": self.errors.tolist(),
            "unexplained": self.unexplained.tolist(),
            "rejected": self.rejected,
        }


def identify(robot: Robot, motions: Sequence[MeasuredMotion]) -> Identification:
    """Identify friction and rotor inertias.

    Parameters
    ----------
    robot : Robot
        The model, without rotor inertias.
    motions : sequence of MeasuredMotion
        Motions of its joints, see :func:`.measured_motions`.

    Raises
    ------
    ControlError
        If no joint can be identified.
    RobotError
        If a moving link has no valid inertia.
    """
    robot.require_inertias("the identification of friction")
    curves = [curve for curve, _ in motions]
    v = np.concatenate([curve.velocities for curve in curves])
    a = np.concatenate([curve.accelerations for curve in curves])
    rest = np.concatenate(
        [
            efforts - robot.inverse_dynamics(curve.positions, curve.velocities, curve.accelerations)
            for curve, efforts in motions
        ]
    )
    n, rate, rejected = robot.n_joints, curves[0].rate, dict[str, str]()
    values, errors, unexplained = (np.full(shape, np.nan) for shape in ((3, n), (3, n), n))
    for j, name in enumerate(robot.joint_names):
        slow = max(_MOVING, _MOVING_SHARE * float(np.abs(v[:, j]).max()))
        is_slow, width = np.abs(v[:, j]) <= slow, np.ones(round(_REVERSAL * rate) + 1)
        moving = np.convolve(is_slow, width, mode="same") < 0.5
        seconds = [float(np.sum(side[moving] > 0.0)) / rate for side in (v[:, j], -v[:, j])]
        if min(seconds) < _MIN_MOVING:
            rejected[name] = (
                f"it moves for {seconds[0]:.1f} s forwards and {seconds[1]:.1f} s backwards; "
                f"{_MIN_MOVING:g} s in both directions are needed"
            )
            continue
        rates = v[moving, j]
        rows = np.column_stack([np.sign(rates), rates, a[moving, j], np.ones(rates.size)])
        found, spread, rms = _least_squares(rows, rest[moving, j])
        dissipated = float(np.mean(np.abs(rates) * found[0] + rates**2 * found[1]))
        doubt = float(np.mean(np.abs(rates) * spread[0] + rates**2 * spread[1]))
        if dissipated < -_SURE * doubt:
            rejected[name] = (
                "its efforts minus those of the model drive the motion instead of resisting it; "
                "check the sign of the efforts and the inertias of the robot description"
            )
            continue
        values[:, j], errors[:, j], unexplained[j] = found[:3], spread[:3], rms
    if len(rejected) == n:
        name, reason = next(iter(rejected.items()))
        raise ControlError(f"no joint can be identified; joint '{name}': {reason}")
    return Identification(robot.joint_names, values, errors, unexplained, rejected)


def _least_squares(rows: FloatArray, rest: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Coefficients, their standard errors, and the RMS of the residual."""
    found = np.linalg.lstsq(rows, rest, rcond=None)[0]
    without = []
    for part in np.array_split(np.arange(len(rest)), _N_PARTS):
        others = np.delete(rows, part, axis=0), np.delete(rest, part)
        without.append(np.linalg.lstsq(*others, rcond=None)[0])
    scatter = np.sum((np.array(without) - np.mean(without, axis=0)) ** 2, axis=0)
    residual = rest - rows @ found
    spread = np.sqrt((_N_PARTS - 1) / _N_PARTS * scatter)
    rms = float(np.sqrt(np.mean(residual**2)))
    return np.asarray(found), np.asarray(spread), rms
