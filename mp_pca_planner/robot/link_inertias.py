# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Masses and principal moments of inertia of each link of a robot.

Pinocchio keeps one inertia per joint, into which links behind fixed and locked joints are merged.
The dynamics are linear in the ten inertial parameters of a joint, and so in those of each link.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from ..arrays import FloatArray
from .inertias import joint_of
from .urdf_elements import stated_origin


@dataclass(frozen=True, eq=False)
class LinkInertias:
    """Contribution of each link to the inertia of the joint that carries it.

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
