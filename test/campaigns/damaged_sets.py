# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Thirty-nine damaged sets of recordings with known truth: what is learned, rejected and named.

    python3 -m campaigns.damaged_sets [--only "copy"]

A demonstration that is no whole motion of its recording is a half motion. The exit status is 1 if
there is one, if a recording is rejected that is good or for another reason than its damage, or if a
foreign recording is not named.
"""

from __future__ import annotations

import re
import sys
import tempfile
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from support.motion_kinds import generate_kinds
from support.tables import options, show

from mp_pca_planner.primitives.build import PrimitiveOptions
from mp_pca_planner.primitives.foreign import foreign_recordings
from mp_pca_planner.primitives.motion_statistics import MotionStatistics
from mp_pca_planner.recordings.bags import write_joint_states
from mp_pca_planner.recordings.demonstration import Demonstration
from mp_pca_planner.recordings.load import load_recordings
from mp_pca_planner.recordings.synthetic import JOINT_NAMES, continuous_recording, generate_motions

Floats = NDArray[np.float64]
S = 1_000_000_000


@dataclass(frozen=True)
class Recorded:
    """A recording to write.

    Attributes
    ----------
    name :
        Its name.
    stamps, positions :
        Its samples [ns, rad].
    spans :
        First and last row of each motion, before it was damaged.
    ends :
        Positions at the start and the end of each whole motion, shape (n_motions, 2, n_joints);
        none if they are not judged.
    suffix :
        Of its file.
    """

    name: str
    stamps: NDArray[np.int64]
    positions: Floats
    spans: tuple[tuple[int, int], ...]
    ends: Floats
    suffix: str = ".mcap"

    @classmethod
    def of(cls, name: str, motions: Sequence[Demonstration], seed: int, rate: float) -> Recorded:
        """Motions and the ways back, with rests."""
        made = continuous_recording(motions, rate, (1.0, 1.6), seed=seed)
        times = np.vstack([made.motion_spans, made.return_spans])
        rows = np.searchsorted(made.times, times[np.argsort(times[:, 0])])
        rows = np.minimum(rows, made.times.size - 1)
        spans = tuple((first, last) for first, last in rows.tolist())
        return cls(name, made.stamps, made.positions, spans, made.positions[rows])

    def kept(self, rows: Any) -> Recorded:
        """Some of the rows."""
        return replace(self, stamps=self.stamps[rows], positions=self.positions[rows])

    def without(self, first: int, last: int) -> Recorded:
        """All rows but some that follow each other."""
        return self.kept(np.r_[0:first, last : self.stamps.size])

    def moved(self, positions: Floats) -> Recorded:
        """Other positions, which are not judged."""
        return replace(self, positions=positions, ends=self.ends[:0])

    def later(self, seconds: float, row: int = 0) -> Recorded:
        """Stamps that are later from a row on."""
        by = np.where(np.arange(self.stamps.size) < row, 0, int(seconds * S))
        return replace(self, stamps=self.stamps + by)

    def slower(self, factor: int) -> Recorded:
        """The same motions in more time."""
        return replace(self, stamps=self.stamps[0] + factor * (self.stamps - self.stamps[0]))

    def row(self, motion: int, share: float = 0.5) -> int:
        """A row within a motion."""
        first, last = self.spans[motion]
        return int(first + share * (last - first))

    def write(self, folder: Path) -> None:
        """Write its file."""
        path = folder / f"{self.name}{self.suffix}"
        if self.suffix == ".csv":
            table = np.column_stack([(self.stamps - self.stamps[0]) / S, self.positions])
            head = ",".join(("time", *JOINT_NAMES))
            np.savetxt(path, table, delimiter=",", header=head, comments="", fmt="%.6f")
        else:
            kind: Any = "rosbag1" if self.suffix == ".bag" else "mcap"
            write_joint_states(path, kind, JOINT_NAMES, self.stamps, self.positions)


Change = Callable[[Recorded], Recorded]


def continuous(n: int = 5, n_motions: int = 4, rate: float = 100.0) -> list[Recorded]:
    """Recordings of motions in random order."""
    seeds = range(1, n + 1)
    return [Recorded.of(f"r{k - 1}", generate_motions(n_motions, k), k, rate) for k in seeds]


def task(n: int, n_motions: int) -> list[Recorded]:
    """Recordings of a single task."""
    motions = generate_kinds(n * n_motions, 1, 12)
    parts = [motions[i * n_motions : (i + 1) * n_motions] for i in range(n)]
    return [Recorded.of(f"r{i}", part, i, 100.0) for i, part in enumerate(parts)]


class Damaged:
    """A set of recordings, some of them damaged, and what is expected of it.

    Parameters
    ----------
    change : callable
        Damages a recording.
    which : sequence of int
        The recordings that are damaged.
    made : callable
        Makes the recordings.
    lost : int
        Number of motions that damage cuts.
    reason : str
        Pattern of the reason for which the damaged are rejected; empty if they are not.
    is_foreign : bool
        Whether the damaged must be named as far from the others.
    copy : str
        Name of a copy that is damaged instead; empty if there is none.
    options :
        Options of the loading.
    """

    def __init__(
        self,
        change: Change = lambda one: one,
        which: Sequence[int] = (1,),
        made: Callable[[], list[Recorded]] = continuous,
        *,
        lost: int = 0,
        reason: str = "",
        is_foreign: bool = False,
        copy: str = "",
        **options: Any,
    ) -> None:
        self.recorded, self.lost, self.reason, self.options = made(), lost, reason, options
        if copy:
            self.recorded.append(replace(self.recorded[which[0]], name=copy))
            which = [len(self.recorded) - 1]
        for k in which:
            self.recorded[k] = change(self.recorded[k])
        damaged = {self.recorded[k].name for k in which}
        self.rejected = damaged if reason else set[str]()
        self.foreign = damaged if is_foreign else set[str]()


def gaps(*motions: int) -> Change:
    """Gaps of 0.2 s in some motions, or in each, because the motions are short."""

    def change(one: Recorded) -> Recorded:
        for k in sorted(motions or range(len(one.spans)), reverse=True):
            one = one.without(one.row(k) - 10, one.row(k) + 10)
        return one

    return change


def jump(one: Recorded) -> Recorded:
    """A joint jumps by 0.9 rad within a motion, and stays there."""
    shift, positions = np.array([0.0, 0.9, 0.0, 0.0]), one.positions.copy()
    positions[one.row(2) :] += shift
    return replace(one, positions=positions, ends=np.concatenate([one.ends, one.ends + shift]))


def only_the_motion(one: Recorded) -> Recorded:
    """The recorder starts and stops with the motion."""
    first, last = one.row(0, 0.15), one.row(0, 0.85)
    return replace(one.kept(slice(first, last + 1)), ends=one.positions[[first, last]][None])


def noise(degrees: float, late: int = 0) -> Change:
    """Noise of all joints, and messages that change places with the next one."""
    rng = np.random.default_rng(3)

    def change(one: Recorded) -> Recorded:
        positions = one.positions + rng.normal(0.0, np.deg2rad(degrees), one.positions.shape)
        order = np.arange(one.stamps.size)
        for k in rng.choice(one.stamps.size - 4, late, replace=False):
            order[[k, k + 1]] = order[[k + 1, k]]
        return replace(one, positions=positions).kept(order)

    return change


def in_degrees(one: Recorded) -> Recorded:
    """Positions in degrees."""
    return replace(one, positions=np.rad2deg(one.positions))


def resampled(one: Recorded, rate: float = 90.0) -> Recorded:
    """The same motions at another rate."""
    stamps = np.arange(one.stamps[0], one.stamps[-1], int(S / rate))
    columns = [np.interp(stamps, one.stamps, column) for column in one.positions.T]
    return replace(one, stamps=stamps, positions=np.transpose(columns))


def noisy(one: Recorded) -> Recorded:
    """The same motions with little noise, a minute later."""
    noise = np.random.default_rng(2).normal(0.0, 2e-4, one.positions.shape)
    return replace(one, positions=one.positions + noise).later(60.0)


def part(one: Recorded) -> Recorded:
    """Some of the motions."""
    return one.kept(slice(one.spans[1][0] - 40, one.spans[4][1] + 40))


def mirrored(one: Recorded) -> Recorded:
    """The motions of the other arm."""
    return one.moved(one.positions * np.array([1.0, -1.0, -1.0, 1.0]))


def mirrored_or_backwards(one: Recorded) -> Recorded:
    """The first one mirrored, the other one played backwards."""
    return mirrored(one) if one.name == "r3" else one.moved(one.positions[::-1].copy())


def two_publishers(one: Recorded) -> Recorded:
    """Another publisher of the same joints, 0.3 rad away."""
    stamps = np.concatenate([one.stamps, one.stamps + 3_000_000])
    positions = np.concatenate([one.positions, one.positions + 0.3])
    return replace(one, stamps=stamps, positions=positions).kept(np.argsort(stamps))


def spikes_and_repeats(one: Recorded) -> Recorded:
    """Spikes of a joint, and messages that are repeated."""
    positions, rows = one.positions.copy(), np.arange(40, 800, 90)
    positions[rows, 2] += 1.0
    again = np.sort(np.concatenate([np.arange(len(positions)), rows + 5]))
    return replace(one, positions=positions).kept(again)


def _clock(seconds: float, lost: int = 1) -> Damaged:
    """The clock is set within a motion, or in the rest behind it if no motion is lost."""

    def change(one: Recorded) -> Recorded:
        return one.later(seconds, one.row(2) if lost else one.spans[2][1] + 40)

    return Damaged(change, lost=lost)


def _copy(change: Change = lambda one: one, name: str = "z") -> Damaged:
    return Damaged(change, reason="samples are also in", copy=name)


def _near_copy(change: Change) -> Damaged:
    return Damaged(change, is_foreign=True, copy="z")


def _foreign(change: Callable[[Floats], Floats], motions: int = 4) -> Damaged:
    return Damaged(
        lambda one: one.moved(change(one.positions)),
        [3],
        lambda: task(10, motions),
        is_foreign=True,
    )


def _single() -> list[Recorded]:
    return continuous(6, 1)


ALL, CUT = range(5), r"cuts off each of its motions"
DEGREES = r"not in degrees .* --degrees"
SETS: dict[str, Callable[[], Damaged]] = {
    "clean": Damaged,
    "clock back by 2 s in a motion": lambda: _clock(-2.0),
    "clock back by 0.3 s in a motion": lambda: _clock(-0.3),
    "clock back by an hour in a motion": lambda: _clock(-3600.0),
    "clock on by 2 s in a motion": lambda: _clock(2.0),
    "clock back by 2 s in a rest": lambda: _clock(-2.0, lost=0),
    "gap in a motion": lambda: Damaged(gaps(2), lost=1, max_gap=0.15),
    "gap of 0.8 s in a slow motion": lambda: Damaged(
        lambda one: one.slower(3).without(one.row(2) - 14, one.row(2) + 14), lost=1
    ),
    "gaps in motions of all recordings": lambda: Damaged(gaps(1, 3), ALL, lost=10, max_gap=0.15),
    "gap in each motion of a recording": lambda: Damaged(gaps(), reason=CUT, max_gap=0.15),
    "gap in a rest": lambda: Damaged(
        lambda one: one.without(one.spans[1][1] + 20, one.spans[1][1] + 80)
    ),
    "gap, recordings not to be cut": lambda: Damaged(
        gaps(0), [2], _single, reason=CUT, segment="none", max_gap=0.15
    ),
    "joint jumps in a motion": lambda: Damaged(jump, lost=1),
    "recording begins and ends in motions": lambda: Damaged(
        lambda one: one.kept(slice(one.row(0), one.row(len(one.spans) - 1))), lost=2
    ),
    "recording of half a motion": lambda: Damaged(
        lambda one: one.kept(slice(one.row(0))), [2], _single, reason=CUT
    ),
    "each is one motion without rests": lambda: Damaged(only_the_motion, range(6), _single),
    "noise of 1 degree": lambda: Damaged(noise(1.0), ALL),
    "noise of 1 degree at 500 Hz": lambda: Damaged(noise(1.0), ALL, lambda: continuous(rate=500.0)),
    "noise of 1 degree at 25 Hz": lambda: Damaged(noise(1.0), ALL, lambda: continuous(rate=25.0)),
    "noise of 1 degree, late messages": lambda: Damaged(noise(1.0, late=60), ALL),
    "all in degrees": lambda: Damaged(in_degrees, ALL, reason=DEGREES),
    "one in degrees": lambda: Damaged(in_degrees, reason=DEGREES),
    "copy in another format": lambda: _copy(lambda one: replace(one, suffix=".bag")),
    "copy as a table": lambda: _copy(lambda one: replace(one, suffix=".csv")),
    "copy shifted in time": lambda: _copy(lambda one: one.later(777.0)),
    "part of another": lambda: _copy(part),
    "part of another, which comes first": lambda: _copy(part, "a"),
    "copy at another rate": lambda: _near_copy(resampled),
    "copy with noise": lambda: _near_copy(noisy),
    "one is mirrored": lambda: _foreign(lambda q: q * np.array([1.0, -1.0, -1.0, 1.0])),
    "one has the opposite signs": lambda: _foreign(np.negative),
    "one is played backwards": lambda: _foreign(lambda q: q[::-1].copy(), motions=1),
    "one has a joint with an offset": lambda: _foreign(lambda q: q + np.array([0, 0, 0, 0.4])),
    "one has two joints exchanged": lambda: _foreign(lambda q: q[:, [0, 3, 2, 1]]),
    "one is twice as large": lambda: _foreign(lambda q: 2.0 * q - q[0]),
    "one is five times as slow": lambda: Damaged(
        lambda one: one.slower(5), [3], lambda: task(10, 4), is_foreign=True
    ),
    "one mirrored, one backwards": lambda: Damaged(
        mirrored_or_backwards, [3, 8], lambda: task(12, 1), is_foreign=True
    ),
    "two publishers": lambda: Damaged(two_publishers, reason="two publishers"),
    "spikes and repeated messages": lambda: Damaged(spikes_and_repeats),
}


@dataclass(frozen=True)
class Outcome:
    """What became of a set: numbers of motions, names by what is wrong, and false alarms."""

    n_whole: int
    n_motions: int
    wrong: dict[str, Collection[str]]
    false_alarms: Collection[str]

    @property
    def is_right(self) -> bool:
        """Whether nothing is wrong but warnings of good recordings."""
        return not any(self.wrong.values())


def judge(name: str, folder: Path) -> Outcome:
    """Write a set into a folder, load it, and compare what is found with the truth."""
    truth = SETS[name]()
    for one in truth.recorded:
        one.write(folder)
    files = sorted(folder.iterdir())  # a folder is not searched for tables
    loaded = load_recordings(files, same_joints=True, **truth.options)
    whole = {one.name: one.ends for one in truth.recorded}
    halves = [
        f"{motion.recording} {motion.start_time:.1f} s"
        for motion in loaded.demonstrations
        if len(whole[motion.recording]) and not _is_whole(motion.positions, whole[motion.recording])
    ]
    reasons = {refusal.recording: refusal.reason for refusal in loaded.refused}
    named: set[str] = set()
    if loaded.demonstrations:
        options = PrimitiveOptions()
        statistics = MotionStatistics.of(loaded.demonstrations, options)
        named = {name for name, _ in foreign_recordings(statistics, options.n_phases)}
    said = re.search("cut_off|rest|left out", "".join([*reasons.values(), loaded.report]))
    wrong = {
        "halves": halves,
        "wrong": [
            f"{one}: {reason}"
            for one, reason in reasons.items()
            if one not in truth.rejected or not re.search(truth.reason, reason)
        ],
        "missed": sorted(truth.rejected - reasons.keys()),
        "unnamed": sorted(truth.foreign - named),
        "silent": ["nothing is said of what is left out"] * (truth.lost > 0 and not said),
    }
    n_whole = sum(len(one.spans) for one in truth.recorded)
    n_whole -= truth.lost
    return Outcome(n_whole, len(loaded.demonstrations), wrong, sorted(named - truth.foreign))


def _is_whole(positions: Floats, motions: Floats) -> bool:
    """Whether positions begin and end where one of the motions does."""
    ends = positions[[0, -1]]
    return any(
        np.abs(ends - motion).max() < 0.15 * np.abs(motion[1] - motion[0]).max() + 0.1
        for motion in motions
    )


def main() -> int:
    """Print the table."""
    only, n_right, rows = options(__doc__ or "", only="").only, 0, list[list[str]]()
    header = ("set", "learned", "whole", "halves", "wrong", "missed", "unnamed", "silent", "alarms")
    for name in (name for name in SETS if only in name):
        with tempfile.TemporaryDirectory() as folder:
            found = judge(name, Path(folder))
        lists = (*found.wrong.values(), found.false_alarms)
        rows.append([name, *map(str, (found.n_motions, found.n_whole, *map(len, lists)))])
        for what in filter(None, lists):
            print(f"{name}: {'; '.join(what)}")
        n_right += found.is_right
    show({"Damaged sets": (header, rows)}, as_json=False)
    print(f"{n_right} of {len(rows)} sets are right")
    return int(n_right < len(rows))


if __name__ == "__main__":
    sys.exit(main())
