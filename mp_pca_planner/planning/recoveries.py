# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Recoveries: changes of the settings after a failed attempt, tried in order until one applies."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Protocol

from ..motion.trajectory import Trajectory
from ..motion.validation import LimitCheck
from .attempt import Attempt, Violation
from .bases import MotionBasis
from .setup import Setup
from .time_scaling import slowdown


@dataclass(frozen=True, eq=False)
class Setting:
    """Settings of an attempt.

    Attributes
    ----------
    basis : MotionBasis
        The basis of motions.
    duration : float
        The duration [s].
    naturalness : float
        Naturalness weight ρ.
    is_first : bool
        Whether it is the first one of its basis.
    """

    basis: MotionBasis
    duration: float
    naturalness: float
    is_first: bool = False


class Failure:
    """A failed attempt, and the expected motion for comparison.

    Parameters
    ----------
    attempt : Attempt
        The attempt, of a single segment.
    setting : Setting
        Settings of the attempt; a free duration has the value that was found.
    setup : Setup
        Robot, limits and options of the planner.
    """

    def __init__(self, attempt: Attempt, setting: Setting, setup: Setup) -> None:
        self.attempt, self.setting, self._setup = attempt, setting, setup

    @property
    def is_recoverable(self) -> bool:
        """Whether another duration or naturalness may help."""
        attempt = self.attempt
        if attempt.is_hopeless or not (attempt.check.violations or attempt.collisions):
            return False
        return not (attempt.collisions and self._setup.collisions(self._expected))

    @cached_property
    def _expected(self) -> Trajectory:
        """The expected motion of the same duration."""
        motion = self.attempt.motions[0]
        return self._setup.sample([replace(motion, weights=self.setting.basis.expected)])

    @cached_property
    def expected_check(self) -> LimitCheck:
        """Comparison of the expected motion with the limits."""
        return self._setup.check(self._expected)


class Recovery(Protocol):
    """A change of the settings after a failure."""

    def propose(self, failure: Failure) -> Setting | None:
        """The setting to try next; None if this recovery does not apply."""


@dataclass(eq=False)
class Slower:
    """A longer duration, if the expected motion violates limits, too.

    From a moving start, a longer duration may violate them more.

    Attributes
    ----------
    max_duration : float
        Longest duration [s].
    max_worse : int
        Number of attempts with one basis, after the least violation, that end this recovery.
    """

    max_duration: float
    max_worse: int = 3
    _violations: list[Violation] = field(default_factory=list)

    def propose(self, failure: Failure) -> Setting | None:
        """A longer duration."""
        if failure.setting.is_first:
            self._violations.clear()
        self._violations.append(failure.attempt.violation)
        n_worse = len(self._violations) - 1 - self._violations.index(min(self._violations))
        if n_worse >= self.max_worse or not failure.is_recoverable:
            return None
        duration = failure.setting.duration
        slower = min(duration * slowdown(failure.expected_check), self.max_duration)
        if not slower > duration:
            return None
        return replace(failure.setting, duration=slower, is_first=False)


@dataclass(frozen=True)
class MoreNatural:
    """A larger naturalness, if the expected motion keeps the limits.

    In that case, the reduction of effort caused the violation of a limit or a collision.

    Attributes
    ----------
    steps : tuple of float
        Increasing values of ρ.
    """

    steps: Sequence[float]

    def propose(self, failure: Failure) -> Setting | None:
        """The next larger naturalness."""
        basis = failure.setting.basis
        if not failure.is_recoverable or failure.expected_check.violations:
            return None
        if basis.precision is None or basis.is_corrected:
            return None
        larger = (step for step in self.steps if step > failure.setting.naturalness)
        step = next(larger, None)
        return None if step is None else replace(failure.setting, naturalness=step, is_first=False)


@dataclass(frozen=True, eq=False)
class WiderBasis:
    """The next wider basis, otherwise with the first setting.

    Attributes
    ----------
    bases : iterator of MotionBasis
        From the narrower to the widest; they are made when they are needed.
    first : Setting
        The first setting.
    """

    bases: Iterator[MotionBasis]
    first: Setting

    def propose(self, failure: Failure) -> Setting | None:
        """The next basis."""
        basis = next(self.bases, None)
        return None if basis is None else replace(self.first, basis=basis)
