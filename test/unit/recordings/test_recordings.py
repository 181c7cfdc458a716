# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The whole way from bags to demonstrations."""

from __future__ import annotations

import hashlib
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from support.bags import EPOCH, FORMATS, Message, S, reaching, stamped, write_bag
from support.compressed_bags import storage_file
from support.embedded_bags import FIELD, TOPIC, write_embedded_bag

from mp_pca_planner.exceptions import RecordingError
from mp_pca_planner.recordings.bags import find_recordings, stored_size
from mp_pca_planner.recordings.load import load_recordings
from mp_pca_planner.recordings.reading import inspect_recording

REACHES = reaching([0.1, 1.1, 0.3])
"""Rest for 1 s and reach for 1 s in turn, 5 s in all: reaches at 1 s and at 3 s."""


def reaches(path: Path, bag_format: str = "mcap") -> Path:
    return write_bag(path, bag_format, stamped(REACHES))


def segments_file(
    folder: Path, *rows: str, header: str = "recording,start_time_s,end_time_s,label"
) -> Path:
    path = folder / "segments.csv"
    path.write_text("\n".join([header, *rows]) + "\n")
    return path


def test_motions_become_demonstrations_with_a_report(tmp_path: Path, bag_format: str) -> None:
    messages = stamped(REACHES)
    path = write_bag(tmp_path / "two", bag_format, [messages[0], *messages])
    loaded = load_recordings([path])
    assert loaded.refused == () and loaded.notes == ()
    for motion, start, goal in zip(loaded, (1.0, 3.0), (1.1, 0.3), strict=True):
        assert (motion.recording, motion.joint_names) == ("two", ("a", "b"))
        assert (motion.start_time, motion.end_time) == pytest.approx((start, start + 1), abs=0.12)
        assert motion.duration == pytest.approx(motion.end_time - motion.start_time)
        np.testing.assert_allclose(motion.positions[-1], [goal, -0.5 * goal], atol=0.01)
        np.testing.assert_allclose(motion.velocities[[0, -1]], 0.0, atol=0.12)
    (report,) = loaded.reports
    assert (report.name, report.path, report.format) == ("two", str(path), bag_format)
    assert (report.topic, report.n_messages) == ("/joint_states", len(messages) + 1)
    assert (report.rate, report.duration) == pytest.approx((100.0, 4.99))
    assert report.joint_names == ("a", "b")
    assert report.checksum == hashlib.sha256(storage_file(path).read_bytes()).hexdigest()
    assert report.repairs == {"repeated_stamps": 1} and report.notes == ()
    assert len(report.motions) == 2 and report.pieces == ()  # no samples stay in memory
    assert 0.0 < report.thresholds.rest < report.thresholds.moving


FROZEN = REACHES.copy()
FROZEN[140:185] = FROZEN[140]
LATE = reaching([0.1, 1.1], rest=2.0)


@pytest.mark.parametrize(
    ("messages", "segments", "repairs", "spans"),
    [
        (stamped(REACHES), ["none"], {}, [(1.0, 4.0)]),
        # A motion never spans a gap, and a part that rests holds none.
        (
            stamped(REACHES)[:140] + stamped(REACHES)[260:],
            ["auto", "none"],
            {"gaps": 1, "cut_off": 1},
            [(3.0, 4.0)],
        ),
        (stamped(LATE)[:320] + stamped(LATE)[400:], ["auto", "none"], {"gaps": 1}, [(2.0, 3.0)]),
        (stamped(FROZEN), ["auto"], {"jumps": 1, "frozen": 44, "cut_off": 2}, [(3.0, 4.0)]),
        # The recorder began within the first motion; with "none" it is taken as it is.
        (stamped(REACHES[150:]), ["auto"], {"cut_off": 1}, [(1.5, 2.5)]),
        (stamped(REACHES[150:250]), ["none"], {}, [(0.0, 0.5)]),
        (stamped(REACHES[125:175]), ["auto"], {}, [(0.0, 0.49)]),
    ],
)
def test_motions_are_whole(
    tmp_path: Path,
    messages: list[Message],
    segments: list[str],
    repairs: dict[str, int],
    spans: list[tuple[float, float]],
) -> None:
    path = write_bag(tmp_path / "x", "mcap", messages)
    for segment in segments:
        (report,) = load_recordings([path], segment=segment).reports
        assert report.repairs == repairs
        np.testing.assert_allclose(
            [(m.start_time, m.end_time) for m in report.motions], spans, atol=0.12
        )


