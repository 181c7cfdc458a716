# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The movement primitive: a mean shape, its principal components, and their statistics."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, ClassVar

import numpy as np

from ..arrays import FloatArray, frozen_array, unique_names
from ..exceptions import PrimitiveFileError
from .alignment import aligned_phases
from .basis import Basis, PolynomialBasis
from .boundary import boundary_values, hermite_functions
from .conditional_model import INVERSE_LENGTHS, ConditionalModel
from .pace import PACE_DEGREE, PacedBasis

COUPLINGS = ("joint", "arm")

# Names stand for sizes that must agree.
_SHAPES: dict[str, tuple[str | int, ...]] = {
    "mean_coefficients": ("joints", "degrees"),
    "component_coefficients": ("weights", "joints", "degrees"),
    "explained_variance": ("weights",),
    "total_variance": ("joints",),
    "weights": ("demonstrations", "weights"),
    "boundary_states": ("demonstrations", 6, "joints"),
    "durations": ("demonstrations",),
    "warps": ("demonstrations", "phases"),
    "fit_residual": ("demonstrations", "joints"),
    "requests": ("requests", "entries"),
    "shape_coefficients": (len(INVERSE_LENGTHS), "fits", 2, "requests", "weights"),
    "straight_weights": ("weights",),
    "pace_coefficients": (len(INVERSE_LENGTHS), "fits", 2, "requests", "rates"),
    "duration_coefficients": (len(INVERSE_LENGTHS), 1, 2, "requests", 1),
    "weight_covariance": ("weights", "weights"),
    "weight_precision": ("weights", "weights"),
    "request_precision": ("entries", "entries"),
}


# Positions, coefficients and durations of motions [rad, m, s] are smaller; what is divided by small
# variances need not be.
_LARGEST_USUAL = 1e6
_LARGEST = {"weight_precision": 1e15, "request_precision": 1e15}


@dataclass(frozen=True, eq=False)
class MovementPrimitive:
    """A family of motions learned from demonstrations.

    A motion is q(s) = h(s) + μ(s) + Σ wₖ φₖ(s), see :mod:`.boundary` and :mod:`.basis`.

    Attributes
    ----------
    name : str
        Name of the primitive.
    joint_names : sequence of str
        The n_joints joints.
    coupling : {'joint', 'arm'}
        Whether each component moves one joint ([P]) or all of them.
    metadata : mapping
        What else is known, of JSON types: options, provenance, repairs.
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
    fit_residual : array, shape (n_demonstrations, n_joints)
        RMS difference between each demonstration and its reproduction with its weights and
        its own timing, over the aligned phases [rad or m].
    model : ConditionalModel
        Predicts the weights for a request.

    Raises
    ------
    PrimitiveFileError
        If arrays are not finite, or their shapes disagree.
    """

    name: str
    joint_names: tuple[str, ...]
    coupling: str
    metadata: Mapping[str, Any]
    mean_coefficients: FloatArray
    component_coefficients: FloatArray
    explained_variance: FloatArray
    total_variance: FloatArray
    weights: FloatArray
    boundary_states: FloatArray
    durations: FloatArray
    warps: FloatArray
    fit_residual: FloatArray
    model: ConditionalModel

    ARRAYS: ClassVar[tuple[str, ...]] = tuple(_SHAPES)
    """Names of all arrays, the model's included."""

    @classmethod
    def from_arrays(
        cls,
        name: str,
        joint_names: tuple[str, ...],
        coupling: str,
        arrays: Mapping[str, FloatArray],
        metadata: Mapping[str, Any],
    ) -> MovementPrimitive:
        """Make a primitive of its :attr:`ARRAYS`."""
        of_model = {field.name for field in fields(ConditionalModel)}
        model = ConditionalModel(**{k: v for k, v in arrays.items() if k in of_model})
        own = {k: v for k, v in arrays.items() if k not in of_model}
        return cls(name, joint_names, coupling, metadata, **own, model=model)

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name:
            raise PrimitiveFileError(
                f"the name of a primitive must be a non-empty string: {self.name!r}"
            )
        text = "".join([self.name, *self.joint_names])
        if any("\ud800" <= letter <= "\udfff" for letter in text):
            raise PrimitiveFileError(f"the names of primitive '{self.name}' must be valid Unicode")
        if self.coupling not in COUPLINGS:
            raise PrimitiveFileError(
                f"the coupling of primitive '{self.name}' is {self.coupling!r}, "
                f"not one of {COUPLINGS}"
            )
        names = unique_names(self.joint_names, f"joints of '{self.name}'", PrimitiveFileError)
        object.__setattr__(self, "joint_names", names)
        object.__setattr__(self, "metadata", dict(self.metadata))
        self._freeze_arrays()
        self._check_values()

    def _freeze_arrays(self) -> None:
        """Make the arrays read-only, once their shapes agree."""
        n = len(self.joint_names)
        sizes: dict[str | int, int] = {"joints": n, "entries": 2 * n + 1, "rates": PACE_DEGREE}
        for array, shape in _SHAPES.items():
            owner = self if hasattr(self, array) else self.model
            frozen = frozen_array(
                getattr(owner, array),
                tuple(x if isinstance(x, int) else sizes.get(x) for x in shape),
                f"array '{array}' of '{self.name}'",
                PrimitiveFileError,
            )
            if np.abs(frozen).max(initial=0.0) > _LARGEST.get(array, _LARGEST_USUAL):
                raise PrimitiveFileError(
                    f"array '{array}' of '{self.name}' holds numbers that are too large for motions"
                )
            sizes |= dict(zip(shape, frozen.shape, strict=True))
            object.__setattr__(owner, array, frozen)

    def _check_values(self) -> None:
        """Refuse arrays of values that make no sense."""
        sizes = (
            len(self.durations),
            len(self.model.requests),
            self.model.shape_coefficients.shape[1],
        )
        if 0 in sizes or np.any(self.durations <= 0.0):
            raise PrimitiveFileError(
                f"primitive '{self.name}' needs demonstrations that last > 0 s"
            )
        if np.any(self.explained_variance <= 0.0) or np.any(self.total_variance < 0.0):
            raise PrimitiveFileError(
                f"primitive '{self.name}' holds a variance that is not positive"
            )
        model = self.model
        for matrix in (model.weight_covariance, model.weight_precision, model.request_precision):
            try:
                np.linalg.cholesky(matrix)
            except np.linalg.LinAlgError:
                raise PrimitiveFileError(
                    f"primitive '{self.name}' holds a covariance that is not positive definite"
                ) from None
        if self.explained_variance.sum() > (1.0 + 1e-6) * self.total_variance.sum():
            raise PrimitiveFileError(
                f"the components of primitive '{self.name}' explain more than all variance"
            )
        if (
            self.warps.shape[1] < 2
            or np.any(self.warps[:, [0, -1]] != (0.0, 1.0))
            or np.any(np.diff(self.warps, axis=1) <= 0.0)
        ):
            raise PrimitiveFileError(
                f"the warps of primitive '{self.name}' must increase from 0 to 1"
            )

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
        return {k: getattr(self if hasattr(self, k) else self.model, k) for k in self.ARRAYS}
