# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Demonstrations from CSV files, from LeRobot datasets and from arrays, beside the same in bags."""

from __future__ import annotations

import json
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from support import commands

import mp_pca_planner as mp
from mp_pca_planner.exceptions import PrimitiveError, RecordingError
from mp_pca_planner.recordings.bags import find_recordings, write_joint_states
from mp_pca_planner.recordings.demonstration import Demonstration
from mp_pca_planner.recordings.reading import inspect_recording
from mp_pca_planner.recordings.synthetic import JOINT_NAMES, continuous_recording, generate_motions

build = partial(commands.result, "build_primitives")
refusal = partial(commands.refusal, "build_primitives")
URDF = mp.config_file("human_arm.urdf")
RECORDING = continuous_recording(generate_motions(6, 1), seed=1)
SECONDS = (RECORDING.stamps - RECORDING.stamps[0]) / 1e9
FPS = 50.0


def write_csv(
    path: Path, names: Sequence[str] = JOINT_NAMES, positions: np.ndarray = RECORDING.positions
) -> Path:
    table = np.column_stack([SECONDS, positions])
    header = ",".join(["time", *names])
    np.savetxt(path, table, "%.12g", delimiter=",", header=header, comments="")
    return path


def assert_same(found: Sequence[Demonstration], expected: Sequence[Demonstration]) -> None:
    assert len(found) == len(expected) > 0
    for one, other in zip(found, expected, strict=True):
        assert one.joint_names == other.joint_names
        np.testing.assert_allclose(one.positions, other.positions, atol=1e-9)


# CSV


def test_a_csv_file_gives_the_motions_of_the_same_bag(tmp_path: Path) -> None:
    bag = tmp_path / "bag.mcap"
    write_joint_states(bag, "mcap", JOINT_NAMES, RECORDING.stamps, RECORDING.positions)
    expected = mp.load_demonstrations(bag)
    assert_same(mp.load_demonstrations(write_csv(tmp_path / "table.csv")), expected)
    named = [f"{name}.positions" for name in JOINT_NAMES]
    assert_same(mp.load_demonstrations(write_csv(tmp_path / "named.csv", named)), expected)
    degrees = write_csv(tmp_path / "deg.csv", positions=np.rad2deg(RECORDING.positions))
    found = mp.load_demonstrations(degrees, robot=URDF, degrees=True)
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one.positions, other.positions, atol=1e-6)


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


def test_a_trajectory_that_was_saved_is_a_table(tmp_path: Path) -> None:
    motion = mp.load_demonstrations(write_csv(tmp_path / "table.csv"))[0]
    zero = np.zeros_like(motion.positions)
    saved = mp.Trajectory(JOINT_NAMES, motion.times, motion.positions, zero, zero)
    saved.save(tmp_path / "motion.csv")
    (found,) = mp.load_demonstrations(tmp_path / "motion.csv")
    assert found.joint_names == JOINT_NAMES
    assert np.abs(found.positions[-1] - motion.positions[-1]).max() < 0.02


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("elbow,wrist\n1,2\n", "one of them the time [s] as one of 'time'"),
        ("time,elbow,phase\n1,2,reach\n", "'phase' holds text, 'reach'; choose the joints"),
        ("time,elbow_vel\n1,2\n", "no column of"),
        ("time,elbow\n1,2,3\n", "2 names in its first line, but 3 columns"),
        ("time,elbow\n1,x\n", "can't be read"),
        ("time,elbow\n0,1\ninf,2\n", "must be finite"),
        ("", "must name its columns"),
        ("time,elbow\n", "holds no samples"),
        ("time,a,a\n0,1,2\n1,2,3\n", "'a'"),
    ],
)
def test_a_table_that_is_none_is_refused_by_name(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "bad.csv").write_text(text, encoding="utf-8")
    with pytest.raises(RecordingError, match="bad") as refused:
        mp.load_demonstrations(tmp_path / "bad.csv")
    assert words in str(refused.value)


