# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""How long ``~/stop`` takes to answer while hostile input arrives.

A client in a process of its own calls the service again and again, in turn with a bare service of
rclpy in another process, and takes the time until it has the answer. Meanwhile, the node gets one
kind of input after the other: goals among obstacles, libraries of primitives, parameters, robot
descriptions, huge messages, and mesh files that are bombs. Printed are the median, the 99.5th
percentile and the longest time of both services for each kind. The goal is that no answer takes
20 ms longer than the longest one of the bare service, on a machine that does nothing else::

    python3 -m campaigns.stop_latency [--seconds 5] [--primitives 300]

The script exits with status 1 if an answer takes longer, or is missing.
"""

from __future__ import annotations

import argparse
import itertools
import os
import re
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from multiprocessing.connection import Connection
from pathlib import Path
from subprocess import Popen
from typing import Any

import numpy as np
from geometry_msgs.msg import Point
from rcl_interfaces.srv import SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import Trigger
from support.node_setup import PROCESSES, URDF, RobotClient, joint_states, silent_node, start_node
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint
from visualization_msgs.msg import Marker, MarkerArray

from mp_pca_planner.primitives.build import build_primitive
from mp_pca_planner.primitives.file import save_primitive
from mp_pca_planner.recordings.synthetic import JOINT_NAMES, generate_motions
from mp_pca_planner.ros.client import this_machine_only

MORE = 0.02
"""Time beyond the longest answer of the bare service that is accepted [s]."""

STOP, BARE = NAMES = ("mp_pca_planner/stop", "bare/service")
PAUSE = 0.01  # between two calls [s]
LOST = 5.0  # an answer that takes longer is lost [s]
TRIANGLES = 180_000  # of an accepted mesh
LINK_TRIANGLES = 10_000  # of each mesh of a link


def main() -> int:
    """Measure, print the results, and return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=5.0, help="time of each kind of input")
    parser.add_argument("--primitives", type=int, default=300, help="primitives that are reloaded")
    parser.add_argument("--only", default="", help="kinds whose names contain this")
    arguments = parser.parse_args()
    os.environ.update(this_machine_only())
    answers: list[dict[str, np.ndarray]] = []
    with (
        tempfile.TemporaryDirectory() as folder,
        hostile_node(Path(folder), arguments.primitives) as hostile,
    ):
        for name, attack in hostile.attacks():
            if arguments.only in name:
                answers.append(hostile.measure(attack, arguments.seconds))
                print(f"{name:34} " + "; ".join(texts(answers[-1])), flush=True)
    every = {name: np.concatenate([one[name] for one in answers]) for name in NAMES}
    print(f"{'all':34} " + "; ".join(texts(every)))
    return int(every[STOP].max() > every[BARE].max() + MORE)


def texts(times: dict[str, np.ndarray]) -> Iterator[str]:
    """Number, median, 99.5th percentile and longest time of each service."""
    for name, found in times.items():
        if len(found):
            median, high, most = 1e3 * np.quantile(found, [0.5, 0.995, 1.0])
            yield f"{name} {len(found)}: {median:.1f} / {high:.1f} / {most:.1f} ms"
        else:
            yield f"{name}: no answer"


