# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A published motion as the controller interpolates it, against polynomials of NumPy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.polynomial import Polynomial

from mp_pca_planner.execution.motions import PublishedMotion
from mp_pca_planner.motion.interpolation import interpolate
from mp_pca_planner.motion.trajectory import Trajectory

JOINTS = ("a", "b")
# Two motions of degree 5: the quintic through any of their points is the polynomial itself.
Q = (Polynomial([0.3, -0.2, 0.5, 0.4, -0.3, 0.05]), Polynomial([-1.0, 0.1, 0.0, -0.2, 0.1, 0.02]))
TIMES = np.array([0.0, 0.3, 0.7, 0.71, 1.6, 2.0])


def columns(times, derivative=0):
    times = np.asarray(times, float)  # NumPy 1.26 evaluates polynomials at no lists
    return np.column_stack([(q.deriv(derivative) if derivative else q)(times) for q in Q])


def motion(times=TIMES, **options):
    states = [columns(times, d) for d in range(3)]
    return PublishedMotion(Trajectory(JOINTS, times - times[0], *states, **options), began=10.0)


def test_motion_of_one_point_is_there_at_every_place():
    one = PublishedMotion(Trajectory(JOINTS, [0.0], [[1.0, 2.0]], [[0.0] * 2], [[0.0] * 2]), 0.0)
    q, v, a = one.sample(np.array([-1.0, 0.0, 3.0]))
    assert q.tolist() == [[1.0, 2.0]] * 3
    assert not v.any() and not a.any()
    assert (one.duration, one.end.tolist()) == (0.0, [1.0, 2.0])


@pytest.mark.parametrize(
    ("here", "switch"), [(0.1, 0.9), (0.1, 0.3002), (0.302, 0.707), (0.0, 1.999)]
)
def test_followed_motion_is_the_old_one_up_to_the_switch_and_then_the_rest(here, switch):
    rest = Trajectory(JOINTS, [0.0, 1.0], *(columns([switch, switch + 1.0], d) for d in range(3)))
    joined = PublishedMotion(motion().followed_by(rest, switch, here), 0.0)
    assert joined.duration == pytest.approx(switch - here + 1.0, abs=1e-6)
    assert np.diff(joined.trajectory.times).min() > 2.9e-4
    since = np.linspace(0.0, joined.duration, 400)
    for d, found in enumerate(joined.sample(since)):
        np.testing.assert_allclose(found, columns(here + since, d), atol=1e-5)


def jerky(seed: int) -> PublishedMotion:
    """A motion whose jerk, of at most 1, jumps at every point."""
    jerks = np.random.default_rng(seed).uniform(-1.0, 1.0, (200, 2))
    states = np.zeros((3, 201, 2))
    for k, jerk in enumerate(jerks):
        q, v, a = states[:, k]
        states[:, k + 1] = (
            q + 0.01 * v + 5e-5 * a + 1e-6 / 6 * jerk,
            v + 0.01 * a + 5e-5 * jerk,
            a + 0.01 * jerk,
        )
    return PublishedMotion(Trajectory(JOINTS, 0.01 * np.arange(201), *states), 0.0)


@given(st.integers(0, 99), st.floats(0.0, 0.9), st.floats(0.01, 0.5), st.booleans())
def test_joined_motion_keeps_the_limits_of_jerk_that_both_of_its_parts_keep(
    seed, here, lead, to_rest
):
    old = jerky(seed)
    here = old.near_point(here)
    switch = old.near_point(here + lead)
    rest = old.rest(switch)
    if not to_rest:
        state = old.state(switch).values
        rest = Trajectory(JOINTS, [0.0, 10.0], *([x, y] for x, y in zip(state, state, strict=True)))
    joined = old.followed_by(rest, switch, here)
    seam = joined.times[: joined.n_steps - rest.n_steps + 1]
    jerks = interpolate(Trajectory(JOINTS, seam, *(x[: seam.size] for x in joined.states))).jerk
    assert np.abs(jerks).max() <= 1.0 + 5e-3
    assert np.diff(seam).min() > 2.9e-4
    np.testing.assert_allclose(seam[:-1], np.round(seam[:-1], 9), atol=1e-15)


def test_efforts_of_both_motions_are_kept_and_those_of_one_alone_are_not():
    efforts = np.column_stack([TIMES, -TIMES])
    old = motion(efforts=efforts)
    states = [columns([0.5, 1.5], d) for d in range(3)]
    joined = old.followed_by(Trajectory(JOINTS, [0, 1], *states, np.full((2, 2), 9.0)), 0.5, 0.2)
    np.testing.assert_allclose(joined.efforts, [[0.2, -0.2], [0.3, -0.3], [9, 9], [9, 9]])
    assert old.followed_by(Trajectory(JOINTS, [0, 1], *states), 0.5, 0.2).efforts is None
