# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Avoidance of obstacles that come while the robot moves."""

from __future__ import annotations

from ..robot.world import World
from .assembly import Model
from .motion_server import MotionServer
from .options import ServingOptions
from .preemptive_worker import CancelledError, IsCancelled
from .served_goal import Served
from .start_state import StartStates


class ObstacleAvoidance:
    """Replaces a motion that would hit a new obstacle, or stops the robot.

    Parameters
    ----------
    server :
        Serves the goals of the motions.
    states :
        The clock of motions.
    options :
        Parameters.

    Attributes
    ----------
    missing : str
        Why an obstacle that was given is not avoided; empty if all are.
    """

    def __init__(
        self, server: MotionServer, states: StartStates, options: ServingOptions | None = None
    ) -> None:
        self._server, self._states = server, states
        self._options, self.missing = options or ServingOptions(), ""

    @property
    def world(self) -> World:
        """The obstacles around the robot."""
        return self._server.surroundings.world

    def replace_world(self, world: World, model: Model | None) -> bool:
        """Use other obstacles; return whether the running motion would hit one of them.

        Goals are planned among the new obstacles from now on. If a motion would hit one, call
        :meth:`avoid` in the thread that serves goals.

        Raises
        ------
        PlannerError
            If they can't be used, see :meth:`.Surroundings.replace`.
        """
        surroundings = self._server.surroundings
        surroundings.replace(world, model)
        if model is not None:
            surroundings.look_ahead(model, self._server.served)
        return self.is_needed

    @property
    def is_needed(self) -> bool:
        """Whether the running motion would hit an obstacle that was not there before."""
        return self._server.surroundings.threat is not None

    def avoid(self, model: Model, is_cancelled: IsCancelled) -> tuple[str, Served | None]:
        """Replace the running motion if it would hit an obstacle; stop the robot if that fails.

        Returns
        -------
        message : str
            What was done, one sentence; empty if there is nothing to avoid.
        served : Served or None
            The new motion, if there is one.

        Raises
        ------
        PlannerError
            If the robot could not even be stopped.
        CancelledError
            If a newer goal preempts it.
        """
        server, surroundings = self._server, self._server.surroundings
        served, reason = server.served, surroundings.reason
        if served is None or not reason:
            return "", None
        last = surroundings.threat_time - self._options.avoidance_reserve

        def is_over() -> bool:
            return is_cancelled() or self._states.motion_time > last

        goal = served.rest_of_goal(self._states.motion_time - served.motion.began)
        try:
            if is_over():
                raise CancelledError
            found = server.serve(
                type(goal),
                lambda _: goal,
                model,
                is_over,
                served.name,
                lookahead=self._options.avoidance_lookahead,
            )
        except Exception as error:  # whatever the reason, the robot must not hit the obstacle
            if is_cancelled():
                raise CancelledError from None
            why = str(error) or "there was no time to plan another motion"
            return f"{reason}: {server.stop(model, reason)}, for {why}", None
        return f"{reason}: another motion leads to the goal", found
