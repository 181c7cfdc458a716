# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""What `import mp_pca_planner as mp` offers."""

import subprocess
import sys
import tempfile
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import mp_pca_planner as mp
from mp_pca_planner.exceptions import GoalError, PlannerError, RecordingError

URDF = mp.config_file("human_arm.urdf")


@cache
def planned() -> tuple:
    demonstrations = mp.load_demonstrations(recording(), robot=URDF)
    primitive = mp.MovementPrimitive.fit(demonstrations, name="raise_arm")
    robot = mp.Robot.from_file(URDF, primitive.joint_names)
    return demonstrations, primitive, robot, mp.Planner(robot, [primitive])


@cache
def recording() -> Path:
    folder = Path(tempfile.mkdtemp())
    return mp.write_example_recording(folder / "motions.mcap", 12)


def test_import_loads_nothing_but_the_package_itself() -> None:
    code = "import sys, mp_pca_planner; print({'numpy', 'pinocchio', 'scipy'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


@pytest.mark.parametrize("name", mp.__all__)
def test_public_name_is_there_with_a_docstring(name: str) -> None:
    assert getattr(mp, name).__doc__
    assert name in dir(mp)


def test_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="has no attribute 'Plannner'"):
        mp.Plannner  # noqa: B018


def test_values_are_described_in_one_line() -> None:
    demonstrations, primitive, robot, planner = planned()
    plan = planner.plan(start=demonstrations[0].positions[0], goal={"elbow": -0.6})
    for value in (demonstrations, demonstrations[0], primitive, robot, planner, plan):
        assert "\n" not in repr(value) and len(repr(value)) < 300
        assert type(value).__name__ in repr(value)
    assert "<table>" in plan._repr_html_()


def test_goal_of_a_dict_an_array_and_a_finished_goal_give_the_same_plan() -> None:
    demonstrations, _, robot, planner = planned()
    start, end = demonstrations[0].positions[[0, -1]]
    names = robot.joint_names
    goal = mp.JointGoal(mp.JointState(names, end), duration=1.5)
    plans = [
        planner.plan(start=dict(zip(names, start, strict=True)), goal=end, duration=1.5),
        planner.plan(dict(zip(names, end, strict=True)), start, duration=1.5),
        planner.plan(goal, mp.JointState(names, start)),
    ]
    for plan in plans:
        np.testing.assert_allclose(
            plan.trajectory.positions, plans[2].trajectory.positions, atol=1e-9
        )


def test_list_of_targets_is_a_sequence_through_all_of_them() -> None:
    demonstrations, _, _, planner = planned()
    a, b = demonstrations[0].positions[[0, -1]]
    c = demonstrations[2].positions[-1]
    plan = planner.plan(start=a, goal=[b, {"elbow": c[3]}, a])
    assert plan.mode == "optimal" and len(plan.motions) == 3
    np.testing.assert_allclose(plan.motions[0].goal.positions, b)
    np.testing.assert_allclose(plan.trajectory.positions[-1], a, atol=1e-9)


def test_pose_is_reached() -> None:
    demonstrations, _, robot, planner = planned()
    start, end = demonstrations[0].positions[[0, -1]]
    there = robot.frame_positions(end[None], ["wrist"])[0, 0]
    plan = planner.plan(start=start, goal=mp.Pose("wrist", there))
    reached = robot.frame_positions(plan.trajectory.positions[-1:], ["wrist"])[0, 0]
    np.testing.assert_allclose(reached, there, atol=1e-4)


def test_wrong_numbers_of_positions_are_rejected() -> None:
    demonstrations, _, _, planner = planned()
    with pytest.raises(GoalError, match="the start needs one position for each of the 4 joints"):
        planner.plan(start=[0.0], goal=demonstrations[0].positions[-1])


def test_recordings_without_a_motion_are_an_error_with_the_first_reason(tmp_path: Path) -> None:
    (tmp_path / "empty.mcap").write_bytes(b"")
    with pytest.raises(RecordingError, match="no motion was found: empty"):
        mp.load_demonstrations(tmp_path / "empty.mcap")


def test_report_counts_repairs_and_rejections(tmp_path: Path) -> None:
    (tmp_path / "empty.mcap").write_bytes(b"")
    demonstrations = mp.load_demonstrations([recording(), tmp_path / "empty.mcap"], robot=URDF)
    assert f"{len(demonstrations)} motions in 1 usable recording(s)" in demonstrations.report
    assert "rejected empty" in demonstrations.report


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (lambda reach, robot, ends: mp.Planner(robot, ["reach.npz"]), "load reads a file"),
        (lambda reach, robot, ends: mp.MovementPrimitive.fit(None), "None is no demonstration"),
        (lambda reach, robot, ends: mp.MovementPrimitive.fit([ends]), "is no demonstration"),
        (lambda reach, robot, ends: reach.sample(1.5, *ends), "positive integer, got 1.5"),
        (lambda reach, robot, ends: reach.sample(-1, *ends), "positive integer, got -1"),
    ],
)
def test_what_is_no_primitive_demonstration_or_number_is_refused(wrong, said) -> None:
    demonstrations, primitive, robot, _ = planned()
    with pytest.raises(PlannerError, match=said):
        wrong(primitive, robot, demonstrations[0].positions[[0, -1]])


def test_planner_takes_a_single_primitive() -> None:
    demonstrations, primitive, robot, planner = planned()
    start, goal = demonstrations[0].positions[[0, -1]]
    alone, listed = (one.plan(goal, start) for one in (mp.Planner(robot, primitive), planner))
    np.testing.assert_array_equal(alone.trajectory.positions, listed.trajectory.positions)
