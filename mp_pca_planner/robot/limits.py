# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Joint limits of a URDF, of files like MoveIt's joint_limits.yaml, and of parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import FloatArray, check_number, is_number, set_frozen, text_table, unique_names
from ..exceptions import LimitsError, quote_names, shown, unknown_name
from ..files import load_yaml, read_text, reading

_KEYS = {
    "lower": "min_position",
    "upper": "max_position",
    "velocity": "max_velocity",
    "acceleration": "max_acceleration",
    "jerk": "max_jerk",
    "effort": "max_effort",
}
LIMIT_KEYS = tuple(_KEYS.values())
"""Keys of one joint in a limits file: those of MoveIt, max_jerk and max_effort."""

DRIVE_KEYS = ("armature", "damping", "friction")
"""Further keys that state the drive of a joint, see :meth:`.Robot.with_drives`."""

# Bounds the acceleration, too: a key of MoveIt's Pilz planner.
_DECELERATION = "max_deceleration"
_SIGNED = ("min_position", "max_position", _DECELERATION)
_MAGNITUDES = ("velocity", "acceleration", "deceleration", "jerk", "effort")
_SWITCHES = {f"has_{quantity}_limits": quantity for quantity in ("position", *_MAGNITUDES)}
_FACTORS = tuple(f"default_{rate}_scaling_factor" for rate in ("velocity", "acceleration"))

_KINDS = (
    "position [rad, m]",
    "velocity [/s]",
    "acceleration [/s²]",
    "jerk [/s³]",
    "effort [N·m, N]",
)

Overrides = Mapping[str, Mapping[str, float]]
"""Values by joint name and key (`LIMIT_KEYS`, `DRIVE_KEYS`); infinite ones remove a limit."""


@dataclass(frozen=True, eq=False)
class JointLimits:
    """Limits of motions by joint; infinite where there is no limit.

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
        If a range is empty, a magnitude is not positive or NaN, or a kind of limit is unknown.

    Examples
    --------
    >>> import mp_pca_planner as mp
    >>> mp.JointLimits(["elbow"], {"elbow": {"min_position": -2.4, "max_velocity": 3.0}})
    JointLimits  position [rad, m]  velocity [/s]  acceleration [/s²]  jerk [/s³]  effort [N·m, N]
    elbow              -2.4 to inf              3                 inf         inf              inf
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
        set_frozen(self, joint_names=names)
        entries = [_read_entry(name, limits.get(name, {}), source) for name in names]
        for field, key in _KEYS.items():
            values = np.array([entry.get(key, _absent(key)) for entry in entries])
            values.setflags(write=False)
            set_frozen(self, **{field: values})
        for name, low, high in zip(names, self.lower, self.upper, strict=True):
            if not low < high:
                raise LimitsError(
                    f"{source}: the positions of joint '{name}' range from {low:g} to {high:g}, "
                    "which leaves no room; the lower limit must be below the upper one (set them "
                    "in a limits file)"
                )

    @property
    def unlimited(self) -> str:
        """Words on limits of velocity, acceleration and jerk that joints lack; empty if none do."""
        found: dict[str, list[str]] = {}
        for name in ("velocity", "acceleration", "jerk"):
            if (lacks := np.isinf(getattr(self, name))).any():
                who = "no joint has a limit" if lacks.all() else "some joints have no limit"
                found.setdefault(who, []).append(name)
        return ", ".join(f"{who} of {' or '.join(names)}" for who, names in found.items())

    def __repr__(self) -> str:
        magnitudes = (self.velocity, self.acceleration, self.jerk, self.effort)
        rates = zip(*(values.tolist() for values in magnitudes), strict=True)
        ends = zip(self.lower.tolist(), self.upper.tolist(), strict=True)
        rows = [
            [name, f"{low:.4g} to {high:.4g}", *(f"{value:.4g}" for value in values)]
            for name, (low, high), values in zip(self.joint_names, ends, rates, strict=True)
        ]
        return text_table(rows, header=["JointLimits", *_KINDS])


def _absent(key: str) -> float:
    return -np.inf if key == "min_position" else np.inf


def merge_limits(*layers: Overrides) -> dict[str, dict[str, float]]:
    """Merge limits joint by joint and key by key; later ones replace earlier ones."""
    merged: dict[str, dict[str, float]] = {}
    for layer in layers:
        for name, values in layer.items():
            merged.setdefault(name, {}).update(values)
    return merged


def limits_file_note(path: str | Path | None) -> str:
    """What a limits file holds that is no limit here, in one sentence; empty if there is nothing.

    These are MoveIt's default scaling factors, and keys of others. A file that can't be read gets
    none.
    """
    notes = list[str]()
    with suppress(LimitsError):
        entries, factors = _read_file(path) if path else ({}, {})
        scaled = [f"{name} {x:g}" for name, x in factors.items() if is_number(x) and x != 1.0]
        if scaled:
            notes.append(
                f"MoveIt's {' and '.join(scaled)} are not applied: motions use the full limits; "
                "for slower ones, lower the limits"
            )
        keys = {str(key) for x in entries.values() if isinstance(x, Mapping) for key in x}
        if ignored := sorted(keys - {*LIMIT_KEYS, *DRIVE_KEYS, *_SWITCHES, _DECELERATION}):
            notes.append(
                f"{quote_names(ignored)} are ignored: limits are {quote_names(LIMIT_KEYS)}"
            )
    return f"limits file '{path}': {'; '.join(notes)}" if notes else ""


def _read_file(path: str | Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Entries of a limits file by joint, and MoveIt's scaling factors, also among the joints."""
    where = f"limits file '{path}'"
    with reading(where, LimitsError):
        content = _holder(load_yaml(read_text(path)))
        entries = content.get("joint_limits")
        if not isinstance(entries, dict):
            raise LimitsError(f"{where} must hold a mapping 'joint_limits' from joints to limits")
    stated = {**entries, **content}
    factors = {name: stated[name] for name in _FACTORS if name in stated}
    # YAML reads the name 1 as a number.
    return {str(name): x for name, x in entries.items() if name not in _FACTORS}, factors


