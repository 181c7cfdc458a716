# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""What a page shows: a robot, its primitives and obstacles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..arrays import FloatArray, check_type
from ..exceptions import MissingDependencyError, PlannerError
from ..motion.collision import CollisionModel
from ..planning.demonstrated import robot_collision
from ..planning.plan import Plan
from ..planning.planner import Planner
from ..primitives.primitive import MovementPrimitive
from ..robot.limits import JointLimits
from ..robot.meshes import package_folders
from ..robot.model import Robot
from ..robot.world import World

if TYPE_CHECKING:
    from .page import ViewPage

_N_COMPARED = 200  # demonstrations that each one is compared with


@dataclass(frozen=True, eq=False)
class PageContent:
    """What a page shows.

    Attributes
    ----------
    robot : Robot
        The robot of the primitives.
    primitives : tuple of MovementPrimitive
        At least one.
    limits : JointLimits
        Limits of its joints.
    folders : sequence of Path
        Folders with the packages of meshes.
    collision : CollisionModel or None
        Collision model of the robot; None: self-collisions are not checked.
    world : World
        The obstacles at the beginning.
    ends : tuple of array, shape (n_joints,), or None
        The first start and goal; those of a demonstration unless given.
    """

    robot: Robot
    primitives: Sequence[MovementPrimitive]
    limits: JointLimits
    folders: Sequence[Path] = ()
    collision: CollisionModel | None = None
    world: World = field(default_factory=World)
    ends: tuple[FloatArray, FloatArray] | None = None


def read_content(
    robot: Robot, primitives: Sequence[MovementPrimitive], package_dirs: Sequence[Path] = ()
) -> PageContent:
    """The content of a page for primitives and their robot.

    Self-collisions are checked if the robot's collision geometry can be read.

    Parameters
    ----------
    robot : Robot
        The robot of their joints.
    primitives : sequence of MovementPrimitive
        At least one.
    package_dirs : sequence of Path
        Folders of packages with meshes; searched before ROS's and those above the URDF.
    """
    folders = package_folders(package_dirs, robot.path)
    # Where meshes are missing, the page states that for the visual ones.
    collision, _ = robot_collision(robot, primitives, package_dirs=folders)
    return PageContent(robot, tuple(primitives), robot.limits(), folders, collision)


def typical_demonstration(primitive: MovementPrimitive) -> int:
    """Index of the whole motion with the least mean distance from the other ones.

    The mean of different motions need not be like any of them: the mean of raising an arm and of
    lowering it hardly moves. A demonstration moves as people do. A fragment takes less than half
    the time of long motions, or joints move less than half as far.
    """
    durations, extents = primitive.durations, _extents(primitive)
    long = [np.quantile(values, 0.9) for values in (durations, extents)]
    whole = np.flatnonzero((durations >= 0.5 * long[0]) & (extents >= 0.5 * long[1]))
    if not len(whole):
        whole = np.arange(len(durations))
    ends = primitive.boundary_states[whole][:, [0, 3]].reshape(len(whole), -1)
    shapes = primitive.weights[whole] / np.sqrt(np.maximum(primitive.explained_variance, 1e-12))
    spread = ends.std(axis=0) + 1e-3  # bounds the weight of a joint that never moved
    places = np.hstack([ends / spread, shapes])
    others = places[:: max(1, len(places) // _N_COMPARED)]
    distances = [np.linalg.norm(others - place, axis=1).sum() for place in places]
    return int(whole[np.argmin(distances)])


def _extents(primitive: MovementPrimitive) -> FloatArray:
    """How far the joints of each demonstration move, there and back or only there."""
    shares = np.linspace(0.0, 1.0, 11)
    motions = [primitive.reproduction(i, t * shares) for i, t in enumerate(primitive.durations)]
    return np.asarray(np.linalg.norm(np.ptp(motions, axis=1), axis=1))


def first_ends(primitive: MovementPrimitive, limits: JointLimits) -> tuple[FloatArray, FloatArray]:
    """Start and goal of a typical demonstration, within the limits."""
    ends = primitive.boundary_states[typical_demonstration(primitive), [0, 3]]
    start, goal = np.clip(ends, limits.lower, limits.upper)
    return start, goal


def show(planner: Planner, plan: Plan | None = None, *, port: int = 8080) -> ViewPage:
    """Serve a page with the robot and the primitives of a planner, to be opened in a browser.

    Parameters
    ----------
    planner : Planner
        A planner.
    plan : Plan, optional
        A plan whose start and goal are shown first.
    port : int
        Port, or the first free one after it; 0: any free one.

    Returns
    -------
    page : ViewPage
        The page, served until it is closed or the process ends.

    Raises
    ------
    MissingDependencyError
        If the extra `view` is not installed.

    Examples
    --------
    >>> import mp_pca_planner as mp
    >>> page = mp.show(planner, plan)  # doctest: +SKIP
    """
    check_type(planner, "planner", PlannerError, Planner)
    try:
        from .page import ViewPage
    except ImportError as error:
        raise MissingDependencyError(str(error.name), "view", "the page") from None
    content = replace(read_content(planner.robot, planner.primitives), limits=planner.limits)
    if planner.collision is not None:
        content = replace(content, world=planner.collision.world)
    if plan is not None:
        first, *_, last = plan.trajectory.positions
        content = replace(content, ends=(first, last))
    return ViewPage(content, port=port)
