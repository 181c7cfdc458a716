# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Statistics of demonstrations: a few hundred numbers for each, enough to build a primitive.

Samples are not kept: a shape becomes its coefficients in the polynomials of the primitive.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..exceptions import PrimitiveError, quote_names
from ..motion.interpolation import boundary_values, hermite_functions
from .basis import end_vanishing_coefficients, legendre_values
from .timing import KNOTS, arc_length_warp, fit_paces, own_phases

# The node loads primitives, but needs neither recordings nor the parts of SciPy that they need.
if TYPE_CHECKING:
    from ..recordings.demonstration import Demonstration
    from .build import PrimitiveOptions

_FACTS = ("recording", "label", "checksum", "start_time_s", "end_time_s")
# Highest degree of the polynomials that represent joint angles over time. Only the first components
# are reported, which are much smoother.
_ANGLE_DEGREE = 30
# Samples of a motion to measure its path: many for each knot of the warp.
_PATH_SAMPLES = 1001
# Predictions are fitted to fewer: the time grows with the cube of their number.
_MAX_FITTED = 200


@dataclass(frozen=True, eq=False)
class MotionStatistics:
    """Statistics of demonstrations of the same joints.

    Attributes
    ----------
    joint_names : tuple of str
        Their joints.
    durations : array, shape (n_demonstrations,)
        Their durations [s].
    extents : array, shape (n_demonstrations,)
        Norms over the joints of the distances that each covers [rad or m].
    boundary_states : array, shape (n_demonstrations, 6, n_joints)
        q, q̇, q̈ at the start, then at the end; q̇ and q̈ are zero.
    warps : array, shape (n_demonstrations, n_warp_phases)
        Shares of the durations at the :data:`.timing.KNOTS`, strictly increasing from 0 to 1.
    paces : array, shape (n_demonstrations, PACE_DEGREE)
        See :func:`.fit_paces`.
    shapes : array, shape (n_demonstrations, n_joints, n_functions)
        Coefficients of the motions less their boundary parts, see :func:`shape_functions`.
    shape_remainders : array, shape (n_demonstrations, n_joints)
        Sums of squares over the phases of the residuals of these coefficients.
    angles : array, shape (n_demonstrations, n_joints, n_angle_functions)
        Coefficients of the joint angles over time.
    angle_remainders : array, shape (n_demonstrations, n_joints)
        The same for the joint angles over time.
    sources : tuple of dict
        Where each comes from, as in the metadata of a primitive: recording, label, checksum, and
        when it starts and ends, in seconds after the first message of the recording.
    """

    joint_names: tuple[str, ...]
    durations: FloatArray
    extents: FloatArray
    boundary_states: FloatArray
    warps: FloatArray
    paces: FloatArray
    shapes: FloatArray
    shape_remainders: FloatArray
    angles: FloatArray
    angle_remainders: FloatArray
    sources: tuple[dict[str, Any], ...]

    @classmethod
    def of(
        cls, demonstrations: Sequence[Demonstration], options: PrimitiveOptions
    ) -> MotionStatistics:
        """Summarise demonstrations.

        Parameters
        ----------
        demonstrations :
            Motions of the same joints in the same order, at least one.
        options :
            How the primitive is built.

        Raises
        ------
        PrimitiveError
            If they have different joints.
        """
        first, n, n_phases = demonstrations[0], len(demonstrations), options.n_phases
        phases, n_joints = np.linspace(0.0, 1.0, n_phases), len(first.joint_names)
        durations, jerks = np.empty((2, n))
        ranges, states = np.empty((n, n_joints)), np.empty((n, 6, n_joints))
        over_time, aligned, quintics = np.empty((3, n, n_phases, n_joints))
        warps, sources = np.tile(KNOTS, (n, 1)), []
        for i, d in enumerate(demonstrations):
            if d.joint_names != first.joint_names:
                raise PrimitiveError(
                    f"the joints of '{d.recording}', {quote_names(d.joint_names)}, are not those "
                    f"of '{first.recording}', {quote_names(first.joint_names)}: choose joints that "
                    "all have, or leave recordings out"
                )
            facts = d.recording, d.label, d.checksum, d.start_time, d.end_time
            sources.append(dict(zip(_FACTS, facts, strict=True)))
            durations[i] = d.duration
            # The largest jerk, in units of the path length per cubed duration.
            path = np.linalg.norm(np.diff(d.positions, axis=0), axis=1).sum()
            jerk = np.linalg.norm(np.gradient(d.accelerations, d.times, axis=0), axis=1).max()
            jerks[i] = jerk * d.duration**3 / max(path, 1e-9)
            ranges[i] = np.ptp(d.positions, axis=0)
            # Joint angles over time: what [P] analyses.
            over_time[i] = d.time_normalised(n_phases)
            # All count as motions from rest to rest, as they are predicted: what is measured at the
            # ends is noisy, and the quintic would spread it over the motion.
            states[i] = 0.0
            states[i, [0, 3]] = d.positions[[0, -1]]
            ends = boundary_values(states[i, :3], states[i, 3:], d.duration)
            quintics[i] = hermite_functions(phases) @ ends
            # Step 1: the same timing for all.
            if options.align == "arc_length":
                warps[i] = arc_length_warp(d.time_normalised(_PATH_SAMPLES))
            aligned[i] = d.at(d.duration * own_phases(warps[i], phases))
        paces = fit_paces(warps, jerks)
        # Step 2: what is left of each motion without the quintic between its ends.
        functions, _ = shape_functions(options.degree, n_phases)
        shapes, shape_remainders = _projected(aligned - quintics, functions)
        angles, angle_remainders = _projected(over_time, _angle_functions(n_phases))
        return cls(
            joint_names=first.joint_names,
            durations=durations,
            extents=np.linalg.norm(ranges, axis=1),
            boundary_states=states,
            warps=warps,
            paces=paces,
            shapes=shapes,
            shape_remainders=shape_remainders,
            angles=angles,
            angle_remainders=angle_remainders,
            sources=tuple(sources),
        )

    def requests(self) -> FloatArray:
        """Requests (q0, qT, log T), as rows."""
        states = self.boundary_states
        return np.column_stack([states[:, 0], states[:, 3], np.log(self.durations)])


