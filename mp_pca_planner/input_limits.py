# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Limits on the input of the package, which comes from files and messages of others."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class InputLimits:
    """Largest sizes and values that are accepted; a refusal states the limit.

    Attributes
    ----------
    text_bytes : int
        Text file: URDF, SRDF, CSV, JSON.
    yaml_bytes : int
        YAML text.
    definition_characters : int
        Definition of messages in a bag; large definitions of ROS have a third of that.
    unpacked_bytes : int
        Content of a CSV file.
    columns : int
        Of a table.
    small_table_values : int
        Numbers that a small Parquet file may unpack to; larger files in proportion to their size.
    joints : int
        Joints of a recording.
    position : float
        Recorded position [rad or m]; drivers mark unknown positions by huge numbers.
    state_rate : float
        Rate of recorded joint states [Hz].
    goal_items : int
        Joints, and points, of a goal of the node.
    goal_bytes : int
        Message of a goal of the node, which answers nothing else while it reads one.
    marker_bytes : int
        Message of markers, which workers read in 2 µs per point: enough for `triangles` in colour.
    primitive_bytes : int
        Content of a primitive file; thousands of demonstrations have a few MB.
    segments : int
        Rows of a table of segments: learning takes minutes from so many motions.
    segment_time : float
        Time in a recording [s], 30 years.
    links, movable_joints : int
        Of a robot: far longer chains overflow the stack of Pinocchio's parser, which keeps the lock
        of the interpreter for a time that grows with the square of the links. Its memory grows with
        the cube of the joints.
    description_value : float
        Length, mass or inertia of a robot [SI units].
    shapes, triangles : int
        Of a world: the time to use it grows with the square of the shapes, and Coal keeps the lock
        of the interpreter while it builds the tree of a mesh, some 80 ms for so many triangles.
    robot_shapes : int
        Collision shapes of a robot: the pairs of more take seconds to set up.
    mesh_triangles : int
        Of a mesh.
    world_length : float
        Size or coordinate of a shape [m].
    mesh_bytes, kept_meshes : int
        Mesh file, and the number of those that are kept in memory.
    targets : int
        Targets of a goal.
    duration : float
        Duration of a planned motion [s].
    shortest : float
        Duration of a planned motion and of its segments [s]; numbers of shorter ones overflow.
    trajectory_points : int
        Points of a planned motion; more would exhaust the memory.
    """

    text_bytes: int = 16 << 20
    yaml_bytes: int = 1 << 20
    definition_characters: int = 1 << 17
    unpacked_bytes: int = 256 << 20
    columns: int = 10_000
    small_table_values: int = 500_000
    joints: int = 500
    position: float = 1e6
    state_rate: float = 5000.0
    goal_items: int = 1000
    goal_bytes: int = 200_000
    marker_bytes: int = 8_000_000
    primitive_bytes: int = 1 << 28
    segments: int = 10_000
    segment_time: float = 1e9
    links: int = 500
    movable_joints: int = 200
    description_value: float = 1e9
    shapes: int = 1000
    triangles: int = 50_000
    robot_shapes: int = 500
    mesh_triangles: int = 500_000
    world_length: float = 1e3
    mesh_bytes: int = 64 << 20
    kept_meshes: int = 500
    targets: int = 200
    duration: float = 600.0
    shortest: float = 1e-6
    trajectory_points: int = 100_000

    def longest_motion(self, period: float) -> float:
        """The longest duration of a motion with points this time apart [s]."""
        return min(self.duration, self.trajectory_points * period)


INPUT_LIMITS = InputLimits()
