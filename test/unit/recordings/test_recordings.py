# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The whole way from bags to demonstrations."""

from __future__ import annotations

import hashlib
import os
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from support.bags import EPOCH, FORMATS, Message, S, reaching, stamped, write_bag
from support.compressed_bags import storage_file

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


def test_motions_become_demonstrations(tmp_path: Path, bag_format: str) -> None:
    path = reaches(tmp_path / "two", bag_format)
    loaded = load_recordings([path])
    assert loaded.refused == ()
    assert [d.recording for d in loaded.demonstrations] == ["two", "two"]
    for demonstration, start, goal in zip(
        loaded.demonstrations, (1.0, 3.0), (1.1, 0.3), strict=True
    ):
        assert demonstration.joint_names == ("a", "b")
        assert demonstration.start_time == pytest.approx(start, abs=0.12)
        assert demonstration.end_time == pytest.approx(start + 1.0, abs=0.12)
        assert demonstration.duration == pytest.approx(
            demonstration.end_time - demonstration.start_time
        )
        np.testing.assert_allclose(demonstration.positions[-1], [goal, -0.5 * goal], atol=0.01)
        np.testing.assert_allclose(demonstration.velocities[[0, -1]], 0.0, atol=0.12)


def test_report_says_what_was_found(tmp_path: Path, bag_format: str) -> None:
    messages = stamped(REACHES)
    path = write_bag(tmp_path / "x", bag_format, [messages[0], *messages])
    (report,) = load_recordings([path]).reports
    file = storage_file(path)
    assert report.name == "x"
    assert report.path == str(path)
    assert report.format == bag_format
    assert report.topic == "/joint_states"
    assert report.n_messages == len(messages) + 1
    assert report.rate == pytest.approx(100.0)
    assert report.duration == pytest.approx(4.99)
    assert report.joint_names == ("a", "b")
    assert report.checksum == hashlib.sha256(file.read_bytes()).hexdigest()
    assert report.repairs == {"repeated_stamps": 1}
    assert len(report.motions) == 2
    assert 0.0 < report.thresholds.rest < report.thresholds.moving
    assert report.notes == ()


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


def test_without_cutting_only_the_stillness_at_the_ends_goes(tmp_path: Path) -> None:
    (demonstration,) = load_recordings([reaches(tmp_path / "x")], segment="none").demonstrations
    assert demonstration.start_time == pytest.approx(1.0, abs=0.12)
    assert demonstration.end_time == pytest.approx(4.0, abs=0.12)


def test_motion_never_spans_a_gap(tmp_path: Path) -> None:
    messages = stamped(REACHES)
    path = write_bag(tmp_path / "x", "mcap", messages[:140] + messages[260:])
    for segment in ("none", "auto"):
        (report,) = load_recordings([path], segment=segment).reports
        assert report.repairs == {"gaps": 1, "cut_off": 1}
        assert [m.start > 2.59 for m in report.motions] == [True]


def test_a_part_that_rests_holds_no_motion(tmp_path: Path) -> None:
    messages = stamped(reaching([0.1, 1.1], rest=2.0))
    path = write_bag(tmp_path / "x", "mcap", messages[:320] + messages[400:])
    for segment in ("none", "auto"):
        (report,) = load_recordings([path], segment=segment).reports
        assert report.repairs == {"gaps": 1}
        ((start, end),) = [(m.start, m.end) for m in report.motions]
        assert (start, end) == pytest.approx((2.0, 3.0), abs=0.12)


@pytest.mark.parametrize("segment", ["auto", "none"])
def test_a_recording_of_halves_is_rejected(tmp_path: Path, segment: str) -> None:
    messages = stamped(REACHES[:250])
    path = write_bag(tmp_path / "x", "mcap", messages[:130] + messages[185:])
    (refusal,) = load_recordings([path], segment=segment, max_gap=0.4).refused
    assert re.search(r"cuts off each of its motions \(\d\).*from rest to rest", refusal.reason)


