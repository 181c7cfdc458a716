# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The way from bags of markers to joint states, for people of other lengths who move about."""

import json
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.arm import JOINTS
from support.bags import read_joint_states
from support.marker_bags import write_marker_arrays

from mp_pca_planner.cli.main import main
from mp_pca_planner.exceptions import PlannerError, RecordingError, RobotError
from mp_pca_planner.files import config_file
from mp_pca_planner.mocap.marker_joint_states import (
    MarkerSource,
    marker_source,
)
from mp_pca_planner.recordings.joint_states import JointStates
from mp_pca_planner.recordings.recording import MarkerResidual
from mp_pca_planner.robot.model import Robot

URDF, MAP = config_file("human_arm.urdf"), config_file("human_arm_markers.yaml")
CHEST = {"chest_origin": (0, 0, 0), "chest_up": (0, 0, 0.1), "chest_right": (0, -0.1, 0)}
ARM = {"right_shoulder": "upper_arm", "right_elbow": "lower_arm", "right_wrist": "wrist"}
SMALL = {"-0.0154 -0.1667 0.0788": "-0.02 -0.19 0.04", "-0.3447": "-0.28", "-0.3074": "-0.26"}
N = 150
FITS = MAP.read_text(encoding="utf-8").partition("fit_origins:")[2].partition("\n# link")[0]
FITS = f"fit_origins:{FITS}"


def motion() -> np.ndarray:
    t = np.linspace(0.0, 1.0, N)[:, None]
    rises = 10 * t**3 - 15 * t**4 + 6 * t**5
    return np.array([-0.2, 0.3, -0.3, -0.5]) + rises * np.array([-1.0, -0.5, 0.9, -0.7])


def markers(*, small: bool = False, base: str = "moving") -> dict[str, np.ndarray]:
    """Markers of an arm that makes the motion, on a chest that moves or is the world."""
    text = URDF.read_text(encoding="utf-8")
    if small:
        for ours, theirs in SMALL.items():
            text = text.replace(f'xyz="{ours}"', f'xyz="{theirs}"')
            text = text.replace(f'xyz="0 0 {ours}"', f'xyz="0 0 {theirs}"')
    robot = Robot(text)
    points = robot.frame_positions(motion(), list(ARM.values())).transpose(1, 0, 2)
    places = dict(zip(ARM, points, strict=True))
    places |= {name: np.tile(np.array(p, dtype=float), (N, 1)) for name, p in CHEST.items()}
    if base == "identity":
        return places
    t = np.linspace(0.0, 3.0, N)
    turns = Rotation.from_euler("zyx", np.column_stack([0.5 * t, 0.2 * np.sin(t), 0.1 * t]))
    shift = np.column_stack([0.3 * t, np.sin(t), 1.4 + 0.05 * np.cos(t)])
    return {name: turns.apply(p) + shift for name, p in places.items()}


class Solved(NamedTuple):
    joint_states: JointStates
    residuals: dict[str, MarkerResidual]


def solved(path: Path, source: MarkerSource) -> tuple[np.ndarray, Solved]:
    found = Solved(*source.joint_states(path))
    assert found.joint_states.joint_names == source.joint_names
    return found.joint_states.positions, found


def changed_map(tmp_path: Path, *changes: tuple[str, str]) -> Path:
    text = MAP.read_text(encoding="utf-8")
    for before, after in changes:
        assert before in text
        text = text.replace(before, after)
    path = tmp_path / "map.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_angles_of_a_moving_person_are_found_whatever_the_lengths(tmp_path: Path) -> None:
    path = write_marker_arrays(tmp_path / "bag", markers(small=True))
    # Transmissions have elements that are called joints, too.
    urdf, more = tmp_path / "arm.urdf", '<transmission><joint name="elbow"/></transmission></robot>'
    urdf.write_text(URDF.read_text(encoding="utf-8").replace("</robot>", more), encoding="utf-8")
    q, found = solved(path, marker_source("/markers", urdf, MAP))
    np.testing.assert_allclose(q, motion(), atol=2e-3)
    assert list(found.residuals) == [*CHEST, *ARM]
    assert all(r.median < 1e-4 and r.n_frames == N for r in found.residuals.values())
    residuals, shoulder, *others = found.joint_states.notes
    assert "'right_shoulder' 0.00 and 0.00" in residuals
    assert shoulder == (
        "joint 'shoulder1' fits the markers best at (-20.0, -190.0, 40.0) mm in its parent link; "
        "the URDF has it at (-15.4, -166.7, 78.8) mm"
    )
    assert [note.split("'")[1] for note in others] == ["elbow", "wrist_joint"]
    # Without the fit, wrong lengths show.
    _, found = solved(path, marker_source("/markers", URDF, changed_map(tmp_path, (FITS, ""))))
    assert found.residuals["right_elbow"].median > 0.01
    assert found.residuals["chest_up"].median < 1e-9


def test_a_base_in_whose_frame_markers_are_recorded_is_not_fitted(tmp_path: Path) -> None:
    places = markers(base="identity")
    places["chest_up"][30:] = np.nan
    path = write_marker_arrays(tmp_path / "bag", places)
    identity = changed_map(tmp_path, ("base: moving", "base: identity"))
    q, _ = solved(path, marker_source("/markers", URDF, identity, JOINTS[::-1]))
    np.testing.assert_allclose(q[:, ::-1], motion(), atol=2e-3)