class Hostile:
    """Sends hostile input to a node, while another process stops the robot."""

    def __init__(self, client: RobotClient, caller: Any, folder: Path, stops: StopClient) -> None:
        self._client, self._caller, self._folder, self._stops = client, caller, folder, stops
        self._numbers = itertools.count(1)
        self._executor = SingleThreadedExecutor(context=caller.context)
        self._executor.add_node(caller)
        there = "mp_pca_planner"
        self._set = caller.create_client(SetParameters, f"{there}/set_parameters")
        self._reload = caller.create_client(Trigger, f"{there}/reload_primitives")
        self._publishers = {
            name: caller.create_publisher(kind, name, 10)
            for kind, name in (
                (JointState, f"{there}/goal"),
                (JointTrajectory, f"{there}/goal_sequence"),
                (JointState, "joint_states"),
                (MarkerArray, f"{there}/obstacles"),
                (String, "robot_description"),
            )
        }
        self._markers = f"{there}/obstacles"

    def attacks(self) -> Iterator[tuple[str, Callable[[], None]]]:
        """Names of inputs, and functions that send them once."""
        yield "nothing", lambda: None
        yield "goals", self._send_goal
        yield "goals among obstacles", self._send_goal_among_obstacles
        yield "reload of many primitives", lambda: self._call(self._reload, Trigger.Request())
        yield "parameters", self._change_parameters
        yield "robot descriptions", self._describe
        yield "the longest robot description", self._describe_chain
        write_stl(self._folder / "link.stl", soup(LINK_TRIANGLES))
        self._set_parameter("collision", True)
        name = f"links with meshes of {LINK_TRIANGLES:,} triangles"
        yield name, self._describe_meshes
        for name, topic, message in self._large_messages():
            content = bytes(serialize_message(message))
            yield name, lambda topic=topic, content=content: self._publish(topic, content)
        for file in self._mesh_files():
            yield f"mesh {file.name}", lambda file=file: self._send_mesh(file)

    def measure(self, attack: Callable[[], None], seconds: float) -> dict[str, np.ndarray]:
        """Answer times of both services during an input that is sent again and again [s]."""
        # The input before may have been another robot.
        self._client.publish("robot_description", String(data=URDF.read_text("utf-8")))
        self._client.wait_for_model()
        self._stops.times()
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            attack()
            self._client.spin_once(0.05)
        # What is still being read or loaded counts, too.
        quiet = time.monotonic() + 2.0
        while time.monotonic() < quiet:
            self._client.spin_once(0.05)
        times = self._stops.times()
        none = MarkerArray(markers=[Marker(action=Marker.DELETEALL)])
        self._publish(self._markers, bytes(serialize_message(none)))
        return times

    def _publish(self, topic: str, content: bytes) -> None:
        self._publishers[topic].publish(content)

    def _call(self, client: Any, request: Any) -> None:
        future = client.call_async(request)
        deadline = time.monotonic() + 60.0
        while not future.done() and time.monotonic() < deadline:
            self._executor.spin_once(0.02)

    def _send_goal(self) -> None:
        end = generate_motions(1, seed=next(self._numbers))[0].positions[-1]
        self._client.publish_goal(JointState(name=JOINT_NAMES, position=end.tolist()))

    def _send_goal_among_obstacles(self) -> None:
        around = np.random.default_rng(1).uniform(-1.0, 1.0, (15, 3))
        around *= 0.9 / np.linalg.norm(around, axis=1)[:, None]
        boxes = [Marker(ns="b", id=k, type=Marker.CUBE) for k in range(len(around))]
        for box, (x, y, z) in zip(boxes, around.tolist(), strict=True):
            box.pose.position.x, box.pose.position.y, box.pose.position.z = x, y, z
            box.scale.x = box.scale.y = box.scale.z = 0.1
        self._publish(self._markers, bytes(serialize_message(MarkerArray(markers=boxes))))
        self._send_goal()

    def _change_parameters(self) -> None:
        k = next(self._numbers)
        self._set_parameter("naturalness", 0.5 + 0.1 * (k % 5))
        self._set_parameter("collision", bool(k % 2))

    def _set_parameter(self, name: str, value: float | bool) -> None:
        message = Parameter(name, value=value).to_parameter_msg()
        self._call(self._set, SetParameters.Request(parameters=[message]))

    def _describe(self) -> None:
        text = URDF.read_text("utf-8") + f"<!-- {next(self._numbers)} -->"
        self._client.publish("robot_description", String(data=text))

    def _describe_meshes(self) -> None:
        scale = f"0.001 0.001 {1e-3 + 1e-6 * next(self._numbers)}"  # none is known already
        mesh = f'<mesh filename="{self._folder}/link.stl" scale="{scale}"/>'
        text = URDF.read_text("utf-8")
        for name in ("elbow", "shoulder"):
            before, mark, after = text.partition(f'<collision name="{name}">')
            after = re.sub(r"<sphere [^>]*>", mesh, after, count=1)
            text = before + mark + after
        self._client.publish("robot_description", String(data=text))

    def _describe_chain(self) -> None:
        links = "".join(
            f'<link name="l{k}"/><joint name="j{k}" type="{"revolute" if k < 190 else "fixed"}">'
            f'<parent link="l{k}"/><child link="l{k + 1}"/><limit effort="1" velocity="1"/></joint>'
            for k in range(490)
        )
        text = f'<robot name="chain{next(self._numbers)}">{links}<link name="l490"/></robot>'
        self._client.publish("robot_description", String(data=text))

    def _large_messages(self) -> Iterator[tuple[str, str, Any]]:
        there, n = "mp_pca_planner", 100_000
        many = JointState(name=["joint"] * n, position=[0.0] * n)
        yield "goals of 100,000 names", f"{there}/goal", many
        some = JointState(name=["joint"] * 3_000, position=[0.0] * 3_000)
        yield "joint states of 3,000 names", "joint_states", some
        point = JointTrajectoryPoint(positions=[0.0] * len(JOINT_NAMES))
        sequence = JointTrajectory(joint_names=JOINT_NAMES, points=[point] * n)
        yield "sequences of 100,000 points", f"{there}/goal_sequence", sequence
        boxes = MarkerArray(markers=[Marker(ns="m", id=k, type=Marker.CUBE) for k in range(5000)])
        yield "5,000 markers", self._markers, boxes
        one = Marker(ns="t", type=Marker.TRIANGLE_LIST)
        one.scale.x = one.scale.y = one.scale.z = 1.0
        one.pose.position.x = 3.0
        one.points = points_of(soup(TRIANGLES))
        yield f"a marker of {TRIANGLES:,} triangles", self._markers, MarkerArray(markers=[one])

    def _mesh_files(self) -> Iterator[Path]:
        for name, n in (("accepted.stl", TRIANGLES), ("million.stl", 1_000_000)):
            write_stl(self._folder / name, soup(n))
            yield self._folder / name
        flat = soup(2)
        flat[..., 2] = 0.0
        write_stl(self._folder / "flat.stl", flat)
        yield self._folder / "flat.stl"
        for name, text in BOMBS.items():
            (self._folder / name).write_text(text, encoding="utf-8")
            yield self._folder / name

    def _send_mesh(self, file: Path) -> None:
        one = Marker(ns="mesh", type=Marker.MESH_RESOURCE, mesh_resource=f"file://{file}")
        one.scale.x = one.scale.y = one.scale.z = 1.0
        one.pose.position.x = 3.0
        self._publish(self._markers, bytes(serialize_message(MarkerArray(markers=[one]))))
        deadline = time.monotonic() + 1.0
        while time.monotonic() < deadline:
            self._client.spin_once(0.05)


