# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Checks of the values of a movement primitive."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..arrays import check_choice, check_type, frozen_array, row_blocks, unique_names
from ..exceptions import PrimitiveError, quote_names, shown
from ..input_limits import INPUT_LIMITS
from .prediction import INVERSE_LENGTHS, ConditionalModel
from .timing import PACE_DEGREE

if TYPE_CHECKING:
    from .primitive import MovementPrimitive

COUPLINGS = ("joint", "arm")

# Equal names denote equal sizes.
ARRAY_SHAPES: dict[str, tuple[str | int, ...]] = {
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
    "shape_coefficients": ("fits", len(INVERSE_LENGTHS), 2, "requests", "weights"),
    "straight_weights": ("weights",),
    "pace_coefficients": ("fits", len(INVERSE_LENGTHS), 2, "requests", "rates"),
    "duration_coefficients": (1, len(INVERSE_LENGTHS), 2, "requests", 1),
    "weight_covariance": ("weights", "weights"),
    "weight_precision": ("weights", "weights"),
    "error_variance": (1,),
    "request_precision": ("entries", "entries"),
}
"""Shapes of the arrays of a primitive and of its conditional model."""


def require_same_joints(movers: Iterable[tuple[str, Sequence[str]]]) -> None:
    """Reject primitives, given by names for the message with their joints, that differ in these."""
    first, joints = "", None
    for name, own in movers:
        if joints is not None and tuple(own) != joints:
            raise PrimitiveError(
                f"{name} moves {quote_names(own)}, but {first} moves {quote_names(joints)}: they "
                "can't be used together"
            )
        first, joints = name, tuple(own)


def freeze_values(primitive: MovementPrimitive) -> None:
    """Check the values of a primitive, and make its arrays read-only.

    Raises
    ------
    PrimitiveError
        If a value has a wrong type, shape or range.
    """
    name = primitive.name
    if not isinstance(name, str) or not name:
        raise PrimitiveError(f"the name of a primitive must be a non-empty string: {shown(name)}")
    names = unique_names(primitive.joint_names, f"joints of '{name}'", PrimitiveError)
    try:
        "".join([name, *names]).encode()
    except UnicodeEncodeError:
        raise PrimitiveError(f"the names of primitive '{name}' must be valid Unicode") from None
    check_type(primitive.model, f"the model of '{name}'", PrimitiveError, ConditionalModel)
    check_choice(
        primitive.coupling, f"the coupling of primitive '{name}'", PrimitiveError, COUPLINGS
    )
    check_type(primitive.metadata, f"the metadata of '{name}'", PrimitiveError, Mapping)
    object.__setattr__(primitive, "joint_names", names)
    object.__setattr__(primitive, "metadata", dict(primitive.metadata))
    n, limits = len(names), INPUT_LIMITS
    sizes: dict[str | int, int] = {"joints": n, "entries": 2 * n + 1, "rates": PACE_DEGREE}
    sizes |= {1: 1, 2: 2, 6: 6}  # numbers denote themselves
    for array, shape in ARRAY_SHAPES.items():
        owner = primitive if hasattr(primitive, array) else primitive.model
        what, expected = f"array '{array}' of '{name}'", tuple(map(sizes.get, shape))
        frozen = frozen_array(getattr(owner, array), expected, what, PrimitiveError)
        is_precision = array.endswith("_precision")
        largest = limits.primitive_precision if is_precision else limits.primitive_value
        for (block,) in row_blocks(frozen):
            if np.abs(block).max(initial=0.0) > largest:
                raise PrimitiveError(f"{what} holds numbers that are too large for motions")
        sizes |= dict(zip(shape, frozen.shape, strict=True))
        object.__setattr__(owner, array, frozen)
    model, total = primitive.model, primitive.total_variance.sum()
    n_known = len(primitive.durations), len(model.requests), len(model.shape_coefficients)
    problems = {
        "it needs at least one demonstration": 0 in n_known,
        "its demonstrations must last > 0 s": np.any(primitive.durations <= 0.0),
        "a variance is not positive": np.any(primitive.explained_variance <= 0.0)
        or np.any(primitive.total_variance < 0.0),
        "the variance of its errors is not positive": model.error_variance[0] <= 0.0,
        "its components explain more than all variance": primitive.explained_variance.sum()
        > (1.0 + 1e-6) * total,
        "its warps must increase from 0 to 1": primitive.warps.shape[1] < 2,
    }
    for (block,) in row_blocks(primitive.warps):
        is_wrong = np.any(block[:, :1] != 0.0) or np.any(block[:, -1:] != 1.0)
        is_wrong = is_wrong or np.any(np.diff(block) <= 0.0)
        problems["its warps must increase from 0 to 1"] |= is_wrong
    for matrix in (model.weight_covariance, model.weight_precision, model.request_precision):
        try:
            np.linalg.cholesky(matrix)
        except np.linalg.LinAlgError:
            problems["a covariance is not positive definite"] = True
    for problem, is_present in problems.items():
        if is_present:
            raise PrimitiveError(f"primitive '{name}': {problem}")