def test_frames_without_enough_markers_are_nan_and_told(tmp_path: Path) -> None:
    places = markers()
    places["right_wrist"][40:45] = np.nan
    places["chest_up"][60:70] = np.nan
    places["right_shoulder"][80:90] = np.nan
    path = write_marker_arrays(tmp_path / "bag", places)
    q, found = solved(path, marker_source("/markers", URDF, MAP))
    gaps = np.flatnonzero(np.isnan(q).any(axis=1))
    assert gaps.tolist() == [*range(40, 45), *range(60, 70)]
    np.testing.assert_allclose(np.delete(q, gaps, 0), np.delete(motion(), gaps, 0), atol=2e-3)
    notes = "\n".join(found.joint_states.notes)
    assert "marker 'right_shoulder' is missing in 10 of 150 frames" in notes
    assert "15 of 150 frames lack markers that the joints need" in notes
    assert found.residuals["right_shoulder"].n_frames == N - 15 - 10


def test_a_recording_in_which_nothing_can_be_solved_is_refused(tmp_path: Path) -> None:
    places = markers()
    places["right_wrist"][75:] = np.nan
    places["right_elbow"][:75] = np.nan
    places["right_shoulder"][:75] = np.nan
    path = write_marker_arrays(tmp_path / "bag", places)
    source = marker_source("/markers", URDF, changed_map(tmp_path, ("elbow: length", "")))
    with pytest.raises(RecordingError, match="no frame has all markers, so the origins of"):
        source.joint_states(path)
    source = marker_source("/markers", URDF, changed_map(tmp_path, (FITS, "")))
    with pytest.raises(RecordingError, match="in none of the 150 frames.*'right_wrist' in 75"):
        source.joint_states(path)


@pytest.mark.parametrize(
    ("before", "after", "error", "message"),
    [
        ("link: wrist", "link: wrists", RobotError, "'wrists' .did you mean 'wrist'"),
        ("elbow: length", "elbows: length", RecordingError, "'elbows' .did you mean 'elbow'"),
        ("shoulder1: position", "shoulder2: length", RecordingError, "no length to fit"),
        ("link: chest, position: [0, 0, 0.1]", "link: upper_arm, position: [0, 0, 0.1]",
         RecordingError, "'chest_origin', 'chest_right'. don't fix its pose: at least 3"),
        ("[0, 0, 0.1]", "[0, 0.2, 0]", RecordingError, "not on one line"),
        ("link: wrist", "link: upper_arm", RecordingError, "leave the joints 'shoulder3', 'elbow'"),
    ],
)  # fmt: skip
def test_maps_that_do_not_fit_the_robot_are_refused_by_name(
    tmp_path: Path, before: str, after: str, error: type[PlannerError], message: str
) -> None:
    with pytest.raises(error, match=message):
        marker_source("/markers", URDF, changed_map(tmp_path, (before, after)))


@pytest.mark.parametrize("recording", ["02_05", "13_30"])
def test_people_are_measured_as_another_method_did(shared_data: Path, recording: str) -> None:
    folder = shared_data / "human_arm"
    q, found = solved(folder / "markers" / recording, marker_source("/markers", URDF, MAP))
    theirs = read_joint_states(folder / "joint_states" / recording, "/joint_states")
    assert theirs.joint_names == JOINTS
    np.testing.assert_array_equal(found.joint_states.header_stamps, theirs.header_stamps)
    rms = np.rad2deg(np.sqrt(np.mean((q - theirs.positions) ** 2, axis=0)))
    assert np.all(rms < 0.1)
    assert max(r.median for r in found.residuals.values()) < 2e-5


def build(capsys: pytest.CaptureFixture[str], *options: object) -> tuple[int, str, str]:
    status = main(["build_primitives", *map(str, options)])
    captured = capsys.readouterr()
    return status, captured.out, captured.err


def test_marker_recordings_become_a_primitive(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    places = {name: np.concatenate([p, p[::-1], p, p[::-1]]) for name, p in markers().items()}
    bag = write_marker_arrays(tmp_path / "session", places)
    bare = tmp_path / "empty"
    write_marker_arrays(bare, {"chest_origin": places["chest_origin"]})
    output = tmp_path / "reach.npz"
    options = ("--markers", "/markers", "--robot", URDF, "--marker-map", MAP, "--output", output)
    status, out, err = build(capsys, bag, bare, *options, "--json")
    assert status == 0, err
    facts = json.loads(out)
    assert facts["joint_names"] == list(JOINTS)
    assert facts["n_motions"] == 4
    assert facts["refused"][0]["recording"] == "empty"
    assert "no recorded marker is called 'chest_up'" in facts["refused"][0]["reason"]
    assert list(facts["marker_residuals"]) == ["session"]
    residuals = facts["marker_residuals"]["session"]
    assert list(residuals) == [*CHEST, *ARM]
    assert residuals["right_wrist"]["n_frames"] == 4 * N
    assert 0.0 <= residuals["right_wrist"]["median"] <= residuals["right_wrist"]["percentile_95"]
    status, out, _ = build(capsys, bag, *options, "--force")
    assert status == 0
    assert "distances of the markers from the model's, median and 95 % [mm]: '" in out


def test_options_for_markers_come_together(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = write_marker_arrays(tmp_path / "bag", markers())
    both = ("--robot", URDF, "--marker-map", MAP)
    for options in (
        ("--markers", "/markers", *both[:2]),
        ("--markers", "/markers", *both[2:]),
        both[2:],
        ("--markers", "/markers", *both, "--topic", "/joint_states"),
    ):
        status, _, err = build(capsys, bag, *options, "--output", tmp_path / "x.npz")
        assert status == 2 and "--markers" in err and not (tmp_path / "x.npz").exists()
