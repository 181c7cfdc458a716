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
    limit_declarations,
    locked_positions,
)
from mp_pca_planner.files import config_file
from mp_pca_planner.planning.options import PlannerOptions

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


def test_every_parameter_is_described_and_its_default_is_accepted() -> None:
    for declaration in (*DECLARATIONS, *limit_declarations(["elbow"])):
        assert declaration.description.endswith(".")
        if type(declaration.default) in (int, float):
            assert declaration.low <= declaration.default <= declaration.high
        if declaration.choices:
            assert declaration.default in declaration.choices


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


def test_settings_take_given_values_and_leave_the_others_at_their_defaults() -> None:
    settings = Settings.from_values({"primitives": ["", "a.npz"], "duration": 2.0, "other": 1})
    assert settings.primitive_paths == ("a.npz",)
    assert settings.duration == 2.0
    assert settings.start_from == BY_NAME["start_from"].default


def test_limits_of_zero_leave_the_limit_as_it_was() -> None:
    values = {
        "limits.a.max_jerk": 3.0,
        "limits.a.max_effort": 0.0,
        "limits.b.c.max_effort": 4.0,
        "limits.d.max_velocity": 0.0,
    }
    assert Settings.from_values(values).limits == {
        "a": {"max_jerk": 3.0},
        "b.c": {"max_effort": 4.0},
    }


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


@pytest.mark.parametrize("text", ["effrt", "effort=-1", "jerk=nan", "effort,effort", "jerk=x", ""])
def test_objective_that_is_no_weighted_sum_is_refused(text: str) -> None:
    with pytest.raises(PlannerError, match="parameter 'objective'"):
        Settings.from_values({"objective": text})


def test_limits_of_the_joints_are_declared_one_by_one() -> None:
    names = [declaration.name for declaration in limit_declarations(["a", "b"])]
    check_limit_names(names, ["a", "b"])
    assert len(set(names)) == 8


@pytest.mark.parametrize(
    "values", [{"srdf": "/nowhere.srdf"}, {"srdf": "/"}, {"package_dirs": ("", "/nowhere")}]
)
@pytest.mark.parametrize("collision", [False, True])
def test_missing_files_of_collisions_are_refused_whether_they_are_used_or_not(values, collision):
    with pytest.raises(PlannerError, match="there is no (file|folder) '/"):
        Settings(collision=collision, **values)


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("locked_joints", "grip", "as in name=value"),
        ("locked_joints", "grip=0.1,grip=0.2", "more than once"),
        ("locked_joints", "grip=nan", "finite"),
        ("locked_joints", "=1", "no joint is called"),
        ("fixed_frames", ("map",), "expected each frame once as FRAME: X Y Z"),
        ("fixed_frames", ("map: 1 2",), "FRAME: X Y Z"),
        ("fixed_frames", ("map: 1 2 inf",), "FRAME: X Y Z"),
        ("fixed_frames", ("map: 1 2 3 0 0 0 0",), "quaternion of length 1"),
        ("fixed_frames", ("map: 1 2 3", "map: 1 2 3"), "each frame once"),
        ("fixed_frames", (": 1 2 3",), "FRAME: X Y Z"),
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
