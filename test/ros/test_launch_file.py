# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The launch file: read, loaded, and launched. `launch` comes with a ROS installation only."""

from __future__ import annotations

import ast
import os
import signal
import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path

import pytest
import yaml
from support.patience import HANG

from mp_pca_planner.execution.parameters import DECLARATIONS

FOLDER = Path(__file__).parents[2]
LAUNCH_FILE = FOLDER / "launch" / "planner.launch.py"
LAUNCH_ARGUMENTS = {
    "robot_description_file",
    "xacro_arguments",
    "robot_description_topic",
    "joint_states_topic",
    "params_file",
    "controller_topic",
    "namespace",
    "rviz",
    "fixed_frame",
    "use_sim_time",
}
PARAMETERS = {declaration.name for declaration in DECLARATIONS}

needs_launch = pytest.mark.skipif(
    find_spec("launch_ros") is None, reason="launch_ros is not installed"
)

# What `ros2 launch` does.
LAUNCH = """
import sys
from launch import LaunchService
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource

file, *arguments = sys.argv[1:]
service = LaunchService()
service.include_launch_description(
    IncludeLaunchDescription(
        PythonLaunchDescriptionSource(file),
        launch_arguments=[argument.split(":=") for argument in arguments],
    )
)
sys.exit(service.run())
"""


def test_launch_file_declares_its_arguments_and_uses_no_others() -> None:
    tree = ast.parse(LAUNCH_FILE.read_text(encoding="utf-8"))
    calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call)]

    def first_arguments(function: str) -> set[str]:
        found = [c for c in calls if isinstance(c.func, ast.Name) and c.func.id == function]
        return {c.args[0].value for c in found if isinstance(c.args[0], ast.Constant)}

    assert first_arguments("DeclareLaunchArgument") == LAUNCH_ARGUMENTS
    used = first_arguments("value") | first_arguments("LaunchConfiguration")
    assert used == LAUNCH_ARGUMENTS


@needs_launch
def test_launch_file_loads_and_declares_its_arguments() -> None:
    from launch import LaunchContext
    from launch.actions import DeclareLaunchArgument
    from launch.launch_description_sources import PythonLaunchDescriptionSource

    source = PythonLaunchDescriptionSource(str(LAUNCH_FILE))
    description = source.get_launch_description(LaunchContext())
    declared = [e.name for e in description.entities if isinstance(e, DeclareLaunchArgument)]
    assert set(declared) == LAUNCH_ARGUMENTS | PARAMETERS
    assert len(declared) == len(set(declared))


@pytest.fixture
def prefix(tmp_path: Path) -> Path:
    """As much of an installation as launching needs, made of links to this checkout."""
    share = tmp_path / "share"
    for link, target in (
        (share / "ament_index/resource_index/packages/mp_pca_planner", "resource/mp_pca_planner"),
        (share / "mp_pca_planner/config", "config"),
        (tmp_path / "lib/mp_pca_planner", "scripts/ros2_run"),
    ):
        link.parent.mkdir(parents=True, exist_ok=True)
        link.symlink_to(FOLDER / target)
    return tmp_path


def launched(prefix: Path, *arguments: str) -> subprocess.Popen[str]:
    paths = [str(prefix), *filter(None, [os.environ.get("AMENT_PREFIX_PATH")])]
    python = [str(FOLDER), *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = os.environ | {
        "AMENT_PREFIX_PATH": os.pathsep.join(paths),
        "PATH": os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]]),
        "PYTHONPATH": os.pathsep.join(python),
        "ROS_LOG_DIR": str(prefix),
    }
    return subprocess.Popen(
        [sys.executable, "-c", LAUNCH, str(LAUNCH_FILE), *arguments],
        env=environment,
        start_new_session=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


@needs_launch
def test_launched_node_uses_arguments_before_the_file_of_parameters_and_ends_with_the_launch(
    prefix: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from support.arm import JOINTS, URDF, arm_primitive
    from support.domains import set_domain
    from support.nodes import GOAL, PATIENCE, START, NodeClient, goal_message
    from trajectory_msgs.msg import JointTrajectory

    from mp_pca_planner.primitives.file import save_primitive

    set_domain(monkeypatch, 27)
    save_primitive(arm_primitive(), tmp_path / "arm.npz")
    (tmp_path / "arm.urdf").write_text(URDF, encoding="utf-8")
    parameters = tmp_path / "parameters.yaml"
    parameters.write_text(
        yaml.safe_dump({"/**": {"ros__parameters": PATIENCE | {"duration": 1.5}}})
    )
    process = launched(
        prefix,
        f"primitives:={tmp_path / 'arm.npz'}",
        f"robot_description_file:={tmp_path / 'arm.urdf'}",
        f"params_file:={parameters}",
        "controller_topic:=/controller/joint_trajectory",
        "joint_states_topic:=/franka/joint_states",
        "namespace:=left",
        "duration:=1.25",
        "publish_effort:=true",
        "stamp_trajectories:=false",  # with stamps, motions begin with a hold
    )
    try:
        with NodeClient(namespace="left", joint_states="/franka/joint_states") as client:
            received: list[JointTrajectory] = []
            topic = "/controller/joint_trajectory"
            client.node.create_subscription(JointTrajectory, topic, received.append, 1)
            client.wait_for_node(with_trajectory=False)
            client.wait_for_model()
            deadline = time.monotonic() + HANG
            while not received:  # until the state has come through
                client.publish_state(JOINTS, START)
                answer = client.send(goal_message(GOAL), with_trajectory=False)
                assert time.monotonic() < deadline, answer.report.message
                client.spin_once()
    finally:
        os.killpg(process.pid, signal.SIGINT)  # as a terminal does at Ctrl-C
        output, _ = process.communicate(timeout=HANG)
    last = received[0].points[-1]
    assert list(last.positions) == GOAL
    assert last.time_from_start.sec + last.time_from_start.nanosec * 1e-9 == 1.25
    assert len(last.effort) == len(GOAL)
    assert process.returncode == 0
    assert "process has finished cleanly" in output
    assert "Traceback" not in output


@needs_launch
@pytest.mark.parametrize(
    ("argument", "words"),
    [
        ("rviz:=perhaps", "['true', 'false']"),
        ("robot_description_file:=missing.xacro", "xacro"),
        ("duration:=many", "duration:=many is not accepted: it must be a number"),
    ],
)
def test_wrong_argument_is_named_and_nothing_is_left_running(
    prefix: Path, argument: str, words: str
) -> None:
    process = launched(prefix, argument)
    output, _ = process.communicate(timeout=HANG)
    assert process.returncode == 1
    assert words in output
