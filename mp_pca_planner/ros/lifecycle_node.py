# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The planner as a managed node, which loads primitives and serves goals when it is told to."""

from __future__ import annotations

from rclpy.lifecycle import LifecycleNodeMixin, LifecycleState, TransitionCallbackReturn

from ..exceptions import GoalError
from ..execution.assembly import Model
from .node import PlannerNode


class LifecyclePlannerNode(LifecycleNodeMixin, PlannerNode):
    """A `PlannerNode` that loads primitives when configured and publishes motions when active.

    Its topics are there in every state: goals that come while it isn't active are refused in
    ``~/plan_report``.
    """

    def __init__(self) -> None:
        self._is_active = False
        PlannerNode.__init__(self)
        LifecycleNodeMixin.__init__(self)

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Load the primitives; it fails if they can't be used."""
        self._primitives_problem = ""
        super()._load()
        if self._primitives_problem:
            return TransitionCallbackReturn.FAILURE
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Serve goals from now on."""
        self._is_active = True
        self._log_readiness()
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Give up what is planned, and serve no more goals; a motion that runs goes on."""
        self._rest()
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Forget the primitives."""
        self._adopt(())
        return super().on_cleanup(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """As `on_deactivate`, for good."""
        self._rest()
        return super().on_shutdown(state)

    def _rest(self) -> None:
        self._is_active = False
        self._goals.cancel()

    def _load(self) -> None:
        """Nothing is loaded before the node is configured."""

    def _ready_model(self) -> Model:
        if not self._is_active:
            raise GoalError(self._what_is_missing())
        return super()._ready_model()

    def _what_is_missing(self) -> str:
        if not self._is_active:
            return "the node is not active: it is configured and activated by ~/change_state"
        return super()._what_is_missing()
