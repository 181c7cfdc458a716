# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Demonstrations from CSV files, from LeRobot datasets and from arrays, beside the same in bags."""

from __future__ import annotations

import json
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support import commands
from support.datasets import write_dataset

import mp_pca_planner as mp
from mp_pca_planner.exceptions import PrimitiveError, RecordingError
from mp_pca_planner.recordings.bags import find_recordings, write_joint_states
from mp_pca_planner.recordings.demonstration import Demonstration
from mp_pca_planner.recordings.synthetic import JOINT_NAMES, continuous_recording, generate_motions

build = partial(commands.result, "build_primitives")
refusal = partial(commands.refusal, "build_primitives")
URDF = mp.config_file("human_arm.urdf")
MOTIONS = generate_motions(5, 3)
RECORDING = continuous_recording(generate_motions(6, 1), seed=1)
SECONDS = (RECORDING.stamps - RECORDING.stamps[0]) / 1e9
FPS = 50.0
EPISODES = [x.at(np.arange(0.0, x.duration, 1.0 / FPS)) for x in MOTIONS]


def write_csv(
    path: Path,
    names: Sequence[str] = JOINT_NAMES,
    positions: np.ndarray = RECORDING.positions,
    times: np.ndarray = SECONDS,
) -> Path:
    table = np.column_stack([times, positions])
    header = ",".join(["time", *names])
    np.savetxt(path, table, "%.18g", delimiter=",", header=header, comments="")
    return path


def write_bag(path: Path) -> Path:
    write_joint_states(path, "mcap", JOINT_NAMES, RECORDING.stamps, RECORDING.positions)
    return path


@pytest.fixture(scope="module")
def expected(tmp_path_factory: pytest.TempPathFactory) -> Sequence[Demonstration]:
    """The motions of a bag with the recording of the tables."""
    return mp.load_demonstrations(write_bag(tmp_path_factory.mktemp("bag") / "bag.mcap"))


def assert_same(found: Sequence[Demonstration], expected: Sequence[Demonstration]) -> None:
    assert len(found) == len(expected) > 0
    for one, other in zip(found, expected, strict=True):
        assert one.joint_names == other.joint_names
        np.testing.assert_allclose(one.positions, other.positions, atol=1e-6)


# CSV


def test_a_csv_file_gives_the_motions_of_the_same_bag(
    expected: Sequence[Demonstration], tmp_path: Path
) -> None:
    table = write_csv(tmp_path / "table.csv")
    assert_same(mp.load_demonstrations(table), expected)
    columns = [line.split(",") for line in table.read_text().splitlines()]
    table.write_text("\n".join(",".join([*line[1:], line[0]]) for line in columns))
    assert_same(mp.load_demonstrations(table), expected)  # the time may be any column
    table.write_text(
        "\n".join(",".join([*x, '"a, b"' if k else "phase"]) for k, x in enumerate(columns))
    )
    assert_same(mp.load_demonstrations(table, joints=JOINT_NAMES), expected)
    degrees = write_csv(tmp_path / "deg.csv", positions=np.rad2deg(RECORDING.positions))
    assert_same(mp.load_demonstrations(degrees, robot=URDF, degrees=True), expected)


@pytest.mark.parametrize(
    ("others", "form"),
    [
        (["elbow_vel", "elbow/effort", "torque_elbow"], "{}.positions"),
        (["frame_index", "Unnamed: 0", "time_ms", ""], "{}"),
        (["action.elbow", "action_shoulder1", "next.reward"], "{}"),
        ([f"other.{name}" for name in JOINT_NAMES], "observation.state.{}.pos"),
        (["joint_vel_1", "vel2", "actual_current_0", "actual_TCP_pose_0", "target_q_0"], "{}"),
    ],
)
def test_columns_that_are_no_positions_are_no_joints(
    expected: Sequence[Demonstration], tmp_path: Path, others: list[str], form: str
) -> None:
    ramps = np.arange(SECONDS.size * len(others), dtype=float).reshape(-1, len(others))
    names = [*others, *(form.format(name) for name in JOINT_NAMES)]
    table = write_csv(tmp_path / "t.csv", names, np.column_stack([ramps, RECORDING.positions]))
    found = mp.load_demonstrations(table)
    assert_same(found, expected)
    note = next(note for note in found.reports[0].notes if "not joint positions" in note)
    assert all(f"'{name}'" in note for name in others if name)


