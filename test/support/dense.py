# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""What a controller makes of points, by SciPy: nothing of the package computes it."""

import numpy as np
from scipy.interpolate import BPoly

from mp_pca_planner.motion.trajectory import Trajectory

ORDERS = {"velocity": 1, "acceleration": 2, "jerk": 3}


def spline(trajectory, n_derivatives=3):
    """The quintics (3) or cubics (2) through the points."""
    columns = trajectory.positions, trajectory.velocities, trajectory.accelerations
    times = trajectory.times.copy()  # SciPy 1.11 takes no read-only times
    return BPoly.from_derivatives(times, np.stack(columns[:n_derivatives], axis=1))


def largest_shares(curve, limits, n=2001):
    """Of each limit, the share that the curve needs most; positions as a share of their half."""
    times = np.linspace(curve.x[0], curve.x[-1], n)
    middle, half = 0.5 * (limits.upper + limits.lower), 0.5 * (limits.upper - limits.lower)
    shares = {"position": np.max(np.abs(curve(times) - middle) / half)}
    for name, order in ORDERS.items():
        shares[name] = np.max(np.abs(curve(times, order)) / getattr(limits, name))
    return shares


def assert_keeps(curve, limits):
    """The curve keeps the limits, but for rounding."""
    shares = largest_shares(curve, limits)
    assert max(shares.values()) <= 1.0 + 2e-6, shares


def minimum_jerk_motion(joints, start, goal, duration, n=101):
    """From rest to rest, by the polynomial of least jerk."""
    start, goal, s = np.asarray(start), np.asarray(goal), np.linspace(0.0, 1.0, n)[:, None]
    way = goal - start
    return Trajectory(
        joints,
        s[:, 0] * duration,
        start + way * (10 * s**3 - 15 * s**4 + 6 * s**5),
        way * (30 * s**2 - 60 * s**3 + 30 * s**4) / duration,
        way * (60 * s - 180 * s**2 + 120 * s**3) / duration**2,
    )