@contextmanager
def hostile_node(folder: Path, n_primitives: int) -> Iterator[Hostile]:
    """A node with many primitives, states of its robot, and a process that stops it."""
    library = primitive_folder(folder, n_primitives)
    q = generate_motions(1, seed=2)[0].positions[0].tolist()
    with (
        (folder / "log.txt").open("w") as log,
        RobotClient() as client,
        silent_node("hostile") as caller,
        running(start_node("-p", f"primitives:=['{library}']", output=log)),
        joint_states(250.0, q),
        StopClient() as stops,
    ):
        client.wait_for_node(120.0)
        client.publish("robot_description", String(data=URDF.read_text("utf-8")))
        client.wait_for_model()
        yield Hostile(client, caller, folder, stops)


def primitive_folder(folder: Path, n: int) -> Path:
    """A folder of primitives that differ in their names."""
    library = folder / "primitives"
    library.mkdir()
    primitive = build_primitive(generate_motions(20, seed=1), "raise_arm")
    for k in range(n):
        save_primitive(replace(primitive, name=f"raise_arm_{k}"), library / f"{k:04}.npz")
    return library


@contextmanager
def running(node: Popen[str]) -> Iterator[None]:
    """Context manager that ends a node."""
    try:
        yield
    finally:
        node.terminate()
        node.wait(timeout=60.0)


