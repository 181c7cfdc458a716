# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Demonstrations to show: those of recordings, or those that a primitive reproduces."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..primitives.primitive import MovementPrimitive
from ..recordings.demonstration import RecordingSet
from .motion import ShownMotion

_UNLABELLED = "without a label"

N_SAMPLES = 60
"""Number of configurations of a shown demonstration."""


@dataclass(frozen=True, eq=False)
class DemonstrationGroup:
    """Demonstrations with one label.

    Attributes
    ----------
    label : str
        The label; the name of the primitive, or a remark, where there is none.
    motions : tuple of ShownMotion
        At least one.
    """

    label: str
    motions: tuple[ShownMotion, ...]


def reproduced(primitives: Iterable[MovementPrimitive]) -> list[DemonstrationGroup]:
    """The demonstrations of primitives, as their weights and their own timing reproduce them."""
    found: dict[str, list[ShownMotion]] = {}
    for primitive in primitives:
        sources = _provenance(primitive)
        for i, (duration, source) in enumerate(zip(primitive.durations, sources, strict=True)):
            times = np.linspace(0.0, float(duration), N_SAMPLES)
            name = _name(i, str(source.get("recording", "")), source.get("start_time_s"))
            motion = ShownMotion(name, times, primitive.reproduction(i, times))
            found.setdefault(str(source.get("label") or primitive.name), []).append(motion)
    return [DemonstrationGroup(label, tuple(motions)) for label, motions in found.items()]


def recorded(recordings: RecordingSet) -> list[DemonstrationGroup]:
    """The demonstrations of recordings, as they were measured."""
    found: dict[str, list[ShownMotion]] = {}
    for i, one in enumerate(recordings.demonstrations):
        name = _name(i, one.recording, one.start_time)
        times = np.linspace(0.0, one.duration, N_SAMPLES)
        motion = ShownMotion(name, times, one.time_normalised(N_SAMPLES))
        found.setdefault(one.label or _UNLABELLED, []).append(motion)
    return [DemonstrationGroup(label, tuple(motions)) for label, motions in found.items()]


def _provenance(primitive: MovementPrimitive) -> list[dict[str, Any]]:
    """Facts on each demonstration; empty where the file holds none."""
    facts = primitive.metadata.get("demonstrations")
    n = len(primitive.durations)
    if not isinstance(facts, list) or len(facts) != n:
        return [{}] * n
    return [fact if isinstance(fact, dict) else {} for fact in facts]


def _name(index: int, recording: str, start: Any) -> str:
    is_known = recording and isinstance(start, int | float)
    where = f" {recording} at {start:.1f} s" if is_known else ""
    return f"{index + 1}.{where}"
