# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""What `import mp_pca_planner as mp` offers."""

import doctest
import io
import json
import subprocess
import sys
import tempfile
import warnings
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import mp_pca_planner as mp
from mp_pca_planner.exceptions import GoalError, PlannerError

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


def test_predictions_far_from_the_demonstrations_warn_with_their_score() -> None:
    _, primitive, _, _ = planned()
    start, goal = primitive.boundary_states[0, [0, 3]]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        primitive.predict(start, goal)
        primitive.sample(1, start, goal)
    score = primitive.in_span_score(start, goal + 5.0)
    for call in (primitive.predict, lambda *ends: primitive.sample(1, *ends)):
        with pytest.warns(UserWarning, match=rf"unlike the demons.*score {score:.1f}") as caught:
            call(start, goal + 5.0)
        assert caught[0].filename == __file__


def test_a_request_in_degrees_is_asked_about() -> None:
    _, primitive, _, _ = planned()
    start, goal = primitive.boundary_states[0, [0, 3]]
    with pytest.warns(UserWarning, match="are these degrees"):
        primitive.predict(start, [45.0, 10.0, 5.0, 30.0])
    with pytest.warns(UserWarning, match="unlike them$"):
        primitive.predict(start, goal + 5.0)


def test_the_expected_error_of_a_request_is_that_of_its_plan() -> None:
    _, primitive, _, planner = planned()
    start, goal = primitive.boundary_states[0, [0, 3]]
    plan = planner.plan(start=start, goal=goal)
    error = primitive.expected_error(start, goal, plan.duration)
    np.testing.assert_allclose(error, plan.facts["expected_error"], rtol=1e-6)
    assert primitive.expected_error(start, {"elbow": goal[3]}) > 0.0


def test_a_primitive_of_one_demonstration_gives_a_warning() -> None:
    demonstrations, _, _, _ = planned()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        mp.MovementPrimitive.fit(demonstrations[:2])
    with pytest.warns(UserWarning, match="one demonstration says nothing") as caught:
        one = mp.MovementPrimitive.fit(demonstrations[:1])
    assert caught[0].filename == __file__
    ends = one.boundary_states[0, [0, 3]]
    np.testing.assert_array_equal(one.sample(1, *ends)[0].positions, one.predict(*ends).positions)
    assert np.isnan(one.expected_error(*ends))


def test_times_in_nanoseconds_and_uneven_times_are_rejected() -> None:
    t = np.linspace(0.0, 1.0, 51)
    with pytest.raises(mp.PlannerError, match="must be in seconds.* span 1e.09 s"):
        mp.Demonstration.from_arrays(["elbow"], 1e9 * t, np.sin(t)[:, None])
    uneven = np.append(1e-6 * t[:-1], 9e5)
    with pytest.raises(mp.PlannerError, match="about even, but"):
        mp.Demonstration.from_arrays(["elbow"], uneven, np.sin(t)[:, None])


def test_arrays_of_another_shape_are_named() -> None:
    t = np.linspace(0.0, 1.0, 51)
    q = np.column_stack([np.sin(t), np.cos(t)])
    fit = mp.MovementPrimitive.fit
    for names in (None, ["a", "b"]):
        with pytest.raises(
            mp.PlannerError, match=r"\(samples, joints\) must have .*, got \(2, 51\)"
        ):
            fit([q.T], times=t, joint_names=names)
    with pytest.raises(mp.PlannerError, match=r"\(50, 2\), got \(51, 2\)"):
        fit([q], times=t[:-1])
    for period in (0.01, np.array(0.01)):
        with pytest.raises(mp.PlannerError, match="times must be the times of the samples"):
            fit([q], times=period)


