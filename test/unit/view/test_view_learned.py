# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A demonstration bent by components, and the clock that plays it."""

import threading
from collections.abc import Iterator
from dataclasses import replace
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from support.arm import arm_demonstrations, arm_primitive, arm_robot

from mp_pca_planner.primitives.primitive import MovementPrimitive

pytest.importorskip("viser", reason="the extra 'view' is not installed")
from mp_pca_planner.view.content import typical_demonstration
from mp_pca_planner.view.learned import (
    bent_demonstration,
)
from mp_pca_planner.view.stage import REST, Player, ShownMotion


def ramp(duration: float = 2.0) -> ShownMotion:
    times = np.array([0.0, duration])
    return ShownMotion(times, np.array([[0.0, 1.0], [10.0, 3.0]]))


# Components


@pytest.mark.parametrize("coupling", ["arm", "joint"])
def test_bending_is_linear_and_keeps_the_ends(coupling):
    primitive = arm_primitive(coupling, 2)
    n = primitive.n_components
    own = bent_demonstration(primitive, 3, np.zeros(n))
    np.testing.assert_allclose(own.positions, primitive.reproduction(3, own.times), atol=1e-12)
    bent = [bent_demonstration(primitive, 3, row).positions - own.positions for row in np.eye(n)]
    both = bent_demonstration(primitive, 3, np.arange(1.0, n + 1.0)).positions - own.positions
    np.testing.assert_allclose(both, np.tensordot(np.arange(1.0, n + 1.0), bent, 1), atol=1e-9)
    np.testing.assert_allclose([one[[0, -1]] for one in bent], 0.0, atol=1e-9)


def test_what_is_bent_moves_as_far_as_the_demonstrations_also_where_half_of_them_return():
    """The mean of raising and of returning moved the wrist by 24 mm, demonstrations by 952."""
    raising = arm_demonstrations()
    returning = [replace(one, positions=one.positions[::-1].copy()) for one in raising]
    primitive = MovementPrimitive.fit([*raising, *returning], name="both ways")
    robot = arm_robot()

    def travel(positions: np.ndarray) -> float:
        ends = robot.frame_positions(positions[[0, -1]], ["wrist"])[:, 0]
        return float(np.linalg.norm(ends[1] - ends[0]))

    straight = np.zeros(primitive.n_components)
    own = [
        travel(bent_demonstration(primitive, i, straight).positions)
        for i in range(len(primitive.durations))
    ]
    index = typical_demonstration(primitive)
    shown = travel(bent_demonstration(primitive, index, straight).positions)
    assert np.quantile(own, 0.2) <= shown <= np.quantile(own, 0.8)
    mean = primitive.boundary_states[:, [0, 3]].mean(axis=0)
    assert travel(mean) < 0.1 * shown  # what the page showed before


# The player


@pytest.fixture
def player() -> Iterator[Player]:
    """A player that rests, of a motion with positions that are times 5, on a stage of stubs."""
    stage: Any = MagicMock()
    stage.lock = threading.RLock()
    stage.drawn.show = lambda q: setattr(stage, "shown", q)
    made = Player(stage, ramp())
    made.play(False)
    made.seek(0.0)
    yield made
    made.close()


def test_the_player_stops_at_the_end_rests_and_starts_again(player):
    player.advance(1.0)
    np.testing.assert_allclose(player._stage.shown, [5.0, 2.0])
    for elapsed in (1.0, 0.5 * REST):
        player.advance(elapsed)
        np.testing.assert_allclose(player._stage.shown, [10.0, 3.0])
    player.advance(0.5 * REST + 0.1)
    np.testing.assert_allclose(player._stage.shown, [0.5, 1.1])


@given(st.floats(0.0, 1.0), st.floats(0.1, 10.0))
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_another_motion_goes_on_at_the_same_share(player, share, duration):
    player.show(ramp())
    player.seek(share)
    player.show(ramp(duration))
    assert player.share == pytest.approx(share)
