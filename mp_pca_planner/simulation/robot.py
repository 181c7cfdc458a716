# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A simulated robot and its trajectory controller, stepped together in virtual time.

Faults are set on demand, and every cycle is recorded.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Hashable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import FloatArray
from ..exceptions import PlannerError
from ..lazy import LazyModule
from ..motion.trajectory import Trajectory
from ..recordings.joint_states import NS_PER_S
from ..robot.model import Robot
from .controller import TrajectoryController, TrajectoryMessage, to_message

lapack = LazyModule("scipy.linalg.lapack")

PERIOD = 1e-3
"""Time of one step [s]."""


class Plant:
    """An arm at rest that follows commanded positions, computed by Pinocchio.

    The motion is integrated by the semi-implicit Euler method. The drives are critically damped.
    They act on the state at the end of each step, which is stable for gains of any size.

    Parameters
    ----------
    robot : Robot
        The arm.
    start : array, shape (n_joints,)
        Its positions [rad or m].

    Attributes
    ----------
    inertia : array, shape (n_joints,)
        Inertia of each drive behind its gear [kg·m² or kg].
    kp, kd : array, shape (n_joints,)
        Gains of the drives [N·m/rad, N·m·s/rad; N/m, N·s/m].
    effort : array, shape (n_joints,)
        Their largest torque [N·m] or force [N].
    q, v : array, shape (n_joints,)
        Positions [rad or m] and velocities [/s].
    acting : array, shape (n_joints,)
        Torques [N·m] or forces [N] of the drives in the last step.
    """

    bandwidth = 100.0
    """Bandwidth of the drives [rad/s]."""

    lag = 0.003
    """Delay with which drives follow commands [s]."""

    inertia_share = 0.05
    """Inertia of each drive and gear as a share of that of the heaviest joint: the wrist of a
    geared arm is far from weightless."""

    def __init__(self, robot: Robot, start: FloatArray) -> None:
        inertias, limits = _largest_inertias(robot), robot.limits()
        self.inertia = np.full(robot.n_joints, self.inertia_share * inertias.max())
        total = inertias + self.inertia
        self.kp, self.kd = self.bandwidth**2 * total, 2.0 * self.bandwidth * total
        self.effort = limits.effort
        self._stiffness = PERIOD * self.kd + PERIOD**2 * self.kp
        self.q, self.v = np.array(start), np.zeros(robot.n_joints)
        self.acting = np.zeros(robot.n_joints)
        self._robot = self._loaded = robot
        self._commanded = self.q

    def set_payload(self, mass: float) -> None:
        """Attach a mass [kg] to the end effector, which gravity compensation does not include."""
        self._loaded = self._robot.with_payload(mass)

    def step(self, command: FloatArray) -> None:
        """Move for one period towards commanded positions, shape (n_joints,)."""
        rate = (command - self._commanded) / PERIOD
        self._commanded = command
        at_rest = self.q[None], np.zeros((1, self.q.size)), np.zeros((1, self.q.size))
        gravity = self._robot.inverse_dynamics(*at_rest)[0]
        M, h = self._loaded.motion_equation(self.q, self.v)
        # The goal at the end of the step, without the part that depends on the velocity there.
        due = command - (self.lag - PERIOD) * rate
        tau = gravity + self.kp * (due - self.q) + self.kd * rate
        momentum = (M + np.diag(self.inertia)) @ self.v
        after = _solve(M + np.diag(self.inertia + self._stiffness), momentum + PERIOD * (tau - h))
        acting = tau - self._stiffness / PERIOD * after
        if (np.abs(acting) > self.effort).any():
            after = self._saturated(M, momentum - PERIOD * h, tau, acting)
            acting = np.clip(tau - self._stiffness / PERIOD * after, -self.effort, self.effort)
        self.acting = acting
        self.v = after
        self.q = self.q + PERIOD * after

    def _saturated(
        self, M: FloatArray, push: FloatArray, tau: FloatArray, acting: FloatArray
    ) -> FloatArray:
        """Velocities after a step in which some drives saturate."""
        full = np.zeros(len(tau), dtype=bool)
        for _ in range(len(tau)):
            over = np.abs(acting) > self.effort
            if not (over & ~full).any():
                break
            full |= over
            limited = np.where(full, np.clip(acting, -self.effort, self.effort), tau)
            diagonal = np.diag(self.inertia + np.where(full, 0.0, self._stiffness))
            after = _solve(M + diagonal, push + PERIOD * limited)
            acting = np.where(full, limited, tau - self._stiffness / PERIOD * after)
        return after


