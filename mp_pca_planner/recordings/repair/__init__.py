# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Repairs of recorded joint states, one family of defects per module.

`repair` reads a whole recording and applies the repairs in a fixed order: joints, clock,
publishers, gaps, jumps. Each repair is counted under its name in `REPAIRS`.
"""

from .clock import MAX_RATE, SIMULATION_TIME, YEAR_NS
from .joints import MAX_JOINTS, choose_joints
from .options import RepairOptions
from .pipeline import repair
from .recording import (
    MIN_SAMPLES,
    REPAIRS,
    CleanRecording,
    Piece,
    counted,
    findings_on_refusal,
    motion_notes,
    refuse_stillness,
)
from .samples import MAX_POSITION

__all__ = [
    "MAX_JOINTS",
    "MAX_POSITION",
    "MAX_RATE",
    "MIN_SAMPLES",
    "REPAIRS",
    "SIMULATION_TIME",
    "YEAR_NS",
    "CleanRecording",
    "Piece",
    "RepairOptions",
    "choose_joints",
    "counted",
    "findings_on_refusal",
    "motion_notes",
    "refuse_stillness",
    "repair",
]
