# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Collisions along a trajectory, of links with each other and with obstacles.

The distances of pairs of bodies are followed along the motion that the controller executes. A pair
can't touch before the joints between its bodies have moved by its distance, so it is checked again
only then (conservative advancement: Mirtich, PhD thesis, Berkeley, 1996), and otherwise every
millisecond.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..robot.collision import CONTACT, CollisionGeometry, package_folders
from .trajectory import Trajectory
from .validation import interpolate

__all__ = ["NOT_CHECKED", "Collision", "CollisionModel", "package_folders"]

NOT_CHECKED = "; self-collisions were not checked: the robot has no collision geometry"
"""End of messages on robots without collision geometry."""

# A pair whose next check is more samples away than the first number needs no exact distance. Every
# pair is checked again after at most the second number of samples.
_SOON, _LATEST = 20, 500


@dataclass(frozen=True)
class Collision:
    """Two bodies that collide during a motion, or come nearer than their margin.

    Attributes
    ----------
    pair : int
        Index of the pair in the model.
    links : tuple of str
        Their names.
    time : float
        When their penetration is deepest [s].
    penetration : float
        Its depth [m]; a lower bound for meshes that are not convex. With a margin, by how much the
        bodies are nearer than that.
    first_time : float
        When the collision begins [s].
    last_time : float
        When it was last found [s].
    point : tuple of float
        Where the bodies meet then, in the base frame [m].
    margin : float
        Least clearance of the pair [m].
    """

    pair: int
    links: tuple[str, str]
    time: float
    penetration: float
    first_time: float
    last_time: float
    point: tuple[float, float, float]
    margin: float = 0.0

    def within(self, began: float, ended: float) -> Collision | None:
        """The part of it between two times, with times counted from the first; None if none."""
        first, last = max(self.first_time, began), min(self.last_time, ended)
        if first > last:
            return None
        moment = min(max(self.time, first), last)
        return replace(self, time=moment - began, first_time=first - began, last_time=last - began)

    def __str__(self) -> str:
        x, y, z = self.point
        return (
            f"{self.bodies} from {self.first_time:.3f} s on "
            f"(deepest at {self.time:.3f} s, by {1e3 * self.penetration:.1f} mm, "
            f"near ({x:.3f}, {y:.3f}, {z:.3f}) m)"
        )

    @property
    def bodies(self) -> str:
        """The two bodies and what is wrong with them, as text."""
        names = f"'{self.links[0]}' and '{self.links[1]}'"
        if self.margin == 0.0:
            return f"{names} collide"
        return f"{names} are nearer than the margin of {1e3 * self.margin:.3g} mm"


class CollisionModel(CollisionGeometry):
    """Collisions of a robot's motions."""

    def collisions(self, trajectory: Trajectory) -> tuple[Collision, ...]:
        """The collisions of a motion, one of each pair that has any, the deepest first.

        Parameters
        ----------
        trajectory : Trajectory
            The motion, of the robot's joints in its order.
        """
        dense = interpolate(trajectory)
        speeds = np.abs(dense.v[:, self.model_order])
        displacements = np.maximum(speeds[1:], speeds[:-1]) * np.diff(dense.times)[:, None]
        # Distance that each joint has travelled up to each moment.
        travelled = np.concatenate(
            [np.zeros((1, displacements.shape[1])), np.cumsum(displacements, axis=0)]
        )
        i, last = 0, len(travelled) - 1
        due = np.zeros(len(self.pairs), dtype=np.intp)
        found: dict[int, list[tuple[float, float]]] = {}
        while i <= last and self.pairs:
            # The last sample is checked in any case.
            now = np.flatnonzero(due <= i) if i < last else np.arange(due.size)
            # Largest distance that each pair can have closed at the samples that follow [m].
            closed = (travelled[i + 1 : i + 1 + _LATEST] - travelled[i]) @ self.levers[now].T
            soon = closed[:_SOON].max(axis=0, initial=0.0)
            distances = self.lower_bounds(dense.q[i], now, soon)
            due[now] = i + 1 + np.count_nonzero(closed < distances, axis=0)
            for pair, distance in zip(now, distances, strict=True):
                if not distance >= CONTACT:  # a NaN is a collision
                    found_at = float(distance), float(dense.times[i])
                    found.setdefault(int(pair), []).append(found_at)
            i = min(int(due.min()), last) if i < last else last + 1
        return tuple(
            Collision(
                k,
                self.pairs[k],
                time,
                max(0.0, -distance),
                samples[0][1],
                samples[-1][1],
                tuple(self.nearest_point(dense.q[dense.times.searchsorted(time)], k).tolist()),
                float(self.margins[k]),
            )
            for (distance, time), k, samples in sorted(
                (min(samples), k, samples) for k, samples in found.items()
            )
        )
