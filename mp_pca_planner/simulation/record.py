# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Record of commanded and measured states, in a buffer that grows."""

from __future__ import annotations

import numpy as np

from ..arrays import FloatArray


class Record:
    """One row per cycle of the controller.

    Attributes
    ----------
    times, clock, scaling : array, shape (n_cycles,)
        Time of each cycle [s], time for which commands have advanced along trajectories [s],
        and speed scaling.
    q, v, a : array, shape (n_cycles, n_joints)
        Commanded positions [rad or m], and the trajectory's velocities and accelerations there,
        by its own clock [/s, /s²].
    measured : array, shape (n_cycles, n_joints)
        Positions before the command, without noise [rad or m].
    cuts : list of int
        Cycles whose commands may jump: the controller was restarted,
        deactivated, or held the measured position.
    """

    def __init__(self, n_joints: int) -> None:
        self._n = n_joints
        self._size = 0
        self._rows = np.empty((4096, 3 + 4 * n_joints))
        self._columns: dict[str, int | slice] = {"times": 0, "clock": 1, "scaling": 2}
        for k, name in enumerate(("q", "v", "a", "measured")):
            self._columns[name] = slice(3 + k * n_joints, 3 + (k + 1) * n_joints)
        self.cuts: list[int] = []

    def __len__(self) -> int:
        return self._size

    def __getattr__(self, name: str) -> FloatArray:
        if name.startswith("_") or name not in self._columns:
            raise AttributeError(name)
        return self._rows[: self._size, self._columns[name]]

    def append(
        self, stamps: tuple[float, float, float], command: FloatArray, measured: FloatArray
    ) -> None:
        """Add a cycle: its time, clock and scaling; q, v and a in a row; measured positions."""
        if self._size == len(self._rows):
            self._rows = np.concatenate([self._rows, np.empty_like(self._rows)])
        row = self._rows[self._size]
        row[:3] = stamps
        row[3 : -self._n] = command
        row[-self._n :] = measured
        self._size += 1

    def clear(self) -> None:
        """Discard all cycles."""
        self._size = 0
        self.cuts.clear()

    def arrays(self) -> dict[str, FloatArray]:
        """Every array by name, for :func:`numpy.savez`."""
        arrays = {name: getattr(self, name) for name in self._columns}
        return arrays | {"cuts": np.array(self.cuts)}