def test_a_table_of_the_rtde_client_of_ur_is_read(
    expected: Sequence[Demonstration], tmp_path: Path
) -> None:
    # Its record.py separates columns by blanks.
    names = [f"actual_{q}_{k}" for q in ("q", "qd") for k in range(len(JOINT_NAMES))]
    values = np.column_stack([RECORDING.positions, np.zeros_like(RECORDING.positions)])
    table = write_csv(tmp_path / "t.csv", names, values)
    table.write_text(table.read_text().replace(",", " ").replace("time", "timestamp"))
    found = mp.load_demonstrations(table)
    assert found[0].joint_names == tuple(names[: len(JOINT_NAMES)])
    rename = {f"actual_q_{k}": name for k, name in enumerate(JOINT_NAMES)}
    assert_same(mp.load_demonstrations(table, rename=rename), expected)


def test_a_csv_file_is_built_inspected_and_refused_in_degrees(tmp_path: Path) -> None:
    table, output = write_csv(tmp_path / "table.csv"), tmp_path / "reach.npz"
    facts = build(table, "--robot", URDF, "--output", output)
    assert facts["joint_names"] == list(JOINT_NAMES)
    (found,) = commands.result("inspect", table)["files"]
    assert (found["format"], found["joint_names"]) == ("csv", list(JOINT_NAMES))
    degrees = write_csv(tmp_path / "deg.csv", positions=np.rad2deg(RECORDING.positions))
    words = (degrees, "--robot", URDF, "--output", tmp_path / "deg.npz")
    assert "not in degrees" in refusal(*words)
    assert build(*words, "--degrees")["n_motions"] == facts["n_motions"]
    name = JOINT_NAMES[0]
    options = ("--degrees", "--rename", f"{name}=first", "--scale", "first=-0.01745")
    (found,) = commands.result("inspect", degrees, *options)["files"]
    assert found["refusal"] is None and found["joint_names"] == ["first", *JOINT_NAMES[1:]]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("elbow,wrist\n1,2\n", "one of them the time [s] as one of 'time'"),
        ("time,elbow,phase\n1,2,reach\n", "'phase' holds text, 'reach'; choose the joints"),
        ("time,elbow\n1,2,3\n", "it has 2 names, 'time,elbow', and 3 values, '1,2,3'"),
        ("time,elbow\n0,1\ninf,2\n", "must be finite"),
    ],
)
def test_a_table_that_is_none_is_refused_by_name(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "bad.csv").write_text(text, encoding="utf-8")
    with pytest.raises(RecordingError, match="bad") as refused:
        mp.load_demonstrations(tmp_path / "bad.csv")
    assert words in str(refused.value)


@pytest.mark.parametrize(("factor", "unit"), [(1e3, "milliseconds"), (1e9, "nanoseconds")])
def test_times_in_other_units_are_refused_by_name(tmp_path: Path, factor: float, unit: str) -> None:
    write_csv(tmp_path / "t.csv", times=factor * (1.78e9 + SECONDS))
    with pytest.raises(RecordingError, match=f"'t.csv' .* in seconds, and these look like {unit}"):
        mp.load_demonstrations(tmp_path / "t.csv")


def test_an_empty_cell_is_an_unknown_number(tmp_path: Path) -> None:
    found = []
    for name in ("", "nan"):
        lines = [line.split(",") for line in write_csv(tmp_path / "t.csv").read_text().splitlines()]
        lines[50][1] = lines[60][-1] = name
        (tmp_path / "t.csv").write_text("\n".join(map(",".join, lines)))
        found.append(mp.load_demonstrations(tmp_path / "t.csv"))
    assert_same(*found)


