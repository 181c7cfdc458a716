#!/usr/bin/env python3
# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Time and memory to read recordings, cut them into motions and learn from them.

    python3 benchmarks/recordings.py [BAG...] [--repeats 3] [--jobs 2] [--dask [ADDRESS]]
    python3 benchmarks/recordings.py --short 20000 | --long 50 [--folder FOLDER] …
    python3 benchmarks/recordings.py --fit 5000

By default with generated sessions of the human-like arm at 100 Hz, as an MCAP file and as a folder
of rosbag2. `--short` are recordings of one motion each, `--long` are of 10 minutes at 1 kHz; they
are kept in a folder that is given. `--fit` learns from so many motions without recordings. Times
are the least of some repeats; the first one may wait for the disk. Memory is the largest of this
process, and of the processes that read for it.
"""

from __future__ import annotations

import argparse
import resource
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from multiprocessing import Pool
from pathlib import Path
from typing import Any

from support.tables import benchmark_parser, show

from mp_pca_planner.primitives.build import build_primitive
from mp_pca_planner.recordings.bags import write_joint_states
from mp_pca_planner.recordings.load import load_recordings
from mp_pca_planner.recordings.synthetic import (
    continuous_recording,
    generate_motions,
    write_example_recording,
)

SECONDS, LONG_RATE = 600.0, 1000.0
_HEADER = ["recordings", "size [MB]", "motions", "moving [s]", "read and cut [s]", "MB/s"]
_HEADER += ["learn [s]", "memory [MB]", "of a process"]


def main() -> None:
    """Print a row for each recording, or for a set of them."""
    parser = benchmark_parser(__doc__)
    parser.add_argument("bags", nargs="*", type=Path, metavar="BAG")
    parser.add_argument("--motions", type=int, default=400, help="of each generated session")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--short", type=int, default=0, help="recordings of one motion each")
    parser.add_argument("--long", type=int, default=0, help="recordings of 10 min at 1 kHz")
    parser.add_argument("--fit", type=int, default=0, help="motions to learn from")
    parser.add_argument("--folder", type=Path, help="where generated recordings are and stay")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--dask", nargs="?", const="local", help="of 2 processes unless given")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = arguments.folder or Path(temporary)
        if arguments.fit:
            motions = generate_motions(arguments.fit, 1)
            rows = [row("without recordings", 0.0, motions, 0.0, arguments.repeats)]
        elif arguments.short or arguments.long:
            write_set(folder, arguments.short, arguments.long)
            rows = [read(folder, arguments)]
        else:
            bags = arguments.bags or [
                write_example_recording(folder / name, arguments.motions)
                for name in ("session.mcap", "session")
            ]
            rows = [read(bag, arguments) for bag in bags]
    show({"Time to learn": (_HEADER, rows)}, as_json=arguments.json)


def write_set(folder: Path, n_short: int, n_long: int) -> None:
    """Write recordings that are not there yet.

    Names that begin with that of the folder would be parts of a split bag.
    """
    folder.mkdir(exist_ok=True)
    jobs = [(folder / f"{k:05}_short.mcap", 1, 100.0, k) for k in range(n_short)]
    # A motion, the way back and two rests take about 3 s.
    n_motions = round(SECONDS / 3.1)
    jobs += [(folder / f"{k:02}_long.mcap", n_motions, LONG_RATE, k) for k in range(n_long)]
    with Pool(2) as pool:
        pool.starmap(_write, [job for job in jobs if not job[0].exists()])


def _write(path: Path, n_motions: int, rate: float, seed: int) -> None:
    made = continuous_recording(generate_motions(n_motions, seed), rate, seed=seed)
    write_joint_states(path, "mcap", made.joint_names, made.stamps, made.positions)


def read(path: Path, arguments: argparse.Namespace) -> list[str]:
    """Figures of a recording, or of a folder of them."""
    size = sum(file.stat().st_size for file in [path, *path.rglob("*")] if file.is_file()) / 1e6
    cluster: Any = nullcontext()
    address = arguments.dask
    if address == "local":
        from distributed import LocalCluster

        cluster = LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None)
        address = cluster.scheduler_address
    with cluster:
        seconds, found = timed(
            lambda: load_recordings([path], jobs=arguments.jobs, dask=address), arguments.repeats
        )
    return row(path.name, size, found.demonstrations, seconds, arguments.repeats)


def row(
    name: str, megabytes: float, motions: Sequence[Any], reading: float, n_repeats: int
) -> list[str]:
    """Figures of a set of motions, after they were read."""
    learning, _ = timed(lambda: build_primitive(motions, "session"), n_repeats)
    memory = [
        resource.getrusage(who).ru_maxrss / 1e3
        for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    ]
    return [
        name,
        f"{megabytes:.1f}",
        str(len(motions)),
        f"{sum(motion.duration for motion in motions):.0f}",
        f"{reading:.2f}",
        f"{megabytes / reading:.1f}" if reading else "–",
        f"{learning:.2f}",
        *(f"{x:.0f}" for x in memory),
    ]


def timed(call: Callable[[], Any], n_repeats: int) -> tuple[float, Any]:
    """The least time of a call [s], and its last result."""
    times = []
    for _ in range(n_repeats):
        began = time.perf_counter()
        result = call()
        times.append(time.perf_counter() - began)
    return min(times), result


if __name__ == "__main__":
    main()
