# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Execution of motions on a robot, without ROS.

Times are in seconds on the clock of the controller unless stated otherwise. A *place* is a time
on a motion, from 0 at its start. A robot on time is at the place given by the clock; a slowed or
held one lags behind it. The *rate* is the derivative of the place by time.

A joint state, from its message to the stop, is followed in :mod:`.tracking`: :mod:`.measured` keeps
it, :mod:`.following` finds where on its motion the robot is, and :mod:`.start_state` chooses where
the next motion starts. A goal, from its arrival to its motion, is followed in :mod:`.serving`:
:mod:`.motion_server` is the entry point and plans, :mod:`.motion_monitor` publishes, watches and
stops with the stops of :mod:`.stopping`, and :mod:`.execution` reports outcomes.
"""