@pytest.mark.parametrize(("column", "restart"), [("episode_index", False), ("trial", True)])
def test_a_column_of_episodes_cuts_and_is_no_joint(
    tmp_path: Path, column: str, restart: bool
) -> None:
    lines, start = [",".join([column, "time", *JOINT_NAMES])], 0.0
    for k, motion in enumerate(MOTIONS):
        rows = np.column_stack([start + motion.times, motion.positions])
        lines += [f"{k}," + ",".join(f"{x:.12g}" for x in row) for row in rows]
        start += 0.0 if restart else motion.duration + 0.01
    table = tmp_path / "all.csv"
    table.write_text("\n".join(lines) + "\n", encoding="utf-8")
    found = mp.load_demonstrations(table)
    assert [one.episode for one in found] == [0, 1, 2, 3, 4]
    assert "episode 3" in repr(found[3])
    for one, motion in zip(found, MOTIONS, strict=True):
        assert one.joint_names == JOINT_NAMES
        np.testing.assert_allclose(one.positions[[0, -1]], motion.positions[[0, -1]], atol=0.05)
    assert [one.episode for one in mp.load_demonstrations(table, episodes=[1, 4])] == [1, 4]
    others = ((table, 7, "has no episode 7; its episodes: 0, 1"),)
    others += ((write_csv(tmp_path / "one.csv"), 0, "holds no episodes to choose from"),)
    others += ((write_bag(tmp_path / "bag.mcap"), 0, "a bag holds no episodes"),)
    for path, episode, words in others:
        with pytest.raises(RecordingError, match=words):
            mp.load_demonstrations(path, episodes=[episode])


def test_what_is_not_used_is_warned_of_once_from_the_line_of_the_caller(tmp_path: Path) -> None:
    write_csv(tmp_path / "good.csv")
    (tmp_path / "bad.csv").write_text("time,elbow\n0,x\n", encoding="utf-8")
    with pytest.warns(UserWarning, match="1 of 2 recordings are rejected .*'bad'") as found:
        mp.load_demonstrations(tmp_path)
    assert [Path(one.filename).name for one in found] == ["test_tables.py"]
    assert "print(demonstrations.report)" in str(found[0].message)
    with pytest.raises(RecordingError, match="'joint' .did you mean 'joints'"):
        mp.load_demonstrations(tmp_path, joint=["elbow"])


def test_a_motion_that_is_cut_off_and_an_absurd_joint_are_warned_of(tmp_path: Path) -> None:
    speed = np.linalg.norm(np.gradient(RECORDING.positions, SECONDS, axis=0), axis=1)
    end = len(speed) // 2 + int(np.argmax(speed[len(speed) // 2 :]))
    write_csv(tmp_path / "t.csv", positions=RECORDING.positions[:end], times=SECONDS[:end])
    with pytest.warns(UserWarning, match="1 of .* motions are dropped"):
        found = mp.load_demonstrations(tmp_path / "t.csv")
    assert "dropped: 1 cut_off in 1 of 1 recording(s) (motion dropped: an end" in found.report
    assert "repaired: 1 cut_off" not in found.report
    share = np.linspace(0.0, 100.0, SECONDS.size)[:, None]
    write_csv(
        tmp_path / "g.csv", [*JOINT_NAMES, "gripper"], np.hstack([RECORDING.positions, share])
    )
    with pytest.warns(UserWarning, match="joint 'gripper' moves over .* absurd"):
        mp.load_demonstrations(tmp_path / "g.csv", segment="none")


def test_tables_are_recordings_where_no_bag_is_beside_them(tmp_path: Path) -> None:
    for name in ("a.csv", "b.csv"):
        write_csv(tmp_path / name)
    assert [path.name for path in find_recordings(str(tmp_path))] == ["a.csv", "b.csv"]
    write_bag(tmp_path / "bag.mcap")
    assert [path.name for path in find_recordings(str(tmp_path))] == ["bag.mcap"]


# LeRobot


