# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Time and memory per recording in large sets, with one process and with several.

Writes short recordings of a synthetic arm into a temporary folder. A primitive is learned from 100,
500 and 2000 of them, with one process and with several; both must give the same primitive. Prints
the time until all statistics are merged [s], the time per recording, and the ratio of the times.
The best of several alternating repetitions counts, because other load disturbs the times. The CPU
time of one process depends less on such load. Prints also the largest memory of the process of
`build_primitives`, and with --kinds of `build_library`, without those that read recordings.

With --kinds, the recordings are of that many kinds, in turn. Prints the kinds found, the adjusted
Rand index with the true ones, and CPU times: to read each recording, and to find the kinds and
learn their primitives. Prints also the size of a primitive of all of them, the time (wall and CPU)
of `build_primitives --update` with one more recording, and the memory as above. With --folder, the
recordings are written there, unless they are there already, and kept.

    python benchmarks/many_recordings.py [--counts 100,500,2000] [--jobs 2] [--repeat 2]
    python benchmarks/many_recordings.py --kinds 20 --counts 2000,20000 [--folder FOLDER]
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np
from motion_kinds import generate_kinds
from tables import Table, benchmark_parser, show

from mp_pca_planner.primitives.build import PrimitiveOptions, build_from_statistics
from mp_pca_planner.primitives.build_library import adjusted_rand_index, library_content
from mp_pca_planner.primitives.file import save_primitive
from mp_pca_planner.primitives.motion_statistics import MotionStatistics
from mp_pca_planner.recordings.bags import BagFormat, write_joint_states
from mp_pca_planner.recordings.load import load_recordings
from mp_pca_planner.recordings.synthetic import continuous_recording, generate_motions

RATE = 100.0
EPOCH_NS = 1_700_000_000_000_000_000
OPTIONS = PrimitiveOptions()

PEAK = """
import sys
from mp_pca_planner.cli.main import main
status = main(sys.argv[1:])
# The peak of `resource` is the parent's if that was larger.
with open("/proc/self/status") as lines:
    print(next(int(line.split()[1]) for line in lines if line.startswith("VmHWM")))
sys.exit(status)
"""
COMMANDS = ("build_primitives", "build_library")


def main() -> None:
    """Print a row per number of recordings."""
    parser = benchmark_parser(__doc__)
    parser.add_argument("--counts", default="100,500,2000")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--repeat", type=int, default=2)
    parser.add_argument("--format", choices=("rosbag1", "sqlite3", "mcap"), default="mcap")
    parser.add_argument("--kinds", type=int)
    parser.add_argument("--folder", type=Path, help="where recordings of kinds are kept")
    arguments = parser.parse_args()
    counts = sorted(int(count) for count in arguments.counts.split(","))
    if arguments.kinds:
        with tempfile.TemporaryDirectory() as folder:
            content = _kinds_table(arguments.folder or Path(folder), counts, arguments)
        show({"Kinds of many recordings": content}, as_json=arguments.json)
        return
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        paths = [_write(Path(folder), i, arguments.format) for i in range(counts[-1])]
        learn(paths[:2], 1)  # warm-up: work that is done once
        for count in counts:
            best = {1: np.inf, arguments.jobs: np.inf}
            processor = np.inf
            digests = set()
            for _ in range(arguments.repeat):
                for jobs in best:
                    start, own = time.perf_counter(), time.process_time()
                    statistics = learn(paths[:count], jobs)
                    best[jobs] = min(best[jobs], time.perf_counter() - start)
                    if jobs == 1:
                        processor = min(processor, time.process_time() - own)
                    digests.add(_content(statistics))
            if len(digests) != 1:
                raise SystemExit("the primitives differ with the number of jobs")
            one, several = best[1], best[arguments.jobs]
            rows.append(
                [
                    str(count),
                    f"{one:.2f}",
                    f"{1e3 * one / count:.2f}",
                    f"{1e3 * processor / count:.2f}",
                    f"{several:.2f}",
                    f"{1e3 * several / count:.2f}",
                    f"{one / several:.2f}",
                    f"{_peak(paths[:count], COMMANDS[0], arguments.jobs):.0f}",
                ]
            )
    one_job = ["1 job [s]", "each [ms]", "processor [ms]"]
    jobs_columns = [f"{arguments.jobs} jobs [s]", "each [ms]", "ratio"]
    header = ["recordings", *one_job, *jobs_columns, f"{COMMANDS[0]} [MB]"]
    show({"Many recordings": (header, rows)}, as_json=arguments.json)


