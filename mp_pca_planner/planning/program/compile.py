# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""From a request to a setting, and from these to a program: step 3 of planning.

A segment has bases from the narrowest to the widest. All components of the primitive come first:
naturalness keeps motions near the demonstrations at a lower effort than fewer components would.
Components with B-splines follow, whose motions may be unlike the demonstrations, then B-splines
alone. Where a collision-free path is known, B-splines lead the primitive's motion along it.

A setting is what is chosen for one attempt. The first attempt at a request begins with its expected
motion: segments with expected weights, joined without optimisation. The boundary parts form the
quintic spline of least jerk through the targets (de Boor, "A Practical Guide to Splines", 1978: one
banded system).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise

import numpy as np

from ...arrays import FloatArray
from ...lazy import LazyModule
from ...motion.goal import JointState
from ...motion.interpolation import quintics
from ...motion.validation import LimitCheck
from ...primitives.basis import BSplineBasis, SumBasis
from ...primitives.primitive import MovementPrimitive
from ..context import Context
from ..motion import Motion, Tables, cost_of, node_states, rank_of
from ..objectives import Objective, time
from ..options import FREE, PlannerOptions, SolverOptions
from ..request import Request, RequestSegment
from ..solver import TINY
from ..time_scaling import least_stretch, slowdown
from .constraints import AlongPath, Clearance, Constraint, Ends, Limits, PoseTarget, limit_shares
from .motion_program import Chain, MotionProgram, junctions_of
from .segment import END_SCALES, GOAL_POSITION, LOG_DURATION_SCALE, SegmentProgram, Unknowns

linalg = LazyModule("scipy.linalg")

N_WIDTHS = 3
"""Number of bases of a segment, see :func:`segment_basis`."""

# Number of starts from demonstrations with similar ends.
_N_NEAREST = 3

NEAR_EXPECTED = 0.1
"""From this naturalness on, motions stay near the expected one.

One start is enough then, and the first attempt has only those limits in the program that the
expected motion comes near, none if it keeps them.
"""

MIN_NATURALNESS = 0.005
"""Least weight ρ of deviations from a path. Without it, the program takes too many passes."""

# Usual magnitude of the correction by B-splines [rad or m]; larger if the primitive fits worse.
_USUAL_CORRECTION = 0.02
# Control points of each joint's B-splines along paths, their deviation with the cost of naturalness
# [rad or m], and the phases between the ends at which they are fitted.
_N_CONTROL_POINTS, _PATH_SPREAD = 6, 0.3
_PATH_PHASES: FloatArray = np.linspace(0.0, 1.0, 80)[1:-1]
# Primitives whose tables stay in memory, those used last.
_N_KEPT_TABLES = 500


@dataclass(frozen=True, eq=False)
class MotionBasis:
    """A basis of motions and the distribution of its weights.

    Attributes
    ----------
    tables : Tables
        The basis at the quadrature nodes and on the grid of the limits.
    expected : array, shape (n_weights,)
        Expected weights ŵ.
    precision : array, shape (n_weights, n_weights), or None
        Λ⁻¹; None without a prediction.
    n_components : int
        Number of principal components, the first of the weights; others are of B-splines.
    starts : tuple of array
        Weights to start from; the expected ones come first.
    is_detour : bool
        Whether the expected weights are those of a motion along a collision-free path.
    """

    tables: Tables
    expected: FloatArray
    precision: FloatArray | None
    n_components: int
    starts: tuple[FloatArray, ...]
    is_detour: bool = False

    def motion(
        self,
        start: JointState,
        goal: JointState,
        duration: float,
        weights: FloatArray | None = None,
    ) -> Motion:
        """A motion with this basis, the expected one unless weights are given."""
        weights = self.expected if weights is None else weights
        return Motion(start, goal, float(duration), self.tables.basis, weights)


@lru_cache(_N_KEPT_TABLES)
def tables_of(primitive: MovementPrimitive) -> Tables:
    """The tables of a primitive's basis, without time scaling."""
    return Tables(primitive.basis)


@lru_cache(8)
def _spline_tables(n_joints: int) -> Tables:
    return Tables(BSplineBasis(n_joints))