@pytest.mark.parametrize(
    ("version", "names"),
    [("v2.1", [f"{name}.pos" for name in JOINT_NAMES]), ("v3.0", {"motors": list(JOINT_NAMES)})],
)
def test_each_episode_of_a_dataset_is_a_motion(tmp_path: Path, version: str, names: object) -> None:
    write_dataset(tmp_path / "set", EPISODES, names, version=version)
    found = mp.load_demonstrations(tmp_path / "set", robot=URDF)
    assert len(found) == len(EPISODES) and found.repairs == {}
    assert "missing" not in found.report
    for one, q in zip(found, EPISODES, strict=True):
        assert one.joint_names == JOINT_NAMES
        nearest = [np.abs(q - position).max(axis=1).min() for position in one.positions[::10]]
        assert max(nearest) < 0.05 and one.duration <= (len(q) - 1) / FPS + 1e-6


def test_a_dataset_is_built_and_inspected(tmp_path: Path) -> None:
    write_dataset(tmp_path / "set", EPISODES, None, columns=["action"])
    options = ("--output", tmp_path / "reach.npz", "--topic", "action")
    assert "names of the 4 values of 'action' are none" in refusal(tmp_path / "set", *options)
    facts = build(tmp_path / "set", *options, "--joints", ",".join(JOINT_NAMES))
    assert facts["n_motions"] == len(EPISODES)
    assert "of 'action' are none" in facts["notes"]["set"][0]
    status, out, _ = commands.run("inspect", tmp_path / "set", "--json")
    (found,) = json.loads(out)["files"]
    assert status == 2 and "no column of numbers is called 'observation.state'" in found["refusal"]


def test_what_a_dataset_lacks_and_what_is_not_read_of_it_is_noted(tmp_path: Path) -> None:
    for name in ("one", "two"):
        write_dataset(
            tmp_path / name, EPISODES, ["a.pos", "b.pos", "c.pos", "d.vel"], version="v2.1"
        )
    info = tmp_path / "two/meta/info.json"
    info.write_text(info.read_text().replace("v2.1", "v1.6"), encoding="utf-8")
    (tmp_path / "one/data/chunk-000/episode_000002.parquet").unlink()
    found = mp.load_demonstrations(tmp_path)
    assert [one.name for one in found.reports] == ["one"]
    assert "version 'v1.6': expected v2.0, v2.1 or v3.0" in found.refused[0].reason
    assert "1 of the 5 episodes" in found.report and "missing in the data: 2;" in found.report
    assert found[0].joint_names == ("a", "b", "c")
    assert "not joint positions: 'd.vel'" in found.report
    assert [one.episode for one in found] == [0, 1, 3, 4]
    assert [x.episode for x in mp.load_demonstrations(tmp_path / "one", episodes=[3])] == [3]


def test_a_damaged_file_costs_its_own_episodes(tmp_path: Path) -> None:
    write_dataset(tmp_path / "set", EPISODES, list(JOINT_NAMES), version="v2.1")
    file = tmp_path / "set/data/chunk-000/episode_000002.parquet"
    file.write_bytes(file.read_bytes()[:500])
    found = mp.load_demonstrations(tmp_path / "set")
    assert [one.episode for one in found] == [0, 1, 3, 4]
    assert "left out: " in found.report and file.name in found.report
    assert "missing in the data: 2;" in found.report
    with pytest.raises(RecordingError, match=r"episode_000002\.parquet"):
        mp.load_demonstrations(tmp_path / "set", episodes=[2])
    # Of a file without a chosen episode, only the footer is read.
    other = file.with_stem("episode_000004")
    other.write_bytes(b"PAR1" + bytes(300) + other.read_bytes()[304:])
    assert other.name in mp.load_demonstrations(tmp_path / "set").report
    chosen = mp.load_demonstrations(tmp_path / "set", episodes=[3, 1, 3])
    assert [one.episode for one in chosen] == [1, 3] and other.name not in chosen.report


# Arrays


