# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Execution of motions on a robot, without ROS.

Times are in seconds on the clock of the controller unless stated otherwise. A *place* is a time
on a motion, from 0 at its start. A robot on time is at the place given by the clock; a slowed or
held one lags behind it. The *rate* is the derivative of the place by time.

Joint states are kept in :mod:`.states`. Where the robot is on which of the :mod:`.motions`, and
where the next one starts, is decided in :mod:`.tracking`. A goal, from its arrival to its motion,
is followed in :mod:`.server`, which stops the robot with the stops of :mod:`.stopping` and reports
the :mod:`.outcomes`. Plans are made in :mod:`.planning`, and the running motion is checked against
new obstacles in :mod:`.watching`, in processes of their own; :mod:`.link` is what they say to each
other.
"""
