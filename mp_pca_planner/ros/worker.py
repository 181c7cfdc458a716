# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Workers of the node: processes that may take long, take much memory, or die.

The planner plans; the watcher checks the running motion. Both read the obstacles. Whatever ends a
worker costs its work: the node starts another one.
"""

from __future__ import annotations

import multiprocessing
import os
import pickle
import resource
import signal
import sys
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from importlib import import_module
from multiprocessing.connection import Connection
from pathlib import Path
from queue import SimpleQueue
from typing import Any

from rclpy.serialization import serialize_message

from ..exceptions import PlannerError, printable
from ..execution.link import (
    PlanRequest,
    Positions,
    Rejected,
    SetUp,
    SetUpDone,
    WatchedRobot,
    WorkerDied,
    WorldFacts,
)
from ..execution.planning import GoalPlanner
from ..execution.watching import Watcher
from ..motion.trajectory import Trajectory
from .markers import Frames, Markers, Obstacles

PLANNER, WATCHER = "planner", "watcher"

# Most memory of a worker [bytes], and their priorities: the node and the watcher go first.
_MEMORY = 6 << 30
_NICE = {PLANNER: 5, WATCHER: 0}
# Time after which a request must be answered, beside the time for its solution, and a set-up [s];
# and the part of the time by the clock that counts beside a worker's processor time.
_ANSWER_TIME, _SET_UP_TIME, _IDLE_SHARE = 2.0, 60.0, 0.2
# Longest time without a message in which a worker looks at lifetimes [s].
_IDLE = 0.05
# Longest time for which a goal waits while obstacles keep arriving [s].
_TAKING = 0.05


@dataclass(frozen=True, eq=False)
class KeepMotion:
    """Keep the motion of a request as a primitive in a folder; the number is for the answer."""

    number: int
    key: int
    folder: str


@dataclass(frozen=True, eq=False)
class Kept:
    """The file of a motion that was kept, or why there is none."""

    number: int
    file: str = ""
    problem: str = ""


@dataclass(frozen=True, eq=False)
class ShowMotion:
    """Draw a motion."""

    trajectory: Trajectory


@dataclass(frozen=True, eq=False)
class Preview:
    """The serialised markers of a motion."""

    content: bytes


@dataclass(frozen=True, eq=False)
class TakeObstacles:
    """Use the obstacles of another worker, pickled; an empty text asks for them."""

    content: bytes = b""


@dataclass(frozen=True, eq=False)
class LoseObstacles:
    """Say that the obstacles are unknown until markers come."""

    reason: str


@dataclass(frozen=True, eq=False)
class InternalError:
    """An exception that no input should cause."""

    text: str


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
        When answers are due, by what they answer: keys of requests, and ``set-up`` [s].
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
        self._process.start()
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
            key = getattr(message, "key", "set-up" if isinstance(message, SetUpDone) else None)
            self.due.pop(key, None)
            found.append(message)
        return found

    def check(self) -> None:
        """Kill the process if it does not answer in time."""
        if not self._killed_for and self.due and self._time() > min(self.due.values()):
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


def run(role: str, connection: Connection, cancelled: Any) -> None:
    """Be a worker until the node ends.

    Parameters
    ----------
    role : str
        `PLANNER` or `WATCHER`.
    connection : Connection
        The way to the node.
    cancelled : value
        Key of the last request that is no longer needed.
    """
    # A terminal sends its signals to the node, too, which ends its workers.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    with suppress(OSError, ValueError):
        resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY))
    with suppress(OSError):
        os.nice(_NICE[role])
    with suppress(OSError):  # where processes are listed
        Path("/proc/self/comm").write_text(role)
    if role == WATCHER:  # it must not be deaf while these load, with the first mesh
        for reader in ("collada", "trimesh"):
            import_module(reader)
    with suppress(EOFError, OSError):
        _Worker(role, connection, cancelled).work()


def trace_of(error: BaseException) -> str:
    """The traceback of an error, in printable lines."""
    lines = "".join(traceback.format_exception(error)).splitlines()
    return "\n".join(map(printable, lines))


class _Worker:
    """What a worker does with each message; each role gets its own kinds of them."""

    def __init__(self, role: str, connection: Connection, cancelled: Any) -> None:
        self._role, self._connection, self._send = role, connection, connection.send
        self._core = GoalPlanner(lambda key: bool(cancelled.value >= key))
        self._core.settle = self._take_obstacles
        self._watcher, self._obstacles = Watcher(), Obstacles()
        self._later: deque[Any] = deque()
        self._told = WorldFacts(0)

    def work(self) -> None:
        """Answer one message after the other."""
        while True:
            if self._later or self._connection.poll(_IDLE):
                message = self._later.popleft() if self._later else self._connection.recv()
                self._guarded(message)
            if self._obstacles.refresh():
                self._use_world()
            if self._role == WATCHER and (verdict := self._watcher.look()) is not None:
                self._send(verdict)

    def _guarded(self, message: Any) -> None:
        """Handle a message; whatever goes wrong is its answer."""
        try:
            self._handle(message)
            return
        except (EOFError, OSError):
            raise
        except MemoryError:
            reason = "the planner is out of memory"
        except PlannerError as error:
            reason = str(error)
        except Exception as error:
            self._send(InternalError(trace_of(error)))
            reason = f"internal error, please report it: {error!r:.500}"
        match message:
            case PlanRequest():
                self._send(Rejected(message.key, reason))
            case SetUp():
                self._send(SetUpDone(message.number, problem=reason))
            case KeepMotion():
                self._send(Kept(message.number, problem=reason))
            case _:
                print(f"{self._role}: {printable(reason)}", file=sys.stderr, flush=True)

    def _handle(self, message: Any) -> None:
        core = self._core
        match message:
            case PlanRequest():
                self._take_obstacles()
                self._send(core.plan(message))
            case SetUp():
                answer = core.set_up(message)
                self._use_model()
                self._send(answer)
            case Positions():
                if core.lock(message.measured) and core.model is not None:
                    self._use_model()
                    self._send(core.model.facts)
            case KeepMotion():
                self._send(self._kept(message))
            case ShowMotion():
                self._show(message)
            case Markers():
                self._obstacles.apply(message)
                self._use_world()
            case Frames():
                self._obstacles.use_frames(message)
                self._use_world()
            case LoseObstacles():
                self._obstacles.lose(message.reason)
                self._use_world()
            case TakeObstacles(content=b""):
                self._send(TakeObstacles(pickle.dumps(self._obstacles)))
            case TakeObstacles():
                self._obstacles = pickle.loads(message.content)
                self._use_model()
            case WatchedRobot():
                self._watcher.receive(message)
                self._use_model()
                self._send(SetUpDone(0))
            case _:
                self._watcher.receive(message)

    def _take_obstacles(self) -> None:
        """Take the obstacles that have arrived; other messages wait."""
        end = time.monotonic() + _TAKING
        while time.monotonic() < end and self._connection.poll(0):
            message = self._connection.recv()
            if isinstance(message, Markers | Frames):
                self._guarded(message)
            else:
                self._later.append(message)

    def _use_model(self) -> None:
        is_planner = self._role == PLANNER
        self._obstacles.use(self._core.model if is_planner else self._watcher.model)
        self._use_world()

    def _use_world(self) -> None:
        """Use the newest obstacles, and tell the node about them."""
        core, obstacles = self._core, self._obstacles
        core.world = self._watcher.world = obstacles.world
        core.unplaced = obstacles.unplaced
        facts = obstacles.facts
        if self._role == PLANNER and facts != self._told:
            self._told = facts
            self._send(facts)

    def _kept(self, message: KeepMotion) -> Kept:
        from ..execution.keeping import keep_motion

        plan, model = self._core.plans.get(message.key), self._core.model
        if plan is None or model is None:
            raise PlannerError(
                "the last motion can't be kept: it continues a running motion; send the goal again "
                "when the robot is at rest"
            )
        folder, facts = Path(message.folder), {"kept_by": "mp_pca_planner"}
        return Kept(message.number, str(keep_motion(plan, model.planner.primitives, folder, facts)))

    def _show(self, message: ShowMotion) -> None:
        from .preview import to_preview

        if (model := self._core.model) is not None:
            markers = to_preview(message.trajectory, model.robot, model.end_effector, model.urdf)
            self._send(Preview(serialize_message(markers)))
