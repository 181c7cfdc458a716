# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Time and memory per recording in large sets, with one process and with several.

Writes short recordings of a synthetic arm into a temporary folder. A primitive is learned from 100,
500 and 2000 of them, with one process and with several; both must give the same primitive. Prints
the time until all statistics are merged [s], the time per recording, and the ratio of the times.
Prints also the growth of the memory of the process, and that of a process that keeps all samples.
The best of several alternating repetitions counts, because other load disturbs the times. The CPU
time of one process depends less on such load.

    python benchmarks/many_recordings.py [--counts 100,500,2000] [--jobs 2] [--repeat 2]
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from functools import partial
from pathlib import Path

import numpy as np
from tables import benchmark_parser, show

from mp_pca_planner.primitives.build import build_from_statistics
from mp_pca_planner.primitives.motion_statistics import MotionStatistics
from mp_pca_planner.primitives.options import PrimitiveOptions
from mp_pca_planner.recordings.bags import BagFormat, write_joint_states
from mp_pca_planner.recordings.load import load_recordings
from mp_pca_planner.recordings.synthetic import continuous_recording, generate_motions

RATE = 100.0
EPOCH_NS = 1_700_000_000_000_000_000
OPTIONS = PrimitiveOptions()

PEAK = """
import json, sys
from pathlib import Path
import numpy as np
from many_recordings import OPTIONS, learn, load_recordings
from mp_pca_planner.primitives.build import build_primitive
def peak():
    # The peak that `resource` tells is the parent's if that was larger.
    with open("/proc/self/status") as status:
        return next(int(line.split()[1]) for line in status if line.startswith("VmHWM")) / 1024
paths = sorted(Path(sys.argv[1]).iterdir())[:int(sys.argv[2])]
learn(paths[:2], 1)
before = peak()
if sys.argv[3] == "statistics":
    learn(paths, 1)
else:
    build_primitive(load_recordings(paths).demonstrations, "x", OPTIONS)
print(json.dumps(peak() - before))
"""


def main() -> None:
    """Print a row per number of recordings."""
    parser = benchmark_parser(__doc__)
    parser.add_argument("--counts", default="100,500,2000")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--repeat", type=int, default=2)
    parser.add_argument("--format", choices=("rosbag1", "sqlite3", "mcap"), default="mcap")
    arguments = parser.parse_args()
    counts = sorted(int(count) for count in arguments.counts.split(","))
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
                    *(f"{_peak(folder, count, kept):.1f}" for kept in ("statistics", "samples")),
                ]
            )
    one_job = ["1 job [s]", "each [ms]", "processor [ms]"]
    jobs_columns = [f"{arguments.jobs} jobs [s]", "each [ms]", "ratio"]
    header = ["recordings", *one_job, *jobs_columns, "peak [MB]", "all samples [MB]"]
    show({"Many recordings": (header, rows)}, as_json=arguments.json)


def learn(paths: list[Path], jobs: int) -> MotionStatistics:
    """Run the steps of `build_primitives` up to the components."""
    loaded = load_recordings(
        paths,
        summarise=partial(MotionStatistics.of, options=OPTIONS),
        most_samples=0,
        jobs=jobs,
    )
    return MotionStatistics.merged(loaded.summaries)


def _write(folder: Path, seed: int, bag_format: BagFormat) -> Path:
    """A recording with one motion, about 3 s long."""
    made = continuous_recording(generate_motions(1, seed), RATE, (0.8, 1.2), seed=seed)
    stamps = EPOCH_NS + np.round(made.times * 1e9).astype(np.int64)
    path = folder / f"{seed:05d}{'.bag' if bag_format == 'rosbag1' else ''}"
    write_joint_states(path, bag_format, made.joint_names, stamps, made.positions)
    return path


def _content(statistics: MotionStatistics) -> bytes:
    """All arrays of the primitive that is learned."""
    arrays = build_from_statistics(statistics, "x", OPTIONS).arrays()
    return b"".join(arrays[name].tobytes() for name in sorted(arrays))


def _peak(folder: str, count: int, kept: str) -> float:
    """Largest growth of the memory of a separate process [MB]."""
    done = subprocess.run(
        [sys.executable, "-c", PEAK, folder, str(count), kept],
        check=True,
        capture_output=True,
        text=True,
        cwd=Path(__file__).parent,
    )
    return float(json.loads(done.stdout))


if __name__ == "__main__":
    main()
