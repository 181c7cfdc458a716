# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Inertias of the links of a robot: their validity, their parts, and bounds of efforts by them."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import pinocchio as pin

from ..arrays import FloatArray
from ..exceptions import quote_names
from .joints import joint_of
from .urdf import Description, stated_origin

_NO_MASS = "no mass"
# Share of the largest principal moment below which the smallest one counts as 0.
_ROUNDOFF = 1e-12
# Share by which a moment may exceed the sum of the others: descriptions are rounded.
_ROUNDING = 0.01


def inertia_flaws(model: Any, description: Description) -> tuple[dict[str, str], list[int]]:
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
    flaws : dict of str to str
        What is wrong with each link that has no valid inertia.
    unknown : list of int
        Joints whose efforts can't be computed, because the inertia of their body is unknown.
    """
    flaws: dict[str, str] = {}
    unknown, solid = set(), set()
    for frame in model.frames:
        joint = joint_of(frame)
        if frame.type != pin.FrameType.BODY or joint == 0:
            continue
        if frame.name in description.solid_links:
            solid.add(joint)
        if frame.name in description.lost_inertials:
            flaws[frame.name] = description.lost_inertials[frame.name]
            unknown.add(joint)
    masses = [inertia.mass for inertia in model.inertias]
    for joint in sorted(set(range(1, model.njoints)) - unknown):
        flaw = _flaw(model.inertias[joint])
        if flaw == _NO_MASS:
            carries = any(masses[k] != 0.0 or k in unknown for k in model.subtrees[joint])
            if carries and joint not in solid:
                continue
            unknown.add(joint)
        if flaw:
            flaws[description.child_links[model.names[joint]]] = flaw
    return flaws, sorted(unknown)


def _flaw(inertia: Any) -> str:
    if inertia.mass == 0.0 and not inertia.inertia.any():
        return _NO_MASS
    if not inertia.mass > 0.0:
        return f"a mass of {inertia.mass:g} kg"
    low, middle, high = np.linalg.eigvalsh(inertia.inertia)
    moments = f"(principal moments with what is fixed to it {low:.3g}, {middle:.3g}, {high:.3g})"
    if not low > _ROUNDOFF * high:
        return f"an inertia tensor that is not positive definite {moments}"
    if high > (1.0 + _ROUNDING) * (low + middle):
        return f"an inertia tensor that violates the triangle inequality {moments}"
    return ""


def listed_flaws(flaws: Mapping[str, str]) -> str:
    """Flaws, given by link, in a message: each with all of its links."""
    links: dict[str, list[str]] = {}
    for link, flaw in flaws.items():
        links.setdefault(flaw, []).append(link)
    return ", ".join(f"{quote_names(names)} ({flaw})" for flaw, names in links.items())


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
    def of(cls, inertials: Mapping[str, ET.Element], model: Any) -> LinkInertias:
        """Place the <inertial> elements of links, given by link, in a model of the same robot."""
        links, joints, parts = [], [], []
        for name, inertial in inertials.items():
            if not model.existFrame(name, pin.FrameType.BODY):
                continue
            frame = model.frames[model.getFrameId(name, pin.FrameType.BODY)]
            if joint_of(frame) == 0:
                continue
            placed = [frame.placement.act(part) for part in _parts(inertial)]
            links.append(name)
            joints.append(joint_of(frame))
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


def _parts(inertial: ET.Element) -> Iterator[Any]:
    """The mass, then each principal moment, in the frame of the link."""
    mass, inertia = (next(inertial.iter(tag)) for tag in ("mass", "inertia"))
    centre, turn = np.split(stated_origin(inertial), 2)
    rotation = pin.rpy.rpyToMatrix(turn)
    yield pin.Inertia(float(mass.attrib["value"]), centre, np.zeros((3, 3)))
    keys = [["i" + "".join(sorted(a + b)) for b in "xyz"] for a in "xyz"]
    moments, axes = np.linalg.eigh([[float(inertia.attrib[key]) for key in row] for row in keys])
    for moment, axis in zip(moments, (rotation @ axes).T, strict=True):
        yield pin.Inertia(0.0, centre, moment * np.outer(axis, axis))


class EffortSlopes:
    """Upper bounds of the rates of change of the efforts of a model.

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
    """

    def __init__(self, model: Any) -> None:
        # Whether each joint moves each link, and its distance to the link's centre of mass.
        self._moves = np.zeros((model.nv, model.nv), dtype=bool)
        self._distances = np.zeros((model.nv, model.nv))
        self._masses, self._spreads = np.zeros(model.nv), np.zeros(model.nv)
        for k in range(1, model.njoints):
            inertia, link, i = model.inertias[k], model.joints[k].idx_v, k
            self._masses[link] = inertia.mass
            # The mean squared distance of the points of a link from its centre of mass, times m;
            # an identified inertia may need points of negative mass.
            moments = np.linalg.eigvalsh(inertia.inertia)
            self._spreads[link] = np.abs(0.5 * moments.sum() - moments).sum()
            distance = float(np.linalg.norm(inertia.lever))
            while i > 0:
                joint = model.joints[i].idx_v
                self._moves[joint, link], self._distances[joint, link] = True, distance
                distance += float(np.linalg.norm(model.jointPlacements[i].translation))
                i = model.parents[i]
        jacobian = pin.computeJointJacobians(model, model.createData(), pin.neutral(model))
        self._is_prismatic = ~jacobian[3:].any(axis=0)
        self._gravity = float(np.linalg.norm(model.gravity.linear))
        self._factors = lru_cache(maxsize=1)(self._factors_of)

    def bounds(self, q: FloatArray, v: FloatArray, a: FloatArray, jerk: FloatArray) -> FloatArray:
        """Bounds of the magnitude of dτ/dt, see :meth:`.Robot.effort_slopes`."""
        # Prismatic joints lengthen the arm.
        inertias, pulls = self._factors(float(q[:, self._is_prismatic].max(axis=0).sum()))
        speed = v.sum(axis=1, keepdims=True)
        rates = jerk + 4.0 * speed * a + 2.0 * speed**2 * v
        return np.asarray(rates @ inertias + v @ pulls)

    def _factors_of(self, longer: float) -> tuple[FloatArray, FloatArray]:
        """W and G of an arm that prismatic joints lengthen [m]."""
        # Derivatives by positions of prismatic joints are at most 1.
        least = 1.0 if self._is_prismatic.any() else 0.0
        distances = np.where(self._moves, np.maximum(self._distances + longer, least), 0.0)
        # By the inequality of Cauchy and Schwarz, for the points of each link.
        roots = self._moves * (np.sqrt(self._masses) * distances + np.sqrt(self._spreads))
        pulls = self._masses * np.minimum(distances[:, None], distances)
        return np.asarray(roots @ roots.T), np.asarray(self._gravity * pulls.sum(axis=2))
