# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The joints that a set of recordings has in common, and those that are left out."""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from operator import itemgetter

import numpy as np

from ..exceptions import quote_names
from .joint_states import Names
from .options import LoadOptions
from .recording import Recording, Refusal

_GRIPPER = re.compile("gripper|finger|knuckle|drive_joint", re.IGNORECASE)
# Steps in which movements of a gripper and of the arm are compared [s]; speed of a moving arm by
# its greatest; share of its path by which a gripper moves with the arm.
_STEP, _ARM_MOVES, _WITH_ARM = 0.2, 0.1, 0.2


def joints_of_set(
    loaded: Mapping[str, Recording | Refusal], options: LoadOptions, *, same_joints: bool
) -> tuple[dict[str, Names], dict[str, str]]:
    """Choose the joints of each recording.

    Parameters
    ----------
    loaded :
        The repaired recordings by their names, and those that are rejected.
    options :
        Of these `joints` and `moving_only`.
    same_joints :
        See :func:`.load_recordings`.

    Returns
    -------
    joints : dict
        The joints of each, in the order of the set; of rejected ones only those that may have them.
    reasons : dict
        Why joints are left out; the others are left out as most recordings lack them.
    """
    used = {name: one for name, one in loaded.items() if isinstance(one, Recording)}
    reasons = _reasons_to_leave_out([*used.values()], options)
    orders: dict[frozenset[str], Names] = {}
    joints: dict[str, Names] = {}
    for name, one in used.items():
        kept = tuple(joint for joint in one.joint_names if joint not in reasons)
        joints[name] = orders.setdefault(frozenset(kept), kept)
    counts = Counter(joints.values())
    common, n_common = max(counts.items(), key=itemgetter(1), default=((), 0))
    if same_joints and 2 * n_common > len(used):
        joints = dict.fromkeys(used, common)
        if options.joints is None:
            joints |= {x: common for x, one in loaded.items() if {*one.joint_names} >= {*common}}
    return joints, reasons


def notes_on_left_out(names: Sequence[str], reasons: Mapping[str, str]) -> tuple[str, ...]:
    """Notes on joints that are not taken, by the reasons of :func:`joints_of_set`."""
    several = defaultdict[str, list[str]](list)
    for name in names:
        several[reasons.get(name, "most recordings lack them")].append(name)
    return tuple(
        f"joints left out, as {why}: {quote_names(names)}" for why, names in several.items()
    )


def _reasons_to_leave_out(recordings: Sequence[Recording], options: LoadOptions) -> dict[str, str]:
    """Joints that are none of the set, and why.

    They are those that move in no recording, and those of a gripper that does not move with the
    arm. Chosen joints are taken all the same, but those that never move with `moving_only`.
    """
    idle = _idle_grippers(recordings) if options.joints is None else set()
    moving = {n for x in recordings for n in x.joint_names if n not in x.still_joints}
    still = {name for x in recordings for name in x.still_joints} - moving
    if options.joints is not None and not options.moving_only:
        still = set()
    return dict.fromkeys(idle, "they move while the arm rests") | dict.fromkeys(
        still, "they never move"
    )


def _idle_grippers(recordings: Sequence[Recording]) -> set[str]:
    """The joints of grippers that move while the other joints rest, by their names and paths."""
    moved, with_arm = defaultdict[str, float](float), defaultdict[str, float](float)
    for recording in recordings:
        of_gripper = np.array([bool(_GRIPPER.search(x)) for x in recording.joint_names])
        if of_gripper.all() or not of_gripper.any():
            continue
        stride = max(round(_STEP * recording.sample_rate), 1)
        paths = np.abs(
            np.vstack([np.diff(x.positions[::stride], axis=0) for x in recording.pieces])
        )
        arm = paths[:, ~of_gripper].sum(axis=1)
        is_moving = arm > _ARM_MOVES * np.quantile(arm, 0.95)
        names = [x for x in recording.joint_names if _GRIPPER.search(x)]
        for name, path in zip(names, paths[:, of_gripper].T, strict=True):
            moved[name] += float(path.sum())
            with_arm[name] += float(path[is_moving].sum())
    return {name for name, path in moved.items() if with_arm[name] < _WITH_ARM * path}
