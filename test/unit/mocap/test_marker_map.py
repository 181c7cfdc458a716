# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The file that says where markers sit."""

from pathlib import Path

import pytest

from mp_pca_planner.exceptions import RecordingError
from mp_pca_planner.mocap.markers import MarkerPlacement, read_marker_map

WRIST = "wrist: {link: hand, position: [0, 0, 0.1]}"


def test_a_map_is_read_with_defaults_of_all_but_link_and_position(tmp_path: Path) -> None:
    path = tmp_path / "map.yaml"
    path.write_text(
        "base: identity\nfit_origins: {elbow: position}\nmarkers:\n"
        f"  {WRIST[:-1]}, body: null}}\n"
        "  tip: {link: hand, position: [1, 2, 3], weight: 0.5, body: 7, offset: [0, 1, 0]}\n"
    )
    found = read_marker_map(path)
    assert (found.base, dict(found.fit_origins)) == ("identity", {"elbow": "position"})
    assert found.markers == (
        MarkerPlacement("wrist", "hand", (0.0, 0.0, 0.1)),
        MarkerPlacement("tip", "hand", (1.0, 2.0, 3.0), 0.5, "7", (0.0, 1.0, 0.0)),
    )
    assert [marker.recorded_name for marker in found.markers] == ["wrist", "7"]
    path.write_text(f"markers: {{{WRIST}}}")
    found = read_marker_map(path)
    assert (found.base, dict(found.fit_origins)) == ("moving", {})
    with pytest.raises(RecordingError, match="marker map '.*none.yaml' can't be read"):
        read_marker_map(tmp_path / "none.yaml")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("markers: [", "can't be read"),
        ("markers: {a: {link: x}}", "it.markers.a is .*, expected an object with 'position'"),
        ("markers: {a: {link: x, position: [0, 0, 0], weight: 0}}", "weight of 'a' is 0"),
        ("markers: {a: {link: x, position: [0, 0, 0], wieght: 1}}", "did you mean 'weight'"),
        (f"base: flying\nmarkers: {{{WRIST}}}", "'moving', 'identity'"),
        (f"fit_origins: {{e: size}}\nmarkers: {{{WRIST}}}", "'e' is called 'size'"),
    ],
)
def test_a_faulty_map_is_refused_by_name(tmp_path: Path, content: str, message: str) -> None:
    path = tmp_path / "map.yaml"
    path.write_text(content)
    with pytest.raises(RecordingError, match=message) as refused:
        read_marker_map(path)
    assert "map.yaml" in str(refused.value)
