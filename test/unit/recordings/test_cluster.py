# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Recordings read by a Dask cluster of real processes: the same bytes."""

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
from support import commands
from support.bags import reaching, stamped, write_bag
from support.patience import HANG

from mp_pca_planner.exceptions import MissingDependencyError
from mp_pca_planner.recordings import workers
from mp_pca_planner.recordings.load import load_recordings

build = partial(commands.result, "build_primitives")
refusal = partial(commands.refusal, "build_primitives")

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

            scheduler = run("scheduler", OURS, "--port", "0", "--scheduler-file", str(file))
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


def test_cluster_gives_the_same_bytes(
    bags: Path, tmp_path: Path, start: Callable[..., Cluster], monkeypatch: pytest.MonkeyPatch
) -> None:
    two = start([OURS, OURS])
    # Workers have another working directory than this process.
    monkeypatch.chdir(bags.parent)
    local, dask = (tmp_path / f"{name}.npz" for name in ("local", "dask"))
    here = build(bags.name, "--output", local, "--name", "p")
    there = build(bags.name, "--output", dask, "--name", "p", "--dask", two.address)
    assert dask.read_bytes() == local.read_bytes()
    assert there["repairs"] == here["repairs"]
    assert [refused["recording"] for refused in there["refused"]] == ["broken"]


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
        for address in (f"tcp://127.0.0.1:{port}", "my cluster"):
            line = refusal(bags, "--output", tmp_path / "p.npz", "--dask", address)
            assert f"no Dask scheduler answers at '{address}'" in line
    assert "not allowed with" in refusal(bags, "--output", "p.npz", "--dask", "a:1", "--jobs", "2")
    assert not (tmp_path / "p.npz").exists()


def test_missing_extra_is_named(bags: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(MissingDependencyError, match=r"mp_pca_planner\[dask\]"):
        load_recordings(bags, dask="tcp://127.0.0.1:1")
