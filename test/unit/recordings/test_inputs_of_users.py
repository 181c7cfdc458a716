# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Inputs that users report: names, units, clocks and files of other programs."""

from __future__ import annotations

import json
import re
import sys
import tracemalloc
from collections.abc import Sequence
from inspect import signature
from pathlib import Path

import numpy as np
import pytest
from backports import zstd
from hypothesis import given
from hypothesis import strategies as st
from support.bags import Message, write_bag
from support.datasets import write_dataset

import mp_pca_planner as mp
from mp_pca_planner.exceptions import PlannerError, RecordingError
from mp_pca_planner.recordings.bags import write_joint_states
from mp_pca_planner.recordings.load import full_turns
from mp_pca_planner.recordings.reading import inspect_recording
from mp_pca_planner.renaming import new_name, read_rename

RATE = 50
NAMES = ("a", "b", "c")


def reaches(n: int = 6, seed: int = 0, joints: int = 3) -> list[np.ndarray]:
    """Minimum-jerk reaches of 2 s at 50 Hz, back and forth [rad]."""
    rng = np.random.default_rng(seed)
    here, found = np.full(joints, 0.1), []
    s = np.linspace(0.0, 1.0, 2 * RATE)[:, None]
    for k in range(n):
        goal = (0.1 if k % 2 else 1.0) + rng.normal(0.0, 0.05, joints)
        found.append(here + (goal - here) * (10 * s**3 - 15 * s**4 + 6 * s**5))
        here = goal
    return found


def rested(motions: Sequence[np.ndarray], seconds: float = 1.0) -> np.ndarray:
    """The motions one after the other, each after a rest, with a rest at the end."""
    rest = round(seconds * RATE)
    parts = [x for q in motions for x in (np.repeat(q[:1], rest, 0), q)]
    return np.vstack([*parts, np.repeat(motions[-1][-1:], rest, 0)])


def stamps(n: int, start: float = 1.78e9) -> np.ndarray:
    return (start * 1e9 + np.arange(n) * 1e9 / RATE).astype(np.int64)


def write_csv(path: Path, names: Sequence[str], episodes: Sequence[np.ndarray]) -> Path:
    lines = [",".join(["time", "episode", *names])]
    for k, q in enumerate(episodes):
        lines += [f"{i / RATE:.3f},{k}," + ",".join(map(repr, x)) for i, x in enumerate(q.tolist())]
    path.write_text("\n".join(lines) + "\n")
    return path


def write_urdf(path: Path, *joints: tuple[str, str, str]) -> Path:
    """A chain of joints (name, type, attributes of the limit)."""
    inertial = (
        '<inertial><mass value="1"/><origin xyz="0 0 0.1"/>'
        '<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial>'
    )
    parts = ['<robot name="arm"><link name="l0"/>']
    for k, (name, kind, limit) in enumerate(joints):
        parts.append(
            f'<link name="l{k + 1}">{inertial}</link><joint name="{name}" type="{kind}">'
            f'<parent link="l{k}"/><child link="l{k + 1}"/><origin xyz="0 0 0.3"/>'
            f'<axis xyz="0 1 0"/><limit {limit}/></joint>'
        )
    path.write_text("".join([*parts, "</robot>"]))
    return path


USUAL = 'lower="-3" upper="3" effort="50" velocity="2"'


# Turns


