# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Work on a Dask cluster of real processes: the same bytes, whichever worker dies."""

import json
import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import pytest
from support.bags import reaching, stamped, write_bag
from support.cluster_work import die_of_three, die_once, fail, kill
from support.patience import HANG
from test_build_primitives import build, refusal

from mp_pca_planner.exceptions import MissingDependencyError, RecordingError
from mp_pca_planner.primitives.build import PrimitiveOptions, build_from_statistics
from mp_pca_planner.primitives.file import save_primitive
from mp_pca_planner.primitives.motion_statistics import MotionStatistics
from mp_pca_planner.recordings import workers
from mp_pca_planner.recordings.load import load_recordings
from mp_pca_planner.recordings.workers import Outcome, map_on_cluster

FOLDER = Path(__file__).parents[2]  # of the functions that workers call
MOST_SECONDS = HANG


@dataclass(frozen=True)
class Cluster:
    """A scheduler and its workers on this machine."""

    address: str
    scheduler: int


@pytest.fixture(scope="module")
def start(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[..., Cluster]]:
    """Start a cluster; a worker for each PYTHONPATH that is given."""
    pytest.importorskip("distributed", reason="distributed is not installed (extra 'dask')")
    with ExitStack() as stack:

        def started(paths: Sequence[str], **settings: str) -> Cluster:
            folder = tmp_path_factory.mktemp("cluster")
            file = folder / "scheduler.json"
            log = stack.enter_context((folder / "log").open("w"))
            paths_of_dask = {"DASK_TEMPORARY_DIRECTORY": str(folder)}
            quiet = ("--no-dashboard", "--host", "127.0.0.1")

            def run(what: str, path: str, *options: str) -> subprocess.Popen:
                process = subprocess.Popen(
                    [sys.executable, "-m", f"distributed.cli.dask_{what}", *options, *quiet],
                    env={**os.environ, "PYTHONPATH": path, **paths_of_dask, **settings},
                    cwd=folder,
                    stdout=log,
                    stderr=log,
                )
                stack.callback(process.wait)
                stack.callback(process.kill)
                return process

            scheduler = run("scheduler", "", "--port", "0", "--scheduler-file", str(file))
            deadline = time.monotonic() + MOST_SECONDS
            # The scheduler makes the file empty, and fills it with a single write a moment later.
            while not (file.exists() and file.stat().st_size):
                assert scheduler.poll() is None and time.monotonic() < deadline, "no scheduler"
                time.sleep(0.05)
            address = json.loads(file.read_text(encoding="utf-8"))["address"]
            for path in paths:
                run("worker", path, address, "--no-nanny", "--nthreads", "1")
            return Cluster(address, scheduler.pid)

        yield started


OURS = f"{FOLDER.parent}{os.pathsep}{FOLDER}"


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bags")
    for i in range(8):
        write_bag(folder / f"{i}", "mcap", stamped(reaching([0.0, 1.0 + 0.1 * i, 0.2 * i])))
    (folder / "broken.bag").write_bytes(b"#ROSBAG V2.0\n" + bytes(99))
    return folder


def on(found: Cluster, function: Callable, items: Sequence, path: Path = FOLDER) -> list[Outcome]:
    outcomes = map_on_cluster(function, items, found.address, lambda _: str(path))
    return sorted(outcomes)


