# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Each recovery alone: when it applies, and what it proposes."""

from types import SimpleNamespace

import pytest

from mp_pca_planner.motion.validation import LimitCheck, Violation
from mp_pca_planner.planning.motion import Motion
from mp_pca_planner.planning.options import PlannerOptions, SolverOptions
from mp_pca_planner.planning.program.setting import Setting
from mp_pca_planner.planning.search.search import (
    Failure,
    given_duration,
    more_natural,
    recovered,
    slower,
)

FAST = LimitCheck((Violation("velocity", "elbow", 0.0, 1.5, 1.0, 0.5),))
FAR = LimitCheck((Violation("position", "elbow", 0.0, 1.5, 1.0, 0.5),))
KEPT = LimitCheck(())


def failure(
    check,
    *,
    recoverable=True,
    naturalness=0.0,
    width=0,
    precision=1.0,
    longest=10.0,
    violations=(0.5,),
    is_timed=False,
    has_clearances=False,
):
    """A failure of which everything is known, at a given duration of 2 s."""
    tables = SimpleNamespace(basis=None)
    basis = SimpleNamespace(tables=tables, expected=None, precision=precision)
    motion = Motion(None, None, 2.0, None, None)
    objectives, solver = ((1.0, None),), SolverOptions()
    setting = Setting((basis,), (motion,), naturalness, objectives, solver, width, is_timed)
    context = SimpleNamespace(
        options=PlannerOptions(),
        longest=600.0,
        bases=SimpleNamespace(n_widths=1),
    )
    return Failure(
        context,
        SimpleNamespace(duration=longest, duration_is_free=False),
        setting,
        setting,
        SimpleNamespace(duration=2.0, has_clearances=has_clearances),
        tuple((violation, 0.0, 0.0) for violation in violations),
        check,
        recoverable,
    )


def test_more_time_is_proposed_where_the_expected_motion_is_too_fast():
    assert slower(failure(FAST)).duration == pytest.approx(2.0 * 1.02 * 1.5)
    assert slower(failure(FAST, longest=2.5)).duration == 2.5
    assert slower(failure(FAST, longest=2.0)) is None


@pytest.mark.parametrize("check", [KEPT, FAR])
def test_more_time_is_not_proposed_where_it_would_not_help(check):
    assert slower(failure(check)) is None
    assert slower(failure(FAST, recoverable=False)) is None


def test_more_time_is_given_up_after_several_worse_attempts_with_one_basis():
    for violations in ((0.5,), (0.5, 0.6), (0.5, 0.6, 0.4), (0.5, 0.6, 0.4, 0.5)):
        assert slower(failure(FAST, violations=violations)) is not None
    worse = (0.5, 0.6, 0.4, 0.5, 0.45, 0.5)
    assert slower(failure(FAST, violations=worse)) is None


def test_more_naturalness_is_proposed_where_the_expected_motion_keeps_the_limits():
    assert more_natural(failure(KEPT)).naturalness == 1e-3
    assert more_natural(failure(KEPT, naturalness=0.1)).naturalness == 1.0
    assert more_natural(failure(KEPT, naturalness=100.0)) is None


@pytest.mark.parametrize(
    "failed",
    [
        failure(FAST),
        failure(KEPT, recoverable=False),
        failure(KEPT, width=1),
        failure(KEPT, precision=None),
    ],
)
def test_more_naturalness_is_not_proposed_where_it_would_not_help(failed):
    assert more_natural(failed) is None


def test_a_free_duration_is_given_next_unless_bodies_collide():
    again = given_duration(failure(FAST, is_timed=True))
    assert again.duration == 2.0 and not again.is_timed
    assert given_duration(failure(FAST)) is None
    assert given_duration(failure(FAST, is_timed=True, has_clearances=True)) is None


def test_the_first_recovery_that_applies_is_taken():
    assert recovered(failure(FAST, is_timed=True)).duration == 2.0
    assert recovered(failure(FAST)).duration > 2.0
    assert recovered(failure(KEPT)).naturalness > 0.0
    assert recovered(failure(FAR)) is None
