# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The file that says where markers sit."""

from pathlib import Path

import pytest

from mp_pca_planner.exceptions import RecordingError
from mp_pca_planner.files import config_file
from mp_pca_planner.mocap.markers import read_marker_map

WRIST = "wrist: {link: hand, position: [0, 0, 0.1]}"


def test_shipped_map_has_the_markers_of_a_person() -> None:
    found = read_marker_map(config_file("human_arm_markers.yaml"))
    assert found.base == "moving"
    assert found.fit_origins == {
        "shoulder1": "position",
        "elbow": "length",
        "wrist_joint": "length",
    }
    assert [m.name for m in found.markers if m.link == "chest"] == [
        "chest_origin",
        "chest_up",
        "chest_right",
    ]


def test_everything_but_link_and_position_has_a_default(tmp_path: Path) -> None:
    path = tmp_path / "map.yaml"
    path.write_text(f"markers:\n  {WRIST[:-1]}, body: null}}\n")
    found = read_marker_map(path)
    assert (found.base, dict(found.fit_origins)) == ("moving", {})
    (marker,) = found.markers
    assert (marker.name, marker.link, marker.recorded_name) == ("wrist", "hand", "wrist")
    assert marker.weight == 1.0
    assert (marker.position, marker.offset) == ((0.0, 0.0, 0.1), (0.0, 0.0, 0.0))


def test_all_that_can_be_said_is_taken(tmp_path: Path) -> None:
    path = tmp_path / "map.yaml"
    path.write_text(
        "base: identity\nfit_origins: {elbow: position}\nmarkers:\n"
        "  tip: {link: hand, position: [1, 2, 3], weight: 0.5, body: 7, offset: [0, 1, 0]}\n"
    )
    found = read_marker_map(path)
    assert (found.base, dict(found.fit_origins)) == ("identity", {"elbow": "position"})
    assert (found.markers[0].body, found.markers[0].weight) == ("7", 0.5)
    assert found.markers[0].offset == (0.0, 1.0, 0.0)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("markers: [", "can't be read"),
        ("markers: " + "[" * 100_000, "nest"),
        (f"x: &x {{{WRIST}}}\nmarkers: *x", "aliases of YAML"),
        (f"markers: {{{WRIST}}}\nbase: 5", "it.base is 5, expected text"),
        ("- a", "it is .*, expected an object"),
        ("markers: {a: {link: x}}", "it.markers.a is .*, expected an object with 'position'"),
        ("markers: {a: {link: x, position: [0, 0]}}", "position of 'a' must have the shape"),
        ("markers: {a: {link: x, position: [0, 0, .nan]}}", r"position of 'a'\[2\] is nan"),
        (
            "markers: {a: {link: x, position: [0, 0, b]}}",
            r"position\[2\] is 'b', expected a number",
        ),
        ("markers: {a: {link: x, position: [0, 0, 0], weight: 0}}", "weight of 'a' is 0"),
        ("markers: {a: {link: x, position: [0, 0, 0], wieght: 1}}", "did you mean 'weight'"),
        (f"base: flying\nmarkers: {{{WRIST}}}", "'moving', 'identity'"),
        (f"fit_origins: {{e: size}}\nmarkers: {{{WRIST}}}", "'e' is called 'size'"),
        (f"fit_origins: [e]\nmarkers: {{{WRIST}}}", "it.fit_origins is .*, expected an object"),
        (f"scale: 1\nmarkers: {{{WRIST}}}", "no key is called 'scale'"),
    ],
)
def test_a_faulty_map_is_refused_by_name(tmp_path: Path, content: str, message: str) -> None:
    path = tmp_path / "map.yaml"
    path.write_text(content)
    with pytest.raises(RecordingError, match=message) as refused:
        read_marker_map(path)
    assert "map.yaml" in str(refused.value)


def test_a_map_that_is_not_there_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="marker map '.*none.yaml' can't be read"):
        read_marker_map(tmp_path / "none.yaml")
