# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Which requests are served when they come faster than they can be."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import pytest
from support.patience import HANG

from mp_pca_planner.view.worker import NewestFirst


class Kitchen:
    """Serves numbers, each once it is allowed to; a negative one fails."""

    def __init__(self) -> None:
        self.begun: list[int] = []
        self.served: list[int] = []
        self.failed: list[tuple[int, BaseException]] = []
        self.has_begun, self.may_end = threading.Semaphore(0), threading.Semaphore(0)
        self.worker = NewestFirst(self._serve, lambda *failure: self.failed.append(failure))

    def _serve(self, number: int) -> None:
        self.begun.append(number)
        self.has_begun.release()
        assert self.may_end.acquire(timeout=HANG)
        if number < 0:
            raise SystemExit(number)
        self.served.append(number)

    def begin(self, number: int) -> None:
        self.worker.submit(number)
        assert self.has_begun.acquire(timeout=HANG)


@pytest.fixture
def kitchen() -> Iterator[Kitchen]:
    kitchen = Kitchen()
    yield kitchen
    kitchen.may_end.release(10)
    kitchen.worker.close(HANG)


def test_of_the_requests_that_wait_the_newest_is_served(kitchen: Kitchen) -> None:
    assert kitchen.worker.is_idle
    kitchen.begin(1)
    for number in (2, 3, 4):
        kitchen.worker.submit(number)
    assert not kitchen.worker.is_idle
    kitchen.may_end.release()
    assert kitchen.has_begun.acquire(timeout=HANG)
    assert kitchen.begun == [1, 4]
    assert kitchen.served == [1]


def test_request_that_fails_is_reported_and_the_next_one_served(kitchen: Kitchen) -> None:
    kitchen.begin(-1)
    kitchen.may_end.release()
    kitchen.begin(2)
    ((number, error),) = kitchen.failed
    assert number == -1
    assert isinstance(error, SystemExit)


def test_thread_ends_after_the_request_that_is_served(kitchen: Kitchen) -> None:
    kitchen.begin(1)
    kitchen.worker.submit(2)
    kitchen.worker.close(0.0)
    kitchen.may_end.release()
    kitchen.worker.close(HANG)
    assert kitchen.begun == kitchen.served == [1]
