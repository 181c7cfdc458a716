# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A running planner node as the page shows it, in plain values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from ..arrays import FloatArray
from ..motion.trajectory import Trajectory
from ..robot.world import World

SILENCE = 3.0
"""Time without diagnostics, which come once a second, after which the node counts as gone [s]."""


@dataclass(frozen=True)
class NodeStatus:
    """A report of the node.

    Attributes
    ----------
    level : int
        0: good, 1: warning, 2: error, 3: stale.
    message : str
        One sentence.
    values : mapping of str to str
        Figures.
    time : float
        When it came, by :func:`time.monotonic` [s].
    """

    level: int
    message: str
    values: Mapping[str, str]
    time: float


@dataclass(frozen=True)
class LiveView:
    """What was received up to now; times by :func:`time.monotonic` [s].

    Attributes
    ----------
    states : mapping
        Position [rad or m], velocity (NaN where none is given) and time of receipt, by joint.
    goal : tuple of (str, float), or None
        A description of the newest goal, and when it came.
    report, execution, diagnostics : NodeStatus or None
        The newest report of a plan, of an execution, and on the node.
    motion : Trajectory or None
        The newest motion that the node has published.
    world : World
        The obstacles of the node.
    """

    states: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)
    goal: tuple[str, float] | None = None
    report: NodeStatus | None = None
    execution: NodeStatus | None = None
    diagnostics: NodeStatus | None = None
    motion: Trajectory | None = None
    world: World = field(default_factory=World)

    def configuration(self, joint_names: Sequence[str]) -> FloatArray | None:
        """Measured positions, shape (n_joints,); None before all of them are known."""
        if any(name not in self.states for name in joint_names):
            return None
        found = np.array([self.states[name][0] for name in joint_names])
        return found if np.all(np.isfinite(found)) else None

    def has_node(self, now: float) -> bool:
        """Whether the node runs."""
        return self.diagnostics is not None and now - self.diagnostics.time < SILENCE


class LiveLink(Protocol):
    """A connection to a running node, used by one thread."""

    def view(self) -> LiveView:
        """What was received up to now."""

    def send_goal(self, positions: Mapping[str, float]) -> None:
        """Send a goal configuration by joint name [rad or m]."""

    def stop(self) -> str:
        """Stop the robot; returns the node's answer, or why there is none."""