def test_an_empty_cell_is_an_unknown_number(tmp_path: Path) -> None:
    lines = write_csv(tmp_path / "gaps.csv").read_text().splitlines()
    for row, column in ((50, 1), (60, len(JOINT_NAMES))):
        cells = lines[row].split(",")
        cells[column] = ""
        lines[row] = ",".join(cells)
    texts = {"empty": "\n".join(lines), "nan": "\n".join(lines).replace(",,", ",nan,")}
    texts["nan"] = texts["nan"].replace(",\n", ",nan\n")
    found = []
    for name, text in texts.items():
        (tmp_path / f"{name}.csv").write_text(text)
        found.append(mp.load_demonstrations(tmp_path / f"{name}.csv").demonstrations)
    assert found[0] and len(found[0]) == len(found[1])
    for one, other in zip(*found, strict=True):
        np.testing.assert_array_equal(one.positions, other.positions)


@pytest.mark.parametrize(
    ("factor", "unit"), [(1e3, "milliseconds"), (1e6, "microseconds"), (1e9, "nanoseconds")]
)
def test_times_in_other_units_are_refused_by_name(tmp_path: Path, factor: float, unit: str) -> None:
    table = np.column_stack([factor * (1.78e9 + SECONDS), RECORDING.positions])
    header = ",".join(["time", *JOINT_NAMES])
    np.savetxt(tmp_path / "t.csv", table, "%.18g", delimiter=",", header=header, comments="")
    with pytest.raises(RecordingError, match=f"'t.csv' .* in seconds, and these look like {unit}"):
        mp.load_demonstrations(tmp_path / "t.csv")


def write_episodes(path: Path, column: str = "episode", restart: bool = False) -> Path:
    """One file of several motions with a column that numbers them."""
    lines = [",".join([column, "time", *JOINT_NAMES])]
    start = 0.0
    for k, motion in enumerate(generate_motions(5, 3)):
        rows = np.column_stack([start + motion.times, motion.positions])
        lines += [f"{k}," + ",".join(f"{x:.12g}" for x in row) for row in rows]
        start += 0.0 if restart else motion.duration + 0.01
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize("restart", [False, True])
@pytest.mark.parametrize("column", ["episode", "episode_index", "episode_id", "demo", "trial"])
def test_a_column_of_episodes_cuts_and_is_no_joint(
    tmp_path: Path, column: str, restart: bool
) -> None:
    table = write_episodes(tmp_path / "all.csv", column, restart)
    found = mp.load_demonstrations(table)
    motions = generate_motions(5, 3)
    assert [one.episode for one in found] == [0, 1, 2, 3, 4]
    assert "episode 3" in repr(found[3])
    for one, motion in zip(found, motions, strict=True):
        assert one.joint_names == JOINT_NAMES
        np.testing.assert_allclose(one.positions[[0, -1]], motion.positions[[0, -1]], atol=0.05)
    some = mp.load_demonstrations(table, episodes=[1, 4])
    assert [one.episode for one in some] == [1, 4]
    with pytest.raises(RecordingError, match="has no episode 7; its episodes: 0, 1"):
        mp.load_demonstrations(table, episodes=[7])


def test_episodes_are_chosen_from_tables_that_have_some(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="holds no episodes to choose from"):
        mp.load_demonstrations(write_csv(tmp_path / "one.csv"), episodes=[0])
    write_joint_states(
        tmp_path / "bag.mcap", "mcap", JOINT_NAMES, RECORDING.stamps, RECORDING.positions
    )
    with pytest.raises(RecordingError, match="a bag holds no episodes"):
        mp.load_demonstrations(tmp_path / "bag.mcap", episodes=[0])


