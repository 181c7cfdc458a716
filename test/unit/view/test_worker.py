# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Which goals are served when they come faster than they can be, by goals that tests let end."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from concurrent.futures import CancelledError

import pytest
from support.patience import HANG

from mp_pca_planner.view.worker import IsCancelled, PreemptiveWorker

TIMEOUT = HANG


class Kitchen:
    """Serves numbers; one at a time, until it is released or cancelled."""

    def __init__(self) -> None:
        self.begun: list[int] = []
        self.served: list[int] = []
        self.dropped: list[int] = []
        self._changed = threading.Condition()
        self._n_allowed = 0
        self.n_rests = 0
        self.failures: list[tuple[int | None, BaseException]] = []
        self.breakage: BaseException | None = None
        self.thread = PreemptiveWorker(self._serve, self._drop, self._rest, self._fail)

    def allow(self) -> None:
        """Let one more be served to its end."""
        with self._changed:
            self._n_allowed += 1
            self._changed.notify_all()

    def wait_for(self, begun: int = 0, served: int = 0, dropped: int = 0) -> None:
        with self._changed:
            assert self._changed.wait_for(
                lambda: (
                    len(self.begun) >= begun
                    and len(self.served) >= served
                    and len(self.dropped) >= dropped
                ),
                TIMEOUT,
            )

    def _break(self) -> None:
        breakage, self.breakage = self.breakage, None
        if breakage is not None:
            raise breakage

    def _fail(self, goal: int | None, error: BaseException) -> None:
        with self._changed:
            self.failures.append((goal, error))
            self._changed.notify_all()
        if isinstance(error, KeyError):
            raise error

    def wait_for_failures(self, n: int) -> None:
        with self._changed:
            assert self._changed.wait_for(lambda: len(self.failures) >= n, TIMEOUT)

    def _serve(self, goal: int, is_cancelled: IsCancelled) -> None:
        self._break()
        with self._changed:
            self.begun.append(goal)
            self._changed.notify_all()
            while len(self.served) >= self._n_allowed:
                self._changed.wait(0.01)
                if is_cancelled():
                    raise CancelledError
            self.served.append(goal)
            self._changed.notify_all()

    def _drop(self, goal: int) -> None:
        self._break()
        with self._changed:
            self.dropped.append(goal)
            self._changed.notify_all()

    def _rest(self) -> None:
        self._break()
        with self._changed:
            self.n_rests += 1
            self._changed.notify_all()

    def wait_for_rest(self) -> None:
        with self._changed:
            assert self._changed.wait_for(lambda: self.n_rests, TIMEOUT)


@pytest.fixture
def kitchen() -> Iterator[Kitchen]:
    kitchen = Kitchen()
    yield kitchen
    kitchen.thread.close()
    assert not kitchen.thread._thread.is_alive()


def test_goals_one_after_the_other_are_all_served(kitchen: Kitchen) -> None:
    for k in range(5):
        kitchen.allow()
        kitchen.thread.submit(k)
        kitchen.wait_for(served=k + 1)
    assert kitchen.served == [0, 1, 2, 3, 4]
    assert not kitchen.dropped


def test_thread_rests_once_when_goals_have_ceased(kitchen: Kitchen) -> None:
    kitchen.thread.submit(0)
    kitchen.wait_for(begun=1)
    time.sleep(3.0 * PreemptiveWorker.pause)
    assert kitchen.n_rests == 0
    kitchen.thread.submit(1)
    kitchen.allow()
    kitchen.wait_for_rest()
    assert kitchen.served == [1]
    time.sleep(3.0 * PreemptiveWorker.pause)
    assert kitchen.n_rests == 1


def test_newer_goal_cancels_the_one_that_is_served(kitchen: Kitchen) -> None:
    kitchen.thread.submit(0)
    kitchen.wait_for(begun=1)
    kitchen.thread.submit(1)
    kitchen.wait_for(begun=2)
    kitchen.allow()
    kitchen.wait_for(served=1)
    assert kitchen.served == [1]
    assert kitchen.dropped == [0]


def test_flood_of_goals_does_not_keep_all_from_being_served(kitchen: Kitchen) -> None:
    kitchen.thread.submit(0)
    kitchen.wait_for(begun=1)
    kitchen.thread.submit(1)
    kitchen.wait_for(begun=2)
    # The one that took the place of another one is served to its end, whatever comes.
    for k in range(2, 1000):
        kitchen.thread.submit(k)
    kitchen.allow()
    kitchen.wait_for(served=1, begun=3)
    kitchen.allow()
    kitchen.wait_for(served=2)
    assert kitchen.served == [1, 999]
    assert sorted(kitchen.served + kitchen.dropped) == list(range(1000))


def test_cancelling_drops_what_is_served_and_what_waits(kitchen: Kitchen) -> None:
    kitchen.thread.submit(0)
    kitchen.wait_for(begun=1)
    kitchen.thread.submit(1)
    kitchen.wait_for(begun=2)
    kitchen.thread.submit(2)
    kitchen.thread.cancel()
    kitchen.wait_for(dropped=3)
    kitchen.allow()
    kitchen.thread.submit(3)
    kitchen.wait_for(served=1)
    assert kitchen.served == [3]


def test_thread_is_idle_but_while_a_goal_is_served_or_waits(kitchen: Kitchen) -> None:
    assert kitchen.thread.is_idle
    kitchen.thread.submit(1)
    assert not kitchen.thread.is_idle
    kitchen.wait_for(begun=1)
    assert not kitchen.thread.is_idle
    kitchen.allow()
    kitchen.wait_for_rest()
    assert kitchen.thread.is_idle


@pytest.mark.parametrize("error", [ValueError(), MemoryError(), SystemExit(), RecursionError()])
def test_exception_of_a_goal_is_reported_and_the_next_goal_is_served(
    kitchen: Kitchen, error: BaseException
) -> None:
    kitchen.breakage = error
    kitchen.thread.submit(1)
    kitchen.wait_for_failures(1)
    assert kitchen.failures == [(1, error)]
    kitchen.allow()
    kitchen.thread.submit(2)
    kitchen.wait_for(served=1)
    assert kitchen.served == [2]


def test_exceptions_of_a_drop_a_rest_and_a_report_do_not_end_the_thread(kitchen: Kitchen) -> None:
    kitchen.thread.submit(0)
    kitchen.wait_for(begun=1)
    kitchen.breakage = ValueError("drop")
    kitchen.thread.cancel()
    kitchen.wait_for_failures(1)
    kitchen.thread.submit(1)
    kitchen.wait_for(begun=2)
    kitchen.breakage = ValueError("rest")
    kitchen.allow()
    kitchen.wait_for_failures(2)
    assert [goal for goal, _ in kitchen.failures] == [0, None]
    kitchen.breakage = KeyError("the report of this one raises it again")
    kitchen.thread.submit(2)
    kitchen.wait_for_failures(3)
    kitchen.allow()
    kitchen.thread.submit(4)
    kitchen.wait_for(served=2)
