# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A referee of commanded motions: limits and jumps, by its own finite differences.

It shares no code with the planner and knows only arrays. Derivatives are divided differences: of
a smooth motion each is the derivative at some time nearby, so none exceeds what the motion really
does, and a step of the acceleration shows as the jerk that one tick makes of it.

Where a controller was slowed, pass its own clock: what was planned is judged, at the speed at
which it was planned, and not how fast someone else slows the robot down.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

ORDERS = {"velocity": 1, "acceleration": 2, "jerk": 3}
# Ticks nearer than this share of the usual one are passed over: little noise divided by very
# little time is much.
_NEAREST = 0.5
_NOISE = 1e-8  # of numbers [rad or m]
# Rates are judged from tick to tick, and over so many ticks, where the finest step makes no
# difference.
_STRIDES = (1, 20)
_ALONE = 0.3  # share of a jump that other steps near it are smaller than
_SAME_TICKS = 20  # in which two clocks see the same
_MARGIN = 2  # ticks beside a cut
_WINDOW = 7  # ticks whose median acceleration is that of the neighbouring motion


@dataclass(frozen=True)
class Exceeded:
    """A limit that a joint exceeded, where it did so most.

    Attributes
    ----------
    quantity : str
        ``position``, ``velocity``, ``acceleration``, ``jerk`` or ``finite``.
    joint, tick : int
        Which joint, and the index of the command.
    value, limit : float
        What was commanded, and what is allowed.
    """

    quantity: str
    joint: int
    tick: int
    value: float
    limit: float


@dataclass(frozen=True)
class Verdict:
    """What a referee found.

    Attributes
    ----------
    exceeded : tuple of Exceeded
        At most one for each quantity, joint and uncut part of the motion.
    jumps : tuple of (int, int, float)
        Tick, joint and size [rad or m] of each jump that is larger than allowed.
    largest_jump : float
        Size of the largest part of a step that the neighbouring motion doesn't explain.
    """

    exceeded: tuple[Exceeded, ...]
    jumps: tuple[tuple[int, int, float], ...]
    largest_jump: float

    @property
    def is_clean(self) -> bool:
        """Whether nothing was found."""
        return not self.exceeded and not self.jumps


def judge(
    positions: ArrayLike,
    clock: ArrayLike,
    limits: Mapping[str, ArrayLike],
    *,
    time: ArrayLike | None = None,
    cuts: Sequence[int] = (),
    joins: Sequence[int] = (),
    tolerance: float = 0.01,
    max_jump: float = 2e-4,
    finest: float = 0.0,
) -> Verdict:
    """Judge commands.

    Parameters
    ----------
    positions : array, shape (n_ticks, n_joints)
        Commanded positions [rad or m].
    clock : array, shape (n_ticks,)
        When each was due [s], never decreasing; equal times are one command.
    limits : mapping
        ``lower``, ``upper``, ``velocity``, ``acceleration``, ``jerk``, each of shape (n_joints,);
        those that are missing or infinite are not judged.
    time : array, shape (n_ticks,), optional
        The time of the world, where the controller's own clock was slowed: a rate is exceeded if
        it is so by both. By its own clock alone, a step of a micrometre that a slowed controller
        makes in a millisecond is a step in next to no time; by that of the world alone, who slows
        the controller down exceeds limits.
    cuts : sequence of int
        Ticks whose commands need not continue those before: the sender is not responsible.
    joins : sequence of int
        Ticks whose commands continue those before, but for a jump that is judged as such alone:
        where a slowed controller takes a message.
    tolerance : float
        Share of a limit by which it may be exceeded (for positions, of their range).
    max_jump : float
        Largest jump that is allowed [rad or m].
    finest : float
        A step that is smaller than what any encoder sees, and so exceeds no rate [rad or m].
    """
    q, own = np.asarray(positions, dtype=float), np.asarray(clock, dtype=float)
    exceeded, jumps, largest = list(_not_finite(q)), [], 0.0
    if exceeded:
        return Verdict(tuple(exceeded), (), np.inf)
    world = own if time is None else np.asarray(time, dtype=float)
    bounds = [0, *sorted({c for c in (*cuts, *joins) if 0 < c < len(q)}), len(q)]
    for tick in joins:
        size = _jump_between(q, tick)
        largest = max(largest, float(np.abs(size).max(initial=0.0)))
        jumps += [(tick, int(j), float(size[j])) for j in np.flatnonzero(np.abs(size) > max_jump)]
    for first, last in pairwise(bounds):
        # A jump beside a cut can't be separated from it.
        first, last = first + _MARGIN * (first > 0), last - _MARGIN * (last < len(q))
        exceeded += _positions_exceeded(q[first:last], first, limits, tolerance)
        found = []
        for one in (own, world) if time is not None else (own,):
            ticks = first + _spread(one[first:last])
            steps, position_jumps = _steps(q[ticks], one[ticks])
            joined = q[ticks] - np.cumsum(position_jumps, axis=0)
            found.append(
                list(_rates_exceeded(joined, one[ticks], ticks, limits, tolerance, finest))
            )
        exceeded += _worst(found)
        # Jumps are what happens in a millisecond of the world.
        largest = max(largest, float(np.abs(steps).max(initial=0.0)))
        jumps += [
            (int(ticks[k]), int(j), float(steps[k, j]))
            for k, j in np.argwhere(np.abs(steps) > max_jump)
        ]
    return Verdict(tuple(exceeded), tuple(jumps), largest)


