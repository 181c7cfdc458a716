# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""From a request and a setting to a problem."""

from __future__ import annotations

import numpy as np

from ...arrays import FloatArray
from ...motion.goal import JointState
from ..context import Context
from ..request import Request
from .along_path import AlongPath
from .chain import Chain, junctions_of
from .clearance import Clearance
from .constraints import Constraint
from .limits import Limits, near_limits
from .naturalness import goal_precision, segment_precision
from .problem import Problem
from .segment import SegmentProgram
from .setting import Setting
from .targets import PoseTarget
from .terms import Naturalness
from .unknowns import GOAL_POSITION, Unknowns


def compile_problem(context: Context, request: Request, setting: Setting) -> Problem:
    """Make the problem of a request."""
    junctions, near = junctions_of(request, setting.initial), is_near_expected(context, setting)
    segments, terms, constraints = [], [], []
    targets = list[PoseTarget | None]()
    for i, (segment, basis) in enumerate(zip(request.segments, setting.bases, strict=True)):
        here, there = junctions[i : i + 2]
        motion, tables = setting.initial[i], basis.tables
        unknowns = Unknowns(
            tables.basis.scales,
            motion.boundary,
            motion.duration,
            free_rows=(*here.orders, *[GOAL_POSITION + order for order in there.orders]),
            duration_is_free=setting.is_timed or here.time_is_free or there.time_is_free,
        )
        program = SegmentProgram(
            context.robot, tables, unknowns, motion.weights, setting.objectives
        )
        natural = _naturalness(context, request, setting, program, i)
        ends = here.fixed_state, there.fixed_state
        segments.append(program)
        terms.append(natural)
        constraints.append(_constraints(context, program, natural, ends, is_near=near))
        targets.append(None)
        if segment.pose is not None:
            targets[i] = PoseTarget(context.robot, tables, unknowns, segment.pose)
    links = None if request.is_single else Chain(junctions, segments)
    starts = [links.start] if links else _starts(setting, segments[0], terms[0], near)
    problem = Problem(segments, terms, constraints, targets, links, starts)
    if setting.bases[0].is_detour or _starts_in_collision(context, setting, problem):
        problem = problem.constrained([_clear(part) for part in constraints])
    return problem


def is_near_expected(context: Context, setting: Setting) -> bool:
    """Whether motions stay near an expected one."""
    uncertain = [basis for basis in setting.bases if basis.precision is None]
    return not uncertain and setting.naturalness >= context.options.search.near_expected


def _naturalness(
    context: Context, request: Request, setting: Setting, program: SegmentProgram, i: int
) -> list[Naturalness]:
    """The cost of deviations from the expected motion.

    Its unit is the cost of that motion; in a sequence, the effort of the joined motion.
    """
    search, basis, segment = context.options.search, setting.bases[i], request.segments[i]
    price = setting.naturalness
    if not request.is_single:
        price *= program.effort(program.expected)
        precision = segment_precision(program, basis, segment.expected, search)
    elif basis.precision is not None and price > 0.0:
        # A free goal is natural where demonstrations end.
        goals = segment.primitive.boundary_states[:, GOAL_POSITION]
        precision = goal_precision(program, basis, goals, search)
    else:
        return []
    return [Naturalness(program.expected, price * precision)]


def _constraints(
    context: Context,
    program: SegmentProgram,
    natural: list[Naturalness],
    ends: tuple[JointState | None, JointState | None],
    *,
    is_near: bool,
) -> list[Constraint]:
    """The constraints of a segment; of limits, those that motions are expected to come near.

    To add a constraint, append it here.
    """
    tables, unknowns, options = program.tables, program.unknowns, context.options
    chosen = None
    if is_near:
        expected, _ = program.at(program.expected)
        timed, is_known = unknowns.n_linear, not unknowns.duration_is_free
        if natural and not is_known:
            is_known = natural[0].precision[timed, timed] > 0.0
        chosen = near_limits(context.limits, expected, options.search.near_limit, is_known)
    known = [end for end in ends if end is not None]
    found: list[Constraint] = [
        Limits(context.robot, tables, unknowns, context.limits, known, chosen)
    ]
    places = [None if end is None else end.positions for end in ends]
    if context.collision is not None:
        basis = tables.basis
        found.append(Clearance(context.collision, unknowns, basis, places, options.clearance))
    for path in options.constraints:
        phases = np.linspace(0.0, 1.0, options.search.n_path_phases)
        found.append(AlongPath(context.robot, path, unknowns, tables.basis, places, phases))
    return found


def _starts(
    setting: Setting, program: SegmentProgram, terms: list[Naturalness], is_near: bool
) -> list[FloatArray]:
    """Unknowns to start from, the cheapest first."""
    n_starts = 1 if is_near else None
    found = [program.unknowns.from_weights(start) for start in setting.bases[0].starts[:n_starts]]
    if len(found) > 1:
        costs = program.costs(np.array(found))
        for term in terms:
            off = np.array(found) - term.expected
            costs += 0.5 * np.einsum("ij,jk,ik->i", off, term.precision, off)
        found = [found[i] for i in np.argsort(costs, kind="stable")]
    return found


def _starts_in_collision(context: Context, setting: Setting, problem: Problem) -> bool:
    """Whether the first motion of a single segment is in collision at a quadrature node."""
    collision = context.collision
    if collision is None or not collision.pairs or problem.links or setting.is_shortest:
        return False
    positions = problem.segments[0].states(problem.starts[0])[0]
    return collision.collide_anywhere(positions)


def _clear(constraints: list[Constraint]) -> list[Constraint]:
    """The constraints with all clearances, before any collision."""
    return [one.everywhere() if isinstance(one, Clearance) else one for one in constraints]
