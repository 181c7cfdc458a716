# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Scenes of benchmarks: a robot and generated motions."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

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


def plain_geometry(urdf: Path, joints: Sequence[str]) -> tuple[Any, Any, list[int]]:
    """Model, collision geometry and order of some joints by Pinocchio alone, others locked."""
    full = pin.buildModelFromUrdf(str(urdf))
    kind, folders = pin.GeometryType.COLLISION, [str(folder) for folder in urdf.parents]
    links = pin.buildGeomFromUrdf(full, str(urdf), kind, package_dirs=folders)
    locked = [i for i, name in enumerate(full.names) if i > 0 and name not in joints]
    rest = np.clip(pin.neutral(full), full.lowerPositionLimit, full.upperPositionLimit)
    model, links = pin.buildReducedModel(full, links, locked, rest)
    return model, links, [list(joints).index(name) for name in model.names[1:]]
