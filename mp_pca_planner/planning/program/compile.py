# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""From a request and a setting to a program: step 3 of planning."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from ...arrays import FloatArray
from ...primitives.prediction import ConditionalDistribution
from ..context import Context
from ..request import Request
from .bases import NEAR_EXPECTED, MotionBasis
from .constraints import AlongPath, Clearance, Constraint, Ends, PoseTarget
from .limits import Limits, limit_shares
from .motion_program import Chain, MotionProgram, junctions_of
from .segment import (
    END_SCALES,
    GOAL_POSITION,
    LOG_DURATION_SCALE,
    Naturalness,
    SegmentProgram,
    Unknowns,
)
from .setting import Setting

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


def compile_program(context: Context, request: Request, setting: Setting) -> MotionProgram:
    """Make the program of a request."""
    junctions = junctions_of(request, setting.initial)
    segments, terms, targets = [], [], list[PoseTarget | None]()
    # Whether motions stay near an expected one.
    near = setting.naturalness >= NEAR_EXPECTED
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
        segment = SegmentProgram(
            context.robot, tables, unknowns, motion.weights, setting.objectives
        )
        segments.append(segment)
        near = near and basis.precision is not None
        terms.append(_naturalness(context, request, setting, segment, i))
        targets.append(None)
        if requested.pose is not None:
            targets[i] = PoseTarget(context.robot, tables, unknowns, requested.pose)
    links = Chain(junctions, segments) if request.mode else None
    starts = [links.start] if links else _starts(setting, segments[0], terms[0], near)
    collision, clear = context.collision, setting.bases[0].is_detour
    among = collision is not None and len(collision.world)
    if collision is not None and among and not (clear or links or setting.is_shortest):
        # Whether bodies collide at a quadrature node of the first motion. Links alone rarely do;
        # the check of the motion finds it.
        clear = collision.collide_anywhere(segments[0].states(starts[0])[0])
    constraints = []
    for segment, natural, (here, there) in zip(segments, terms, pairwise(junctions), strict=True):
        ends = here.fixed_state, there.fixed_state
        constraints.append(_constraints(context, segment, natural, ends, near=near, clear=clear))
    return MotionProgram(segments, terms, constraints, targets, links, starts)


def _naturalness(
    context: Context, request: Request, setting: Setting, program: SegmentProgram, i: int
) -> list[Naturalness]:
    """The cost of deviations from the expected motion.

    Its unit is the cost of that motion; in a sequence, the effort of the joined motion.
    """
    basis, segment = setting.bases[i], request.segments[i]
    price = setting.naturalness
    if request.mode:
        price *= program.effort(program.expected)
        precision = _segment_precision(program, basis, segment.expected)
    elif basis.precision is not None and price > 0.0:
        # A free goal is natural where demonstrations end.
        goals = segment.primitive.boundary_states[:, GOAL_POSITION]
        precision = _goal_precision(program, basis, goals)
    else:
        return []
    return [Naturalness(program.expected, price * precision)]


def _goal_precision(segment: SegmentProgram, basis: MotionBasis, goals: FloatArray) -> FloatArray:
    """Precision of the unknowns of a motion to a single goal, in units of its objective.

    The cost of one standard deviation from the expected motion is the larger of two values: the
    cost of that motion, and 8 times the decrease of the objective along one standard
    deviation. The second keeps motions natural if their effort could decrease fast: to first order,
    the optimum is at most 1 / (8 ρ) standard deviations away.

    Parameters
    ----------
    segment : SegmentProgram
        The motion.
    basis : MotionBasis
        Its basis, with a prediction.
    goals : array, shape (n_demonstrations, n_joints)
        Goals of the demonstrations. A free goal is natural near the configuration of the search
        that is most like them; their spread is the unit of its changes.

    Returns
    -------
    precision : array, shape (n_unknowns, n_unknowns)
        At ρ = 1.
    """
    assert basis.precision is not None
    n, size = segment.unknowns.n_weights, segment.unknowns.scales.size
    own = basis.precision * np.outer(segment.unknowns.scales[:n], segment.unknowns.scales[:n])
    precision = np.zeros((size, size))
    precision[:n, :n] = own
    free = range(n, segment.unknowns.n_linear)
    if free:
        spread = np.maximum(goals.std(axis=0), _MIN_SPREAD)
        precision[free, free] = (END_SCALES[GOAL_POSITION] / spread) ** 2
    _, here = segment.at(segment.expected)
    descent = float(np.sqrt(here.gradient[:n] @ np.linalg.solve(own, here.gradient[:n])))
    return precision * max(here.cost, _EFFORT_WEIGHT * descent)


def _segment_precision(
    segment: SegmentProgram,
    basis: MotionBasis,
    expected: ConditionalDistribution,
) -> FloatArray:
    """Precision of the unknowns of a segment, shape (n_unknowns, n_unknowns).

    A change of the boundary states bends the motion as weights do. Its cost is relative to the
    spread of the demonstrations of each joint, averaged over the motion.
    """
    unknowns, tables = segment.unknowns, basis.tables
    n, n_joints = unknowns.n_weights, unknowns.boundary.shape[1]
    precision = np.zeros((segment.unknowns.scales.size, segment.unknowns.scales.size))
    if basis.precision is not None:
        precision[:n, :n] = basis.precision * np.outer(
            segment.unknowns.scales[:n], segment.unknowns.scales[:n]
        )
    if unknowns.duration_is_free:
        precision[unknowns.n_linear, unknowns.n_linear] = (
            LOG_DURATION_SCALE / _DURATION_SPREAD
        ) ** 2
    variances = np.zeros(n_joints)
    if basis.n_components:
        k = basis.n_components
        functions = tables.values[0, 1:-1, :, 1 : k + 1]
        variances = np.einsum(
            "k,kji,il,kjl->j", tables.quadrature, functions, expected.covariance, functions
        )
    spreads = _BEND_SPREAD * np.maximum(np.sqrt(variances), _MIN_SPREAD)
    rows = unknowns.free_rows
    bends = tables.hermite[0, 1:-1, rows].T * END_SCALES[rows]
    gram = bends.T @ (bends * tables.quadrature[:, None])
    for j in range(n_joints):
        index = n + j + n_joints * np.arange(len(rows))
        precision[np.ix_(index, index)] += gram / spreads[j] ** 2
    return precision


def _constraints(
    context: Context,
    program: SegmentProgram,
    natural: list[Naturalness],
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
        expected, _ = program.at(program.expected)
        timed, is_known = unknowns.n_linear, not unknowns.duration_is_free
        if natural and not is_known:
            is_known = natural[0].precision[timed, timed] > 0.0
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


def _starts(
    setting: Setting, program: SegmentProgram, terms: list[Naturalness], is_near: bool
) -> list[FloatArray]:
    """Unknowns to start from, the cheapest first."""
    n_starts = 1 if is_near else None
    found = program.unknowns.from_weights(np.array(setting.bases[0].starts[:n_starts]))
    if len(found) > 1:
        costs = program.costs(found)
        for term in terms:
            off = found - term.expected
            costs += 0.5 * np.einsum("ij,jk,ik->i", off, term.precision, off)
        found = found[np.argsort(costs, kind="stable")]
    return list(found)
