# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Joints of a robot: their order, the locked ones, and the inertias that they move."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray, frozen_array
from ..exceptions import RobotError
from ..lazy import LazyModule
from .urdf import Description

pin = LazyModule("pinocchio")

_NOT_A_LINK = " (joint)"
# Share of the largest principal moment below which the smallest one counts as 0.
_ROUNDOFF = 1e-12
# Share by which a moment may exceed the sum of the others: descriptions are rounded.
_ROUNDING = 0.01


class JointOrder:
    """Conversion between the order of the user's joints and that of Pinocchio's vectors.

    Attributes
    ----------
    to_pin : array of int, shape (n_joints,)
        Index of each of the user's joints in Pinocchio's vectors.
    from_pin : array of int, shape (n_joints,)
        The inverse permutation.
    is_same : bool
        Whether both orders are the same.
    """

    def __init__(self, model: Any, joint_names: Sequence[str]) -> None:
        self.to_pin = np.array([model.joints[model.getJointId(n)].idx_v for n in joint_names])
        self.from_pin = np.argsort(self.to_pin)
        self.is_same = bool(np.array_equal(self.to_pin, np.arange(len(joint_names))))

    def checked(self, *arrays: FloatArray, n_dims: int) -> list[FloatArray]:
        """Values of the user's joints in Pinocchio's order, all of the shape of the first.

        Pinocchio itself checks neither shapes nor types.

        Raises
        ------
        RobotError
            If they have another shape.
        """
        values = [np.asarray(x, dtype=np.float64) for x in arrays]
        expected = (*values[0].shape[: n_dims - 1], len(self.to_pin))
        for x in values:
            if x.shape != expected or x.ndim != n_dims:
                shape = ", ".join([*["any"] * (n_dims - 1), str(expected[-1])])
                raise RobotError(
                    f"values of the joints must all have the shape ({shape}), got {x.shape}"
                )
        return [self.sorted(x) for x in values]

    def sorted(self, x: FloatArray) -> FloatArray:
        """Values of the user's joints, along the last axis, in Pinocchio's order."""
        return np.ascontiguousarray(x if self.is_same else x[..., self.from_pin])

    def restored(self, x: FloatArray) -> FloatArray:
        """Pinocchio's values, along the last axis, in the user's order."""
        return np.asarray(x if self.is_same else x[..., self.to_pin])

    def restored_matrix(self, x: FloatArray) -> FloatArray:
        """The same along both of the last axes."""
        return x if self.is_same else x[..., self.to_pin, :][..., self.to_pin]


class LockedModel:
    """A model of all movable joints, with the positions of the locked ones.

    Parameters
    ----------
    joint_names : sequence of str
        Joints that move.
    locked : mapping of str to float
        Positions [rad or m] of others; 0 (or the nearest limit) unless given. Those of joints that
        mimic one of these follow from it.
    description : Description
        All joints.

    Attributes
    ----------
    known : mapping of str to float
        The positions that were given, and those of joints that mimic these [rad or m].

    Raises
    ------
    RobotError
        If a position is no finite number.
    """

    def __init__(
        self,
        joint_names: Sequence[str],
        locked: Mapping[str, float],
        description: Description,
    ) -> None:
        self._full = full = description.model
        self._colliding = description.collisions.keys()
        low, high = full.lowerPositionLimit, full.upperPositionLimit
        self._reference = np.clip(pin.neutral(full), low, high)
        names = enumerate(full.names)
        self._locked = [i for i, name in names if i > 0 and name not in joint_names]
        given = {
            name: float(frozen_array(x, (), f"position of locked joint '{name}'", RobotError))
            for name, x in locked.items()
        }
        following = {
            name: multiplier * given[followed] + offset
            for name, (followed, multiplier, offset) in description.mimics.items()
            if followed in given and name not in joint_names
        }
        self.known: Mapping[str, float] = {**following, **given}
        for name, position in self.known.items():
            self._reference[full.joints[full.getJointId(name)].idx_q] = position

    def relevant(self, *, pairs: bool, links: Collection[str]) -> tuple[str, ...]:
        """The locked joints whose positions make a difference, see `Robot.relevant_joints`."""
        model = self._full
        moving = {i for i in range(1, model.njoints) if i not in self._locked}
        shapes, needed = (
            {f.parentJoint for f in model.frames if f.type == pin.FrameType.BODY and f.name in some}
            for some in (self._colliding, links)
        )
        relevant = []
        for joint in self._locked:
            carried, carriers = set(model.subtrees[joint]), set(model.supports[joint])
            is_carried = bool(moving & carriers)
            has_mass = any(model.inertias[i].mass > 0.0 for i in carried)
            if (
                (carried & (moving | needed))
                or (is_carried and has_mass)
                or ((is_carried or pairs) and carried & shapes)
            ):
                relevant.append(model.names[joint])
        return tuple(relevant)

    def carriers(self, links: Collection[str]) -> tuple[str, ...]:
        """The locked joints that place joints that move, or some links."""
        model, body = self._full, pin.FrameType.BODY
        placed = {i for i in range(1, model.njoints) if i not in self._locked}
        placed |= {f.parentJoint for f in model.frames if f.type == body and f.name in links}
        carriers = (joint for joint in self._locked if set(model.subtrees[joint]) & placed)
        return tuple(model.names[joint] for joint in carriers)

    def reduced(self) -> Any:
        """The model without locked joints.

        Pinocchio finds frames by name there, and some joints have the name of a link: they get
        other names meanwhile.
        """
        full = self._full
        if not self._locked:
            return full
        links = {frame.name for frame in full.frames if frame.type == pin.FrameType.BODY}
        model = full.copy()
        for frame in model.frames:
            if frame.type != pin.FrameType.BODY and frame.name in links:
                frame.name += _NOT_A_LINK
        for joint, name in enumerate(full.names):
            model.names[joint] = name + _NOT_A_LINK if name in links else name
        reduced = pin.buildReducedModel(model, self._locked, self._reference)
        for joint, name in enumerate(list(reduced.names)):
            reduced.names[joint] = name.removesuffix(_NOT_A_LINK)
        return reduced

    def are_neighbours(self, links: Sequence[str]) -> NDArray[np.bool_]:
        """Whether at most one joint is between two links, shape (n_links, n_links)."""
        full, body = self._full, pin.FrameType.BODY
        frames = (full.frames[full.getFrameId(name, body)] for name in links)
        joints = np.array([frame.parentJoint for frame in frames], dtype=np.intp)
        above = np.array(full.parents, dtype=np.intp)[joints]
        moved = joints[:, None]
        return np.asarray((moved == joints) | (moved == above) | (above[:, None] == joints))