def test_motions_that_differ_by_full_turns_are_on_the_same_turn(tmp_path: Path) -> None:
    urdf = write_urdf(
        tmp_path / "arm.urdf",
        ("a", "revolute", USUAL),
        ("b", "continuous", 'effort="20" velocity="3"'),
    )
    one_turn = [q + np.array([0.0, np.pi - 0.1]) for q in reaches(14, joints=2)]
    reported = [
        np.column_stack([q[:, 0], (q[:, 1] + np.pi) % (2 * np.pi) - np.pi]) for q in one_turn
    ]
    found = mp.load_demonstrations(write_csv(tmp_path / "t.csv", ["a", "b"], reported), robot=urdf)
    expected = mp.load_demonstrations(
        write_csv(tmp_path / "s.csv", ["a", "b"], one_turn), robot=urdf
    )
    assert found.repairs["turns"] > 0 and "turns" not in expected.repairs
    shifts = [x.positions - y.positions for x, y in zip(found, expected, strict=True)]
    turns = shifts[0][0, 1] / (2.0 * np.pi)
    assert turns == pytest.approx(round(turns))
    for shift in shifts:
        np.testing.assert_allclose(shift, np.broadcast_to(shifts[0][:1], shift.shape), atol=1e-6)


@given(st.lists(st.floats(-50.0, 50.0), min_size=1, max_size=20))
def test_angles_come_within_one_turn_and_most_stay(angles: list[float]) -> None:
    turns = np.array(full_turns(np.array(angles)))
    shifted = np.array(angles) + 2.0 * np.pi * turns
    assert np.ptp(shifted) <= 2.0 * np.pi + 1e-9
    assert turns.dtype.kind == "i"
    assert np.sort(turns)[(len(angles) - 1) // 2] == 0


# Clocks and rests


@pytest.mark.parametrize("years", [1, 56])
def test_a_clock_that_was_set_forward_cuts_there_alone(tmp_path: Path, years: int) -> None:
    q = rested(reaches())
    times = stamps(len(q))
    times[: len(q) // 2 + 60] -= years * 365 * 86_400 * 10**9  # within the fourth motion
    write_joint_states(tmp_path / "set.mcap", "mcap", NAMES, times, q)
    found = mp.load_demonstrations(tmp_path / "set.mcap")
    assert found.repairs["clock_jumps"] == 1 and len(found) == 5
    assert found.reports[0].duration < 1.2 * len(q) / RATE


@pytest.mark.parametrize("noise", [0.0, 0.1])
def test_rests_at_both_ends_are_cut_whatever_the_flicker(tmp_path: Path, noise: float) -> None:
    rng, tick = np.random.default_rng(0), 360.0 / 4096.0
    episodes = [np.rad2deg(rested([q], 5.0)) for q in reaches(6)]
    flickering = [np.round((q + rng.normal(0.0, noise, q.shape)) / tick) * tick for q in episodes]
    table = write_csv(tmp_path / "t.csv", NAMES, flickering)
    found = mp.load_demonstrations(table, degrees=True)
    assert len(found) == 6 and max(one.duration for one in found) < 2.6
    for one, q in zip(found, reaches(6), strict=True):
        np.testing.assert_allclose(one.positions[[0, -1]], q[[0, -1]], atol=0.02)


def test_episodes_without_motion_are_named(tmp_path: Path) -> None:
    episodes = [q[:1].repeat(len(q), 0) if k == 2 else q for k, q in enumerate(reaches(6))]
    found = mp.load_demonstrations(write_csv(tmp_path / "t.csv", NAMES, episodes))
    assert [x.episode for x in found] == [0, 1, 3, 4, 5]
    assert "episodes without motion: 2" in found.report


# Robots


# Names


@pytest.mark.parametrize(
    ("rename", "name", "expected"),
    [
        (["*_l*=left_*_j*"], "arm_l3", "left_arm_j3"),
        (["a=b", "*=c_*"], "a", "b"),
        (["left_*=*"], "elbow", "elbow"),
        (["/right/states/*=right_*"], "elbow", "right_elbow"),
    ],
)
def test_a_joint_is_renamed_by_the_first_pattern(
    rename: list[str], name: str, expected: str
) -> None:
    assert new_name(name, read_rename(rename), "/right/states") == expected
    for text in ("a", "=b", "a=", "a=*"):
        with pytest.raises(PlannerError, match="can't rename a joint"):
            read_rename([text])


def test_joints_are_renamed_in_bags_and_tables(tmp_path: Path) -> None:
    left = [f"left_{name}" for name in NAMES]
    q = rested(reaches())
    write_joint_states(tmp_path / "set.mcap", "mcap", left, stamps(len(q)), q)
    table = write_csv(tmp_path / "t.csv", [f"{name}.pos" for name in left], reaches())
    for path in (tmp_path / "set.mcap", table):
        rename = {"left_*": "*", "right_*": "r*"}
        found = mp.load_demonstrations(path, rename=rename, joints=NAMES[::-1])
        assert found[0].joint_names == NAMES[::-1]
        note = r"--rename right_\*=r\* renames nothing: none of .*'left_a', 'left_b', 'left_c'"
        assert re.search(note, found.report) and found.report.count("--rename") == 1
    with pytest.raises(RecordingError, match="'x'"):
        mp.load_demonstrations(table, rename={"left_*": "x"})


@pytest.mark.parametrize("times", ["seconds", "constant", "missing"])
@pytest.mark.parametrize(
    ("names", "joints"),
    [
        ([list(NAMES)], None),
        ({name: i for i, name in reversed([*enumerate(NAMES)])}, None),
        ({"motors": None}, NAMES),
        (["state"], NAMES),
        (["a", "b", "b"], NAMES),
        ([f"{name}.pos" for name in NAMES], [f"{name}.pos" for name in NAMES]),
    ],
)
def test_names_of_datasets_are_read_or_given(
    tmp_path: Path, names: object, joints: Sequence[str] | None, times: str
) -> None:
    folder = write_dataset(tmp_path / "set", reaches(), names, times=times)
    found = mp.load_demonstrations(folder, joints=joints)
    assert found[0].joint_names == NAMES and len(found) == 6
    assert found[0].duration == pytest.approx(2.0, abs=0.3)
    assert ("times are frame_index / fps" in found.report) == (times != "seconds")


@pytest.mark.parametrize(
    ("names", "words"),
    [
        (["x", "y", "z"], "'x', 'y', 'z' are coordinates of poses and not joints"),
        (["state"], "names of the 3 values .* are 'state', not .*--joints"),
        (["a", "b", "b"], "names of the 3 values .* are 'a', 'b', 'b', not .*--joints"),
        (3, "info.json' does not describe a LeRobot dataset"),
    ],
)
def test_a_dataset_of_other_names_is_rejected_alone(
    tmp_path: Path, names: object, words: str
) -> None:
    write_dataset(tmp_path / "bad", reaches(), names)
    write_dataset(tmp_path / "good", reaches(), list(NAMES), shape=[1, 3])
    with pytest.warns(UserWarning, match="1 of 2 recordings"):
        found = mp.load_demonstrations(tmp_path)
    assert len(found) == 6
    with pytest.raises(RecordingError, match=words):
        mp.load_demonstrations(tmp_path / "bad")


# Units


def test_shares_of_ranges_are_scaled_and_said(tmp_path: Path) -> None:
    names = ["a", "b", "gripper"]
    ranges = {"a": 2000, "b": 3000, "gripper": 1000}
    factors = np.array([1000, 1500, 1000]) * 2.0 * np.pi / 4095.0 / 100.0
    folder = write_dataset(tmp_path / "set", [q / factors for q in reaches()], names)
    calibration = tmp_path / "arm.json"
    motors = {name: {"range_min": 1000, "range_max": 1000 + r} for name, r in ranges.items()}
    calibration.write_text(json.dumps(motors))
    by_hand = dict(zip(names, factors.tolist(), strict=True))
    for scale in (calibration, by_hand):
        found = mp.load_demonstrations(folder, scale=scale)
        for one, q in zip(found, reaches(), strict=True):
            np.testing.assert_allclose(one.positions[-1], q[-1], atol=0.02)
    with pytest.raises(RecordingError, match="from -100 to 100 with --scale CALIBRATION.json"):
        mp.load_demonstrations(folder)
    with pytest.warns(UserWarning, match="from -100 to 100, .* if they are LeRobot's shares"):
        found = mp.load_demonstrations(folder, degrees=True)
    assert found[0].joint_names == ("a", "b") and "LeRobot states grippers" in found.report
    assert "values are from -100 to 100" in found.report
    for scale, words in (({"d": 2.0}, "no joint is called 'd'"), ({"a": 0.0}, "that is not 0")):
        with pytest.raises(RecordingError, match=words):
            mp.load_demonstrations(folder, scale=scale)
    # Borders of episodes are no gaps, whether it can be used or not.
    refused = inspect_recording(folder)
    assert refused["repairs"] == {} and "--degrees" in refused["refusal"]
    in_degrees = mp.load_demonstrations(folder, degrees=True, prismatic=["b"])
    assert in_degrees.reports[0].repairs == {}
    assert "not converted from degrees: 'b'\n" in in_degrees.report
    with pytest.warns(UserWarning, match="instead of --degrees, give the whole") as caught:
        mp.load_demonstrations(folder, degrees=True, scale={"b": -1.0})
    assert not any("convert degrees with" in str(one.message) for one in caught)
    refused = inspect_recording(folder, degrees=True, rename={"a": "elbow"})
    assert refused["refusal"] is None and "elbow" in refused["joint_names"]


def test_episodes_that_return_are_said_and_cut_on_request(tmp_path: Path) -> None:
    there = reaches(20)
    several = [rested([q, q[::-1]]) for q in there]
    folder = write_dataset(tmp_path / "set", several, list(NAMES))
    found = mp.load_demonstrations(folder)
    assert len(found) == 20 and "20 of 20 motions end where they start" in found.report
    cut = mp.load_demonstrations(folder, cut="rests")
    assert len(cut) == 40 and "end where they start" not in cut.report
    assert [x.episode for x in cut] == [k for k in range(20) for _ in range(2)]
    assert len(mp.load_demonstrations(folder, min_rest=0.3)) == 40
    facts = inspect_recording(folder)
    seconds = sum(len(q) - 1 for q in several) / RATE
    assert facts["episodes"] == 20 and facts["duration"] == pytest.approx(seconds)
    with pytest.raises(RecordingError, match="the folder of a LeRobot dataset, which holds meta/"):
        mp.load_demonstrations(folder / "meta/info.json")


# Folders and files


def test_packed_bags_of_a_folder_are_read_and_others_named(tmp_path: Path) -> None:
    for name, seed in (("monday", 1), ("tuesday", 2)):
        q = rested(reaches(seed=seed))
        write_joint_states(tmp_path / f"{name}.mcap", "mcap", NAMES, stamps(len(q)), q)
    packed = zstd.compress((tmp_path / "tuesday.mcap").read_bytes())
    (tmp_path / "tuesday.mcap").unlink()
    (tmp_path / "tuesday.mcap.zstd").write_bytes(packed)
    (tmp_path / "wednesday.bag.active").write_bytes(b"#ROSBAG V2.0\n")
    (tmp_path / "notes.txt").write_text("")
    (tmp_path / "loop").symlink_to(tmp_path)
    with pytest.warns(UserWarning, match="1 of 3 recordings"):
        found = mp.load_demonstrations(tmp_path)
    assert len(found.reports) == 2 and len(found) == 12
    assert "run rosbag reindex wednesday.bag.active" in found.refused[0].reason
    assert "files left out, as they are not recordings" in found.report
    assert found.report.count("notes.txt") == 1


@pytest.mark.parametrize("gripper", ["finger_joint", "drive_joint"])
@pytest.mark.parametrize("how", ["rests", "alone", "with the arm"])
def test_a_gripper_is_learned_where_it_moves_with_the_arm(
    tmp_path: Path, how: str, gripper: str
) -> None:
    motions = reaches()
    arm = rested(motions, 2.0)  # rests of 2 s between motions of 2 s
    begins, lasts = (2.0, 2.0) if how == "with the arm" else (0.5, 1.0)
    knots = [t for k in range(len(motions)) for t in (4.0 * k + begins, 4.0 * k + begins + lasts)]
    widths = [width for k in range(len(motions)) for width in ((0.0, 0.08), (0.08, 0.0))[k % 2]]
    width = np.interp(np.arange(len(arm)) / RATE, knots, widths)
    table = np.column_stack([arm, np.full(len(arm), 0.02) if how == "rests" else width])
    names = (*NAMES, gripper)
    write_joint_states(tmp_path / "t.mcap", "mcap", names, stamps(len(table)), table)
    found = mp.load_demonstrations(tmp_path / "t.mcap")
    assert len(found) == len(motions)
    assert found[0].joint_names == (names if how == "with the arm" else NAMES)
    why = {"rests": "they never move", "alone": "they move while the arm rests"}.get(how)
    assert (f"joints left out, as {why}: '{gripper}'" in found.report) == bool(why)
    chosen = mp.load_demonstrations(tmp_path / "t.mcap", joints=names)
    assert chosen[0].joint_names == names


def test_a_joint_that_never_moves_is_learned_only_where_it_is_chosen(tmp_path: Path) -> None:
    table = np.column_stack([rested(reaches()), np.full(len(rested(reaches())), 0.4)])
    path = write_csv(tmp_path / "t.csv", (*NAMES, "d"), [table])
    found = mp.load_demonstrations(path)
    assert found[0].joint_names == NAMES
    assert "joints left out, as they never move: 'd'" in found.report
    chosen = mp.load_demonstrations(path, joints=("d", *NAMES))
    assert chosen[0].joint_names == ("d", *NAMES)
    for one, other in zip(found, chosen, strict=True):
        np.testing.assert_array_equal(one.positions, other.positions[:, 1:])


def test_messages_without_names_are_said_to_lack_them(tmp_path: Path) -> None:
    messages = [Message([], [0.1 * k], int(t)) for k, t in enumerate(stamps(50))]
    with pytest.raises(RecordingError, match="50 messages must name as many different joints"):
        mp.load_demonstrations(write_bag(tmp_path / "b", "mcap", messages))


def test_all_episodes_of_a_dataset_are_named_if_one_is_unknown(tmp_path: Path) -> None:
    folder = write_dataset(tmp_path / "set", reaches(), list(NAMES), version="v2.1")
    for episodes in ([0, 1, 99], [99], [2, "left"]):
        with pytest.raises(RecordingError, match="its episodes: 0, 1, 2, 3, 4, 5"):
            mp.load_demonstrations(folder, episodes=episodes)
    (folder / "data/chunk-000/episode_000002.parquet").write_bytes(b"")
    with pytest.raises(RecordingError, match=r"has no episode 2.*episode_000002.parquet"):
        mp.load_demonstrations(folder, episodes=[1, 2])
    assert [x.episode for x in mp.load_demonstrations(folder, episodes=[1, 4])] == [1, 4]


def test_an_error_of_loading_shows_no_function_but_the_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = write_dataset(tmp_path / "set", reaches(), list(NAMES))
    for module in ("pyarrow", "pyarrow.parquet"):
        monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(mp.PlannerError, match=r"mp_pca_planner\[lerobot\]") as raised:
        mp.load_demonstrations(folder)
    assert len(raised.traceback) == 2  # this test, and load_demonstrations
    assert {"episodes", "degrees", "rename"} <= {*signature(mp.load_demonstrations).parameters}


def write_hostile(folder: Path, kind: str) -> Path:
    """A small file that unpacks to much."""
    path = folder / "t.csv"
    if kind == "label":
        rows = [f"{i},{'x' * (400_000 if i == 5 else 1)},0.5" for i in range(2000)]
        path.write_text("time,episode,a\n" + "\n".join(rows))
    else:
        arrow = pytest.importorskip("pyarrow")
        from pyarrow import parquet

        path = write_dataset(folder / "set", reaches(), list(NAMES))
        n = 5_000_000
        column = arrow.FixedSizeListArray.from_arrays(arrow.array(np.zeros(3 * n, "f4")), 3)
        many = {"episode_index": np.zeros(n, int), "observation.state": column}
        parquet.write_table(arrow.table(many), path / "data/chunk-000/file-000.parquet")
    return path


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("label", "'t': "),
        ("parquet", "unpack to"),
    ],
)
def test_a_small_file_that_unpacks_to_much_is_rejected(
    tmp_path: Path, kind: str, words: str
) -> None:
    path = write_hostile(tmp_path, kind)
    tracemalloc.start()
    try:
        with pytest.raises(RecordingError, match=words):
            mp.load_demonstrations(path)
        assert tracemalloc.get_traced_memory()[1] < 200e6
    finally:
        tracemalloc.stop()


