# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The command `simulate`: the simulated robot as ROS sees it, over the middleware."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from contextlib import contextmanager

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS 2 (extra 'ros') is not installed")

from rcl_interfaces.msg import Log
from rcl_interfaces.srv import SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from support.arm import GRIPPER_URDF, JOINTS, URDF, arm_primitive
from support.commands import refusal
from support.domains import set_domain
from support.nodes import ros_node
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from mp_pca_planner.files import config_file

START = (0.1, 0.2, 0.0, -0.8)
START_TEXT = ",".join(map(str, START))
PATIENCE = 60.0
ARM = config_file("human_arm.urdf")


@pytest.fixture(autouse=True)
def _own_domain(monkeypatch):
    set_domain(monkeypatch, 70)


class User:
    """What a user of a robot sees of it, and sends to it."""

    def __init__(self, node, topic, run):
        self._run = run
        self._executor = SingleThreadedExecutor(context=node.context)
        self.states, self.descriptions, self.log = [], [], []
        node.create_subscription(Log, "/rosout", lambda line: self.log.append(line.msg), 1000)
        node.create_subscription(JointState, "joint_states", self.states.append, 10_000)
        self._node = node
        self._executor.add_node(node)
        self._trajectories = node.create_publisher(JointTrajectory, topic, 1)
        self._parameters = node.create_client(SetParameters, "simulated_robot/set_parameters")
        self.wait(lambda: self.states and self._trajectories.get_subscription_count())
        self.wait(self._parameters.service_is_ready)
        self.wait(lambda: node.count_publishers("/rosout") > 1)

    def wait(self, is_done):
        deadline = time.monotonic() + PATIENCE
        while not is_done():
            assert self._run.poll() is None, self._run.communicate()[1]
            assert time.monotonic() < deadline
            self._executor.spin_once(timeout_sec=0.05)

    def stamps(self):
        """Stamps of the joint states [ns]."""
        stamps = [state.header.stamp for state in self.states]
        return [stamp.sec * 10**9 + stamp.nanosec for stamp in stamps]

    def hear_description(self):
        """Subscribe late: the description is latched."""
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        keep = self.descriptions.append
        self._node.create_subscription(String, "robot_description", keep, latched)
        self.wait(lambda: self.descriptions)
        return self.descriptions[0].data

    def send(self, positions, seconds):
        point = JointTrajectoryPoint(positions=list(positions), velocities=[0.0] * len(positions))
        point.time_from_start.sec = seconds
        self._trajectories.publish(JointTrajectory(joint_names=JOINTS, points=[point]))

    def set(self, name, value):
        parameter = Parameter(name, value=value).to_parameter_msg()
        future = self._parameters.call_async(SetParameters.Request(parameters=[parameter]))
        self.wait(future.done)
        (result,) = future.result().results
        return result.reason if not result.successful else ""

    def wait_until_at(self, positions):
        self.wait(lambda: np.abs(np.array(self.states[-1].position) - positions).max() < 1e-7)


@contextmanager
def simulated(
    *options,
    robot=ARM,
    topic="mp_pca_planner/joint_trajectory",
    number=signal.SIGINT,
    start=("--start", START_TEXT),
):
    """The command, its user, and what it printed in the end."""
    command = [sys.executable, "-m", "mp_pca_planner", "simulate", "--json"]
    command += ["--robot", str(robot)]
    command += [*start, *options]
    printed = {}
    with (
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as run,
        ros_node("user") as node,
    ):
        try:
            yield User(node, topic, run), printed
        finally:
            run.send_signal(number)
            output, errors = run.communicate(timeout=PATIENCE)
            printed["stderr"] = errors
    assert run.returncode == 0, errors
    assert "Traceback" not in errors
    printed |= json.loads(output)


def test_robot_executes_what_it_is_sent_and_records_every_command(tmp_path):
    path, goal = tmp_path / "commands.npz", np.array([0.4, 0.1, 0.2, -1.2])
    with simulated("--record", str(path)) as (user, printed):
        np.testing.assert_allclose(user.states[0].position, START, atol=1e-9)
        assert list(user.states[0].name) == list(JOINTS)
        assert user.hear_description() == URDF
        user.send(goal, 1)
        user.wait_until_at(goal)
    assert (printed["received"], printed["rejected"]) == (1, [])
    np.testing.assert_allclose(printed["positions"], goal, atol=2e-4)
    record = np.load(path)
    assert list(record["joint_names"]) == list(JOINTS)
    np.testing.assert_array_equal(record["q"][-1], goal)
    # Commands come every millisecond, whenever the process was running.
    np.testing.assert_allclose(np.diff(record["clock"]), 1e-3, atol=1e-12)
    assert np.diff(user.stamps()).min() == 2_000_000


def test_options_count_and_faults_are_parameters(tmp_path):
    primitive = arm_primitive()
    primitive.save(tmp_path / "reach.npz")
    options = ["--controller-topic", "arm/joint_trajectory", "--rate", "100", "--payload", "1"]
    options += ["--primitive", str(tmp_path / "reach.npz"), "--speed-scaling", "0.5"]
    chosen = {"topic": "arm/joint_trajectory", "number": signal.SIGTERM, "start": ()}
    with simulated(*options, **chosen) as (user, printed):
        assert list(user.states[0].name) == list(primitive.joint_names)
        starts = primitive.boundary_states[:, 0]
        # The payload makes it sag, by 5.5 mrad at rest; other starts are 116 mrad away.
        assert np.abs(starts - user.states[0].position).max(axis=1).min() < 0.02
        assert "expected a number from 0 to 1" in user.set("speed_scaling", 2.0)
        assert user.set("payload", 0.0) == ""
        user.states.clear()
        user.wait(lambda: len(user.states) > 50)
        assert set(np.diff(user.stamps())) == {10_000_000}
        # A controller that is not active says why it rejects.
        assert user.set("active", False) == ""
        user.send(START, 1)
        user.wait(lambda: any("not active" in line for line in user.log))
    (rejected,) = printed["rejected"]
    assert rejected["reason"] == "the controller is not active"


def test_joints_beside_those_of_the_primitive_are_published_at_rest(tmp_path):
    (tmp_path / "arm.urdf").write_text(GRIPPER_URDF)
    arm_primitive().save(tmp_path / "reach.npz")
    options = ("--primitive", str(tmp_path / "reach.npz"))
    with simulated(*options, robot=tmp_path / "arm.urdf", start=()) as (user, _):
        state = user.states[-1]
        assert list(state.name) == [*JOINTS, "finger"]
        assert (state.position[-1], state.velocity[-1], state.effort[-1]) == (0.05, 0.0, 0.0)


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        (["--start", "wrist=1"], "no joint is called 'wrist'"),
        (["--payload", "-1"], "payload is -1.0, expected a number from 0"),
        (["--start", "elbow=-30"], "--start: joint 'elbow' at -30 is outside its limits [-2.79"),
        (["--start", "1,2"], "--start has 2 values, expected 4: "),
    ],
)
def test_wrong_use_is_refused_in_one_line(options, reason):
    assert reason in refusal("simulate", "--robot", config_file("human_arm.urdf"), *options)
