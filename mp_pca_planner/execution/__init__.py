# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Execution of motions on a robot, without ROS.

Measured and commanded states, replacement of a running motion, stops, monitoring, and trials.
Times are in seconds on the clock of the controller unless stated otherwise. A *place* is a time
on a motion, from 0 at its start. A robot on time is at the place given by the clock; a slowed or
held one lags behind it. The *rate* is the derivative of the place by time.

:mod:`.motion_server` is the entry point. :mod:`.motion_follower` estimates how the robot follows
its motion, :mod:`.start_state` chooses where the next one starts, :mod:`.goal_planner` plans it,
:mod:`.stopping` finds stops, and :mod:`.execution_monitor` reports outcomes.
"""
