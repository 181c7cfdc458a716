# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Each defect is put into a bag, and found again."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from support.bags import EPOCH, Message, S, reaching, read_joint_states, stamped, write_bag

from mp_pca_planner.exceptions import RecordingError
from mp_pca_planner.recordings.joint_states import IntArray, JointStates
from mp_pca_planner.recordings.recording import REPAIRS, Recording
from mp_pca_planner.recordings.repair import repair

MOTION = reaching([0.1, 1.1])
"""Two joints for 3 s at 100 Hz, never both zero."""

N = len(MOTION)


class Bag:
    """Writes messages and repairs what is read from the bag."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def repaired(self, messages: list[Message], joints: list[str] | None = None) -> Recording:
        path = write_bag(self.folder / "x", "mcap", messages)
        return repair(read_joint_states(path, "/joint_states"), joints)


def states(stamps: IntArray, received: IntArray, positions: np.ndarray) -> JointStates:
    """Joint states that need no bag."""
    listed = np.ones(positions.shape, dtype=bool)
    return JointStates("/joint_states", ("a", "b"), stamps, received, positions, listed)


def cleaned(positions: np.ndarray, rate: int = 100) -> Recording:
    """Repair positions that need no bag."""
    stamps = EPOCH + np.arange(len(positions)) * (S // rate)
    return repair(states(stamps, stamps, positions))


@pytest.fixture
def bag(tmp_path: Path) -> Bag:
    return Bag(tmp_path)


def test_clean_recording_is_left_as_it_is(bag: Bag) -> None:
    clean = bag.repaired(stamped(MOTION))
    (piece,) = clean.pieces
    assert clean.joint_names == ("a", "b")
    assert clean.repairs == {}
    assert clean.notes == ()
    assert clean.rate == pytest.approx(100.0)
    assert clean.duration == pytest.approx((N - 1) / 100)
    np.testing.assert_array_equal(piece.positions, MOTION)
    np.testing.assert_allclose(piece.times, np.arange(N) / 100, atol=1e-9)


def test_joints_are_taken_by_name_whatever_their_order(bag: Bag) -> None:
    messages = stamped(MOTION)
    for message in messages[1::3]:
        message.names, message.positions = ("b", "a"), message.positions[::-1]
    clean = bag.repaired(messages)
    np.testing.assert_array_equal(clean.pieces[0].positions, MOTION)
    assert clean.repairs == {}
    assert clean.notes == ()


def test_messages_of_another_publisher_are_counted_and_dropped(bag: Bag) -> None:
    gripper = stamped(np.zeros((N, 1)), names=("finger",), start=EPOCH + 3)
    both = sorted([*stamped(MOTION), *gripper], key=lambda message: message.stamp)
    clean = bag.repaired(both, ["a", "b"])
    np.testing.assert_array_equal(clean.pieces[0].positions, MOTION)
    assert clean.repairs == {"missing_joints": N}


def published(name: str, times: np.ndarray, positions: np.ndarray) -> list[Message]:
    stamps = EPOCH + np.round(times * S).astype(int)
    return [Message((name,), [q], int(t)) for t, q in zip(stamps, positions, strict=True)]


def test_joints_of_several_publishers_are_joined_by_time(bag: Bag) -> None:
    often, seldom = np.arange(0.0, 4.0, 0.01), np.arange(0.503, 3.2, 0.027)
    wrapped = (seldom + np.pi) % (2.0 * np.pi) - np.pi  # jumps at 3.14 s
    messages = [*published("b", seldom, wrapped), *published("a", often, 0.5 * often)]
    messages.append(Message(("finger",), [0.0], EPOCH))
    messages.sort(key=lambda message: message.stamp)
    clean = bag.repaired(messages, ["b", "a"])
    for piece in clean.pieces:
        b, a = piece.positions.T
        times = piece.times + 0.51  # of the first message between two of the other publisher
        np.testing.assert_allclose(a, 0.5 * times, atol=1e-8)
        np.testing.assert_allclose(b, times, atol=1e-8)
    n = sum(piece.times.size for piece in clean.pieces)
    assert clean.pieces[-1].times[-1] + 0.51 > 3.16
    assert clean.repairs == {"missing_joints": often.size - n + 1, "wrapped": 1}
    assert clean.notes[0].startswith("no message lists all of the joints")


TIMES = np.arange(0.0, 2.0, 0.01)
WITH_FINGER = [*stamped(MOTION), Message(("finger",), [0.0], EPOCH + 5 * S)]
IN_PIECES = [
    Message(("a", "b"), row, EPOCH + (index + 200 * (index // 5)) * S // 100)
    for index, row in enumerate(MOTION)
]
AT_ONE_MOMENT = [
    *(Message(("a", "b"), [1.0, 2.0], EPOCH) for _ in range(50)),
    *(Message(("a", "b"), [np.nan, 2.0], EPOCH + index * S) for index in range(50)),
]


@pytest.mark.parametrize(
    ("messages", "joints", "sentence"),
    [
        (WITH_FINGER, None, r"choose the joints, .* 'a', 'b'; 'finger'"),
        (WITH_FINGER, ["a", "finger"], "no message lists all of the joints"),
        (
            [*published("a", TIMES, TIMES), *published("b", TIMES + 3.0, TIMES)],
            ["a", "b"],
            "'a', 'b' together, .* don't overlap in time",
        ),
        (
            stamped(np.column_stack([MOTION, np.full(N, np.nan)]), names=("a", "b", "finger")),
            None,
            "never of 'finger'",
        ),
        *((stamped(MOTION[100 : 100 + n]), None, f"{n} usable samples") for n in (1, 5, 9)),
        (IN_PIECES, None, f"in {N // 5 - 1} places"),
        (AT_ONE_MOMENT, None, "there are 1 usable samples"),
        ([Message((), [1.0], EPOCH)], None, "no well-formed message"),
    ],
)
def test_messages_that_are_no_recording_are_refused(
    bag: Bag, messages: list[Message], joints: list[str] | None, sentence: str
) -> None:
    with pytest.raises(RecordingError, match=sentence):
        bag.repaired(messages, joints)


def test_nothing_is_joined_across_a_gap_of_one_publisher(bag: Bag) -> None:
    times = np.arange(0.0, 4.0, 0.01)
    has_b = np.abs(times - 2.0) > 0.4
    late = times[has_b] + 0.003
    messages = [*published("a", times, np.sin(times)), *published("b", late, np.cos(late))]
    clean = bag.repaired(sorted(messages, key=lambda message: message.stamp), ["a", "b"])
    before, after = clean.pieces
    assert before.times[-1] < 1.61 and after.times[0] > 2.39
    np.testing.assert_allclose(after.positions[:, 1], np.cos(after.times + 0.01), atol=1e-4)


def test_publishers_with_stamps_out_of_order_are_joined_by_reception(bag: Bag) -> None:
    times = np.arange(0.0, 3.0, 0.01)
    messages = [*published("a", times, times), *published("b", times + 0.004, times + 0.004)]
    for message in messages:
        message.receive = message.stamp
        if message.names == ("b",):
            message.stamp = 0
    clean = bag.repaired(sorted(messages, key=lambda message: message.receive), ["a", "b"])
    np.testing.assert_allclose(clean.pieces[0].positions[:, 1], times[1:], atol=1e-8)


def test_messages_received_in_bursts_without_stamps_have_no_time(bag: Bag) -> None:
    messages = stamped(MOTION)
    for index, message in enumerate(messages):
        message.receive = EPOCH + index // 20 * S // 5 + index % 20 * 1000
        message.stamp = 0
    with pytest.raises(RecordingError, match="received in bursts within 2.8 s"):
        bag.repaired(messages)


def test_messages_without_joints_are_no_reason_to_choose(bag: Bag) -> None:
    clean = bag.repaired([*stamped(MOTION), Message((), [], EPOCH + 5 * S)])
    np.testing.assert_array_equal(clean.pieces[0].positions, MOTION)
    assert clean.repairs == {"missing_joints": 1}


def test_joints_that_some_messages_lack_are_noted(bag: Bag) -> None:
    messages = stamped(MOTION)
    messages[5].names, messages[5].positions = ("a",), MOTION[5, :1]
    clean = bag.repaired(messages)
    assert clean.joint_names == ("a",)
    assert clean.notes[0] == "joints left out, as not every message has them: 'b'"


def test_messages_with_nan_are_counted_and_dropped(bag: Bag) -> None:
    broken = MOTION.copy()
    broken[[7, 8], 0], broken[20, 1], broken[21, 0] = np.nan, np.inf, np.finfo(float).max
    clean = bag.repaired(stamped(broken))
    assert clean.repairs == {"non_finite": 4}
    np.testing.assert_array_equal(
        clean.pieces[0].positions, np.delete(MOTION, [7, 8, 20, 21], axis=0)
    )


def test_nan_of_a_joint_that_is_not_chosen_does_not_matter(bag: Bag) -> None:
    broken = MOTION.copy()
    broken[:, 1] = np.nan
    assert bag.repaired(stamped(broken), ["a"]).repairs == {}


@pytest.mark.parametrize("zeros_first", [True, False])
def test_second_publisher_of_zeros_with_equal_stamps_is_dropped(
    bag: Bag, zeros_first: bool
) -> None:
    pairs = zip(stamped(0.0 * MOTION), stamped(MOTION), strict=True)
    messages = [item for pair in pairs for item in pair[:: 1 if zeros_first else -1]]
    clean = bag.repaired(messages)
    assert clean.repairs == {"contradicting": N}
    np.testing.assert_array_equal(clean.pieces[0].positions, MOTION)


def test_publishers_that_contradict_each_other_are_refused(bag: Bag) -> None:
    pairs = zip(stamped(MOTION), stamped(MOTION + 0.5), strict=True)
    with pytest.raises(RecordingError, match="two publishers"):
        bag.repaired([message for pair in pairs for message in pair])


def test_a_few_contradictions_are_no_second_publisher(bag: Bag) -> None:
    messages = stamped(MOTION[60:])
    for place in (31, 52, 73):
        messages.insert(place, replace(messages[place - 1], positions=MOTION[80] + 0.016))
    clean = bag.repaired(messages)
    assert clean.repairs == {"contradicting": 3}
    np.testing.assert_array_equal(clean.pieces[0].positions, MOTION[60:])


def test_block_of_late_messages_is_no_second_publisher(bag: Bag) -> None:
    messages = [replace(message, receive=message.stamp) for message in stamped(MOTION)]
    late = messages[130:160]
    for message in late:
        message.receive = messages[165].stamp + 1
    clean = bag.repaired(messages[:130] + messages[160:166] + late + messages[166:])
    assert clean.repairs == {"out_of_order": 30}
    np.testing.assert_array_equal(clean.pieces[0].positions, MOTION)


@pytest.mark.parametrize("error", [-1000 * S, 1000 * S])
def test_single_wrong_stamp_is_dropped_and_shifts_nothing(bag: Bag, error: int) -> None:
    messages = stamped(MOTION)
    messages[70].receive = messages[70].stamp
    messages[70].stamp += error
    clean = bag.repaired(messages)
    assert clean.repairs == {"stray_stamps": 1}
    np.testing.assert_array_equal(clean.pieces[0].positions, np.delete(MOTION, 70, axis=0))
    assert clean.pieces[0].times[-1] == pytest.approx((N - 1) / 100)


@pytest.mark.parametrize("seconds", [2.0, 0.3])
def test_clock_that_is_set_back_while_recording_cuts(bag: Bag, seconds: float) -> None:
    """The clock gives the times of reception, too, by which messages of a chunk are sorted."""
    messages = stamped(MOTION)
    for message in messages[N // 2 :]:
        message.stamp -= int(seconds * S)
    for message in messages:
        message.receive = message.stamp
    clean = bag.repaired(messages)
    assert clean.repairs == {"clock_jumps": 1}
    for piece, part in zip(clean.pieces, (MOTION[: N // 2], MOTION[N // 2 :]), strict=True):
        np.testing.assert_array_equal(piece.positions, part)


@pytest.mark.parametrize("rate", [50.0, 500.0])
def test_noise_of_a_degree_is_no_second_publisher(bag: Bag, rate: float) -> None:
    rng = np.random.default_rng(1)
    motion = reaching([0.1, 1.1, -0.4, 0.5], rate=rate)
    messages = stamped(motion + rng.normal(0.0, np.deg2rad(1.0), motion.shape), rate=rate)
    for message in messages:
        message.receive = message.stamp
    for late in rng.choice(len(messages) - 1, 20, replace=False):
        messages[late], messages[late + 1] = messages[late + 1], messages[late]
    for message, time in zip(messages, sorted(x.stamp for x in messages), strict=True):
        message.receive = time
    assert set(bag.repaired(messages).repairs) == {"out_of_order"}


def test_gap_cuts_and_keeps_the_time(bag: Bag) -> None:
    messages = stamped(MOTION)
    clean = bag.repaired(messages[:100] + messages[180:])
    assert clean.repairs == {"gaps": 1}
    assert [piece.times.size for piece in clean.pieces] == [100, N - 180]
    assert clean.pieces[1].times[0] == pytest.approx(1.8)


def test_clock_that_is_set_forward_in_a_motion_cuts(bag: Bag) -> None:
    messages = stamped(MOTION)
    for message in messages[N // 2 :]:
        message.stamp += int(0.3 * S)
    clean = bag.repaired(messages)
    assert clean.repairs == {"clock_steps": 1}
    for piece, part in zip(clean.pieces, (MOTION[: N // 2], MOTION[N // 2 :]), strict=True):
        np.testing.assert_array_equal(piece.positions, part)


@pytest.mark.parametrize("noise", [0.0, np.deg2rad(1.0)])
@pytest.mark.parametrize("defect", ["lost", "delayed", "step at rest", "lost rest"])
def test_other_holes_are_no_steps_of_the_clock(bag: Bag, noise: float, defect: str) -> None:
    rng = np.random.default_rng(2)
    motion = reaching([0.1, 1.1, 0.1], rest=0.5) if defect == "lost rest" else MOTION
    messages = stamped(motion + rng.normal(0.0, noise, motion.shape))
    if defect == "lost rest":
        del messages[151:199]
    elif defect == "lost":
        del messages[130:160]
    elif defect == "delayed":
        for place, message in enumerate(messages[130:160]):
            message.stamp = messages[160].stamp - (30 - place) * S // 2000
    else:
        for message in messages[50:]:
            message.stamp += int(0.3 * S)
    assert bag.repaired(messages).repairs == {}


def test_slow_recording_has_no_gaps(bag: Bag) -> None:
    slow = reaching([0.1, 1.1], rate=5.0, reach=10.0)
    assert bag.repaired(stamped(slow, rate=1.5)).repairs == {}


def test_piece_that_is_too_short_is_counted_and_dropped(bag: Bag) -> None:
    messages = stamped(MOTION)
    clean = bag.repaired(messages[:3] + messages[80:])
    assert clean.repairs == {"gaps": 1, "short_pieces": 1}
    assert len(clean.pieces) == 1
    assert clean.pieces[0].times[0] == pytest.approx(0.8)


def test_positions_that_freeze_in_a_motion_are_no_rest(bag: Bag) -> None:
    frozen = MOTION.copy()
    frozen[140:180] = frozen[140]
    clean = bag.repaired(stamped(frozen))
    assert clean.repairs == {"jumps": 1, "frozen": 39}
    np.testing.assert_array_equal(clean.pieces[0].positions, MOTION[:141])
    np.testing.assert_array_equal(clean.pieces[1].positions, MOTION[180:])


def test_rest_of_a_coarse_encoder_before_a_jump_is_kept(bag: Bag) -> None:
    coarse = np.round(MOTION / np.deg2rad(0.5)) * np.deg2rad(0.5)
    coarse[280:, 1] += 0.7
    clean = bag.repaired(stamped(coarse))
    assert clean.repairs == {"jumps": 1}
    np.testing.assert_array_equal(clean.pieces[0].positions, coarse[:280])


def test_turns_at_once_are_taken_out(bag: Bag) -> None:
    turned = MOTION.copy()
    turned[150:, 0] += 6 * np.pi
    clean = bag.repaired(stamped(turned))
    assert clean.repairs == {"wrapped": 1}
    np.testing.assert_allclose(clean.pieces[0].positions, MOTION, atol=1e-12)


def test_jump_that_is_no_full_turn_cuts(bag: Bag) -> None:
    jumping = MOTION.copy()
    jumping[150:, 0] += 4.0
    clean = bag.repaired(stamped(jumping))
    assert clean.repairs == {"jumps": 1}
    np.testing.assert_array_equal(clean.pieces[0].positions, jumping[:150])
    np.testing.assert_array_equal(clean.pieces[1].positions, jumping[150:])


def test_a_joint_that_turns_fast_for_several_samples_does_not_jump() -> None:
    """As a shoulder near its singularity does, where its angles follow from markers."""
    turning = MOTION.copy()
    turning[150:, 0] += 1.0
    turning[150:152, 0] -= [0.7, 0.3]
    assert cleaned(turning).repairs == {}


def test_times_begin_with_the_first_message_even_if_it_is_unusable_or_late() -> None:
    stamps = EPOCH + np.arange(N) * (S // 100)
    broken = MOTION.copy()
    broken[:20] = np.nan
    (piece,) = repair(states(stamps, stamps, broken)).pieces
    assert piece.times[0] == pytest.approx(0.2)
    order = np.array([1, 0, *range(2, N)])
    (piece,) = repair(states(stamps[order], stamps, MOTION[order])).pieces
    np.testing.assert_allclose(piece.times[:2], [0.0, 0.01], atol=1e-9)


@pytest.mark.parametrize("size", [-1.0, 0.3, 2.0])
def test_samples_elsewhere_are_counted_and_dropped(bag: Bag, size: float) -> None:
    spiked = MOTION.copy()
    places = [40, 150, 151 + 9, 260]
    spiked[places, 1] += size
    clean = bag.repaired(stamped(spiked))
    assert clean.repairs == {"spikes": 4}
    np.testing.assert_array_equal(clean.pieces[0].positions, np.delete(MOTION, places, axis=0))


@pytest.mark.parametrize("speed", [0.2, 1.0, 5.0])
@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_no_motion_is_taken_for_a_jump(speed: float, noise: float) -> None:
    motion = reaching([0.1, 1.1, -0.4], reach=1.0 / speed)
    motion = motion + noise * np.random.default_rng(0).normal(size=motion.shape)
    assert cleaned(motion).repairs == {}


@pytest.mark.parametrize("every", [1, 2])
def test_publishers_with_unequal_stamps_that_contradict_each_other_are_refused(
    bag: Bag, every: int
) -> None:
    other = stamped(MOTION + 0.5, start=EPOCH + 3_000_000)[::every]
    messages = sorted([*stamped(MOTION), *other], key=lambda message: message.stamp)
    with pytest.raises(RecordingError, match=r"jump \d+ times.*two publishers"):
        bag.repaired(messages)


@pytest.mark.parametrize("rate", [40.0, 100.0, 250.0])
def test_zeros_between_positions_are_counted_and_dropped(bag: Bag, rate: float) -> None:
    zeros = stamped(np.zeros((round(3 * rate), 2)), rate=rate, start=EPOCH + 3_000_000)
    messages = sorted([*stamped(MOTION), *zeros], key=lambda message: message.stamp)
    clean = bag.repaired(messages)
    assert clean.repairs == {"zeros": len(zeros)}
    assert clean.rate == pytest.approx(100.0)
    np.testing.assert_array_equal(clean.pieces[0].positions, MOTION)


def test_passing_zero_is_no_defect(bag: Bag) -> None:
    assert bag.repaired(stamped(MOTION - MOTION[0])).repairs == {}


def test_joint_that_never_moves_is_named(bag: Bag) -> None:
    half = MOTION.copy()
    half[:, 1] = 0.0
    clean = bag.repaired(stamped(half))
    assert "joints that never move: 'b'" in clean.all_notes
    np.testing.assert_array_equal(clean.pieces[0].positions, half)


def test_messages_without_stamp_among_stamped_ones_are_counted_and_dropped(bag: Bag) -> None:
    messages = stamped(MOTION)
    for message in messages[3:6]:
        message.receive, message.stamp = message.stamp, 0
    clean = bag.repaired(messages)
    assert clean.repairs == {"unstamped": 3}
    np.testing.assert_array_equal(clean.pieces[0].positions, np.delete(MOTION, [3, 4, 5], axis=0))


def test_times_of_reception_stand_in_where_no_header_is_stamped(bag: Bag) -> None:
    messages = stamped(MOTION)
    for message in messages:
        message.receive, message.stamp = message.stamp, 0
    clean = bag.repaired(messages)
    assert clean.rate == pytest.approx(100.0)
    assert len(clean.notes) == 1
    assert "times of reception" in clean.notes[0]


def test_unstamped_messages_of_another_publisher_do_not_matter(bag: Bag) -> None:
    gripper = [Message(("finger",), [0.0], 0, EPOCH + index * S // 1000) for index in range(900)]
    clean = bag.repaired([*gripper, *stamped(MOTION)], ["a", "b"])
    assert clean.repairs == {"missing_joints": 900}
    assert clean.notes == ()
    assert clean.pieces[0].times[0] == 0.0


def test_recording_without_usable_time_is_refused(bag: Bag) -> None:
    messages = stamped(MOTION)
    for index, message in enumerate(messages):
        message.receive, message.stamp = EPOCH + index * 20_000, 0
    with pytest.raises(RecordingError, match=r"no usable time.*300 messages.*within 0.00598 s"):
        bag.repaired(messages)


def test_simulation_time_is_noted_and_used(bag: Bag) -> None:
    messages = stamped(MOTION, start=12 * S)
    for index, message in enumerate(messages):
        message.receive = EPOCH + index * 13_000_000
    clean = bag.repaired(messages)
    assert clean.duration == pytest.approx((N - 1) / 100)
    assert "simulation time" in clean.notes[0]


@given(
    stamps=hnp.arrays(np.int64, st.integers(1, 60), elements=st.integers(0, 4 * S)),
    positions=hnp.arrays(np.float64, (60, 2), elements=st.floats(-4, 4) | st.just(np.nan)),
)
def test_whatever_comes_in_pieces_are_usable_or_refused(
    stamps: np.ndarray, positions: np.ndarray
) -> None:
    n = stamps.size
    try:
        clean = repair(states(stamps, EPOCH + stamps, positions[:n]))
    except RecordingError:
        return
    assert set(clean.repairs) <= set(REPAIRS)
    assert min(clean.repairs.values(), default=1) > 0
    times = np.concatenate([piece.times for piece in clean.pieces])
    assert np.all(np.diff(times) > 0)
    assert times[0] >= 0
    assert all(np.isfinite(piece.positions).all() for piece in clean.pieces)


def long_recording(rate: int, seed: int) -> JointStates:
    """Some 40 s in which a joint turns on and on and wraps, with defects at random places."""
    generator = np.random.default_rng(seed)
    n = 40 * rate
    seconds = np.arange(n) / rate
    turning = (2.1 * seconds + np.pi) % (2.0 * np.pi) - np.pi
    positions = np.column_stack([0.3 + np.sin(0.7 * seconds), turning])
    steps = np.full(n, S // rate)
    kept, order = np.ones(n, dtype=bool), np.arange(n)
    places = generator.choice(np.arange(200, n - 200, 100), 15, replace=False)
    positions[places[:4], 0] = np.nan
    positions[places[4:6], 0] += 2.5
    steps[places[6:8]] += 3 * S
    steps[places[8]] -= 60 * S
    steps[places[9]] = 0
    positions[places[9]] = positions[places[9] - 1]
    for place in places[10:13]:
        order[[place, place + 1]] = order[[place + 1, place]]
    kept[places[13:]] = False
    order = order[kept]
    stamps = (EPOCH + np.cumsum(steps))[order]
    return replace(states(stamps, EPOCH + np.arange(order.size), positions[order]), n_malformed=3)


@pytest.mark.parametrize("rate", [100, 250])
@pytest.mark.parametrize("seed", range(3))
def test_defects_of_all_kinds_in_one_recording_are_counted(rate: int, seed: int) -> None:
    assert repair(long_recording(rate, seed)).repairs == {
        "malformed": 3,
        "non_finite": 4,
        "clock_jumps": 1,
        "out_of_order": 3,
        "repeated_stamps": 1,
        "gaps": 2,
        "wrapped": 13,
        "spikes": 2,
    }


def test_samples_of_a_fast_recording_are_averaged() -> None:
    seconds = np.arange(3000) / 1000
    positions = np.column_stack([np.sin(seconds), seconds])
    clean = cleaned(positions, 1000)
    (piece,) = clean.pieces
    assert (clean.rate, clean.sample_rate) == pytest.approx((1000.0, 100.0))
    assert piece.times.size == 300
    np.testing.assert_allclose(piece.positions[:, 0], np.sin(piece.times), atol=1e-5)
    np.testing.assert_allclose(piece.positions[:, 1], piece.times, atol=1e-9)
