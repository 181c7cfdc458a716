# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Figures of plans: the motion with its vias, warnings, and the demonstrations behind it."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..arrays import by_name
from ..planning.plan import Plan
from ..planning.remarks import UNUSUAL_IN_SPAN_SCORE
from ..primitives.prediction import nearest_demonstrations
from ..primitives.primitive import MovementPrimitive
from ..robot.limits import JointLimits
from .motion import Curve, MotionContext, motion_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

N_DEMONSTRATIONS = 8
"""Number of demonstrations behind a segment; more hide each other."""

_N_SAMPLES = 101


def plan_figure(
    figure: Figure,
    plan: Plan,
    primitives: Sequence[MovementPrimitive] = (),
    limits: JointLimits | None = None,
    prismatic: Collection[str] = (),
) -> list[list[Axes]]:
    """Plot a plan, at most twelve panels.

    Parameters
    ----------
    figure : Figure
        An empty figure, see :func:`.styled_figure`.
    plan : Plan
        The plan.
    primitives : sequence of MovementPrimitive
        Primitives of the planner. The demonstrations of those in use whose ends are nearest to
        those of each segment are drawn behind it, re-timed to its duration.
    limits : JointLimits, optional
        Limits of the joints, drawn where the motion is near them.
    prismatic : collection of str
        Joints that are measured in metres; the others are shown in degrees.

    Returns
    -------
    panels : list of list of Axes
        By column, the Axes of positions, velocities and, if known, efforts.
    """
    drawn = f"{len(plan.motions)} segments" if plan.mode else f"'{plan.primitive}'"
    title = f"{drawn}: {plan.message}"
    context = plan_context(plan, primitives)
    return motion_figure(figure, {"planned": plan.trajectory}, title, limits, prismatic, context)


def plan_context(plan: Plan, primitives: Sequence[MovementPrimitive]) -> MotionContext:
    """What the figure of a plan shows beside its trajectory."""
    known = {primitive.name: primitive for primitive in primitives}
    joints = list(plan.trajectory.joint_names)
    behind: list[Curve] = []
    begin = 0.0
    for motion, name in zip(plan.motions, plan.primitives, strict=True):
        if (primitive := known.get(name)) is not None:
            order = [primitive.joint_names.index(joint) for joint in joints]
            states = [by_name(x.joint_names, x.positions) for x in (motion.start, motion.goal)]
            ends = np.array([[state[joint] for joint in primitive.joint_names] for state in states])
            times = np.linspace(begin, begin + motion.duration, _N_SAMPLES)
            for i in nearest_demonstrations(primitive, ends)[:N_DEMONSTRATIONS]:
                own = np.linspace(0.0, primitive.durations[i], _N_SAMPLES)
                behind.append((times, primitive.reproduction(int(i), own)[:, order]))
        begin += motion.duration
    score = plan.in_span_score
    unlike = f"unlike the demonstrations (in-span score {score:.1f}, usual: about 1)"
    warnings = [unlike] if score > UNUSUAL_IN_SPAN_SCORE else []
    return MotionContext(behind, plan.duration * np.array(plan.via_phases), warnings)
