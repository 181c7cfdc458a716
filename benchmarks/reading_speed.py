# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Speed and memory of reading recordings, compared with deserialising each message.

Writes recordings of seven joints at 1 kHz in each format, and reads each of them in separate
processes: one deserialises every message with rosbags, one reads the joint states, one loads the
demonstrations. Prints the times, their ratio, and the peak memory above that after the imports.

    python benchmarks/reading_speed.py [--minutes 1 10 60] [--formats mcap sqlite3 rosbag1]
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from tables import benchmark_parser, show

from mp_pca_planner.recordings.bags import write_joint_states
from mp_pca_planner.recordings.joint_states import NS_PER_S

JOINTS = [f"joint_{number}" for number in range(1, 8)]
RATE = 1000
EPOCH = 1_700_000_000 * NS_PER_S

DESERIALISE = """
from pathlib import Path
from rosbags.highlevel import AnyReader
def work(path):
    with AnyReader([Path(path)]) as reader:
        for connection, _, data in reader.messages():
            reader.deserialize(data, connection.msgtype)
"""

READ = """
from pathlib import Path
from mp_pca_planner.recordings.bags import open_bag
def work(path):
    with open_bag(Path(path)) as bag:
        bag.joint_states("/joint_states")
"""

LOAD = """
from mp_pca_planner.recordings.load import load_recordings
import scipy.interpolate, scipy.signal
def work(path):
    found = load_recordings([path])
    assert found.demonstrations and not found.refused, found.refused
"""

MEASURE = """
import json, sys, time
def peak():
    # The peak of `resource` is the parent's if that was larger.
    with open("/proc/self/status") as status:
        return next(int(line.split()[1]) for line in status if line.startswith("VmHWM")) / 1024
before, start = peak(), time.perf_counter()
work(sys.argv[1])
print(json.dumps({"seconds": time.perf_counter() - start, "megabytes": peak() - before}))
"""


def main() -> None:
    """Measure every given format and length, and print a table."""
    parser = benchmark_parser(__doc__)
    parser.add_argument("--minutes", type=float, nargs="+", default=[1.0, 10.0])
    parser.add_argument("--formats", nargs="+", default=["mcap", "sqlite3"])
    arguments = parser.parse_args()
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for bag_format in arguments.formats:
            for minutes in arguments.minutes:
                path = Path(folder) / ("x.bag" if bag_format == "rosbag1" else "x")
                write_recording(path, bag_format, round(minutes * 60 * RATE))
                slow, read, load = (measured(code, path) for code in (DESERIALISE, READ, LOAD))
                rows.append(
                    [
                        bag_format,
                        f"{minutes:g}",
                        f"{slow['seconds']:.2f}",
                        f"{read['seconds']:.2f}",
                        f"{slow['seconds'] / read['seconds']:.1f}",
                        f"{read['megabytes']:.0f}",
                        f"{load['seconds']:.2f}",
                        f"{load['megabytes']:.0f}",
                    ]
                )
    header = ["format", "minutes", "rosbags [s]", "read [s]", "ratio", "peak [MB]"]
    header += ["to motions [s]", "peak [MB]"]
    show({"Reading speed": (header, rows)}, as_json=arguments.json)


def write_recording(path: Path, bag_format: str, n_steps: int) -> None:
    """Write reaches of two seconds with rests of one second between."""
    steps = np.arange(n_steps)
    reach, within = np.divmod(steps / RATE, 3.0)
    s = np.clip(within / 2.0, 0.0, 1.0)
    there = reach % 2 + (1 - 2 * (reach % 2)) * (10 * s**3 - 15 * s**4 + 6 * s**5)
    positions = there[:, np.newaxis] * np.linspace(0.4, 1.0, len(JOINTS))
    write_joint_states(
        path,
        bag_format,
        JOINTS,
        EPOCH + steps * (NS_PER_S // RATE),
        positions,
        np.gradient(positions, 1 / RATE, axis=0),
        np.zeros_like(positions),
        overwrite=True,
    )


def measured(code: str, path: Path) -> dict[str, float]:
    """Run code on a recording in a separate process."""
    command = [sys.executable, "-c", code + MEASURE, str(path)]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    return dict(json.loads(done.stdout))


if __name__ == "__main__":
    main()