def test_arrays_become_the_motion_that_a_bag_of_them_gives() -> None:
    motion = MOTIONS[0]
    found, again = (
        Demonstration.from_arrays(motion.joint_names, motion.times + 3.0, motion.positions)
        for _ in range(2)
    )
    assert found.times[0] == 0.0 and found.duration == pytest.approx(motion.duration, abs=0.01)
    np.testing.assert_allclose(found.at(motion.times[5:-5]), motion.positions[5:-5], atol=0.02)
    assert again.checksum == found.checksum != ""


class Frame(dict[str, np.ndarray]):
    """Named columns, as a DataFrame has them."""

    @property
    def columns(self) -> list[str]:
        return list(self)


TIMES = [motion.times for motion in MOTIONS]
ARRAYS = [motion.positions for motion in MOTIONS]
FRAMES = [
    Frame({"time": x.times, **dict(zip(x.joint_names, x.positions.T, strict=True))})
    for x in MOTIONS
]


def test_a_primitive_of_arrays_or_columns_is_that_of_their_demonstrations() -> None:
    names = list(MOTIONS[0].joint_names)
    several = [Demonstration.from_arrays(names, *one) for one in zip(TIMES, ARRAYS, strict=True)]
    expected = mp.MovementPrimitive.fit(several)
    frames = [Frame({name: frame[name] for name in names}) for frame in FRAMES]
    for motions, chosen in ((ARRAYS, names), (frames, None), (FRAMES, names)):
        found = mp.MovementPrimitive.fit(motions, times=TIMES, joint_names=chosen)
        assert found.joint_names == expected.joint_names
        np.testing.assert_array_equal(found.component_coefficients, expected.component_coefficients)
    turned = mp.MovementPrimitive.fit(FRAMES, times=TIMES, joint_names=names[::-1])
    assert turned.joint_names == tuple(names[::-1])
    block = np.array([motion.time_normalised(51) for motion in MOTIONS])
    shared = mp.MovementPrimitive.fit(block, times=np.linspace(0.0, 1.0, 51))
    assert shared.joint_names == ("joint1", "joint2", "joint3", "joint4")


@pytest.mark.parametrize(
    ("motions", "times", "words"),
    [
        (FRAMES, TIMES, r"'time' of motion 1 is not a joint: pass times=\["),
        (
            [Frame(a=np.zeros(9), b=np.zeros(9)), Frame(a=np.zeros(9))],
            [np.arange(9.0)] * 2,
            "motion 2: no column",
        ),
        ({"a": np.zeros((9, 2))}, np.arange(9.0), r"list\(motions.values"),
        ("folder/", np.arange(9.0), "load_demonstrations reads"),
        (ARRAYS, None, "arrays need times="),
        (np.zeros((3, 5, 2)), None, "a ndarray is not a demonstration: .* arrays need"),
        ([np.rad2deg(x) for x in ARRAYS], TIMES, r"joint 'joint\d' moves over .* numpy\.deg2rad"),
    ],
)
def test_what_is_no_list_of_motions_is_refused(motions: Any, times: Any, words: str) -> None:
    with pytest.raises(PrimitiveError, match=words):
        mp.MovementPrimitive.fit(motions, times=times)


def test_arrays_that_are_cut_are_warned_of_once_from_the_line_of_the_caller() -> None:
    cut = [array[len(array) // 3 : -len(array) // 3] for array in ARRAYS]
    with pytest.warns(UserWarning, match="5 of 5 motions begin or end while they move") as found:
        mp.MovementPrimitive.fit(cut, times=[0.01 * np.arange(len(one)) for one in cut])
    assert [Path(one.filename).name for one in found] == ["test_tables.py"]


@pytest.mark.parametrize(
    ("times", "positions", "words"),
    [
        ([0.0, 1.0, 0.5, 2.0, 3.0], np.zeros((5, 2)), "strictly increase, but at index 2 0.5 s"),
        (np.arange(6.0), np.zeros((5, 2)), "positions of 'arrays'"),
    ],
)
def test_arrays_that_are_no_motion_are_refused(
    times: object, positions: np.ndarray, words: str
) -> None:
    with pytest.raises(RecordingError, match=words):
        Demonstration.from_arrays(["a", "b"], times, positions)
