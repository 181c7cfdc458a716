# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Each recovery alone: when it applies, and what it proposes."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import pytest
from mp_pca_planner.planning.recoveries import MoreNatural, Setting, Slower, WiderBasis

from mp_pca_planner.motion.validation import LimitCheck, Violation

FAST = LimitCheck((Violation("velocity", "elbow", 0.0, 1.5, 1.0, 0.5),))
FAR = LimitCheck((Violation("position", "elbow", 0.0, 1.5, 1.0, 0.5),))
KEPT = LimitCheck(())


def basis(*, is_corrected=False, precision=1.0):
    return SimpleNamespace(precision=precision, is_corrected=is_corrected)


@dataclass
class MadeUpFailure:
    """A failure of which everything is known."""

    setting: Setting
    expected_check: LimitCheck
    is_recoverable: bool = True
    violation: float = 0.5

    @property
    def attempt(self):
        return SimpleNamespace(violation=(self.violation, 0.0, 0.0))


def failure(check, recoverable=True, naturalness=0.0, **options):
    return MadeUpFailure(Setting(basis(**options), 2.0, naturalness), check, recoverable)


def test_more_time_is_proposed_where_the_expected_motion_is_too_fast():
    setting = Slower(10.0).propose(failure(FAST))
    assert setting.duration == pytest.approx(2.0 * 1.02 * 1.5)
    assert not setting.is_first
    assert Slower(2.5).propose(failure(FAST)).duration == 2.5
    assert Slower(2.0).propose(failure(FAST)) is None


@pytest.mark.parametrize("check", [KEPT, FAR])
def test_more_time_is_not_proposed_where_it_would_not_help(check):
    assert Slower(10.0).propose(failure(check)) is None
    assert Slower(10.0).propose(failure(FAST, recoverable=False)) is None


def test_more_time_is_given_up_after_several_worse_attempts_with_one_basis():
    slower = Slower(10.0, max_worse=2)
    first = replace(failure(FAST).setting, is_first=True)

    def proposed(violation, setting=first):
        return slower.propose(MadeUpFailure(setting, FAST, violation=violation))

    later = proposed(0.5)
    for violation in (0.6, 0.4, 0.5):
        assert proposed(violation, later) is not None
    assert proposed(0.45, later) is None
    assert proposed(0.45) is not None


def test_more_naturalness_is_proposed_where_the_expected_motion_keeps_the_limits():
    natural = MoreNatural((0.1, 1.0))
    assert natural.propose(failure(KEPT)).naturalness == 0.1
    assert natural.propose(failure(KEPT, naturalness=0.1)).naturalness == 1.0
    assert natural.propose(failure(KEPT, naturalness=1.0)) is None


@pytest.mark.parametrize(
    "failed",
    [
        failure(FAST),
        failure(KEPT, recoverable=False),
        failure(KEPT, is_corrected=True),
        failure(KEPT, precision=None),
    ],
)
def test_more_naturalness_is_not_proposed_where_it_would_not_help(failed):
    assert MoreNatural((1.0,)).propose(failed) is None


def test_bases_are_proposed_one_after_the_other_with_the_first_duration():
    bases = [basis(), basis(is_corrected=True)]
    wider = WiderBasis(iter(bases), Setting(basis(), 3.0, 0.5, is_first=True))
    for expected in bases:
        setting = wider.propose(failure(KEPT))
        assert setting.basis is expected
        assert (setting.duration, setting.naturalness, setting.is_first) == (3.0, 0.5, True)
    assert wider.propose(failure(KEPT)) is None
