#!/usr/bin/env python3
# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Makes the two interfaces of control_msgs that the node uses, where ROS 2 comes from PyPI.

`scripts/control_messages.py FOLDER` makes a package `control_msgs` in FOLDER, with the messages and
the action below, and prints the variable of the environment with which it is found. It needs a C++
compiler and the headers of Python. The names and types of the fields are those of ROS 2 Jazzy, so
that the node meets a real controller; all the rest is made by the generators of ROS 2.

A ROS 2 installation with ros2_control has the real package: nothing is made then.
"""

from __future__ import annotations

import contextlib
import importlib.util
import io
import os
import shutil
import subprocess
import sys
import sysconfig
import tempfile
import textwrap
from pathlib import Path

PACKAGE = "control_msgs"

INTERFACES = {
    "msg/JointTolerance.msg": """
        string name
        float64 position
        float64 velocity
        float64 acceleration
    """,
    "msg/JointComponentTolerance.msg": """
        uint16 X_AXIS=1
        uint16 Y_AXIS=2
        uint16 Z_AXIS=3
        uint16 TRANSLATION=4
        uint16 ROTATION=5
        string joint_name
        uint16 component
        float64 position
        float64 velocity
        float64 acceleration
    """,
    "msg/JointTrajectoryControllerState.msg": """
        std_msgs/Header header
        string[] joint_names
        trajectory_msgs/JointTrajectoryPoint reference
        trajectory_msgs/JointTrajectoryPoint feedback
        trajectory_msgs/JointTrajectoryPoint error
        trajectory_msgs/JointTrajectoryPoint output
        string[] multi_dof_joint_names
        trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_reference
        trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_feedback
        trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_error
        trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_output
        float64 speed_scaling_factor
    """,
    "action/FollowJointTrajectory.action": """
        trajectory_msgs/JointTrajectory trajectory
        trajectory_msgs/MultiDOFJointTrajectory multi_dof_trajectory
        JointTolerance[] path_tolerance
        JointComponentTolerance[] component_path_tolerance
        JointTolerance[] goal_tolerance
        JointComponentTolerance[] component_goal_tolerance
        builtin_interfaces/Duration goal_time_tolerance
        ---
        int32 error_code
        int32 SUCCESSFUL = 0
        int32 INVALID_GOAL = -1
        int32 INVALID_JOINTS = -2
        int32 OLD_HEADER_TIMESTAMP = -3
        int32 PATH_TOLERANCE_VIOLATED = -4
        int32 GOAL_TOLERANCE_VIOLATED = -5
        string error_string
        ---
        std_msgs/Header header
        string[] joint_names
        trajectory_msgs/JointTrajectoryPoint desired
        trajectory_msgs/JointTrajectoryPoint actual
        trajectory_msgs/JointTrajectoryPoint error
        string[] multi_dof_joint_names
        trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_desired
        trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_actual
        trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_error
    """,
}

# Libraries that are loaded are found by their names, wherever they are.
_START = """
import ctypes
import pathlib

for _library in sorted(pathlib.Path(__file__).parent.glob("lib*.so")):
    ctypes.CDLL(str(_library))
"""

_TYPE_SUPPORTS = ["rosidl_typesupport_fastrtps_c", "rosidl_typesupport_introspection_c"]


def main(arguments: list[str]) -> str | None:
    """Make the package in the folder given; returns why that can't be done, None if it was."""
    if len(arguments) != 1:
        return "give one folder, in which the package is made"
    if reason := _missing():
        return reason
    target = Path(arguments[0]).resolve()
    target.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=target) as work:
        package = Path(work) / "made" / PACKAGE
        # The generators look up their templates there, and say what they read.
        os.environ.setdefault("AMENT_PREFIX_PATH", sys.prefix)
        with contextlib.redirect_stdout(io.StringIO()):
            _generate(Path(work))
        if reason := _compile(Path(work), package):
            return reason
        (package / "__init__.py").write_text(_START, encoding="utf-8")
        # Whole or not at all, and what another process has made meanwhile is as good.
        with contextlib.suppress(OSError):
            package.rename(target / PACKAGE)
    print(f"PYTHONPATH={target}")
    return None


