# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""RRT-Connect of OMPL with shortcuts, and the time-optimal motion along its path by TOPP-RA."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from ..arrays import FloatArray
from ..motion.trajectory import Trajectory
from ..planning.sampling import SamplingOptions, sampled_path
from ..robot.limits import JointLimits
from .method import PeerResult, import_peer
from .without_optimisation import sample_times

_OPTIONS = SamplingOptions(step=0.05, smooths=True)


class SamplingPeer:
    """OMPL and TOPP-RA, for one robot.

    Parameters
    ----------
    limits : JointLimits
        Velocities and accelerations are kept, jerks and efforts are not.
    max_time : float
        Time limit of the search [s].

    Raises
    ------
    MissingDependencyError
        If OMPL or TOPP-RA is not installed.
    """

    name = "ompl_toppra"
    about = (
        "RRT-Connect of OMPL, shortcuts and smoothing, then TOPP-RA within the limits of "
        "velocities and accelerations"
    )

    def __init__(self, limits: JointLimits, max_time: float) -> None:
        import_peer("ompl", f"the peer '{self.name}'", "ompl")
        self._toppra = import_peer("toppra", f"the peer '{self.name}'")
        self._limits, self._max_time = limits, max_time

    def solve(
        self, start: FloatArray, goal: FloatArray, collides: Callable[[FloatArray], bool]
    ) -> PeerResult:
        """Find a path, and the shortest motion along it."""
        began = time.perf_counter()
        limits = self._limits
        path = sampled_path(
            collides,
            (limits.lower, limits.upper),
            (start, goal),
            _OPTIONS,
            lambda: time.perf_counter() - began > self._max_time,
        )
        if path is None:
            return PeerResult(None, time.perf_counter() - began, status="no path was found")
        motion = self._timed(path)
        took = time.perf_counter() - began
        if motion is None:
            return PeerResult(None, took, status="the path could not be parametrised")
        times = sample_times(float(motion.duration))
        states = [motion(times, order) for order in range(3)]
        return PeerResult(Trajectory(limits.joint_names, times, *states), took)

    def _timed(self, path: FloatArray) -> Any:
        """The time-optimal motion along a path; None if there is none."""
        toppra, limits = self._toppra, self._limits
        lengths = np.linalg.norm(np.diff(path, axis=0), axis=1)
        path, lengths = path[np.append(True, lengths > 1e-6)], lengths[lengths > 1e-6]
        spline = toppra.SplineInterpolator(np.append(0.0, np.cumsum(lengths)), path)
        constraints = [toppra.constraint.JointVelocityConstraint(_both(limits.velocity))]
        if np.isfinite(limits.acceleration).all():
            bound = _both(limits.acceleration)
            constraints.append(toppra.constraint.JointAccelerationConstraint(bound))
        return toppra.algorithm.TOPPRA(constraints, spline).compute_trajectory()


def _both(bound: FloatArray) -> FloatArray:
    return np.stack([-bound, bound], axis=1)
