# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Fuzz test of the node: random messages on every topic, odd values for every parameter.

Run it as ``python3 -m campaigns.node_fuzz``. After each step, the services are called, the
parameters are reset, and a valid goal must be served. The script exits with status 1 if the node
dies, does not answer, or reports an internal error. `test/ros/test_node_fuzz.py` runs a short
version; `stop_latency` measures how soon ``~/stop`` answers during the inputs that take long.
"""

from __future__ import annotations

import os
import random
import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import suppress
from subprocess import Popen
from typing import Any

import numpy as np
from campaigns.fuzz_files import spoilt_bytes
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
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import Trigger
from support.arm import URDF
from support.nodes import NodeClient, arm_node, described_client
from support.tables import options
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint
from visualization_msgs.msg import Marker, MarkerArray

from mp_pca_planner.files import config_file
from mp_pca_planner.recordings.synthetic import JOINT_NAMES, generate_motions
from mp_pca_planner.ros.client import NoAnswerError, is_served, this_machine_only

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
    "robot_description": String(data=URDF),
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
    *("<robot/>", _CHAIN, str(config_file("human_arm.urdf")), URDF),
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


ODD_STATES = ("nan velocities", "inf", "lengths", "split", "subsets", "clocks", "others", "nan")
"""Kinds of joint states of odd robots."""


def main() -> int:
    """Run the fuzz test and print the results."""
    arguments = options(__doc__, messages=2000, share=1)
    os.environ.update(this_machine_only())
    given = {"save_folder": "'{folder}'", "state_timeout": 3600.0}
    with (
        arm_node(**given, may_trace=True) as (node, folder),
        described_client() as client,
    ):
        fuzzer = Fuzzer(node, client)
        fuzzer.check("the start")
        fuzzer.send_garbage(arguments.messages)
        fuzzer.send_too_much()
        fuzzer.send_odd_states(arguments.messages // 10)
        fuzzer.send_unknown_frames()
        fuzzer.set_odd_values(arguments.share)
        lines = (folder / "log.txt").read_text(errors="replace").splitlines()
    found = {line[line.index("internal") :]: k for k, line in enumerate(lines) if _DEFECT in line}
    print(
        f"{fuzzer.n_steps} steps with {fuzzer.n_sent} messages and values, {fuzzer.n_served} good "
        f"goals served in between; the node logged {len(found)} kinds of internal errors"
    )
    for text, k in found.items():
        print(f"{text}, after:", *lines[max(k - _N_BEFORE, 0) : k], sep="\n")
    return int(bool(found))


class Fuzzer:
    """Sends invalid input to the node, and checks that it continues to serve goals.

    Parameters
    ----------
    node :
        The process of the node.
    client :
        A client of the node, which has a model.
    seed : int
        Seed of the random input.
    """

    def __init__(self, node: Popen[str], client: NodeClient, seed: int = 1) -> None:
        self.n_steps = self.n_served = self.n_sent = 0
        self._node, self._client, self._random = node, client, random.Random(seed)
        self._services: dict[str, Any] = {}
        self._first_values = self._all_parameters()

    def send_garbage(self, n_messages: int) -> None:
        """Send damaged and random serialised messages to each topic in turn."""
        for topic, message in TOPICS.items():
            self._flood(topic, type(message), garbage(message, n_messages, self.n_steps))
            if isinstance(message, MarkerArray):  # valid ones by chance may be in the way
                none = serialize_message(MarkerArray(markers=[Marker(action=Marker.DELETEALL)]))
                self._flood(topic, MarkerArray, [none] * 5)
            self.check(topic)
        self._set({"use_sim_time": True})
        clocks = garbage(Clock(), n_messages, self.n_steps)
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
        for name in ("stop", "save_motion", "reload_primitives"):
            self._call(Trigger, name)
        odd = ["", _LONG, "limits.", "limits..", "a\nb"]
        self._call(GetParameters, "get_parameters", names=odd)
        self._call(DescribeParameters, "describe_parameters", names=odd)

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

    def _flood(self, topic: str, kind: Any, messages: Iterable[bytes]) -> None:
        qos = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        publisher = self._client.node.create_publisher(kind, topic, qos)
        while not publisher.get_subscription_count():
            self._client.spin_once()
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
        self._client.node.destroy_publisher(publisher)

    def _all_parameters(self) -> list[ParameterMessage]:
        names = self._call(ListParameters, "list_parameters").result.names
        # This parameter can't be set.
        names = [name for name in names if name != "start_type_description_service"]
        values = self._call(GetParameters, "get_parameters", names=names).values
        pairs = zip(names, values, strict=True)
        return [ParameterMessage(name=name, value=value) for name, value in pairs]

    def _set(self, values: dict[str, Any]) -> None:
        self.n_sent += len(values)
        parameters = [as_message(name, value) for name, value in values.items()]
        self._call(SetParameters, "set_parameters", parameters=parameters)

    def _set_first_values(self) -> Any:
        # Without primitives no limit parameters are declared.
        known = [value for value in self._first_values if not value.name.startswith("limits.")]
        for values in (known, self._first_values):
            name = "set_parameters_atomically"
            result = self._call(SetParametersAtomically, name, parameters=values).result
        return result

    def _call(self, kind: Any, name: str, **request: Any) -> Any:
        if name not in self._services:
            there = f"{self._client.planner}/{name}"
            self._services[name] = self._client.node.create_client(kind, there)
        client = self._services[name]
        assert client.wait_for_service(_PATIENCE), f"{name} is not there"
        # The client may discover the service before the service discovers it; then the answer is
        # lost.
        for _ in range(3):
            with suppress(NoAnswerError):
                return self._client.result(client, kind.Request(**request), _PATIENCE / 3.0)
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


def garbage(message: Any, n: int, seed: int) -> Iterator[bytes]:
    """Damaged serialised messages of a type."""
    good, generator = bytes(serialize_message(message)), np.random.default_rng(seed)
    return (spoilt_bytes(good, generator) for _ in range(n))


def odd_states(kind: str, state: JointState, generator: random.Random) -> Iterator[JointState]:
    """Thirty joint states of a robot at rest; some kinds can't be used."""
    names, q, now = list(state.name), state.position.tolist(), time.time()
    for k in range(30):
        message = JointState(name=names, position=q, velocity=[0.0] * len(q))
        if kind == "nan velocities":
            message.velocity = [generator.choice([0.0, float("nan")]) for _ in q]
        elif kind == "inf":
            message.velocity = [generator.choice([0.0, float("inf")]) for _ in q]
        elif kind == "lengths":
            message.velocity = [0.0] * generator.randrange(8)
            message.position = q[: generator.randrange(len(q) + 1)]
        elif kind in ("split", "subsets"):
            half = set(names[k % 2 :: 2])
            chosen = half if kind == "split" else set(generator.sample(names, k % 5))
            message.name = [name for name in names if name in chosen]
            message.position = [x for name, x in zip(names, q, strict=True) if name in chosen]
            message.velocity = []
        elif kind == "clocks":
            stamp = generator.choice(
                [now, now - 3.0, now + 1e3, 1.0, 2e9, generator.random() * 2e9]
            )
            message.header.stamp.sec = int(stamp)
            message.header.stamp.nanosec = int(stamp % 1.0 * 1e9)
        elif kind == "others":
            message.name = [*names, *(f"finger {k} {j}" for j in range(100))]
            message.position = [*q, *[float("nan")] * 100]
            message.velocity = []
        elif kind == "nan":
            message.position = [generator.choice([x, float("nan")]) for x in q]
        yield message


if __name__ == "__main__":
    sys.exit(main())