def test_a_step_of_the_clock_and_frozen_positions_make_no_half_motions(tmp_path: Path) -> None:
    stepped = stamped(REACHES)
    for message in stepped[150:]:
        message.stamp += 3 * S // 10
    write_bag(tmp_path / "stepped", "mcap", stepped)
    frozen = REACHES.copy()
    frozen[140:185] = frozen[140]
    write_bag(tmp_path / "frozen", "mcap", stamped(frozen))
    for report in load_recordings([tmp_path]).reports:
        assert [m.start > 2.59 for m in report.motions] == [True]
        assert report.repairs["cut_off"] > 0


def test_a_motion_of_which_the_recording_lacks_an_end_is_left_out(tmp_path: Path) -> None:
    for name, last in (("one", 250), ("both", None)):
        write_bag(tmp_path / name, "mcap", stamped(REACHES[150:last]))
    loaded = load_recordings([tmp_path])
    (both,), (one,) = loaded.reports, loaded.refused
    assert [len(both.motions), both.repairs] == [1, {"cut_off": 1}]
    assert both.motions[0].start == pytest.approx(1.5, abs=0.12)
    assert one.recording == "one" and "--segment none" in one.reason
    (report,) = load_recordings([tmp_path / "one"], segment="none").reports
    assert len(report.motions) == 1


def test_a_recording_that_is_one_motion_without_rests_is_used(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "tight", "mcap", stamped(REACHES[125:175]))
    (report,) = load_recordings([path]).reports
    assert [(m.start, m.end) for m in report.motions] == [(0.0, pytest.approx(0.49))]
    assert report.repairs == {}


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


def test_without_a_majority_no_recording_is_rejected_for_its_joints(tmp_path: Path) -> None:
    write_bag(tmp_path / "1", "mcap", stamped(REACHES))
    write_joints(tmp_path / "2", ("c", "d"))
    loaded = load_recordings([tmp_path], same_joints=True)
    assert [report.joint_names for report in loaded.reports] == [("a", "b"), ("c", "d")]


def test_a_set_in_degrees_is_rejected_without_a_robot(tmp_path: Path) -> None:
    for name in "12":
        write_bag(tmp_path / name, "mcap", stamped(float(name) * np.rad2deg(REACHES)))
    loaded = load_recordings([tmp_path])
    assert [refusal.recording for refusal in loaded.refused] == ["1", "2"]
    for refusal in loaded.refused:
        assert re.search("2 of its 2 joints .* not in degrees .* --degrees", refusal.reason)
    assert len(load_recordings([tmp_path], degrees=True).reports) == 2


def test_radians_are_not_read_as_degrees(tmp_path: Path) -> None:
    write_bag(tmp_path / "1", "mcap", stamped(REACHES))
    (refusal,) = load_recordings([tmp_path], degrees=True).refused
    assert re.search("radians rather than degrees: leave out --degrees", refusal.reason)


def test_a_joint_that_turns_on_and_on_is_not_in_degrees(tmp_path: Path) -> None:
    turns = np.column_stack([12.0 * REACHES[:, 0], REACHES])
    path = write_bag(tmp_path / "x", "mcap", stamped(turns, names=("wheel", "a", "b")))
    (report,) = load_recordings([path]).reports
    assert len(report.motions) == 2
    assert "joint 'wheel' moves over 12 rad" in report.notes[-1]


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


def test_small_motions_are_left_out_with_a_note(tmp_path: Path) -> None:
    short = reaching([1, 1.09], reach=0.4)
    positions = np.concatenate([reaching([0, 1]), short, reaching([1.09, 0.1])])
    path = write_bag(tmp_path / "x", "mcap", stamped(positions))
    (report,) = load_recordings([path]).reports
    assert len(report.motions) == 2
    assert report.notes == (
        "1 motions over less than 10% of the extent of the largest are left out",
    )


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