def test_cluster_gives_the_same_bytes_also_when_a_worker_is_killed_during_the_work(
    bags: Path, tmp_path: Path, start: Callable[..., Cluster], monkeypatch: pytest.MonkeyPatch
) -> None:
    two = start([OURS, OURS])
    # Workers have another working directory than this process.
    monkeypatch.chdir(bags.parent)
    local, dask, after = (tmp_path / f"{name}.npz" for name in ("local", "dask", "after"))
    here = build(bags.name, "--output", local, "--name", "p")
    there = build(bags.name, "--output", dask, "--name", "p", "--dask", two.address)
    assert dask.read_bytes() == local.read_bytes()
    assert there["repairs"] == here["repairs"]
    assert [refused["recording"] for refused in there["refused"]] == ["broken"]

    marker = tmp_path / "marker"
    loaded = load_recordings(
        [bags.name],
        summarise=partial(die_once, marker=marker),
        most_samples=0,
        dask=two.address,
    )
    victim = int(marker.read_text(encoding="utf-8"))
    assert not Path(f"/proc/{victim}").exists() or is_zombie(victim)
    assert [report.name for report in loaded.reports] == [f"{i}" for i in range(8)]
    primitive = build_from_statistics(
        MotionStatistics.merged(loaded.summaries),
        "p",
        PrimitiveOptions(),
        {
            "repairs": {report.name: report.repairs for report in loaded.reports},
            "prismatic_joints": [],
        },
    )
    save_primitive(primitive, after)
    assert after.read_bytes() == local.read_bytes()


def is_zombie(process: int) -> bool:
    stat = Path(f"/proc/{process}/stat").read_text(encoding="utf-8")
    return stat.rpartition(")")[2].split()[0] == "Z"


def test_item_that_kills_every_worker_has_no_result_and_those_beside_it_have(
    start: Callable[..., Cluster],
) -> None:
    strict = start([OURS, OURS, OURS], DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES="0")
    outcomes = on(strict, die_of_three, [1, 2, 3, 4])
    assert outcomes[2] == (2, None)
    assert [outcomes[i][1] for i in (0, 1, 3)] == [1, 2, 4]


def test_errors_and_lost_schedulers_are_told(start: Callable[..., Cluster]) -> None:
    one = start([OURS])
    with pytest.raises(ArithmeticError, match="no 1"):
        on(one, fail, [1])
    with pytest.raises(RecordingError, match="can't read '/nowhere/bags'.*same path"):
        on(one, abs, [1], Path("/nowhere/bags"))
    with pytest.raises(RecordingError, match="cluster at 'tcp://127.*' was lost"):
        on(one, kill, [one.scheduler])


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("__version__ = '0.0.1'", "has mp_pca_planner 0.0.1, but .* is needed"),
        ("", "lacks mp_pca_planner"),
    ],
)
def test_worker_of_another_version_is_refused(
    tmp_path: Path, start: Callable[..., Cluster], content: str, message: str
) -> None:
    package = tmp_path / "mp_pca_planner"
    package.mkdir()
    (package / "__init__.py").write_text(content, encoding="utf-8")
    other = start([str(tmp_path)])
    with pytest.raises(RecordingError, match=f"can't be used: its worker on '.*' {message}"):
        on(other, abs, [1])


def test_cluster_without_workers_is_refused(
    start: Callable[..., Cluster], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(workers, "PATIENCE", 0.1)
    with pytest.raises(RecordingError, match="has no workers"):
        on(start([]), abs, [1])


@contextmanager
def port_of_nobody() -> Iterator[int]:
    """A port that is taken, so that nobody else gets it, but doesn't listen."""
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        yield taken.getsockname()[1]


def test_scheduler_that_does_not_answer_is_refused_in_one_line(
    bags: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("distributed", reason="distributed is not installed (extra 'dask')")
    monkeypatch.setattr(workers, "_CONNECTION_TIMEOUT", 1.0)
    with port_of_nobody() as port:
        address = f"tcp://127.0.0.1:{port}"
        line = refusal(bags, "--output", tmp_path / "p.npz", "--dask", address)
    assert f"no Dask scheduler answers at '{address}'" in line
    line = refusal(bags, "--output", tmp_path / "p.npz", "--dask", "my cluster")
    assert "'my cluster' is not the address of a Dask scheduler such as tcp://" in line
    assert "not allowed with" in refusal(bags, "--output", "p.npz", "--dask", "a:1", "--jobs", "2")
    assert not (tmp_path / "p.npz").exists()


def test_missing_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(MissingDependencyError, match=r"mp_pca_planner\[dask\]"):
        list(map_on_cluster(abs, [1], "tcp://127.0.0.1:1", str))
