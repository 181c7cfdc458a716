# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""What all steps of planning share: robot, limits, world and options, time and threads."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from copy import copy
from dataclasses import dataclass
from functools import cache
from typing import Any

from ..arrays import check_number
from ..exceptions import GoalError
from ..input_limits import INPUT_LIMITS
from ..motion.collision import CollisionModel
from ..robot.limits import JointLimits
from ..robot.model import Robot
from .options import PlannerOptions


@dataclass(frozen=True, eq=False)
class Context:
    """Everything about a planner but its primitives.

    Attributes
    ----------
    robot : Robot
        The model.
    limits : JointLimits
        Limits of its joints.
    options : PlannerOptions
        Options of planning.
    collision : CollisionModel or None
        The model of its collisions, if they are checked.
    longest : float
        The longest duration of a motion that is accepted [s].
    """

    robot: Robot
    limits: JointLimits
    options: PlannerOptions
    collision: CollisionModel | None
    longest: float

    def check_duration(self, what: str, seconds: float) -> None:
        """Reject a motion whose points would take too much time and memory, or overflow.

        Parameters
        ----------
        what : str
            The beginning of the message, such as "the duration is".
        seconds : float
            The duration [s].

        Raises
        ------
        GoalError
            If the duration is longer than `longest`, or shorter than a microsecond.
        """
        if not seconds <= self.longest:
            raise GoalError(
                f"{what} {seconds:.4g} s, at most {self.longest:g} s are accepted with a sample "
                f"period of {self.options.sample_period:g} s"
            )
        if not seconds >= INPUT_LIMITS.shortest:
            raise GoalError(
                f"{what} {seconds:.4g} s, at least {INPUT_LIMITS.shortest:g} s are accepted"
            )


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Use one thread in BLAS during a block, then as many as before.

    No effect if threadpoolctl is not installed, as in ROS workspaces that lack it.
    """
    controller = _blas()
    with nullcontext() if controller is None else controller.limit(limits=1):
        yield


@cache
def _blas() -> Any:
    """Controls the BLAS libraries of the process, which are loaded when planning begins."""
    try:
        from threadpoolctl import ThreadpoolController
    except ImportError:
        return None
    return ThreadpoolController().select(user_api="blas")


class Budget:
    """The time that planning may take, from now on, and whether it is cancelled.

    It only cuts a search off, and then says so: otherwise a plan is the same on any machine.

    Parameters
    ----------
    seconds : float
        Longest time for planning [s]; some of it is kept for the last checks.
    is_cancelled : callable
        Returns whether the result is no longer needed: the best motion found until then is
        returned.

    Raises
    ------
    GoalError
        If the time is not a positive number.

    Examples
    --------
    >>> import mp_pca_planner as mp
    >>> mp.Budget(0.2).is_late()
    False
    """

    def __init__(
        self, seconds: float = float("inf"), is_cancelled: Callable[[], bool] = lambda: False
    ) -> None:
        check_number(seconds, "the time for planning [s]", GoalError, 1e-9)
        self.seconds, self.is_cancelled = seconds, is_cancelled
        self.deadline = time.perf_counter() + seconds
        # Of the whole: whether the clock, or a cancellation, ended a search, and the seconds that
        # the check of a motion took at most: the last motion needs one more.
        self.whole, self.is_cut, self.longest_check = self, False, 0.0

    def is_late(self, ahead: float = 0.0) -> bool:
        """Whether the time runs out within some seconds, or the search was cancelled.

        True is remembered: the caller ends what it does.
        """
        ends = time.perf_counter() + ahead + self.whole.longest_check
        late = ends > self.deadline or self.is_cancelled()
        self.whole.is_cut |= late
        return late

    def part(self, share: float) -> Budget:
        """A budget of a share of the remaining time, 0 to 1."""
        part, now = copy(self), time.perf_counter()
        part.deadline = now + share * max(self.deadline - now, 0.0)
        return part