def _largest_inertias(robot: Robot) -> FloatArray:
    """The largest inertia of each joint in 64 random configurations [kg·m² or kg]."""
    limits, zero = robot.limits(), np.zeros(robot.n_joints)
    low, high = np.clip(limits.lower, -np.pi, None), np.clip(limits.upper, None, np.pi)
    draws = low + (high - low) * np.random.default_rng(0).uniform(size=(64, robot.n_joints))
    inertias = [np.diag(robot.motion_equation(q, zero)[0]) for q in draws]
    return np.asarray(np.max(inertias, axis=0))


def _solve(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """Solve with a symmetric positive definite matrix of which the upper triangle is given."""
    _, solution, info = lapack.dposv(matrix, right)
    if info != 0:
        raise PlannerError(
            "the mass matrix of the robot is not positive definite: give every moving link of "
            "the robot description a valid inertial"
        )
    return np.asarray(solution)


@dataclass(slots=True)
class Faults:
    """Faults of a simulated robot; every attribute may be set at any time.

    Attributes
    ----------
    speed_scaling : float
        Speed of the trajectory's clock, 0 to 1. The robot follows a change smoothly, in about
        0.4 s, as real robots do.
    held : bool
        Whether the robot is held: a speed scaling of 0 until it is released.
    silent : bool
        Whether no joint states are published.
    delay, jitter : float
        Transport time of a message, and its largest random addition [s].
    active : bool
        Whether the controller is active; it rejects messages unless it is.
    drop : float
        Probability that a message is lost.
    payload : float
        Mass at the end effector that gravity compensation does not include [kg].
    noise : float
        Standard deviation of measured positions [rad or m]; that of velocities is 100/s times it.

    Raises
    ------
    PlannerError
        If a value is out of range.
    """

    speed_scaling: float = 1.0
    held: bool = False
    silent: bool = False
    delay: float = 0.0
    jitter: float = 0.0
    active: bool = True
    drop: float = 0.0
    payload: float = 0.0
    noise: float = 0.0

    def __setattr__(self, name: str, value: Any) -> None:
        high = {"payload": 1000.0, "noise": 0.1}.get(name, 1.0)
        if not 0.0 <= value <= high:
            raise PlannerError(f"{name} is {value}, expected a number from 0 to {high:g}")
        object.__setattr__(self, name, value)


class Record:
    """One row per cycle of the controller.

    Attributes
    ----------
    times, clock, scaling : array, shape (n_cycles,)
        Time of each cycle [s], time for which commands have advanced along trajectories [s],
        and speed scaling.
    q, v, a : array, shape (n_cycles, n_joints)
        Commanded positions [rad or m], and the trajectory's velocities and accelerations there,
        by its own clock [/s, /s²].
    measured : array, shape (n_cycles, n_joints)
        Positions before the command, without noise [rad or m].
    cuts : list of int
        Cycles whose commands may jump: the controller was restarted or deactivated, or its goal
        was cancelled.
    """

    def __init__(self, n_joints: int) -> None:
        shapes: dict[str, tuple[int, ...]] = dict.fromkeys(("times", "clock", "scaling"), ())
        shapes |= dict.fromkeys(("q", "v", "a", "measured"), (n_joints,))
        self._names, self._size = tuple(shapes), 0
        self._rows = np.empty(4096, [(name, float, shape) for name, shape in shapes.items()])
        self.cuts: list[int] = []

    def __len__(self) -> int:
        return self._size

    def __getattr__(self, name: str) -> FloatArray:
        if name.startswith("_") or name not in self._names:
            raise AttributeError(name)
        return np.asarray(self._rows[name][: self._size])

    def append(self, *row: float | FloatArray) -> None:
        """Add a cycle: the values of all columns, in the order above."""
        if self._size == len(self._rows):
            self._rows = np.concatenate([self._rows, np.empty_like(self._rows)])
        self._rows[self._size] = row
        self._size += 1

    def clear(self) -> None:
        """Discard all cycles."""
        self._size = 0
        self.cuts.clear()

    def arrays(self) -> dict[str, FloatArray]:
        """Every array by name, for :func:`numpy.savez`."""
        arrays = {name: getattr(self, name) for name in self._names}
        return arrays | {"cuts": np.array(self.cuts)}


CYCLE_NS = round(PERIOD * NS_PER_S)
"""Time of one step of the robot [ns]."""


class SimulatedRobot:
    """An arm, its drives and its trajectory controller, stepped together.

    Parameters
    ----------
    robot : Robot
        The arm.
    start : array, shape (n_joints,)
        Positions at the start, at rest [rad or m].
    seed : int
        Of delays, losses and noise.
    time_ns : int
        First time of the virtual clock [ns], over 0: a stamp of 0 means "on arrival".
    state_rate : float
        Rate of joint states [Hz], up to 1000.

    Attributes
    ----------
    joint_names : tuple of str
        Joints of the controller.
    controller : TrajectoryController
        The controller.
    time_ns, state_time_ns : int
        The present time, and the stamp of the newest joint state [ns].
    faults : Faults
        Present faults; set its attributes at any time.
    record : Record
        Commanded and measured states of every cycle.
    rejections : list of (float, str)
        Time [s] and reason of each message that was rejected or dropped.
    state_period_ns : int
        Time between joint states [ns].
    n_received : int
        Messages that reached the controller.
    taken : list of (int, int)
        Cycle in which it began to follow each, and the number of its points.

    """

    def __init__(
        self,
        robot: Robot,
        start: ArrayLike,
        *,
        seed: int = 0,
        time_ns: int = 10**12,
        state_rate: float = 500.0,
    ) -> None:
        q = np.array(start, dtype=float)
        self.joint_names = robot.joint_names
        self.faults, self.record = Faults(), Record(robot.n_joints)
        self.rejections: list[tuple[float, str]] = []
        self.n_received = 0
        self.taken: list[tuple[int, int]] = []
        self.plant = Plant(robot, q)
        self.controller = TrajectoryController(self.joint_names, q, robot.continuous)
        self.time_ns = self.state_time_ns = time_ns
        self.state_period_ns = round(NS_PER_S / state_rate)
        self._filters = [1.0, 1.0, 1.0]
        self._payload = 0.0
        self._under_way: deque[tuple[int, TrajectoryMessage, Hashable | None]] = deque()
        # Noise has its own random stream, so that it does not change delays.
        self._chance, self._noise = (np.random.default_rng([seed, k]) for k in range(2))
        self._measured = self._state = self._measure()

    @property
    def time(self) -> float:
        """The present time [s]."""
        return self.time_ns / NS_PER_S

    def send(
        self, trajectory: Trajectory, stamp: float | None = None, *, last_point_only: bool = False
    ) -> None:
        """Send a trajectory to the controller, with the present delay and loss.

        Parameters
        ----------
        trajectory : Trajectory
            The motion.
        stamp : float, optional
            Time at which it starts [s]; on arrival unless given.
        last_point_only : bool
            Whether only the last point is sent, to which the controller interpolates by itself.
        """
        self.send_message(to_message(trajectory, stamp, last_point_only=last_point_only))

    def send_message(self, message: TrajectoryMessage, goal: Hashable | None = None) -> None:
        """Send any message to the controller, with the present delay and loss.

        Parameters
        ----------
        message : TrajectoryMessage
            The message.
        goal : hashable, optional
            Identifies the goal of the action that it is; else it comes by topic.
        """
        lost, late = self._chance.uniform(size=2)
        if lost < self.faults.drop:
            self.rejections.append((self.time, "the message was lost"))
            return
        delay = self.faults.delay + late * self.faults.jitter
        due = self.time_ns + round(delay * NS_PER_S)
        # Messages of one publisher keep their order.
        if self._under_way:
            due = max(due, self._under_way[-1][0])
        self._under_way.append((due, message, goal))

    def cancel(self, goal: Hashable) -> bool:
        """Cancel a goal of the action at once; returns whether it was being executed."""
        # A goal that was accepted is the controller's, even if its message is still under way.
        while any(entry[2] == goal for entry in self._under_way):
            self._deliver(*self._under_way.popleft()[1:])
        is_running = self.controller.cancel(goal)
        if is_running:
            self.record.cuts += [len(self.record), len(self.record) + 1]
        return is_running

    def step(self) -> None:
        """Advance by 1 ms."""
        self.time_ns += CYCLE_NS
        controller, faults = self.controller, self.faults
        if faults.active != controller.is_active:
            self._activate(faults.active)
        if faults.payload != self._payload:
            self._payload = faults.payload
            self.plant.set_payload(self._payload)
        while self._under_way and self._under_way[0][0] <= self.time_ns:
            self._deliver(*self._under_way.popleft()[1:])
        self._measured = self._measure()
        target = 0.0 if faults.held else faults.speed_scaling
        if self._filters[-1] != target:
            self._filters = _smoothed(self._filters, target)
        controller.speed_scaling = self._filters[-1]
        command = controller.update(self.time_ns, CYCLE_NS, self._measured)
        clock, rows = controller.clock_ns / NS_PER_S, command.reshape(3, -1)
        self.record.append(self.time, clock, controller.speed_scaling, *rows, self.plant.q)
        if not faults.silent and self.time_ns - self.state_time_ns >= self.state_period_ns:
            self._state, self.state_time_ns = self._measured, self.time_ns
        # Drives ignore NaN.
        if math.isfinite(rows[0].sum()):
            self.plant.step(rows[0])

    def set_time(self, time_ns: int) -> None:
        """Set the clock [ns]; neither the arm nor its controller moves meanwhile."""
        since = time_ns - self.time_ns
        self.time_ns += since
        self.state_time_ns = min(self.state_time_ns, time_ns)
        self._under_way = deque(
            (due + since, message, goal) for due, message, goal in self._under_way
        )

    def newest_state(self) -> tuple[float, FloatArray, FloatArray]:
        """The newest joint state that was published: its stamp [s], positions, velocities."""
        return self.state_time_ns / NS_PER_S, *self._state

    def measured_state(self) -> tuple[FloatArray, FloatArray]:
        """Positions and velocities measured in the last cycle, each of shape (n_joints,)."""
        return self._measured

    def restart_controller(self) -> None:
        """Restart the controller: it drops its trajectory and holds the commanded positions."""
        self._activate(self.faults.active)

    def _activate(self, active: bool) -> None:
        self.record.cuts.append(len(self.record))
        (self.controller.activate if active else self.controller.deactivate)()

    def _deliver(self, message: TrajectoryMessage, goal: Hashable | None) -> None:
        self.n_received += 1
        reason = self.controller.receive(message, self.time_ns, goal)
        if reason is not None:
            self.rejections.append((self.time, reason))
        else:
            self.taken.append((len(self.record), len(message.points)))

    def _measure(self) -> tuple[FloatArray, FloatArray]:
        q, v = self.plant.q, self.plant.v
        if self.faults.noise == 0.0:
            return q, v
        noise = self.faults.noise * self._noise.standard_normal((2, len(q)))
        # Noise of velocities, as of position differences over 10 ms.
        return q + noise[0], v + 100.0 * noise[1]


def _smoothed(filters: list[float], target: float) -> list[float]:
    """The next values of three filters with time constants of 50 ms, for about 0.4 s in all."""
    # The first two derivatives of the last one are bounded. A step of the speed scaling would be a
    # step of the velocity, which no planner can prevent.
    share, before, result = PERIOD / 0.05, target, []
    for value in filters:
        before = value + share * (before - value)
        result.append(before)
    # Filters never reach their target exactly.
    is_there = max(abs(value - target) for value in result) < 1e-6
    return [target] * 3 if is_there else result
