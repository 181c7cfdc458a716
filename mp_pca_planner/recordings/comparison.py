# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The second pass over a set: recordings compared with each other.

Copies are rejected, and the set decides which joints are taken and what is too small or too large
to be a motion.
"""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import replace
from operator import itemgetter

import numpy as np
from numpy.typing import NDArray

from ..exceptions import quote_names
from . import cutting
from .load_one import LoadTask
from .recording_set import GatheredSets
from .repair.recording import FINGERPRINT_SIZE
from .segmentation import absurd_extent, least_extent_of_set

MIN_COMMON = 3
"""Fewer common hashes of fingerprints are no evidence."""

MIN_SHARE = 0.7
"""Share of a recording's runs that another one has, from which on it is a copy or a part of it."""


def refuse_copies(tasks: Sequence[LoadTask], loaded: GatheredSets) -> None:
    """Reject recordings whose samples are those of another one, or a part of them.

    Of a recording with a table of segments, the motions are those that a person chose.
    """
    originals: dict[str, str] = {}
    values, owners = array("q"), array("q")
    for index, task in enumerate(tasks):
        for report in loaded.found(index)[0] if task.segments is None else ():
            original = originals.setdefault(report.checksum, task.name)
            if original != task.name:
                loaded.refuse(index, task.name, f"it is a copy of '{original}', which is used")
            else:
                values.extend(report.fingerprint)
                owners.extend([index] * len(report.fingerprint))
    gone = set[int]()
    for pair, shares in sorted(common_shares(np.array(values), np.array(owners)).items()):
        if max(shares) >= MIN_SHARE and not gone & set(pair):
            # Of equal ones, the first is kept.
            part, whole = pair if shares[0] > shares[1] + 0.3 else pair[::-1]
            gone.add(part)
            where = f"in '{tasks[whole].name}', which is used"
            if min(shares) < MIN_SHARE:
                reason = f"it is a part of another recording: its samples are also {where}"
            else:
                reason = f"it is a copy in another form: its samples are also {where}"
            loaded.refuse(part, tasks[part].name, reason)


def common_shares(
    values: NDArray[np.int64], owners: NDArray[np.int64]
) -> dict[tuple[int, int], tuple[float, float]]:
    """Shares of the runs of two recordings that the other one has, too.

    Parameters
    ----------
    values : array, shape (n_hashes,)
        The fingerprints of all recordings, one after the other.
    owners : array, shape (n_hashes,)
        The index of the recording of each, not decreasing.

    Returns
    -------
    :
        By the indices of the recordings, the first one less than the second one.
    """
    order = np.argsort(values, kind="stable")
    is_new = np.append(True, np.diff(values[order]) != 0)
    starts = np.flatnonzero(is_new)
    ends = np.append(starts[1:], values.size)
    pairs = Counter[tuple[int, int]]()
    for start, end in zip(starts[ends - starts > 1], ends[ends - starts > 1], strict=True):
        found = owners[order[start:end]].tolist()
        # Of many copies, each is compared with the first ones.
        pairs.update((one, other) for i, one in enumerate(found[:4]) for other in found[i + 1 :])
    shares = {}
    for pair, n_common in pairs.items():
        both = [values[slice(*np.searchsorted(owners, (i, i + 1)))] for i in pair]
        # The hashes of a longer recording reach less far.
        reach = min(own[-1] if own.size == FINGERPRINT_SIZE else np.inf for own in both)
        if n_common >= MIN_COMMON:
            first, second = (n_common / np.count_nonzero(own <= reach) for own in both)
            shares[pair] = (float(first), float(second))
    return shares


def with_joints_of_set(
    tasks: Sequence[LoadTask], loaded: GatheredSets, same_joints: bool, *, moving_only: bool
) -> dict[int, LoadTask]:
    """Recordings to load again with the joints of the set in its order, by index.

    On request, recordings of other joints are rejected. With `moving_only`, joints that move in no
    recording are no joints of the set.
    """
    still = _still_joints(len(tasks), loaded) if moving_only else set[str]()
    orders: dict[frozenset[str], tuple[str, ...]] = {}
    counts = Counter[tuple[str, ...]]()
    for index in range(len(tasks)):
        for report in loaded.found(index)[0]:
            joints = tuple(name for name in report.joint_names if name not in still)
            counts[orders.setdefault(frozenset(joints), joints)] += 1
    common, n_common = max(counts.items(), key=itemgetter(1), default=((), 0))
    is_one_set = same_joints and 2 * n_common > counts.total()
    again: dict[int, LoadTask] = {}
    for index, task in enumerate(tasks):
        used, refused = loaded.found(index)
        for report in used:
            own = set(report.joint_names)
            joints = common if is_one_set else orders[frozenset(own - still)]
            if not own.issuperset(joints):
                loaded.refuse(
                    index,
                    task.name,
                    f"its joints, {quote_names(report.joint_names)}, are not those of most "
                    f"recordings, {quote_names(common)}: choose joints that all have, or use it "
                    "separately",
                )
            elif joints != report.joint_names:
                again[index] = _with_joints(task, joints, report.joint_names, still)
        for one in refused:
            if is_one_set and not task.options.joints and set(one.joint_names).issuperset(common):
                again[index] = _with_joints(task, common, one.joint_names)
    return again


def _still_joints(n_tasks: int, loaded: GatheredSets) -> set[str]:
    """The joints that move in no recording that is used."""
    reports = [report for index in range(n_tasks) for report in loaded.found(index)[0]]
    moving = {n for one in reports for n in one.joint_names if n not in one.still_joints}
    return {name for one in reports for name in one.still_joints} - moving


def _with_joints(
    task: LoadTask,
    joints: tuple[str, ...],
    found: Sequence[str],
    still: Collection[str] = (),
) -> LoadTask:
    """A recording with some of its joints, and notes on the others."""
    others = [name for name in found if name not in joints]
    reasons = {
        "they never move": [name for name in others if name in still],
        "most recordings lack them": [name for name in others if name not in still],
    }
    notes = tuple(
        f"joints left out, as {why}: {quote_names(names)}"
        for why, names in reasons.items()
        if names
    )
    return replace(task, options=replace(task.options, joints=joints), notes=notes)


def with_extent_of_set(
    tasks: Sequence[LoadTask], loaded: GatheredSets, known_extents: Sequence[float]
) -> dict[int, LoadTask]:
    """Recordings to load again by the extents of all motions, by index.

    Movements of some count as rest relative to the motions of the set. Those of absurdly large
    motions are rejected.
    """
    extents, smallest, largest = array("d", known_extents), array("d"), array("d")
    for index, task in enumerate(tasks):
        reports, _ = loaded.found(index)
        own = [m.extent for x in reports for m in x.motions if task.segments is None]
        extents.extend(own)
        smallest.append(min(own, default=np.inf))
        largest.append(max(own, default=0.0))
    absurd = absurd_extent([*known_extents, *filter(None, largest)])
    for index in np.flatnonzero(np.asarray(largest) > absurd).tolist():
        what = cutting.far_moving("its joints move", largest[index], absurd)
        reason = (
            f"beside the other recordings' motions, {what}; choose the joints, or give "
            "a table of segments if these movements are motions"
        )
        loaded.refuse(index, tasks[index].name, reason)
        smallest[index] = np.inf
    if not np.isfinite(smallest).any():
        return {}
    least = least_extent_of_set([x for x in extents if x <= absurd])
    small = np.flatnonzero(np.asarray(smallest) <= least).tolist()
    return {index: replace(tasks[index], least_extent=least) for index in small}