def _jump_between(q: Array, tick: int) -> Array:
    """How far the motions before and after a tick, continued by half a tick each, are apart."""
    if not 3 <= tick <= len(q) - 3:
        return np.zeros(q.shape[1])
    weights = np.array([0.375, -1.25, 1.875])
    return np.asarray(weights[::-1] @ q[tick : tick + 3] - weights @ q[tick - 3 : tick])


def _worst(found: Sequence[Sequence[Exceeded]]) -> list[Exceeded]:
    """For each quantity and joint the worst that every clock agrees on."""
    *others, last = found
    worst: dict[tuple[str, int], Exceeded] = {}
    for one in last:
        agreed = all(
            any(
                (other.quantity, other.joint) == (one.quantity, one.joint)
                and abs(other.tick - one.tick) <= _SAME_TICKS
                for other in clock
            )
            for clock in others
        )
        key = one.quantity, one.joint
        if agreed and (key not in worst or abs(one.value) > abs(worst[key].value)):
            worst[key] = one
    return list(worst.values())


def _not_finite(q: Array) -> list[Exceeded]:
    bad = np.argwhere(~np.isfinite(q))
    return [Exceeded("finite", int(j), int(k), float(q[k, j]), np.inf) for k, j in bad[:1]]


def _spread(time: Array) -> NDArray[np.intp]:
    """Indices of the last commands of each time, far enough from one another."""
    if len(time) == 0:
        return np.zeros(0, dtype=np.intp)
    nearest = _NEAREST * float(np.diff(time).max(initial=0.0)) or 1.0
    kept: list[int] = []
    last = -np.inf
    for k, now in enumerate(time.tolist()):
        if now - last >= nearest:
            kept.append(k)
            last = now
        elif now == last:
            kept[-1] = k
    return np.array(kept, dtype=np.intp)


def _positions_exceeded(
    q: Array, first: int, limits: Mapping[str, ArrayLike], tolerance: float
) -> list[Exceeded]:
    none = np.full(q.shape[1], np.inf)
    lower, upper = (np.asarray(limits.get(k, s * none)) for k, s in (("lower", -1), ("upper", 1)))
    width = upper - lower
    slack = tolerance * np.where(np.isfinite(width), width, 0.0)
    found = []
    for limit, over in ((upper, q - upper - slack), (lower, lower - q - slack)):
        for j in np.flatnonzero((over > 0.0).any(axis=0)):
            k = int(over[:, j].argmax())
            found.append(Exceeded("position", int(j), first + k, float(q[k, j]), float(limit[j])))
    return found


def _differences(q: Array, time: Array, order: int) -> Array:
    """Divided differences times the factorial of their order, shape (n - order, n_joints)."""
    for k in range(1, order + 1):
        q = k * np.diff(q, axis=0) / (time[k:] - time[:-k])[:, None]
    return q


def _steps(q: Array, time: Array) -> tuple[Array, Array]:
    """Part of each step that the neighbouring motion doesn't explain; jumps of the position.

    The first is the change of velocity beyond what the median acceleration around it makes, as a
    displacement. Both have the shape of `q`.
    """
    steps, jumps = np.zeros_like(q), np.zeros_like(q)
    if len(q) < _WINDOW + 2:
        return steps, jumps
    a, half = _differences(q, time, 2), _WINDOW // 2
    padded = np.pad(a, ((half, half), (0, 0)), mode="reflect")
    usual = np.median(np.lib.stride_tricks.sliding_window_view(padded, _WINDOW, axis=0), axis=-1)
    h = np.diff(time)
    size = (0.5 * (h[1:] + h[:-1]) * h[1:])[:, None]
    steps[2:] = (a - usual) * size
    jumps[2:] = _position_jumps(a * size, steps[2:])
    return steps, jumps


def _position_jumps(moved: Array, steps: Array) -> Array:
    """Jumps of position only: the next step restores the velocity, and others are far smaller.

    The motion without them is judged by its derivatives, so that a jump counts once.
    """
    jumps, pairs = np.zeros_like(steps), steps[1:-2] * steps[2:-1]
    for before, j in np.argwhere((pairs < 0.0) & (np.abs(steps[1:-2]) > _NOISE)):
        k = before + 1
        near = np.abs(np.r_[steps[max(k - _WINDOW, 0) : k, j], steps[k + 2 : k + _WINDOW, j]])
        if near.max() < _ALONE * np.abs(steps[k : k + 2, j]).min():
            # Between the ticks before and after, which know nothing of the jump.
            usual = moved[k - 1, j] + (moved[k + 2, j] - moved[k - 1, j]) * np.array([1, 2]) / 3
            there, back = moved[k : k + 2, j] - usual
            jumps[k, j] = np.sign(there) * min(abs(there), abs(back))
    return jumps


def _rates_exceeded(
    q: Array,
    time: Array,
    ticks: NDArray[np.intp],
    limits: Mapping[str, ArrayLike],
    tolerance: float,
    finest: float,
) -> Iterator[Exceeded]:
    for quantity, order in ORDERS.items():
        limit = np.asarray(limits.get(quantity, np.full(q.shape[1], np.inf)), dtype=float)
        if not np.isfinite(limit).any():
            continue
        for part in (slice(k, None, stride) for stride in _STRIDES for k in range(stride)):
            if len(q[part]) <= order:
                continue
            values = _differences(q[part], time[part], order)
            step = np.diff(time[part])[order - 1 :, None]
            over = np.abs(values) > (1.0 + tolerance) * limit + finest / step**order
            for k, j in np.argwhere(over):
                tick, value = int(ticks[part][k + order]), float(values[k, j])
                yield Exceeded(quantity, int(j), tick, value, float(limit[j]))
