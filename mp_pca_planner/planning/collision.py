# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Motions in which the robot doesn't hit itself.

The distances of pairs of links are followed along the motion that the controller executes. A pair
that is apart can't touch before the joints between have closed its distance, so it is looked at
again only then (conservative advancement: Mirtich, PhD thesis, Berkeley, 1996), and otherwise
every millisecond.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pinocchio as pin

from ..arrays import FloatArray
from ..exceptions import RobotError
from ..goal import JointState, SequenceGoal
from ..robot import Robot
from ..trajectory import Trajectory
from ..validation import interpolate
from .planner import INFEASIBLE, Plan, Planner
from .sequence import OPTIMAL, REAL_TIME, SequencePlan, SequencePlanner

# Motions that collide are pulled towards the expected one, ten times as hard each time.
_PULLS = (1e-2, 1e-1, 1.0, 10.0)
# Distances below this are contact [m]: what the algorithms give for touching surfaces.
_CONTACT = 1e-6
# A pair that needs another look later than this [s] needs no exact distance.
_SOON = 0.02

_AnyPlan = TypeVar("_AnyPlan", Plan, SequencePlan)

_NOT_CHECKED = "; self-collisions were not checked: the robot has no collision geometry"
_ALWAYS_COLLIDES = "no motion without self-collision was found: {}"


@dataclass(frozen=True)
class Collision:
    """Two links that are in each other during a motion.

    Attributes
    ----------
    links : tuple of str
        Their names.
    time : float
        When they are deepest in each other [s].
    penetration : float
        How deep [m]; of meshes it is a lower bound.
    first_time : float
        When they meet [s].
    last_time : float
        When they were last found in each other [s].
    """

    links: tuple[str, str]
    time: float
    penetration: float
    first_time: float
    last_time: float

    def __str__(self) -> str:
        return (
            f"'{self.links[0]}' and '{self.links[1]}' collide from {self.first_time:.3f} s on "
            f"(deepest at {self.time:.3f} s, by {1e3 * self.penetration:.1f} mm)"
        )


