# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Hostile meshes through every way into the planner.

    python3 benchmarks/hostile_meshes.py [--only NAME] [--flips 300]

Each mesh of `mesh_inputs`, and a marker with flipped bytes, is used as an obstacle in Python, in a
planning scene, as a marker, as the collision shape of a link, and in the page. A process of its own
does all of that for one mesh. It may use or reject the mesh with one sentence. The script exits
with 1 if one ends, raises another error, stays longer than a minute, computes for more than 5 s, or
takes more than 500 MB, all ways and the start of Python together.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from mesh_inputs import FILES, FLOOR, SOUPS

import mp_pca_planner as mp
from mp_pca_planner.exceptions import PlannerError
from mp_pca_planner.files import config_file
from mp_pca_planner.motion.collision import CollisionModel

CPU_SECONDS, MEMORY, WALL_SECONDS = 5.0, 500e6, 60.0
URDF = config_file("human_arm.urdf").read_text(encoding="utf-8")
TOOL = (
    '<link name="tool"><{tag}><geometry><mesh filename="{file}"/></geometry></{tag}></link>'
    '<joint name="flange" type="fixed"><parent link="wrist"/><child link="tool"/></joint></robot>'
)


def use(world: mp.World, urdf: str = URDF) -> None:
    """Check configurations and a motion in a world."""
    robot = mp.Robot(urdf)
    model = CollisionModel(robot, world=world, margin=0.01)
    q = np.random.default_rng(0).uniform(-1.0, 1.0, (20, robot.n_joints))
    found = model.near(q, 10.0)
    assert np.isfinite(found.distances).all()
    assert np.isfinite(found.rows).all()
    for one in q:
        model.collides(one)
    model.check(np.full(len(model.pairs), 0.1), hulls=True)(q[0])
    still = np.zeros((2, robot.n_joints))
    model.collisions(mp.Trajectory(robot.joint_names, [0.0, 0.1], q[[0, 0]], still, still))


def world_of(shape: mp.Mesh) -> mp.World:
    """A world with the mesh, and one with it on a link."""
    floor = mp.Obstacle("plane", mp.Mesh(*FLOOR, (0.0, 0.0, -2.0)))
    return mp.World([mp.Obstacle("mesh", shape), mp.Obstacle("held", shape, "wrist"), floor])


def ways_of_file(path: Path) -> Iterator[tuple[str, Callable[[], None]]]:
    """The ways in of a file."""
    yield "python", lambda: use(world_of(mp.Mesh.from_file(path)))
    for tag, act in (("collision", use_link), ("visual", show)):
        urdf = URDF.replace("</robot>", TOOL.format(tag=tag, file=path))
        yield tag, lambda urdf=urdf, act=act: act(urdf)  # type: ignore[misc]
    yield "marker", lambda: use(mp.World([marked(mesh_resource=f"file://{path}", type=10)]))


def ways_of_soup(vertices: Any, triangles: Any, folder: Path) -> Iterator[tuple[str, Any]]:
    """The ways in of vertices and triangles."""
    yield "python", lambda: use(world_of(mp.Mesh(vertices, triangles)))
    yield "scene", lambda: use(mp.World.from_file(scene_file(vertices, triangles, folder)))

    def as_marker(*scale: float) -> None:
        from geometry_msgs.msg import Point, Vector3

        corners = np.asarray(vertices)[np.ravel(triangles)]  # of wrong indices there are none
        points = [Point(x=x, y=y, z=z) for x, y, z in corners.tolist()]
        size = Vector3(**dict(zip("xyz", scale, strict=True)))
        use(mp.World([marked(type=11, points=points, scale=size)]))

    n = len(vertices)
    if np.size(triangles) and 0 <= np.min(triangles) <= np.max(triangles) < n:
        yield "marker", lambda: as_marker(1.0, 1.0, 1.0)
        yield "marker without a scale", lambda: as_marker(0.0, 0.0, 0.0)
        yield "flat marker", lambda: as_marker(1.0, 1.0, 0.0)


