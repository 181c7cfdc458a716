# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""What is chosen for one attempt at a request; with the request, all that is compiled."""

from __future__ import annotations

from dataclasses import dataclass

from ..motion import Motion
from ..objectives import Objective
from ..options import SolverOptions
from .bases import MotionBasis


@dataclass(frozen=True, eq=False)
class Setting:
    """Settings of an attempt.

    Attributes
    ----------
    bases : tuple of MotionBasis
        The bases of the segments.
    initial : tuple of Motion
        The expected motion, with its duration.
    naturalness : float
        Naturalness weight ρ.
    objectives : tuple of (float, Objective)
        Running costs and their weights.
    solver : SolverOptions
        Options of the solver.
    width : int
        Number of the basis, from the narrowest, see :meth:`.BasisStore.basis`.
    is_timed : bool
        Whether the duration of a single segment is an unknown.
    is_shortest : bool
        Whether the shortest duration is searched.
    """

    bases: tuple[MotionBasis, ...]
    initial: tuple[Motion, ...]
    naturalness: float
    objectives: tuple[tuple[float, Objective], ...]
    solver: SolverOptions
    width: int = 0
    is_timed: bool = False
    is_shortest: bool = False

    @property
    def duration(self) -> float:
        """Duration of the expected motion [s]."""
        return sum(motion.duration for motion in self.initial)