@pytest.mark.parametrize(
    "others",
    [
        [f"{name}_vel" for name in JOINT_NAMES],
        ["elbow_velocity", "elbow/effort", "torque_elbow"],
        ["frame_index", "index", "task_index", "Unnamed: 0", "time_ms", ""],
        ["action.elbow", "action_shoulder1", "next.reward", "next.done"],
    ],
)
def test_columns_that_are_no_positions_are_no_joints(tmp_path: Path, others: list[str]) -> None:
    zeros = np.arange(SECONDS.size * len(others), dtype=float).reshape(-1, len(others))
    positions = np.column_stack([zeros, RECORDING.positions])
    table = write_csv(tmp_path / "t.csv", [*others, *JOINT_NAMES], positions)
    expected = mp.load_demonstrations(write_csv(tmp_path / "plain.csv"))
    found = mp.load_demonstrations(table)
    assert_same(found, expected)
    note = next(note for note in found.reports[0].notes if "not joint positions" in note)
    assert all(f"'{name}'" in note for name in others if name)


def test_joint_columns_are_named_as_in_lerobot(tmp_path: Path) -> None:
    expected = mp.load_demonstrations(write_csv(tmp_path / "plain.csv"))
    names = [f"observation.state.{name}.pos" for name in JOINT_NAMES]
    positions = np.column_stack([RECORDING.positions, RECORDING.positions])
    both = [*names, *(f"other.{name}" for name in JOINT_NAMES)]
    assert_same(mp.load_demonstrations(write_csv(tmp_path / "t.csv", both, positions)), expected)
    actions = [f"action.{name}" for name in JOINT_NAMES]
    (first, *_) = mp.load_demonstrations(write_csv(tmp_path / "a.csv", actions))
    assert first.joint_names == tuple(actions)
    rates = [f"q{k}" for k in range(4)] + [f"dq{k}" for k in range(4)]
    (first, *_) = mp.load_demonstrations(write_csv(tmp_path / "q.csv", rates, positions))
    assert first.joint_names == ("q0", "q1", "q2", "q3")


def test_the_joints_that_are_chosen_are_all_that_counts(tmp_path: Path) -> None:
    lines = write_csv(tmp_path / "plain.csv").read_text().splitlines()
    texts = [
        f"{line},{'a, b' if k else 'phase'}".replace("a, b", '"a, b"')
        for k, line in enumerate(lines)
    ]
    (tmp_path / "text.csv").write_text("\n".join(texts) + "\n", encoding="utf-8")
    found = mp.load_demonstrations(tmp_path / "text.csv", joints=JOINT_NAMES)
    assert_same(found, mp.load_demonstrations(tmp_path / "plain.csv", joints=JOINT_NAMES))
    named = ["elbow_vel", *JOINT_NAMES[1:]]
    (first, *_) = mp.load_demonstrations(write_csv(tmp_path / "v.csv", named), joints=named)
    assert first.joint_names == tuple(named)


def test_the_time_may_be_any_column(tmp_path: Path) -> None:
    lines = write_csv(tmp_path / "plain.csv").read_text().splitlines()
    last = [",".join([*line.split(",")[1:], line.split(",")[0]]) for line in lines]
    (tmp_path / "last.csv").write_text("\n".join(last) + "\n", encoding="utf-8")
    found = mp.load_demonstrations(tmp_path / "last.csv")
    assert_same(found, mp.load_demonstrations(tmp_path / "plain.csv"))


def test_what_is_not_used_is_warned_of_once_from_the_line_of_the_caller(tmp_path: Path) -> None:
    write_csv(tmp_path / "good.csv")
    (tmp_path / "bad.csv").write_text("time,elbow\n0,x\n", encoding="utf-8")
    with pytest.warns(UserWarning, match="1 of 2 recordings are rejected .*'bad'") as found:
        mp.load_demonstrations(tmp_path)
    assert [Path(one.filename).name for one in found] == ["test_tables.py"]
    assert "print(demonstrations.report)" in str(found[0].message)
    with pytest.raises(RecordingError, match="'joint' .did you mean 'joints'"):
        mp.load_demonstrations(tmp_path, joint=["elbow"])


