# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Calls of the Python API with wrong types, shapes and values raise only documented errors."""

from contextlib import suppress
from itertools import count, repeat

import numpy as np
import pytest
from fuzz_calls import ARRAYS, NUMBERS, OTHERS, calls, planned, try_call, without_call

import mp_pca_planner as mp
from mp_pca_planner.arrays import as_list, check_number, float_array, unique_names
from mp_pca_planner.exceptions import GoalError, shown

EVERY = (*NUMBERS, *OTHERS, *ARRAYS)


def test_random_calls_raise_only_errors_of_the_front_door(tmp_path, monkeypatch):
    # benchmarks/fuzz_calls.py makes thousands of them.
    monkeypatch.chdir(tmp_path)
    problems = [try_call(number, 7, tmp_path) for number in range(300)]
    assert [one for one in problems if one[1]] == []


def test_every_public_function_has_a_valid_call(tmp_path, monkeypatch):
    # Otherwise odd arguments would test nothing. Add one to `calls` of benchmarks/fuzz_calls.py.
    monkeypatch.chdir(tmp_path)
    assert without_call(calls(tmp_path)) == []


@pytest.mark.parametrize("make", EVERY)
def test_every_value_has_a_text_for_messages(make):
    assert len(shown(make())) <= 80 + len("a value of type ")


@pytest.mark.parametrize("make", EVERY)
def test_checks_raise_the_error_that_they_are_given(make):
    for check in (
        lambda x: float_array(x, "x", GoalError, (4,)),
        lambda x: check_number(x, "x", GoalError, 0.0),
        lambda x: unique_names(x, "x", GoalError),
        lambda x: as_list(x, "x", GoalError),
    ):
        problem = ""
        try:
            check(make())
        except GoalError as error:
            problem = str(error)
        assert problem == "" or problem.startswith("x")


@pytest.mark.parametrize("make", EVERY)
def test_what_is_given_to_a_method_raises_an_error_of_the_front_door(make):
    planner, primitive, plan, _ = planned()
    for call in (
        lambda x: mp.Trajectory.load(x),
        lambda x: mp.Sphere(0.1).moved(x),
        lambda x: planner.robot.with_joints(x),
        lambda x: primitive.nearest_demonstrations(x),
        lambda x: x is not None and primitive.plot(x),
        lambda x: x is not None and plan.plot(x),
    ):
        with suppress(mp.PlannerError):
            call(make())


@pytest.mark.parametrize(
    "values",
    [["0.1"] * 4, [True] * 4, np.full(4, 1j), np.zeros(4, "M8[s]"), np.ma.masked_array([0.0] * 4)],
)
def test_what_is_no_number_is_not_converted_silently(values):
    with pytest.raises(GoalError, match="x must be numbers"):
        float_array(values, "x", GoalError, (4,))


def test_shape_is_checked_before_memory_is_taken():
    with pytest.raises(GoalError, match=r"shape \(4\), got \(1000000000000,\)"):
        float_array(np.broadcast_to(0.0, 10**12), "x", GoalError, (4,))
    for huge in (range(10**15), [range(10**15)], ([0.0], [0.0], range(10**15)), {0: [range(9)]}):
        with pytest.raises(GoalError, match="x must be numbers"):
            float_array(huge, "x", GoalError, (None, None))


@pytest.mark.parametrize("endless", [count, lambda: repeat(np.eye(9)), lambda: range(10**15)])
def test_fitting_rejects_endless_motions_and_times(endless):
    fit, one = mp.MovementPrimitive.fit, np.eye(9)
    for positions, times in ((endless(), [0.0, 0.1]), ([one], endless()), ([endless()], one[0])):
        with pytest.raises(mp.PlannerError, match="positions|times"):
            fit(positions, times=times)
    with pytest.raises(mp.PlannerError, match="joint_names"):
        fit([one], times=np.arange(9.0), joint_names=endless())


def test_values_in_messages_are_on_one_line():
    for value in (np.zeros((3, 4)), np.full(40, 0.1), "a\nb", [np.eye(2)]):
        assert shown(value).isprintable()


def test_every_error_derives_from_the_one_of_the_front_door():
    errors = [getattr(mp, name) for name in mp.__all__ if name.endswith("Error")]
    assert all(issubclass(one, mp.PlannerError) for one in errors)
    assert planned()[0].primitives
