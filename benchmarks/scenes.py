# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Scenes of benchmarks: a robot and generated motions."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from mp_pca_planner.evaluation.problems import Scene, demonstrations_of
from mp_pca_planner.robot.model import Robot


def scene_of(name: str, urdf: Path, joints: Sequence[str] | None, n_motions: int) -> Scene:
    """A robot with the limits of its description and randomly generated motions.

    Parameters
    ----------
    name, urdf, joints :
        The robot, see :func:`robot_file`.
    n_motions :
        Number of demonstrations.
    """
    robot = Robot.from_file(urdf, joints)
    limits = robot.limits()
    motions = demonstrations_of(name, robot, limits, n_motions)
    return Scene(name, urdf, robot, limits, tuple(motions))
