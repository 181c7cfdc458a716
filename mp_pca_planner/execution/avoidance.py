# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Avoidance of obstacles that come while the robot moves, and the way on after a stop."""

from __future__ import annotations

from ..exceptions import PlannerError
from .assembly import Model
from .goal_planner import GoalRequest
from .motion_server import MotionServer
from .preemptive_worker import CancelledError, IsCancelled
from .served_goal import Served


def avoid_obstacle(
    server: MotionServer, model: Model, is_cancelled: IsCancelled
) -> tuple[str, Served | None]:
    """Replace the running motion if it would hit an obstacle; stop the robot if that fails.

    Call this in the thread that serves goals.

    Parameters
    ----------
    server : MotionServer
        Serves the goals of the motions.
    model : Model
        The planner and its settings.
    is_cancelled : callable
        Whether a newer goal came.

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
    states, options = server.states, server.options
    served, threat = server.served, server.surroundings.threat
    if served is None or threat is None:
        return "", None
    last, reason = threat.last_time(options), threat.reason

    def is_over() -> bool:
        return is_cancelled() or states.motion_time > last

    goal = served.rest_of_goal(states.motion_time - served.motion.began)
    try:
        if is_over():
            raise CancelledError
        request = GoalRequest(goal, model, served.name)
        found = server.serve(request, is_over, lookahead=options.avoidance_lookahead)
    except Exception as error:  # whatever the reason, the robot must not hit the obstacle
        if is_cancelled():
            raise CancelledError from None
        why = str(error) or "there was no time to plan another motion"
        return f"{reason}: {server.stop_before(threat, model)}, because {why}", None
    return f"{reason}: another motion leads to the goal", found


def go_on(
    server: MotionServer, model: Model, is_cancelled: IsCancelled
) -> tuple[str, Served | None]:
    """Go on to the goal of a motion that was stopped before an obstacle, if it is due.

    Call this in the thread that serves goals.

    Parameters
    ----------
    server, model, is_cancelled :
        See :func:`avoid_obstacle`.

    Returns
    -------
    message : str
        What was done, one sentence; empty if there is nothing to do.
    served : Served or None
        The new motion, if there is one.

    Raises
    ------
    CancelledError
        If a newer goal preempts it.
    """
    resumption = server.resumption
    if resumption is None:
        return "", None
    resumption.tried, resumption.world = server.states.motion_time, server.surroundings.world
    try:
        request = GoalRequest(resumption.goal, model, resumption.name)
        return "the robot goes on to its goal", server.serve(request, is_cancelled)
    except PlannerError as error:
        return f"the robot waits before an obstacle: {error}", None
