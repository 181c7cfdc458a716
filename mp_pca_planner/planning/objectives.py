# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Objectives of motions: running costs ½∫‖r‖²dt, summed with weights.

An objective computes its residual r at every node, and the derivatives of r by positions,
velocities, accelerations, jerks and efforts. The motion compiler applies the chain rule. To add
one, write a function of `Nodes` (examples/own_objective.py). A cost ∫f dt with f ≥ 0 has this form
with r = √(2f).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from ..arrays import FloatArray, read_values
from ..exceptions import GoalError, unknown_name
from ..robot.model import Robot

QUANTITIES = ("positions", "velocities", "accelerations", "jerks", "efforts")
"""Quantities that residuals may depend on."""


@dataclass(frozen=True, eq=False)
class Nodes:
    """A motion at the quadrature nodes.

    Attributes
    ----------
    robot : Robot
        The model.
    positions, velocities, accelerations, jerks : array, shape (n_nodes, n_joints)
        Positions [rad or m] and their derivatives by time.
    efforts : array, shape (n_nodes, n_joints)
        Efforts [N·m or N].
    start, goal : array, shape (n_joints,)
        Positions at the ends; for a pose goal, the initial configuration of the search.
    """

    robot: Robot
    positions: FloatArray
    velocities: FloatArray
    accelerations: FloatArray
    jerks: FloatArray
    efforts: FloatArray
    start: FloatArray
    goal: FloatArray


class Residuals(NamedTuple):
    """Residuals of a running cost ½∫‖r‖²dt at the nodes.

    Attributes
    ----------
    values : array, shape (n_nodes, n_residuals)
        r.
    partials : mapping of str to array, shape (n_nodes, n_residuals, n_joints), or float
        Derivatives of r by those of `QUANTITIES` that it depends on; a number stands for that
        multiple of the identity.
    """

    values: FloatArray
    partials: Mapping[str, FloatArray | float]


Objective = Callable[[Nodes], Residuals]
"""A running cost: its residuals at the nodes, and their derivatives."""

_SMOOTH_POWER = 0.1  # [W]


def effort(nodes: Nodes) -> Residuals:
    """Half the square of the efforts, [P] eq. (6) [N²·m²·s]."""
    return Residuals(nodes.efforts, {"efforts": 1.0})


def jerk(nodes: Nodes) -> Residuals:
    """Half the square of the jerks (Flash and Hogan, J. Neurosci. 5(7), 1985) [rad²/s⁵]."""
    return Residuals(nodes.jerks, {"jerks": 1.0})


def energy(nodes: Nodes) -> Residuals:
    """Mechanical work Σ∫|τq̇|dt, positive and negative alike [J].

    The residuals are signed roots of twice the power p of each joint. Near 0 its absolute value is
    smoothed to √(p² + ε²) − ε with ε = 0.1 W.
    """
    power = nodes.efforts * nodes.velocities
    smooth = np.sqrt(power**2 + _SMOOTH_POWER**2)
    slope = np.sqrt((smooth + _SMOOTH_POWER) / 2.0) / smooth
    eye = np.eye(power.shape[1])
    return Residuals(
        power * np.sqrt(2.0 / (smooth + _SMOOTH_POWER)),
        {
            "velocities": (slope * nodes.efforts)[:, :, None] * eye,
            "efforts": (slope * nodes.velocities)[:, :, None] * eye,
        },
    )


def time(nodes: Nodes) -> Residuals:
    """The duration [s]; it has an effect only if the duration is free."""
    return Residuals(np.full((len(nodes.positions), 1), np.sqrt(2.0)), {})


def straightness(nodes: Nodes, frame: str) -> Residuals:
    """Half the squared distance of a frame from the straight line between its ends [m²·s].

    The residuals are the components across the line of the displacement from the first point.
    """
    points = nodes.robot.attach_points([frame], np.zeros((1, 3)))
    q = np.vstack([nodes.start, nodes.goal, nodes.positions])
    places, jacobians = points.positions_and_jacobians(q)
    first, last = places[0, 0], places[1, 0]
    length = float(np.linalg.norm(last - first))
    line = (last - first) / length if length > 0.0 else np.zeros(3)
    across = np.eye(3) - np.outer(line, line)
    return Residuals((places[2:, 0] - first) @ across, {"positions": across @ jacobians[2:, 0]})


def uses_efforts(objective: Objective, robot: Robot) -> bool:
    """Whether an objective depends on efforts, judged by its derivatives."""
    zero = np.zeros((1, robot.n_joints))
    nodes = Nodes(robot, zero, zero, zero, zero, zero, zero[0], zero[0])
    return "efforts" in objective(nodes).partials


_SIMPLE: dict[str, Objective] = {"effort": effort, "energy": energy, "jerk": jerk, "time": time}

OBJECTIVES = (*_SIMPLE, "straightness")
"""Names that :func:`objective_by_name` accepts."""


def objective_by_name(name: str, robot: Robot, frame: str | None = None) -> Objective:
    """Return an objective of this module.

    Parameters
    ----------
    name : str
        Its name.
    robot : Robot
        The model.
    frame : str, optional
        The frame whose path is to be straight; that of the end effector unless given.

    Raises
    ------
    GoalError
        If there is no such objective.
    RobotError
        If there is no such frame.
    """
    if name == "straightness":
        frame = robot.end_effector if frame is None else frame
        robot.frame_positions(np.zeros((0, robot.n_joints)), [frame])
        return partial(straightness, frame=frame)
    if name not in _SIMPLE:
        raise GoalError(unknown_name("objective", name, OBJECTIVES))
    return _SIMPLE[name]


def objective_weights(text: str, what: str) -> dict[str, float]:
    """Read a weighted sum: ``NAME=WEIGHT,…``; a name alone has the weight 1.

    Parameters
    ----------
    text : str
        The sum.
    what : str
        Name of the option in messages.

    Raises
    ------
    GoalError
        If a name is unknown or repeated, or a weight is not between 1e-12 and 1e12, which fits all
        units and avoids overflow.
    """
    weights = read_values(text, what, "objective", OBJECTIVES, "1")
    if not weights:
        raise GoalError(f"{what}: {unknown_name('objective', text, OBJECTIVES)}")
    for name, weight in weights.items():
        if not 1e-12 <= weight <= 1e12:
            raise GoalError(
                f"{what}: the weight of '{name}' is {weight:g}, expected one from 1e-12 to 1e+12"
            )
    return weights


def weighted_objectives(
    weights: Mapping[str, float], robot: Robot, frame: str | None = None
) -> tuple[tuple[float, Objective], ...]:
    """The objectives of a weighted sum, see :func:`objective_by_name`."""
    return tuple((w, objective_by_name(name, robot, frame)) for name, w in weights.items())
