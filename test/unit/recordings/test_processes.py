# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Work in several processes: nothing is lost, whoever dies."""

import multiprocessing
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from pathlib import Path

import pytest
from support.patience import HANG

from mp_pca_planner.recordings import workers
from mp_pca_planner.recordings.workers import map_by, map_in_processes


def square(number: int) -> int:
    return number * number


def die_of_three(number: int) -> int:
    if number == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def die_once(marker: Path) -> int:
    if not marker.exists():
        marker.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return os.getpid()


def fail(number: int) -> int:
    raise ArithmeticError(f"no {number}")


def test_every_item_is_done_once_by_other_processes() -> None:
    outcomes = sorted(map_in_processes(square, range(20), 2))
    assert outcomes == [(i, i * i) for i in range(20)]


def test_bundles_leave_nothing_out() -> None:
    # So many and so quick that they are handed out in bundles, of which one kills its process.
    numbers = [*range(10, 300), 3, *range(300, 500)]
    outcomes = dict(map_in_processes(die_of_three, numbers, 2))
    assert len(outcomes) == len(numbers)
    killer = numbers.index(3)
    assert outcomes.pop(killer) is None
    assert outcomes == {index: numbers[index] for index in outcomes}


def test_item_that_kills_its_process_has_no_result_and_the_others_have() -> None:
    outcomes = dict(map_in_processes(die_of_three, range(12), 2))
    assert outcomes == {i: None if i == 3 else i for i in range(12)}


def test_item_of_a_process_that_was_killed_is_done_again(tmp_path: Path) -> None:
    ((_, process),) = map_in_processes(die_once, [tmp_path / "marker"], 2)
    assert process not in (None, os.getpid())


def test_a_pool_that_lost_all_processes_between_submissions_is_replaced() -> None:
    results = {}
    for index, result in map_in_processes(square, range(100), 2):
        if not results:
            for process in multiprocessing.active_children():
                process.kill()
                process.join()
        results[index] = result
    assert results == {i: i * i for i in range(100)}


def test_bundles_of_workers_that_are_gone_without_a_word_are_done_again(monkeypatch) -> None:
    monkeypatch.setattr(workers, "PATIENCE", 0.01)
    n_hired = 0

    @contextmanager
    def hire(n_bundles: int) -> Iterator[workers.Hired]:
        nonlocal n_hired
        n_hired += 1

        def submit(bundle: list[int]) -> Future:
            future = Future()
            if n_hired > 1:
                future.set_result([square(i) for i in bundle])
            return future

        yield submit, lambda: n_hired > 1, 2

    outcomes = sorted(map_by(hire, [[0, 1], [2], [3]], OSError))
    # Two bundles were submitted, and lost.
    assert outcomes == [(i, i * i) for i in range(4)]
    assert n_hired > 1


def test_error_of_the_function_comes_through() -> None:
    with pytest.raises(ArithmeticError, match="no 1"):
        list(map_in_processes(fail, [1], 2))


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL])
def test_no_process_outlives_its_parent(how: signal.Signals) -> None:
    code = (
        "import signal, time\n"
        "from mp_pca_planner.recordings.workers import map_in_processes\n"
        "import os\n"
        # Whatever started the tests may have had it ignored.
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "def slow(_):\n"
        # One write, which a pipe doesn't mix with another's: print may need two.
        "    os.write(1, f'{os.getpid()}\\n'.encode())\n"
        "    time.sleep(60)\n"
        "    return 1\n"
        "list(map_in_processes(slow, range(4), 2))\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code],
        cwd=Path(__file__).parents[3],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    ) as parent:
        assert parent.stdout is not None
        workers = [int(parent.stdout.readline()) for _ in range(2)]
        parent.send_signal(how)
        parent.wait(timeout=HANG)
        deadline = time.monotonic() + HANG
        while any(is_alive(worker) for worker in workers):
            assert time.monotonic() < deadline, "a process is left"
            time.sleep(0.05)


def is_alive(process: int) -> bool:
    try:
        # Those that nobody has waited for yet are dead, too.
        state = (
            Path(f"/proc/{process}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()[0]
        )
    except OSError:
        return False
    return state not in "ZX"
