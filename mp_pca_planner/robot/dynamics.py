# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Dynamics of a robot over whole motions and at single states, by Pinocchio."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from ..arrays import FloatArray
from .effort_slopes import EffortSlopes
from .pinocchio_model import PinocchioModel


class Dynamics(PinocchioModel):
    """Efforts of motions, and accelerations under efforts."""

    _working_memory = ("_data", "_results", "_pool", "_slopes")

    def _use(self, model: Any) -> None:
        super()._use(model)
        data = self._data
        # Releases of Pinocchio before 3.0 fill only the upper triangle of M.
        q, zero = np.linspace(0.3, 0.7, model.nv), np.zeros(model.nv)
        pin.computeRNEADerivatives(model, data, q, zero, zero)
        self._mirror_mass_matrix = not np.allclose(data.M, data.M.T)
        # Views of the results, made once: making them takes as long as the call itself.
        self._results = (data.dtau_dq, data.dtau_dv, data.M, data.tau)
        self._pool: Any = pin.ModelPool(model, 1) if hasattr(pin, "rneaInParallel") else None
        self._slopes: EffortSlopes | None = None

    def inverse_dynamics(self, q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
        """Efforts of a motion, NaN where the inertia of a moving link is not known.

        Parameters
        ----------
        q, v, a : array, shape (n_steps, n_joints)
            Positions [rad or m], velocities [/s] and accelerations [/s²].

        Returns
        -------
        tau : array, shape (n_steps, n_joints)
            Joint torques [N·m] or forces [N].
        """
        q, v, a = self._in_order(q, v, a, n_dims=2)
        if self._pool is not None:
            tau = np.empty(q.shape)
            pin.rneaInParallel(1, self._pool, q.T, v.T, a.T, tau.T)
        else:  # Pinocchio built without OpenMP
            rows = [pin.rnea(self._model, self._data, *x) for x in zip(q, v, a, strict=True)]
            tau = np.array(rows).reshape(q.shape)
        return self._order.restored(tau)

    def known_efforts(self, q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray | None:
        """Efforts of a motion as :meth:`inverse_dynamics`, or None if one is NaN."""
        tau = self.inverse_dynamics(q, v, a)
        return None if np.isnan(tau).any() else tau

    def effort_slopes(
        self, q: FloatArray, v: FloatArray, a: FloatArray, jerk: FloatArray
    ) -> FloatArray:
        """Upper bounds of the rates of change of efforts, see :meth:`.EffortSlopes.bounds`.

        Parameters
        ----------
        q, v, a, jerk : array, shape (n_steps, n_joints)
            Largest magnitudes of positions [rad or m] and their derivatives in each of several
            intervals.

        Returns
        -------
        slopes : array, shape (n_steps, n_joints)
            Bounds of the magnitude of dτ/dt [N·m/s or N/s].
        """
        if self._slopes is None:
            self._slopes = EffortSlopes(self._model)
        q, v, a, jerk = (self._order.sorted(x) for x in (q, v, a, jerk))
        return self._order.restored(self._slopes.bounds(q, v, a, jerk))

    def inverse_dynamics_derivatives(
        self, q: FloatArray, v: FloatArray, a: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Efforts of a motion and their derivatives.

        Parameters
        ----------
        q, v, a : array, shape (n_steps, n_joints)
            Positions [rad or m], velocities [/s] and accelerations [/s²].

        Returns
        -------
        tau : array, shape (n_steps, n_joints)
            Joint torques [N·m] or forces [N].
        dtau : array, shape (n_steps, n_joints, 3 n_joints)
            ∂τ/∂q, ∂τ/∂q̇ and ∂τ/∂q̈ (the mass matrix) side by side.
        """
        n = self.n_joints
        q, v, a = self._in_order(q, v, a, n_dims=2)
        tau = np.empty((len(q), n))
        dtau = np.empty((len(q), 3, n, n))  # filled block by block: the innermost loop of planning
        model, data, derivatives = self._model, self._data, pin.computeRNEADerivatives
        by_q, by_v, by_a, efforts = self._results
        for q_k, v_k, a_k, dtau_k, tau_k in zip(q, v, a, dtau, tau, strict=True):
            derivatives(model, data, q_k, v_k, a_k)
            dtau_k[0], dtau_k[1], dtau_k[2] = by_q, by_v, by_a
            tau_k[:] = efforts
        if self._mirror_mass_matrix:
            upper = np.triu(dtau[:, 2])
            dtau[:, 2] = upper + np.triu(upper, 1).transpose(0, 2, 1)
        dtau = self._order.restored_matrix(dtau)
        return self._order.restored(tau), dtau.transpose(0, 2, 1, 3).reshape(len(q), n, 3 * n)

    def motion_equation(self, q: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mass matrix and bias efforts of one state: τ = M q̈ + h.

        Parameters
        ----------
        q, v : array, shape (n_joints,)
            Positions [rad or m] and velocities [/s].

        Returns
        -------
        M : array, shape (n_joints, n_joints)
            The mass matrix; only its upper triangle is sure to be filled.
        h : array, shape (n_joints,)
            Efforts of gravity, centrifugal and Coriolis forces.
        """
        model, data, order = self._model, self._data, self._order
        q, v = self._in_order(q, v, n_dims=1)
        M, h = pin.crba(model, data, q), pin.nonLinearEffects(model, data, q, v)
        if not order.is_same:
            M = order.restored_matrix(np.triu(M) + np.triu(M, 1).T)
        return M, order.restored(h)

    def gravity_efforts(self, q: FloatArray) -> FloatArray:
        """Efforts that hold the robot still in one configuration, shape (n_joints,)."""
        g = pin.computeGeneralizedGravity(self._model, self._data, *self._in_order(q, n_dims=1))
        return self._order.restored(g)

    def forward_dynamics(self, q: FloatArray, v: FloatArray, tau: FloatArray) -> FloatArray:
        """Accelerations [/s²] of one state under efforts, all of shape (n_joints,).

        By Featherstone's articulated-body algorithm.
        """
        q, v, tau = self._in_order(q, v, tau, n_dims=1)
        return self._order.restored(pin.aba(self._model, self._data, q, v, tau))