# Cuts


def test_cuts_at_hesitations_are_said_and_can_be_left_out(tmp_path: Path) -> None:
    halves = [x for q in reaches() for x in (q, 2.0 * q[-1] - q[::-1])]
    q = rested([np.vstack(pair) for pair in zip(halves[::2], halves[1::2], strict=True)])
    q = np.vstack([np.column_stack([q, np.sin(q[:, 0])])])
    write_joint_states(tmp_path / "set.mcap", "mcap", (*NAMES, "d"), stamps(len(q)), q)
    found = mp.load_demonstrations(tmp_path / "set.mcap")
    rests = mp.load_demonstrations(tmp_path / "set.mcap", cut="rests")
    n_cuts = len(found) - len(rests)
    assert n_cuts > 0 and f"{n_cuts} cuts at hesitations" in found.report
    assert "hesitations" not in rests.report


def test_arms_of_two_topics_are_taken_together(tmp_path: Path) -> None:
    q = rested(reaches())
    times = stamps(len(q))
    messages = []
    for t, x in zip(times.tolist(), q.tolist(), strict=True):
        messages.append(Message(NAMES, x, t, topic="/left/joint_states"))
        messages.append(Message(NAMES, x[::-1], t + 3_000_000, topic="/right/joint_states"))
    bag = write_bag(tmp_path / "set", "mcap", messages)
    both = {"topic": "/left/joint_states,/right/joint_states"}
    with pytest.raises(RecordingError, match="list the same joints, 'a', 'b', 'c': rename"):
        mp.load_demonstrations(bag, **both)
    found = mp.load_demonstrations(bag, rename={"/right/joint_states/*": "right_*"}, **both)
    assert found[0].joint_names == (*NAMES, "right_a", "right_b", "right_c")
    np.testing.assert_allclose(found[0].positions[:, :3], found[0].positions[:, :2:-1], atol=0.01)


