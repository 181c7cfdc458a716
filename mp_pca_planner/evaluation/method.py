# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Interface of the benchmark's methods: inputs and results."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any

from ..exceptions import MissingDependencyError
from ..motion.trajectory import Trajectory

if TYPE_CHECKING:
    from .check import Verdict
    from .problems import Problem

SOLVED = "solved"


@dataclass(frozen=True, eq=False)
class PeerResult:
    """Result of a method for one problem.

    Repeated solutions make one result, with the median time of all and the rest of the last one.

    Attributes
    ----------
    trajectory : Trajectory or None
        The motion, whether it keeps the limits or not; None if there is none.
    solve_time : float
        Time to find it [s], as the method defines it.
    iterations : int
        Iterations of its optimisation, 0 if it has none.
    status : str
        The status that the method reports: 'solved', or the reason of its failure.
    verdict : Verdict or None
        The referee's verdict on the motion, once there is one.
    """

    trajectory: Trajectory | None
    solve_time: float
    iterations: int = 0
    status: str = SOLVED
    verdict: Verdict | None = None

    @property
    def feasible(self) -> bool:
        """Whether there is a motion that the referee accepts."""
        return self.verdict is not None and self.verdict.feasible

    @property
    def solved(self) -> bool:
        """Whether there is a motion that the method itself reports as solved."""
        return self.verdict is not None and self.status == SOLVED

    def facts(self) -> dict[str, Any]:
        """The result by the names of the package's public interface."""
        return {
            "effort_cost": None,
            "solve_time_s": self.solve_time,
            "iterations": self.iterations,
            "feasible": False,
            "status": self.status,
            **({} if self.verdict is None else asdict(self.verdict)),
        }


@dataclass(frozen=True, eq=False)
class Method:
    """A planning method, set up for one robot, its limits and demonstrations.

    Attributes
    ----------
    name : str
        Its name in tables and JSON.
    about : str
        Description of the method and its setup, one sentence.
    solve : callable
        Solves one problem from scratch.
    slow : bool
        Whether the method is run on a subset of the problems only.
    """

    name: str
    about: str
    solve: Callable[[Problem], PeerResult]
    slow: bool = False


def import_peer(module: str, purpose: str, extra: str = "peers") -> Any:
    """Import an optional module.

    Raises
    ------
    MissingDependencyError
        If it can't be imported.
    """
    try:
        return import_module(module)
    except ImportError:
        raise MissingDependencyError(module, extra, purpose) from None
