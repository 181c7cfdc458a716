# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Thirty damaged sets of recordings with known truth: what is learned, rejected and named.

    python3 -m campaigns.damaged_sets [--only NAME …]

A demonstration that is no whole motion of its recording is a half motion. The exit status is 1 if
there is one, if a recording is rejected that is good or for another reason than its damage, or if a
foreign recording is not named.
"""

from __future__ import annotations

import argparse
import re
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from support.motion_kinds import generate_kinds

from mp_pca_planner.primitives.build import PrimitiveOptions
from mp_pca_planner.primitives.foreign import foreign_recordings
from mp_pca_planner.primitives.motion_statistics import MotionStatistics
from mp_pca_planner.recordings.bags import write_joint_states
from mp_pca_planner.recordings.load import load_recordings
from mp_pca_planner.recordings.synthetic import (
    SyntheticRecording,
    continuous_recording,
    generate_motions,
)

Floats = NDArray[np.float64]
S = 1_000_000_000
BACK = "two publishers"


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

    def kept(self, rows: Any) -> Recorded:
        """Some of the rows."""
        return replace(self, stamps=self.stamps[rows], positions=self.positions[rows])

    def moved(self, positions: Floats) -> Recorded:
        """Other positions, which are not judged."""
        return replace(self, positions=positions, ends=self.ends[:0])

    def row(self, motion: int, share: float = 0.5) -> int:
        """A row within a motion."""
        first, last = self.spans[motion]
        return int(first + share * (last - first))


@dataclass(frozen=True)
class Truth:
    """What is expected of a set.

    Attributes
    ----------
    rejected :
        Patterns of the reasons, by the names of the recordings.
    foreign :
        Recordings that must be named as far from the others.
    lost :
        Number of motions that damage cuts.
    options :
        Options of the loading.
    """

    rejected: dict[str, str] = field(default_factory=dict)
    foreign: frozenset[str] = frozenset()
    lost: int = 0
    options: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Outcome:
    """What became of a set: demonstrations, of these halves, and names by what is wrong."""

    n_whole: int
    n_motions: int
    halves: tuple[str, ...]
    wrongly_rejected: tuple[str, ...]
    not_rejected: tuple[str, ...]
    not_named: tuple[str, ...]
    false_alarms: tuple[str, ...]
    silent: bool

    @property
    def is_right(self) -> bool:
        """Whether nothing is wrong but warnings of good recordings."""
        wrong = (self.halves, self.wrongly_rejected, self.not_rejected, self.not_named)
        return not any(wrong) and not self.silent


def continuous(n: int, n_motions: int = 4, rate: float = 100.0, seed: int = 0) -> list[Recorded]:
    """Recordings of motions and ways back, with rests."""
    found = []
    for i in range(n):
        own = 1000 * seed + i + 1
        made = continuous_recording(generate_motions(n_motions, own), rate, (1.0, 1.6), seed=own)
        found.append(_recorded(f"r{i}", made))
    return found


def _recorded(name: str, made: SyntheticRecording) -> Recorded:
    times = np.vstack([made.motion_spans, made.return_spans])
    rows = np.searchsorted(made.times, times[np.argsort(times[:, 0])])
    rows = np.minimum(rows, made.times.size - 1)
    spans = tuple((first, last) for first, last in rows.tolist())
    return Recorded(name, made.stamps, made.positions, spans, made.positions[rows])


def task(n: int, n_motions: int) -> list[Recorded]:
    """Recordings of a single task, with the ways back."""
    motions = generate_kinds(n * n_motions, 1, 12)
    parts = [motions[i * n_motions : (i + 1) * n_motions] for i in range(n)]
    made = [continuous_recording(part, 100.0, (1.0, 1.6), seed=i) for i, part in enumerate(parts)]
    return [_recorded(f"r{i}", one) for i, one in enumerate(made)]


def single(n: int, rate: float = 100.0, seed: int = 0) -> list[Recorded]:
    """Recordings of one motion each, with rests."""
    return continuous(n, 1, rate, seed)


Set = tuple[list[Recorded], Truth]
CUT = r"cuts off each of its motions"
COPY = r"samples are also in"
DEGREES = r"not in degrees .* --degrees"


def _clock(shift: float, share: float = 0.5, lost: int = 1) -> Set:
    """The clock of a recording is set by some seconds within a motion, or in the rest behind it."""
    made = continuous(5)
    stamps = made[1].stamps.copy()
    row = made[1].row(2, share) if share < 1.0 else made[1].spans[2][1] + 40
    stamps[row:] += int(shift * S)
    made[1] = replace(made[1], stamps=stamps)
    return made, Truth(lost=lost)


def _gaps(which: Sequence[int], motions: Sequence[int]) -> Set:
    """Gaps of 0.2 s, because the motions are short, in motions of some recordings or in each."""
    made, lost = continuous(5), 0
    for i in which:
        one = made[i]
        rows = np.ones(one.stamps.size, dtype=bool)
        for k in motions or range(len(one.spans)):
            middle = one.row(k)
            rows[middle - 10 : middle + 10] = False
            lost += 1
        made[i] = one.kept(rows)
    truth = Truth(lost=lost, options={"max_gap": 0.15})
    if not motions:
        rejected = {made[i].name: CUT for i in which}
        truth = replace(truth, rejected=rejected, lost=0)
    return made, truth


def clean() -> Set:
    """Nothing is wrong."""
    return continuous(5), Truth()


def long_gap() -> Set:
    """A gap of 0.8 s in a slow motion."""
    made = continuous(5)
    slow = made[1]
    made[1] = replace(slow, stamps=slow.stamps[0] + 3 * (slow.stamps - slow.stamps[0]))
    rows = np.ones(slow.stamps.size, dtype=bool)
    rows[slow.row(2) - 14 : slow.row(2) + 14] = False
    made[1] = made[1].kept(rows)
    return made, Truth(lost=1)


def gap_in_a_rest() -> Set:
    """A gap in which nothing moves."""
    made = continuous(5)
    rows = np.ones(made[1].stamps.size, dtype=bool)
    rest = made[1].spans[1][1]
    rows[rest + 20 : rest + 80] = False
    made[1] = made[1].kept(rows)
    return made, Truth()


def jump_of_a_joint() -> Set:
    """A joint jumps by 0.9 rad within a motion, and stays there."""
    made = continuous(5)
    positions = made[1].positions.copy()
    shift = np.array([0.0, 0.9, 0.0, 0.0])
    positions[made[1].row(2) :] += shift
    ends = np.concatenate([made[1].ends, made[1].ends + shift])
    made[1] = replace(made[1], positions=positions, ends=ends)
    return made, Truth(lost=1)


def ends_in_motions() -> Set:
    """The recorder starts and stops within motions."""
    made = continuous(5)
    one = made[1]
    rows = np.zeros(one.stamps.size, dtype=bool)
    rows[one.row(0) : one.row(len(one.spans) - 1)] = True
    made[1] = one.kept(rows)
    return made, Truth(lost=2)


def half_of_the_only_motion() -> Set:
    """A recorder stops within the only motion."""
    made = single(6)
    rows = np.arange(made[2].stamps.size) < made[2].row(0)
    made[2] = made[2].kept(rows)
    return made, Truth({made[2].name: CUT})


def one_motion_without_rests() -> Set:
    """The recorder starts and stops with each motion."""
    made = single(6)
    for i, one in enumerate(made):
        first, last = one.row(0, 0.15), one.row(0, 0.85)
        ends = one.positions[[first, last]][None]
        made[i] = replace(one.kept(slice(first, last + 1)), ends=ends)
    return made, Truth()


def gap_of_uncut_recordings() -> Set:
    """A gap in a motion, with --segment none."""
    made = single(6)
    rows = np.ones(made[2].stamps.size, dtype=bool)
    rows[made[2].row(0) - 10 : made[2].row(0) + 10] = False
    made[2] = made[2].kept(rows)
    return made, Truth({made[2].name: CUT}, options={"segment": "none", "max_gap": 0.15})


def _noise(degrees: float, rate: float, *, late: int = 0) -> Set:
    made = continuous(5, rate=rate)
    rng = np.random.default_rng(3)
    for i, one in enumerate(made):
        positions = one.positions + rng.normal(0.0, np.deg2rad(degrees), one.positions.shape)
        order = np.arange(one.stamps.size)
        for k in rng.choice(one.stamps.size - 4, late, replace=False):
            order[[k, k + 1]] = order[[k + 1, k]]
        made[i] = replace(one, positions=positions[order], stamps=one.stamps[order])
    return made, Truth()


def all_in_degrees() -> Set:
    """All recordings are in degrees."""
    made = [replace(x, positions=np.rad2deg(x.positions)) for x in continuous(5)]
    return made, Truth({x.name: DEGREES for x in made})


def one_in_degrees() -> Set:
    """One recording is in degrees."""
    made = continuous(5)
    made[1] = replace(made[1], positions=np.rad2deg(made[1].positions))
    return made, Truth({"r1": DEGREES})


def _copy(change: Callable[[Recorded], Recorded], name: str = "z") -> Set:
    made = continuous(5)
    made.append(replace(change(made[1]), name=name))
    return made, Truth({name: COPY})


def _near_copy(change: Callable[[Recorded], Recorded]) -> Set:
    made, _ = _copy(change)
    return made, Truth(foreign=frozenset({"z"}))


def _resampled(one: Recorded, rate: float = 90.0) -> Recorded:
    """The same motions at another rate."""
    stamps = np.arange(one.stamps[0], one.stamps[-1], int(S / rate))
    columns = [np.interp(stamps, one.stamps, column) for column in one.positions.T]
    return replace(one, stamps=stamps, positions=np.transpose(columns))


def _noisy(one: Recorded) -> Recorded:
    noise = np.random.default_rng(2).normal(0.0, 2e-4, one.positions.shape)
    return replace(one, positions=one.positions + noise, stamps=one.stamps + 60 * S)


def _part(one: Recorded) -> Recorded:
    return one.kept(slice(one.spans[1][0] - 40, one.spans[4][1] + 40))


def a_part_comes_first() -> Set:
    """A part of a recording, with a name before its name."""
    made, _ = _copy(_part, "a")
    return made, Truth({"a": COPY})


def _foreign(change: Callable[[Recorded], Recorded], n: int = 10, *, motions: int = 4) -> Set:
    made = task(n, motions)
    made[3] = change(made[3])
    return made, Truth(foreign=frozenset({made[3].name}))


def _mirrored(one: Recorded) -> Recorded:
    return one.moved(one.positions * np.array([1.0, -1.0, -1.0, 1.0]))


def _negative(one: Recorded) -> Recorded:
    return one.moved(-one.positions)


def _backwards(one: Recorded) -> Recorded:
    return one.moved(one.positions[::-1].copy())


def _offset(one: Recorded, by: float = 0.4) -> Recorded:
    return one.moved(one.positions + np.array([0.0, 0.0, 0.0, by]))


def _exchanged(one: Recorded) -> Recorded:
    return one.moved(one.positions[:, [0, 3, 2, 1]])


def _twice_as_large(one: Recorded) -> Recorded:
    return one.moved(2.0 * one.positions - one.positions[0])


def _slow(one: Recorded) -> Recorded:
    return replace(one, stamps=one.stamps[0] + 5 * (one.stamps - one.stamps[0]))


def mirrored_and_backwards() -> Set:
    """One recording is mirrored, another one is played backwards."""
    made = task(12, 1)
    made[3], made[8] = _mirrored(made[3]), _backwards(made[8])
    return made, Truth(foreign=frozenset({"r3", "r8"}))


def two_publishers() -> Set:
    """Another publisher of the same joints, 0.3 rad away."""
    made = continuous(5)
    one = made[1]
    other = one.positions + 0.3
    stamps = np.concatenate([one.stamps, one.stamps + 3_000_000])
    order = np.argsort(stamps)
    positions = np.concatenate([one.positions, other])[order]
    made[1] = replace(one, stamps=stamps[order], positions=positions)
    return made, Truth({"r1": BACK})


def spikes_and_repeats() -> Set:
    """Spikes of a joint, and messages that are repeated."""
    made = continuous(5)
    positions, rows = made[1].positions.copy(), np.arange(40, 800, 90)
    positions[rows, 2] += 1.0
    again = np.sort(np.concatenate([np.arange(len(positions)), rows + 5]))
    made[1] = replace(made[1], stamps=made[1].stamps[again], positions=positions[again])
    return made, Truth()


SETS: dict[str, Callable[[], Set]] = {
    "clean": clean,
    "clock back by 2 s in a motion": lambda: _clock(-2.0),
    "clock back by 0.3 s in a motion": lambda: _clock(-0.3),
    "clock back by an hour in a motion": lambda: _clock(-3600.0),
    "clock on by 2 s in a motion": lambda: _clock(2.0),
    "clock back by 2 s in a rest": lambda: _clock(-2.0, 1.0, lost=0),
    "gap in a motion": lambda: _gaps([1], [2]),
    "gap of 0.8 s in a slow motion": long_gap,
    "gaps in motions of all recordings": lambda: _gaps(range(5), [1, 3]),
    "gap in each motion of a recording": lambda: _gaps([1], []),
    "gap in a rest": gap_in_a_rest,
    "gap, recordings not to be cut": gap_of_uncut_recordings,
    "joint jumps in a motion": jump_of_a_joint,
    "recording begins and ends in motions": ends_in_motions,
    "recording of half a motion": half_of_the_only_motion,
    "each is one motion without rests": one_motion_without_rests,
    "noise of 1 degree": lambda: _noise(1.0, 100.0),
    "noise of 1 degree at 500 Hz": lambda: _noise(1.0, 500.0),
    "noise of 1 degree at 25 Hz": lambda: _noise(1.0, 25.0),
    "noise of 1 degree, late messages": lambda: _noise(1.0, 100.0, late=60),
    "all in degrees": all_in_degrees,
    "one in degrees": one_in_degrees,
    "copy in another format": lambda: _copy(lambda x: replace(x, suffix=".bag")),
    "copy as a table": lambda: _copy(lambda x: replace(x, suffix=".csv")),
    "copy shifted in time": lambda: _copy(lambda x: replace(x, stamps=x.stamps + 777 * S)),
    "part of another": lambda: _copy(_part),
    "part of another, which comes first": a_part_comes_first,
    "copy at another rate": lambda: _near_copy(_resampled),
    "copy with noise": lambda: _near_copy(_noisy),
    "one is mirrored": lambda: _foreign(_mirrored),
    "one has the opposite signs": lambda: _foreign(_negative),
    "one is played backwards": lambda: _foreign(_backwards, motions=1),
    "one has a joint with an offset": lambda: _foreign(_offset),
    "one has two joints exchanged": lambda: _foreign(_exchanged),
    "one is twice as large": lambda: _foreign(_twice_as_large),
    "one is five times as slow": lambda: _foreign(_slow),
    "one mirrored, one backwards": mirrored_and_backwards,
    "two publishers": two_publishers,
    "spikes and repeated messages": spikes_and_repeats,
}


def judge(name: str, folder: Path) -> Outcome:
    """Write a set into a folder, load it, and compare what is found with the truth."""
    recorded, truth = SETS[name]()
    for one in recorded:
        _write(folder, one)
    given = {k: v for k, v in truth.options.items() if k == "segment"}
    if "max_gap" in truth.options:
        given["max_gap"] = truth.options["max_gap"]
    files = sorted(folder.iterdir())  # a folder is not searched for tables
    loaded = load_recordings(files, same_joints=True, **given)
    whole = {one.name: one.ends for one in recorded}
    halves = [
        f"{motion.recording} {motion.start_time:.1f} s"
        for motion in loaded.demonstrations
        if len(whole[motion.recording]) and not _is_whole(motion.positions, whole[motion.recording])
    ]
    reasons = {refusal.recording: refusal.reason for refusal in loaded.refused}
    wrongly = [
        f"{one}: {reason}"
        for one, reason in reasons.items()
        if not re.search(truth.rejected.get(one, "(?!)"), reason)
    ]
    options = PrimitiveOptions()
    named: set[str] = set()
    if loaded.demonstrations:
        statistics = MotionStatistics.of(loaded.demonstrations, options)
        named = {name for name, _ in foreign_recordings(statistics, options.n_phases)}
    said = (*(reason for reason in reasons.values()), loaded.report)
    return Outcome(
        n_whole=sum(len(one.spans) for one in recorded) - truth.lost,
        n_motions=len(loaded.demonstrations),
        halves=tuple(halves),
        wrongly_rejected=tuple(wrongly),
        not_rejected=tuple(sorted(truth.rejected.keys() - reasons.keys())),
        not_named=tuple(sorted(truth.foreign - named)),
        false_alarms=tuple(sorted(named - truth.foreign)),
        silent=truth.lost > 0 and not re.search("cut_off|rest|left out", "".join(said)),
    )


def _is_whole(positions: Floats, motions: Floats) -> bool:
    """Whether positions begin and end where one of the motions does."""
    ends = positions[[0, -1]]
    return any(
        np.abs(ends - motion).max() < 0.15 * np.abs(motion[1] - motion[0]).max() + 0.1
        for motion in motions
    )


def _write(folder: Path, one: Recorded) -> None:
    path = folder / f"{one.name}{one.suffix}"
    names = ("shoulder1", "shoulder2", "shoulder3", "elbow")
    if one.suffix == ".csv":
        times = (one.stamps - one.stamps[0]) / S
        head = ",".join(("time", *names))
        table = np.column_stack([times, one.positions])
        np.savetxt(path, table, delimiter=",", header=head, comments="", fmt="%.6f")
    else:
        kind: Any = "rosbag1" if one.suffix == ".bag" else "mcap"
        write_joint_states(path, kind, names, one.stamps, one.positions)


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--only", nargs="+", choices=SETS, default=list(SETS), metavar="NAME")
    right = []
    columns = ("learned", "whole", "halves", "wrong", "missed", "unnamed", "alarms")
    print(f"{'set':<42}" + "".join(f"{column:>9}" for column in columns))
    for name in parser.parse_args().only:
        with tempfile.TemporaryDirectory() as folder:
            found = judge(name, Path(folder))
        wrong = (found.halves, found.wrongly_rejected, found.not_rejected, found.not_named)
        counts = (found.n_motions, found.n_whole, *map(len, (*wrong, found.false_alarms)))
        print(f"{name:<42}" + "".join(f"{count:>9}" for count in counts))
        for what in (*wrong, found.false_alarms):
            if what:
                print(f"    {'; '.join(what)}")
        if found.silent:
            print("    nothing is said of what is left out")
        right.append(found.is_right)
    print(f"{sum(right)} of {len(right)} sets are right")
    return 0 if all(right) else 1


if __name__ == "__main__":
    sys.exit(main())