def use_link(urdf: str) -> None:
    """Check collisions of a robot with a mesh."""
    use(mp.World([mp.Obstacle("ball", mp.Sphere(0.1, (0.5, 0.0, 0.0)))]), urdf)


def show(urdf: str) -> None:
    """Make the shapes of the page."""
    from mp_pca_planner.view.robot_shapes import RobotShapes

    shapes = RobotShapes(mp.Robot(urdf), urdf, ())
    assert all(np.isfinite(one.hull.bounds).all() for one in shapes.shapes)
    if shapes.notes:
        raise PlannerError(shapes.notes[0])


def marked(**fields: Any) -> mp.Obstacle:
    """The obstacle of a marker."""
    from geometry_msgs.msg import Vector3
    from rclpy.serialization import serialize_message
    from visualization_msgs.msg import Marker, MarkerArray

    from mp_pca_planner.ros.obstacle_markers import to_obstacle
    from mp_pca_planner.ros.serialised import read_markers

    marker = Marker(**{"scale": Vector3(x=1.0, y=1.0, z=1.0), **fields})
    marker.pose.orientation.w = 1.0
    (read,) = read_markers(bytes(serialize_message(MarkerArray(markers=[marker]))))
    return to_obstacle(read)


def flipped(number: int) -> None:
    """Use a valid marker of triangles with some flipped bytes."""
    from geometry_msgs.msg import Point, Vector3
    from rclpy.serialization import serialize_message
    from visualization_msgs.msg import Marker, MarkerArray

    from mp_pca_planner.ros.obstacle_markers import to_obstacle
    from mp_pca_planner.ros.serialised import read_markers

    random = np.random.default_rng([28, number])
    corners = random.uniform(-1.0, 1.0, (12, 3)) * (1.0, 1.0, random.integers(0, 2))
    points = [Point(x=x, y=y, z=z) for x, y, z in corners.tolist()]
    marker = Marker(type=11, points=points, scale=Vector3(x=1.0, y=1.0, z=1.0))
    marker.pose.orientation.w = 1.0
    content = bytearray(serialize_message(MarkerArray(markers=[marker])))
    for at in random.integers(4, len(content), random.integers(1, 6)).tolist():
        content[at] = int(random.choice([0, 1, 127, 255, random.integers(0, 256)]))
    world = mp.World([to_obstacle(one) for one in read_markers(bytes(content))])
    use(mp.World([mp.Obstacle(one.name, one.shapes) for one in world]))


def scene_file(vertices: Any, triangles: Any, folder: Path) -> Path:
    """A planning scene with a mesh."""
    numbers = json.dumps(np.asarray(vertices).tolist())
    numbers = (
        numbers.replace("NaN", ".nan").replace("-Infinity", "-.inf").replace("Infinity", ".inf")
    )
    path = folder / "scene.yaml"
    path.write_text(
        "world: {collision_objects: [{id: a, meshes: [{vertices: "
        f"{numbers}, triangles: {json.dumps(np.asarray(triangles).tolist())}}}]}}]}}"
    )
    return path


def judge(ways: Iterator[tuple[str, Callable[[], None]]]) -> dict[str, str]:
    """How each way ended: used, rejected with a sentence, or raised."""
    ends = {}
    for name, act in ways:
        try:
            act()
            ends[name] = "used"
        except PlannerError as error:
            text = str(error)
            ends[name] = f"rejected: {text}" if text.isprintable() else f"raised {text!r}"
        except BaseException as error:
            ends[name] = f"raised {error!r}"
    return ends


