# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Inertias of the links that joints move: flaws, changes, and bounds of the efforts they need."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any

import numpy as np

from ..arrays import FloatArray
from ..lazy import LazyModule
from .urdf import Description

pin = LazyModule("pinocchio")

# Elements of links that are bodies, not just frames.
_SHAPES = ("visual", "collision")
# Share of the largest principal moment below which the smallest one counts as 0.
_ROUNDOFF = 1e-12
# Share by which a moment may exceed the sum of the others: descriptions are rounded.
_ROUNDING = 0.01


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


def scaled_inertias(model: Any, inertias: Mapping[str, Any], factors: FloatArray) -> Any:
    """A model whose links have other masses and principal moments of inertia.

    Parameters
    ----------
    model : pinocchio.Model
        A model, which keeps one inertia per joint: links behind fixed joints are merged into it.
    inertias : mapping of str to pinocchio.Inertia
        Inertias by link, in its frame, of all that joints of the model move.
    factors : array, shape (n_links, 4)
        See :meth:`.Robot.with_link_inertias`.
    """
    model = model.copy()
    frames = [model.frames[model.getFrameId(name, pin.FrameType.BODY)] for name in inertias]
    for frame in frames:
        model.inertias[frame.parentJoint] = pin.Inertia.Zero()
    for frame, inertia, (by_mass, *by_moment) in zip(
        frames, inertias.values(), factors.tolist(), strict=True
    ):
        moments, axes = np.linalg.eigh(inertia.inertia)
        changed = inertia.copy()
        changed.mass, changed.inertia = (
            by_mass * inertia.mass,
            axes * (by_moment * moments) @ axes.T,
        )
        model.inertias[frame.parentJoint] += frame.placement.act(changed)
    return model


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