def test_a_motion_that_is_cut_off_is_called_dropped(tmp_path: Path) -> None:
    speed = np.linalg.norm(np.gradient(RECORDING.positions, SECONDS, axis=0), axis=1)
    end = len(speed) // 2 + int(np.argmax(speed[len(speed) // 2 :]))
    table = np.column_stack([SECONDS, RECORDING.positions])[:end]
    header = ",".join(["time", *JOINT_NAMES])
    np.savetxt(tmp_path / "t.csv", table, delimiter=",", header=header, comments="")
    with pytest.warns(UserWarning, match="1 of .* motions are dropped"):
        found = mp.load_demonstrations(tmp_path / "t.csv")
    assert "dropped: 1 cut_off (an end of the recording" in found.report
    assert "repaired: 1 cut_off" not in found.report


def test_absurd_joints_and_times_are_warned_of(tmp_path: Path) -> None:
    share = np.linspace(0.0, 100.0, SECONDS.size)[:, None]
    gripper = write_csv(
        tmp_path / "g.csv", [*JOINT_NAMES, "gripper"], np.hstack([RECORDING.positions, share])
    )
    with pytest.warns(UserWarning, match="joint 'gripper' moves over .* absurd"):
        mp.load_demonstrations(gripper, segment="none")


def test_tables_beside_bags_are_no_recordings(tmp_path: Path) -> None:
    bag = tmp_path / "bag.mcap"
    write_joint_states(bag, "mcap", JOINT_NAMES, RECORDING.stamps, RECORDING.positions)
    (tmp_path / "bag_segments.csv").write_text("recording,start_time_s,end_time_s\n")
    assert len(mp.load_demonstrations(tmp_path).reports) == 1


# LeRobot


def write_dataset(
    folder: Path, version: str, names: object, *, column: str = "observation.state"
) -> list[np.ndarray]:
    """Write a dataset of LeRobot as its documentation describes it; returns the episodes."""
    arrow = pytest.importorskip("pyarrow", reason="pyarrow (extra 'lerobot') is not installed")
    from pyarrow import parquet

    motions = generate_motions(5, 3)
    episodes = [
        motion.at(np.arange(0.0, motion.duration, 1.0 / FPS)).astype(np.float32)
        for motion in motions
    ]
    is_old = version.startswith("v2")
    path = (
        "data/chunk-000/episode_{:06d}.parquet" if is_old else "data/chunk-000/file-{:03d}.parquet"
    )
    vector = {"dtype": "float32", "shape": [len(JOINT_NAMES)], "names": names}
    image = {"dtype": "video", "shape": [480, 640, 3], "names": ["height", "width", "channels"]}
    features = {column: vector, "observation.images.top": image}
    info = {"codebase_version": version, "fps": FPS, "data_path": path, "features": features}
    (folder / "meta").mkdir(parents=True)
    (folder / "meta/info.json").write_text(json.dumps(info), encoding="utf-8")
    (folder / "data/chunk-000").mkdir(parents=True)
    tables = [
        arrow.table(
            {
                column: arrow.array(list(q), arrow.list_(arrow.float32(), len(JOINT_NAMES))),
                "timestamp": np.arange(len(q), dtype=np.float32) / np.float32(FPS),
                "frame_index": np.arange(len(q)),
                "episode_index": np.full(len(q), k),
            }
        )
        for k, q in enumerate(episodes)
    ]
    if not is_old:  # several episodes in a file
        tables = [arrow.concat_tables(tables[:2]), arrow.concat_tables(tables[2:])]
    for k, table in enumerate(tables):
        parquet.write_table(table, folder / path.format(k))
    return episodes


@pytest.mark.parametrize("version", ["v2.1", "v3.0"])
@pytest.mark.parametrize(
    "names", [[f"{name}.pos" for name in JOINT_NAMES], {"motors": list(JOINT_NAMES)}]
)
def test_each_episode_of_a_dataset_is_a_motion(tmp_path: Path, version: str, names: object) -> None:
    episodes = write_dataset(tmp_path / "set", version, names)
    found = mp.load_demonstrations(tmp_path / "set", robot=URDF)
    assert len(found) == len(episodes) and found.repairs == {}
    for one, q in zip(found, episodes, strict=True):
        assert one.joint_names == JOINT_NAMES
        times = np.arange(len(q)) / FPS
        nearest = [np.abs(q - position).max(axis=1).min() for position in one.positions[::10]]
        assert max(nearest) < 0.05 and one.duration <= times[-1] + 1e-6


