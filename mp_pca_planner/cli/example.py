# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""`example`: a robot, a recording of it, limits and an obstacle, as files."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from ..evaluation.problems import DEMONSTRATIONS_SEED, HUMAN_ARM, demonstrations_of, robot_file
from ..files import check_writable, config_file, read_bytes, read_text, write_whole
from ..recordings.bags import write_joint_states
from ..recordings.reaches import reach_recording
from ..recordings.synthetic import SyntheticRecording, continuous_recording
from ..robot.model import Robot
from .common import make_folder, report
from .terminal import DONE, written_lines

FILES = ("arm.urdf", "session.mcap", "limits.yaml", "scene.yaml")
"""The files that are written."""

# Centres of balls on the path of the hand [m].
_BALLS = {HUMAN_ARM: (0.40, -0.57, -0.15), "panda": (0.50, 0.10, 0.52)}
_SCENE = """\
name: ball on the path
world:
  collision_objects:
    - id: ball
      header: {{frame_id: ""}}
      operation: 0
      pose: {{position: {{x: {}, y: {}, z: {}}}, orientation: {{w: 1.0}}}}
      primitives: [{{type: 2, dimensions: [0.05]}}]
      primitive_poses: [{{position: {{x: 0.0, y: 0.0, z: 0.0}}, orientation: {{w: 1.0}}}}]
"""
_PACKAGE = "package://example-robot-data/"


def run(arguments: argparse.Namespace) -> int:
    """Run the command; returns the exit status."""
    make_folder(arguments.output)
    urdf, session, limits, scene = files = [arguments.output / name for name in FILES]
    for file in files:
        check_writable(file, overwrite=arguments.force)
    name, source, joints = robot_file(arguments.robot)
    limits_file = config_file(f"{name}_joint_limits.yaml")
    recording = _recording(name, Robot.from_file(source, joints), limits_file, arguments.motions)
    contents = {
        urdf: _description(source).encode(),
        limits: read_bytes(limits_file),
        scene: _SCENE.format(*_BALLS[name]).encode(),
    }
    for file, content in contents.items():
        write_whole(file, content, overwrite=arguments.force)
    names, stamps = recording.joint_names, recording.stamps
    write_joint_states(
        session, "mcap", names, stamps, recording.positions, overwrite=arguments.force
    )
    facts = {"robot": name, "joint_names": list(names), "files": [str(file) for file in files]}
    report(arguments, facts, f"robot        {name}: {', '.join(names)}", *written_lines(files))
    return DONE


def _description(source: Path) -> str:
    """The robot description, with paths of meshes that hold in every folder."""
    package = next((one for one in source.parents if one.name == "example-robot-data"), None)
    return read_text(source).replace(_PACKAGE, f"file://{package}/")


def _recording(name: str, robot: Robot, limits: Path, n_motions: int) -> SyntheticRecording:
    motions = demonstrations_of(name, robot, robot.limits(limits), n_motions)
    if name == HUMAN_ARM:
        return continuous_recording(motions, seed=DEMONSTRATIONS_SEED)
    others = [joint for joint in robot.movable_joints if joint not in robot.joint_names]
    bounds = robot.with_joints(others).limits()
    resting = np.clip(0.0, bounds.lower, bounds.upper).tolist()
    still = dict(zip(others, resting, strict=True))
    return reach_recording(motions, still, seed=DEMONSTRATIONS_SEED)
