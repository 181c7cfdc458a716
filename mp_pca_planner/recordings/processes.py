# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The same work on many items in several processes, which survives the death of one of them."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Generic, TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")

IN_FLIGHT = 2
"""Bundles handed out for each process: it need not wait for the next one, few are lost with it."""

BUNDLE_TIME, MOST_BUNDLED = 0.1, 16
"""Handing something out takes half a millisecond. Items are bundled up to so much time [s], and up
to that number, for if their process dies they are all done again."""


@dataclass(frozen=True)
class Outcome(Generic[Result]):
    """What became of an item.

    Attributes
    ----------
    index : int
        Which item it is.
    result : object or None
        What the function returned; None if every process that tried it died.
    repeated : bool
        Whether it had to be done again because a process died.
    """

    index: int
    result: Result | None
    repeated: bool = False


def map_in_processes(
    function: Callable[[Item], Result], items: Sequence[Item], n_processes: int
) -> Iterator[Outcome[Result]]:
    """Call a function with every item, in other processes.

    When a process dies, nobody knows which item killed it: all that were handed out are done
    again, each in a process of its own.

    Parameters
    ----------
    function :
        A function of a module; it returns something that can be sent between processes, not None.
    items :
        What to call it with.
    n_processes :
        How many processes to use.

    Yields
    ------
    :
        The outcomes, in the order in which they are ready.
    """
    left = list(range(len(items)))[::-1]
    began, n_done = time.perf_counter(), 0
    while left:
        lost: list[int] = []
        with _pool(min(n_processes, len(left))) as pool:
            running: dict[Future[list[Result]], list[int]] = {}
            while running or (left and not lost):
                while left and not lost and len(running) < IN_FLIGHT * n_processes:
                    rate = n_done / n_processes / (time.perf_counter() - began)
                    # Towards the end bundles are small, so that no process is left with much.
                    most = min(MOST_BUNDLED, len(left) // (IN_FLIGHT * n_processes))
                    bundle = left[-max(min(int(BUNDLE_TIME * rate), most), 1) :][::-1]
                    try:
                        future = pool.submit(_map, function, [items[index] for index in bundle])
                    except BrokenProcessPool:
                        lost += bundle
                    else:
                        running[future] = bundle
                    del left[-len(bundle) :]
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    bundle = running.pop(future)
                    if isinstance(future.exception(), BrokenProcessPool):
                        lost += bundle
                        continue
                    n_done += len(bundle)
                    for index, result in zip(bundle, future.result(), strict=True):
                        yield Outcome(index, result)
        for index in sorted(lost):
            yield _alone(function, items[index], index)


def _map(function: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
    return [function(item) for item in items]


def _alone(function: Callable[[Item], Result], item: Item, index: int) -> Outcome[Result]:
    with _pool(1) as pool:
        try:
            return Outcome(index, pool.submit(function, item).result(), repeated=True)
        except BrokenProcessPool:
            return Outcome(index, None, repeated=True)


@contextmanager
def _pool(n_processes: int) -> Iterator[ProcessPoolExecutor]:
    """Processes that are ended at once if something goes wrong here, Ctrl-C for example."""
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
    """End this process when its parent has been killed, which nobody else would tell it."""
    while os.getppid() == parent:
        time.sleep(0.5)
    os._exit(1)
