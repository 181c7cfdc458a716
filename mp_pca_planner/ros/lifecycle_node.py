# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The planner as a managed node, which loads primitives and serves goals on request."""

from __future__ import annotations

from rclpy.lifecycle import LifecycleNodeMixin, LifecycleState, TransitionCallbackReturn

from .node import PlannerNode

_INACTIVE = "the node is not active: configure and activate it with ~/change_state"


class LifecyclePlannerNode(LifecycleNodeMixin, PlannerNode):
    """A `PlannerNode` that loads primitives when configured and publishes motions when active.

    Its topics exist in every state: goals that arrive while it is not active are rejected in
    ``~/plan_report``.
    """

    def __init__(self) -> None:
        PlannerNode.__init__(self, hold=_INACTIVE)
        LifecycleNodeMixin.__init__(self)

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Load the primitives; it fails if they can't be used."""
        return super().on_configure(state) if self.load() else TransitionCallbackReturn.FAILURE

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Serve goals from now on."""
        self.accept_goals()
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Cancel goals and reject further ones; a running motion continues."""
        self.reject_goals(_INACTIVE)
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Drop the primitives."""
        self._setup.unload()
        return super().on_cleanup(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Reject goals permanently."""
        self.reject_goals(_INACTIVE)
        return super().on_shutdown(state)
