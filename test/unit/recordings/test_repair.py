# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Each defect is put into joint states, and found again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from support.bags import EPOCH, S, reaching

from mp_pca_planner.exceptions import RecordingError
from mp_pca_planner.recordings.joint_states import JointStates
from mp_pca_planner.recordings.recording import REPAIRS
from mp_pca_planner.recordings.repair import repair

MOTION = reaching([0.1, 1.1])
"""Two joints for 3 s at 100 Hz, never both zero."""

N = len(MOTION)
ROWS = np.arange(N)
STAMPS = EPOCH + ROWS * (S // 100)
HALF = N // 2


def states(
    positions: np.ndarray = MOTION,
    stamps: np.ndarray = STAMPS,
    received: np.ndarray | None = None,
    names: tuple[str, ...] = ("a", "b"),
) -> JointStates:
    """Joint states that are received as they are stamped; NaN in all of a column is not listed."""
    listed = np.ones(positions.shape, dtype=bool)
    return JointStates(
        "/joint_states", names, stamps, stamps if received is None else received, positions, listed
    )


def published(*publishers: tuple[str, np.ndarray, np.ndarray]) -> JointStates:
    """Joint states of publishers of a joint each: its name, times [s] and positions."""
    names = tuple(dict.fromkeys(name for name, _, _ in publishers))
    columns = np.concatenate([[names.index(name)] * len(t) for name, t, _ in publishers])
    times = np.concatenate([t for _, t, _ in publishers])
    order = np.argsort(times, kind="stable")
    listed = columns[:, None] == np.arange(len(names))
    values = np.where(listed, np.concatenate([q for _, _, q in publishers])[:, None], np.nan)
    stamps = EPOCH + np.round(times * S).astype(np.int64)
    raw = states(values[order], stamps[order], names=names)
    return replace(raw, listed=listed[order])


def together(first: JointStates, *others: JointStates) -> JointStates:
    """All messages in the order of their reception."""
    for one in others:
        first = first.followed_by(one)
    return taken(first, np.argsort(first.receive_stamps, kind="stable"))


def taken(raw: JointStates, rows: np.ndarray) -> JointStates:
    arrays = ("header_stamps", "receive_stamps", "positions", "listed")
    return replace(raw, **{name: getattr(raw, name)[rows] for name in arrays})


def put(values: np.ndarray, rows: object, change: object) -> np.ndarray:
    """A copy with other values in some rows."""
    changed = values.copy()
    changed[rows] = change
    return changed


def shifted(values: np.ndarray, rows: object, by: object) -> np.ndarray:
    return put(values, rows, values[rows] + by)


def noisy(seed: int, motion: np.ndarray = MOTION, deviation: float = np.deg2rad(1.0)) -> np.ndarray:
    return motion + np.random.default_rng(seed).normal(0.0, deviation, motion.shape)


def late(positions: np.ndarray, rate: float) -> JointStates:
    """Twenty messages are received after the next one."""
    order = np.arange(len(positions))
    for row in np.random.default_rng(1).choice(len(order) - 1, 20, replace=False):
        order[[row, row + 1]] = order[[row + 1, row]]
    stamps = EPOCH + np.round(np.arange(len(order)) * S / rate).astype(np.int64)
    return states(positions[order], stamps[order], stamps)


NAN = put(put(MOTION, ([7, 8, 20, 21], [0, 0, 1, 0]), np.nan), (20, 1), np.inf)
NAN[21, 0] = np.finfo(float).max
FROZEN = put(MOTION, slice(140, 180), MOTION[140])
SLOW = reaching([0.1, 1.1], rate=30)
THIRTIETHS = EPOCH + np.arange(len(SLOW)) * (S // 30)
COARSE = np.round(MOTION / np.deg2rad(0.5)) * np.deg2rad(0.5)
COARSE = shifted(COARSE, (slice(280, None), 1), 0.7)
JUMPING = shifted(MOTION, (slice(150, None), 0), 4.0)
# As a shoulder near its singularity turns, where its angles follow from markers.
FAST = shifted(shifted(MOTION, (slice(150, None), 0), 1.0), (slice(150, 152), 0), [-0.7, -0.3])
SPIKED = [40, 150, 160, 260]
BACK = {seconds: shifted(STAMPS, slice(HALF, None), int(-seconds * S)) for seconds in (2.0, 0.3)}
DELAYED = put(STAMPS, slice(130, 160), STAMPS[160] - np.arange(30, 0, -1) * (S // 2000))
LONG_REST = reaching([0.1, 1.1, 0.1], rest=0.5)
HALVES = [MOTION[:HALF], MOTION[HALF:]]
WITHOUT = {rows: np.delete(MOTION, rows, axis=0) for rows in (70, (3, 4, 5), tuple(SPIKED))}
REPEATED = np.insert(ROWS, [91, 112, 133], [90, 111, 132])
CONTRADICTED = put(MOTION[REPEATED], [91, 113, 135], MOTION[140] + 0.016)


def zeros(n: int, rate: float, offset: int) -> JointStates:
    return states(np.zeros((n, 2)), EPOCH + offset + np.arange(n) * round(S / rate))


CASES = {
    "clean": (states(), {}, [MOTION]),
    "NaN": (states(NAN), {"non_finite": 4}, [np.delete(MOTION, [7, 8, 20, 21], axis=0)]),
    "frozen in a motion": (
        states(FROZEN),
        {"jumps": 1, "frozen": 39},
        [MOTION[:141], MOTION[180:]],
    ),
    "joint that is read at 3 Hz": (
        states(np.repeat(SLOW[::10], 10, axis=0), THIRTIETHS),
        {},
        [np.repeat(SLOW[::10], 10, axis=0)],
    ),
    "rest of a coarse encoder": (states(COARSE), {"jumps": 1}, [COARSE[:280], COARSE[280:]]),
    "jump that is no turn": (states(JUMPING), {"jumps": 1}, [JUMPING[:150], JUMPING[150:]]),
    "fast for several samples": (states(FAST), {}, [FAST]),
    "passing zero": (states(MOTION - MOTION[0]), {}, [MOTION - MOTION[0]]),
    **{
        f"spikes of {size}": (
            states(shifted(MOTION, (SPIKED, 1), size)),
            {"spikes": 4},
            [WITHOUT[tuple(SPIKED)]],
        )
        for size in (-1.0, 0.3)
    },
    **{
        f"stamp off by {error}": (
            states(stamps=shifted(STAMPS, 70, error * S), received=STAMPS),
            {"stray_stamps": 1},
            [WITHOUT[70]],
        )
        for error in (-1000, 1000)
    },
    **{
        f"clock back by {seconds}": (states(stamps=stamps), {"clock_jumps": 1}, HALVES)
        for seconds, stamps in BACK.items()
    },
    "gap": (taken(states(), np.r_[0:100, 180:N]), {"gaps": 1}, [MOTION[:100], MOTION[180:]]),
    "unstamped": (
        states(stamps=put(STAMPS, slice(3, 6), 0), received=STAMPS),
        {"unstamped": 3},
        [WITHOUT[3, 4, 5]],
    ),
    "zeros with equal stamps": (
        together(zeros(N, 100, 0), states()),
        {"contradicting": N},
        [MOTION],
    ),
    "zeros behind": (together(states(), zeros(N, 100, 0)), {"contradicting": N}, [MOTION]),
    **{
        f"zeros between at {rate} Hz": (
            together(states(), zeros(3 * rate, rate, 3_000_000)),
            {"zeros": 3 * rate},
            [MOTION],
        )
        for rate in (40, 250)
    },
    "few contradictions": (
        states(CONTRADICTED, STAMPS[REPEATED]),
        {"contradicting": 3},
        [MOTION],
    ),
    "other publisher": (
        together(states(), states(np.zeros((N, 1)), STAMPS + 3, names=("finger",))),
        {"missing_joints": N},
        [MOTION],
    ),
    **{
        f"messages swapped at {rate} Hz": (
            late(noisy(1, reaching([0.1, 1.1, -0.4, 0.5], rate=rate)), rate),
            {"out_of_order": 20},
            None,
        )
        for rate in (50.0, 500.0)
    },
    # Other holes are no steps of the clock.
    **{
        f"{what} and noise of {noise:.2f}": (
            taken(states(noisy(2, motion, noise), stamps), rows),
            {},
            None,
        )
        for noise in (0.0, np.deg2rad(1.0))
        for what, motion, stamps, rows in (
            ("lost messages", MOTION, STAMPS, np.r_[0:130, 160:N]),
            ("delayed messages", MOTION, DELAYED, ROWS),
            ("clock forward at rest", MOTION, shifted(STAMPS, slice(50, None), 3 * S // 10), ROWS),
            ("lost rest", LONG_REST, EPOCH + np.arange(350) * (S // 100), np.r_[0:151, 199:350]),
        )
    },
}


@pytest.mark.parametrize("case", CASES)
def test_a_defect_is_counted_and_nothing_else_changes(case: str) -> None:
    raw, repairs, pieces = CASES[case]
    clean = repair(raw, ["a", "b"])
    assert clean.repairs == repairs
    assert clean.notes == ()
    for piece, expected in zip(clean.pieces, pieces or [], strict=bool(pieces)):
        np.testing.assert_array_equal(piece.positions, expected)


def test_facts_of_a_clean_recording() -> None:
    clean = repair(states(put(MOTION, (slice(None), 1), 0.0)))
    assert clean.joint_names == ("a", "b") and clean.all_notes == ("joints that never move: 'b'",)
    assert (clean.rate, clean.duration) == pytest.approx((100.0, (N - 1) / 100))
    np.testing.assert_allclose(clean.pieces[0].times, ROWS / 100, atol=1e-9)


def test_turns_at_once_are_taken_out() -> None:
    clean = repair(states(shifted(MOTION, (slice(150, None), 0), 6 * np.pi)))
    assert clean.repairs == {"wrapped": 1}
    np.testing.assert_allclose(clean.pieces[0].positions, MOTION, atol=1e-12)


def test_times_begin_with_the_first_message_even_if_it_is_unusable_or_late() -> None:
    (piece,) = repair(states(put(MOTION, slice(0, 20), np.nan))).pieces
    assert piece.times[0] == pytest.approx(0.2)
    order = np.r_[1, 0, 2:N]
    (piece,) = repair(states(MOTION[order], STAMPS[order])).pieces
    np.testing.assert_allclose(piece.times[:2], [0.0, 0.01], atol=1e-9)
    clean = repair(taken(states(), np.r_[0:100, 180:N]))
    assert clean.pieces[1].times[0] == pytest.approx(1.8)


def test_joints_that_some_messages_lack_are_noted() -> None:
    raw = states(put(MOTION, (5, 1), np.nan))
    clean = repair(replace(raw, listed=put(raw.listed, (5, 1), False)))
    assert clean.joint_names == ("a",) and clean.repairs == {}
    assert clean.notes == ("joints left out, as not every message has them: 'b'",)
    # Messages without joints are no reason to choose.
    clean = repair(replace(raw, listed=put(raw.listed, 5, False)))
    assert clean.joint_names == ("a", "b") and clean.repairs == {"missing_joints": 1}


def test_joints_of_several_publishers_are_joined_by_time() -> None:
    often, seldom = np.arange(0.0, 4.0, 0.01), np.arange(0.503, 3.2, 0.027)
    wrapped = (seldom + np.pi) % (2.0 * np.pi) - np.pi  # jumps at 3.14 s
    finger = ("finger", np.zeros(1), np.zeros(1))
    clean = repair(published(("b", seldom, wrapped), ("a", often, 0.5 * often), finger), ["b", "a"])
    for piece in clean.pieces:
        times = piece.times + 0.51  # of the first message between two of the other publisher
        np.testing.assert_allclose(piece.positions, np.outer(times, [1.0, 0.5]), atol=1e-8)
    n = sum(piece.times.size for piece in clean.pieces)
    assert clean.pieces[-1].times[-1] + 0.51 > 3.16
    assert clean.repairs == {"missing_joints": often.size - n + 1, "wrapped": 1}
    assert clean.notes[0].startswith("no message lists all of the joints")


def test_nothing_is_joined_across_a_gap_of_one_publisher() -> None:
    times = np.arange(0.0, 4.0, 0.01)
    some = times[np.abs(times - 2.0) > 0.4]
    raw = published(("a", times, np.sin(times)), ("b", some + 0.003, np.cos(some + 0.003)))
    before, after = repair(raw, ["a", "b"]).pieces
    assert before.times[-1] < 1.61 and after.times[0] > 2.39
    np.testing.assert_allclose(after.positions[:, 1], np.cos(after.times + 0.01), atol=1e-4)


def test_publishers_with_stamps_out_of_order_are_joined_by_reception() -> None:
    times = np.arange(0.0, 3.0, 0.01)
    raw = published(("a", times, times), ("b", times + 0.004, times + 0.004))
    stamps = np.where(raw.listed[:, 1], 0, raw.header_stamps)
    clean = repair(replace(raw, header_stamps=stamps), ["a", "b"])
    np.testing.assert_allclose(clean.pieces[0].positions[:, 1], times[1:], atol=1e-8)


TIMES = np.arange(0.0, 2.0, 0.01)
MIXED = together(states(), states(np.zeros((1, 1)), STAMPS[-1:] + S, names=("finger",)))
OTHER = states(MOTION + 0.5)
BETWEEN = states(MOTION + 0.5, STAMPS + 3_000_000)
NEVER = states(np.column_stack([MOTION, np.full(N, np.nan)]), names=("a", "b", "finger"))
UNSTAMPED = np.zeros(N, dtype=np.int64)
BURSTS = states(stamps=UNSTAMPED, received=EPOCH + ROWS // 20 * S // 5 + ROWS % 20 * 1000)


@pytest.mark.parametrize(
    ("raw", "joints", "sentence"),
    [
        (MIXED, None, r"choose the joints, .* 'a', 'b'; 'finger'"),
        (MIXED, ["a", "finger"], "no message lists all of the joints"),
        (
            published(("a", TIMES, TIMES), ("b", TIMES + 3.0, TIMES)),
            ["a", "b"],
            "'a', 'b' together, .* don't overlap in time",
        ),
        (NEVER, None, "never of 'finger'"),
        *((taken(states(), ROWS[100 : 100 + n]), None, f"{n} usable samples") for n in (1, 9)),
        (states(stamps=STAMPS + 2 * S * (ROWS // 5)), None, f"in {N // 5 - 1} places"),
        (taken(states(), ROWS[:0]), None, "no well-formed message"),
        (together(states(), OTHER), None, "two publishers"),
        (together(states(), BETWEEN), None, r"jump \d+ times.*two publishers"),
        (together(states(), taken(BETWEEN, ROWS[::2])), None, r"jump \d+ times.*two publishers"),
        (BURSTS, None, "received in bursts within 2.8 s"),
        (
            states(stamps=UNSTAMPED, received=EPOCH + ROWS * 20_000),
            None,
            r"no usable time.*300 messages.*within 0.00598 s",
        ),
    ],
)
def test_messages_that_are_no_recording_are_refused(
    raw: JointStates, joints: list[str] | None, sentence: str
) -> None:
    with pytest.raises(RecordingError, match=sentence):
        repair(raw, joints)


def test_slow_recording_has_no_gaps() -> None:
    slow = reaching([0.1, 1.1], rate=5.0, reach=10.0)
    assert repair(states(slow, EPOCH + np.arange(len(slow)) * (2 * S // 3))).repairs == {}


@pytest.mark.parametrize(
    ("raw", "notes"),
    [
        (
            states(stamps=UNSTAMPED, received=STAMPS),
            ("no usable header stamps: times of reception are used",),
        ),
        # Simulation time, for example.
        (states(stamps=STAMPS - EPOCH + 12 * S, received=EPOCH + ROWS * 13_000_000), ()),
    ],
)
def test_the_use_of_times_of_reception_is_noted(raw: JointStates, notes: tuple[str, ...]) -> None:
    clean = repair(raw)
    assert (clean.rate, clean.duration) == pytest.approx((100.0, (N - 1) / 100))
    assert clean.notes == notes


@given(
    stamps=hnp.arrays(np.int64, st.integers(1, 60), elements=st.integers(0, 4 * S)),
    positions=hnp.arrays(np.float64, (60, 2), elements=st.floats(-4, 4) | st.just(np.nan)),
)
def test_whatever_comes_in_pieces_are_usable_or_refused(
    stamps: np.ndarray, positions: np.ndarray
) -> None:
    try:
        clean = repair(states(positions[: stamps.size], stamps, EPOCH + stamps))
    except RecordingError:
        return
    assert set(clean.repairs) <= set(REPAIRS)
    assert min(clean.repairs.values(), default=1) > 0
    times = np.concatenate([piece.times for piece in clean.pieces])
    assert np.all(np.diff(times) > 0)
    assert times[0] >= 0
    assert all(np.isfinite(piece.positions).all() for piece in clean.pieces)


def test_samples_of_a_fast_recording_are_averaged() -> None:
    seconds = np.arange(3000) / 1000
    positions = np.column_stack([np.sin(seconds), seconds])
    clean = repair(states(positions, EPOCH + np.arange(3000) * (S // 1000)))
    (piece,) = clean.pieces
    assert (clean.rate, clean.sample_rate) == pytest.approx((1000.0, 100.0))
    assert piece.times.size == 300
    expected = np.column_stack([np.sin(piece.times), piece.times])
    np.testing.assert_allclose(piece.positions, expected, atol=1e-5)