def segment_basis(
    options: PlannerOptions, request: Request, segment: RequestSegment, width: int = 0
) -> MotionBasis:
    """A basis of a segment.

    Parameters
    ----------
    options : PlannerOptions
        Options of planning.
    request : Request
        The request. Motions of a sequence have no time scaling. Where a single motion may be far
        from the expected one, or is to be the shortest, its basis has several starts.
    segment : RequestSegment
        The segment.
    width : int
        Below `N_WIDTHS`. 0: the components of the primitive (B-splines alone if the options say
        so); 1: with B-splines of every joint added; 2: B-splines alone, without a prediction.
    """
    primitive, expected = segment.primitive, segment.expected
    if width == 2 or options.basis == "bspline":
        tables = _spline_tables(primitive.n_joints)
        zero = np.zeros(tables.basis.n_weights)
        return MotionBasis(tables, zero, None, 0, (zero,))
    ends = segment.start.positions, segment.goal.positions
    if not request.mode and expected.pace.any():
        # The basis of a motion with its own time scaling is not known in advance.
        tables = Tables(primitive.paced_basis(*ends, expected.pace))
    else:
        tables = tables_of(primitive)
    starts = [expected.weights]
    if not request.mode and (request.is_shortest or request.naturalness < NEAR_EXPECTED):
        starts.append(np.zeros_like(expected.weights))
        known = primitive.boundary_states[:, [0, 3]].reshape(len(primitive.weights), -1)
        distances = np.sum((known - np.concatenate(ends)) ** 2, axis=1)
        starts += list(primitive.weights[np.argsort(distances, kind="stable")[:_N_NEAREST]])
    weights, precision = expected.weights, expected.precision
    if width == 1:
        usual = max(float(np.sqrt(np.mean(primitive.fit_residual**2))), _USUAL_CORRECTION)
        splines = BSplineBasis(primitive.n_joints)
        tables = Tables(SumBasis(tables.basis, splines, usual))
        none = np.zeros(splines.n_weights)
        weights, *starts = (np.append(x, none) for x in (weights, *starts))
        precision = linalg.block_diag(precision, np.eye(none.size) / usual**2)
    return MotionBasis(tables, weights, precision, expected.weights.size, tuple(starts))


def basis_along(segment: RequestSegment, path: FloatArray, naturalness: float) -> MotionBasis:
    """The components and B-splines; a path takes the place of the prediction.

    Parameters
    ----------
    segment : RequestSegment
        The segment.
    path : array, shape (n_points, n_joints)
        Points with straight lines between them.
    naturalness : float
        ρ of the motion.
    """
    tables, fit = _path_tables(segment.primitive)
    natural, s = segment.expected, _PATH_PHASES
    n_components = natural.weights.size
    n_splines = tables.basis.n_weights - n_components
    weights = np.append(natural.weights, np.zeros(n_splines))
    line = Motion(segment.start, segment.goal, segment.duration, tables.basis, weights)
    lengths = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1)))
    # Minimum jerk along the path.
    along = lengths[-1] * (10.0 * s**3 - 15.0 * s**4 + 6.0 * s**5)
    points = np.stack([np.interp(along, lengths, q) for q in path.T], axis=1)
    off = points - line.evaluate(s * line.duration)[0]
    weights = np.append(natural.weights, (fit @ off).T.ravel())
    # The path is no demonstration: it counts as little at any naturalness.
    share = MIN_NATURALNESS / max(naturalness, MIN_NATURALNESS)
    of_path = np.eye(n_splines) * (share / _PATH_SPREAD**2)
    precision = linalg.block_diag(natural.precision, of_path)
    return MotionBasis(tables, weights, precision, n_components, (weights,), is_detour=True)


def rates_along(segment: RequestSegment, basis: MotionBasis) -> FloatArray:
    """Derivatives by phase of the expected motion along a path.

    Velocities, accelerations and jerks, shape (3, n_phases, n_joints).
    """
    s = np.append(0.0, np.append(_PATH_PHASES, 1.0))
    line = basis.motion(segment.start, segment.goal, segment.duration)
    shapes = basis.tables.basis.shapes(basis.expected, s, 3)
    return np.asarray((quintics(s, line.boundary, 3) + shapes)[1:])


@lru_cache(64)
def _path_tables(primitive: MovementPrimitive) -> tuple[Tables, FloatArray]:
    """The basis of a primitive's motions along paths, and the fit of its B-splines to points.

    The fit has the shape (n_control_points, n_phases). All joints have the same splines.
    """
    splines = BSplineBasis(primitive.n_joints, _N_CONTROL_POINTS)
    basis = SumBasis(primitive.basis, splines, _PATH_SPREAD)
    fit = np.linalg.pinv(splines.functions(_PATH_PHASES)[:, 0, :_N_CONTROL_POINTS])
    return Tables(basis), np.asarray(fit)


