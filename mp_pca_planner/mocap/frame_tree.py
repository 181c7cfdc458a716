# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Poses along a tree of frames."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..exceptions import RecordingError, quote_names
from ..recordings.byte_layout import NS_PER_S
from ..recordings.joint_states import IntArray

if TYPE_CHECKING:
    from .marker_messages import BodySamples


def in_root(
    child: str, tree: Mapping[str, BodySamples], fixed: Collection[str]
) -> tuple[FloatArray, str]:
    """Poses of a frame in the root of its tree, at the frame's own stamps; and the root.

    Raises
    ------
    RecordingError
        If the parents of the frame form a circle.
    """
    stamps, poses = tree[child].stamps, tree[child].poses
    chain = [child]
    while (parent := tree[chain[-1]].frame) in tree:
        if parent in chain:
            raise RecordingError(f"frames {quote_names(chain)} are each other's parents")
        chain.append(parent)
        outer = tree[parent]
        index = np.zeros(len(stamps), dtype=np.int64)
        if parent not in fixed:
            index = _same_time(stamps, outer.stamps)
        poses = _compose(np.where((index >= 0)[:, None], outer.poses[index], np.nan), poses)
    return poses, parent


def _same_time(stamps: IntArray, others: IntArray) -> IntArray:
    """Index of the other that is nearest in time; -1 if none is within half a usual period."""
    column = clock_of([stamps, others])
    times, order = stamps[:, column], np.argsort(others[:, column], kind="stable")
    theirs = others[order, column]
    # A time below the mean of two others is nearer to the first; on a tie the first is taken.
    nearest = np.searchsorted(theirs[:-1] + np.diff(theirs) // 2, times)
    near = np.abs(theirs[nearest] - times) <= 0.5 * usual_period(theirs)
    return np.where(near, order[nearest], -1)


def clock_of(stamps: Collection[IntArray]) -> int:
    """Column of the stamps to use: header stamps if all are set, else times of reception."""
    return 0 if all(own[:, 0].all() for own in stamps) else 1


def usual_period(times: IntArray) -> float:
    """Median step of times in any order [ns]; a second if they are all the same."""
    steps = np.diff(np.sort(times))
    steps = steps[steps > 0]
    return float(np.median(steps)) if steps.size else float(NS_PER_S)


def has_rotation(poses: FloatArray) -> NDArray[np.bool_]:
    """Whether each pose, shape (n_poses, 7), is finite and has an orientation."""
    turned = np.abs(poses[:, 3:]).sum(axis=1) > 0.0
    return np.asarray(np.isfinite(poses).all(axis=1) & turned)


def _compose(outer: FloatArray, inner: FloatArray) -> FloatArray:
    """Poses of inner frames given in outer ones, in the frame of the outer ones."""
    from scipy.spatial.transform import Rotation

    result = np.full(inner.shape, np.nan)
    usable = has_rotation(outer) & has_rotation(inner)
    first = Rotation.from_quat(outer[usable, 3:])
    result[usable, :3] = outer[usable, :3] + first.apply(inner[usable, :3])
    result[usable, 3:] = (first * Rotation.from_quat(inner[usable, 3:])).as_quat()
    return result
