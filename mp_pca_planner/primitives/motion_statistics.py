# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Statistics of demonstrations: a few hundred numbers for each, enough to build a primitive.

A recording is mapped to the :class:`MotionStatistics` of its demonstrations, and those of all
recordings are merged. Samples are not kept: a shape becomes its coefficients in the polynomials of
the primitive.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..exceptions import PrimitiveError, quote_names, unknown_name
from ..rows import empty_rows, release, row_blocks
from .alignment import align, aligned_positions
from .basis import end_vanishing_coefficients, legendre_values
from .boundary import boundary_values, hermite_functions
from .options import PrimitiveOptions
from .pace import fit_paces

# The node loads primitives, but needs neither recordings nor the parts of SciPy that they need.
if TYPE_CHECKING:
    from ..recordings.demonstration import Demonstration

# Highest degree of the polynomials that represent joint angles over time. Only the first components
# are reported, which are much smoother.
_ANGLE_DEGREE = 30


class MotionSource(NamedTuple):
    """Where a demonstration comes from.

    Attributes
    ----------
    recording, label, checksum : str
        Of the demonstration.
    start_time, end_time : float
        When it starts and ends, in seconds after the first message of the recording.
    """

    recording: str
    label: str
    checksum: str
    start_time: float
    end_time: float

    @property
    def identity(self) -> tuple[str, float, float]:
        """Equal for the same part of the same recording, whatever its name and label."""
        return self.checksum, round(self.start_time, 6), round(self.end_time, 6)


