#!/usr/bin/env python3
# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Times to read recordings, cut them into motions and learn from them.

    python3 benchmarks/recordings.py [BAG...] [--motions 400] [--repeats 3]

By default with generated sessions of the human-like arm at 100 Hz, as an MCAP file and as a folder
of rosbag2. Times are the least of some repeats; the first one may wait for the disk.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from support.tables import benchmark_parser, show

from mp_pca_planner.primitives.build import build_primitive
from mp_pca_planner.recordings.load import load_recordings
from mp_pca_planner.recordings.synthetic import write_example_recording


def main() -> None:
    """Print a row for each recording."""
    parser = benchmark_parser(__doc__)
    parser.add_argument("bags", nargs="*", type=Path, metavar="BAG")
    parser.add_argument("--motions", type=int, default=400, help="of each generated session")
    parser.add_argument("--repeats", type=int, default=3)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        bags = arguments.bags or [
            write_example_recording(Path(folder) / name, arguments.motions)
            for name in ("session.mcap", "session")
        ]
        rows = [row(bag, arguments.repeats) for bag in bags]
    header = ["recording", "size [MB]", "motions", "moving [s]", "read and cut [s]", "MB/s"]
    show({"Time to learn": ([*header, "learn [s]"], rows)}, as_json=arguments.json)


def row(bag: Path, n_repeats: int) -> list[str]:
    """Figures of a recording."""
    size = sum(file.stat().st_size for file in [bag, *bag.rglob("*")] if file.is_file()) / 1e6
    reading, found = timed(lambda: load_recordings([bag]), n_repeats)
    motions = found.demonstrations
    learning, _ = timed(lambda: build_primitive(motions, "session"), n_repeats)
    return [
        bag.name,
        f"{size:.1f}",
        str(len(motions)),
        f"{sum(motion.duration for motion in motions):.0f}",
        f"{reading:.2f}",
        f"{size / reading:.1f}",
        f"{learning:.2f}",
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
