# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The referee that judges commanded motions, on motions whose derivatives are known."""

from __future__ import annotations

import numpy as np
import pytest
from support.referee import judge

CLOCK = np.arange(2001) * 1e-3
OMEGA = 2.0


def sine(clock=CLOCK, amplitude=1.0):
    """Largest velocity, acceleration and jerk are the amplitude times OMEGA, OMEGA², OMEGA³."""
    return amplitude * np.sin(OMEGA * clock)[:, None]


def limits(share=1.0, **others):
    return {
        "velocity": [share * OMEGA],
        "acceleration": [share * OMEGA**2],
        "jerk": [share * OMEGA**3],
        "lower": [-1.0],
        "upper": [1.0],
        **others,
    }


def test_motion_that_reaches_all_its_limits_is_clean():
    verdict = judge(sine(), CLOCK, limits())
    assert verdict.is_clean
    assert verdict.largest_jump < 1e-7


def test_limits_that_are_2_percent_lower_are_exceeded_by_each_derivative():
    verdict = judge(sine(), CLOCK, limits(0.98))
    assert [found.quantity for found in verdict.exceeded] == ["velocity", "acceleration", "jerk"]
    values = [abs(found.value) for found in verdict.exceeded]
    np.testing.assert_allclose(values, [OMEGA, OMEGA**2, OMEGA**3], rtol=1e-5)


@pytest.mark.parametrize("tick", [300, 785, 1500])
@pytest.mark.parametrize("size", [1e-6, -1e-4, 1e-3])
def test_jump_counts_once_and_has_its_own_size(tick, size):
    q = sine()
    q[tick:] += size
    verdict = judge(q, CLOCK, limits())
    assert not verdict.exceeded
    assert verdict.largest_jump == pytest.approx(abs(size), rel=1e-2, abs=1e-7)
    expected = [(tick, 0), (tick + 1, 0)] if abs(size) > 2e-4 else []
    assert [jump[:2] for jump in verdict.jumps] == expected


@pytest.mark.parametrize(("quantity", "order"), [("acceleration", 1), ("jerk", 2)])
def test_step_of_a_derivative_exceeds_the_next_one(quantity, order):
    q, step = sine(amplitude=0.5), 0.05
    q[700:, 0] += step / order * (CLOCK[700:] - CLOCK[699]) ** order
    found = {f.quantity: f for f in judge(q, CLOCK, limits()).exceeded}[quantity]
    assert abs(found.tick - 701) <= 1
    assert 0.4 * step / 1e-3 < abs(found.value) < 1.1 * step / 1e-3


def test_slowed_motion_is_judged_by_its_own_clock():
    # A smooth brake to nothing and back, of a motion that is at its limits throughout.
    scaling = 1.0 - np.exp(-(((CLOCK - 1.0) / 0.1) ** 2))
    own = np.cumsum(scaling) * 1e-3
    assert judge(sine(own), own, limits()).is_clean
    assert not judge(sine(own), CLOCK, limits()).is_clean


def test_cut_excuses_the_step_at_it_and_nothing_else():
    q = sine()
    q[700:] = q[699]
    assert not judge(q, CLOCK, limits()).is_clean
    assert judge(q, CLOCK, limits(), cuts=[700]).is_clean
    assert not judge(q, CLOCK, limits(), cuts=[600]).is_clean