def _kinds_table(folder: Path, counts: list[int], arguments: argparse.Namespace) -> Table:
    n_kinds = arguments.kinds
    folder.mkdir(exist_ok=True)
    paths = [_write(folder, i, arguments.format, n_kinds) for i in range(counts[-1] + 1)]
    learn(paths[:2], 1, "none")
    rows = []
    for count in counts:
        start = time.process_time()
        statistics = learn(paths[:count], 1, "none")
        read = time.process_time()
        content = library_content(statistics, OPTIONS)
        learned = time.process_time()
        assigned = content.kinds.assigned.tolist()
        index = adjusted_rand_index(assigned, [i % n_kinds for i in range(count)])
        cells = [f"{1e3 * (read - start) / count:.2f}", f"{1e3 * (learned - read) / count:.2f}"]
        cells += [f"{1e3 * (learned - start) / count:.2f}"]
        found = [str(count), str(len(content.primitives)), f"{index:.3f}"]
        found += [*cells, *_update(statistics, paths[-1])]
        rows.append([*found, *(f"{_peak(paths[:count], x, arguments.jobs):.0f}" for x in COMMANDS)])
    header = ["recordings", "kinds", "adjusted Rand index", "read, each [ms]", "kinds, each [ms]"]
    header += ["both [ms]", "one pot [MB]", "update [s]", "processor [s]"]
    return [*header, *(f"{x} [MB]" for x in COMMANDS)], rows


def _update(statistics: MotionStatistics, path: Path) -> list[str]:
    """Size of a primitive of all, and times of an update by one recording."""
    with tempfile.TemporaryDirectory() as folder:
        return _updated(Path(folder, "all.npz"), statistics, path)


def _updated(file: Path, statistics: MotionStatistics, path: Path) -> list[str]:
    origin = {"repairs": {}, "prismatic_joints": []}
    primitive = build_from_statistics(statistics, "all", OPTIONS, origin)
    save_primitive(primitive, file, overwrite=True)
    command = ["build_primitives", str(path), "--segment", "none", "--update", str(file)]
    start, before = time.perf_counter(), os.times()
    arguments = [sys.executable, "-m", "mp_pca_planner", *command]
    subprocess.run(arguments, check=True, stdout=subprocess.DEVNULL)
    after, wall = os.times(), time.perf_counter() - start
    processor = sum(after[2:4]) - sum(before[2:4])
    return [f"{file.stat().st_size / 1e6:.1f}", f"{wall:.2f}", f"{processor:.2f}"]


def learn(
    paths: list[Path], jobs: int, segment: Literal["auto", "none"] = "auto"
) -> MotionStatistics:
    """Run the steps of `build_primitives` up to the components."""
    loaded = load_recordings(
        paths,
        segment=segment,
        summarise=partial(MotionStatistics.of, options=OPTIONS),
        most_samples=0,
        jobs=jobs,
    )
    return MotionStatistics.merged(loaded.summaries)


def _write(folder: Path, seed: int, bag_format: BagFormat, n_kinds: int | None = None) -> Path:
    """A recording with one motion, about 3 s long, unless it is there already."""
    path = folder / f"{seed:05d}{'.bag' if bag_format == 'rosbag1' else ''}"
    if path.exists():
        return path
    motions = generate_motions(1, seed)
    if n_kinds is not None:
        motions = generate_kinds(1, n_kinds, seed=0, first=seed)
    made = continuous_recording(motions, RATE, (0.8, 1.2), seed=seed)
    stamps = EPOCH_NS + np.round(made.times * 1e9).astype(np.int64)
    write_joint_states(path, bag_format, made.joint_names, stamps, made.positions)
    return path


def _content(statistics: MotionStatistics) -> bytes:
    """All arrays of the primitive that is learned."""
    arrays = build_from_statistics(statistics, "x", OPTIONS).arrays()
    return b"".join(arrays[name].tobytes() for name in sorted(arrays))


def _peak(paths: list[Path], command: str, jobs: int) -> float:
    """Largest memory of the process of a command, without those that read recordings [MB]."""
    with tempfile.TemporaryDirectory() as folder:
        links = Path(folder, "bags")
        links.mkdir()
        for path in paths:
            (links / path.name).symlink_to(path)
        output = str(Path(folder, "all.npz" if command == COMMANDS[0] else "library"))
        options = ["--segment", "none", "--jobs", str(jobs), "--output", output]
        arguments = [sys.executable, "-c", PEAK, command, str(links), *options]
        done = subprocess.run(arguments, check=True, capture_output=True, text=True)
    return int(done.stdout.split()[-1]) / 1024


if __name__ == "__main__":
    main()
