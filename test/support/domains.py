# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""ROS domains that no other test process of this machine uses: leased by locks on files."""

from __future__ import annotations

import fcntl
import tempfile
from pathlib import Path
from typing import IO

import pytest

_leases: dict[object, tuple[int, IO[str]]] = {}
"""Domain and locked file of each key; the locks end with the process."""


def lease_domain(key: object = "") -> int:
    """A domain of this process alone; the same one for the same key."""
    if key not in _leases:
        for number in range(1, 101):
            file = (Path(tempfile.gettempdir()) / f"mp_pca_planner_domain_{number}").open("w")
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                file.close()
            else:
                _leases[key] = number, file
                break
        else:
            raise RuntimeError("all 100 ROS domains are in use by tests")
    return _leases[key][0]


def set_domain(patch: pytest.MonkeyPatch, key: object) -> None:
    """Meet only nodes of this test process and key."""
    from mp_pca_planner.ros.client import this_machine_only

    for name, value in this_machine_only(lease_domain(key)).items():
        patch.setenv(name, value)
