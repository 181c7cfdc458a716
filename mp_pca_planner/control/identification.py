# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Friction and rotor inertias of joints, identified from recordings that hold efforts.

Measured efforts minus the inverse dynamics of the model are taken, joint by joint, as

    offset + friction · sign(q̇) + viscous · q̇ + armature · q̈

by least squares. Standard errors are those of the jackknife over parts of the recordings, because
neighbouring samples are not independent.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..arrays import FloatArray
from ..exceptions import ControlError
from ..recordings.efforts import MeasuredMotion
from ..robot.model import Robot

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
    v = np.concatenate([motion.velocities for motion in motions])
    a = np.concatenate([motion.accelerations for motion in motions])
    rest = np.concatenate(
        [
            motion.efforts
            - robot.inverse_dynamics(motion.positions, motion.velocities, motion.accelerations)
            for motion in motions
        ]
    )
    n, rate, rejected = robot.n_joints, motions[0].rate, dict[str, str]()
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
