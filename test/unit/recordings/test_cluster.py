# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Recordings read by a Dask cluster of real processes: the same bytes."""

import socket
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest
from support import commands
from support.bags import reaching, stamped, write_bag

from mp_pca_planner.exceptions import MissingDependencyError
from mp_pca_planner.recordings import workers
from mp_pca_planner.recordings.load import load_recordings

build = partial(commands.result, "build_primitives")
refusal = partial(commands.refusal, "build_primitives")


@pytest.fixture(scope="module")
def scheduler() -> Iterator[str]:
    """Address of a scheduler with two workers in processes of their own."""
    reason = "distributed is not installed (extra 'dask')"
    distributed = pytest.importorskip("distributed", reason=reason)
    with distributed.LocalCluster(2, threads_per_worker=1, dashboard_address=None) as cluster:
        yield cluster.scheduler_address


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bags")
    for i in range(8):
        write_bag(folder / f"{i}", "mcap", stamped(reaching([0.0, 1.0 + 0.1 * i, 0.2 * i])))
    (folder / "broken.bag").write_bytes(b"#ROSBAG V2.0\n" + bytes(99))
    return folder


def test_cluster_gives_the_same_bytes(
    bags: Path, tmp_path: Path, scheduler: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Workers have another working directory than this process.
    monkeypatch.chdir(bags.parent)
    local, dask = (tmp_path / f"{name}.npz" for name in ("local", "dask"))
    here = build(bags.name, "--output", local, "--name", "p")
    there = build(bags.name, "--output", dask, "--name", "p", "--dask", scheduler)
    assert dask.read_bytes() == local.read_bytes()
    assert there["repairs"] == here["repairs"]
    assert [refused["recording"] for refused in there["refused"]] == ["broken"]


def test_scheduler_that_does_not_answer_is_refused_in_one_line(
    bags: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("distributed", reason="distributed is not installed (extra 'dask')")
    monkeypatch.setattr(workers, "_CONNECTION_TIMEOUT", 1.0)
    with socket.socket() as taken:  # nobody else gets its port, and nobody listens on it
        taken.bind(("127.0.0.1", 0))
        for address in (f"tcp://127.0.0.1:{taken.getsockname()[1]}", "my cluster"):
            line = refusal(bags, "--output", tmp_path / "p.npz", "--dask", address)
            assert f"no Dask scheduler answers at '{address}'" in line
    assert "not allowed with" in refusal(bags, "--output", "p.npz", "--dask", "a:1", "--jobs", "2")
    assert not (tmp_path / "p.npz").exists()


def test_missing_extra_is_named(bags: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(MissingDependencyError, match=r"mp_pca_planner\[dask\]"):
        load_recordings(bags, dask="tcp://127.0.0.1:1")