def _missing() -> str:
    """What is not there of all that is needed; empty if it is."""
    for module in ("rclpy", "rosidl_adapter", "rosidl_generator_py", "trajectory_msgs"):
        if importlib.util.find_spec(module) is None:
            return f"there is no Python package '{module}': install the wheels of ROS 2"
    if shutil.which("gcc") is None or shutil.which("g++") is None:
        return "there is no C++ compiler: install the package 'g++'"
    header = Path(sysconfig.get_paths()["include"]) / "Python.h"
    return "" if header.exists() else f"there is no '{header}': install the package 'python3-dev'"


def _generate(work: Path) -> None:
    """Write the sources of the package."""
    from rosidl_adapter.action import convert_action_to_idl
    from rosidl_adapter.msg import convert_msg_to_idl
    from rosidl_generator_c.cli import GenerateC
    from rosidl_generator_py.cli import GeneratePython
    from rosidl_typesupport_c.cli import GenerateCTypesupport
    from rosidl_typesupport_fastrtps_c.cli import GenerateFastRTPSCTypesupport
    from rosidl_typesupport_introspection_c.cli import GenerateIntrospectionCTypesupport

    descriptions, files = work / PACKAGE, []
    for name, fields in INTERFACES.items():
        path = descriptions / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(textwrap.dedent(fields).lstrip(), encoding="utf-8")
        convert = convert_action_to_idl if path.suffix == ".action" else convert_msg_to_idl
        convert(descriptions, PACKAGE, Path(name), path.parent)
        files.append(f"{descriptions}:{Path(name).with_suffix('.idl')}")
    includes = [str(Path(sys.prefix) / "share"), str(work)]
    # In a folder of each, because some of their files have the same names.
    for name, generator in (
        ("made", GeneratePython("py", typesupport_implementations=["rosidl_typesupport_c"])),
        ("c", GenerateC("c")),
        ("c_support", GenerateCTypesupport("c", typesupport_implementations=_TYPE_SUPPORTS)),
        ("fastrtps_c", GenerateFastRTPSCTypesupport("fastrtps_c")),
        ("introspection_c", GenerateIntrospectionCTypesupport("introspection_c")),
    ):
        generator.generate(PACKAGE, files, includes, work / name / PACKAGE)


def _compile(work: Path, package: Path) -> str:
    """Make one library of all sources; returns why that failed, empty if it did not."""
    from numpy import get_include

    prefix, name = Path(sys.prefix), f"{PACKAGE}_s__rosidl_typesupport_c.so"
    headers = prefix / "include"
    folders = [*work.iterdir(), sysconfig.get_paths()["include"], get_include(), headers]
    # Those of the packages whose messages are fields of ours, and of the type supports.
    libraries = [
        path.name.removeprefix("lib").removesuffix(".so")
        for path in sorted((prefix / "lib").glob("lib*.so"))
        if path.name.startswith(("librosidl_", "libfastcdr", "librmw.", "librcutils"))
        or path.name.partition("__")[2].endswith(("_c.so", "_py.so"))
    ]
    sources = [path for path in work.rglob("*.c*") if path.suffix in (".c", ".cpp")]
    reason = _gcc(
        *("-O1", "-w", "-fPIC", "-shared", "-o", package / name),
        *(f"-I{folder}" for folder in (*folders, *headers.iterdir())),
        *sorted(sources),
        *(f"-L{prefix / 'lib'}", "-Wl,--as-needed", "-lstdc++"),
        *(f"-l{library}" for library in libraries),
    )
    # At run time, the implementation is looked up in a library of each of these names.
    for support in () if reason else _TYPE_SUPPORTS:
        alias = f"lib{PACKAGE}__{support}.so"
        reason = reason or _gcc(
            *("-shared", "-o", package / alias, f"-Wl,-soname,{alias}"),
            *(f"-L{package}", f"-l:{name}", "-Wl,-rpath,$ORIGIN"),
        )
    return reason


def _gcc(*arguments: object) -> str:
    """Run the compiler; returns why it failed, empty if it did not."""
    command = ["gcc", "-Wl,--no-as-needed", *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return f"the compiler failed: {done.stderr[-2000:]}" if done.returncode else ""


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
