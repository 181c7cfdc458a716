# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Processing of many items by the workers of a Dask cluster."""

from __future__ import annotations

import logging
import pickle
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from .. import __version__
from ..exceptions import RecordingError, require
from .processes import IN_FLIGHT, PATIENCE, Hired, Item, Outcome, Result, map_by


@dataclass(frozen=True)
class ClusterOptions:
    """Options of working on a cluster.

    Attributes
    ----------
    connection_timeout : float
        Time in which a scheduler must answer [s].
    min_threads : int
        Threads of workers for which items are submitted, at least: workers may come later. All
        items would take memory of this process and of the scheduler in proportion to their number.
    """

    connection_timeout: float = 10.0
    min_threads: int = 16


OPTIONS = ClusterOptions()

_ADDRESS = re.compile(r"((tcp|tls|ucx|ws|wss)://)?[^/\s]+:\d{1,5}")


def map_on_cluster(
    function: Callable[[Item], Result],
    items: Sequence[Item],
    address: str,
    path_of: Callable[[Item], str],
) -> Iterator[Outcome]:
    """Call a function with every item, on the workers of a cluster.

    Dask gives the items of a worker that dies to another one. An item has no result if the workers
    that try it die as often as Dask is configured to allow, and again when it is the only one.

    Parameters
    ----------
    function :
        A function of a module; it returns something that can be sent between machines.
    items :
        Arguments of the calls.
    address :
        Address of the scheduler, for example 'tcp://192.0.2.1:8786'.
    path_of :
        Path of the file or folder that an item is about, absolute; '' if it has none. All workers
        must see it.

    Yields
    ------
    :
        The outcomes, in the order in which they are ready.

    Raises
    ------
    MissingDependencyError
        If `distributed` is not installed.
    RecordingError
        If the cluster can't be reached, has no workers or is lost, or a worker does not have this
        version of this package, or does not see a path.
    """
    distributed = require("distributed", "dask", "work on a Dask cluster")
    if not _ADDRESS.fullmatch(address):
        raise RecordingError(
            f"'{address}' is not the address of a Dask scheduler such as tcp://192.0.2.1:8786"
        )
    name = f"the Dask cluster at '{address}'"
    run = _run_on_worker()

    @contextmanager
    def hire(_: int) -> Iterator[Hired]:
        try:
            client = distributed.Client(
                address, timeout=OPTIONS.connection_timeout, set_as_default=False
            )
        except OSError as error:
            raise RecordingError(f"no Dask scheduler answers at '{address}': {error}") from None

        def submit(bundle: list[int]) -> Any:
            (index,) = bundle
            work = pickle.dumps((function, items[index]))
            return client.submit(run, work, path_of(items[index]), __version__, pure=False)

        def has_workers() -> bool:
            if not client.nthreads():
                raise RecordingError(f"{name} has no workers, also after {PATIENCE:g} s")
            return True

        try:
            with _quiet(), client:
                threads = sum(client.nthreads().values())
                yield submit, has_workers, IN_FLIGHT * max(threads, OPTIONS.min_threads)
        except distributed.CancelledError:
            raise RecordingError(f"{name} was lost") from None
        except (ImportError, FileNotFoundError) as error:
            raise RecordingError(f"{name} can't be used: {error}") from None

    yield from map_by(hire, [[index] for index in range(len(items))], distributed.KilledWorker)


@contextmanager
def _quiet() -> Iterator[None]:
    """Silence the client: the outcomes show in one sentence what happens to the connection."""
    log = logging.getLogger("distributed.client")
    level = log.level
    log.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        log.setLevel(level)


def _run_on_worker() -> Callable[[bytes, str, str], list[Any]]:
    """Make the function that processes an item on a worker, or returns the reason why it can't.

    It is made here and uses nothing of this module, so that it is sent by value. A scheduler then
    needs nothing of this package, and a worker without it says so. Workers come and go, so each
    item is checked.
    """

    def run(work: bytes, path: str, version: str) -> list[Any]:
        import os
        import pickle
        import socket

        worker = f"its worker on '{socket.gethostname()}'"
        try:
            from .. import __version__ as found

            if found == version:
                function, item = pickle.loads(work)
        except (ImportError, AttributeError) as error:
            raise ImportError(f"{worker} lacks mp_pca_planner or a part of it: {error}") from None
        if found != version:
            raise ImportError(f"{worker} has mp_pca_planner {found}, but {version} is needed")
        if path and not os.path.exists(path):
            raise FileNotFoundError(
                f"{worker} can't read '{path}': all must see the recordings at the same path"
            )
        return [function(item)]

    return run