@pytest.mark.parametrize("n_good", [1, 4])
def test_recording_in_degrees_is_refused_and_the_others_are_used(
    tmp_path: Path, n_good: int
) -> None:
    write_bag(tmp_path / "degrees", "mcap", stamped(np.degrees(reaching([0, 1.4]))))
    for index in range(n_good):
        write_bag(tmp_path / f"reach_{index}", "mcap", stamped(reaching([0, 1.0 + 0.1 * index])))
    loaded = load_recordings([tmp_path])
    (refused,) = loaded.refused
    assert refused.recording == "degrees"
    assert "not in degrees" in refused.reason
    assert len(loaded.demonstrations) == n_good


@pytest.mark.parametrize("joints", [None, ["b", "a"]])
def test_recordings_of_the_same_joints_in_another_order_are_one_set(
    tmp_path: Path, joints: list[str] | None
) -> None:
    write_bag(tmp_path / "one", "mcap", stamped(REACHES))
    # Twice as large: the same samples would be those of a copy.
    write_bag(tmp_path / "two", "mcap", stamped(2.0 * REACHES[:, ::-1], names=("b", "a")))
    loaded = load_recordings([tmp_path], joints=joints)
    assert {d.joint_names for d in loaded.demonstrations} == {tuple(joints or ("a", "b"))}
    for first, second in zip(*np.reshape(list(loaded.demonstrations), (2, 2)), strict=True):
        np.testing.assert_allclose(2.0 * first.positions, second.positions, atol=1e-12)


@pytest.mark.parametrize("rate", [10, 25, 100, 400])
@pytest.mark.parametrize("noise", [1e-4, 3e-3])
def test_noise_alone_is_no_motion(tmp_path: Path, rate: int, noise: float) -> None:
    positions = np.random.default_rng(rate).normal(scale=noise, size=(60 * rate, 2))
    path = write_bag(tmp_path / "standing", "mcap", stamped(positions, rate=rate))
    for segment in ("auto", "none"):
        (refused,) = load_recordings([path], segment=segment).refused
        assert "no motion" in refused.reason or "nothing moves" in refused.reason


def test_unknown_way_to_segment_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="'auto', 'none'"):
        load_recordings([reaches(tmp_path / "x")], segment="aut")  # type: ignore[arg-type]


def test_segments_by_hand_are_taken_as_they_are(tmp_path: Path, bag_format: str) -> None:
    path = reaches(tmp_path / "x", bag_format)
    table = segments_file(
        tmp_path,
        "out,x,1.0,2.0,9",
        "back,x,3.0,4.99,9",
        header="label,recording,start_time_s,end_time_s,other",
    )
    loaded = load_recordings([path], segments_csv=table)
    assert [(m.start, m.end, m.label) for m in loaded.reports[0].motions] == [
        (pytest.approx(1.0), pytest.approx(2.0), "out"),
        (pytest.approx(3.0), pytest.approx(4.99), "back"),
    ]
    assert [d.label for d in loaded.demonstrations] == ["out", "back"]


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ("y,1.0,2.0,", "no recording is called 'y'"),
        ("x,one,2.0,", "'start_time_s' must be a number of seconds, got 'one'"),
        ("x,1.0,,", "'end_time_s' must be a number of seconds, got ''"),
        ("x,1.0", "'end_time_s' must be a number of seconds, got ''"),
        ("x,nan,2.0,", "'start_time_s' must be a number"),
        ("x,2.0,2.0,", "end after its start"),
        ("x,-1.0,2.0,", "must start at 0 s or later"),
        ("x,1.0,1e308,", "at 1e.09 s at the latest"),
        (",1.0,2.0,", "no recording is called ''"),
        ("x,1.00,2.0,", "this row repeats .* line 2: remove one"),
    ],
)
def test_faulty_row_is_refused_with_its_line(tmp_path: Path, row: str, message: str) -> None:
    path = reaches(tmp_path / "x")
    table = segments_file(tmp_path, "x,1.0,2.0,", row)
    with pytest.raises(RecordingError, match=f"line 3: .*{message}"):
        load_recordings([path], segments_csv=table)