def test_a_dataset_is_built_and_inspected(tmp_path: Path) -> None:
    episodes = write_dataset(tmp_path / "set", "v3.0", None, column="action")
    options = ("--output", tmp_path / "reach.npz", "--topic", "action")
    assert "doesn't name the 4 values of 'action'" in refusal(tmp_path / "set", *options)
    names = ("--joints", ",".join(JOINT_NAMES))
    facts = build(tmp_path / "set", *options, *names)
    assert facts["n_motions"] == len(episodes)
    assert "doesn't name" in facts["notes"]["set"][0]
    assert "no column of numbers is called 'observation.state'" in str(
        inspect_recording(tmp_path / "set").refusal
    )


def test_episodes_that_a_dataset_lacks_are_noted(tmp_path: Path) -> None:
    write_dataset(tmp_path / "set", "v2.1", list(JOINT_NAMES))
    info = json.loads((tmp_path / "set/meta/info.json").read_text())
    (tmp_path / "set/meta/info.json").write_text(json.dumps(info | {"total_episodes": 5}))
    assert "missing" not in mp.load_demonstrations(tmp_path / "set").report
    (tmp_path / "set/data/chunk-000/episode_000002.parquet").unlink()
    found = mp.load_demonstrations(tmp_path / "set")
    assert "1 of the 5 episodes" in found.report and "missing in the data: 2;" in found.report
    assert [one.episode for one in found] == [0, 1, 3, 4]
    assert [x.episode for x in mp.load_demonstrations(tmp_path / "set", episodes=[3])] == [3]


def test_values_of_a_dataset_that_are_no_positions_are_no_joints(tmp_path: Path) -> None:
    names = ["a.pos", "b.pos", "c.pos", "d.vel"]
    write_dataset(tmp_path / "set", "v2.1", names)
    found = mp.load_demonstrations(tmp_path / "set")
    assert found[0].joint_names == ("a", "b", "c")
    assert "not joint positions: 'd.vel'" in found.report


def test_a_folder_of_datasets_is_searched(tmp_path: Path) -> None:
    for name in ("one", "two"):
        write_dataset(tmp_path / name, "v2.1", list(JOINT_NAMES))
    (tmp_path / "two/meta/info.json").write_text(
        (tmp_path / "two/meta/info.json").read_text().replace("v2.1", "v1.6"), encoding="utf-8"
    )
    found = mp.load_demonstrations(tmp_path)
    assert [one.name for one in found.reports] == ["one"]
    assert "version 'v1.6': expected v2.0, v2.1 or v3.0" in found.refused[0].reason


# Arrays


def test_arrays_become_the_motion_that_a_bag_of_them_gives(tmp_path: Path) -> None:
    motion = generate_motions(1, 5)[0]
    found = Demonstration.from_arrays(motion.joint_names, motion.times + 3.0, motion.positions)
    assert found.times[0] == 0.0 and found.duration == pytest.approx(motion.duration, abs=0.01)
    np.testing.assert_allclose(found.at(motion.times[5:-5]), motion.positions[5:-5], atol=0.02)
    again = Demonstration.from_arrays(motion.joint_names, motion.times + 3.0, motion.positions)
    assert again.checksum == found.checksum != ""


def test_a_primitive_of_arrays_is_that_of_their_demonstrations() -> None:
    motions = generate_motions(5, 5)
    names, arrays = motions[0].joint_names, [motion.positions for motion in motions]
    times = [motion.times for motion in motions]
    found = mp.MovementPrimitive.fit(arrays, times=times, joint_names=names)
    several = [Demonstration.from_arrays(names, *one) for one in zip(times, arrays, strict=True)]
    expected = mp.MovementPrimitive.fit(several)
    np.testing.assert_array_equal(found.component_coefficients, expected.component_coefficients)
    block = np.array([motion.time_normalised(51) for motion in motions])
    shared = mp.MovementPrimitive.fit(block, times=np.linspace(0.0, 1.0, 51))
    assert shared.joint_names == ("joint1", "joint2", "joint3", "joint4")


