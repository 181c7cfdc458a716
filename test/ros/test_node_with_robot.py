# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The node and a simulated robot, each in a process of its own, over the middleware."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

from std_msgs.msg import Header
from support.arm import JOINTS, arm_robot
from support.bench import LIMITS, VIA, Bench, benched
from support.domains import set_domain
from support.nodes import GOAL, START, goal_message
from support.patience import HANG
from support.referee import judge
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import Marker, MarkerArray

from mp_pca_planner.cli.main import main
from mp_pca_planner.motion.collision import CollisionModel
from mp_pca_planner.motion.interpolation import interpolate
from mp_pca_planner.robot.world import Obstacle, Sphere, World
from mp_pca_planner.ros.messages import to_trajectory

RADIUS, MARGIN = 0.03, 0.01
TRANSPORT = 0.02  # the longest that a message may take for a motion to continue another one [s]


# Before the tests of one robot: two nodes with theirs are more than a small machine runs in time.
@pytest.mark.slow
def test_motions_continued_and_stopped_neither_jump_nor_exceed_limits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    set_domain(monkeypatch, 88)
    record = tmp_path / "commands.npz"
    with benched(tmp_path, "--record", str(record)) as bench:
        bench.arrive(GOAL, VIA, START, GOAL)
        stopped = bench.begin_slowly(START)
        bench.client.stop(HANG)
        assert bench.execution(stopped)["outcome"] == "stopped"
        sent = [message.header.stamp for message in bench.client.trajectories]
    commands = np.load(record)
    stamps = np.array([stamp.sec + 1e-9 * stamp.nanosec for stamp in sent])
    ticks, n_points = commands["taken"].T
    assert len(ticks) == len(stamps) == len(commands["delays"])
    # Nothing is promised for messages that take longer, as they may on a busy machine. A
    # single point is led to from the measured state.
    is_late = (stamps > 0.0) & (commands["times"][ticks] - stamps > TRANSPORT)
    is_late |= commands["delays"] > TRANSPORT
    # A robot that was held while its process did not run is seen to be late some time after.
    held = np.flatnonzero(np.diff(commands["times"]) > 0.0011)
    is_late |= np.any((ticks[:, None] > held) & (ticks[:, None] < held + 1000), axis=1)
    end = ticks[-1] if is_late[-1] and n_points[-1] == 1 else None
    limits, own = arm_robot().limits(), {k: np.full(len(JOINTS), v) for k, v in LIMITS.items()}
    verdict = judge(
        commands["q"][:end],
        commands["clock"][:end],
        {"lower": limits.lower, "upper": limits.upper, **own},
        cuts=[*commands["cuts"], *ticks[is_late | (n_points == 1)]],
        finest=2e-7,
    )
    assert verdict.is_clean, verdict


@pytest.mark.slow
def test_first_obstacle_of_a_node_leaves_a_clear_motion_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    set_domain(monkeypatch, 86)
    with benched(tmp_path) as bench:
        bench.client.set(duration=6.0)
        bench.arrive(GOAL)  # in this time the watcher starts
        moving = bench.send(START)
        wait_for_obstacles(bench, "1", "none", ball(np.array([0.0, 0.0, -3.0])))
        report = bench.execution(moving)
        assert report["outcome"] == "arrived", str(report)


@pytest.fixture(scope="module")
def shared_bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    with pytest.MonkeyPatch.context() as patch:
        set_domain(patch, 85)
        with benched(tmp_path_factory.mktemp("robot")) as bench:
            yield bench


@pytest.fixture
def bench(shared_bench: Bench) -> Bench:
    """The robot at rest at the start, without obstacles."""
    wait_for_obstacles(shared_bench, "0", "none", Marker(action=Marker.DELETEALL))
    answer = shared_bench.send(START)
    if answer.trajectory is not None:
        shared_bench.execution(answer)
    return shared_bench


def wait_for_obstacles(bench: Bench, number: str, rejected: str, *markers: Marker) -> None:
    """Publish markers, and wait until the diagnostics say so."""
    if markers:
        bench.client.publish_markers(*markers)
    bench.client.wait_for_diagnostics(
        lambda values: values["obstacles"] == number and rejected in values["obstacle_rejected"],
        HANG,
    )


def ball(position: np.ndarray, **fields: object) -> Marker:
    one = Marker(ns="ball", type=Marker.SPHERE, **fields)
    one.scale.x = one.scale.y = one.scale.z = 2.0 * RADIUS
    one.pose.position.x, one.pose.position.y, one.pose.position.z = map(float, position)
    return one


def hand(positions: Sequence[float]) -> np.ndarray:
    return arm_robot().frame_positions(np.array([positions]), ["wrist"])[0, 0]


