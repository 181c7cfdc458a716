# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Joint limits: from the URDF, from a file like MoveIt's joint_limits.yaml, from parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import FloatArray, unique_names
from ..exceptions import LimitsError, unknown_name
from ..files import MAX_YAML_BYTES, load_yaml, read_text, reading

# Keys of one joint in a limits file; those of MoveIt, and min/max_effort's kin.
LIMIT_KEYS = (
    "min_position",
    "max_position",
    "max_velocity",
    "max_acceleration",
    "max_jerk",
    "max_effort",
)
_SWITCHES = {
    "has_position_limits": ("min_position", "max_position"),
    "has_velocity_limits": ("max_velocity",),
    "has_acceleration_limits": ("max_acceleration",),
    "has_jerk_limits": ("max_jerk",),
    "has_effort_limits": ("max_effort",),
}

Overrides = Mapping[str, Mapping[str, float]]
"""Limits by joint name and key (see `LIMIT_KEYS`); infinite ones take a limit away."""


@dataclass(frozen=True, eq=False)
class JointLimits:
    """What a motion must keep to, joint by joint; infinite where there is no limit.

    Attributes
    ----------
    joint_names : tuple of str
        Names of the joints, n_joints of them.
    lower, upper : array, shape (n_joints,)
        Range of positions [rad or m].
    velocity, acceleration, jerk : array, shape (n_joints,)
        Largest magnitudes [/s, /s², /s³].
    effort : array, shape (n_joints,)
        Largest magnitude of the torque [N·m] or force [N].

    Raises
    ------
    LimitsError
        If a range is empty, or a magnitude is not positive or NaN.
    """

    joint_names: tuple[str, ...]
    lower: FloatArray
    upper: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    jerk: FloatArray
    effort: FloatArray

    def __init__(
        self, joint_names: Sequence[str], limits: Overrides, *, source: str = "limits"
    ) -> None:
        names = unique_names(joint_names, source, LimitsError)
        columns = {
            "lower": ("min_position", -np.inf),
            "upper": ("max_position", np.inf),
            "velocity": ("max_velocity", np.inf),
            "acceleration": ("max_acceleration", np.inf),
            "jerk": ("max_jerk", np.inf),
            "effort": ("max_effort", np.inf),
        }
        object.__setattr__(self, "joint_names", names)
        for field, (key, absent) in columns.items():
            values = np.array([limits.get(name, {}).get(key, absent) for name in names], float)
            for name, value in zip(names, values, strict=True):
                _check_limit(name, key, value, source)
            values.setflags(write=False)
            object.__setattr__(self, field, values)
        for name, low, high in zip(names, self.lower, self.upper, strict=True):
            if not low < high:
                raise LimitsError(
                    f"{source}: the positions of joint '{name}' range from {low:g} to {high:g}, "
                    "which leaves no room; the lower limit must be below the upper one"
                )


def _check_limit(name: str, key: str, value: float, source: str) -> None:
    if np.isnan(value) or (not key.endswith("position") and value <= 0.0):
        wanted = "a number" if key.endswith("position") else "a positive number"
        raise LimitsError(
            f"{source}: {key} of joint '{name}' is {value:g}, but it must be {wanted} "
            "(set it in a limits file or by a parameter; .inf means no limit)"
        )


def merge_limits(*layers: Overrides) -> dict[str, dict[str, float]]:
    """Lay limits over one another, joint by joint and key by key; later ones win."""
    merged: dict[str, dict[str, float]] = {}
    for layer in layers:
        for name, values in layer.items():
            merged.setdefault(name, {}).update(values)
    return merged


def read_limits_file(path: str | Path, joint_names: Sequence[str]) -> dict[str, dict[str, float]]:
    """Read limits in the form of MoveIt's joint_limits.yaml.

    Parameters
    ----------
    path :
        A YAML file with a mapping ``joint_limits: {joint: {max_velocity: …}}``, MoveIt's
        ``has_…_limits`` switches included; ``max_effort`` and ``max_jerk`` are accepted too.
        Its default scaling factors are what MoveIt asks for, no limits: they are not applied.
    joint_names :
        Joints of the robot; an entry for another one is refused.

    Returns
    -------
    limits : dict
        By joint name and key. ``has_…_limits: false`` gives infinite values.

    Raises
    ------
    LimitsError
        If the file can't be read or says something else than limits.
    """
    where = f"limits file '{path}'"
    with reading(where, LimitsError):
        content = load_yaml(read_text(path, MAX_YAML_BYTES))
        joints = content.get("joint_limits") if isinstance(content, dict) else None
        if not isinstance(joints, dict):
            raise LimitsError(
                f"{where} must hold a mapping 'joint_limits' from joint names to limits"
            )
        return {
            _known_joint(name, joint_names, where): _read_entry(name, entry, where)
            for name, entry in joints.items()
        }


def _known_joint(name: Any, joint_names: Sequence[str], where: str) -> str:
    if name not in joint_names:
        raise LimitsError(f"{where}: {unknown_name('joint', str(name), joint_names)}")
    return str(name)


def _read_entry(name: str, entry: Any, where: str) -> dict[str, float]:
    if not isinstance(entry, dict):
        raise LimitsError(f"{where}: joint '{name}' must be a mapping of limits, got {entry!r:.40}")
    values: dict[str, float] = {}
    for key, value in entry.items():
        if key in _SWITCHES:
            if not isinstance(value, bool):
                raise LimitsError(f"{where}: {key} of joint '{name}' must be true or false")
        elif key in LIMIT_KEYS:
            if isinstance(value, bool) or not isinstance(value, int | float):
                raise LimitsError(
                    f"{where}: {key} of joint '{name}' is {value!r:.40}, not a number"
                )
            values[key] = float(value)
            _check_limit(name, key, values[key], where)
        else:
            valid = (*LIMIT_KEYS, *_SWITCHES)
            raise LimitsError(f"{where}: joint '{name}': {unknown_name('limit', str(key), valid)}")
    for switch, keys in _SWITCHES.items():
        if entry.get(switch) is False:
            values.update({key: -np.inf if key == "min_position" else np.inf for key in keys})
    return values