class Frame(dict[str, np.ndarray]):
    """Named columns, as a DataFrame has them."""

    @property
    def columns(self) -> list[str]:
        return list(self)


def test_columns_of_tables_name_the_joints() -> None:
    motions = generate_motions(5, 5)
    times = [motion.times for motion in motions]
    names = list(motions[0].joint_names)
    frames = [Frame(zip(names, motion.positions.T, strict=True)) for motion in motions]
    found = mp.MovementPrimitive.fit(frames, times=times)
    expected = mp.MovementPrimitive.fit(
        [motion.positions for motion in motions], times=times, joint_names=names
    )
    assert found.joint_names == expected.joint_names
    np.testing.assert_array_equal(found.component_coefficients, expected.component_coefficients)
    timed = [Frame({"time": t, **frame}) for t, frame in zip(times, frames, strict=True)]
    with pytest.raises(PrimitiveError, match=r"'time' of motion 1 is not a joint: pass times=\["):
        mp.MovementPrimitive.fit(timed, times=times)
    again = mp.MovementPrimitive.fit(timed, times=times, joint_names=names[::-1])
    assert again.joint_names == tuple(names[::-1])
    frames[1].pop("elbow")
    with pytest.raises(PrimitiveError, match="motion 2: no column is called 'elbow'"):
        mp.MovementPrimitive.fit(frames, times=times)


@pytest.mark.parametrize(
    ("motions", "words"),
    [
        ({"a": np.zeros((9, 2))}, "list\\(motions.values"),
        ("folder/", "load_demonstrations reads"),
        (np.zeros((9, 2)), "is one motion"),
        ([Frame(a=np.zeros(9))], None),
    ],
)
def test_what_is_no_list_of_motions_is_refused_in_a_sentence(motions: object, words: str) -> None:
    if words is not None:
        with pytest.raises(PrimitiveError, match=words):
            mp.MovementPrimitive.fit(motions, times=np.arange(9.0))
    else:
        with pytest.raises(PrimitiveError, match="arrays need times="):
            mp.MovementPrimitive.fit(motions)


def test_arrays_are_warned_of_once_from_the_line_of_the_caller() -> None:
    motions = generate_motions(5, 5)
    arrays = [motion.positions for motion in motions]
    milliseconds = [1000.0 * motion.times for motion in motions]
    with pytest.warns(UserWarning, match="'motion 1' .* look like milliseconds") as found:
        mp.MovementPrimitive.fit(arrays, times=milliseconds)
    assert [Path(one.filename).name for one in found] == ["test_tables.py"]
    cut = [array[len(array) // 3 : -len(array) // 3] for array in arrays]
    with pytest.warns(UserWarning, match="5 of 5 motions begin or end while they move") as found:
        mp.MovementPrimitive.fit(cut, times=[0.01 * np.arange(len(one)) for one in cut])
    assert len(found) == 1


def by_share_of_path(q: np.ndarray) -> np.ndarray:
    """Positions at the shares of a minimum-jerk motion of the path."""
    path = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(q, axis=0), axis=1)))
    s = np.linspace(0.0, 1.0, 101)
    shares = 10 * s**3 - 15 * s**4 + 6 * s**5
    return np.column_stack([np.interp(shares, path / path[-1], x) for x in q.T])


def test_held_out_errors_are_distances_of_paths() -> None:
    motions = generate_motions(12, 5)
    reach = mp.MovementPrimitive.fit(motions[1:])
    start, goal = motions[0].positions[[0, -1]]
    expected = [
        by_share_of_path(x.positions)
        for x in (motions[0], reach.predict(start, goal, motions[0].duration))
    ]
    expected = np.sqrt(np.mean(np.subtract(*expected) ** 2))
    np.testing.assert_allclose(reach.errors(motions[:1]), expected, rtol=0.02)
    arrays = reach.errors([motions[0].positions], times=[motions[0].times])
    np.testing.assert_allclose(arrays, expected, rtol=0.2)
    other = Demonstration.from_arrays(list("abcd"), motions[0].times, motions[0].positions)
    with pytest.raises(PrimitiveError, match="not those of primitive"):
        reach.errors([other])
    with pytest.raises(PrimitiveError, match="arrays need times="):
        reach.errors([motions[0].positions])