SCALING_MARGIN = 1.02
"""Factor on the duration at which the expected motion just keeps the limits at the nodes.

It is for the peaks between them.
"""

MAX_STRETCH = 10.0
"""Largest factor of a free duration where an attempt does not meet the limits."""

# Cost of the planner's objectives as a share of that of time, for the shortest duration.
_SHARE_IN_SHORTEST = 1e-3
# Share of a limit from which on the expected motion is near it.
_NEAR_LIMIT = 0.7
# The unit of naturalness is the cost of the expected motion, or this multiple of the decrease of
# the objective along one standard deviation of the weights, if that is larger.
_EFFORT_WEIGHT = 8.0
# Change of the logarithm of a segment's duration with the same cost as one standard deviation of
# the weights.
_DURATION_SPREAD = 0.3
# Passing a target at speed bends segments more than in demonstrations from rest to rest. Therefore
# this number of their standard deviations counts as one (benchmarks/sequences.py), and the least
# standard deviation of a joint there [rad or m].
_BEND_SPREAD, _MIN_SPREAD = 18.0, 0.01
# Phases of a segment at which path constraints are kept at first.
_N_PATH_PHASES = 40


@dataclass(frozen=True, eq=False)
class Setting:
    """Settings of an attempt.

    Attributes
    ----------
    bases : tuple of MotionBasis
        The bases of the segments.
    initial : tuple of Motion
        The expected motion, with its duration.
    naturalness : float
        Naturalness weight ρ.
    objectives : tuple of (float, Objective)
        Running costs and their weights.
    solver : SolverOptions
        Options of the solver.
    is_timed : bool
        Whether the duration of a single segment is an unknown.
    """

    bases: tuple[MotionBasis, ...]
    initial: tuple[Motion, ...]
    naturalness: float
    objectives: tuple[tuple[float, Objective], ...]
    solver: SolverOptions = SolverOptions()
    is_timed: bool = False


def first_setting(context: Context, request: Request, basis: MotionBasis) -> Setting:
    """The setting of the first attempt at one segment, from the expected motion.

    A free duration is longer than expected if the motion exceeds limits otherwise, with a margin
    unless it is an unknown of the program, which keeps the limits itself. For the shortest
    duration, the planner's objectives count little: they choose among motions of one duration.
    """
    usual, objectives = request.duration, context.options.objectives
    is_timed = request.is_shortest or (request.duration_is_free and request.timing == FREE)
    expected = basis.motion(request.start, request.goal, usual)
    if request.duration_is_free:
        margin = 1.0 if is_timed else SCALING_MARGIN
        states = node_states(expected, basis.tables)
        stretch = margin * least_stretch(context.robot, context.limits, states)
        if 1.0 < stretch <= min(MAX_STRETCH, context.longest / usual):
            expected = replace(expected, duration=usual * stretch)
    if not request.is_shortest:
        naturalness = request.naturalness
        return Setting((basis,), (expected,), naturalness, objectives, is_timed=is_timed)
    cost = cost_of(context.robot, expected, basis.tables, objectives)
    share = _SHARE_IN_SHORTEST * expected.duration / max(cost, TINY)
    others = [(share * weight, objective) for weight, objective in objectives]
    return Setting((basis,), (expected,), 0.0, ((1.0, time), *others), is_timed=True)


def expected_cost(context: Context, request: Request) -> float:
    """The objective of the expected motion of one segment, in the duration that limits allow.

    Near the demonstrations, it is within some percent of the cost of the motion that is planned.
    """
    basis = segment_basis(context.options, request, request.segments[0])
    setting = first_setting(context, request, basis)
    return rank_of(cost_of(context.robot, setting.initial[0], basis.tables, setting.objectives))


def lasting(setting: Setting, duration: float) -> Setting:
    """The setting with the expected motion of a given duration."""
    basis, motion = setting.bases[0], setting.initial[0]
    initial = (basis.motion(motion.start, motion.goal, duration),)
    return replace(setting, initial=initial, is_timed=False)


def joined_motion(
    request: Request,
    bases: Sequence[MotionBasis],
    durations: Sequence[float],
    share: float = 1.0,
) -> tuple[Motion, ...]:
    """The expected motion of a sequence.

    Parameters
    ----------
    request : Request
        The request.
    bases : sequence of MotionBasis
        The bases of the segments.
    durations : sequence of float
        Durations of the segments [s].
    share : float
        Factor of the velocities and accelerations at targets that are passed.
    """
    ends = pairwise(_passing_states(request, durations, share))
    return tuple(
        basis.motion(here, there, duration)
        for (here, there), duration, basis in zip(ends, durations, bases, strict=True)
    )


