# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The case study of [P], Section 4: arm motions, their components, and a planned motion.

The planning method of [P]: one PCA of the joint angles themselves for each joint; mean and
components as fourth-order polynomials; motions m(s) + Σ wₖ φₖ(s) whose end points are linear
equality constraints on the weights. Velocities at the ends are free, since [P] states no constraint
on them. The weights that meet the constraints are an affine space, whose coordinates are the
unknowns: for every joint, their number is that of the components kept minus two.

Such a program has several minima. It is solved from many starts, until two of them lead to the
least effort that is found. B-splines are treated alike, with ends at rest and with free ends.
Efforts and times of all starts are kept, so that methods are compared with the same number of
starts.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.polynomial import legendre
from prediction import (
    BSPLINES,
    LEAST_EFFORT,
    PLANNED,
    Comparison,
    Prediction,
    Predictor,
    compare,
)
from scipy.linalg import null_space

from mp_pca_planner.arrays import FloatArray
from mp_pca_planner.exceptions import PrimitiveError
from mp_pca_planner.motion.interpolation import hermite_functions
from mp_pca_planner.planning.context import one_blas_thread
from mp_pca_planner.planning.motion import Tables
from mp_pca_planner.planning.program.motion_program import MotionProgram
from mp_pca_planner.planning.program.segment import SegmentProgram, Unknowns
from mp_pca_planner.planning.solver import solve
from mp_pca_planner.primitives.basis import Basis, BSplineBasis, PolynomialBasis, legendre_values
from mp_pca_planner.primitives.differences import FINE_PHASES
from mp_pca_planner.primitives.pca import PrincipalComponents, fit_components
from mp_pca_planner.recordings.demonstration import Demonstration
from mp_pca_planner.robot.model import Robot

N_COMPONENTS = 4
"""Components kept of each joint ([P] Table 2)."""

DEGREE = 4
"""Degree of their polynomials ([P] Section 4)."""

MAX_ROUNDS = 3
"""Largest number of rounds of starts of a search."""

# Samples of a motion.
_N_PHASES = 101
# Standard deviations of random starts, in turn, in units of the usual weights.
_SPREADS = (1.0, 2.0, 4.0, 8.0)
# Usual weights of B-splines [rad], similar to those of the paper's components.
_BSPLINE_SCALE = 0.2
# Relative difference of efforts that count as the same.
_AGREEMENT = 0.01


def angle_components(motions: Sequence[Demonstration]) -> list[PrincipalComponents]:
    """Components of the joint angles over time, joint by joint ([P] eq. (1)–(5))."""
    angles = np.array([motion.time_normalised(_N_PHASES) for motion in motions])
    return [fit_components(angles[:, :, j]) for j in range(angles.shape[2])]


def paper_basis(
    components: Sequence[PrincipalComponents], start: FloatArray, goal: FloatArray
) -> PolynomialBasis:
    """The basis of all motions between two positions that the components can represent.

    Parameters
    ----------
    components :
        Of each joint, see :func:`angle_components`.
    start, goal : array, shape (n_joints,)
        Positions [rad or m].

    Returns
    -------
    basis : PolynomialBasis
        Its mean is the likeliest of these motions; its weights, of unit variance, are those of
        the others. Unlike other bases, its functions include the boundary part.
    """
    n_joints, phases = len(components), np.array([0.0, 1.0])
    means, functions = [], []
    for j, found in enumerate(components):
        # Scaled by standard deviations, so that the shortest vector of weights is the likeliest.
        deviations = np.sqrt(found.explained_variance[:N_COMPONENTS])
        scaled = found.components[:N_COMPONENTS] * deviations[:, None]
        mean, polynomials = _polynomials(found.mean), _polynomials(scaled)
        at_ends = legendre_values(polynomials, phases).reshape(2, -1)
        missing = np.array([start[j], goal[j]]) - legendre_values(mean, phases)
        weights = np.linalg.lstsq(at_ends, missing, rcond=None)[0]
        means.append(mean + weights @ polynomials)
        for direction in null_space(at_ends).T if at_ends.size else ():
            function = np.zeros((n_joints, DEGREE + 1))
            function[j] = direction @ polynomials
            functions.append(function)
    return PolynomialBasis(
        np.array(means),
        np.reshape(functions, (-1, n_joints, DEGREE + 1)),
        np.ones(len(functions)),
    )


def paper_method(robot: Robot, n_starts: int) -> Predictor:
    """The method of the paper, as a predictor for comparisons."""

    def predict(motion: Demonstration, others: Sequence[Demonstration]) -> Prediction:
        """Plan between the ends of a motion with its duration."""
        components = angle_components(others)
        began = time.perf_counter()
        basis = paper_basis(components, *motion.positions[[0, -1]])
        # The basis includes the end points, so there is no boundary part.
        boundary = np.zeros((6, motion.n_joints))
        unknowns = Unknowns(basis.scales, boundary, motion.duration)
        return _least_effort(robot, basis, unknowns, n_starts, began)

    return predict


