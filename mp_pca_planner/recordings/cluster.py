# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The same work on many items by the workers of a Dask cluster."""

from __future__ import annotations

import logging
import pickle
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from queue import Empty, Queue
from typing import TYPE_CHECKING, Any

from .. import __version__
from ..exceptions import MissingDependencyError, RecordingError
from .processes import Item, Outcome, Result

if TYPE_CHECKING:
    from distributed import Client, Future

SECONDS_TO_CONNECT = 10
"""Time in which a scheduler must answer."""

SECONDS_FOR_WORKERS = 60
"""Time in which it must have a worker: some clusters start them when there is work."""

_ADDRESS = re.compile(r"((tcp|tls|ucx|ws|wss)://)?[^/\s]+:\d{1,5}")


def map_on_cluster(
    function: Callable[[Item], Result],
    items: Sequence[Item],
    address: str,
    paths: Sequence[Path],
) -> Iterator[Outcome[Result]]:
    """Call a function with every item, on the workers of a cluster.

    What a worker was given that is lost, Dask gives to another one. An item has no result if the
    workers that try it are lost again and again (as often as Dask is configured to allow), also
    when it is the only one.

    Parameters
    ----------
    function :
        A function of a module; it returns something that can be sent between machines.
    items :
        What to call it with.
    address :
        Address of the scheduler, for example 'tcp://192.0.2.1:8786'.
    paths :
        The file or folder that each item is about, absolute; all workers must see it.

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
    try:
        import distributed  # noqa: F401  # whether it can be imported is the question
    except ImportError:
        raise MissingDependencyError("distributed", "dask", "work on a Dask cluster") from None
    work = [
        (pickle.dumps((function, item)), str(path)) for item, path in zip(items, paths, strict=True)
    ]
    with _connected(address) as client:
        lost = []
        for index, answer in _answers(client, address, work, range(len(work))):
            if answer is None:
                lost.append(index)
            else:
                yield Outcome(index, pickle.loads(answer))
        # What waited on the same workers was lost with what killed them: each has another chance.
        for index in lost:
            for _, answer in _answers(client, address, work, [index]):
                result = None if answer is None else pickle.loads(answer)
                yield Outcome(index, result, repeated=True)


def _answers(
    client: Client, address: str, work: Sequence[tuple[bytes, str]], indices: Iterable[int]
) -> Iterator[tuple[int, bytes | None]]:
    """Have some items done; None for one whose workers were lost again and again."""
    from distributed import CancelledError, KilledWorker

    run = _run_on_worker()
    done: Queue[Future[Any]] = Queue()
    running = {client.submit(run, *work[i], __version__, pure=False): i for i in indices}
    for future in running:
        future.add_done_callback(done.put)
    where = f"the Dask cluster at '{address}'"
    while running:
        try:
            future = done.get(timeout=SECONDS_FOR_WORKERS)
        except Empty:
            if not client.nthreads():
                raise RecordingError(
                    f"{where} has no workers, also after {SECONDS_FOR_WORKERS} s"
                ) from None
            continue
        index = running.pop(future)
        try:
            answer = future.result()
        except KilledWorker:
            answer = None
        except CancelledError:
            raise RecordingError(f"{where} was lost") from None
        if isinstance(answer, str):
            raise RecordingError(f"{where} can't be used: {answer}")
        yield index, answer


def _run_on_worker() -> Callable[[bytes, str, str], bytes | str]:
    """Make the function that does an item on a worker, or says why it can't.

    It is made here, and uses nothing of this module, so that it is sent by value: a scheduler needs
    nothing of this package, and a worker without it is found out instead of ended by what it can't
    unpack. Workers come and go, so each item is checked.
    """

    def run(work: bytes, path: str, version: str) -> bytes | str:
        import os
        import pickle
        import socket

        worker = f"its worker on '{socket.gethostname()}'"
        try:
            from .. import __version__ as found

            if found != version:
                return f"{worker} has mp_pca_planner {found}, but {version} is needed as here"
            function, item = pickle.loads(work)
        except (ImportError, AttributeError) as error:
            return f"{worker} lacks mp_pca_planner {version} or a part of it: {error}"
        if not os.path.exists(path):
            return f"{worker} does not see '{path}': all must see the recordings at the same path"
        return pickle.dumps(function(item))

    return run


@contextmanager
def _connected(address: str) -> Iterator[Client]:
    """A connection to a scheduler, which drops all work that is left when it ends."""
    from distributed import Client

    if not _ADDRESS.fullmatch(address):
        raise RecordingError(
            f"'{address}' is no address of a Dask scheduler such as tcp://192.0.2.1:8786"
        )
    try:
        client = Client(address, timeout=SECONDS_TO_CONNECT, set_as_default=False)
    except OSError as error:
        raise RecordingError(f"no Dask scheduler answers at '{address}': {error}") from None
    # What happens to the connection is told by what becomes of the work, in one sentence.
    log = logging.getLogger("distributed.client")
    level = log.level
    log.setLevel(logging.CRITICAL)
    try:
        with client:
            yield client
    finally:
        log.setLevel(level)