def _passing_states(request: Request, durations: Sequence[float], share: float) -> list[JointState]:
    """States at the start and at the targets, by splines between rests."""
    # Imported here, because the import is slow and a node may never need it.
    from scipy.interpolate import make_interp_spline

    segments, first = request.segments, request.start
    times = np.concatenate([[0.0], np.cumsum(durations)])
    places = np.array([first.positions, *(segment.goal.positions for segment in segments)])
    rest, rates = np.zeros_like(first.positions), np.zeros((2, *places.shape))
    rates[:, 0] = first.velocities, first.accelerations
    stops = np.flatnonzero([segment.stops for segment in segments])
    for i, j in pairwise([0, *(stops + 1)]):
        spline = make_interp_spline(
            times[i : j + 1],
            places[i : j + 1],
            k=5,
            bc_type=([(1, rates[0, i]), (2, rates[1, i])], [(1, rest), (2, rest)]),
        )
        for d in (1, 2):
            rates[d - 1, i + 1 : j] = share * spline.derivative(d)(times[i + 1 : j])
    return [JointState(first.joint_names, q, v, a) for q, v, a in zip(places, *rates, strict=True)]


def stretched(
    request: Request, check: LimitCheck, durations: Sequence[float], most: float
) -> list[float]:
    """Longer durations of the free groups in which a limit is violated.

    Parameters
    ----------
    request : Request
        The request.
    check : LimitCheck
        Check of the motion with these durations.
    durations : sequence of float
        The durations of the segments [s].
    most : float
        Largest factor on the predicted durations.
    """
    ends, longer = np.cumsum(durations), list(durations)
    for violation in check.violations:
        segment = min(int(np.searchsorted(ends, violation.time)), len(durations) - 1)
        group, is_fixed = next(one for one in request.groups if segment in one[0])
        if is_fixed or durations[segment] > most * request.segments[segment].duration:
            continue
        factor = slowdown([violation])
        for i in group:
            longer[i] = max(longer[i], durations[i] * factor)
    return longer


def compile_program(context: Context, request: Request, setting: Setting) -> MotionProgram:
    """Make the program of a request."""
    junctions = junctions_of(request, setting.initial)
    segments = []
    for i, (requested, basis) in enumerate(zip(request.segments, setting.bases, strict=True)):
        here, there = junctions[i : i + 2]
        motion, tables = setting.initial[i], basis.tables
        unknowns = Unknowns(
            tables.basis.scales,
            motion.boundary,
            motion.duration,
            free_orders=(here.orders, there.orders),
            duration_is_free=setting.is_timed or here.time_is_free or there.time_is_free,
        )
        objectives = setting.objectives
        segment = SegmentProgram(context.robot, tables, unknowns, motion.weights, objectives)
        segment.precision = _precision(request, setting, segment, i)
        if requested.pose is not None:
            segment.target = PoseTarget(context.robot, tables, unknowns, requested.pose)
        segments.append(segment)
    # Whether motions stay near an expected one.
    near = setting.naturalness >= NEAR_EXPECTED
    near &= all(basis.precision is not None for basis in setting.bases)
    links = Chain(junctions, segments) if request.mode else None
    if links:
        starts = [links.start]
    else:
        basis, motion = setting.bases[0], setting.initial[0]
        weights = list(basis.starts[: 1 if near else None])
        starts = [segments[0].unknowns.from_weights(one) for one in weights]
        if len(starts) > 1:  # the cheapest first
            costs = [segments[0].naturalness(x)[0] for x in starts]
            for i, one in enumerate(weights):
                tried = replace(motion, weights=one)
                costs[i] += cost_of(context.robot, tried, basis.tables, setting.objectives)
            starts = [starts[i] for i in np.argsort(costs, kind="stable")]
    collision, clear = context.collision, setting.bases[0].is_detour
    among = collision is not None and len(collision.world)
    if collision is not None and among and not (clear or links or request.is_shortest):
        # Whether bodies collide at a quadrature node of the first motion. Links alone rarely do;
        # the check of the motion finds it.
        clear = collision.collide_anywhere(segments[0].at(starts[0]).nodes.positions)
    constraints = []
    for segment, (here, there) in zip(segments, pairwise(junctions), strict=True):
        ends = here.fixed_state, there.fixed_state
        constraints.append(_constraints(context, segment, ends, near=near, clear=clear))
    return MotionProgram(segments, constraints, links, starts)


