# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Executors that read several recordings at the same time: processes, or a Dask cluster."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager

from ..exceptions import RecordingError, require

# Times in which a scheduler must answer, and have a worker [s].
_CONNECTION_TIMEOUT = 10.0
_PATIENCE = 60.0


@contextmanager
def process_pool(n_processes: int) -> Iterator[Executor]:
    """Processes of this machine, which are ended at once on an error or Ctrl-C in this process."""
    others = set(multiprocessing.active_children())
    # Copies of this process have everything imported; new ones would take longer to start than
    # many recordings take to read.
    context = multiprocessing.get_context("fork")
    pool = ProcessPoolExecutor(n_processes, context, _prepare_process, (os.getpid(),))
    try:
        yield pool
    except BaseException:
        for process in set(multiprocessing.active_children()) - others:
            process.terminate()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def _prepare_process(parent: int) -> None:
    # Ctrl-C goes to all processes of the terminal: the parent decides, without their tracebacks.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: int) -> None:
    """End this process when its parent was killed; the system does not signal that by default."""
    while os.getppid() == parent:
        time.sleep(0.5)
    os._exit(1)


@contextmanager
def dask_cluster(address: str) -> Iterator[Executor]:
    """The workers of a Dask cluster, all of which must see the recordings at the same paths.

    Parameters
    ----------
    address :
        Address of the scheduler, for example 'tcp://192.0.2.1:8786'.

    Raises
    ------
    MissingDependencyError
        If `distributed` is not installed.
    RecordingError
        If the cluster can't be reached, has no workers or is lost, its workers die, or they lack
        this package.
    """
    distributed = require("distributed", "dask", "work on a Dask cluster")
    try:
        distributed.comm.get_address_host_port(address)  # a client without a port never ends
        client = distributed.Client(address, timeout=_CONNECTION_TIMEOUT, set_as_default=False)
    except (OSError, ValueError) as error:
        raise RecordingError(
            f"no Dask scheduler answers at '{address}', expected one such as tcp://192.0.2.1:8786: "
            f"{error}"
        ) from None
    lost = (distributed.CancelledError, distributed.KilledWorker, TimeoutError)
    try:
        with client:
            client.wait_for_workers(1, timeout=_PATIENCE)
            yield client.get_executor(pure=False)
    except (*lost, ImportError, RuntimeError) as error:
        raise RecordingError(
            f"the Dask cluster at '{address}' can't be used: it needs a scheduler and workers "
            f"with mp_pca_planner and enough memory ({type(error).__name__}: {error})"
        ) from None