class StopClient:
    """A process that stops the robot again and again, and times the answers."""

    def __init__(self) -> None:
        self._here, there = PROCESSES.Pipe(duplex=False)
        self._process = PROCESSES.Process(target=_stop_again_and_again, args=[there], daemon=True)
        self._bare = PROCESSES.Process(target=_serve, daemon=True)

    def __enter__(self) -> StopClient:
        self._bare.start()
        self._process.start()
        self._here.poll(120.0)  # it has got its first answer
        return self

    def __exit__(self, *_: object) -> None:
        for process in (self._process, self._bare):
            process.kill()
            process.join()

    def times(self) -> dict[str, np.ndarray]:
        """Answer times of both services since the last call [s]; `LOST` without an answer."""
        found: dict[str, list[float]] = {name: [] for name in NAMES}
        while self._here.poll():
            name, seconds = self._here.recv()
            found[name].append(seconds)
        return {name: np.array(times) for name, times in found.items()}


def _serve() -> None:
    """A service that does nothing else."""
    with silent_node("bare") as node:
        node.create_service(Trigger, BARE, lambda _, response: response)
        executor = SingleThreadedExecutor(context=node.context)
        executor.add_node(node)
        executor.spin()


def _stop_again_and_again(times: Connection) -> None:
    """Call both services in turn and take the answers as they arrive.

    An executor of rclpy would add up to 80 ms of its own.
    """
    with silent_node("operator") as node:
        clients = {name: node.create_client(Trigger, name) for name in NAMES}
        for client in clients.values():
            client.wait_for_service(120.0)
        time.sleep(1.0)  # the services discover the client, too
        while True:
            for name, client in clients.items():
                began = time.monotonic()
                client.call_async(Trigger.Request())
                while not has_answer(client) and time.monotonic() - began < LOST:
                    time.sleep(0.0005)
                times.send((name, time.monotonic() - began))
                time.sleep(PAUSE)


def has_answer(client: Any) -> bool:
    """Whether an answer of the service has arrived, which is taken."""
    with client.handle:
        header, _ = client.handle.take_response(Trigger.Response)
    return header is not None


def soup(n: int) -> np.ndarray:
    """Triangles of a wavy surface, shape (n, 3, 3) [m]."""
    random = np.random.default_rng(1)
    corners = random.uniform(-0.5, 0.5, (n, 1, 3)) + random.uniform(-0.01, 0.01, (n, 3, 3))
    corners[..., 2] = 0.1 * np.sin(9.0 * corners[..., 0]) * np.cos(7.0 * corners[..., 1])
    return corners


def points_of(triangles: np.ndarray) -> list[Point]:
    """The corners as messages."""
    return [Point(x=x, y=y, z=z) for x, y, z in triangles.reshape(-1, 3).tolist()]


def write_stl(file: Path, triangles: np.ndarray) -> None:
    """Write a binary STL file."""
    kind = [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")]
    facets = np.zeros(len(triangles), dtype=kind)
    facets["corners"] = triangles
    file.write_bytes(bytes(80) + len(triangles).to_bytes(4, "little") + facets.tobytes())


_ENTITIES = "".join(
    f'<!ENTITY e{k} "{f"&e{k - 1};" * 10 if k else "lol lol lol"}">' for k in range(10)
)
_CYCLE = (
    '<library_nodes><node id="a"><instance_node url="#b"/></node>'
    '<node id="b"><instance_node url="#a"/></node></library_nodes><library_visual_scenes>'
    '<visual_scene id="s"><node><instance_node url="#a"/></node></visual_scene>'
    '</library_visual_scenes><scene><instance_visual_scene url="#s"/></scene>'
)
_COLLADA = '<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">'
_DEEP = "<node>" * 20_000 + "</node>" * 20_000
BOMBS = {
    "entities.dae": f"<!DOCTYPE x [{_ENTITIES}]>{_COLLADA}<asset>&e9;</asset></COLLADA>",
    "cycle.dae": f"{_COLLADA}{_CYCLE}</COLLADA>",
    "deep.dae": f"{_COLLADA}<library_nodes>{_DEEP}</library_nodes></COLLADA>",
    "indices.obj": "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 999999999\n" * 1000,
}
"""Mesh files that take a reader's time or memory."""


if __name__ == "__main__":
    sys.exit(main())