# Kinds of motions


@pytest.mark.parametrize("n_kinds", [1, 2, 4])
def test_motions_of_several_kinds_are_told(tmp_path: Path, n_kinds: int) -> None:
    rng = np.random.default_rng(n_kinds)
    centres = np.vstack([np.zeros(3), np.eye(3)])[:n_kinds]
    (course,) = reaches(1)
    # Motions of one kind differ by some 0.03 rad, those of two by 1 rad.
    episodes = [course + one + rng.normal(0.0, 0.02, 3) for one in centres for _ in range(6)]
    table = write_csv(tmp_path / "t.csv", NAMES, episodes)
    notes = "".join(mp.load_demonstrations(table).notes)
    assert (f"these look like {n_kinds} kinds" in notes) if n_kinds > 1 else not notes
    # A way and its way back are one kind.
    assert not mp.load_demonstrations(write_csv(tmp_path / "b.csv", NAMES, reaches(12))).notes


# Files of other programs


@pytest.mark.parametrize(
    ("head", "separator", "decimal"),
    [
        ("time{}a{}b{}c", ";", "."),
        ("time{}a{}b{}c", ";", ","),
        ("time{}a{}b{}c", "\t", "."),
        ("# recorded by hand\n# at 50 Hz\ntime{}a{}b{}c", ",", "."),
        ("__time{}/joint_states/a/position{}/joint_states/b/position{}/joint_states/c/position",
         ",", "."),
    ],
)  # fmt: skip
def test_the_tables_of_spreadsheets_and_plotjuggler_are_read(
    tmp_path: Path, head: str, separator: str, decimal: str
) -> None:
    (q,) = reaches(1)
    times = np.arange(len(q)) / RATE
    rows = [
        separator.join(f"{x:.9f}".replace(".", decimal) for x in row)
        for row in np.column_stack([times, q]).tolist()
    ]
    names = head.format(*[separator] * 3)
    (tmp_path / "t.csv").write_text("\n".join([names, *rows]) + "\n")
    (found,) = mp.load_demonstrations(tmp_path / "t.csv")
    assert found.joint_names == NAMES
    np.testing.assert_allclose(found.positions[[0, -1]], q[[0, -1]], atol=0.01)


