# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Statistics of demonstrations: a few hundred numbers for each, enough to build a primitive.

A recording is mapped to the :class:`MotionStatistics` of its demonstrations, and those of all
recordings are merged. Samples are not kept: a shape becomes its coefficients in the polynomials of
the primitive.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.polynomial import legendre

from ..arrays import FloatArray
from ..exceptions import PrimitiveError
from ..recordings.demonstration import Demonstration
from .alignment import align, aligned_positions
from .basis import end_vanishing_coefficients, legendre_values
from .boundary import boundary_values, hermite_functions
from .options import PrimitiveOptions

# Highest degree of the polynomials that represent joint angles over time. Only the first components
# are reported, which are much smoother.
_ANGLE_DEGREE = 30


@dataclass(frozen=True, eq=False)
class MotionSummary:
    """One demonstration, without its samples.

    Attributes
    ----------
    recording, label, checksum : str
        Of the demonstration.
    start_time, end_time : float
        When it starts and ends, in seconds after the first message of the recording.
    duration : float
        Its duration [s].
    extent : float
        Largest range of a joint [rad or m].
    boundary_state : array, shape (6, n_joints)
        q, q̇, q̈ at the start, then at the end.
    warp : array, shape (n_warp_phases,)
        See :func:`.align`.
    shape : array, shape (n_joints, n_functions)
        Coefficients of the motion less its boundary part, see :func:`shape_functions`.
    shape_remainder : array, shape (n_joints,)
        Sum of squares over the phases of the residual of these coefficients.
    angles : array, shape (n_joints, n_angle_functions)
        Coefficients of the joint angles over time.
    angle_remainder : array, shape (n_joints,)
        The same for the joint angles over time.
    """

    recording: str
    label: str
    checksum: str
    start_time: float
    end_time: float
    duration: float
    extent: float
    boundary_state: FloatArray
    warp: FloatArray
    shape: FloatArray
    shape_remainder: FloatArray
    angles: FloatArray
    angle_remainder: FloatArray


@dataclass(frozen=True, eq=False)
class MotionStatistics:
    """Summaries of demonstrations of the same joints.

    Attributes
    ----------
    joint_names : tuple of str
        Their joints.
    motions : tuple of MotionSummary
        Summary of each.
    """

    joint_names: tuple[str, ...]
    motions: tuple[MotionSummary, ...]

    @classmethod
    def of(
        cls, demonstrations: Sequence[Demonstration], options: PrimitiveOptions
    ) -> MotionStatistics:
        """Summarise demonstrations.

        Parameters
        ----------
        demonstrations :
            Motions of the same joints in the same order, at least one; with the alignment 'dtw',
            all of the primitive.
        options :
            How the primitive is built.

        Raises
        ------
        PrimitiveError
            If they have different joints.
        """
        _check_joints([(d.joint_names, d.recording) for d in demonstrations])
        warps = align(demonstrations, options.align)
        motions = (_summarise(d, w, options) for d, w in zip(demonstrations, warps, strict=True))
        return cls(demonstrations[0].joint_names, tuple(motions))

    @classmethod
    def merged(cls, parts: Iterable[MotionStatistics]) -> MotionStatistics:
        """Merge the statistics of parts of the demonstrations, at least one part.

        Raises
        ------
        PrimitiveError
            If they have different joints.
        """
        ordered = list(parts)
        _check_joints([(x.joint_names, x.motions[0].recording) for x in ordered])
        motions = tuple(motion for part in ordered for motion in part.motions)
        return cls(ordered[0].joint_names, motions)

    def stacked(self, name: str) -> FloatArray:
        """An attribute of all motions, shape (n_demonstrations, ...)."""
        return np.array([getattr(motion, name) for motion in self.motions])


@lru_cache(maxsize=8)
def shape_functions(degree: int, n_phases: int) -> tuple[FloatArray, FloatArray]:
    """Polynomials that vanish with two derivatives at both ends, orthonormal on the phases.

    A shape that is sampled at the phases has the coefficients of its least-squares fit as inner
    products with them, and distances between coefficients are distances between samples.

    Parameters
    ----------
    degree : int
        Their highest degree.
    n_phases : int
        Number of phases, evenly spaced from 0 to 1.

    Returns
    -------
    values : array, shape (n_phases, n_functions)
        Their values.
    legendre_coefficients : array, shape (n_functions, degree + 1)
        The same polynomials as Legendre series.
    """
    admissible = end_vanishing_coefficients(degree)
    phases = np.linspace(0.0, 1.0, n_phases)
    values, triangle = np.linalg.qr(legendre_values(admissible, phases))
    return values, np.linalg.solve(triangle.T, admissible)


@lru_cache(maxsize=8)
def _angle_functions(n_phases: int) -> FloatArray:
    """Polynomials that are orthonormal on the phases, shape (n_phases, n_functions)."""
    degree = min(n_phases - 1, _ANGLE_DEGREE)
    return np.linalg.qr(legendre.legvander(np.linspace(-1.0, 1.0, n_phases), degree))[0]


def _summarise(
    demonstration: Demonstration, warp: FloatArray, options: PrimitiveOptions
) -> MotionSummary:
    phases = np.linspace(0.0, 1.0, options.n_phases)
    positions = aligned_positions(demonstration, warp, phases)
    curves = (demonstration.positions, demonstration.velocities, demonstration.accelerations)
    state = np.array([curve[end] for end in (0, -1) for curve in curves])
    if options.align != "linear":
        state[[1, 2, 4, 5]] = 0.0  # a re-timed motion counts as one from rest to rest
    duration = demonstration.duration
    boundary = boundary_values(tuple(state[:3]), tuple(state[3:]), duration)
    functions, _ = shape_functions(options.degree, options.n_phases)
    shape, remainder = _project(positions - hermite_functions(phases) @ boundary, functions)
    angles, angle_remainder = _project(
        demonstration.time_normalised(options.n_phases), _angle_functions(options.n_phases)
    )
    return MotionSummary(
        recording=demonstration.recording,
        label=demonstration.label,
        checksum=demonstration.checksum,
        start_time=demonstration.start_time,
        end_time=demonstration.end_time,
        duration=duration,
        extent=float(np.ptp(positions, axis=0).max()),
        boundary_state=state,
        warp=warp,
        shape=shape,
        shape_remainder=remainder,
        angles=angles,
        angle_remainder=angle_remainder,
    )


def _project(curves: FloatArray, functions: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Coefficients of curves of shape (n_phases, n_joints), and the squares of their residuals."""
    coefficients = curves.T @ functions
    rest = curves - functions @ coefficients.T
    return coefficients, np.asarray(np.sum(rest**2, axis=0))


def _check_joints(found: Sequence[tuple[tuple[str, ...], str]]) -> None:
    """Reject recordings, given with their joints, whose joints differ from those of the first."""
    first, first_recording = found[0]
    for joint_names, recording in found:
        if joint_names != first:
            raise PrimitiveError(
                f"the joints of '{recording}', {joint_names}, "
                f"are not those of '{first_recording}', {first}"
            )
