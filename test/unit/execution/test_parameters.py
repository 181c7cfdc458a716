# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The table of parameters, the files that show it, and the settings that come of it."""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest
import yaml

from mp_pca_planner.exceptions import PlannerError
from mp_pca_planner.execution.parameters import (
    DECLARATIONS,
    Settings,
    check_limit_names,
    fixed_frames,
    locked_positions,
)
from mp_pca_planner.files import config_file
from mp_pca_planner.planning.options import MAX_NATURALNESS, PlannerOptions

BY_NAME = {declaration.name: declaration for declaration in DECLARATIONS}


def test_parameter_file_is_written_from_the_table() -> None:
    script = runpy.run_path(str(Path(__file__).parents[3] / "scripts" / "parameter_file.py"))
    text = config_file("planner.yaml").read_text(encoding="utf-8")
    assert text == script["parameter_file"](), "run scripts/parameter_file.py > config/planner.yaml"


def test_parameter_file_shows_every_parameter_with_its_default() -> None:
    text = config_file("planner.yaml").read_text(encoding="utf-8")
    shown = yaml.safe_load(text)["/**"]["ros__parameters"]
    declared = {
        d.name: list(d.default) if isinstance(d.default, tuple) else d.default for d in DECLARATIONS
    }
    assert shown == declared
    assert {n: type(v) for n, v in shown.items()} == {n: type(v) for n, v in declared.items()}


@pytest.mark.parametrize("end", ["low", "high"])
@pytest.mark.parametrize(
    "name",
    # Constraints are a text in parameters, and objects in options.
    [d.name for d in DECLARATIONS if hasattr(PlannerOptions(), d.name) and d.name != "constraints"],
)
def test_planner_accepts_the_ends_of_every_range(name: str, end: str) -> None:
    declaration = BY_NAME[name]
    is_number = type(declaration.default) in (int, float)
    value = getattr(declaration, end) if is_number else declaration.default
    options = Settings.from_values({name: value}).planner_options
    # A negative number of ROS stands for None.
    expected = None if is_number and value < 0.0 else value
    assert getattr(options, name) == expected


def test_limits_of_zero_leave_the_limit_as_it_was() -> None:
    values = {
        "primitives": ["", "a.npz"],
        "limits.a.max_jerk": 3.0,
        "limits.a.max_effort": 0.0,
        "limits.b.c.max_effort": 4.0,
        "limits.d.max_velocity": 0.0,
    }
    settings = Settings.from_values(values)
    assert settings.limits == {"a": {"max_jerk": 3.0}, "b.c": {"max_effort": 4.0}}
    assert settings.primitive_paths == ("a.npz",)


@pytest.mark.parametrize("name", [d.name for d in DECLARATIONS if d.choices])
def test_text_that_is_none_of_the_choices_is_refused_with_the_choices(name: str) -> None:
    with pytest.raises(PlannerError) as refusal:
        Settings.from_values({name: "nonsense"})
    for choice in BY_NAME[name].choices:
        assert repr(choice) in str(refusal.value)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("limits.elbo.max_velocity", "did you mean 'elbow'"),
        ("limits.elbow.max_velocities", "max_velocity"),
        ("limits.elbow", "limits.<joint>.<quantity>"),
        ("limits.", "limits.<joint>.<quantity>"),
    ],
)
def test_limits_of_other_joints_and_quantities_are_refused(name: str, words: str) -> None:
    with pytest.raises(PlannerError, match=words):
        check_limit_names(["duration", "limits.elbow.max_jerk", name], ["elbow"])


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("locked_joints", "grip", "as in name=value"),
        ("locked_joints", "grip=0.1,grip=0.2", "more than once"),
        ("srdf", "/nowhere.srdf", "there is no file '/nowhere.srdf'"),
        ("package_dirs", ("", "/nowhere"), "there is no folder '/nowhere'"),
        ("objective", "effrt", "did you mean 'effort'"),
        ("fixed_frames", ("map",), "expected each frame once as FRAME: X Y Z"),
        ("fixed_frames", ("map: 1 2 inf",), "FRAME: X Y Z"),
        ("fixed_frames", ("map: 1 2 3 0 0 0 0",), "quaternion of length 1"),
        ("fixed_frames", ("map: 1 2 3", "map: 1 2 3"), "each frame once"),
    ],
)
def test_text_of_several_values_is_refused_with_the_form_that_is_accepted(name, value, words):
    with pytest.raises(PlannerError, match=f"'{name}'.*{words}"):
        Settings(**{name: value})


def test_texts_of_several_values_are_read():
    assert locked_positions(" a=1, b = -2e-1,") == {"a": 1.0, "b": -0.2}
    found = fixed_frames(("", "map: 1 2 3", "camera: 0,0,1, 0 0 0.7071 0.7071"))
    assert found["map"] == [1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0]
    assert found["camera"] == pytest.approx([0, 0, 1, 0, 0, 0.5**0.5, 0.5**0.5])


def test_naturalness_has_the_same_bounds_in_python_and_in_the_node() -> None:
    assert BY_NAME["naturalness"].high == MAX_NATURALNESS
    assert PlannerOptions(naturalness=MAX_NATURALNESS).naturalness == MAX_NATURALNESS
    with pytest.raises(PlannerError, match=r"naturalness must be a number from 0 to 1, got 2\.0"):
        PlannerOptions(naturalness=2.0)