def test_what_rostopic_echo_prints_is_read(tmp_path: Path) -> None:
    (q,) = reaches(1)
    kinds = ("name", "position", "velocity")
    fields = [f"field.{kind}{i}" for kind in kinds for i in range(3)]
    rows = [",".join(["%time", "field.header.seq", "field.header.frame_id", *fields])]
    for k, (t, row) in enumerate(zip(stamps(len(q)).tolist(), q.tolist(), strict=True)):
        rows.append(",".join([f"{t},{k},", *NAMES, *map(repr, row), "0,0,0"]))
    (tmp_path / "t.csv").write_text("\n".join(rows) + "\n")
    (found,) = mp.load_demonstrations(tmp_path / "t.csv")
    assert (found.joint_names, found.duration) == (NAMES, pytest.approx(2.0, abs=0.1))
    np.testing.assert_allclose(found.positions[[0, -1]], q[[0, -1]], atol=0.01)


@pytest.mark.parametrize("name", ["t.csv", "t.mcap", "t.db3"])
def test_a_pointer_of_git_lfs_says_how_to_get_the_file(tmp_path: Path, name: str) -> None:
    pointer = "version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 12345\n"
    (tmp_path / name).write_text(pointer)
    with pytest.raises(RecordingError, match=f"{name}.*git lfs pull"):
        mp.load_demonstrations(tmp_path / name)


