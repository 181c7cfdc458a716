# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Joints of a robot: their order, the locked ones, and the inertias that they move."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from ..arrays import FloatArray, frozen_array
from ..exceptions import RobotError
from ..lazy import LazyModule
from .urdf import Description

pin = LazyModule("pinocchio")

_NOT_A_LINK = " (joint)"
# Elements of links that are bodies, not just frames.
_SHAPES = ("visual", "collision")
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


def positions_with_mimics(
    locked: Mapping[str, float], joint_names: Sequence[str], description: Description
) -> dict[str, float]:
    """Given positions of locked joints, and those of joints that mimic these [rad or m].

    Raises
    ------
    RobotError
        If a position is no finite number.
    """
    given = {
        name: float(frozen_array(x, (), f"position of locked joint '{name}'", RobotError))
        for name, x in locked.items()
    }
    following = {
        name: multiplier * given[followed] + offset
        for name, (followed, multiplier, offset) in description.mimics.items()
        if followed in given and name not in joint_names
    }
    return {**following, **given}


def reduced_model(full: Any, joint_names: Sequence[str], locked: Mapping[str, float]) -> Any:
    """A model in which only some joints move.

    Pinocchio finds frames by name in it, and some joints have the name of a link: they get other
    names meanwhile.

    Parameters
    ----------
    full : pinocchio.Model
        The model of all joints.
    joint_names : sequence of str
        Joints that move.
    locked : mapping of str to float
        Positions [rad or m] of others; 0 (or the nearest limit) unless given.
    """
    reference = np.clip(pin.neutral(full), full.lowerPositionLimit, full.upperPositionLimit)
    for name, position in locked.items():
        reference[full.joints[full.getJointId(name)].idx_q] = position
    fixed = locked_joints(full, joint_names)
    if not fixed:
        return full
    links = {frame.name for frame in full.frames if frame.type == pin.FrameType.BODY}
    model = full.copy()
    for frame in model.frames:
        if frame.type != pin.FrameType.BODY and frame.name in links:
            frame.name += _NOT_A_LINK
    for joint, name in enumerate(full.names):
        model.names[joint] = name + _NOT_A_LINK if name in links else name
    reduced = pin.buildReducedModel(model, fixed, reference)
    for joint, name in enumerate(list(reduced.names)):
        reduced.names[joint] = name.removesuffix(_NOT_A_LINK)
    return reduced


def locked_joints(full: Any, joint_names: Sequence[str]) -> list[int]:
    """Pinocchio's numbers of the joints that don't move."""
    return [i for i, name in enumerate(full.names) if i > 0 and name not in joint_names]


def joints_of_links(full: Any, links: Collection[str]) -> list[int]:
    """Pinocchio's numbers of the joints that carry some links, in their order."""
    body = pin.FrameType.BODY
    ids = (full.getFrameId(name, body) for name in links if full.existFrame(name, body))
    return [full.frames[i].parentJoint for i in ids]


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
    states = description.states
    unread = [link for link in links if link.name not in description.inertias]
    lost = [link for link in unread if states(link.name, "inertial")]
    flaws, unknown = [link.name for link in lost], {link.parentJoint for link in lost}
    solid = {link.parentJoint for link in links if states(link.name, *_SHAPES)}
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
            moved = next(description.joints[model.names[joint]].iter("child"))
            flaws.append(moved.get("link", ""))
    return flaws, sorted(unknown)


def _is_valid(inertia: Any) -> bool:
    """Whether mass and inertia tensor of a body are positive, and those of a distribution."""
    low, middle, high = np.linalg.eigvalsh(inertia.inertia)
    is_definite = low > _ROUNDOFF * high and high <= (1.0 + _ROUNDING) * (low + middle)
    return bool(inertia.mass > 0.0 and is_definite)


LinkInertias = Mapping[str, tuple[int, FloatArray]]
"""Contributions of links to the inertia of the joints that carry them, by link.

Pinocchio keeps one inertia per joint, into which links behind fixed and locked joints are merged.
The dynamics are linear in the ten inertial parameters of a joint, and so in those of each link.
Pinocchio's joint, and the parameters in its frame of the mass alone and of each principal moment
alone, shape (4, 10).
"""


def link_inertias(inertias: Mapping[str, Any], model: Any) -> LinkInertias:
    """Place inertias of links, given by link, in a model of the same robot."""
    links = {}
    for name, inertia in inertias.items():
        if not model.existFrame(name, pin.FrameType.BODY):
            continue
        frame = model.frames[model.getFrameId(name, pin.FrameType.BODY)]
        if frame.parentJoint > 0:
            placed = (frame.placement.act(part) for part in _parts(inertia))
            parameters = np.array([part.toDynamicParameters() for part in placed])
            links[name] = frame.parentJoint, parameters
    return links


def scale_links(model: Any, links: LinkInertias, factors: FloatArray) -> None:
    """Multiply masses and principal moments of links in a model by factors, (n_links, 4)."""
    for (joint, parts), factor in zip(links.values(), factors, strict=True):
        parameters = model.inertias[joint].toDynamicParameters() + (factor - 1.0) @ parts
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
