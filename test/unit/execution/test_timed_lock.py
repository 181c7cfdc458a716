# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A lock that another thread holds is not waited for without a limit."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor

import pytest
from support.patience import HANG

from mp_pca_planner.execution.threads import BusyError, TimedLock


def test_lock_that_another_thread_holds_is_given_up() -> None:
    lock, is_held, may_end = TimedLock(), threading.Event(), threading.Event()

    def hold() -> None:
        with lock:
            is_held.set()
            may_end.wait(HANG)

    thread = threading.Thread(target=hold)
    thread.start()
    assert is_held.wait(HANG)
    with pytest.raises(BusyError, match=r"longer than 0.005 s; send the goal again"), lock.within():
        pass
    with pytest.raises(BusyError, match="longer than 2 s"), lock:
        pass
    may_end.set()
    thread.join()
    with lock, lock.within(), lock:  # it is free, and reentrant
        pass


def test_lock_is_free_for_others_after_an_error() -> None:
    lock = TimedLock()

    def take() -> None:
        with lock, lock.within():
            pass

    for hold in (lock, lock.within()):
        with pytest.raises(ValueError, match="within"), hold:
            raise ValueError("within")
        with ThreadPoolExecutor(1) as other:
            other.submit(take).result(HANG)
