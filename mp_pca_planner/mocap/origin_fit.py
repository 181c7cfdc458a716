# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Fit of joint origins to a recording, so that one model serves people of different sizes.

The marker positions are linear in the joints' origins o (or in their distances, along the
directions that the URDF gives): with the rotation R of the parent link, ∂p/∂o = R for every marker
beyond the joint. Origins and the joint positions of some frames are found together by Gauss-Newton.
The joint positions are eliminated frame by frame by a projection of the errors, which leaves a
small system for the origins alone.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ..arrays import FloatArray
from ..exceptions import RecordingError, unknown_name
from ..robot.model import Robot
from .inverse_kinematics import BoolArray, Linearised, MarkerProblem, minimise, solve_each
from .markers import MarkerMap, MarkerPlacement, OriginFit

# Frames that are used, evenly spread over the recording.
_N_FRAMES = 60
# Largest number of steps.
_MAX_ITERATIONS = 30
# Change of the origins at which the fit ends [m].
_LAST_STEP = 1e-7
# Directions that change the errors less than this share of the strongest stay unchanged.
_MIN_EFFECT = 1e-4


class _Joint(NamedTuple):
    """A joint of a URDF: the links it connects, and its origin in the parent link [m]."""

    parent: str
    child: str
    origin: FloatArray


def check_fits(urdf: str, marker_map: MarkerMap) -> None:
    """Refuse fits that are impossible for this robot description.

    Raises
    ------
    RecordingError
        If it has no such joint, or a joint whose distance is fitted has no direction.
    """
    joints = _joints(ET.fromstring(urdf))
    for name, kind in marker_map.fit_origins.items():
        if name not in joints:
            raise RecordingError(
                f"{marker_map.source}: fit_origins: {unknown_name('joint', name, joints)}"
            )
        if kind == "length" and not joints[name].origin.any():
            raise RecordingError(
                f"{marker_map.source}: fit_origins: joint '{name}' is at the origin of its parent "
                "link, so there is no length to fit; use 'position'"
            )


def fit_origins(
    urdf: str,
    joint_names: Sequence[str],
    markers: Sequence[MarkerPlacement],
    fits: Mapping[str, OriginFit],
    targets: FloatArray,
) -> tuple[str, tuple[str, ...]]:
    """Fit the origins of some joints.

    Parameters
    ----------
    urdf :
        The robot description.
    joint_names :
        Joints that move.
    markers :
        Markers that they move.
    fits :
        The fitted part of each origin, see :class:`.markers.MarkerMap`.
    targets : array, shape (n_frames, n_markers, 3)
        Measured positions in the base frame [m]; NaN where missing. The frames must fix all joints.

    Returns
    -------
    urdf : str
        The robot description with the fitted origins.
    notes : tuple of str
        The fitted origins, one sentence for each joint.
    """
    joints = _joints(ET.fromstring(urdf))
    columns = [
        (name, direction)
        for name, fit in fits.items()
        for direction in _directions(joints[name], fit)
    ]
    in_parents = [(joints[name].parent, direction) for name, direction in columns]
    chosen = np.unique(np.linspace(0, len(targets) - 1, _N_FRAMES).round().astype(int))
    beyond = _beyond(joints, [name for name, _ in columns], markers)
    q: FloatArray | None = None

    def fitted(change: FloatArray) -> dict[str, FloatArray]:
        origins = {name: joints[name].origin for name in fits}
        for (name, direction), amount in zip(columns, change, strict=True):
            origins[name] = origins[name] + amount * direction
        return origins

    def linearise(change: FloatArray) -> Linearised:
        nonlocal q
        robot = Robot(_with_origins(urdf, fitted(change)), joint_names)
        problem = MarkerProblem(robot, markers, targets[chosen])
        q = solve_each(problem, q)
        effects = np.einsum("mc,kci->kmic", beyond, _turned(robot, q, in_parents))
        return _reduced(problem, q, effects)

    bounds = np.array(-np.inf), np.array(np.inf)
    start = np.zeros(len(columns))
    limits = _LAST_STEP, _MAX_ITERATIONS
    change, _ = minimise(start, linearise, _strong_step, bounds, *limits)
    return _with_origins(urdf, fitted(change)), _notes(joints, fitted(change))


