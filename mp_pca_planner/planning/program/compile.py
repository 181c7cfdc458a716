# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""From a request and a setting to a problem, and from its unknowns back to motions."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from ...arrays import FloatArray
from ...motion.goal import JointState
from ..configurations import nearest_configuration
from ..context import Context
from ..motion import Motion
from ..request import Request, Segment
from .bases import MotionBasis, StartPoint
from .chain import Chain, Junction, junctions_of
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
    junctions = junctions_of(request, setting.initial)
    segments, terms, constraints, targets = [], [], [], []
    for i, one in enumerate(request.segments):
        basis, ends = setting.bases[i], junctions[i : i + 2]
        program = _segment(context, setting, i, ends)
        natural = _naturalness(context, request, setting, program, i)
        segments.append(program)
        terms.append([] if natural is None else [natural])
        targets.append(_target(context, program, one))
        constraints.append(_constraints(context, setting, program, basis, ends, natural))
    chain = None if request.is_single else Chain(junctions, segments)
    starts = (
        [StartPoint(chain.start)] if chain else _starts(context, setting, segments[0], terms[0])
    )
    problem = Problem(segments, terms, constraints, targets, chain, starts)
    if setting.bases[0].is_detour or _starts_in_collision(context, setting, problem):
        problem = problem.constrained([_clear(part) for part in constraints])
    return problem


def is_near_expected(context: Context, setting: Setting) -> bool:
    """Whether motions stay near an expected one."""
    certain = all(basis.precision is not None for basis in setting.bases)
    return certain and setting.naturalness >= context.options.search.near_expected


def _segment(
    context: Context, setting: Setting, i: int, ends: tuple[Junction, ...]
) -> SegmentProgram:
    """A segment with its running costs."""
    basis, motion, (here, there) = setting.bases[i], setting.initial[i], ends
    unknowns = Unknowns(
        basis.tables.basis.scales,
        motion.boundary,
        motion.duration,
        free_rows=[*here.orders, *(GOAL_POSITION + order for order in there.orders)],
        duration_is_free=setting.is_timed or here.time_is_free or there.time_is_free,
    )
    tables, objectives = basis.tables, setting.objectives
    return SegmentProgram(context.robot, tables, unknowns, motion.weights, objectives)


def _naturalness(
    context: Context, request: Request, setting: Setting, program: SegmentProgram, i: int
) -> Naturalness | None:
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
        return None
    return Naturalness(program.expected, price * precision)


def _target(context: Context, program: SegmentProgram, segment: Segment) -> PoseTarget | None:
    if segment.pose is None:
        return None
    return PoseTarget(context.robot, program.tables, program.unknowns, segment.pose)


def _constraints(
    context: Context,
    setting: Setting,
    program: SegmentProgram,
    basis: MotionBasis,
    ends: tuple[Junction, ...],
    natural: Naturalness | None,
) -> list[Constraint]:
    """The constraints of a segment; of limits, those that motions are expected to come near."""
    tables, unknowns, options = program.tables, program.unknowns, context.options
    states = [end.fixed_state for end in ends]
    known = [state for state in states if state is not None]
    chosen = None
    if is_near_expected(context, setting):
        expected, _ = program.at(program.expected)
        timed = unknowns.n_linear
        is_known = not unknowns.duration_is_free or (
            natural is not None and natural.precision[timed, timed] > 0.0
        )
        chosen = near_limits(context.limits, expected, options.search.near_limit, is_known)
    found: list[Constraint] = [
        Limits(context.robot, tables, unknowns, context.limits, known, chosen)
    ]
    if context.collision is not None:
        places = [None if state is None else state.positions for state in states]
        basis_ = basis.tables.basis
        found.append(Clearance(context.collision, unknowns, basis_, places, options.clearance))
    return found


def _starts(
    context: Context, setting: Setting, program: SegmentProgram, terms: list[Naturalness]
) -> list[StartPoint]:
    """Unknowns to start from, the cheapest first."""
    unknowns, basis = program.unknowns, setting.bases[0]
    n_starts = 1 if is_near_expected(context, setting) else None
    # The state of a solver for weights alone does not fit programs with other unknowns.
    fits = unknowns.scales.size == basis.expected.size
    found = [
        StartPoint(unknowns.from_weights(weights), memory if fits else None)
        for weights, memory in basis.starts[:n_starts]
    ]
    if len(found) > 1:
        costs = program.costs(np.array([start.unknowns for start in found]))
        for term in terms:
            off = np.array([start.unknowns for start in found]) - term.expected
            costs += 0.5 * np.einsum("ij,jk,ik->i", off, term.precision, off)
        found = [found[i] for i in np.argsort(costs, kind="stable")]
    return found


def _starts_in_collision(context: Context, setting: Setting, problem: Problem) -> bool:
    """Whether the first motion of a single segment is in collision at a quadrature node."""
    if not context.searches_paths or problem.links is not None or setting.is_shortest:
        return False
    assert context.collision is not None
    positions = problem.segments[0].states(problem.starts[0].unknowns)[0]
    return context.collision.collide_anywhere(positions)


def _clear(constraints: list[Constraint]) -> list[Constraint]:
    """The constraints with all clearances, before any collision."""
    return [one.everywhere() if isinstance(one, Clearance) else one for one in constraints]


def motions_at(
    context: Context, request: Request, setting: Setting, problem: Problem, x: FloatArray
) -> tuple[Motion, ...]:
    """The motions that unknowns stand for, with ends that are corrected to reach poses exactly."""
    if problem.links is None:
        unknowns = problem.segments[0].unknowns
        goal, weights = request.goal, [unknowns.weights(x)]
        if request.pose is not None:
            boundary, _ = unknowns.boundary_at(x)
            goal = JointState(goal.joint_names, boundary[GOAL_POSITION])
        states = [(request.start, 0.0), (goal, unknowns.duration_at(x))]
    else:
        states, weights = problem.links.states(x), problem.links.weights(x)
    for i, segment in enumerate(request.segments):
        if segment.pose is not None:
            state, time = states[i + 1]
            search = context.options.poses
            q, _ = nearest_configuration(
                context.robot, context.limits, segment.pose, state.positions, search
            )
            states[i + 1] = JointState(state.joint_names, q, *state.values[1:]), time
    return tuple(
        Motion(here, there, ended - began, basis.tables.basis, own)
        for ((here, began), (there, ended)), basis, own in zip(
            pairwise(states), setting.bases, weights, strict=True
        )
    )