class CollisionModel:
    """Which links of a robot may not touch, and whether they do.

    Parameters
    ----------
    robot : Robot
        The robot, whose URDF has collision geometry.
    srdf : str or Path, optional
        An SRDF file whose ``disable_collisions`` name the pairs that need no look. Without one,
        these are neighbours and what touches in the neutral configuration.
    package_dirs : sequence of Path
        Folders in which packages of ``package://`` paths of meshes are.

    Attributes
    ----------
    pairs : tuple of tuple of str
        The pairs of links that are watched; empty without collision geometry.

    Raises
    ------
    RobotError
        If a mesh or the SRDF file can't be read.
    """

    def __init__(
        self,
        robot: Robot,
        *,
        srdf: str | Path | None = None,
        package_dirs: Sequence[Path] = (),
    ) -> None:
        self._model, self._geometry, self._order = robot.collision_geometry(package_dirs)
        self._data = self._model.createData()
        shapes = [part.geometry for part in self._geometry.geometryObjects]
        for shape in shapes:
            shape.computeLocalAABB()
        self._centres = [np.array(shape.aabb_center) for shape in shapes]
        self._radii = [float(shape.aabb_radius) for shape in shapes]
        if srdf is None:
            self._remove_touching_at_neutral()
        else:
            self._geometry.addAllCollisionPairs()
            self._remove_disabled(Path(srdf))
        self._remove_fixed()
        self._geometry_data = self._geometry.createData()
        self.pairs = tuple(self._links(pair) for pair in self._geometry.collisionPairs)
        self._levers = self._lever_arms()

    @property
    def has_geometry(self) -> bool:
        """Whether there is any collision geometry at all."""
        return bool(self._geometry.ngeoms)

    def worst_collision(self, trajectory: Trajectory) -> Collision | None:
        """The deepest collision of a motion, None if there is none.

        Parameters
        ----------
        trajectory : Trajectory
            The motion, of the robot's joints in its order.
        """
        dense = interpolate(trajectory)
        q = np.ascontiguousarray(dense.q[:, self._order])
        # How fast each pair can close, at most [m/s].
        closing = self._levers @ np.abs(dense.v[:, self._order]).max(axis=0)
        closing = np.maximum(closing, 1e-9)
        due = np.zeros(len(self.pairs))
        found: dict[int, list[tuple[float, float]]] = {}
        for time, configuration in zip(dense.times, q, strict=True):
            # The last point is looked at whatever is due.
            now = np.flatnonzero(due <= time) if time < dense.times[-1] else np.arange(len(due))
            if not now.size:
                continue
            # Far pairs are told by the spheres around them, which takes no time.
            distances = self._distances(configuration, now, _SOON * closing[now])
            due[now] = time + np.maximum(distances, 0.0) / closing[now]
            for pair, distance in zip(now, distances, strict=True):
                if distance < _CONTACT:
                    found.setdefault(int(pair), []).append((float(distance), float(time)))
        if not found:
            return None
        worst = min(found, key=lambda pair: min(found[pair]))
        distance, time = min(found[worst])
        times = [moment for _, moment in found[worst]]
        return Collision(self.pairs[worst], time, max(-distance, 0.0), times[0], times[-1])

    def _distances(self, configuration: FloatArray, pairs: Any, enough: Any = None) -> FloatArray:
        """Distances of pairs [m]; where they exceed `enough`, a lower bound that does, too."""
        geometry, data = self._geometry, self._geometry_data
        pin.updateGeometryPlacements(self._model, self._data, geometry, data, configuration)
        centres = [
            placement.act(centre) for placement, centre in zip(data.oMg, self._centres, strict=True)
        ]
        distances = np.empty(len(pairs))
        for i, k in enumerate(pairs):
            pair = geometry.collisionPairs[int(k)]
            apart = np.linalg.norm(centres[pair.first] - centres[pair.second])
            distances[i] = apart - self._radii[pair.first] - self._radii[pair.second]
            if enough is None or distances[i] < enough[i]:
                distances[i] = pin.computeDistance(geometry, data, int(k)).min_distance
        return distances

    def _links(self, pair: Any) -> tuple[str, str]:
        objects = self._geometry.geometryObjects
        first, second = (
            self._model.frames[objects[i].parentFrame].name for i in (pair.first, pair.second)
        )
        return first, second

    def _remove_fixed(self) -> None:
        """Leave the pairs that move against each other."""
        objects = self._geometry.geometryObjects
        for pair in list(self._geometry.collisionPairs):
            if objects[pair.first].parentJoint == objects[pair.second].parentJoint:
                self._geometry.removeCollisionPair(pair)

    def _remove_touching_at_neutral(self) -> None:
        low, high = self._model.lowerPositionLimit, self._model.upperPositionLimit
        neutral = np.clip(pin.neutral(self._model), low, high)
        self._geometry_data = self._geometry.createData()
        pairs = list(self._geometry.collisionPairs)
        for pair, distance in zip(pairs, self._distances(neutral, range(len(pairs))), strict=True):
            if distance < _CONTACT:
                self._geometry.removeCollisionPair(pair)

    def _remove_disabled(self, srdf: Path) -> None:
        try:
            text = srdf.read_text(encoding="utf-8")
            pin.removeCollisionPairsFromXML(self._model, self._geometry, text)
        except (OSError, ValueError, RuntimeError) as error:
            reason = getattr(error, "strerror", None) or error
            raise RobotError(f"the SRDF file '{srdf}' can't be read: {reason}") from None

    def _lever_arms(self) -> FloatArray:
        """How fast each joint can make the links of each pair approach, (n_pairs, n_joints).

        For a joint that turns, the longest way from it along the links to a point of the geometry
        behind it [m]; for one that slides, 1.
        """
        objects = self._geometry.geometryObjects
        arms = np.zeros((len(self.pairs), self._model.nv))
        for row, pair in zip(arms, self._geometry.collisionPairs, strict=True):
            chains = [list(self._model.supports[objects[i].parentJoint]) for i in _both(pair)]
            for i, chain, other in zip(_both(pair), chains, chains[::-1], strict=True):
                centre = objects[i].placement.act(self._centres[i])
                reach = float(np.linalg.norm(centre)) + self._radii[i]
                for joint in reversed([j for j in chain if j > 0]):
                    slides = self._slide(joint)
                    if joint not in other:
                        row[self._model.joints[joint].idx_v] = 1.0 if slides else reach
                    placement = self._model.jointPlacements[joint].translation
                    reach += float(np.linalg.norm(placement)) + slides
        return arms

    def _slide(self, joint: int) -> float:
        """How far a joint that slides goes [m], 0 for one that turns."""
        if not self._model.joints[joint].shortname().startswith("JointModelP"):
            return 0.0
        index = self._model.joints[joint].idx_q
        ends = self._model.lowerPositionLimit[index], self._model.upperPositionLimit[index]
        return float(np.abs(ends).max())


