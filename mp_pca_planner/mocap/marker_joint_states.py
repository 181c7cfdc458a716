# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Joint states from a recording of markers ([P] Section 3), with the residuals of the fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import compress
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..exceptions import RecordingError, quote_names
from ..input_limits import INPUT_LIMITS
from ..recordings.joint_states import NS_PER_S, JointStates
from ..recordings.recording import MarkerResidual
from ..robot.model import Robot
from .inverse_kinematics import MarkerProblem, fit_origins, fitted_origins, solve
from .markers import MarkerMap, MarkerPlacement, MarkerTrajectories, read_marker_map, read_markers


@dataclass(frozen=True)
class MarkerSource:
    """Topic of recorded markers, and the model to which they are attached.

    Attributes
    ----------
    topic : str
        Topic of the markers, see :func:`.markers.read_markers`.
    urdf : str
        The robot description.
    joint_names : tuple of str
        Joints to find.
    on_base, moved : tuple of MarkerPlacement
        Markers that no joint moves, and those that joints do.
    marker_map : MarkerMap
        All of them, and the origins to fit.
    """

    topic: str
    urdf: str
    joint_names: tuple[str, ...]
    on_base: tuple[MarkerPlacement, ...]
    moved: tuple[MarkerPlacement, ...]
    marker_map: MarkerMap

    def joint_states(
        self, path: Path, *, salvage: bool = False
    ) -> tuple[JointStates, dict[str, MarkerResidual]]:
        """Find the joint states whose markers on the model fit recorded ones.

        Returns
        -------
        joint_states : JointStates
            Joint states in the form of recorded ones, with notes; positions are NaN in frames with
            too few markers.
        residuals : dict
            Residual of each marker, by its name.

        Raises
        ------
        RecordingError
            If the recording can't be read, lacks a marker, or no frame has the markers that are
            needed.
        """
        recorded = read_markers(path, self.topic, (*self.on_base, *self.moved), salvage=salvage)
        robot, fits = Robot(self.urdf, self.joint_names), tuple[str, ...]()
        measured, base_residuals = self._in_base_frame(robot, recorded.positions)
        targets = measured[:, len(self.on_base) :]
        if fitted := fitted_origins(self.urdf, self.marker_map):
            whole = np.isfinite(targets).all(axis=(1, 2))
            if not whole.any():
                raise RecordingError(
                    "no frame has all markers, so the origins of "
                    f"{quote_names(self.marker_map.fit_origins)} can't be fitted to it: remove "
                    "'fit_origins' from the marker map"
                )
            robot, fits = fit_origins(robot, self.moved, fitted, targets[whole])
        problem = MarkerProblem(robot, self.moved, targets)
        absent = np.count_nonzero(~np.isfinite(recorded.positions).all(axis=2), axis=0)
        missing = {name: n for name, n in zip(recorded.names, absent, strict=True) if n}
        frames = np.flatnonzero(problem.determined())
        if not frames.size:
            raise RecordingError(
                f"in none of the {len(targets)} frames are enough markers seen at a time; missing "
                "are " + ", ".join(f"'{name}' in {count}" for name, count in missing.items())
            )
        q = solve(problem, _period(recorded))
        distances = np.hstack([base_residuals[frames], problem.residuals(frames, q[frames])])
        residuals = dict(zip(recorded.names, map(_summary, distances.T), strict=True))
        figures = ", ".join(
            f"'{name}' {1000.0 * r.median:.2f} and {1000.0 * r.percentile_95:.2f}"
            for name, r in residuals.items()
            if r.n_frames
        )
        notes = (
            *recorded.notes,
            f"distances of the markers from the model's, median and 95 % [mm]: {figures}",
            *fits,
            *(
                f"marker '{name}' is missing in {n} of {len(q)} frames"
                for name, n in missing.items()
            ),
            *_notes(robot, q),
        )
        stamps = recorded.header_stamps, recorded.receive_stamps
        listed = np.ones(q.shape, dtype=bool)
        states = JointStates(recorded.topic, self.joint_names, *stamps, q, listed, notes=notes)
        return states, residuals

    def _in_base_frame(self, robot: Robot, positions: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Measured positions in the base frame, and distances of the markers on the base [m]."""
        # Their shapes are (n_frames, n_markers, 3), NaN where the pose of the base is unknown, and
        # (n_frames, n_base_markers).
        n_base, points, measured = len(self.on_base), np.empty((0, 3)), positions
        if n_base:
            places = np.array([marker.position for marker in self.on_base])
            attached = robot.attach_points([marker.link for marker in self.on_base], places)
            points = attached.positions_and_jacobians(np.zeros((1, robot.n_joints)))[0][0]
        if self.marker_map.base != "identity":
            seen = np.asarray(np.isfinite(positions[:, :n_base]).all(axis=2))
            weights = seen * np.array([marker.weight for marker in self.on_base])
            finite = np.where(seen[..., None], positions[:, :n_base], 0.0)
            rotations, translations = fit_poses(points, finite, weights)
            measured = np.einsum("kij,kmi->kmj", rotations, positions - translations[:, None])
        return measured, np.linalg.norm(measured[:, :n_base] - points, axis=2)


def marker_source(
    topic: str, urdf: str | Path, marker_map: str | Path, joints: Sequence[str] | None = None
) -> MarkerSource:
    """Read the model and the marker map, and check that they determine the joint positions.

    Parameters
    ----------
    topic : str
        Topic of the markers.
    urdf, marker_map : str or Path
        Files.
    joints : sequence of str, optional
        Names of the joints to find; by default all that can move.

    Raises
    ------
    RobotError, RecordingError
        If a file can't be used, a link or joint is unknown, the markers on the base don't fix its
        pose, or those on the other links leave a joint open.
    """
    robot = Robot.from_file(urdf, joints)
    chosen = read_marker_map(marker_map)
    fitted_origins(robot.urdf, chosen)
    is_moved = [_is_moved(robot, marker.link) for marker in chosen.markers]
    on_base = tuple(compress(chosen.markers, np.logical_not(is_moved)))
    moved = tuple(compress(chosen.markers, is_moved))
    points = np.array([marker.position for marker in on_base]).reshape(-1, 3)
    if chosen.base != "identity" and not fix_a_pose(points, np.ones((1, len(on_base))))[0]:
        raise RecordingError(
            f"{chosen.source}: the markers on the base ({quote_names(m.name for m in on_base)}) "
            "don't fix its pose: at least 3 that are not on one line are needed, or "
            "'base: identity' if markers are recorded in its frame"
        )
    loose = robot.joint_names
    if moved:
        problem = MarkerProblem(robot, moved, np.zeros((1, len(moved), 3)))
        still_open = problem.open_joints(np.ones(len(moved), dtype=bool))
        loose = tuple(robot.joint_names[joint] for joint in still_open)
    if loose:
        raise RecordingError(
            f"{chosen.source}: the markers leave the joints {quote_names(loose)} open: add markers "
            "on the links that they move, or choose the joints without them"
        )
    return MarkerSource(topic, robot.urdf, robot.joint_names, on_base, moved, chosen)


def _is_moved(robot: Robot, link: str) -> bool:
    """Whether a joint moves a link: a single point may be on the axis of a joint, but not three."""
    attached = robot.attach_points([link] * 3, np.eye(3))
    _, jacobians = attached.positions_and_jacobians(np.zeros((1, robot.n_joints)))
    return bool(np.abs(jacobians).max() > 1e-9)


def _period(recorded: MarkerTrajectories) -> float:
    """Usual time from one frame to the next [s]; not less than joint states may have."""
    headers = recorded.header_stamps
    steps = np.diff(headers if headers.all() else recorded.receive_stamps)
    steps = steps[steps > 0]
    if not steps.size:
        raise RecordingError("all frames of markers have the same stamp: there is no usable time")
    return max(float(np.median(steps)) / NS_PER_S, 1.0 / INPUT_LIMITS.state_rate)


def _summary(distances: FloatArray) -> MarkerResidual:
    """Median and 95 % of distances, NaN where a marker is not seen."""
    seen = distances[np.isfinite(distances)]
    middle, high = np.percentile(seen, [50.0, 95.0]).tolist() if seen.size else (np.nan, np.nan)
    return MarkerResidual(middle, high, seen.size)


def _notes(robot: Robot, q: FloatArray) -> list[str]:
    """What is unusual about the joint positions."""
    notes, n_unsolved = [], np.count_nonzero(~np.isfinite(q).all(axis=1))
    if n_unsolved:
        notes.append(
            f"{n_unsolved} of {len(q)} frames lack markers that the joints need: they count as "
            "non_finite"
        )
    limits = robot.limits()
    at_limit = (q <= limits.lower + 1e-6) | (q >= limits.upper - 1e-6)
    notes += [
        f"joint '{name}' is at its limit in {count} of {len(q)} frames: its range may be too "
        "small, or a marker not at its place in the marker map"
        for name, count in zip(robot.joint_names, at_limit.sum(axis=0), strict=True)
        if count
    ]
    return notes


def fix_a_pose(points: FloatArray, weights: FloatArray) -> NDArray[np.bool_]:
    """Whether points (those with a weight) fix a pose: at least three, not on one line.

    Parameters
    ----------
    points : array, shape (n_points, 3)
        Points in the body's frame [m].
    weights : array, shape (n_frames, n_points)
        Weight of each, 0 if it is missing.

    Returns
    -------
    is_fixed : array of bool, shape (n_frames,)
    """
    if len(points) < 3:
        return np.zeros(len(weights), dtype=bool)
    centred = points - _centres(np.broadcast_to(points, (*weights.shape, 3)), weights)
    spread = np.linalg.svd(centred * np.sqrt(weights)[..., None], compute_uv=False)
    enough = np.count_nonzero(weights, axis=1) >= 3
    # Points whose width is a twentieth of their length are on one line.
    return np.asarray(enough & (spread[:, 1] > 0.05 * spread[:, 0]))


def fit_poses(
    points: FloatArray, measured: FloatArray, weights: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Rotations R and translations t that minimise Σ w ‖R p + t − m‖² in each frame.

    Parameters
    ----------
    points : array, shape (n_points, 3)
        Points p in the body's frame [m].
    measured : array, shape (n_frames, n_points, 3)
        Measured positions m [m]; any finite ones where the weight is 0.
    weights : array, shape (n_frames, n_points)
        Weights w.

    Returns
    -------
    rotations : array, shape (n_frames, 3, 3)
        NaN in frames whose points don't fix a pose.
    translations : array, shape (n_frames, 3)
        [m]; likewise.
    """
    there = np.broadcast_to(points, measured.shape)
    local_centres, centres = _centres(there, weights), _centres(measured, weights)
    correlation = np.einsum(
        "kp,kpi,kpj->kij", weights, measured - centres, there - local_centres, optimize=True
    )
    u, _, right = np.linalg.svd(correlation)
    # The nearest orthogonal matrix may be a reflection; then the weakest direction is turned.
    u[:, :, 2] *= np.sign(np.linalg.det(u) * np.linalg.det(right))[:, None]
    rotations = u @ right
    translations = centres[:, 0] - np.einsum("kij,kj->ki", rotations, local_centres[:, 0])
    loose = ~fix_a_pose(points, weights)
    rotations[loose], translations[loose] = np.nan, np.nan
    return rotations, translations


def _centres(points: FloatArray, weights: FloatArray) -> FloatArray:
    """Weighted means over the points, shape (n_frames, 1, 3)."""
    total = np.maximum(weights.sum(axis=1), np.finfo(float).tiny)
    means = np.einsum("kp,kpi->ki", weights, points) / total[:, None]
    return np.asarray(means[:, None, :])
