# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Execution of motions on a robot, without ROS.

The present and the commanded state, joining a running motion, stopping, monitoring, and trials.
Times are in seconds on the clock of the controller unless they say otherwise. A *place* is a time
on a motion, from 0 at its start: a robot that runs on time is at the place that the clock says, a
slowed or held one behind it.
"""
