# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Recordings in object storage, read by two processes, while the network is cut once.

Short recordings of a synthetic arm are put into an S3 server on this machine (moto), which is
reached through a proxy that cuts a connection in the middle. A primitive is learned from them, and
from the same recordings in files; both must be the same to the byte. Prints the times [s], and the
time until a run that was interrupted in the middle has gone on (--resume).

    python benchmarks/object_storage.py [--recordings 200] [--jobs 2]
"""

from __future__ import annotations

import argparse
import logging
import os
import sys
import tempfile
import time
from functools import partial
from pathlib import Path

import boto3
from moto.server import ThreadedMotoServer

from mp_pca_planner.arrays import text_table
from mp_pca_planner.primitives.build import PrimitiveOptions, build_from_statistics
from mp_pca_planner.primitives.file import primitive_bytes
from mp_pca_planner.primitives.motion_statistics import MotionStatistics
from mp_pca_planner.recordings.bags import write_joint_states
from mp_pca_planner.recordings.load import load_recordings
from mp_pca_planner.recordings.synthetic import continuous_recording, generate_motions

sys.path.append(str(Path(__file__).parents[1] / "test" / "unit" / "recordings"))
from test_remote import Proxy

KEYS = {"AWS_ACCESS_KEY_ID": "key", "AWS_SECRET_ACCESS_KEY": "secret"}
OPTIONS = PrimitiveOptions()


def main() -> None:
    """Print a row per place of the recordings."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--recordings", type=int, default=200)
    parser.add_argument("--jobs", type=int, default=2)
    arguments = parser.parse_args()
    n, jobs = arguments.recordings, arguments.jobs
    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    server = ThreadedMotoServer("127.0.0.1", 0, verbose=False)
    server.start()
    _, port = server.get_host_and_port()
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary, "bags")
        write(folder, n)
        size = upload(folder, f"http://127.0.0.1:{port}")
        proxy = Proxy(port, cut_after=size // n // 2)
        proxy.start()
        os.environ.update(KEYS, AWS_ENDPOINT_URL=f"http://127.0.0.1:{proxy.port}")
        rows, contents = [], set()
        interrupted = Path(temporary, "journal")
        load(folder, jobs, interrupted, 0.5)
        cases = [
            ("files", folder, None),
            ("S3, cut once", "s3://bucket/bags", None),
            ("files, half of them resumed", folder, interrupted),
        ]
        for name, place, journal in cases:
            began = time.perf_counter()
            contents.add(load(place, jobs, journal))
            rows.append([name, f"{time.perf_counter() - began:.2f}"])
    server.stop()
    print(f"{n} recordings of {size / n / 1000:.0f} kB, {jobs} processes")
    print(text_table(rows, header=["from", "time [s]"]))
    print(f"the network was cut: {proxy.is_cut}; different primitives: {len(contents)}")
    sys.exit(len(contents) != 1 or not proxy.is_cut)


def write(folder: Path, n: int) -> None:
    """Write recordings of one motion each."""
    folder.mkdir()
    for i in range(n):
        made = continuous_recording(generate_motions(1, i), 100.0, (0.8, 1.2), seed=i)
        columns = made.joint_names, made.stamps, made.positions
        write_joint_states(folder / f"{i:05d}.mcap", "mcap", *columns)


def upload(folder: Path, endpoint: str) -> int:
    """Put the recordings into a bucket; returns their size [bytes]."""
    names = {"aws_access_key_id": "key", "aws_secret_access_key": "secret"}
    client = boto3.client("s3", endpoint_url=endpoint, region_name="us-east-1", **names)
    client.create_bucket(Bucket="bucket")
    for file in folder.iterdir():
        client.upload_file(str(file), "bucket", f"bags/{file.name}")
    return sum(file.stat().st_size for file in folder.iterdir())


def load(place: Path | str, jobs: int, journal: Path | None, until: float = 1.0) -> bytes:
    """The content of the primitive that is learned; none if the run ends after a share of them."""

    def progress(done: int, total: int) -> None:
        if done > until * total:
            raise KeyboardInterrupt

    try:
        loaded = load_recordings(
            place,
            summarise=partial(MotionStatistics.of, options=OPTIONS),
            most_samples=0,
            jobs=jobs,
            resume=journal,
            progress=progress,
        )
    except KeyboardInterrupt:
        return b""
    statistics = MotionStatistics.merged(loaded.summaries)
    return primitive_bytes(build_from_statistics(statistics, "x", OPTIONS))


if __name__ == "__main__":
    main()
