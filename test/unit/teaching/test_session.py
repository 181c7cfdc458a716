# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A teaching session: the same motions as offline, as the recording grows and when continued."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from support.bags import reaching, stamped, write_bag

from mp_pca_planner.exceptions import RecordingError
from mp_pca_planner.recordings.bags import JOINT_STATE
from mp_pca_planner.recordings.demonstration import Demonstration
from mp_pca_planner.recordings.load import load_recordings
from mp_pca_planner.teaching.session import (
    KEYS,
    StoredStates,
    TeachingSession,
    hold_dialogue,
    stored_states,
)

GOALS = (0.0, 1.0, 0.2, 0.9)


def states(folder: Path, positions: np.ndarray, bag_format: str = "mcap") -> StoredStates:
    path = write_bag(folder / f"made_{positions.shape[0]}", bag_format, stamped(positions))
    return stored_states(path)[1]


def session(folder: Path) -> TeachingSession:
    return TeachingSession(folder / "taught.npz", "/joint_states", None)


def shown(lines: list[str]) -> list[int]:
    """Numbers of the motions that are said to be new."""
    return [int(line.split()[1][:-1]) for line in lines if line.startswith("motion ")]


def spans(motions: tuple[Demonstration, ...]) -> list[tuple[float, float]]:
    return [(motion.start_time, motion.end_time) for motion in motions]


def test_motions_are_those_that_are_cut_offline(tmp_path: Path, bag_format: str) -> None:
    bag = write_bag(tmp_path / "example", bag_format, stamped(reaching(GOALS)))
    (_, messages), lines = stored_states(bag), list[str]()
    with session(tmp_path) as taught:
        for k in range(0, len(messages), 50):
            taught.record(messages[k : k + 50])
            lines += taught.update()
        lines += taught.update(is_over=True)
        expected = load_recordings(bag).demonstrations
        assert spans(taught.motions) == spans(expected)
        for own, other in zip(taught.motions, expected, strict=True):
            np.testing.assert_array_equal(own.positions, other.positions)
        assert shown(lines) == list(range(1, len(expected) + 1))  # each once


def test_a_continued_session_has_the_earlier_motions_but_the_discarded(tmp_path: Path) -> None:
    with session(tmp_path) as taught:
        taught.record(states(tmp_path, reaching(GOALS)))
        taught.update(is_over=True)
        last = taught.discard_last()
        assert last is not None and not shown(taught.update(is_over=True))
        kept = spans(taught.motions)
        assert len(kept) == 2 and last.start_time > kept[-1][1]
    for _ in range(2):
        with session(tmp_path) as taught:
            assert shown(taught.update()) == [1, 2]
            assert spans(taught.motions) == kept
            taught.write_segments()
    segments = tmp_path / "taught_segments.csv"
    table = load_recordings(tmp_path / "taught.mcap", segments_csv=segments)
    np.testing.assert_allclose(spans(table.demonstrations), kept, rtol=0.0, atol=1e-6)


def test_a_motion_that_the_recording_cuts_off_is_left_out(tmp_path: Path) -> None:
    positions, lines = reaching(GOALS)[:-150], list[str]()  # ends within the last motion
    with session(tmp_path) as taught:
        for message in states(tmp_path, positions):
            taught.record([message])
            lines += taught.update()
        assert shown(lines) == [1, 2]  # each when the arm rests, the third is under way
        lines = taught.update(is_over=True)
        assert not shown(lines) and "lack their start or end" in lines[0]


def test_the_first_goal_is_that_of_the_motion_from_where_the_arm_is(tmp_path: Path) -> None:
    with session(tmp_path) as taught:
        taught.record(states(tmp_path, reaching((0.0, 1.0, 0.0))))
        taught.update(is_over=True)
        names, goal, words = taught.first_goal()
    np.testing.assert_allclose(goal, [1.0, -0.5], atol=0.01)
    assert words.startswith(f"{names[0]}=1.00,{names[1]}=-0.50 [rad]")


def test_the_recording_is_complete_from_the_first_motion_on(tmp_path: Path) -> None:
    """An independent reader finds the messages; a process that is killed leaves them."""
    positions, path = reaching(GOALS), tmp_path / "taught.mcap"
    messages = states(tmp_path, positions)
    killed = session(tmp_path)
    for n in range(100, len(messages), 100):
        killed.record(messages[n - 100 : n])
        killed.update()
    assert len(killed.motions) == 2  # the third was under way
    with AnyReader([path]) as reader:
        (connection,) = reader.connections
        assert (connection.topic, connection.msgtype) == ("/joint_states", JOINT_STATE)
        kept = [(stamp, bytes(data)) for _, stamp, data in reader.messages()]
    assert len(kept) > 400 and kept == messages[: len(kept)]
    with session(tmp_path) as taught:
        taught.update()
        assert spans(taught.motions) == spans(killed.motions)
        taught.record(messages[len(kept) :])
        assert shown(taught.update(is_over=True)) == [3]
    assert stored_states(path)[1] == messages


def test_files_of_others_and_of_other_topics_are_left_alone(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "made", "mcap", stamped(reaching(GOALS)))
    taught = tmp_path / "taught.mcap"
    discarded = tmp_path / "taught_discarded.csv"
    discarded.write_text("recording,start_time_s,end_time_s\nother,1,2\n")
    with pytest.raises(RecordingError, match="no recording is called 'other'"):
        session(tmp_path)
    for content, reason in (
        (next(path.glob("*.mcap")).read_bytes(), "holds other topics than '/x'"),
        (b"\x89MCAP0\r\nanother program's", "can't be read"),
    ):
        taught.write_bytes(content)
        with pytest.raises(RecordingError, match=reason):
            TeachingSession(tmp_path / "taught.npz", "/x", None)
        assert taught.read_bytes() == content


class Silent:
    """A source without messages, such as a topic that nobody publishes on."""

    pause = 1e-6

    def feed(self, record: Callable[[StoredStates], None]) -> None:
        record([])

    def silence(self) -> str:
        return "nobody publishes"


class Pressed:
    """Keys of a person who waits for some time."""

    def __init__(self, keys: str, n_pauses: int = 30) -> None:
        self.keys, self.n_left = list(keys), n_pauses

    def pressed(self, timeout: float | None) -> str | None:
        self.n_left -= timeout is not None
        return "" if timeout and self.n_left > 0 else self.keys.pop(0)


def dialogue(folder: Path, source: Silent | None, keys: str) -> list[str]:
    lines: list[str] = []
    with session(folder) as taught:
        pressed = Pressed(keys).pressed
        hold_dialogue(taught, source, pressed, lambda *x: lines.extend(x))
    return lines


def test_the_dialogue_names_keys_and_silence(tmp_path: Path) -> None:
    reason = "no motion yet: there is no well-formed message on '/joint_states'"
    assert dialogue(tmp_path, Silent(), "q") == ["nobody publishes"]  # once
    assert dialogue(tmp_path, None, "ybdq") == [
        reason,
        f"'y' does nothing: {KEYS}",
        "there is no motion to build a primitive from",
        "there is no motion to discard",
    ]
    with session(tmp_path) as taught:
        taught.record(states(tmp_path, reaching(GOALS[:2])))
    assert "nobody publishes" in dialogue(tmp_path, Silent(), "q")
    assert "motion 1 is discarded: 0 left" in dialogue(tmp_path, None, "dq")