def bsplines(robot: Robot, n_starts: int, *, free_ends: bool) -> Predictor:
    """B-splines of least effort, as a predictor.

    They have 6 free control points for each joint. With free ends, velocities and accelerations at
    the ends are unknowns, too: 4 more control points, which otherwise bring the motion to rest.
    """
    orders = (1, 2) if free_ends else ()

    @cache  # The other motions have no effect.
    def plan(motion: Demonstration) -> Prediction:
        """Plan between the ends of a motion with its duration."""
        began = time.perf_counter()
        basis = BSplineBasis(motion.n_joints)
        boundary = np.zeros((6, motion.n_joints))
        boundary[[0, 3]] = motion.positions[[0, -1]]
        scales = np.full(basis.n_weights, _BSPLINE_SCALE)
        unknowns = Unknowns(scales, boundary, motion.duration, free_orders=(orders, orders))
        return _least_effort(robot, basis, unknowns, n_starts, began)

    return lambda motion, _: plan(motion)


def _least_effort(
    robot: Robot, basis: Basis, unknowns: Unknowns, n_starts: int, began: float
) -> Prediction:
    """The motion of least effort of a basis, from the likeliest weights and from random starts.

    Rounds of starts follow until two starts agree on the least effort.
    """
    rng = np.random.default_rng(1)
    segment = SegmentProgram(robot, Tables(basis), unknowns, np.zeros(basis.n_weights))
    problem = MotionProgram([segment], [[]])
    starts, best = list[tuple[float, float]](), None
    with one_blas_thread():
        for k in range(n_starts * MAX_ROUNDS):
            x = _SPREADS[k % len(_SPREADS)] * rng.normal(size=unknowns.scales.size) * (k > 0)
            found = solve(problem, x)
            # The first start includes the time to set up the program.
            ended = time.perf_counter()
            starts.append((found.cost, ended - began))
            began, best = ended, found if best is None or found.cost < best.cost else best
            if (k + 1) % n_starts == 0 and n_agreeing(np.array(starts)) > 1:
                break
    assert best is not None
    ends = unknowns.boundary_at(best.unknowns)
    shape = basis.shape(unknowns.weights(best.unknowns), FINE_PHASES)
    positions = hermite_functions(FINE_PHASES) @ ends + shape
    seconds = float(sum(duration for _, duration in starts))
    return Prediction(positions, best.cost, seconds, np.array(starts))


def n_agreeing(starts: FloatArray, n_starts: int | None = None) -> int:
    """Number of the first starts that lead to the least effort of all starts."""
    efforts = starts[:, 0]
    least = (1.0 + _AGREEMENT) * efforts.min()
    return int(np.sum(efforts[:n_starts] <= least))


def _polynomials(curves: FloatArray) -> FloatArray:
    """Legendre coefficients of least-squares fits to sampled curves, shape (..., degree + 1)."""
    x = np.linspace(-1.0, 1.0, _N_PHASES)
    return np.asarray(curves @ np.linalg.pinv(legendre.legvander(x, DEGREE)).T)


PAPER = "components as in the paper"
FREE_BSPLINES = "B-splines, free end velocities"
REST_BSPLINES = "B-splines, many starts"
TABLE_3_METHODS = (BSPLINES, REST_BSPLINES, FREE_BSPLINES, PAPER, LEAST_EFFORT, PLANNED)
SAME_ENDS = {REST_BSPLINES: REST_BSPLINES, FREE_BSPLINES: FREE_BSPLINES, PAPER: FREE_BSPLINES}
"""Methods with many starts, and the B-splines with the same ends."""
FREE_ENDS = (FREE_BSPLINES, PAPER)
"""Methods that leave velocities and accelerations at the ends free; others end at rest."""


