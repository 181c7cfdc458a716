# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Recoveries: changes of the setting after a failed attempt at one segment.

Each is a function of the failure that returns the setting to try next, or None if it does not
apply. `RECOVERIES` lists them; the first that applies is taken. To add one, write a function and
add it to the list.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from ...motion.validation import LimitCheck
from ..context import Context
from ..program.setting import Setting, first_setting, lasting
from ..request import Request
from ..time_scaling import slowdown
from .candidate import Candidate, Violation, collides, sampled


@dataclass(frozen=True, eq=False)
class Failure:
    """A failed attempt at one segment, and the expected motion for comparison.

    Attributes
    ----------
    context : Context
        Of the planner.
    request : Request
        The request.
    first, setting : Setting
        The first setting of the request, and the one that failed.
    candidate : Candidate
        The motion that was found.
    violations : tuple of Violation
        Violations of the attempts with this basis, the last one included.
    expected_check : LimitCheck
        Comparison with the limits of the expected motion of the same ends and duration.
    is_recoverable : bool
        Whether another duration or naturalness may help.
    """

    context: Context
    request: Request
    first: Setting
    setting: Setting
    candidate: Candidate
    violations: tuple[Violation, ...]
    expected_check: LimitCheck
    is_recoverable: bool


Recovery = Callable[[Failure], Setting | None]


def given_duration(failure: Failure) -> Setting | None:
    """The duration that was found as a given one, unless bodies collide."""
    setting, found = failure.setting, failure.candidate
    if not setting.is_timed or setting.is_shortest or found.has_clearances:
        return None
    return lasting(setting, found.duration)


def slower(failure: Failure) -> Setting | None:
    """A longer duration, if the expected motion violates limits, too.

    From a moving start, a longer duration may violate them more; then this recovery ends.
    """
    search, duration = failure.context.options.search, failure.candidate.duration
    longest = failure.request.duration
    if failure.request.duration_is_free:
        longest = min(longest * search.max_stretch, failure.context.longest)
    violations = failure.violations
    n_worse = len(violations) - 1 - violations.index(min(violations))
    if n_worse >= search.max_worse or not failure.is_recoverable:
        return None
    longer = min(duration * slowdown(failure.expected_check.violations), longest)
    return lasting(failure.setting, longer) if longer > duration else None


def more_natural(failure: Failure) -> Setting | None:
    """A larger naturalness, if the expected motion keeps the limits.

    In that case, the reduction of the cost caused the violation of a limit or a collision.
    """
    setting, steps = failure.setting, failure.context.options.search.naturalness_steps
    if not failure.is_recoverable or failure.expected_check.violations:
        return None
    larger = [step for step in steps if step > setting.naturalness]
    if setting.bases[0].precision is None or setting.width or not larger:
        return None
    return replace(lasting(setting, failure.candidate.duration), naturalness=larger[0])


def wider_basis(failure: Failure) -> Setting | None:
    """The next wider basis, otherwise with the first setting."""
    context, request, first = failure.context, failure.request, failure.first
    width = failure.setting.width + 1
    if width >= context.bases.n_widths:
        return None
    basis = context.bases.basis(
        request.segments[0], request.naturalness, width, shortest=first.is_shortest
    )
    if first.is_shortest:
        return first_setting(context, request, basis, width, shortest=True)
    wider = replace(first, bases=(basis,), width=width)
    return replace(lasting(wider, first.duration), is_timed=first.is_timed)


RECOVERIES: tuple[Recovery, ...] = (given_duration, slower, more_natural, wider_basis)
"""The recoveries, in the order in which they are tried."""


def recovered(failure: Failure) -> Setting | None:
    """The setting of the first recovery that applies; None if none does."""
    for recovery in RECOVERIES:
        if (setting := recovery(failure)) is not None:
            return setting
    return None


def failure_of(
    context: Context,
    request: Request,
    first: Setting,
    setting: Setting,
    found: Sequence[Candidate],
) -> Failure:
    """The failure of the last of the attempts with one basis."""
    candidate = found[-1]
    expected = replace(candidate.motions[0], weights=setting.bases[0].expected)
    trajectory, check = sampled(context, [expected])
    is_recoverable = (
        not setting.is_shortest
        and not candidate.is_hopeless
        and bool(candidate.check.violations or candidate.collisions)
        and not (candidate.collisions and collides(context, trajectory))
    )
    return Failure(
        context,
        request,
        first,
        setting,
        candidate,
        tuple(one.violation for one in found),
        check,
        is_recoverable,
    )
