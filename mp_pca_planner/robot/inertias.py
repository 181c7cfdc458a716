# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Validity of the inertias of moving bodies.

A body consists of the links between one joint and the next ones. Therefore a massless frame at the
end of an arm needs no inertia. A link without mass or shape between the axes of a multi-axis joint
needs none, either, if the next link has an inertia.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pinocchio as pin

from ..exceptions import quote_names
from .urdf import Description

_NO_MASS = "no mass"
# Share of the largest principal moment below which the smallest one counts as 0.
_ROUNDOFF = 1e-12
# Share by which a moment may exceed the sum of the others: descriptions are rounded.
_ROUNDING = 0.01


def inertia_flaws(model: Any, description: Description) -> tuple[dict[str, str], list[int]]:
    """Moving links without a valid inertia.

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


def joint_of(frame: Any) -> int:
    """The joint that moves a frame; releases of Pinocchio name the attribute differently."""
    return int(frame.parentJoint if hasattr(frame, "parentJoint") else frame.parent)
