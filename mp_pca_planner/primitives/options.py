# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Options of building primitives."""

from __future__ import annotations

from dataclasses import dataclass

from ..arrays import check_choice, check_number
from ..exceptions import PrimitiveError, names_options
from .basis import N_END_CONDITIONS
from .primitive_values import COUPLINGS
from .timing import ALIGNMENTS


@names_options(PrimitiveError)
@dataclass(frozen=True)
class PrimitiveOptions:
    """Options of building a primitive.

    Attributes
    ----------
    coupling : {'joint', 'arm'}
        One PCA per joint, as in [P], or one of all joints stacked: far fewer weights.
    n_components : int or None
        Components to keep (per joint for coupling 'joint'); None: as few as reach `variance`.
    variance : float
        Share of the variance that the components kept must explain, if their number is not given.
    n_phases : int
        Samples of a time-normalised demonstration.
    degree : int
        Degree of the polynomials that carry mean and components.
    align : {'linear', 'arc_length'}
        How the demonstrations are aligned in time, see :func:`.align`.

    Raises
    ------
    PrimitiveError
        If an option is unknown or out of its range.
    """

    coupling: str = "arm"
    n_components: int | None = None
    variance: float = 0.99
    n_phases: int = 101
    degree: int = 15
    align: str = "arc_length"

    def __post_init__(self) -> None:
        check_choice(self.coupling, "coupling", PrimitiveError, COUPLINGS)
        if self.n_components is not None:
            check_number(self.n_components, "components", PrimitiveError, 1, is_whole=True)
        check_number(self.variance, "variance", PrimitiveError, 1e-9, 1.0)
        check_number(
            self.degree,
            "degree (of which the ends take six conditions)",
            PrimitiveError,
            N_END_CONDITIONS,
            30,
            is_whole=True,
        )
        check_number(
            self.n_phases,
            "phases (at least twice the degree)",
            PrimitiveError,
            2 * self.degree,
            10_000,
            is_whole=True,
        )
        check_choice(self.align, "align", PrimitiveError, ALIGNMENTS)
