# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""What a method of planning is to the benchmark."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any, Protocol

from ..exceptions import MissingDependencyError
from ..motion.trajectory import Trajectory

if TYPE_CHECKING:
    from .problems import Problem

SOLVED = "solved"


@dataclass(frozen=True, eq=False)
class Answer:
    """What a method makes of a problem.

    Attributes
    ----------
    trajectory : Trajectory or None
        The motion, also one that keeps no limits; None if there is none.
    solve_time : float
        Time to find it [s], as the method defines it.
    iterations : int
        Iterations of its optimisation, 0 if it has none.
    status : str
        What the method itself says: 'solved', or why not.
    """

    trajectory: Trajectory | None
    solve_time: float
    iterations: int = 0
    status: str = SOLVED


class Method(Protocol):
    """A way to plan motions, set up for one robot, its limits and demonstrations.

    Attributes
    ----------
    name : str
        What tables and JSON call it.
    about : str
        What it is and how it was set up, in a sentence.
    slow : bool
        Whether it is run on a part of the problems only.
    """

    name: str
    about: str
    slow: bool

    def solve(self, problem: Problem) -> Answer:
        """Solve one problem, whole: what is known of an earlier one is not used."""


def import_peer(module: str, purpose: str, extra: str = "peers") -> Any:
    """Import an optional module, of the extra 'peers' unless another one is named.

    Raises
    ------
    MissingDependencyError
        If it can't be imported.
    """
    try:
        return import_module(module)
    except ImportError:
        raise MissingDependencyError(module, extra, purpose) from None