def test_units_other_than_radians_are_named_with_the_next_step(tmp_path: Path) -> None:
    for name in "12":
        degrees = float(name) * np.rad2deg(REACHES)
        write_bag(tmp_path / name, "mcap", stamped(degrees))
    write_bag(tmp_path / "radians", "mcap", stamped(REACHES))
    loaded = load_recordings([tmp_path])
    assert [refusal.recording for refusal in loaded.refused] == ["1", "2"]
    for refusal in loaded.refused:
        assert re.search("2 of its 2 joints .* not in degrees .* --degrees", refusal.reason)
    loaded = load_recordings([tmp_path], degrees=True)
    assert [report.name for report in loaded.reports] == ["1", "2"]
    assert "radians rather than degrees: leave out --degrees" in loaded.refused[0].reason
    for reach, given, words in (
        (100.0, False, "degrees with --degrees .*, LeRobot's .* --scale CALIBRATION.json .* mm"),
        (150.0, False, r"degrees with --degrees \(degrees=True\), other units .* 0.001 for mm"),
        (4095.0, False, "; convert other units with --scale .* for 4096 ticks a turn"),
        (4095.0, True, "; instead of --degrees, give the whole factor .* for 4096 ticks a turn"),
    ):
        write_bag(tmp_path / f"{reach}{given}", "mcap", stamped(REACHES * reach / REACHES.max()))
        (refusal,) = load_recordings([tmp_path / f"{reach}{given}"], degrees=given).refused
        assert re.search(f"not in degrees .*{words}.* with --joints", refusal.reason)
    # A single joint may turn on and on.
    turns = np.column_stack([12.0 * REACHES[:, 0], REACHES])
    path = write_bag(tmp_path / "wheel", "mcap", stamped(turns, names=("wheel", "a", "b")))
    (report,) = load_recordings([path]).reports
    assert len(report.motions) == 2
    assert "joint 'wheel' moves over 12 rad" in report.notes[-1]


@pytest.mark.parametrize(
    ("upper", "note", "refusal"),
    [
        (1.09, None, None),  # soft limits and noise
        (0.9, "joint 'a' is at 1.1 rad (or m), 0.2 beyond its limit in the robot descr", None),
        (-2.5, None, "joint 'a' is at 1.1 rad (or m), 3.6 beyond its limit in the robot descr"),
    ],
)
def test_motions_beyond_the_limits_of_the_robot_are_noted_or_refused(
    tmp_path: Path, upper: float, note: str | None, refusal: str | None
) -> None:
    limits = {"a": (-3.0, upper), "other": (5.0, 6.0)}
    loaded = load_recordings([reaches(tmp_path / "x")], position_limits=limits)
    found = [one for report in loaded.reports for one in report.notes if "beyond" in one]
    assert len(found) == (note is not None) and all(one.startswith(note) for one in found)
    reasons = [one.reason for one in loaded.refused]
    assert len(reasons) == (refusal is not None)
    assert all(one.startswith(refusal) for one in reasons)


