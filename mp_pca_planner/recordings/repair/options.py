# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Options of the repairs."""

from __future__ import annotations

from dataclasses import dataclass

from ..byte_layout import NS_PER_S


@dataclass(frozen=True)
class RepairOptions:
    """Thresholds of the repairs; the defaults suit arms recorded at 5 to 1000 Hz.

    Attributes
    ----------
    max_gap : float or None
        Longest time without messages that is no gap [s], over 0. By default `gap_time`, or
        `gap_periods` usual periods where these are longer.
    gap_time, gap_periods : float
        See `max_gap` [s, periods].
    enough_rate : float
        Arm motions need no higher sample rate [Hz]. Of a recording with at least twice this rate,
        consecutive samples are averaged.
    max_conflicts, min_conflicts : float, int
        A second publisher is present if more than this share of the messages, and more than this
        number, contradict others.
    conflict : float
        A late message contradicts the others if it is farther than this from their positions at
        its time [rad or m].
    max_turn_error : float
        A jump is a full turn if it differs from one by less than this [rad].
    min_jump, jump_ratio : float
        A jump is longer than `min_jump` [rad or m] and than `jump_ratio` usual steps.
    jump_speed, jump_isolation : float
        A jump is faster than `jump_speed` [/s] and longer than `jump_isolation` times the steps
        before and after it. A spike, which returns in the next sample, need not be as fast.
    max_jumps : float
        From this share of jumping samples on there are two publishers.
    min_alternations : int
        A publisher of zeros is present from this number of changes between zeros and positions on.
    far_from_zero : float
        Positions beside zeros are another publisher's if they exceed this [rad or m].
    """

    max_gap: float | None = None
    gap_time: float = 0.5
    gap_periods: float = 5
    enough_rate: float = 100.0
    max_conflicts: float = 0.01
    min_conflicts: int = 10
    conflict: float = 0.01
    max_turn_error: float = 1.0
    min_jump: float = 0.05
    jump_ratio: float = 10.0
    jump_speed: float = 20.0
    jump_isolation: float = 5.0
    max_jumps: float = 0.05
    min_alternations: int = 10
    far_from_zero: float = 0.05

    def longest_gap(self, period: float) -> float:
        """Longest time between messages of this usual period that is no gap, both in [ns]."""
        if self.max_gap is not None:
            return self.max_gap * NS_PER_S
        return max(self.gap_time * NS_PER_S, self.gap_periods * period)