def test_more_segments_than_can_be_learned_from_are_refused(tmp_path: Path) -> None:
    table = segments_file(tmp_path, *(f"x,1.0,{i + 2}," for i in range(10_001)))
    with pytest.raises(RecordingError, match="more than 10,000 rows"):
        load_recordings([reaches(tmp_path / "x")], segments_csv=table)


def test_segments_in_a_pipe_are_refused(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(RecordingError, match="pipe' can't be read: it is not a regular file"):
        load_recordings([reaches(tmp_path / "x")], segments_csv=tmp_path / "pipe")


def test_segment_outside_its_recording_is_refused_with_its_line(tmp_path: Path) -> None:
    table = segments_file(tmp_path, "x,1.0,2.0,", "x,4.0,5.2,")
    (refusal,) = load_recordings([reaches(tmp_path / "x")], segments_csv=table).refused
    assert "line 3: 4 s to 5.2 s is not within the recording" in refusal.reason


@pytest.mark.parametrize(
    "content",
    [
        *(b"", b"recording,start_time_s\n", b"\xff\xfe\x00", b"a\x00b\n1\n"),
        b"recording,start_time_s,end_time_s\n" + 200_000 * b"x",
    ],
)
def test_file_that_holds_no_segments_is_refused_by_name(tmp_path: Path, content: bytes) -> None:
    path = reaches(tmp_path / "x")
    table = tmp_path / "segments.csv"
    table.write_bytes(content)
    with pytest.raises(RecordingError, match=r"segments\.csv"):
        load_recordings([path], segments_csv=table)
    with pytest.raises(RecordingError, match=r"none\.csv"):
        load_recordings([path], segments_csv=tmp_path / "none.csv")


def test_recording_without_a_row_is_refused(tmp_path: Path) -> None:
    paths = [reaches(tmp_path / "x"), reaches(tmp_path / "y")]
    loaded = load_recordings(paths, segments_csv=segments_file(tmp_path, "x,1.0,2.0,"))
    assert [report.name for report in loaded.reports] == ["x"]
    assert [refusal.recording for refusal in loaded.refused] == ["y"]


def test_inspection_counts_defects(tmp_path: Path, bag_format: str) -> None:
    messages = stamped(REACHES)
    messages[3].positions = [np.nan, 0.0]
    path = write_bag(tmp_path / "x", bag_format, [messages[0], *messages], unknown_type=True)
    found = inspect_recording(path)
    assert found.format == bag_format
    assert [(t.name, t.count) for t in found.topics] == [("/joint_states", 501), ("/strange", 1)]
    assert found.joint_names == ("a", "b")
    assert found.rate == pytest.approx(100.0)
    assert found.repairs == {"non_finite": 1, "repeated_stamps": 1}
    assert found.refusal is None


def test_inspection_tells_why_a_recording_is_useless(tmp_path: Path, bag_format: str) -> None:
    still = inspect_recording(write_bag(tmp_path / "x", bag_format, stamped(np.ones((99, 2)))))
    assert still.n_messages == 99
    assert still.joint_names == ("a", "b")
    assert "nothing moves" in str(still.refusal)
    (tmp_path / "broken.bag").write_bytes(b"")
    broken = inspect_recording(tmp_path / "broken.bag")
    assert broken.topics == ()
    assert "broken.bag" in str(broken.refusal)


def test_inspection_is_of_one_recording(tmp_path: Path) -> None:
    reaches(tmp_path / "x")
    reaches(tmp_path / "y")
    with pytest.raises(RecordingError, match="2 recordings"):
        inspect_recording(tmp_path)


def test_gestures_of_a_humanoid_are_loaded(shared_data: Path) -> None:
    joints = [f"arm_right_{number}_joint" for number in range(1, 8)]
    loaded = load_recordings([shared_data / "reem_gestures" / "*.bag"], joints=joints)
    assert loaded.refused == ()
    assert len(loaded.reports) == 5
    for report in loaded.reports:
        assert 1 <= len(report.motions) <= 8
        assert report.rate == pytest.approx(50.0, rel=0.01)
        assert report.motions[0].start == pytest.approx(0.5, abs=0.1)
        assert "simulation time" in report.notes[0]


def test_slow_recording_among_unknown_types_is_one_motion(shared_data: Path) -> None:
    loaded = load_recordings([shared_data / "iri_wam"])
    (demonstration,) = loaded.demonstrations
    assert loaded.reports[0].rate == pytest.approx(10.0, rel=0.01)
    assert demonstration.start_time == pytest.approx(2.4, abs=0.2)
    assert demonstration.end_time == pytest.approx(11.6, abs=0.2)
    assert np.abs(demonstration.velocities[[0, -1]]).max() < 0.02


def test_recordings_without_time_are_refused(shared_data: Path) -> None:
    loaded = load_recordings([shared_data / "unstamped"])
    assert loaded.demonstrations == ()
    assert len(loaded.refused) == 2
    assert all("no usable time" in refusal.reason for refusal in loaded.refused)


def test_all_motions_cut_by_hand_load(shared_data: Path) -> None:
    arm = shared_data / "human_arm"
    loaded = load_recordings([arm / "joint_states"], segments_csv=arm / "motions.csv")
    assert loaded.refused == ()
    assert len(loaded.demonstrations) == 141
    assert {d.joint_names for d in loaded.demonstrations} == {
        ("shoulder1", "shoulder2", "shoulder3", "elbow")
    }


def test_damaged_recording_is_used_as_far_as_it_goes_only_on_request(tmp_path: Path) -> None:
    motions = np.tile(reaching([0.1, 1.1, 0.1]), (4, 1))
    file = storage_file(write_bag(tmp_path / "x", "mcap", stamped(motions)))
    content = file.read_bytes()
    file.write_bytes(content[: int(0.7 * len(content))])
    assert not load_recordings([file]).reports
    assert inspect_recording(file).refusal is not None
    (report,) = load_recordings([file], salvage=True).reports
    assert report.motions
    assert "before the damage" in report.notes[0]
    assert inspect_recording(file, salvage=True).n_messages == report.n_messages


def test_longest_gap_reaches_the_repair(tmp_path: Path) -> None:
    messages = stamped(reaching([0.1, 1.1, 0.1]))
    path = write_bag(tmp_path / "x", "mcap", messages[:210] + messages[290:])
    assert load_recordings([path]).reports[0].repairs == {"gaps": 1}
    assert load_recordings([path], max_gap=1.0).reports[0].repairs == {}


def test_inspection_of_a_useless_recording_shows_its_defects(tmp_path: Path) -> None:
    messages = stamped(np.full((100, 2), 0.3))
    messages[5].positions = [1.0]
    messages[7].positions = [np.nan, 0.3]
    found = inspect_recording(write_bag(tmp_path / "x", "mcap", messages))
    assert found.refusal is not None
    assert found.repairs == {"malformed": 1, "non_finite": 1}


def test_field_of_messages_needs_their_topic(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "x", "mcap", stamped(reaching([0.1, 1.1])))
    with pytest.raises(RecordingError, match="'states' needs a topic"):
        load_recordings([path], state_field="states")
    (refusal,) = load_recordings([path], topic="/joint_states", state_field="states").refused
    assert "no field of 'states' is called 'states'" in refusal.reason
    found = inspect_recording(path, "/joint_states", state_field="states")
    assert found.refusal == refusal.reason