def test_a_bag_whose_file_was_renamed_is_read(tmp_path: Path) -> None:
    q = rested(reaches(2))
    bag = write_bag(
        tmp_path / "bag",
        "mcap",
        [Message(NAMES, x, t) for x, t in zip(q, stamps(len(q)).tolist(), strict=True)],
    )
    expected = mp.load_demonstrations(bag)
    (file,) = bag.glob("*.mcap")
    file.rename(bag / "reaching.mcap")  # rosbag2#2021
    found = mp.load_demonstrations(bag)
    assert [x.duration for x in found] == [x.duration for x in expected]
    assert any("metadata.yaml names other files" in x for x in found.reports[0].notes)


def test_vectors_of_two_arms_are_told_apart_by_renaming(tmp_path: Path) -> None:
    arms = [f"observation.state.{side}_arm" for side in ("left", "right")]  # GalaxeaVLA#32
    folder = write_dataset(
        tmp_path / "set", reaches(), {"motors": ["j1", "j2", "j3"]}, columns=arms
    )
    with pytest.raises(
        RecordingError, match="not as many different ones.*--rename 'observation.state.right_arm"
    ):
        mp.load_demonstrations(folder, topic=",".join(arms))
    rename = {f"{arms[0]}/*": "left_*"}
    found = mp.load_demonstrations(folder, topic=",".join(arms), rename=rename)
    assert found[0].joint_names == ("left_j1", "left_j2", "left_j3", "j1", "j2", "j3")
