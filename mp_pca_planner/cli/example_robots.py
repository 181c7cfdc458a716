# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Robots of the demo with generated motions: a person's arm, and some of example-robot-data."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..arrays import by_name
from ..files import check_writable, config_file, read_text, write_whole
from ..recordings.bags import write_joint_states
from ..recordings.demonstration import Demonstration
from ..recordings.reaches import random_reaches, reach_recording
from ..recordings.synthetic import continuous_recording, generate_motions
from ..robot.examples import HUMAN_ARM, example_file
from ..robot.limits import JointLimits
from ..robot.model import Robot

DEMONSTRATIONS_SEED = 1
"""Seed of the demonstrations."""
_WITH_SCENE = (HUMAN_ARM, "panda")


def demonstrations_of(
    name: str,
    robot: Robot,
    limits: JointLimits,
    n_motions: int = 40,
    seed: int = DEMONSTRATIONS_SEED,
) -> list[Demonstration]:
    """Generated motions of a robot: human-like ones for the human-like arm, else reaches."""
    if name == HUMAN_ARM:
        return generate_motions(n_motions, seed)
    return random_reaches(robot, limits, n_motions, seed)


def write_example(name: str, folder: Path, *, force: bool) -> list[Path]:
    """Write session.mcap, arm.urdf and, of two robots, limits.yaml and scene.yaml."""
    source, joints = example_file(name)
    robot = Robot.from_file(source, joints)
    # Paths of meshes that hold in every folder.
    package = next((one for one in source.parents if one.name == "example-robot-data"), "")
    urdf = read_text(source).replace("package://example-robot-data/", f"file://{package}/")
    contents, limits = {"arm.urdf": urdf}, robot.limits()
    if name in _WITH_SCENE:
        limits_file = config_file(f"{name}_joint_limits.yaml")
        contents["limits.yaml"] = read_text(limits_file)
        contents["scene.yaml"] = read_text(config_file(f"{name}_scene.yaml"))
        limits = robot.limits(limits_file)
    files = [folder / "session.mcap", *(folder / file for file in contents)]
    for file in files:
        check_writable(file, overwrite=force)
    motions = demonstrations_of(name, robot, limits)
    if name == HUMAN_ARM:
        found = continuous_recording(motions, seed=DEMONSTRATIONS_SEED)
    else:
        others = [joint for joint in robot.movable_joints if joint not in robot.joint_names]
        still: dict[str, float] = {}
        if others:
            bounds = robot.with_joints(others).limits()
            still = by_name(others, np.clip(0.0, bounds.lower, bounds.upper))
        found = reach_recording(motions, still, seed=DEMONSTRATIONS_SEED)
    for file, text in zip(files[1:], contents.values(), strict=True):
        write_whole(file, text.encode(), overwrite=force)
    names, stamps, positions = found.joint_names, found.stamps, found.positions
    write_joint_states(files[0], "mcap", names, stamps, positions, overwrite=force)
    return files
