# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A worker of the node: a process that may take long, take much memory, or die.

The planner plans; the watcher checks the running motion. Both read the obstacles.
"""

from __future__ import annotations

import gc
import os
import pickle
import resource
import signal
import sys
import time
import traceback
from collections import deque
from contextlib import suppress
from dataclasses import dataclass
from importlib import import_module
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from rclpy.serialization import serialize_message

from ..exceptions import PlannerError, printable
from ..execution.link import (
    Place,
    PlanRequest,
    Positions,
    Rejected,
    SetUp,
    SetUpDone,
    WatchedRobot,
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
        self._measured: Positions | None = None
        self._told = WorldFacts(0)

    def work(self) -> None:
        """Answer one message after the other."""
        while True:
            if self._later or self._connection.poll(_IDLE):
                message = self._later.popleft() if self._later else self._connection.recv()
                if isinstance(message, Positions):
                    self._measured = message
                else:
                    self._guarded(message)
            # The newest positions count, once nothing else waits: goals go first.
            if self._measured and not (self._later or self._connection.poll(0)):
                measured, self._measured = self._measured, None
                self._guarded(measured)
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
                answer: object = core.plan(message)
                self._tell_model()
                self._send(answer)
            case SetUp():
                answer = core.set_up(message)
                self._use_model()
                self._send(answer)
                # What stays is not searched while a goal is planned: some 0.4 of 4 ms, or 90 once.
                gc.unfreeze()
                gc.collect()
                gc.freeze()
            case Positions():
                core.lock(message.measured)
                self._tell_model()
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
            case Place():
                self._watcher.receive(message)
                self._send(message)
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

    def _tell_model(self) -> None:
        """Tell the node if joints that do not move are elsewhere."""
        model = self._core.model
        if model is not None and model is not self._obstacles.model:
            self._use_model()
            self._send(model.facts)

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
