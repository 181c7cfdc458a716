# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Positions in degrees or millimetres, which are rejected."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from ...exceptions import RecordingError
from .recording import Defect, Piece, RepairOptions, count


def refuse_degrees(
    pieces: Sequence[Piece], options: RepairOptions, repairs: Counter[str]
) -> Sequence[Piece]:
    """Reject positions of which two joints, and half of all, are beyond any angle in radians.

    Raises
    ------
    RecordingError
        If they are.
    """
    reach = np.max([np.abs(piece.positions).max(axis=0) for piece in pieces], axis=0)
    n_far = count(reach > options.largest_angle)
    # A single joint may turn on and on.
    if n_far < 2 or 2 * n_far < reach.size:
        return pieces
    raise RecordingError(
        f"{n_far} of its {reach.size} joints are beyond {options.largest_angle:g} rad, one at "
        f"{reach.max():.3g}: positions must be in radians (or m), not in degrees (or mm); if these "
        "are degrees, convert them with --degrees (degrees=True in Python), else choose the joints "
        "of the arm"
    )


UNITS = Defect({}, refuse_degrees)
