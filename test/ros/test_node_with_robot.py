# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The node and a simulated robot, each in a process of its own, over the middleware."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import count
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

from diagnostic_msgs.msg import DiagnosticStatus
from support.arm import JOINTS, arm_primitive, arm_robot
from support.bench import LIMITS, VIA, Bench, benched
from support.domains import set_domain
from support.nodes import GOAL, START, goal_message
from support.patience import HANG
from support.referee import judge
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import Marker, MarkerArray

from mp_pca_planner.cli.main import main
from mp_pca_planner.primitives.file import save_primitive

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


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    """One robot for most tests, which leave it at rest."""
    with pytest.MonkeyPatch.context() as patch:
        set_domain(patch, 85)
        with benched(tmp_path_factory.mktemp("robot")) as bench:
            yield bench


def test_goal_is_reached_and_reported_as_arrived(bench: Bench) -> None:
    report = bench.arrive(GOAL)
    assert float(report["error"]) < 1e-3
    np.testing.assert_allclose(bench.position, GOAL, atol=1e-3)


@pytest.mark.slow
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


@pytest.mark.realtime
def test_goal_that_comes_twenty_times_a_second_arrives_with_one_motion(bench: Bench) -> None:
    first = bench.client.send(bench.message(GOAL), HANG)
    n_motions, n_executions = len(bench.client.trajectories), len(bench.client.executions)

    def repeat() -> bool:
        bench.client.publish_goal(bench.message(GOAL))
        time.sleep(0.05)
        return len(bench.client.executions) > n_executions

    bench.wait(repeat)
    assert bench.execution(first)["outcome"] == "arrived"
    again = bench.client.send(bench.message(GOAL), HANG)
    assert again.values["status"] == "under_way"
    assert len(bench.client.trajectories) == n_motions


@pytest.mark.slow
def test_robot_at_half_speed_takes_a_goal_in_motion_and_arrives(bench: Bench) -> None:
    with bench.fault("speed_scaling", 0.5, 1.0):
        first, second = bench.send(START), bench.send(VIA)
        assert bench.execution(second)["outcome"] == "arrived"
    assert bench.execution(first)["outcome"] in ("replaced", "arrived")
    np.testing.assert_allclose(bench.position, VIA, atol=1e-3)


def distance_to_path(position: np.ndarray, trajectory: JointTrajectory) -> float:
    path = np.array([point.positions for point in trajectory.points])
    fine = np.linspace(0, len(path) - 1, 20 * len(path))
    dense = np.column_stack([np.interp(fine, np.arange(len(path)), q) for q in path.T])
    return float(np.abs(dense - position).max(axis=1).min())


@pytest.mark.slow
def test_goal_near_the_running_one_is_served_after_its_primitive_was_renamed(
    bench: Bench, tmp_path: Path
) -> None:
    save_primitive(replace(arm_primitive(), name="renamed"), tmp_path / "renamed.npz")
    goal = START if np.abs(bench.position - VIA).max() < 0.1 else VIA
    bench.begin_slowly(goal)
    bench.set(primitives=[str(tmp_path / "renamed.npz")])
    n = len(bench.client.trajectories)
    answer = bench.send(np.array(goal) + 0.01)
    assert answer.trajectory is not None
    assert answer.report.level != DiagnosticStatus.ERROR, answer.report.message
    assert answer.values["primitive"] == "renamed"
    assert len(bench.client.trajectories) == n + 1
    bench.set(primitives=[bench.primitive])
    bench.client.stop()
    bench.execution(answer)


@pytest.mark.slow
def test_stop_in_motion_ends_at_rest_on_the_path(bench: Bench) -> None:
    goals = (GOAL, START)
    for k in count():
        moving = bench.begin_slowly(goals[k % 2])
        answer, stop = bench.client.stop(HANG)
        assert answer.success, answer.message
        assert bench.execution(moving)["outcome"] == "stopped"
        # On a busy machine it may not be known precisely enough where the robot is.
        if "on its path" in answer.message:
            break
        assert k < 4, answer.message
    assert stop is not None
    assert len(stop.points) > 1
    assert distance_to_path(bench.position, moving.trajectory) < 1e-3
    assert np.abs(bench.position - goals[k % 2]).max() > 0.1
