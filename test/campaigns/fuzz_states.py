# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Joint states of odd robots, for `node_fuzz.py`."""

from __future__ import annotations

import random
import time
from collections.abc import Iterator

from sensor_msgs.msg import JointState

ODD_STATES = ("nan velocities", "inf", "lengths", "split", "subsets", "clocks", "others", "nan")
"""Kinds of joint states of odd robots."""


def odd_states(kind: str, state: JointState, generator: random.Random) -> Iterator[JointState]:
    """Thirty joint states of a robot at rest; some kinds can't be used."""
    names, q, now = list(state.name), state.position.tolist(), time.time()
    for k in range(30):
        message = JointState(name=names, position=q, velocity=[0.0] * len(q))
        if kind == "nan velocities":
            message.velocity = [generator.choice([0.0, float("nan")]) for _ in q]
        elif kind == "inf":
            message.velocity = [generator.choice([0.0, float("inf")]) for _ in q]
        elif kind == "lengths":
            message.velocity = [0.0] * generator.randrange(8)
            message.position = q[: generator.randrange(len(q) + 1)]
        elif kind in ("split", "subsets"):
            half = set(names[k % 2 :: 2])
            chosen = half if kind == "split" else set(generator.sample(names, k % 5))
            message.name = [name for name in names if name in chosen]
            message.position = [x for name, x in zip(names, q, strict=True) if name in chosen]
            message.velocity = []
        elif kind == "clocks":
            stamp = generator.choice(
                [now, now - 3.0, now + 1e3, 1.0, 2e9, generator.random() * 2e9]
            )
            message.header.stamp.sec = int(stamp)
            message.header.stamp.nanosec = int(stamp % 1.0 * 1e9)
        elif kind == "others":
            message.name = [*names, *(f"finger {k} {j}" for j in range(100))]
            message.position = [*q, *[float("nan")] * 100]
            message.velocity = []
        elif kind == "nan":
            message.position = [generator.choice([x, float("nan")]) for x in q]
        yield message