def test_times_that_look_like_milliseconds_give_a_warning() -> None:
    t = np.linspace(0.0, 1.0, 51)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        mp.Demonstration.from_arrays(["elbow"], t, np.sin(t)[:, None])
    with pytest.warns(UserWarning, match="20 s apart: times must be in seconds"):
        mp.Demonstration.from_arrays(["elbow"], 1e3 * t, np.sin(t)[:, None])


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


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (lambda reach, robot, ends: mp.Planner(robot, ["reach.npz"]), "load reads a file"),
        (lambda reach, robot, ends: mp.MovementPrimitive.fit([ends]), "arrays need times="),
        (lambda reach, robot, ends: reach.sample(1.5, *ends), "from 0 to 10000, got 1.5"),
        (lambda reach, robot, ends: reach.sample(1, *ends, seed="x"), "seed must be a whole"),
        (lambda reach, robot, ends: reach.predict(*ends, duration=1e9), "from 0.001 to 600"),
        (
            lambda reach, robot, ends: reach.predict({"elbow": 0}, ends[1]),
            "lacks .*shoulder1",
        ),
        (lambda reach, robot, ends: reach.predict(ends[0], {"elbo": 0}), "did you mean 'elbow'"),
        (lambda reach, robot, ends: mp.Planner(URDF, reach), "the robot must be of type Robot"),
        (lambda reach, robot, ends: mp.Planner([reach], robot), "the robot must be of type Robot"),
        (lambda reach, robot, ends: mp.Planner(robot, reach, collision="yes"), "CollisionModel or"),
        (lambda reach, robot, ends: mp.JointGoal(ends[1]), "JointState or Mapping"),
        (lambda reach, robot, ends: mp.SequenceGoal([{"elbow": 0}], ["x"]), "increase, got ..x.,"),
        (lambda reach, robot, ends: mp.JointState("elbow", [0]), "a list of names is needed"),
        (lambda reach, robot, ends: mp.show(reach), "planner must be of type Planner"),
        (lambda reach, robot, ends: mp.JointLimits(["a"], {"a": {"velocity": 1}}), "max_velocity"),
        (lambda reach, robot, ends: robot.frame_positions(ends[0], ["wrist"]), "any, 4"),
        (lambda reach, robot, ends: mp.World([mp.Sphere(1.0)]), "must be of type Obstacle"),
        (lambda reach, robot, ends: mp.write_example_recording("x.mcap", 1.5), "whole number"),
    ],
)
def test_wrong_value_is_refused_in_one_sentence(wrong, said) -> None:
    demonstrations, primitive, robot, _ = planned()
    with pytest.raises(PlannerError, match=said):
        wrong(primitive, robot, demonstrations[0].positions[[0, -1]])


def test_prediction_takes_what_plan_takes() -> None:
    demonstrations, primitive, robot, _ = planned()
    start, goal = demonstrations[0].positions[[0, -1]]
    names, elbow = robot.joint_names, np.where(np.equal(robot.joint_names, "elbow"), goal, start)
    expected = primitive.predict(start, elbow)
    state = mp.JointState(names[::-1], start[::-1])
    for begin in (dict(zip(names, start, strict=True)), state):
        found = primitive.predict(begin, {"elbow": goal[names.index("elbow")]})
        np.testing.assert_array_equal(found.positions, expected.positions)


@pytest.mark.parametrize("name", mp.__all__)
def test_examples_of_public_names_run(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    found = doctest.DocTestFinder(recurse=True).find(getattr(mp, name), name)
    examples = [one for one in found if one.examples]
    is_base = not (isinstance(getattr(mp, name), type) and issubclass(getattr(mp, name), Exception))
    assert examples or (not is_base and name != "PlannerError")
    for one in examples:
        report = io.StringIO()
        failed, _ = doctest.DocTestRunner().run(one, out=report.write)
        assert not failed, report.getvalue()


def test_trajectories_in_files_hold_the_exact_numbers(tmp_path: Path) -> None:
    demonstrations, _, _, planner = planned()
    plan = planner.plan(start=demonstrations[0].positions[0], goal={"elbow": -0.6})
    for motion in (plan.trajectory, plan.trajectory.with_efforts(None)):
        for suffix in (".csv", ".json", ".npz"):
            motion.save(tmp_path / f"motion{suffix}", overwrite=True)
        columns = motion.columns()
        with np.load(tmp_path / "motion.npz") as arrays:
            content = json.loads((tmp_path / "motion.json").read_text())
            assert tuple(content["joint_names"]) == tuple(arrays["joint_names"])
            assert set(arrays.files) == {"joint_names", *columns}
            for name, values in columns.items():
                np.testing.assert_array_equal(arrays[name], values)
                np.testing.assert_array_equal(content[name], values)
        table = np.loadtxt(tmp_path / "motion.csv", delimiter=",", skiprows=1)
        np.testing.assert_array_equal(table, np.column_stack(list(columns.values())))


@pytest.mark.parametrize(
    "values",
    [["0.1"] * 4, [True] * 4, np.full(4, 1j), np.zeros(4, "M8[s]"), np.ma.masked_array([0.0] * 4)],
)
def test_what_is_no_number_is_not_converted_silently(values: object) -> None:
    with pytest.raises(GoalError, match="must be numbers"):
        mp.JointState(list("abcd"), values)
