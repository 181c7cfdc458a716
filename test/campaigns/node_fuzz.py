# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Fuzz test of the node: random messages on every topic, odd values for every parameter.

Run it as ``python3 -m campaigns.node_fuzz``. After each step, the services are called, the
parameters are reset, and a valid goal must be served. The script exits with status 1 if the node
dies, does not answer, or reports an internal error. `test/ros/test_node_fuzz.py` runs a short
version; `stop_latency` measures how soon ``~/stop`` answers during the inputs that take long.
"""

from __future__ import annotations

import argparse
import os
import random
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from subprocess import Popen
from typing import Any

from campaigns.fuzz_states import ODD_STATES, odd_states
from geometry_msgs.msg import PoseStamped, Vector3
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterType, ParameterValue
from rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    ListParameters,
    SetParameters,
    SetParametersAtomically,
)
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import Trigger
from support.node_setup import URDF, RobotClient, primitive_file, silent_node, start_node
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint
from visualization_msgs.msg import Marker, MarkerArray

from mp_pca_planner.recordings.synthetic import JOINT_NAMES, generate_motions
from mp_pca_planner.ros.client import is_served, this_machine_only

_PATIENCE, _ACKNOWLEDGED = 120.0, 5.0  # [s]
_PERIOD = 2e-3
_DEFECT, _N_BEFORE = "internal error", 50  # the lines of the log before such a line are printed
_MOTION = generate_motions(1, seed=2)[0]
_START, _END = _MOTION.positions[0], _MOTION.positions[-1]
_STATE = JointState(name=JOINT_NAMES, position=_START.tolist(), velocity=[0.0] * len(_START))
_POINT = JointTrajectoryPoint(positions=_END.tolist())
_MARKER = Marker(type=Marker.CUBE, scale=Vector3(x=0.1, y=0.1, z=0.1))
_MARKER.pose.position.x, _MARKER.pose.orientation.w = 5.0, 1.0
TOPICS: dict[str, Any] = {
    "joint_states": _STATE,
    "robot_description": String(data=URDF.read_text(encoding="utf-8")),
    "mp_pca_planner/goal": JointState(name=JOINT_NAMES, position=_END.tolist()),
    "mp_pca_planner/goal_pose": PoseStamped(),
    "mp_pca_planner/goal_sequence": JointTrajectory(joint_names=JOINT_NAMES, points=[_POINT] * 3),
    "mp_pca_planner/obstacles": MarkerArray(markers=[_MARKER] * 2),
}
"""Every subscription by name, with a valid message."""

_LONG = "x" * 5000
_CHAIN = "".join(
    f'<link name="l{k}"/><joint name="j{k}" type="revolute"><parent link="l{k}"/>'
    f'<child link="l{k + 1}"/><limit effort="1" velocity="1"/></joint>'
    for k in range(20_000)
)
_CHAIN = f'<robot name="chain">{_CHAIN}<link name="l20000"/></robot>'
ODD_VALUES: tuple[Any, ...] = (
    *(None, True, False),
    *(0, 1, -1, 7, 2**31, 2**63 - 1, -(2**63)),
    *(0.0, -0.0, 0.5, -1.0, 5e-324, 1e-300, 1e308, float("inf"), float("-inf"), float("nan")),
    *("", " ", _LONG, 200 * _LONG, "/", "..", "~", "../" * 1000, "/dev/zero", "/dev/stdin"),
    *("a\nb", "\x1b[31mred", "\u202eright", "🤖", "%s%n$(reboot)`id`", "null", "[]", "auto"),
    *("<robot/>", _CHAIN, str(URDF), URDF.read_text("utf-8")),
    *([], [True], [0], [0.0], [""], [_LONG], ["/"], ["/dev/zero"], ["a"] * 10_000),
    *(b"", b"\xff\x00"),
)
"""About fifty values that are tried for every parameter."""

MESSAGES_OF_MANY = (
    JointState(name=[f"joint_{k}" for k in range(100_000)], position=[0.0] * 100_000),
    JointState(name=["joint"] * 100_000, position=[0.0] * 100_000),
    JointTrajectory(joint_names=JOINT_NAMES, points=[_POINT] * 100_000),
)
"""Well-formed goals that are far too large."""


def main() -> int:
    """Run the fuzz test and print the results."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--messages", type=int, default=2000, help="garbage for each topic")
    parser.add_argument("--share", type=int, default=1, help="set each parameter to 1 in so many")
    arguments = parser.parse_args()
    os.environ.update(this_machine_only())
    with (
        primitive_file() as file,
        tempfile.TemporaryDirectory() as folder,
        (Path(folder) / "log.txt").open("w+") as log,
    ):
        own = ("-p", f"primitives:=['{file}']", "-p", f"save_folder:='{folder}'")
        node = start_node(*own, "-p", "state_timeout:=3600.0", output=log)
        try:
            with RobotClient() as client, silent_node("fuzzer") as caller:
                fuzzer = Fuzzer(node, client, caller)
                fuzzer.check("the start")
                fuzzer.send_garbage(arguments.messages)
                fuzzer.send_too_much()
                fuzzer.send_odd_states(arguments.messages // 10)
                fuzzer.send_unknown_frames()
                fuzzer.set_odd_values(arguments.share)
        finally:
            node.terminate()
            status = node.wait(timeout=60.0)
        log.seek(0)
        lines = log.read().splitlines()
    found = {line[line.index("internal") :]: k for k, line in enumerate(lines) if _DEFECT in line}
    print(
        f"{fuzzer.n_steps} steps with {fuzzer.n_sent} messages and values, {fuzzer.n_served} good "
        "goals served in between"
    )
    print(f"the node ended with status {status} and logged {len(found)} kinds of internal errors")
    for text, k in found.items():
        print(f"{text}, after:", *lines[max(k - _N_BEFORE, 0) : k], sep="\n")
    return int(status != 0 or bool(found))


class Fuzzer:
    """Sends invalid input to the node, and checks that it continues to serve goals.

    Parameters
    ----------
    node :
        The process of the node.
    client :
        A client of the node.
    caller :
        A node of the fuzzer's own.
    seed : int
        Seed of the random input.
    """

    def __init__(
        self,
        node: Popen[str],
        client: RobotClient,
        caller: Node,
        seed: int = 1,
    ) -> None:
        self.n_steps = self.n_served = self.n_sent = 0
        self._node, self._client, self._caller = node, client, caller
        self._executor = SingleThreadedExecutor(context=caller.context)
        self._executor.add_node(caller)
        self._random = random.Random(seed)
        self._services: dict[str, Any] = {}
        client.wait_for_node()
        client.publish("robot_description", TOPICS["robot_description"])
        client.wait_for_model()
        self._first_values = self._all_parameters()

    def send_garbage(self, n_messages: int) -> None:
        """Send damaged and random serialised messages to each topic in turn."""
        for topic, message in TOPICS.items():
            self._flood(topic, type(message), garbage(message, n_messages, self._random))
            if isinstance(message, MarkerArray):  # valid ones by chance may be in the way
                none = serialize_message(MarkerArray(markers=[Marker(action=Marker.DELETEALL)]))
                self._flood(topic, MarkerArray, [none] * 5)
            self.check(topic)
        self._set({"use_sim_time": True})
        clocks = garbage(Clock(), n_messages, self._random)
        # Of a negative time, rclpy itself raises an error.
        self._flood("/clock", Clock, [x for x in clocks if len(x) < 8 or x[7] < 0x80])
        self.check("/clock")

    def send_too_much(self) -> None:
        """Send messages of a hundred thousand names and points."""
        for message in MESSAGES_OF_MANY:
            topic = "goal" if isinstance(message, JointState) else "goal_sequence"
            assert not is_served(self._client.send(message, _PATIENCE).report)
            if isinstance(message, JointState):
                self._flood("joint_states", JointState, [serialize_message(message)] * 5)
            self.check(f"a large message to {topic}")

    def send_odd_states(self, n_bursts: int) -> None:
        """Send bursts of joint states as odd robots do: split, stamped by other clocks, silent."""
        for k in range(n_bursts):
            kind = ODD_STATES[k % len(ODD_STATES)]
            burst = [
                bytes(serialize_message(one)) for one in odd_states(kind, _STATE, self._random)
            ]
            self._flood("joint_states", JointState, burst)
            if self._random.random() < 0.2:
                time.sleep(self._random.uniform(0.3, 1.0))
            self.check(f"joint states: {kind}")

    def send_unknown_frames(self) -> None:
        """Send obstacles in frames that are unknown, odd, or known by a parameter."""
        for frame in ("map", "/world", "camera optical", "", "wrist", _LONG, "a\nb", "🤖"):
            marker = Marker(type=Marker.CUBE, scale=_MARKER.scale, pose=_MARKER.pose)
            marker.header.frame_id = frame
            clear = Marker(action=Marker.DELETEALL)
            for value in ([""], [f"{frame}: 9 9 9"]):
                self._set({"fixed_frames": value})
                marked = serialize_message(MarkerArray(markers=[marker]))
                self._flood("mp_pca_planner/obstacles", MarkerArray, [marked] * 3)
                self._client.send(self._next_goal(), _PATIENCE)
            none = serialize_message(MarkerArray(markers=[clear]))
            self._flood("mp_pca_planner/obstacles", MarkerArray, [none] * 3)
            self.check(f"an obstacle in the frame {frame!r:.40}")

    def set_odd_values(self, share: int = 1) -> None:
        """Set each parameter to every n-th odd value, with a different offset each time."""
        for k, name in enumerate(value.name for value in self._first_values):
            for value in ODD_VALUES[k % share :: share]:
                self._set({name: value})
                self.call_services()
                self.check(f"{name} = {value!r:.80}")
            print(f"{self.n_steps} steps after odd values of {name}", file=sys.stderr, flush=True)

    def call_services(self) -> None:
        """Call each service; its answer depends on the input before."""
        there = "mp_pca_planner"
        for name in ("stop", "save_motion", "reload_primitives"):
            self._call(Trigger, f"{there}/{name}", Trigger.Request())
        odd = ["", _LONG, "limits.", "limits..", "a\nb"]
        for kind, name in (
            (GetParameters, "get_parameters"),
            (DescribeParameters, "describe_parameters"),
        ):
            self._call(kind, f"{there}/{name}", kind.Request(names=odd))

    def check(self, what: str) -> None:
        """Reset the parameters and check that the next valid goal is served."""
        self.n_steps += 1
        client = self._client
        assert self._node.poll() is None, f"the node died of {what}"
        result = self._set_first_values()
        assert result.successful, f"after {what}: {result.reason}"
        client.publish("robot_description", TOPICS["robot_description"])
        deadline = time.monotonic() + _PATIENCE
        while True:
            # Messages on other topics may arrive between these two.
            client.publish("joint_states", _STATE)
            report = client.send(self._next_goal(), _PATIENCE).report
            if is_served(report):
                break
            assert time.monotonic() < deadline, f"after {what}: {report.message}"
        self.n_served += 1
        client.reports.clear()
        client.trajectories.clear()

    def _next_goal(self) -> JointState:
        """A new goal with its own stamp."""
        shift = [self._random.uniform(-1e-2, 1e-2) for _ in JOINT_NAMES]
        goal = JointState(name=JOINT_NAMES, position=(_END + shift).tolist())
        goal.header.stamp.sec = self._random.randrange(1, 2**31)
        return goal

    def _flood(self, topic: str, kind: Any, messages: Sequence[bytes] | Iterator[bytes]) -> None:
        qos = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        publisher = self._caller.create_publisher(kind, topic, qos)
        while not publisher.get_subscription_count():
            self._executor.spin_once(0.05)
        for message in messages:
            self.n_sent += 1
            # DDS rejects messages beyond the bound of their type.
            with suppress(RuntimeError):
                publisher.publish(message)
            # This rate is low enough that the node receives most of them.
            time.sleep(_PERIOD)
            self._client.spin_once(0.0)
        # What is not acknowledged yet would be lost; truncated messages never are.
        publisher.wait_for_all_acked(Duration(seconds=_ACKNOWLEDGED))
        self._caller.destroy_publisher(publisher)

    def _all_parameters(self) -> list[ParameterMessage]:
        names = self._call(
            ListParameters, "mp_pca_planner/list_parameters", ListParameters.Request()
        ).result.names
        # This parameter can't be set.
        names = [name for name in names if name != "start_type_description_service"]
        request = GetParameters.Request(names=names)
        values = self._call(GetParameters, "mp_pca_planner/get_parameters", request).values
        return [
            ParameterMessage(name=name, value=value)
            for name, value in zip(names, values, strict=True)
        ]

    def _set(self, values: dict[str, Any]) -> None:
        self.n_sent += len(values)
        parameters = [as_message(name, value) for name, value in values.items()]
        request = SetParameters.Request(parameters=parameters)
        self._call(SetParameters, "mp_pca_planner/set_parameters", request)

    def _set_first_values(self) -> Any:
        # Without primitives no limit parameters are declared.
        known = [value for value in self._first_values if not value.name.startswith("limits.")]
        for values in (known, self._first_values):
            result = self._call(
                SetParametersAtomically,
                "mp_pca_planner/set_parameters_atomically",
                SetParametersAtomically.Request(parameters=values),
            ).result
        return result

    def _call(self, kind: Any, name: str, request: Any) -> Any:
        if name not in self._services:
            self._services[name] = self._caller.create_client(kind, name)
        client = self._services[name]
        assert client.wait_for_service(_PATIENCE), f"{name} is not there"
        # The client may discover the service before the service discovers it; then the answer is
        # lost.
        for _ in range(3):
            future = client.call_async(request)
            deadline = time.monotonic() + _PATIENCE / 3.0
            # spin_until_future_complete adds a callback to the future with each message.
            while not future.done() and time.monotonic() < deadline:
                self._executor.spin_once(0.1)
            if future.done():
                return future.result()
        raise AssertionError(f"{name} did not answer to {request!s:.200}")


def as_message(name: str, value: object) -> ParameterMessage:
    """A parameter message as clients send it; an empty list gets an explicit type."""
    if value is None:
        unset = ParameterValue(type=ParameterType.PARAMETER_NOT_SET)
        return ParameterMessage(name=name, value=unset)
    if isinstance(value, bytes):
        octets = [bytes([octet]) for octet in value]
        return Parameter(name, Parameter.Type.BYTE_ARRAY, octets).to_parameter_msg()
    kind = Parameter.Type.STRING_ARRAY if value == [] else None
    return Parameter(name, kind, value).to_parameter_msg()


def garbage(message: Any, n: int, generator: random.Random) -> Iterator[bytes]:
    """Damaged and random serialised messages of a type."""
    good = bytes(serialize_message(message))
    for k in range(n):
        damaged = bytearray(good)
        if k % 4 == 0:
            del damaged[generator.randrange(len(good)) :]
        elif k % 4 == 1:
            for _ in range(generator.randrange(1, 6)):
                octet = generator.choice([0, 1, 127, 128, 255, generator.randrange(256)])
                damaged[generator.randrange(len(good))] = octet
        elif k % 4 == 2:
            damaged[4:] = generator.randbytes(generator.randrange(128))
        else:
            damaged = bytearray(generator.randbytes(generator.randrange(64)))
        yield bytes(damaged)


if __name__ == "__main__":
    sys.exit(main())