def _reduced(problem: MarkerProblem, q: FloatArray, effects: FloatArray) -> Linearised:
    """Least squares of the origins, from which the joint positions are eliminated.

    Parameters
    ----------
    problem, q :
        Frames and their best joint positions.
    effects : array, shape (n_frames, n_markers, 3, n_columns)
        Derivatives of the marker positions by the origins.
    """
    frames = np.arange(len(q))
    errors, jacobians = problem.weighted(frames, q)
    effects = effects * problem.scale(frames)[..., None, None]
    removed = jacobians @ np.linalg.pinv(jacobians, rcond=_MIN_EFFECT)
    rest = np.eye(errors.shape[1]) - removed
    matrix = (rest @ effects.reshape(*errors.shape, -1)).reshape(-1, effects.shape[-1])
    left = (rest @ errors[..., None]).reshape(-1)
    return float(np.sum(errors**2)), matrix.T @ left, matrix.T @ matrix


def _strong_step(
    gradient: FloatArray, matrix: FloatArray, held: BoolArray, damping: float
) -> FloatArray:
    """Step in the directions that change the errors."""
    values, vectors = np.linalg.eigh(matrix)
    strong = values > _MIN_EFFECT**2 * values[-1]
    vectors = vectors[:, strong]
    return np.asarray(-vectors @ ((vectors.T @ gradient) / (values[strong] + damping)))


def _joints(root: ET.Element) -> dict[str, _Joint]:
    found = {}
    for joint in root.iter("joint"):
        parent, child, origin = (joint.find(tag) for tag in ("parent", "child", "origin"))
        if parent is not None and child is not None:
            text = "0 0 0" if origin is None else origin.get("xyz", "0 0 0")
            found[joint.get("name", "")] = _Joint(
                parent.get("link", ""), child.get("link", ""), np.array(text.split(), dtype=float)
            )
    return found


def _with_origins(urdf: str, origins: Mapping[str, FloatArray]) -> str:
    root = ET.fromstring(urdf)
    for joint in root.iter("joint"):
        position = origins.get(joint.get("name", ""))
        if position is not None:
            origin = joint.find("origin")
            if origin is None:
                origin = ET.SubElement(joint, "origin")
            origin.set("xyz", " ".join(repr(float(x)) for x in position))
    return ET.tostring(root, encoding="unicode")


def _directions(joint: _Joint, fit: OriginFit) -> FloatArray:
    """Directions in the parent link that the origin may move in, shape (n_directions, 3)."""
    if fit == "position":
        return np.eye(3)
    return joint.origin[None] / np.linalg.norm(joint.origin)


def _beyond(
    joints: Mapping[str, _Joint], names: Sequence[str], markers: Sequence[MarkerPlacement]
) -> FloatArray:
    """1 where a marker is beyond a joint, else 0; shape (n_markers, n_names)."""
    above = {joint.child: (name, joint.parent) for name, joint in joints.items()}
    result = np.zeros((len(markers), len(names)))
    for row, marker in zip(result, markers, strict=True):
        link = marker.link
        while link in above:
            passed, link = above[link]
            row[[name == passed for name in names]] = 1.0
    return result


def _turned(robot: Robot, q: FloatArray, columns: Sequence[tuple[str, FloatArray]]) -> FloatArray:
    """Directions given in links, in the base frame; shape (n_frames, n_columns, 3)."""
    links = [link for link, _ in columns]
    directions = np.array([direction for _, direction in columns])
    tips, _ = robot.attach_points(links, directions).positions_and_jacobians(q)
    origins, _ = robot.attach_points(links, 0.0 * directions).positions_and_jacobians(q)
    return tips - origins


def _notes(joints: Mapping[str, _Joint], origins: Mapping[str, FloatArray]) -> tuple[str, ...]:
    return tuple(
        f"joint '{name}' fits the markers best at ({_millimetres(origin)}) mm in its parent link; "
        f"the URDF has it at ({_millimetres(joints[name].origin)}) mm"
        for name, origin in origins.items()
    )


def _millimetres(position: FloatArray) -> str:
    return ", ".join(f"{1000.0 * x:.1f}" for x in position)