def thinned(requests: FloatArray) -> NDArray[np.intp]:
    """Indices of at most 200 motions, the same motions whatever their order."""
    step = -(-len(requests) // _MAX_FITTED)
    return np.lexsort(requests.T[::-1])[::step] if step > 1 else np.arange(len(requests))


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
def shape_smoother(
    degree: int, n_phases: int, price: float = 1e-9, end_price: float = 3e-8
) -> FloatArray:
    """Matrix that smooths shapes, shape (n_functions, n_functions), for rows of coefficients.

    It minimises the squared change and the squared third derivative over phase together. Noise of
    the demonstrations, which alignment magnifies at their ends, would become jerk.

    Parameters
    ----------
    degree, n_phases : int
        See :func:`shape_functions`.
    price : float
        Weight of the third derivative. By default half remains of a wave of a fifth of the motion.
    end_price : float
        Its weight in the first and the last tenth of the motion.
    """
    _, coefficients = shape_functions(degree, n_phases)
    phases = np.linspace(0.0, 1.0, n_phases)
    jerks = legendre_values(coefficients, phases, 3)
    weights = np.where(np.abs(phases - 0.5) > 0.4, end_price, price)
    return np.asarray(np.linalg.inv(np.eye(jerks.shape[1]) + (jerks.T * weights) @ jerks))


@lru_cache(maxsize=8)
def _angle_functions(n_phases: int) -> FloatArray:
    """Polynomials that are orthonormal on the phases, shape (n_phases, n_functions)."""
    degree = min(n_phases - 1, _ANGLE_DEGREE)
    return np.linalg.qr(legendre.legvander(np.linspace(-1.0, 1.0, n_phases), degree))[0]


def _projected(curves: FloatArray, functions: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Coefficients of sampled curves, and sums of the squares of their residuals.

    Parameters
    ----------
    curves : array, shape (n_demonstrations, n_phases, n_joints)
        The curves.
    functions : array, shape (n_phases, n_functions)
        Orthonormal functions.
    """
    coefficients = curves.transpose(0, 2, 1) @ functions
    rest = curves - functions @ coefficients.transpose(0, 2, 1)
    return coefficients, np.asarray(np.sum(rest**2, axis=1))