@dataclass(frozen=True, eq=False)
class MotionStatistics:
    """Statistics of demonstrations of the same joints.

    Attributes
    ----------
    joint_names : tuple of str
        Their joints.
    motions : tuple of MotionSource
        Source of each.
    durations : array, shape (n_demonstrations,)
        Their durations [s].
    extents : array, shape (n_demonstrations,)
        Norms over the joints of the distances that each covers [rad or m].
    boundary_states : array, shape (n_demonstrations, 6, n_joints)
        q, q̇, q̈ at the start, then at the end.
    warps : array, shape (n_demonstrations, n_warp_phases)
        See :func:`.align`.
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
    """

    joint_names: tuple[str, ...]
    motions: tuple[MotionSource, ...]
    durations: FloatArray
    extents: FloatArray
    boundary_states: FloatArray
    warps: FloatArray
    paces: FloatArray
    shapes: FloatArray
    shape_remainders: FloatArray
    angles: FloatArray
    angle_remainders: FloatArray

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
        from ..recordings.segmentation import extent

        _check_joints([(d.joint_names, d.recording) for d in demonstrations])
        warps = align(demonstrations, options.align)
        pairs = zip(demonstrations, warps, strict=True)
        columns = zip(*(_summarise(d, w, options) for d, w in pairs), strict=True)
        states, shapes, remainders, angles, angle_remainders = map(np.array, columns)
        return cls(
            joint_names=demonstrations[0].joint_names,
            motions=tuple(
                MotionSource(d.recording, d.label, d.checksum, d.start_time, d.end_time)
                for d in demonstrations
            ),
            durations=np.array([d.duration for d in demonstrations]),
            extents=np.array([extent(d.positions) for d in demonstrations]),
            boundary_states=states,
            warps=warps,
            paces=fit_paces(warps),
            shapes=shapes,
            shape_remainders=remainders,
            angles=angles,
            angle_remainders=angle_remainders,
        )

    @classmethod
    def merged(cls, parts: Iterable[MotionStatistics]) -> MotionStatistics:
        """Merge the statistics of parts of the demonstrations, at least one part.

        The parts are iterated over twice. The arrays are in a temporary file if they are large.

        Raises
        ------
        PrimitiveError
            If they have different joints, or were made with other options.
        """
        first, motions = next(iter(parts)), list[MotionSource]()
        row_shapes = first.shapes.shape[1:] + first.angles.shape[1:]
        for part in parts:
            _check_joints([(x.joint_names, x.motions[0].recording) for x in (first, part)])
            if part.shapes.shape[1:] + part.angles.shape[1:] != row_shapes:
                raise PrimitiveError("statistics of different --degree or --phases can't be merged")
            motions += part.motions
        arrays = _gathered(len(motions), first, (part._arrays() for part in parts))
        return cls(first.joint_names, tuple(motions), **arrays)

    def requests_and_shapes(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Requests (q0, qT, log T), shapes, and shapes of the reversed motions, as rows."""
        ends = self.boundary_states[:, 0], self.boundary_states[:, 3]
        # The functions of the shapes are alternately even and odd.
        reversed_shapes = self.shapes * (-1.0) ** np.arange(self.shapes.shape[2])
        there, back = (x.reshape(len(self.motions), -1) for x in (self.shapes, reversed_shapes))
        return np.column_stack([*ends, np.log(self.durations)]), there, back

    def blocks(self) -> Iterator[MotionStatistics]:
        """Some motions at a time, in order; arrays in a file take memory for these only."""
        n_done = 0
        for arrays in row_blocks(*self._arrays()):
            motions = self.motions[n_done : n_done + len(arrays[0])]
            yield MotionStatistics(self.joint_names, motions, *arrays)
            n_done += len(motions)

    def chosen(self, which: Sequence[int] | NDArray[np.intp]) -> MotionStatistics:
        """The statistics of some of the demonstrations, by index."""
        indices = np.asarray(which, dtype=np.intp)
        parts = ([array[some] for array in self._arrays()] for (some,) in row_blocks(indices))
        arrays = _gathered(len(indices), self, parts)
        release(self.angles)
        motions = tuple(self.motions[i] for i in indices)
        return MotionStatistics(self.joint_names, motions, **arrays)

    def _arrays(self) -> list[FloatArray]:
        return [getattr(self, name) for name in _ARRAYS]

    def ordered(self, joint_names: tuple[str, ...]) -> MotionStatistics:
        """The same motions with the same joints in another order."""
        order = [self.joint_names.index(name) for name in joint_names]
        of_joints = ("shapes", "shape_remainders", "angles", "angle_remainders")
        arrays = {name: getattr(self, name)[:, order] for name in of_joints}
        states = self.boundary_states[:, :, order]
        return replace(self, joint_names=joint_names, boundary_states=states, **arrays)

    def added(self, new: MotionStatistics) -> MotionStatistics:
        """These and the new ones; a motion that is in already is counted once.

        Raises
        ------
        PrimitiveError
            See :meth:`merged`.
        """
        known = {motion.identity for motion in self.motions}
        fresh = [i for i, motion in enumerate(new.motions) if motion.identity not in known]
        return MotionStatistics.merged([self, new.chosen(fresh)] if fresh else [self])

    def of_recording(self, name: str) -> list[int]:
        """Indices of the demonstrations of a recording; none if there is no such recording.

        Parameters
        ----------
        name :
            Its name, or its checksum, or the first 8 or more digits of that.

        Raises
        ------
        PrimitiveError
            If several recordings have this name.
        """
        found = [
            i
            for i, motion in enumerate(self.motions)
            if motion.recording == name or (len(name) >= 8 and motion.checksum.startswith(name))
        ]
        checksums = sorted({self.motions[i].checksum for i in found})
        if len(checksums) > 1:
            raise PrimitiveError(
                f"several recordings are called '{name}': name one by its checksum, "
                + " or ".join(checksum[:12] for checksum in checksums)
            )
        return found

    def without(self, names: Collection[str]) -> MotionStatistics:
        """These without the demonstrations of some recordings, see :meth:`of_recording`.

        Raises
        ------
        PrimitiveError
            If there is no such recording, or none would be left.
        """
        gone: set[int] = set()
        for name in names:
            found = self.of_recording(name)
            if not found:
                known = sorted({motion.recording for motion in self.motions})
                raise PrimitiveError(unknown_name("recording", name, known))
            gone.update(found)
        kept = [i for i in range(len(self.motions)) if i not in gone]
        if not kept:
            raise PrimitiveError("nothing would be left: at least one recording must stay")
        return self.chosen(kept)


_ARRAYS = tuple(x.name for x in fields(MotionStatistics)[2:])


def _gathered(
    n_rows: int, like: MotionStatistics, parts: Iterable[Sequence[FloatArray]]
) -> dict[str, FloatArray]:
    """All arrays by name, given some rows of all of them at a time."""
    arrays = empty_rows(n_rows, {name: getattr(like, name).shape[1:] for name in _ARRAYS})
    n_done = 0
    for part in parts:
        for array, rows in zip(arrays.values(), part, strict=True):
            array[n_done : n_done + len(rows)] = rows
            release(array)
        n_done += len(part[0])
    return arrays


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
) -> tuple[FloatArray, ...]:
    """Boundary state, shape and angles of a demonstration, the latter two with their remainders."""
    phases = np.linspace(0.0, 1.0, options.n_phases)
    positions = aligned_positions(demonstration, warp, phases)
    curves = (demonstration.positions, demonstration.velocities, demonstration.accelerations)
    state = np.array([curve[end] for end in (0, -1) for curve in curves])
    if options.align != "linear":
        state[[1, 2, 4, 5]] = 0.0  # a re-timed motion counts as one from rest to rest
    boundary = boundary_values(tuple(state[:3]), tuple(state[3:]), demonstration.duration)
    functions, _ = shape_functions(options.degree, options.n_phases)
    angles = demonstration.time_normalised(options.n_phases)
    return (
        state,
        *_project(positions - hermite_functions(phases) @ boundary, functions),
        *_project(angles, _angle_functions(options.n_phases)),
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
                f"the joints of '{recording}', {quote_names(joint_names)}, "
                f"are not those of '{first_recording}', {quote_names(first)}: choose joints that "
                "all have (--joints), or leave recordings out"
            )
