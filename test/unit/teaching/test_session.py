# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A teaching session: the same motions as offline, as the recording grows and when continued."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from support.bags import minimum_jerk, reaching, stamped, write_bag

from mp_pca_planner.exceptions import RecordingError
from mp_pca_planner.recordings.demonstration import Demonstration
from mp_pca_planner.recordings.load import load_recordings
from mp_pca_planner.recordings.synthetic import write_example_recording
from mp_pca_planner.teaching.dialogue import KEYS, PlayedBag, SessionWords, hold_dialogue
from mp_pca_planner.teaching.session import TeachingSession

GOALS = (0.0, 1.0, 0.2, 0.9)


def played(folder: Path, positions: np.ndarray, bag_format: str = "mcap") -> PlayedBag:
    path = write_bag(folder / f"made_{positions.shape[0]}", bag_format, stamped(positions))
    return PlayedBag(path)


def session(folder: Path) -> TeachingSession:
    return TeachingSession(folder / "taught.npz", "/joint_states", None)


def spans(motions: tuple[Demonstration, ...]) -> list[tuple[float, float]]:
    return [(motion.start_time, motion.end_time) for motion in motions]


def feed_all(source: PlayedBag, into: TeachingSession) -> None:
    while source.feed(into.record):
        pass


def test_motions_are_those_that_are_cut_offline(tmp_path: Path) -> None:
    bag = write_example_recording(tmp_path / "example.mcap", 8)
    source, found = PlayedBag(bag), list[Demonstration]()
    with session(tmp_path) as taught:
        while source.feed(taught.record):
            new, _, _ = taught.update()
            found += new
        new, _, _ = taught.update(is_over=True)
        found += new
        expected = load_recordings(bag).demonstrations
        assert spans(taught.motions) == spans(expected)
        for own, other in zip(taught.motions, expected, strict=True):
            np.testing.assert_array_equal(own.positions, other.positions)
        # Each was shown once.
        assert [one.start_time for one in found] == pytest.approx(
            [one.start_time for one in expected], abs=0.05
        )


def test_joint_states_of_every_format_are_recorded(tmp_path: Path, bag_format: str) -> None:
    source = played(tmp_path, reaching(GOALS), bag_format)
    with session(tmp_path) as taught:
        feed_all(source, taught)
        taught.update(is_over=True)
        assert len(taught.motions) == 3
    assert len(load_recordings(tmp_path / "taught.mcap").demonstrations) == 3


def test_a_motion_is_shown_when_the_arm_rests(tmp_path: Path) -> None:
    positions = reaching(GOALS[:2])  # rests 1 s, moves 1 s, rests 1 s
    shown = []
    with session(tmp_path) as taught:
        for message in stamped_messages(tmp_path, positions):
            taught.record([message])
            found, _, _ = taught.update()
            shown.append(len(found))
    (step,) = np.flatnonzero(shown)
    assert 250 < step < 290
    assert shown[step] == 1


def stamped_messages(folder: Path, positions: np.ndarray) -> list[tuple[int, bytes]]:
    messages = list[tuple[int, bytes]]()
    source = played(folder, positions)
    while source.feed(messages.extend):
        pass
    return messages


def test_a_continued_session_has_the_earlier_motions_but_the_discarded(tmp_path: Path) -> None:
    with session(tmp_path) as taught:
        feed_all(played(tmp_path, reaching(GOALS)), taught)
        taught.update(is_over=True)
        last = taught.discard_last()
        assert last is not None
        kept = spans(taught.motions)
        assert len(kept) == 2 and last.start_time > kept[-1][1]
    for _ in range(2):
        with session(tmp_path) as taught:
            found, _, _ = taught.update()
            assert spans(found) == kept
            taught.write_segments()
    segments = tmp_path / "taught_segments.csv"
    table = load_recordings(tmp_path / "taught.mcap", segments_csv=segments)
    np.testing.assert_allclose(spans(table.demonstrations), kept, rtol=0.0, atol=1e-6)


def test_discarding_ends_with_the_first_motion(tmp_path: Path) -> None:
    with session(tmp_path) as taught:
        assert taught.discard_last() is None
        feed_all(played(tmp_path, reaching(GOALS)), taught)
        taught.update(is_over=True)
        assert [taught.discard_last() is not None for _ in range(4)] == [True] * 3 + [False]
        found, _, _ = taught.update(is_over=True)
        assert found == ()