def _both(pair: Any) -> tuple[int, int]:
    return pair.first, pair.second


@dataclass(eq=False)
class CollisionFreePlanner:
    """A planner whose motions don't make the robot hit itself.

    A motion that does is planned again nearer to the demonstrations; if that doesn't help, it is
    infeasible.

    Parameters
    ----------
    planner : Planner
        Plans without regard to collisions.
    collision : CollisionModel
        Of the same robot.
    """

    planner: Planner
    collision: CollisionModel
    _stronger: dict[float, Planner] = field(default_factory=dict, init=False)

    def plan(self, goal: Any, start: JointState) -> Plan:
        """Plan a motion to any goal that :meth:`Planner.plan` takes."""
        first, worst = _looked_at(self.planner.plan(goal, start), self.collision)
        if worst is None:
            return first
        return self._remedy(goal, start, first, worst)

    def _remedy(self, goal: Any, start: JointState, first: Plan, worst: Collision) -> Plan:
        """A motion nearer to the demonstrations that is free, or the refusal of the first."""
        taken = first.solve_time
        if _inside(worst, first.trajectory):
            for pull in (pull for pull in _PULLS if pull > first.naturalness):
                plan = self._planner(pull).plan(goal, start)
                taken += plan.solve_time
                if plan.is_executable and not self.collision.worst_collision(plan.trajectory):
                    raised = f"from {first.naturalness:g} to {plan.naturalness:g}"
                    note = f"; to avoid self-collision, the naturalness was raised {raised}"
                    return replace(plan, message=plan.message + note, solve_time=taken)
        message = _ALWAYS_COLLIDES.format(worst)
        return replace(first, status=INFEASIBLE, message=message, solve_time=taken)

    def _planner(self, naturalness: float) -> Planner:
        if naturalness not in self._stronger:
            options = replace(self.planner.options, naturalness=naturalness)
            self._stronger[naturalness] = replace(self.planner, options=options)
        return self._stronger[naturalness]


@dataclass(eq=False)
class CollisionFreeSequencePlanner:
    """A planner of sequences in which the robot doesn't hit itself.

    Instead of an optimal sequence that does, the one joined in real time is returned, which is
    nearer to the demonstrations; if that does, too, the sequence is infeasible.

    Parameters
    ----------
    planner : SequencePlanner
        Plans without regard to collisions.
    collision : CollisionModel
        Of the same robot.
    """

    planner: SequencePlanner
    collision: CollisionModel

    def plan(self, goal: SequenceGoal, start: JointState, mode: str = OPTIMAL) -> SequencePlan:
        """Plan as :meth:`.SequencePlanner.plan` does."""
        first, worst = _looked_at(self.planner.plan(goal, start, mode), self.collision)
        if worst is None:
            return first
        taken = first.solve_time
        if first.mode == OPTIMAL and _inside(worst, first.trajectory):
            plan = self.planner.plan(goal, start, REAL_TIME)
            taken += plan.solve_time
            if plan.is_executable and not self.collision.worst_collision(plan.trajectory):
                note = f"{plan.message}, for in the optimal one {worst}"
                return replace(plan, message=note, solve_time=taken)
        message = _ALWAYS_COLLIDES.format(worst)
        return replace(first, status=INFEASIBLE, message=message, solve_time=taken)


def _looked_at(plan: _AnyPlan, collision: CollisionModel) -> tuple[_AnyPlan, Collision | None]:
    """A plan, which says so if nothing could be checked, and its worst collision."""
    if not collision.has_geometry:
        return replace(plan, message=plan.message + _NOT_CHECKED), None
    return plan, collision.worst_collision(plan.trajectory) if plan.is_executable else None


def _inside(collision: Collision, trajectory: Trajectory) -> bool:
    """Whether the links are apart at both ends, which no other motion would change."""
    return collision.first_time > 0.0 and collision.last_time < trajectory.duration


def package_folders(urdf: Path, given: Sequence[Path] = ()) -> list[Path]:
    """Folders in which packages may be: those given, those of ROS, and those above the URDF."""
    folders = [*given]
    folders += [Path(p) for p in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep) if p]
    prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    folders += [Path(p) / "share" for p in prefixes if p]
    return [*folders, *urdf.resolve().parents]