def test_bad_recording_is_refused_by_name_and_the_rest_is_used(tmp_path: Path) -> None:
    for size, name in enumerate(FORMATS, start=1):
        write_bag(tmp_path / name, name, stamped(0.3 * size * REACHES))
    (tmp_path / "broken.bag").write_bytes(b"#ROSBAG V2.0\n")
    write_bag(tmp_path / "still", "mcap", stamped(np.ones((300, 2))))
    write_bag(tmp_path / "other", "mcap", [], unknown_type=True)
    done: list[tuple[int, int]] = []
    loaded = load_recordings([tmp_path], progress=lambda n, total: done.append((n, total)))
    assert [report.name for report in loaded.reports] == ["mcap", "rosbag1", "sqlite3"]
    assert [refusal.recording for refusal in loaded.refused] == ["broken", "other", "still"]
    assert "'/strange' (nobody_msgs/msg/Strange)" in loaded.refused[1].reason
    assert "nothing moves" in loaded.refused[2].reason
    sizes = [stored_size(path) for path in find_recordings([tmp_path])]
    n_done, totals = zip(*done, strict=True)
    assert list(n_done) == sorted(n_done)
    assert set(np.cumsum(sizes).tolist()) <= set(n_done)
    assert set(totals) == {sum(sizes)}


def test_chosen_topic_is_read(tmp_path: Path) -> None:
    messages = [*stamped(REACHES), Message(("x",), [0.0], EPOCH, topic="/other")]
    path = write_bag(tmp_path / "x", "mcap", messages)
    assert "'/joint_states', '/other'" in load_recordings([path]).refused[0].reason
    assert "'/joint_states', '/other'" in load_recordings([path], topic="/x").refused[0].reason
    assert load_recordings([path], topic="/joint_states").reports[0].topic == "/joint_states"


def test_the_field_of_joint_states_that_a_refusal_names_is_read(tmp_path: Path) -> None:
    path = write_embedded_bag(tmp_path / "x", "rosbag1", stamped(reaching([0.5, -0.5])))
    (refused,) = load_recordings([path]).refused
    assert f"--topic {TOPIC} --field {FIELD}" in refused.reason
    assert len(load_recordings([path], topic=TOPIC, state_field=FIELD).demonstrations) == 1
    with pytest.raises(RecordingError, match="'states' needs a topic"):
        load_recordings([path], state_field="states")


def write_joints(path: Path, *joints: tuple[str, ...]) -> Path:
    """Reaches whose joints come in one message, or in several of different publishers."""
    messages = []
    for k, group in enumerate(joints):
        places = [0 if name == "a" else 1 for name in group]
        messages += stamped(REACHES[:, places], names=group, start=EPOCH + k * 3_000_000)
    messages.sort(key=lambda message: message.stamp)
    return write_bag(path, "mcap", messages)


def test_recordings_take_the_joints_of_most(tmp_path: Path) -> None:
    for name in ("1", "2", "3", "4"):
        write_bag(tmp_path / name, "mcap", stamped(float(name) * REACHES))
    write_joints(tmp_path / "5_gripper", ("a", "b", "grip"))
    write_joints(tmp_path / "6_gripper_apart", ("b", "a"), ("grip",))
    write_joints(tmp_path / "7_apart", ("b",), ("a",))
    write_joints(tmp_path / "8_other", ("c", "b"))
    mixed = load_recordings([tmp_path])
    assert [report.joint_names for report in mixed.reports][4:] == [("a", "b", "grip"), ("c", "b")]
    loaded = load_recordings([tmp_path], same_joints=True)
    assert {report.joint_names for report in loaded.reports} == {("a", "b")}
    assert len(loaded.reports) == 7 and len(loaded.demonstrations) == 14
    (other,) = loaded.refused
    assert other.recording == "8_other"
    assert other.reason.startswith(
        "its joints, 'c', 'b', are not those of most recordings, 'a', 'b': choose joints"
    )
    left_out = "joints left out, as most recordings lack them: 'grip'"
    noted = [report.name for report in loaded.reports if left_out in report.notes]
    assert noted == ["5_gripper", "6_gripper_apart"]
    for demonstration in loaded.demonstrations[8:]:
        goal = demonstration.positions[-1, 0]
        np.testing.assert_allclose(demonstration.positions[-1], [goal, -0.5 * goal], atol=0.01)
    # Without a majority, no recording is rejected for its joints.
    half = [tmp_path / "1", tmp_path / "8_other"]
    assert len(load_recordings(half, same_joints=True).reports) == 2