def run_one(name: str, folder: Path) -> None:
    """Use one mesh in this process; print how each way ended, and the longest wait of a thread."""
    gap, ready = [0.0], threading.Event()

    def tick() -> None:
        last = time.perf_counter()
        while not ready.wait(1e-3):
            now = time.perf_counter()
            gap[0], last = max(gap[0], now - last), now

    judge(ways_of_soup(*FLOOR, folder))  # imports
    ticker = threading.Thread(target=tick)
    ticker.start()
    if name.startswith("flips "):
        first, last = map(int, name.split()[1:])
        ends = judge((f"{k}", lambda k=k: flipped(k)) for k in range(first, last))  # type: ignore[misc]
    elif name in SOUPS:
        ends = judge(ways_of_soup(*SOUPS[name], folder))
    else:
        path = folder / name
        FILES[name](path)
        ends = judge(ways_of_file(path))
    ready.set()
    ticker.join()
    print(json.dumps({"ends": ends, "gap": gap[0]}))


def main() -> int:
    """Run all meshes; print those with problems, and a summary."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", help="use this mesh alone, in this process")
    parser.add_argument("--flips", type=int, default=300, help="markers with flipped bytes")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        if arguments.only:
            run_one(arguments.only, Path(folder))
            return 0
        flips = [f"flips {k} {k + 100}" for k in range(0, arguments.flips, 100)]
        names, bad, worst, n_uses = [*FILES, *SOUPS, *flips], 0, np.zeros(4), 0
        ends: dict[str, int] = {"used": 0, "rejected": 0}
        for name in names:
            problems, figures, found = _measured(name)
            worst = np.maximum(worst, figures)
            n_uses += len(found)
            for end in found.values():
                kind = end.split(":")[0]
                ends[kind] = ends.get(kind, 0) + 1
            bad += bool(problems)
            for problem in problems:
                print(f"{name}: {problem}", file=sys.stderr, flush=True)
    print(
        json.dumps(
            {
                "meshes": len(FILES) + len(SOUPS),
                "flipped_markers": arguments.flips,
                "uses": n_uses,
                **{k: v for k, v in ends.items() if k in ("used", "rejected")},
                "with_problems": bad,
                "cpu_s": round(float(worst[0]), 2),
                "memory_mb": round(float(worst[1]) / 1e6),
                "wall_s": round(float(worst[2]), 1),
                "longest_wait_of_a_thread_s": round(float(worst[3]), 3),
            }
        )
    )
    return int(bad > 0)


def _measured(name: str) -> tuple[list[str], Any, dict[str, str]]:
    """Problems of one mesh, its CPU time, memory, wall time and longest gap, and its ends."""
    began = time.monotonic()
    command = [sys.executable, __file__, "--only", name]
    with tempfile.TemporaryFile("w+") as output, tempfile.TemporaryFile("w+") as errors:
        process = subprocess.Popen(command, stdout=output, stderr=errors, stdin=subprocess.PIPE)
        watchdog = threading.Timer(WALL_SECONDS, process.kill)
        watchdog.start()
        _, status, used = os.wait4(process.pid, 0)
        watchdog.cancel()
        process.returncode = os.waitstatus_to_exitcode(status)
        output.seek(0)
        errors.seek(0)
        text, trace = output.read(), errors.read()
    wall, cpu, memory = (
        time.monotonic() - began,
        used.ru_utime + used.ru_stime,
        1024 * used.ru_maxrss,
    )
    problems = []
    found = json.loads(text) if text.startswith("{") else {"ends": {}, "gap": 0.0}
    if status:
        problems.append(f"ended with {process.returncode} {trace[-300:]}")
    # A hundred markers share a process.
    if cpu > CPU_SECONDS and not name.startswith("flips"):
        problems.append(f"computed for {cpu:.1f} s")
    if memory > MEMORY:
        problems.append(f"took {memory / 1e6:.0f} MB")
    problems += [f"{way}: {end}" for way, end in found["ends"].items() if end.startswith("raised")]
    return problems, np.array([cpu, memory, wall, found["gap"]]), found["ends"]


if __name__ == "__main__":
    sys.exit(main())
