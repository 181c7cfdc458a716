# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The workers of the node, from its side: whatever ends one costs its work, and it starts anew."""

from __future__ import annotations

import math
import multiprocessing
import pickle
import signal
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from itertools import count
from multiprocessing.connection import Connection
from queue import SimpleQueue
from typing import Any

from rclpy.task import Future

from ..execution.link import Place, PlanRequest, SetUp, SetUpDone, WatchedRobot, WorkerDied
from .markers import Frames, Markers
from .worker import PLANNER, WATCHER, KeepMotion, Kept, LoseObstacles, TakeObstacles, run

# Time after which a request must be answered, beside the time for its solution, and a set-up [s];
# and the part of the time by the clock that counts beside a worker's processor time.
_ANSWER_TIME, _SET_UP_TIME, _IDLE_SHARE = 2.0, 60.0, 0.2


class WorkerProcess:
    """A worker, from the node's side; it is a link of the server.

    A thread sends what waits, another one receives; they hold nothing else.

    Parameters
    ----------
    role : str
        `PLANNER` or `WATCHER`.
    wake : callable
        Called in another thread when a message has come.
    longest_solve : float
        Longest time for a solution [s].

    Attributes
    ----------
    due : dict
        When answers are due, by what they answer: keys of requests, ``set-up``, ``place`` [s].
    """

    def __init__(self, role: str, wake: Callable[[], None], longest_solve: float = 0.2) -> None:
        self.role, self._wake, self.longest_solve = role, wake, longest_solve
        self._outbox: SimpleQueue[object] = SimpleQueue()
        self._inbox: deque[object] = deque()
        self.start()

    def start(self) -> None:
        """Start the process, in place of one that has ended."""
        self._outbox.put(None)  # ends the thread that sends to that one
        self._outbox = SimpleQueue()
        self.due: dict[object, float] = {}
        self._killed_for, role = "", self.role
        context = multiprocessing.get_context("spawn")
        self._cancelled: Any = context.Value("Q", 0, lock=False)
        ours, theirs = context.Pipe()
        self._process = context.Process(
            target=run, args=(role, theirs, self._cancelled), name=role, daemon=True
        )
        # Ctrl-C in a terminal reaches the workers, too: it waits until they ignore it.
        unblocked = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
        self._process.start()
        signal.pthread_sigmask(signal.SIG_SETMASK, unblocked)
        theirs.close()
        for work, *of_work in ((self._send_all, ours, self._outbox), (self._receive_all, ours)):
            threading.Thread(target=work, args=of_work, name=role, daemon=True).start()

    @property
    def pid(self) -> int:
        """The process."""
        return self._process.pid or 0

    @property
    def backlog(self) -> int:
        """Messages that wait to be sent."""
        return self._outbox.qsize()

    def send(self, message: object) -> None:
        """Send a message; it never waits."""
        now = self._time()
        if isinstance(message, PlanRequest):
            self.due[message.key] = now + self.longest_solve + _ANSWER_TIME
        elif isinstance(message, SetUp):
            self.due["set-up"] = now + _SET_UP_TIME
        elif isinstance(message, Place):
            self.due.setdefault("place", now + _ANSWER_TIME)
        self._outbox.put(message)

    def cancel(self, key: int) -> None:
        """Ask the planner to end its work on a request, and on all before."""
        self._cancelled.value = max(self._cancelled.value, key)
        if key in self.due:
            self.due[key] = min(self.due[key], self._time() + _ANSWER_TIME)

    def receive(self) -> list[object]:
        """The messages that have come."""
        found = []
        while self._inbox:
            message = self._inbox.popleft()
            if isinstance(message, Place):  # it only shows that the watcher works
                self.due.pop("place", None)
                continue
            key = getattr(message, "key", "set-up" if isinstance(message, SetUpDone) else None)
            self.due.pop(key, None)
            if key == "set-up":  # requests have waited for it
                due = self._time() + self.longest_solve + _ANSWER_TIME
                self.due = dict.fromkeys(self.due, due)
            found.append(message)
        return found

    def check(self) -> None:
        """Kill the process if it does not answer in time."""
        due = self.due.get("set-up", min(self.due.values(), default=math.inf))
        if not self._killed_for and self._time() > due:
            self._killed_for = "it did not answer in time"
            self._process.kill()

    def _time(self) -> float:
        """The time of deadlines [s]: on a busy machine, a worker that is not run is not late."""
        used = 0.0
        with suppress(OSError):  # it has ended
            used = time.clock_gettime(~self.pid << 3 | 2)  # see clock_getcpuclockid(3)
        return used + _IDLE_SHARE * time.monotonic()

    def close(self) -> None:
        """End the process."""
        self._killed_for = self._killed_for or "it was ended"
        self._process.kill()
        self._process.join(5.0)

    def _send_all(self, connection: Connection, outbox: SimpleQueue[object]) -> None:
        with suppress(OSError):
            while (message := outbox.get()) is not None:
                connection.send(message)

    def _receive_all(self, connection: Connection) -> None:
        try:
            while True:
                self._inbox.append(connection.recv())
                self._wake()
        except (EOFError, OSError, pickle.UnpicklingError):
            self._process.join(5.0)
            self._inbox.append(WorkerDied(self._killed_for or self._reason()))
            with suppress(Exception):  # the node may be ending
                self._wake()

    def _reason(self) -> str:
        code = self._process.exitcode
        if code is not None and code < 0:
            return f"signal {signal.Signals(-code).name}"
        return f"exit status {code}"