def test_copies_in_other_forms_and_parts_count_once(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    noisy = REACHES + rng.normal(0.0, 1e-3, REACHES.shape)
    first = write_bag(tmp_path / "first", "mcap", stamped(noisy))
    shutil.copytree(first, tmp_path / "same_file")
    write_bag(tmp_path / "later", "sqlite3", stamped(noisy, start=EPOCH + 3600 * S))
    write_bag(tmp_path / "a_part", "mcap", stamped(noisy[:250]))
    again = REACHES + rng.normal(0.0, 1e-3, REACHES.shape)
    write_bag(tmp_path / "same_task", "mcap", stamped(again))
    swapped = stamped(noisy[:, ::-1], names=("b", "a"))
    write_bag(tmp_path / "swapped", "rosbag1", swapped)
    loaded = load_recordings([tmp_path])
    assert [report.name for report in loaded.reports] == ["first", "same_task"]
    reasons = {refusal.recording: refusal.reason for refusal in loaded.refused}
    assert reasons.keys() == {"same_file", "later", "a_part", "swapped"}
    assert "a part of another recording" in reasons["a_part"]
    assert all("also in 'first', which is used" in reason for reason in reasons.values())


SWAY = 0.05 * np.sin(0.6 * np.pi * np.arange(0.0, 60.0, 0.01))[:, None] * [1.0, -0.5]
"""A standing arm that sways over 0.1 rad: in a set of large motions, that is rest."""


def test_movements_that_are_small_beside_those_of_the_set_are_rest(tmp_path: Path) -> None:
    for index in range(5):
        write_bag(tmp_path / f"reach_{index}", "mcap", stamped(reaching([0, 2.0 + 0.1 * index])))
    swaying = write_bag(tmp_path / "standing", "mcap", stamped(SWAY))
    mixed = reaching([0, 0.3, 0.35])
    write_bag(tmp_path / "mixed", "mcap", stamped(mixed))
    alone = load_recordings([swaying])
    assert len(alone.reports[0].motions) > 10
    loaded = load_recordings([tmp_path], jobs=2)
    (refused,) = loaded.refused
    assert refused.recording == "standing"
    assert "by the extent of the other recordings' motions" in refused.reason
    by_name = {report.name: report for report in loaded.reports}
    assert by_name["mixed"].repairs == {"rest": 1}
    assert len(loaded.demonstrations) == 6
    # Beside the largest motion of the same recording small ones are no motions, either.
    parts = reaching([0, 1]), reaching([1, 1.09], reach=0.4), reaching([1.09, 0.1])
    path = write_bag(tmp_path / "small", "mcap", stamped(np.concatenate(parts)))
    (report,) = load_recordings([path]).reports
    assert "1 motions over less than 10% of the extent of the largest" in report.notes[0]


@pytest.mark.parametrize("rate", [10, 25, 100, 400])
@pytest.mark.parametrize("noise", [1e-4, 3e-3])
def test_noise_alone_is_no_motion(tmp_path: Path, rate: int, noise: float) -> None:
    positions = np.random.default_rng(rate).normal(scale=noise, size=(60 * rate, 2))
    path = write_bag(tmp_path / "standing", "mcap", stamped(positions, rate=rate))
    for segment in ("auto", "none"):
        (refused,) = load_recordings([path], segment=segment).refused
        assert "no motion" in refused.reason or "nothing moves" in refused.reason


def test_all_motions_cut_by_hand_load(shared_data: Path) -> None:
    arm = shared_data / "human_arm"
    loaded = load_recordings([arm / "joint_states"], segments_csv=arm / "motions.csv")
    assert loaded.refused == ()
    assert len(loaded.demonstrations) == 141
    assert {d.joint_names for d in loaded.demonstrations} == {
        ("shoulder1", "shoulder2", "shoulder3", "elbow")
    }


ROWS = ["x,1.0,2.0,out", "x,3.0,4.99,back"]


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        (["y,1.0,2.0,"], "line 2: no recording is called 'y'"),
        (
            [*ROWS, "x,one,2.0,"],
            "line 4: 'start_time_s', .* must be numbers of seconds, .* got 'one', '2.0'",
        ),
        (["x,2.0,2.0,"], "line 2: .* the second one larger, .* got '2.0', '2.0'"),
        (["x,-1.0,2.0,"], "line 2: .* from 0 to .* got '-1.0', '2.0'"),
        ([f"x,1.0,{i + 2}," for i in range(10_001)], "more than 10,000 rows"),
    ],
)
def test_a_table_of_segments_is_taken_or_refused_with_the_line(
    tmp_path: Path, rows: list[str], message: str
) -> None:
    path = reaches(tmp_path / "x")
    loaded = load_recordings([path], segments_csv=segments_file(tmp_path, *ROWS))
    found = [(m.start_time, m.end_time, m.label) for m in loaded.reports[0].motions]
    approx = pytest.approx
    assert found == [(approx(1.0), approx(2.0), "out"), (approx(3.0), approx(4.99), "back")]
    assert [motion.label for motion in loaded] == ["out", "back"]
    with pytest.raises(RecordingError, match=message):
        load_recordings([path], segments_csv=segments_file(tmp_path, *rows))