def _precision(request: Request, setting: Setting, segment: SegmentProgram, i: int) -> FloatArray:
    """ρΛ⁻¹ of deviations of a segment from the expected motion, by its unknowns.

    In a sequence, its unit is the effort of the joined motion. A change of the boundary states
    bends the motion as weights do: its cost is relative to the spread of the demonstrations of each
    joint, averaged over the motion.

    Of a single motion, the cost of one standard deviation from the expected motion is the larger of
    two values: the cost of that motion, and 8 times the decrease of the objective along one
    standard deviation. The second keeps motions natural if their effort could decrease fast: to
    first order, the optimum is at most 1 / (8 ρ) standard deviations away. A free goal is natural
    near the configuration of the search that is most like the demonstrations; the spread of their
    goals is the unit of its changes.
    """
    basis, requested, price = setting.bases[i], request.segments[i], setting.naturalness
    unknowns, precision = segment.unknowns, np.zeros_like(segment.precision)
    n, n_joints, scales = unknowns.n_weights, unknowns.n_joints, unknowns.scales
    if basis.precision is not None:
        precision[:n, :n] = basis.precision * np.outer(scales[:n], scales[:n])
    if not request.mode:
        if basis.precision is None or not price > 0.0:
            return segment.precision
        if unknowns.free_rows:
            goals = requested.primitive.boundary_states[:, GOAL_POSITION]
            spread = np.maximum(goals.std(axis=0), _MIN_SPREAD)
            free = range(n, unknowns.n_linear)
            precision[free, free] = (END_SCALES[GOAL_POSITION] / spread) ** 2
        here = segment.at(segment.expected)
        slope, own = here.gradient[:n], precision[:n, :n]
        descent = float(np.sqrt(slope @ np.linalg.solve(own, slope)))
        return price * (precision * max(here.cost, _EFFORT_WEIGHT * descent))
    if unknowns.duration_is_free:
        timed = unknowns.n_linear
        precision[timed, timed] = (LOG_DURATION_SCALE / _DURATION_SPREAD) ** 2
    variances, tables = np.zeros(n_joints), basis.tables
    if basis.n_components:
        functions = tables.values[0, 1:-1, :, 1 : basis.n_components + 1]
        covariance = requested.expected.covariance
        variances = np.einsum(
            "k,kji,il,kjl->j", tables.quadrature, functions, covariance, functions
        )
    spreads = _BEND_SPREAD * np.maximum(np.sqrt(variances), _MIN_SPREAD)
    rows = unknowns.free_rows
    bends = tables.hermite[0, 1:-1, rows].T * END_SCALES[rows]
    gram = bends.T @ (bends * tables.quadrature[:, None])
    for j in range(n_joints):
        index = n + j + n_joints * np.arange(len(rows))
        precision[np.ix_(index, index)] += gram / spreads[j] ** 2
    return price * segment.effort(segment.expected) * precision


def _constraints(
    context: Context,
    program: SegmentProgram,
    ends: Ends,
    *,
    near: bool,
    clear: bool,
) -> list[Constraint]:
    """The constraints of a segment. To add a constraint, append it here.

    Of limits, near an expected motion only those of which it takes more than a share; none if it
    keeps them at the nodes and its duration is known. Clearances if one of its first motions
    collides.
    """
    tables, unknowns, options = program.tables, program.unknowns, context.options
    chosen = None
    if near:
        expected = program.at(program.expected)
        timed, is_known = unknowns.n_linear, not unknowns.duration_is_free
        is_known = is_known or bool(program.precision[timed, timed] > 0.0)
        shares = limit_shares(context.limits, expected.states, expected.nodes.efforts).max(axis=1)
        is_within = is_known and bool(np.all(shares <= 1.0))
        chosen = ~(shares <= (1.0 if is_within else _NEAR_LIMIT))
    found: list[Constraint] = [
        Limits(context.robot, tables, unknowns, context.limits, ends, chosen)
    ]
    if context.collision is not None:
        basis = tables.basis
        clearance = Clearance(context.collision, unknowns, basis, ends)
        found.append(clearance.everywhere() if clear else clearance)
    for path in options.constraints:
        phases = np.linspace(0.0, 1.0, _N_PATH_PHASES)
        found.append(AlongPath(context.robot, path, unknowns, tables.basis, ends, phases))
    return found
