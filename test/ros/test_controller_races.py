# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Controllers that answer late, never, or with a no, and restart, race with stops; virtual time."""

from __future__ import annotations

import heapq
from concurrent.futures import Future
from itertools import count
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

from mp_pca_planner.ros import controller

N_RUNS = 500
TICK = 0.05  # of the node [s]
LATEST = 0.03  # transport of a message [s]
LONGEST = controller.ControllerAction.answer_time + 2.0 * TICK + LATEST


class Goal:
    """A goal at the controller; it is the handle of the goal, too."""

    def __init__(self, world, name, duration):
        self.world, self.name, self.duration = world, name, duration
        self.is_stop, self.sent = duration < 1.0, world.now
        self.answer, self.result = Future(), Future()
        self.accepted = self.is_cancelled = False

    def get_result_async(self):
        return self.result

    def cancel_goal_async(self):
        assert not self.result.done(), "a goal that has ended is cancelled"
        self.is_cancelled = True
        self.world.after(self.world.transport(), lambda: self.world.end(self, 5))


class World:
    """A controller, which executes the goal that it accepted last, and the node's side of it."""

    def __init__(self, seed, monkeypatch):
        self.random, self.now = np.random.default_rng(seed), 0.0
        self.running, self.since, self.goals = None, 0.0, []
        self.stopped, self.was_doubtful = None, True  # the first stop after the last motion
        self._events, self._order = [], count()
        monkeypatch.setattr(controller, "time", SimpleNamespace(monotonic=lambda: self.now))
        monkeypatch.setattr(controller, "ActionClient", lambda *_: self)
        monkeypatch.setattr(controller, "deserialize_message", lambda content, _: content)
        kind = SimpleNamespace(Goal=lambda trajectory: trajectory)
        monkeypatch.setattr(controller, "FollowJointTrajectory", kind)
        self.action = controller.ControllerAction(None, lambda *_: None)
        self.action.use(SimpleNamespace(controller_action="follow"))

    def transport(self):
        return self.random.uniform(0.0, LATEST)

    def after(self, delay, action):
        heapq.heappush(self._events, (self.now + delay, next(self._order), action))

    def run(self, duration):
        end = self.now + duration
        while self.now < end:
            self.now += 0.01
            while self._events and self._events[0][0] <= self.now:
                heapq.heappop(self._events)[2]()
            if round(100 * self.now) % round(100 * TICK) == 0:
                self.action.watch()
            self.check()

    def check(self):
        """No motion before the stop goes on, and none after it is cancelled."""
        goal, stopped = self.running, self.stopped
        assert not any(g.is_cancelled for g in self.goals if stopped is None or g.sent > stopped)
        if goal is None or goal.is_stop or stopped is None or goal.sent > stopped:
            return
        assert self.now - max(self.since, stopped) <= LONGEST, "it moves on"
        assert self.was_doubtful or self.since <= self.goals[-1].sent, "it moves after a stop"

    def stop(self):
        if not self.goals or not self.goals[-1].is_stop:
            self.stopped = self.now
        self.was_doubtful = self.action.has_unanswered_motion
        self.send(0.2)

    def server_is_ready(self):
        return True

    def send_goal_async(self, goal):
        """Accept, reject or lose a goal, in time or late."""
        kind = self.random.random()
        if kind < 0.8:
            delay = self.transport() if kind < 0.5 else self.random.uniform(0.0, 2.0)
            self.after(delay, lambda: self.decide(goal, is_accepted=self.random.random() < 0.8))
        return goal.answer

    def decide(self, goal, *, is_accepted):
        goal.accepted = is_accepted
        if is_accepted:
            if self.running is not None:
                self.end(self.running, 6)
            self.running, self.since = goal, self.now
            self.after(goal.duration, lambda: self.end(goal, 4))
        goal.answer.set_result(goal)

    def end(self, goal, status):
        if self.running is goal:
            self.running = None
            result = SimpleNamespace(error_code=0, error_string="")
            goal.result.set_result(SimpleNamespace(status=status, result=result))

    def restart(self):
        """Forget what it does, and all answers."""
        self.running = None
        self._events.clear()

    def send(self, duration):
        goal = Goal(self, len(self.goals), duration)
        self.goals.append(goal)
        self.action.send(goal, goal, is_stop=goal.is_stop)


@pytest.mark.parametrize("first", range(0, N_RUNS, 100))
def test_no_motion_goes_on_after_a_stop_whatever_a_controller_answers(first, monkeypatch):
    n_late = 0
    for seed in range(first, first + 100):
        world = World(seed, monkeypatch)
        for _ in range(8):
            if world.random.random() < 0.6:
                world.send(world.random.uniform(2.0, 20.0))
            else:
                world.stop()
            world.run(world.random.choice([0.02, 0.2, 1.0, 3.0]))
            n_late += world.was_doubtful and world.stopped is not None
            if world.random.random() < 0.05:
                world.restart()
        world.run(25.0)
        is_answered = all(goal.answer.done() for goal in world.goals if not goal.is_stop)
        assert world.action.has_unanswered_motion != is_answered
    assert n_late > 50
