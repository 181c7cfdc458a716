# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Processing of many items by several workers, robust to the death of workers.

The workers are processes of this machine, or those of a Dask cluster.
"""

from __future__ import annotations

import logging
import multiprocessing
import os
import pickle
import re
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, contextmanager
from itertools import zip_longest
from queue import Empty, Queue
from typing import Any, TypeVar

from .. import __version__
from ..exceptions import RecordingError, require

Item = TypeVar("Item")
Result = TypeVar("Result")

IN_FLIGHT = 2
"""Bundles submitted per process, or thread of a worker: enough to keep it busy, few to be repeated
if it dies."""

PATIENCE = 60.0
"""Time without a result after which it is checked whether there are workers [s]."""

MAX_BUNDLED = 16
BUNDLES = 32
"""Submitting takes half a millisecond, so items are bundled. A bundle has at most `MAX_BUNDLED`
items, and fewer if a process would get fewer than `BUNDLES` bundles, because all items of a bundle
are repeated if their process dies."""


Outcome = tuple[int, Any]
"""Index of an item, and what the function returned; None if every worker that tried it died."""

Hired = tuple[Callable[[list[int]], Any], Callable[[], bool], int]
"""A function from a bundle of indices to its future, one that returns whether there are workers
left, and the number of bundles to be submitted at a time."""

Hire = Callable[[int], AbstractContextManager[Hired]]
"""Makes workers for a number of bundles."""


def map_by(hire: Hire, bundles: Sequence[list[int]], died: type[Exception]) -> Iterator[Outcome]:
    """Process every item by workers.

    When a worker dies, it is unknown which item killed it. All submitted items are processed again,
    each in its own bundle.

    Parameters
    ----------
    hire :
        Makes the workers.
    bundles :
        Indices of the items that are submitted together.
    died :
        Error of a future whose worker died.

    Yields
    ------
    :
        The outcomes, in the order in which they are ready.
    """
    left = list(bundles)[::-1]
    while left:
        lost = []
        for index, result in _round(hire, left, died):
            if result is None:
                lost.append(index)
            else:
                yield index, result
        for index in sorted(lost):
            yield from _round(hire, [[index]], died)


def _round(hire: Hire, left: list[list[int]], died: type[Exception]) -> Iterator[Outcome]:
    """Process bundles from the end of a list until a worker dies; None marks lost items."""
    done: Queue[Any] = Queue()
    running: dict[Any, list[int]] = {}
    is_whole = True
    with hire(len(left)) as (submit, has_workers, max_running):
        while running or (left and is_whole):
            while left and is_whole and len(running) < max_running:
                future = submit(left[-1])
                running[future] = left.pop()
                future.add_done_callback(done.put)
            try:
                ended = [done.get(timeout=PATIENCE)]
            except Empty:
                ended = [] if has_workers() else list(running)
            for future in ended:
                bundle, results = running.pop(future), _results(future, died)
                is_whole = is_whole and results is not None
                yield from zip_longest(bundle, results or ())


def _results(future: Any, died: type[Exception]) -> list[Any] | None:
    """Results of a bundle; None if its worker died."""
    if not future.done():
        return None  # its worker is gone without a word
    try:
        found: list[Any] = future.result()
    except died:
        return None
    return found


def map_in_processes(
    function: Callable[[Item], Result], items: Sequence[Item], n_processes: int
) -> Iterator[Outcome]:
    """Call a function with every item, in other processes, see :func:`map_by`.

    Parameters
    ----------
    function :
        A function of a module; it returns something that can be sent between processes, not None.
    items :
        Arguments of the calls.
    n_processes :
        Number of processes.
    """
    size = min(MAX_BUNDLED, max(1, len(items) // (BUNDLES * n_processes)))
    bundles = [
        list(range(first, min(first + size, len(items)))) for first in range(0, len(items), size)
    ]

    @contextmanager
    def hire(n_bundles: int) -> Iterator[Hired]:
        others = set(multiprocessing.active_children())
        with _pool(min(n_processes, n_bundles)) as pool:

            def has_workers() -> bool:
                return bool(set(multiprocessing.active_children()) - others)

            def submit(bundle: list[int]) -> Future[list[Result]]:
                try:
                    return pool.submit(_map, function, [items[i] for i in bundle])
                except BrokenProcessPool as error:
                    # As if a process had died with it.
                    lost: Future[list[Result]] = Future()
                    lost.set_exception(error)
                    return lost

            yield submit, has_workers, IN_FLIGHT * n_processes

    return map_by(hire, bundles, BrokenProcessPool)


@contextmanager
def _pool(n_processes: int) -> Iterator[ProcessPoolExecutor]:
    """A pool of processes that are ended at once on an error or Ctrl-C in this process."""
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


def _map(function: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
    return [function(item) for item in items]


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


# Time in which a scheduler must answer [s].
_CONNECTION_TIMEOUT = 10.0
# Threads of workers for which items are submitted, at least: workers may come later. All items
# would take memory of this process and of the scheduler in proportion to their number.
_MIN_THREADS = 16


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
            client = distributed.Client(address, timeout=_CONNECTION_TIMEOUT, set_as_default=False)
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
                yield submit, has_workers, IN_FLIGHT * max(threads, _MIN_THREADS)
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
