# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""How long ``~/stop`` takes to answer while hostile input arrives.

A client in a process of its own calls the service again and again, in turn with a bare service of
rclpy in another process, and takes the time until it has the answer. Meanwhile, the node gets one
kind of input after the other: goals among obstacles, libraries of primitives, parameters, robot
descriptions, huge messages, and mesh files that are bombs. Printed are the median, the 99.5th
percentile and the longest time of both services for each kind. The goal is that no answer takes
20 ms longer than the longest one of the bare service, on a machine that does nothing else::

    python3 -m campaigns.stop_latency [--seconds 5] [--primitives 300] [--only goals]

The script exits with status 1 if an answer takes longer, or is missing.
"""

from __future__ import annotations

import itertools
import os
import re
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from multiprocessing.connection import Connection
from multiprocessing.synchronize import Event
from pathlib import Path
from typing import Any

import numpy as np
from geometry_msgs.msg import Point
from rclpy.executors import SingleThreadedExecutor
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from support.arm import JOINTS, URDF
from support.hostile_meshes import soup, write_bombs, write_stl
from support.nodes import (
    GOAL,
    PROCESSES,
    START,
    NodeClient,
    arm_node,
    described_client,
    goal_message,
    other_process,
    publish_states,
    ros_node,
)
from support.tables import options
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint
from visualization_msgs.msg import Marker, MarkerArray

from mp_pca_planner.ros.client import NoAnswerError, this_machine_only

MORE = 0.02
"""Time beyond the longest answer of the bare service that is accepted [s]."""

STOP, BARE = NAMES = ("mp_pca_planner/stop", "bare/service")
PAUSE = 0.01  # between two calls [s]
LOST = 5.0  # an answer that takes longer is lost [s]
TRIANGLES = 180_000  # of an accepted mesh
LINK_TRIANGLES = 10_000  # of each mesh of a link

Attack = Callable[[], Any]
Times = dict[str, np.ndarray]


def main() -> int:
    """Run the attacks, print the results, and return the exit status."""
    arguments = options(__doc__, seconds=5.0, primitives=300, only="")
    os.environ.update(this_machine_only())
    here, there = PROCESSES.Pipe(duplex=False)
    answers: list[Times] = []
    with (
        arm_node(n_primitives=arguments.primitives, may_trace=True) as (_, folder),
        described_client() as client,
        other_process(publish_states, 250.0, START),
        other_process(_serve),
        other_process(_stop_again_and_again, there),
    ):
        for name, attack in attacks(client, folder):
            if arguments.only in name:
                answers.append(measure(client, attack, arguments.seconds, here))
                print(f"{name:34} " + "; ".join(texts(answers[-1])), flush=True)
    every = {name: np.concatenate([one[name] for one in answers]) for name in NAMES}
    print(f"{'all':34} " + "; ".join(texts(every)))
    return int(every[STOP].max() > every[BARE].max() + MORE)


def texts(times: Times) -> Iterator[str]:
    """Number, median, 99.5th percentile and longest time of each service."""
    for name, found in times.items():
        figures = [f"{1e3 * x:.1f}" for x in np.quantile(found, [0.5, 0.995, 1.0])]
        yield f"{name} {len(found)}: {' / '.join(figures)} ms"


def measure(client: NodeClient, attack: Attack, seconds: float, answers: Connection) -> Times:
    """Answer times of both services during an input that is sent again and again [s].

    They are `LOST` without an answer.
    """
    # The input before may have been another robot, and obstacles.
    client.publish_markers(Marker(action=Marker.DELETEALL))
    client.publish_description(URDF)
    client.wait_for_model()
    while answers.poll():
        answers.recv()
    end = time.monotonic() + seconds
    while time.monotonic() < end + 2.0:  # what is still being read or loaded counts, too
        if time.monotonic() < end:
            attack()
        client.spin_once(0.05)
    found: dict[str, list[float]] = {name: [] for name in NAMES}
    while answers.poll():
        name, took = answers.recv()
        found[name].append(took)
    return {name: np.array(times or [LOST]) for name, times in found.items()}


def attacks(client: NodeClient, folder: Path) -> Iterator[tuple[str, Attack]]:
    """Names of inputs, and functions that send them once."""
    numbers, describe = itertools.count(1), client.publish_description

    def set_parameters(**values: object) -> None:
        with suppress(NoAnswerError):
            client.try_to_set(values)

    def send_goal() -> None:
        client.publish_goal(goal_message(np.array(GOAL) + 1e-3 * (next(numbers) % 50)))

    around = np.random.default_rng(1).uniform(-1.0, 1.0, (15, 3))
    around *= 0.9 / np.linalg.norm(around, axis=1)[:, None]
    boxes = [_marker("b", k, Marker.CUBE, x, 0.1) for k, x in enumerate(around)]
    chain = "".join(
        f'<link name="l{k}"/><joint name="j{k}" type="{"revolute" if k < 190 else "fixed"}">'
        f'<parent link="l{k}"/><child link="l{k + 1}"/><limit effort="1" velocity="1"/></joint>'
        for k in range(490)
    )

    def describe_meshes() -> None:
        scale = f"0.001 0.001 {1e-3 + 1e-6 * next(numbers)}"  # none is known already
        mesh = f'<mesh filename="{folder}/link.stl" scale="{scale}"/>'
        text = URDF
        for name in ("elbow", "shoulder"):
            before, mark, after = text.partition(f'<collision name="{name}">')
            text = before + mark + re.sub(r"<sphere [^>]*>", mesh, after, count=1)
        describe(text)

    yield "nothing", lambda: None
    yield "goals", send_goal
    yield "goals among obstacles", lambda: (client.publish_markers(*boxes), send_goal())
    yield "reload of many primitives", lambda: client.call("reload_primitives", 60.0)
    yield (
        "parameters",
        lambda: set_parameters(
            naturalness=0.5 + 0.1 * (next(numbers) % 5), collision=bool(next(numbers) % 2)
        ),
    )
    yield "robot descriptions", lambda: describe(f"{URDF}<!-- {next(numbers)} -->")
    yield (
        "the longest robot description",
        lambda: describe(f'<robot name="chain{next(numbers)}">{chain}<link name="l490"/></robot>'),
    )
    write_stl(folder / "link.stl", soup(LINK_TRIANGLES))
    set_parameters(collision=True)
    yield f"links with meshes of {LINK_TRIANGLES:,} triangles", describe_meshes
    for name, topic, message in _large_messages():
        content = bytes(serialize_message(message))
        yield name, lambda topic=topic, content=content: client.publish(topic, content)
    flat = soup(2)
    flat[..., 2] = 0.0
    for name, triangles in (
        ("accepted", soup(TRIANGLES)),
        ("million", soup(1_000_000)),
        ("flat", flat),
    ):
        write_stl(folder / f"{name}.stl", triangles)
    for file in (*sorted(folder.glob("*.stl")), *write_bombs(folder)):
        marker = _marker("mesh", 0, Marker.MESH_RESOURCE, (3.0, 0.0, 0.0), 1.0)
        marker.mesh_resource = f"file://{file}"
        yield (
            f"mesh {file.name}",
            lambda one=marker: (client.publish_markers(one), time.sleep(0.5)),
        )


def _marker(space: str, number: int, kind: int, place: Any, size: float) -> Marker:
    one = Marker(ns=space, id=number, type=kind)
    one.pose.position = Point(**dict(zip("xyz", map(float, place), strict=True)))
    one.scale.x = one.scale.y = one.scale.z = size
    return one


def _large_messages() -> Iterator[tuple[str, str, Any]]:
    n = 100_000
    yield "goals of 100,000 names", "goal", JointState(name=["joint"] * n, position=[0.0] * n)
    some = JointState(name=["joint"] * 3_000, position=[0.0] * 3_000)
    yield "joint states of 3,000 names", "joint_states", some
    point = JointTrajectoryPoint(positions=[0.0] * len(JOINTS))
    sequence = JointTrajectory(joint_names=JOINTS, points=[point] * n)
    yield "sequences of 100,000 points", "goal_sequence", sequence
    boxes = [_marker("m", k, Marker.CUBE, (0, 0, 0), 0.0) for k in range(5000)]
    yield "5,000 markers", "obstacles", MarkerArray(markers=boxes)
    one = _marker("t", 0, Marker.TRIANGLE_LIST, (3.0, 0.0, 0.0), 1.0)
    one.points = [Point(x=x, y=y, z=z) for x, y, z in soup(TRIANGLES).reshape(-1, 3).tolist()]
    yield f"a marker of {TRIANGLES:,} triangles", "obstacles", MarkerArray(markers=[one])


def _serve(is_ready: Event) -> None:
    """A service that does nothing else."""
    with ros_node("bare") as node:
        node.create_service(Trigger, BARE, lambda _, response: response)
        executor = SingleThreadedExecutor(context=node.context)
        executor.add_node(node)
        is_ready.set()
        executor.spin()


def _stop_again_and_again(times: Connection, is_ready: Event) -> None:
    """Call both services in turn and take the answers as they arrive.

    An executor of rclpy would add up to 80 ms of its own.
    """
    with ros_node("operator") as node:
        clients = {name: node.create_client(Trigger, name) for name in NAMES}
        for client in clients.values():
            client.wait_for_service(120.0)
        time.sleep(1.0)  # the services discover the client, too
        is_ready.set()
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


if __name__ == "__main__":
    sys.exit(main())