Hear = Callable[[str, object], None]
"""Takes the role of a worker, and what it says."""


class Workers:
    """The planner and the watcher, which have the same obstacles.

    A worker that has ended is started again, and takes the obstacles over from the other one.

    Parameters
    ----------
    wake : callable
        See `WorkerProcess`.
    longest_solve : float
        Longest time for a solution [s].
    hear : callable
        Takes what the workers say; a `WorkerDied` when another one is being started.

    Attributes
    ----------
    planner, watcher : WorkerProcess
        The workers. The watcher is there from the start, because the first obstacle may be near a
        moving robot.
    has_obstacles : bool
        Whether there have been any.
    n_restarts : int
        Workers that have ended.
    """

    def __init__(self, wake: Callable[[], None], longest_solve: float, hear: Hear) -> None:
        self.planner = WorkerProcess(PLANNER, wake, longest_solve)
        self.watcher = WorkerProcess(WATCHER, wake)
        self._hear = hear
        self.has_obstacles, self.n_restarts = False, 0
        # What the planner has been asked, by the numbers of the answers.
        self._numbers = count(1)
        self._asked: dict[int, Future] = {}
        self._watched: WatchedRobot | None = None
        self._is_up = False
        # The worker that takes over obstacles of the other, and markers that came since it began.
        self._heir: WorkerProcess | None = None
        self._meanwhile: list[Markers] = []

    @property
    def is_watching(self) -> bool:
        """Whether the watcher knows the robot and the obstacles."""
        return self._is_up and self._heir is not self.watcher

    @property
    def backlog(self) -> int:
        """Most messages that wait to be sent to a worker."""
        return max(self.planner.backlog, self.watcher.backlog)

    def ask(self, question: Callable[[int], SetUp | KeepMotion]) -> Future:
        """Ask the planner what is made of a number; the answer comes later."""
        number = next(self._numbers)
        future = self._asked[number] = Future()
        self.planner.send(question(number))
        return future

    def watch(self, robot: WatchedRobot) -> None:
        """Tell the watcher which robot it watches, if that is another one."""
        if robot != self._watched:
            self._watched = robot
            self.watcher.send(robot)

    def send_obstacles(self, message: Markers | Frames) -> None:
        """Send both workers obstacles, or poses of their frames."""
        self.has_obstacles = True
        if self._heir is not None and isinstance(message, Markers):
            self._meanwhile.append(message)
        self.planner.send(message)
        self.watcher.send(message)

    def receive(self) -> None:
        """Handle what the workers have said."""
        for worker in (self.planner, self.watcher):
            for message in worker.receive():
                self._on_message(worker, message)

    def check(self) -> None:
        """Kill the workers that do not answer in time."""
        self.planner.check()
        self.watcher.check()

    def close(self) -> None:
        """End the workers."""
        self.planner.close()
        self.watcher.close()

    def _on_message(self, worker: WorkerProcess, message: object) -> None:
        if isinstance(message, SetUpDone | Kept) and message.number in self._asked:
            self._asked.pop(message.number).set_result(message)
            return
        if isinstance(message, TakeObstacles):
            self._hand_over(message)
            return
        if isinstance(message, WorkerDied):
            self._restart(worker, message)
        elif isinstance(message, SetUpDone) and worker is self.watcher:
            self._is_up = True
        self._hear(worker.role, message)

    def _hand_over(self, obstacles: TakeObstacles) -> None:
        heir, self._heir = self._heir, None
        if heir is not None:
            for message in (obstacles, *self._meanwhile):
                heir.send(message)

    def _restart(self, worker: WorkerProcess, died: WorkerDied) -> None:
        self.n_restarts += 1
        worker.start()
        other = self.watcher if worker is self.planner else self.planner
        if self._heir is other:
            self._heir = None
            reason = "the obstacles were lost as both workers have ended: publish them again"
            self.planner.send(LoseObstacles(reason))
        elif self.has_obstacles:
            self._meanwhile = self._meanwhile if self._heir is worker else []
            self._heir = worker
            other.send(TakeObstacles())
        if worker is self.watcher:
            self._is_up, self._watched = False, None
            return
        waiting, self._asked = self._asked, {}
        for number, future in waiting.items():
            problem = f"the planner has ended ({died.reason})"
            future.set_result(SetUpDone(number, problem=problem))