def test_a_trajectory_is_a_table_of_flat_columns(tmp_path: Path) -> None:
    zero = np.zeros((2, 1))
    motion = mp.Trajectory(["elbow"], [0.0, 1.0], [[0.0], [0.5]], zero, zero)
    names = ["time", "elbow.positions", "elbow.velocities", "elbow.accelerations"]
    motion.save(tmp_path / "m.csv")
    assert (tmp_path / "m.csv").read_text().splitlines()[0] == ",".join(names)


def test_arrays_in_degrees_are_refused() -> None:
    motions = generate_motions(5, 5)
    degrees = [np.rad2deg(motion.positions) for motion in motions]
    times = [motion.times for motion in motions]
    with pytest.raises(PrimitiveError, match=r"joint 'joint\d' moves over .* numpy\.deg2rad"):
        mp.MovementPrimitive.fit(degrees, times=times)


def test_a_primitive_says_how_well_it_predicts_and_for_which_goals() -> None:
    motions = generate_motions(12, 5)
    reach = mp.MovementPrimitive.fit(motions)
    facts, text = reach.summary(), str(reach)
    assert 0.0 < facts["left_out_error"] < 0.9 * facts["minimum_jerk_error"]
    goals = np.array([motion.positions[-1] for motion in motions])
    found = np.array([facts["goals"][name] for name in reach.joint_names]).T
    np.testing.assert_allclose(found, [goals.min(axis=0), goals.max(axis=0)], atol=1e-9)
    assert f"left-out motions: {facts['left_out_error']:.3g} rad" in text
    assert all(f"  {name}: starts " in text for name in reach.joint_names)
    assert len(repr(reach.model)) < 100


def test_a_folder_of_tables_is_a_set_of_recordings(tmp_path: Path) -> None:
    for name in ("a.csv", "b.csv"):
        write_csv(tmp_path / name)
    assert [path.name for path in find_recordings(str(tmp_path))] == ["a.csv", "b.csv"]
    stamps, positions = RECORDING.stamps, RECORDING.positions
    write_joint_states(tmp_path / "bag.mcap", "mcap", JOINT_NAMES, stamps, positions)
    assert [path.name for path in find_recordings(str(tmp_path))] == ["bag.mcap"]


@pytest.mark.parametrize(
    ("times", "positions", "words"),
    [
        ([0.0, 1.0, 0.5, 2.0, 3.0], np.zeros((5, 2)), "strictly increase, but at index 2 0.5 s"),
        ([0.0, 1.0], np.zeros((2, 2)), "2 samples: 5 or more"),
        (np.arange(6.0), np.zeros((5, 2)), "positions of 'arrays'"),
        (np.arange(5.0), np.full((5, 2), np.nan), "positions of 'arrays'"),
    ],
)
def test_arrays_that_are_no_motion_are_refused(
    times: object, positions: np.ndarray, words: str
) -> None:
    with pytest.raises(RecordingError, match=words):
        Demonstration.from_arrays(["a", "b"], times, positions)


def test_arrays_without_times_are_refused_in_one_sentence() -> None:
    with pytest.raises(PrimitiveError, match="arrays need times="):
        mp.MovementPrimitive.fit([np.zeros((5, 2))])
    with pytest.raises(PrimitiveError, match=r"^primitive 'primitive' can't be built: arrays"):
        mp.MovementPrimitive.fit(np.zeros((3, 5, 2)))
    with pytest.raises(PrimitiveError, match="1 motions, but 2 arrays of times"):
        mp.MovementPrimitive.fit([np.zeros((5, 2))], times=[np.arange(5.0)] * 2)