def test_send_goal_waits_until_the_robot_has_arrived(
    bench: Bench, capsys: pytest.CaptureFixture[str]
) -> None:
    def send(positions: Sequence[float], *options: str) -> int:
        goal = ",".join(f"{n}={x}" for n, x in zip(JOINTS, positions, strict=True))
        return main(["send_goal", goal, "--timeout", f"{HANG}", *options])

    patience = ("--wait", f"{HANG}")
    assert send(VIA, *patience) == 0
    bench.wait(lambda: np.allclose(bench.position, VIA, atol=1e-3))
    assert "arrived: the largest error is" in capsys.readouterr().out
    with bench.fault("active", False, True):
        assert send(START, "--json", *patience) == 1
    facts = json.loads(capsys.readouterr().out)
    assert facts["execution"]["outcome"] == "never_started"
    assert send(START, *patience) == 0


def is_erased(preview: MarkerArray) -> bool:
    return [marker.action for marker in preview.markers] == [Marker.DELETEALL]


@pytest.mark.slow
def test_preview_is_erased_after_its_motion_or_with_a_refused_goal(bench: Bench) -> None:
    def wait_for(is_expected: Callable[[MarkerArray], bool]) -> None:
        bench.wait(lambda: bool(bench.client.previews) and is_expected(bench.client.previews[-1]))

    arrived = bench.begin_slowly(VIA)
    wait_for(lambda preview: not is_erased(preview))
    assert bench.execution(arrived)["outcome"] == "arrived"
    wait_for(is_erased)
    with bench.fault("active", False, True):
        assert bench.execution(bench.send(GOAL))["outcome"] == "never_started"
        wait_for(lambda preview: not is_erased(preview))
        bench.client.send(goal_message([0.0], ("nothing",)), HANG)
        wait_for(is_erased)
    bench.arrive(START)


def test_robot_stops_where_no_motion_leads_around(bench: Bench) -> None:
    moving = bench.begin_slowly(GOAL)
    wait_for_obstacles(bench, "1", "none", ball(hand(GOAL)))
    assert bench.execution(moving)["outcome"] == "stopped"
    assert "'lower_arm' would hit 'ball'" in bench.client.executions[-1].message
    assert np.abs(bench.position - GOAL).max() > 0.1


SCENE = """world:
  collision_objects:
    - id: ball
      pose: {{position: {{x: {:.6f}, y: {:.6f}, z: {:.6f}}}}}
      primitives: [{{type: 2, dimensions: [{}]}}]
"""


def test_a_scene_is_sent_by_a_command_avoided_and_removed(
    bench: Bench, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    through = bench.send(GOAL).trajectory
    centre = hand(through.points[len(through.points) // 2].positions)
    world = World([Obstacle("ball", Sphere(RADIUS, centre))])
    model = CollisionModel(arm_robot(), world=world, self_collision=False)

    def clearance(message: JointTrajectory) -> float:
        dense = interpolate(to_trajectory(message))
        return float(model.near(dense.q, np.inf).distances.min())

    bench.arrive(START)
    (tmp_path / "scene.yaml").write_text(SCENE.format(*centre, RADIUS))
    assert main(["send_obstacles", str(tmp_path / "scene.yaml"), "--json"]) == 0
    sent = json.loads(capsys.readouterr().out)
    assert (sent["sent"], sent["obstacles_of_the_node"], sent["rejected"]) == (["ball"], 1, "")
    around = bench.send(GOAL)
    assert clearance(through) < 0.0 and clearance(around.trajectory) > 0.99 * MARGIN
    bench.execution(around)
    assert main(["send_obstacles", "--clear"]) == 0
    wait_for_obstacles(bench, "0", "none")
    assert main(["send_obstacles"]) == 2
    assert "give a FILE, or --clear" in capsys.readouterr().err


@pytest.mark.slow
def test_obstacle_in_an_unknown_frame_rejects_goals_until_the_frame_is_known(bench: Bench) -> None:
    in_map = ball(hand(GOAL) + np.array([0.0, 0.0, 1.0]), header=Header(frame_id="/map"))
    wait_for_obstacles(bench, "0", "'ball' is stated in the frame 'map'", in_map)
    assert "the frame 'map', which is not a link" in bench.send(GOAL).report.message
    bench.client.set(fixed_frames=["map: 0 0 -1"])
    wait_for_obstacles(bench, "1", "none")
    assert "'lower_arm' and 'ball'" in bench.send(GOAL).report.message
    bench.client.set(fixed_frames=["map: 0 0 3"])
    # The obstacle follows its frame within a moment.
    bench.wait(lambda: bench.send(GOAL).trajectory is not None)
    bench.client.set(fixed_frames=[""])
