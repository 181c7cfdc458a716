# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Recordings read by several processes: the same result, and one sentence if a process dies."""

import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from support.bags import reaching, stamped, write_bag
from support.cluster_work import die
from support.patience import HANG

from mp_pca_planner.exceptions import RecordingError
from mp_pca_planner.recordings import load
from mp_pca_planner.recordings.load import load_recordings


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bags")
    for i in range(6):
        write_bag(folder / f"{i}", "mcap", stamped(reaching([0.0, 1.0 + 0.1 * i, 0.2 * i])))
    (folder / "broken.bag").write_bytes(b"#ROSBAG V2.0\n" + bytes(99))
    return folder


def test_processes_and_any_executor_give_the_same_result(bags: Path) -> None:
    alone = load_recordings(bags)
    seen: list[tuple[int, int]] = []
    several = load_recordings(bags, jobs=2, progress=lambda done, total: seen.append((done, total)))
    with ThreadPoolExecutor(2) as executor:
        threads = load_recordings(bags, executor=executor)
    for found in (several, threads):
        for one, other in zip(found.reports, alone.reports, strict=True):
            fields = ("name", "n_messages", "repairs", "notes", "thresholds", "checksum")
            assert [getattr(one, x) for x in fields] == [getattr(other, x) for x in fields]
        assert [refused.recording for refused in found.refused] == ["broken"]
        for motion, other in zip(found, alone, strict=True):
            assert motion.checksum == other.checksum
            np.testing.assert_array_equal(motion.positions, other.positions)
    assert seen == sorted(seen) and seen[-1][0] == seen[-1][1]


def test_a_process_that_dies_is_told_with_what_to_do(
    bags: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(load, "read_one", die)
    with pytest.raises(RecordingError, match=r"died.*memory ran out; use fewer --jobs"):
        load_recordings(bags, jobs=2)


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL])
def test_no_process_outlives_its_parent(how: signal.Signals) -> None:
    code = (
        "import signal, time\n"
        "from mp_pca_planner.recordings.workers import process_pool\n"
        "import os\n"
        # Whatever started the tests may have had it ignored.
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "def slow(_):\n"
        # One write, which a pipe doesn't mix with another's: print may need two.
        "    os.write(1, f'{os.getpid()}\\n'.encode())\n"
        "    time.sleep(60)\n"
        "    return 1\n"
        "with process_pool(2) as pool:\n"
        "    list(pool.map(slow, range(4)))\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code],
        cwd=Path(__file__).parents[3],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    ) as parent:
        assert parent.stdout is not None
        workers = [int(parent.stdout.readline()) for _ in range(2)]
        parent.send_signal(how)
        parent.wait(timeout=HANG)
        deadline = time.monotonic() + HANG
        while any(is_alive(worker) for worker in workers):
            assert time.monotonic() < deadline, "a process is left"
            time.sleep(0.05)


def is_alive(process: int) -> bool:
    try:
        # Those that nobody has waited for yet are dead, too.
        state = (
            Path(f"/proc/{process}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()[0]
        )
    except OSError:
        return False
    return state not in "ZX"
