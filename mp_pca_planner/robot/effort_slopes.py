# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Upper bounds of the rates of change of joint efforts.

The position c of a point of a link is a chain of rotations of the joints i before it. All of its
derivatives by their angles are bounded by the distance ρᵢ from joint i to the point, with the
joints stretched out; in a derivative by several joints, by that of the last one. The effort of
joint i is the sum over points of ∂c/∂qᵢ · (c̈ − g) dm. Therefore its rate of change is at most

    Σⱼ Wᵢⱼ (|q⃛ⱼ| + 4 s |q̈ⱼ| + 2 s² |q̇ⱼ|) + Σⱼ Gᵢⱼ |q̇ⱼ|   with   s = Σⱼ |q̇ⱼ|,

where W is the sum over points of ρᵢ ρⱼ dm, and G that of |g| min(ρᵢ, ρⱼ) dm.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
import pinocchio as pin

from ..arrays import FloatArray


class EffortSlopes:
    """Bounds of the rates of change of the efforts of a model.

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
        """Bounds of the magnitude of dτ/dt, see :meth:`.Dynamics.effort_slopes`."""
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