def _holder(content: Any) -> dict[str, Any]:
    """The mapping that holds `joint_limits`, which is deep in a parameter file of ROS 2."""
    if isinstance(content, dict) and "joint_limits" not in content:
        return next(filter(None, map(_holder, content.values())), {})
    return content if isinstance(content, dict) else {}


def given_limits(
    given: Overrides | str | Path, joint_names: Sequence[str]
) -> dict[str, dict[str, float]]:
    """Limits of a mapping, or of a file in the form of MoveIt's joint_limits.yaml.

    Parameters
    ----------
    given :
        Limits by joint name and key; or a YAML file with a mapping ``joint_limits: {joint:
        {max_velocity: …}}``, also within a parameter file of ROS 2, MoveIt's ``has_…_limits``
        switches included; ``max_effort`` and ``max_jerk`` are accepted too, and so are the keys of
        drives. ``!degrees 90`` is read, and
        ``max_deceleration`` bounds the acceleration, too. MoveIt's default scaling factors and
        unknown keys are ignored, see :func:`limits_file_note`.
    joint_names :
        Joints of the robot; an entry for another joint is rejected.

    Returns
    -------
    limits : dict
        By joint name and key. ``has_…_limits: false`` gives infinite values.

    Raises
    ------
    LimitsError
        If the file can't be read, or a joint, a key or a value can't be used.
    """
    where = "limits"
    if isinstance(given, str | Path):
        where, (limits, _) = f"limits file '{given}'", _read_file(given)
    elif isinstance(given, Mapping):
        limits = dict(given)
    else:
        raise LimitsError(f"limits must be a mapping from joint names, got {shown(given, 40)}")
    for name in limits:
        if name not in joint_names:
            raise LimitsError(f"{where}: {unknown_name('joint', name, joint_names)}")
    with reading(where, LimitsError):  # of a number that no float can hold
        return {
            name: _read_entry(name, entry, where, is_file=where != "limits")
            for name, entry in limits.items()
        }


def _read_entry(name: str, entry: Any, where: str, *, is_file: bool = False) -> dict[str, float]:
    """Limits and drives of a joint by key; infinite ones where a limit is switched off."""
    if not isinstance(entry, Mapping):
        raise LimitsError(
            f"{where}: joint '{name}' must be a mapping of limits, got {shown(entry, 40)}"
        )
    # MoveIt's Setup Assistant writes 0 beside a limit that is switched off.
    off = tuple(quantity for switch, quantity in _SWITCHES.items() if entry.get(switch) is False)
    values = {key: _absent(key) for key in (*LIMIT_KEYS, _DECELERATION) if key.endswith(off)}
    for key, value in entry.items():
        what = f"{where}: {key} of joint '{name}'"
        if key in _SWITCHES:
            if not isinstance(value, bool):
                raise LimitsError(f"{what} must be true or false")
        elif key in DRIVE_KEYS:
            check_number(value, what, LimitsError, 0.0, 1e9)
            values[key] = float(value)
        elif key in (*LIMIT_KEYS, _DECELERATION):
            if key not in values:
                values[key] = _limit(value, what, is_signed=key in _SIGNED)
        # A limit with a misspelt name must not be missing without a word.
        elif not is_file or get_close_matches(str(key), (*LIMIT_KEYS, *DRIVE_KEYS), cutoff=0.85):
            valid = (*LIMIT_KEYS, *DRIVE_KEYS, *_SWITCHES)
            raise LimitsError(f"{where}: joint '{name}': {unknown_name('limit', key, valid)}")
    slowest = abs(values.pop(_DECELERATION, np.inf))
    if slowest < values.get("max_acceleration", np.inf):
        values["max_acceleration"] = slowest
    return values


def _limit(value: Any, what: str, *, is_signed: bool) -> float:
    """A limit: an end of a range, or a magnitude."""
    if not (is_number(value) or isinstance(value, float)):
        raise LimitsError(f"{what} is {shown(value, 40)}, not a number")
    number = float(value)
    # Ratios to smaller limits overflow.
    if np.isnan(number) or (not is_signed and number < 1e-9):
        expected = "a number" if is_signed else "a positive number from 1e-09 on"
        raise LimitsError(
            f"{what} is {number:g}, but it must be {expected} (set it in a limits file or by a "
            "parameter; .inf means no limit)"
        )
    return number