def test_tables_of_segments_and_recordings_that_do_not_fit(tmp_path: Path) -> None:
    paths = [reaches(tmp_path / "x"), reaches(tmp_path / "y")]
    rows = ("x,1.0,2.0,", "x,4.0,5.2,")
    first, second = load_recordings(paths, segments_csv=segments_file(tmp_path, *rows)).refused
    assert "line 3: 4 s to 5.2 s is not within the recording" in first.reason
    assert (second.recording, "lists no motion of it" in second.reason) == ("y", True)
    table = segments_file(tmp_path, header="recording,start_time_s")
    for path, words in ((table, "lacks the columns 'end_time_s'"), (tmp_path / "no.csv", "no.csv")):
        with pytest.raises(RecordingError, match=words):
            load_recordings(paths, segments_csv=path)
    with pytest.raises(RecordingError, match="'auto', 'none'"):
        load_recordings(paths, segment="aut")


def test_inspection_counts_defects_and_tells_why_a_recording_is_useless(tmp_path: Path) -> None:
    messages = stamped(REACHES)
    messages[3].positions = [np.nan, 0.0]
    messages[4].positions = [1.0]
    path = write_bag(tmp_path / "x", "rosbag1", [messages[0], *messages], unknown_type=True)
    found = inspect_recording(path)
    assert found["format"] == "rosbag1"
    assert [(t["name"], t["count"]) for t in found["topics"]] == [
        ("/joint_states", 501),
        ("/strange", 1),
    ]
    assert (found["joint_names"], found["rate"]) == (("a", "b"), pytest.approx(100.0))
    defects = {"malformed": 1, "non_finite": 1, "repeated_stamps": 1}
    assert (found["repairs"], found["refusal"]) == (defects, None)
    for message in messages[5:]:
        message.positions = [0.1, -0.05]
    still = inspect_recording(write_bag(tmp_path / "still", "mcap", messages[3:]))
    assert (still["n_messages"], still["joint_names"]) == (len(messages) - 3, ("a", "b"))
    assert "nothing moves" in str(still["refusal"])
    assert still["repairs"] == {"malformed": 1, "non_finite": 1}
    (tmp_path / "broken.bag").write_bytes(b"")
    broken = inspect_recording(tmp_path / "broken.bag")
    assert broken["topics"] == () and "broken.bag" in str(broken["refusal"])
    with pytest.raises(RecordingError, match="3 recordings"):
        inspect_recording(tmp_path)
