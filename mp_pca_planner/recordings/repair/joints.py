# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Choice of the joints, and their positions by name."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from ...arrays import FloatArray, unique_names
from ...exceptions import RecordingError, quote_names, unknown_name
from ...input_limits import INPUT_LIMITS
from ..joint_states import IntArray, RawJointStates, listed_names


def choose_joints(
    listed: Sequence[tuple[str, ...]], topic: str, joints: Sequence[str] | None
) -> tuple[str, ...]:
    """Choose the joints to take: the requested ones, else those that all messages list.

    Parameters
    ----------
    listed :
        Names of the joints in each message, or in each kind of messages.
    topic :
        Name of the topic.
    joints :
        Requested names.

    Raises
    ------
    RecordingError
        If there is no message, a name is unknown, no joint is in every message, or the joints
        are more than are accepted.
    """
    if not listed:
        raise RecordingError(f"there is no well-formed message on '{topic}'")
    names = _common_joints(listed, topic) if joints is None else _known_joints(listed, joints)
    if len(names) > INPUT_LIMITS.joints:
        raise RecordingError(
            f"{len(names)} joints of '{topic}' are more than the {INPUT_LIMITS.joints} accepted: choose "
            "some of them (--joints)"
        )
    return names


def _known_joints(listed: Sequence[tuple[str, ...]], joints: Sequence[str]) -> tuple[str, ...]:
    known = listed_names(listed)
    names = unique_names(joints, "chosen joints", RecordingError)
    for name in names:
        if name not in known:
            raise RecordingError(unknown_name("joint", name, known))
    return names


def _common_joints(listed: Sequence[tuple[str, ...]], topic: str) -> tuple[str, ...]:
    common = set.intersection(*map(set, listed))
    if not common:
        choices = "; ".join(quote_names(names) for names in list(dict.fromkeys(listed))[:10])
        raise RecordingError(
            f"no joint is in every message of '{topic}', choose joints that come together: "
            f"{choices}"
        )
    return tuple(name for name in listed[0] if name in common)


def take_joints(
    raw: RawJointStates, names: tuple[str, ...], repairs: Counter[str]
) -> tuple[IntArray, FloatArray]:
    """Messages that list all of the joints, and their positions in the order of `names`.

    Raises
    ------
    RecordingError
        If no message lists them all.
    """
    messages: list[IntArray] = []
    positions: list[FloatArray] = []
    first_order: list[str] | None = None
    for layout in raw.layouts:
        if not set(names) <= set(layout.joint_names):
            repairs["missing_joints"] += layout.messages.size
            continue
        order = [name for name in layout.joint_names if name in names]
        first_order = first_order or order
        if order != first_order:
            repairs["reordered"] += layout.messages.size
        messages.append(layout.messages)
        columns = [layout.joint_names.index(name) for name in names]
        own = layout.positions
        positions.append(own if columns == list(range(own.shape[1])) else own[:, columns])
    if not messages:
        raise RecordingError(f"no message lists all of the joints {quote_names(names)} together")
    if len(messages) == 1:
        return messages[0], positions[0]
    merged = np.concatenate(messages)
    order_of_reception = np.argsort(merged)
    return merged[order_of_reception], np.concatenate(positions)[order_of_reception]
