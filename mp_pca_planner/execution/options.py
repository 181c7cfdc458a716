# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Constants of tracking, serving and stopping, with their units.

The values were tuned in campaigns of moving robots. Distances are the largest of all
joints [rad or m].
"""

from __future__ import annotations


class Tracking:
    """Constants of the estimation, from measured states, of how a robot follows its motion.

    Attributes
    ----------
    rest_velocity : float
        Reported velocity up to which a robot is at rest [rad/s or m/s]: the noise of encoders.
    rest_slope : float
        The same for the slope of positions over the window, which has less noise.
    clear_velocity : float
        Reported velocity above any noise: the robot counts as moving, independently of its
        positions.
    spacing, window : float
        Shortest time between the states that are kept, and how long they are kept [s].
    min_span : float
        Time that positions must span to give a velocity [s].
    rest_spread : float
        Change of a position over the window up to which a joint may be at rest: two publishers
        that disagree may change it without a slope.
    max_step, max_speed : float
        States contradict each other if a position changes by more than this step and this speed
        [rad/s or m/s] explain.
    max_reversal, max_acceleration : float
        They also do if it changes back and forth by more than this distance and this acceleration
        [rad/s² or m/s²] explain.
    max_disagreement : float
        Two publishers contradict each other if their positions of the same time differ by more
        than this distance and this acceleration explain.
    max_stamp_delay, max_stamp_lead : float
        Stamps that usually lie further behind their receipt, or further ahead of it, show that the
        clocks of the robot and of this computer differ [s].
    stamp_spacing, min_stamps, max_stamps : float, int, int
        Shortest time between stamps that are compared [s], and the fewest that show a constant
        difference. So many are remembered.
    position_noise : float
        Standard deviation of measured positions in the estimation of the place, > 0.
    prior : tuple of four floats
        Standard deviations of its prior, > 0: of the place [s], the rate [1], the change of the
        rate [1/s], and the change of that change [1/s²].
    max_rate : float
        Largest rate of a robot, > 1.
    n_newest : int
        Samples that the error of an estimated place is averaged over, ≥ 1.
    good_error : float
        Error above which the newer half of the window is fitted alone: the rate may have changed
        too fast for one fit.
    servo_memory : float
        Time for which older values of the servo model are kept [s]: a lag is detected late, and the
        values learned in the meantime are discarded.
    servo_time : float
        Time constant with which the offset of the servos is learned, > 0 [s].
    lag_share : float
        Speed of learning the lag as a share of that of the offset, 0 to 1.
    slow : float
        Speed below which an offset along the path looks like a lag [rad/s or m/s].
    lag_noise : float
        How much longer than learned the lag of a robot on time may be [s].
    initial_lag : float
        Lag before anything was learned [s]: arms lag by some milliseconds.
    max_lag : float
        Largest lag of servos and messages together [s]; a robot that lags more is late.
    cycle : float
        Cycle of the controller [s]; commands are ahead of time by one cycle at any rate.
    on_time_distance, on_time_rate : float
        A robot is on time if its commanded position differs less from that of the clock. It is also
        on time if its rate differs less from 1 and its lag is a plausible servo lag.
    start_distance, start_time : float
        The same distance during this time [s] after a motion from rest was published. A robot
        starts so slowly that servo errors look like a lag; after this time its motion is visible.
    taken_distance : float
        Distance between the newest motion and the one before at which the robot's position shows
        that the newest one was taken.
    refused_distance, refused_rest_distance : float
        Distance from the newest motion at which a robot in motion, or at rest, shows that the
        newest one was not taken.
    same_distance : float
        Distance below which both motions count as the same.
    load_lag : float
        Change of the servo lag that an unknown load may cause [s].
    max_age : float
        Age of the newest state up to which a motion may be continued [s].
    precision, max_change : float
        A lagging robot's motion is continued if its place is known to this distance, beside the
        noise, and its rate changes more slowly [1/s].
    missed_distance : float
        A robot that rests farther from the end of its motion has left it, for any plausible load.
    missed_stop_distance : float
        The same distance for a stop at a single point. A controller that is deactivated during the
        stop holds a position somewhere short of the point.
    beside_share : float
        A robot that rests short of the end is this near to its path, as a share of the distance
        left. An unknown load pulls it away from the end in any direction.
    min_rate : float
        Rate below which the robot counts as being stopped by something else.
    visible_time, late_start : float
        Time after publishing from which states show the motion [s], and the same for a motion from
        rest, whose message may be late.
    start_tolerance : float
        Distance that a robot at rest may move between the choice of a start and publishing. It
        bounds the jump that the controller has to absorb.
    full_rate : float
        Difference from 1 up to which a rate is that of the clock.
    lead : float
        Part of a motion that is retained when another one continues it [s].
    """

    rest_velocity = 0.01
    rest_slope = 0.003
    clear_velocity = 0.1
    spacing = 0.008
    window = 0.3
    min_span = 0.08
    rest_spread = 0.005
    max_step = 0.05
    max_speed = 10.0
    max_reversal = 0.004
    max_acceleration = 50.0
    max_disagreement = 5e-4
    max_stamp_delay = 0.1
    max_stamp_lead = 0.005
    stamp_spacing = 0.02
    min_stamps = 20
    max_stamps = 250
    position_noise = 0.002
    prior = (1.0, 0.3, 2.0, 40.0)
    max_rate = 1.2
    n_newest = 5
    good_error = 3e-5
    servo_memory = 0.35
    servo_time = 0.2
    lag_share = 0.2
    slow = 0.1
    lag_noise = 0.005
    initial_lag = 0.002
    max_lag = 0.1
    cycle = 0.001
    on_time_distance = 5e-4
    on_time_rate = 0.07
    start_distance = 0.002
    start_time = 0.5
    taken_distance = 0.0015
    refused_distance = 0.006
    refused_rest_distance = 4e-4
    same_distance = 1.5e-4
    load_lag = 0.003
    max_age = 0.1
    precision = 1e-4
    max_change = 0.5
    missed_distance = 0.02
    missed_stop_distance = 0.005
    beside_share = 0.15
    min_rate = 0.05
    visible_time = 0.05
    late_start = 1.0
    start_tolerance = 0.005
    full_rate = 0.01
    lead = 0.35


class Serving:
    """Constants of serving goals, continuing and stopping motions, and monitoring their execution.

    Attributes
    ----------
    max_attempts : int
        Times that a motion is planned if the robot has moved past its start, ≥ 1. Each time, the
        start is twice as far ahead as the last planning took. A stop is found as many times, if
        each takes too long.
    max_lookahead : float
        Longest time that a joint goal is planned ahead [s]; by then, a displaced motion is
        published.
    latency_margin, initial_latency : float
        Expected time from choosing a start to publishing, as a multiple of the 90th percentile of
        the latest ones, and before the first one [s].
    publishing_time : float
        Part of the time for planning that is left for the checks before publishing [s].
    confirmation_timeout, confirmation_period : float
        Longest time to wait until states show that the last motion was taken, and the time
        between these checks [s].
    late_states : float
        Age of the newest joint states up to which a goal waits for newer ones [s]: a machine may
        have stalled.
    near, near_at_rest : float
        Change of the goal up to which a motion is displaced without planning, while it runs and
        at its end.
    stop_latency, longest_stop_latency : float
        Time to find a stop, from whose end on it begins [s]. Where that takes longer, the next one
        begins twice as long from now, and at most so long.
    max_stops, clearance_time : int, float
        Number of stops that are checked for collisions at most, ≥ 1, and time after which no
        further one is [s].
    acceleration_share, jerk_share : float
        Shares of the limits for stops of a robot whose velocity is estimated, 0 to 1.
    away_time : float
        Time away from the path after which a motion is not followed [s].
    start_delay, left_start, slowest_rate : float
        Time at rest at the start after which a motion never started [s], and the distance at
        which a joint has left the start, if a robot at this rate had left it.
    avoidance_lookahead : float
        Least time that a motion around a new obstacle is planned ahead [s].
    avoidance_reserve : float
        Time before a collision with a new obstacle at which the search for another motion ends, and
        the robot is stopped [s].
    max_hold : float
        Time at rest on the path before the end, or without states after the end, after which a
        motion counts as not followed [s].
    """

    max_attempts = 3
    max_lookahead = 0.25
    latency_margin = 1.5
    initial_latency = 0.1
    publishing_time = 0.02
    confirmation_timeout = 1.5
    confirmation_period = 0.01
    late_states = 1.5
    near = 0.15
    near_at_rest = 0.03
    stop_latency = 0.02
    longest_stop_latency = 0.1
    max_stops = 8
    clearance_time = 0.01
    acceleration_share = 0.7
    jerk_share = 0.5
    away_time = 0.2
    start_delay = 1.0
    left_start = 0.006
    slowest_rate = 0.1
    avoidance_lookahead = 0.15
    avoidance_reserve = 0.6
    max_hold = 10.0