def inertia_flaws(model: Any, description: Description) -> tuple[list[str], list[int]]:
    """Moving links without a valid inertia.

    A body consists of the links between one joint and the next ones. Therefore a massless frame at
    the end of an arm needs no inertia. A link without mass or shape between the axes of a
    multi-axis joint needs none, either, if the next link has an inertia.

    Parameters
    ----------
    model : pinocchio.Model
        The model of the joints that move.
    description : Description
        The description that it was built from.

    Returns
    -------
    flaws : list of str
        The links.
    unknown : list of int
        Joints whose efforts can't be computed, because the inertia of their body is unknown.
    """
    links = [f for f in model.frames if f.type == pin.FrameType.BODY and f.parentJoint > 0]
    lost = [link for link in links if link.name in description.lost_inertias]
    flaws, unknown = [link.name for link in lost], {link.parentJoint for link in lost}
    solid = {link.parentJoint for link in links if link.name in description.solid_links}
    masses = [inertia.mass for inertia in model.inertias]
    for joint in sorted(set(range(1, model.njoints)) - unknown):
        inertia = model.inertias[joint]
        is_empty = inertia.mass == 0.0 and not inertia.inertia.any()
        if is_empty:
            carries = any(masses[k] != 0.0 or k in unknown for k in model.subtrees[joint])
            if carries and joint not in solid:
                continue
            unknown.add(joint)
        if is_empty or not _is_valid(inertia):
            flaws.append(description.child_links[model.names[joint]])
    return flaws, sorted(unknown)


def _is_valid(inertia: Any) -> bool:
    """Whether mass and inertia tensor of a body are positive, and those of a distribution."""
    low, middle, high = np.linalg.eigvalsh(inertia.inertia)
    is_definite = low > _ROUNDOFF * high and high <= (1.0 + _ROUNDING) * (low + middle)
    return bool(inertia.mass > 0.0 and is_definite)


@dataclass(frozen=True, eq=False)
class LinkInertias:
    """Contribution of each link to the inertia of the joint that carries it.

    Pinocchio keeps one inertia per joint, into which links behind fixed and locked joints are
    merged. The dynamics are linear in the ten inertial parameters of a joint, and so in those of
    each link.

    Attributes
    ----------
    links : tuple of str
        Names of the n_links links that joints move and that have an inertia.
    joints : tuple of int
        Pinocchio's joint that carries each.
    parts : array, shape (n_links, 4, 10)
        Inertial parameters in the frame of that joint, in Pinocchio's order, of the mass alone
        and of each principal moment alone.
    """

    links: tuple[str, ...]
    joints: tuple[int, ...]
    parts: FloatArray

    @classmethod
    def of(cls, inertias: Mapping[str, Any], model: Any) -> LinkInertias:
        """Place inertias of links, given by link, in a model of the same robot."""
        links, joints, parts = [], [], []
        for name, inertia in inertias.items():
            if not model.existFrame(name, pin.FrameType.BODY):
                continue
            frame = model.frames[model.getFrameId(name, pin.FrameType.BODY)]
            if frame.parentJoint == 0:
                continue
            links.append(name)
            joints.append(frame.parentJoint)
            placed = (frame.placement.act(part) for part in _parts(inertia))
            parts.append([part.toDynamicParameters() for part in placed])
        array = np.array(parts, dtype=np.float64).reshape(-1, 4, 10)
        return cls(tuple(links), tuple(joints), array)

    def change(self, model: Any, factors: FloatArray) -> None:
        """Multiply the parts of a model's links.

        Parameters
        ----------
        model :
            Pinocchio's model, changed in place.
        factors : array, shape (n_links, 4)
            Of the mass and of each principal moment.
        """
        for joint, part, factor in zip(self.joints, self.parts, factors, strict=True):
            parameters = model.inertias[joint].toDynamicParameters() + (factor - 1.0) @ part
            model.inertias[joint] = _inertia(parameters)


