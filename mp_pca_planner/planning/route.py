# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Resolution of goals of several targets: configurations for poses, primitives, durations.

For each pose, the initial configuration is the one that makes the sequence most similar to the
demonstrations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from ..arrays import FloatArray
from ..exceptions import GoalError
from ..input_limits import INPUT_LIMITS
from ..motion.goal import JointState, Pose, SequenceGoal
from .conditions import JointTarget, PoseTarget, Target
from .pose_search import configurations_at, starts_near
from .selection import Selector
from .sequence_request import SequenceRequest, duration_groups, fit_durations
from .setup import Setup
from .states import check_start, check_within_limits, completed, in_order, unwrapped

# Targets within this distance of each other count as the same [rad or m].
_SAME = 1e-6


class SequenceResolver:
    """Resolves goals of several targets for a planner.

    Parameters
    ----------
    setup : Setup
        Robot, limits and options of the planner.
    selector : Selector
        Chooses among its primitives.
    """

    def __init__(self, setup: Setup, selector: Selector) -> None:
        self._setup, self._selector = setup, selector
        self.robot, self.limits = setup.robot, setup.limits
        self._search = setup.options.search

    def resolve(self, goal: SequenceGoal, start: JointState) -> SequenceRequest:
        """Choose configurations, primitives and usual durations.

        Parameters
        ----------
        goal : SequenceGoal
            The targets. Initial targets at the robot's position count as passed.
        start : JointState
            Present state.

        Raises
        ------
        GoalError, RobotError
            See :meth:`.Planner.plan`.
        """
        self._check_size(goal)
        here = in_order(start, self.robot.joint_names)
        check_start(here, self.limits)
        selector = self._selector.among(goal.primitive)
        n_passed = self._n_passed(goal, here)
        goal = replace(
            goal,
            targets=goal.targets[n_passed:],
            times=goal.times[n_passed:],
            stops=goal.stops[n_passed:],
        )
        states = self._route(goal, here, selector, n_passed + 1)
        chosen = [selector.choose(a.positions, b.positions) for a, b in pairwise(states)]
        usual = [one.first.expected.duration for one in chosen]
        durations = fit_durations(usual, goal.times)
        self._setup.check_duration("the sequence would take", sum(durations))
        self._setup.check_duration("a segment of the sequence would take", min(durations))
        return SequenceRequest(
            tuple(states),
            tuple(map(self._target, goal.targets, states[1:])),
            (*goal.stops[:-1], True),
            tuple(chosen),
            durations,
            duration_groups(goal.times),
        )

    def _target(self, target: JointState | Pose, there: JointState) -> Target:
        if isinstance(target, Pose):
            return PoseTarget(self.robot, target)
        n = self.robot.n_joints
        return JointTarget(np.arange(n), there.positions, n)

    def _route(
        self, goal: SequenceGoal, here: JointState, selector: Selector, first_number: int
    ) -> tuple[JointState, ...]:
        """The states at the start and the targets that are most similar to the demonstrations.

        For poses, the configurations with the least sum of squared in-span scores are chosen, by
        dynamic programming.
        """
        known = selector.primitives.ends.reshape(-1, self.robot.n_joints)
        routes = [_Route(0.0, (here,))]
        for number, target in enumerate(goal.targets, first_number):
            if isinstance(target, Pose):
                routes = self._through(target, number, routes, known, selector)
                continue
            what = f"target {number}"
            longer = []
            for route in routes:
                positions = completed(target, route.states[-1], self.robot, what).positions
                there = JointState(here.joint_names, positions)
                check_within_limits(what, there, self.limits)
                longer.append(route.to(there, selector))
            named_all = len(target.joint_names) == self.robot.n_joints
            routes = [min(longer, key=lambda route: route.cost)] if named_all else longer
        states = min(routes, key=lambda route: route.cost).states
        for number, (a, b) in enumerate(pairwise(states[1:]), first_number):
            if np.abs(a.positions - b.positions).max() <= _SAME:
                # A segment without displacement would get an arbitrary swing from the optimiser.
                raise GoalError(
                    f"targets {number} and {number + 1} of the sequence are the same: give it once"
                )
        return states

    def _n_passed(self, goal: SequenceGoal, here: JointState) -> int:
        """The number of initial targets at the robot's position."""
        for n_passed, (target, when) in enumerate(
            zip(goal.targets[:-1], goal.times[:-1], strict=True)
        ):
            if isinstance(target, JointState):
                there = completed(target, here, self.robot, f"target {n_passed + 1}")
                missed = there.positions - here.positions
            else:
                missed = PoseTarget(self.robot, target).error(here.positions)[0]
            if np.abs(missed).max() > self._search.here:
                return n_passed
            if when is not None:
                raise GoalError(
                    f"target {n_passed + 1} of the sequence is where the robot is, and is to be "
                    f"passed at {when:g} s: to wait there, send the sequence later"
                )
        return len(goal.targets) - 1

    def _through(
        self,
        pose: Pose,
        number: int,
        routes: Sequence[_Route],
        known: FloatArray,
        selector: Selector,
    ) -> list[_Route]:
        """The best route to each of the configurations that reach a pose."""
        starts = [route.states[-1].positions for route in routes]
        starts += starts_near(self.robot, pose, known)
        try:
            found = configurations_at(self.robot, self.limits, pose, starts)
        except GoalError as error:
            raise GoalError(f"target {number}: {error}") from None
        longer = []
        for q in found[: self._search.n_route_configurations]:
            longer_routes = []
            for route in routes:
                before = route.states[-1]
                there = JointState(before.joint_names, unwrapped(q, before, self.robot))
                longer_routes.append(route.to(there, selector))
            longer.append(min(longer_routes, key=lambda route: route.cost))
        return longer

    def _check_size(self, goal: SequenceGoal) -> None:
        """Reject sequences that would exceed time or memory."""
        most = INPUT_LIMITS.targets
        if len(goal.targets) > most:
            raise GoalError(
                f"the sequence has {len(goal.targets)} targets, at most {most} are accepted"
            )
        last = max((when for when in goal.times if when is not None), default=1.0)
        self._setup.check_duration("the sequence asks for a time of", last)


@dataclass(frozen=True, eq=False)
class _Route:
    """States up to a target, and the sum of squared in-span scores between them."""

    cost: float
    states: tuple[JointState, ...]

    def to(self, there: JointState, selector: Selector) -> _Route:
        """The route continued to a state."""
        score = selector.least_score(self.states[-1].positions, there.positions)
        return _Route(self.cost + score**2, (*self.states, there))