@dataclass(frozen=True, eq=False)
class CaseStudy:
    """Results of the case study.

    Attributes
    ----------
    motions : tuple of Demonstration
        The motions chosen.
    components : tuple of PrincipalComponents
        Of the joint angles, joint by joint: [P] Table 2 and Fig. 2.
    raising : Demonstration
        The motion with the largest rise of the hand.
    raised : dict of str to Prediction
        The same motion planned by several methods: [P] Table 3, Figs. 3 and 4.
    held_out : Comparison
        Each of the motions planned with primitives of the others.
    other_activities : Comparison or None
        Each of them planned with primitives of other activities, if there are any.
    """

    motions: tuple[Demonstration, ...]
    components: tuple[PrincipalComponents, ...]
    raising: Demonstration
    raised: dict[str, Prediction]
    held_out: Comparison
    other_activities: Comparison | None

    def closer_than_bsplines(self, quantity: str) -> float:
        """Share of the motions for which the plan is nearer to the demonstration than B-splines."""
        ours, theirs = (self.held_out.column(name, quantity) for name in (PLANNED, BSPLINES))
        return float(np.mean(ours < theirs))

    def time_ratio(self, method: str) -> float:
        """A method's solve time as a multiple of that of B-splines, of all motions together."""
        ours, theirs = (self.held_out.column(name, "solve_time") for name in (method, BSPLINES))
        return float(np.sum(ours) / np.sum(theirs))

    def searches(self, method: str) -> list[FloatArray]:
        """Efforts and times [s] of a method's starts, shape (n_starts, 2), by motion."""
        found = (predictions[method].starts for predictions in self.held_out.predictions)
        return [starts for starts in found if starts is not None]

    def effort_and_time(self, method: str, n_starts: int | None) -> tuple[float, float]:
        """Median effort of the best of the first starts, and their time for all motions [s]."""
        first = [starts[:n_starts] for starts in self.searches(method)]
        efforts = [starts[:, 0].min() for starts in first]
        return float(np.median(efforts)), float(sum(starts[:, 1].sum() for starts in first))


def choose_motions(motions: Sequence[Demonstration], number: int) -> list[Demonstration]:
    """Choose motions from all activities in turn, evenly spread over each activity.

    Parameters
    ----------
    motions :
        All motions; their labels are the activities.
    number :
        Number of motions to choose.

    Raises
    ------
    PrimitiveError
        If there are fewer motions.
    """
    if not 3 <= number <= len(motions):
        raise PrimitiveError(
            f"{number} motions can't be chosen: the recordings hold {len(motions)}, and the case "
            "study needs at least 3"
        )
    activities = [
        [i for i, m in enumerate(motions) if m.label == label]
        for label in sorted({m.label for m in motions})
    ]
    quotas = [0] * len(activities)
    while sum(quotas) < number:
        for k, members in enumerate(activities):
            quotas[k] += int(quotas[k] < len(members) and sum(quotas) < number)
    chosen = [
        members[(2 * i + 1) * len(members) // (2 * quota)]
        for members, quota in zip(activities, quotas, strict=True)
        for i in range(quota)
    ]
    return [motions[i] for i in sorted(chosen)]


def study(
    motions: Sequence[Demonstration],
    number: int,
    robot: Robot,
    tip: str,
    progress: Callable[[int, int], None] | None = None,
    n_starts: int = 100,
) -> CaseStudy:
    """Run the case study.

    Parameters
    ----------
    motions :
        All motions.
    number :
        Number of motions to choose, see :func:`choose_motions`.
    robot :
        Model of the arm.
    tip :
        The frame at its end.
    progress :
        Called with motions done and in all.
    n_starts :
        Starts of each search for the least effort; as many more follow until two agree.

    Raises
    ------
    PrimitiveError
        If there are too few motions.
    """
    chosen = choose_motions(motions, number)
    activities = [motion.label for motion in chosen]
    groupings = [None, activities] if len(set(activities)) > 1 else [None]
    n_done = 0

    def count(*_: int) -> None:
        """Report the motions of all comparisons."""
        nonlocal n_done
        n_done += 1
        if progress is not None:
            progress(n_done, number * len(groupings))

    more = {
        PAPER: paper_method(robot, n_starts),
        REST_BSPLINES: bsplines(robot, n_starts, free_ends=False),
        FREE_BSPLINES: bsplines(robot, n_starts, free_ends=True),
    }
    held_out, *other_activities = (
        compare(chosen, groups, robot=robot, tip=tip, more=more, progress=count)
        for groups in groupings
    )
    highest = _highest_rise(held_out, robot, tip)
    planned_highest = held_out.predictions[highest]
    return CaseStudy(
        motions=tuple(chosen),
        components=tuple(angle_components(chosen)),
        raising=held_out.motions[highest],
        raised={name: planned_highest[name] for name in TABLE_3_METHODS},
        held_out=held_out,
        other_activities=other_activities[0] if other_activities else None,
    )


def variance_shares(components: Sequence[PrincipalComponents]) -> FloatArray:
    """Shares of the variance of the first four components, shape (n_joints, 4), [P] eq. (5)."""
    shares = np.zeros((len(components), N_COMPONENTS))
    for row, found in zip(shares, components, strict=True):
        if found.total_variance > 0.0:
            own = found.explained_variance[:N_COMPONENTS]
            row[: own.size] = own / found.total_variance
    return shares


def _highest_rise(held_out: Comparison, robot: Robot, tip: str) -> int:
    """Index of the motion with the largest rise of the hand."""
    ends = [motion.positions[[0, -1]] for motion in held_out.motions]
    heights = [robot.frame_positions(q, [tip])[:, 0, 2] for q in ends]
    return int(np.argmax([end - start for start, end in heights]))