def _inertia(parameters: FloatArray) -> Any:
    if parameters[0] != 0.0:
        return pin.Inertia.FromDynamicParameters(parameters)
    # A body without mass has no centre of mass: Pinocchio would divide by zero.
    xx, xy, yy, xz, yz, zz = parameters[4:]
    return pin.Inertia(0.0, np.zeros(3), np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))


def _parts(inertia: Any) -> Iterator[Any]:
    """The mass alone, then each principal moment."""
    yield pin.Inertia(inertia.mass, inertia.lever, np.zeros((3, 3)))
    moments, axes = np.linalg.eigh(inertia.inertia)
    for moment, axis in zip(moments, axes.T, strict=True):
        yield pin.Inertia(0.0, inertia.lever, moment * np.outer(axis, axis))


def effort_slopes(model: Any) -> Callable[..., FloatArray]:
    """A function that bounds the rates of change of the efforts of a model.

    The position c of a point of a link is a chain of rotations of the joints i before it. All of
    its derivatives by their angles are bounded by the distance ρᵢ from joint i to the point, with
    the joints stretched out; in a derivative by several joints, by that of the last one. The effort
    of joint i is the sum over points of ∂c/∂qᵢ · (c̈ − g) dm. Its rate of change is thus at most

        Σⱼ Wᵢⱼ (|q⃛ⱼ| + 4 s |q̈ⱼ| + 2 s² |q̇ⱼ|) + Σⱼ Gᵢⱼ |q̇ⱼ|   with   s = Σⱼ |q̇ⱼ|,

    where W is the sum over points of ρᵢ ρⱼ dm, and G that of |g| min(ρᵢ, ρⱼ) dm.

    Parameters
    ----------
    model : pinocchio.Model
        A model of joints with one degree of freedom each.

    Returns
    -------
    bounds : callable
        See :meth:`.Robot.effort_slopes`; in Pinocchio's order.
    """
    # Whether each joint moves each link, and its distance to the link's centre of mass.
    moves = np.zeros((model.nv, model.nv), dtype=bool)
    distances = np.zeros((model.nv, model.nv))
    masses, spreads = np.zeros(model.nv), np.zeros(model.nv)
    for k in range(1, model.njoints):
        inertia, link, i = model.inertias[k], model.joints[k].idx_v, k
        masses[link] = inertia.mass
        # The mean squared distance of the points of a link from its centre of mass, times m; an
        # identified inertia may need points of negative mass.
        moments = np.linalg.eigvalsh(inertia.inertia)
        spreads[link] = np.abs(0.5 * moments.sum() - moments).sum()
        distance = float(np.linalg.norm(inertia.lever))
        while i > 0:
            joint = model.joints[i].idx_v
            moves[joint, link], distances[joint, link] = True, distance
            distance += float(np.linalg.norm(model.jointPlacements[i].translation))
            i = model.parents[i]
    jacobian = pin.computeJointJacobians(model, model.createData(), pin.neutral(model))
    is_prismatic = ~jacobian[3:].any(axis=0)
    gravity = float(np.linalg.norm(model.gravity.linear))

    @lru_cache(maxsize=1)
    def factors(longer: float) -> tuple[FloatArray, FloatArray]:
        """W and G of an arm that prismatic joints lengthen [m]."""
        # Derivatives by positions of prismatic joints are at most 1.
        least = 1.0 if is_prismatic.any() else 0.0
        reaches = np.where(moves, np.maximum(distances + longer, least), 0.0)
        # By the inequality of Cauchy and Schwarz, for the points of each link.
        roots = moves * (np.sqrt(masses) * reaches + np.sqrt(spreads))
        pulls = masses * np.minimum(reaches[:, None], reaches)
        return np.asarray(roots @ roots.T), np.asarray(gravity * pulls.sum(axis=2))

    def bounds(q: FloatArray, v: FloatArray, a: FloatArray, jerk: FloatArray) -> FloatArray:
        # Prismatic joints lengthen the arm.
        inertias, pulls = factors(float(q[:, is_prismatic].max(axis=0).sum()))
        speed = v.sum(axis=1, keepdims=True)
        rates = jerk + 4.0 * speed * a + 2.0 * speed**2 * v
        return np.asarray(rates @ inertias + v @ pulls)

    return bounds
