# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The movement primitive: a mean shape, its principal components, and their statistics."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import FloatArray, frozen_array, unique_names
from ..exceptions import PrimitiveFileError
from .alignment import aligned_phases
from .basis import Basis, PolynomialBasis
from .boundary import boundary_values, hermite_functions
from .pace import PacedBasis, reversed_paces
from .statistics import RequestStatistics

COUPLINGS = ("joint", "arm")

_PHASES = np.linspace(0.0, 1.0, 101)


class MovementPrimitive:
    """A family of motions learned from demonstrations, immutable.

    A motion is q(s) = h(s) + μ(s) + Σ wₖ φₖ(s), see :mod:`.boundary` and :mod:`.basis`.

    Parameters
    ----------
    name : str
        Name of the primitive.
    joint_names : sequence of str
        The n_joints joints.
    coupling : {'joint', 'arm'}
        Whether each component moves one joint ([P]) or all of them.
    mean_coefficients : array, shape (n_joints, degree + 1)
        Legendre coefficients of μ [rad or m].
    component_coefficients : array, shape (n_components, n_joints, degree + 1)
        Legendre coefficients of the φₖ.
    explained_variance : array, shape (n_components,)
        The λₖ of [P] eq. (1), in decreasing order (joint by joint for coupling 'joint').
    total_variance : array, shape (n_joints,)
        Variance of the shapes of each joint, summed over the phases ([P] eq. (4)).
    weights : array, shape (n_demonstrations, n_components)
        Weights of the demonstrations ([P] eq. (2)).
    boundary_states : array, shape (n_demonstrations, 6, n_joints)
        q, q̇, q̈ of the aligned demonstrations at the start, then at the end; re-timed ones
        start and end at rest.
    durations : array, shape (n_demonstrations,)
        Their durations [s].
    warps : array, shape (n_demonstrations, n_warp_phases)
        Their own timing: shares of their durations at evenly spaced aligned phases, strictly
        increasing from 0 to 1, see :mod:`.alignment`.
    paces : array, shape (n_demonstrations, n_pace)
        The same as polynomials, see :mod:`.pace`.
    kernels : array, shape (n_kernels, 7)
    activities : array, shape (n_demonstrations,)
        See :class:`.RequestStatistics`.
    fit_residual : array, shape (n_demonstrations, n_joints)
        RMS difference between each demonstration and its reproduction with its weights and
        its own timing, over the aligned phases [rad or m].
    metadata : mapping
        What else is known, of JSON types: options, provenance, repairs.

    Raises
    ------
    PrimitiveFileError
        If arrays are missing, not finite, or their shapes disagree.
    """

    ARRAYS = (
        "mean_coefficients",
        "component_coefficients",
        "explained_variance",
        "total_variance",
        "weights",
        "boundary_states",
        "durations",
        "warps",
        "paces",
        "kernels",
        "activities",
        "fit_residual",
    )

    def __init__(
        self,
        name: str,
        joint_names: tuple[str, ...],
        coupling: str,
        arrays: Mapping[str, ArrayLike],
        metadata: Mapping[str, Any],
    ) -> None:
        if not isinstance(name, str) or not name:
            raise PrimitiveFileError(
                f"the name of a primitive must be a non-empty string: {name!r}"
            )
        if any("\ud800" <= letter <= "\udfff" for letter in "".join([name, *joint_names])):
            raise PrimitiveFileError(f"the names of primitive '{name}' must be valid Unicode")
        if coupling not in COUPLINGS:
            raise PrimitiveFileError(
                f"the coupling of primitive '{name}' is {coupling!r}, not one of {COUPLINGS}"
            )
        self.name = name
        self.coupling = coupling
        self.joint_names = unique_names(joint_names, f"joints of '{name}'", PrimitiveFileError)
        self.metadata = dict(metadata)
        n = len(self.joint_names)

        def take(array: str, shape: tuple[int | None, ...]) -> FloatArray:
            if array not in arrays:
                raise PrimitiveFileError(f"primitive '{name}' lacks the array '{array}'")
            return frozen_array(
                arrays[array], shape, f"array '{array}' of '{name}'", PrimitiveFileError
            )

        self.mean_coefficients = take("mean_coefficients", (n, None))
        series = self.mean_coefficients.shape[1]
        self.component_coefficients = take("component_coefficients", (None, n, series))
        k = len(self.component_coefficients)
        self.explained_variance = take("explained_variance", (k,))
        self.total_variance = take("total_variance", (n,))
        self.weights = take("weights", (None, k))
        demonstrations = len(self.weights)
        self.boundary_states = take("boundary_states", (demonstrations, 6, n))
        self.durations = take("durations", (demonstrations,))
        self.warps = take("warps", (demonstrations, None))
        self.fit_residual = take("fit_residual", (demonstrations, n))
        if demonstrations == 0 or np.any(self.durations <= 0.0):
            raise PrimitiveFileError(f"primitive '{name}' needs demonstrations that last > 0 s")
        if np.any(self.explained_variance <= 0.0) or np.any(self.total_variance < 0.0):
            raise PrimitiveFileError(f"primitive '{name}' holds a variance that is not positive")
        if (
            self.warps.shape[1] < 2
            or np.any(self.warps[:, [0, -1]] != (0.0, 1.0))
            or np.any(np.diff(self.warps, axis=1) <= 0.0)
        ):
            raise PrimitiveFileError(f"the warps of primitive '{name}' must increase from 0 to 1")
        self.paces = take("paces", (demonstrations, None))
        self.activities = take("activities", (demonstrations,))
        try:
            self.statistics = self._request_statistics(take("kernels", (None, None)))
        except np.linalg.LinAlgError as error:
            raise PrimitiveFileError(
                f"the motions of primitive '{name}' are too much alike or too far apart to learn "
                f"from ({error}): leave repetitions out"
            ) from None

    @property
    def n_joints(self) -> int:
        """Number of joints."""
        return len(self.joint_names)

    @property
    def n_components(self) -> int:
        """Number of components, that is, of weights."""
        return len(self.component_coefficients)

    @property
    def degree(self) -> int:
        """Degree of the polynomials."""
        return int(self.mean_coefficients.shape[1]) - 1

    @property
    def basis(self) -> PolynomialBasis:
        """The basis functions for the motion compiler."""
        return PolynomialBasis(
            self.mean_coefficients, self.component_coefficients, np.sqrt(self.explained_variance)
        )

    def paced_basis(self, start: FloatArray, goal: FloatArray, pace: FloatArray) -> Basis:
        """The basis functions for a motion between two positions at a pace.

        Parameters
        ----------
        start, goal : array, shape (n_joints,)
            Positions [rad or m].
        pace : array, shape (n_pace,)
            See :class:`.PacedBasis`.
        """
        if not np.any(pace):
            return self.basis
        return PacedBasis(self.basis, goal - start, pace)

    def _request_statistics(self, kernels: FloatArray) -> RequestStatistics:
        return RequestStatistics(
            np.column_stack(
                [self.boundary_states[:, 0], self.boundary_states[:, 3], np.log(self.durations)]
            ),
            self.weights,
            *_reversed_and_common_weights(self.basis, self.weights),
            self.paces,
            reversed_paces(self.paces),
            kernels,
            self.activities,
        )

    @property
    def joint_of_component(self) -> tuple[int, ...]:
        """Which joint each component moves; only for coupling 'joint'."""
        magnitude = np.abs(self.component_coefficients).max(axis=2, initial=0.0)
        return tuple(int(j) for j in magnitude.argmax(axis=1))

    @property
    def explained_variance_ratio(self) -> dict[str, list[float]]:
        """λₖ as a share of the variance, [P] eq. (5), by joint name or under 'arm'."""
        if self.coupling == "arm":
            total = float(self.total_variance.sum())
            return {"arm": [float(v) / total for v in self.explained_variance]}
        shares: dict[str, list[float]] = {name: [] for name in self.joint_names}
        for variance, joint in zip(self.explained_variance, self.joint_of_component, strict=True):
            shares[self.joint_names[joint]].append(float(variance / self.total_variance[joint]))
        return shares

    def reproduction(self, demonstration: int, times: FloatArray) -> FloatArray:
        """A demonstration as its weights give it back, with its own timing.

        Parameters
        ----------
        demonstration : int
            Which one.
        times : array, shape (n_steps,)
            Times from 0 to its duration [s].

        Returns
        -------
        positions : array, shape (n_steps, n_joints)
            Joint positions [rad or m].
        """
        duration = float(self.durations[demonstration])
        phases = aligned_phases(self.warps[demonstration], times / duration)
        state = self.boundary_states[demonstration]
        boundary = boundary_values(tuple(state[:3]), tuple(state[3:]), duration)
        return np.asarray(
            hermite_functions(phases) @ boundary
            + self.basis.shape(self.weights[demonstration], phases)
        )

    def arrays(self) -> dict[str, FloatArray]:
        """The arrays that make up the primitive, by name."""
        own = {name: getattr(self, name) for name in self.ARRAYS if hasattr(self, name)}
        return own | {"kernels": self.statistics.kernels}


def _reversed_and_common_weights(
    basis: Basis, weights: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Weights that come nearest to shapes gone backwards, and those nearest to the mean shape.

    Parameters
    ----------
    basis : Basis
        Of the primitive.
    weights : array, shape (n_demonstrations, n_weights)
        Weights of the shapes.
    """
    values = basis.functions(_PHASES)
    functions, turned = (
        x.reshape(_PHASES.size * basis.n_joints, basis.n_weights) for x in (values, values[::-1])
    )
    mean = basis.shape(np.zeros(basis.n_weights), _PHASES)
    nearest = np.linalg.pinv(functions)
    reversed_weights = weights @ (nearest @ turned).T + nearest @ (mean[::-1] - mean).ravel()
    return reversed_weights, nearest @ mean.ravel()
