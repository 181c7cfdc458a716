# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""An independent referee of commanded motions: limits and jumps, by finite differences.

It shares no code with the planner and takes only arrays. Derivatives are divided differences. For a
smooth motion, each equals the derivative at some nearby time, so it never exceeds the true peak. A
step of the acceleration appears as a jerk over one tick.

For a slowed controller, pass its own clock. The referee then judges the planned motion at its
planned speed; the deceleration by the speed scaling does not count.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

ORDERS = {"velocity": 1, "acceleration": 2, "jerk": 3}
# Ticks closer than this share of the usual period are skipped, because division by a very short
# time amplifies noise.
_NEAREST = 0.5
_NOISE = 1e-8  # rounding of positions [rad or m]
# Rates are judged from tick to tick, and over this many ticks, where the finest step has no effect.
_STRIDES = (1, 20)
_ALONE = 0.3  # other steps near a jump are below this share of it
_SAME_TICKS = 20  # window in which two clocks are compared [ticks]
_MARGIN = 2  # ticks around a cut that are not judged
_WINDOW = 7  # window of the median acceleration of the neighbouring motion [ticks]


@dataclass(frozen=True)
class Exceeded:
    """A violated limit of a joint, at its largest violation.

    Attributes
    ----------
    quantity : str
        ``position``, ``velocity``, ``acceleration``, ``jerk`` or ``finite``.
    joint, tick : int
        Which joint, and the index of the command.
    value, limit : float
        The commanded value and the limit.
    """

    quantity: str
    joint: int
    tick: int
    value: float
    limit: float


@dataclass(frozen=True)
class Verdict:
    """Findings of the referee.

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
        """Whether there are no findings."""
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
        Time of each command [s], not decreasing; of equal times the last command counts.
    limits : mapping
        ``lower``, ``upper``, ``velocity``, ``acceleration``, ``jerk``, each of shape (n_joints,);
        missing or infinite limits are not judged.
    time : array, shape (n_ticks,), optional
        Real time, where the controller's own clock was slowed. A rate is exceeded only if it is
        exceeded by both clocks. By the controller's clock alone, a micrometre per millisecond would
        be a step in almost no time. By real time alone, the deceleration of the speed scaling would
        count.
    cuts : sequence of int
        Ticks whose commands need not continue those before: the sender is not responsible.
    joins : sequence of int
        Ticks at which a slowed controller receives a message. Their commands continue those before
        except for a jump, which is judged only as a jump.
    tolerance : float
        Share of a limit by which it may be exceeded (for positions, of their range).
    max_jump : float
        Largest jump that is allowed [rad or m].
    finest : float
        A step below the resolution of encoders, which never violates a rate limit [rad or m].
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
        # Jumps are measured per millisecond of real time.
        largest = max(largest, float(np.abs(steps).max(initial=0.0)))
        jumps += [
            (int(ticks[k]), int(j), float(steps[k, j]))
            for k, j in np.argwhere(np.abs(steps) > max_jump)
        ]
    return Verdict(tuple(exceeded), tuple(jumps), largest)


def _jump_between(q: Array, tick: int) -> Array:
    """Distance between the motions before and after a tick, each extrapolated by half a tick."""
    if not 3 <= tick <= len(q) - 3:
        return np.zeros(q.shape[1])
    weights = np.array([0.375, -1.25, 1.875])
    return np.asarray(weights[::-1] @ q[tick : tick + 3] - weights @ q[tick - 3 : tick])


def _worst(found: Sequence[Sequence[Exceeded]]) -> list[Exceeded]:
    """For each quantity and joint, the largest violation that all clocks confirm."""
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
    """Indices of the last command of each time, with a minimum distance in time."""
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
    """Jumps of the position alone, after which the next step restores the velocity.

    The motion without them is judged by its derivatives, so that a jump counts once.
    """
    jumps, pairs = np.zeros_like(steps), steps[1:-2] * steps[2:-1]
    for before, j in np.argwhere((pairs < 0.0) & (np.abs(steps[1:-2]) > _NOISE)):
        k = before + 1
        near = np.abs(np.r_[steps[max(k - _WINDOW, 0) : k, j], steps[k + 2 : k + _WINDOW, j]])
        if near.max() < _ALONE * np.abs(steps[k : k + 2, j]).min():
            # Interpolated between the ticks before and after, which the jump does not affect.
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