def test_a_motion_that_the_recording_cuts_off_is_left_out(tmp_path: Path) -> None:
    positions = reaching(GOALS)[:-150]  # ends within the last motion
    with session(tmp_path) as taught:
        feed_all(played(tmp_path, positions), taught)
        found, _, _ = taught.update()
        assert found == ()
        found, _, notes = taught.update(is_over=True)
    assert len(found) == 2
    assert "lacks the start or the end" in notes[0]


def test_small_movements_are_left_out_with_a_note(tmp_path: Path) -> None:
    small = np.concatenate([minimum_jerk(1.0, 0.92, 40), np.full(100, 0.92)])
    positions = np.concatenate([reaching(GOALS[:2]), np.column_stack([small, -0.5 * small])])
    with session(tmp_path) as taught:
        feed_all(played(tmp_path, positions), taught)
        found, _, notes = taught.update(is_over=True)
    assert len(found) == 1
    assert notes == ("1 motions over less than 10% of the extent of the largest are left out",)


def test_the_first_goal_is_that_of_the_motion_from_where_the_arm_is(tmp_path: Path) -> None:
    with session(tmp_path) as taught:
        feed_all(played(tmp_path, reaching((0.0, 1.0, 0.0))), taught)
        taught.update(is_over=True)
        np.testing.assert_allclose(taught.first_goal(), [1.0, -0.5], atol=0.01)


def test_tables_that_are_damaged_are_refused(tmp_path: Path) -> None:
    discarded = tmp_path / "taught_discarded.csv"
    discarded.write_text("recording,start_time_s,end_time_s\nother,1,2\n")
    with pytest.raises(RecordingError, match="no recording is called 'other'"):
        session(tmp_path)
    discarded.unlink()
    with session(tmp_path) as taught:
        _, _, notes = taught.update()
        assert notes == ()


class Silent:
    """A source without messages, such as a topic that nobody publishes on."""

    def __init__(self, n_looks: int) -> None:
        self.n_left = n_looks

    def feed(self, record: Callable[[Sequence[tuple[int, bytes]]], None]) -> bool:
        self.n_left -= 1
        record([])
        return self.n_left >= 0

    def silence(self) -> str:
        return "nobody publishes"


class Pressed:
    """Keys of a person who waits until the source has ended."""

    def __init__(self, keys: str) -> None:
        self.keys = list(keys)

    def pressed(self, timeout: float | None) -> str | None:
        return "" if timeout else self.keys.pop(0)


def dialogue(folder: Path, source: Silent, keys: str) -> list[str]:
    lines: list[str] = []
    with session(folder) as taught:
        hold_dialogue(
            taught,
            source.feed,
            Pressed(keys).pressed,
            SessionWords(),
            lambda *x: lines.extend(x),
            pause=1e-6,
            silence=source.silence,
        )
    return lines


def test_a_topic_that_stays_silent_is_named_once(tmp_path: Path) -> None:
    reason = "no motion yet: there is no well-formed message on '/joint_states'"
    assert dialogue(tmp_path, Silent(30), "q") == ["nobody publishes", reason]
    assert dialogue(tmp_path, Silent(0), "q") == [reason]


def test_a_continued_session_names_a_silent_topic_too(tmp_path: Path) -> None:
    with session(tmp_path) as taught:
        feed_all(played(tmp_path, reaching(GOALS[:2])), taught)
    assert "nobody publishes" in dialogue(tmp_path, Silent(30), "q")


def test_a_key_without_a_meaning_is_named(tmp_path: Path) -> None:
    lines = dialogue(tmp_path, Silent(0), "ybq")
    assert lines[1:] == [
        f"'y' does nothing: {KEYS}",
        "there is no motion to build a primitive from",
    ]


def test_reasons_are_not_given_while_more_follows(tmp_path: Path) -> None:
    with session(tmp_path) as taught:
        feed_all(played(tmp_path, np.zeros((5, 2))), taught)
        _, _, notes = taught.update(explains=False)
        assert notes == ()
        _, _, notes = taught.update()
        assert "5 usable samples" in notes[0]
