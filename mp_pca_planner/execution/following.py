# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""How a robot follows the motion that was published last, and the parameters of that judgement."""

from __future__ import annotations

from dataclasses import dataclass, field

from ..exceptions import TrajectoryError
from .measured import MeasuringOptions
from .published_motion import PublishedMotion
from .servo import ServoOptions
from .tracking import Progress, TrackingOptions

ON_TIME, LAGGING, HELD, OFF = "on_time", "lagging", "held", "off"
"""The robot is at its place by the clock, moves along the path behind that place, rests short of
the end of the motion, or is away from the path."""


class UnconfirmedError(TrajectoryError):
    """The place of the robot on the motion that was published last is not known yet."""


@dataclass(frozen=True)
class FollowingOptions:
    """Thresholds of how a robot follows its motion.

    The values were tuned in campaigns of benchmarks/moving_robot.py. Distances are the largest of
    all joints [rad or m].

    Attributes
    ----------
    cycle : float
        Cycle of the controller, by which commands are ahead of their time at any rate [s].
    on_time_distance, on_time_rate : float
        A robot is on time if its commanded position differs less from that of the clock, or if
        its rate differs less from 1 and its lag is one of servos.
    start_distance, start_time : float
        The same distance in this time after a motion from rest was published [s]: a robot starts
        so slowly that servo errors look like a lag. By then it is seen to move.
    taken_distance : float
        Distance between the newest motion and the one before at which the robot's position shows
        that the newest one was taken.
    refused_distance, refused_rest_distance : float
        Distance from the newest motion at which a robot in motion, or at rest, shows that the
        newest one was not taken.
    same_distance : float
        Distance between both motions that makes no difference.
    load_lag : float
        Change of the servo lag that an unknown load may cause [s].
    max_age : float
        Age of the newest state up to which a motion may be continued [s].
    precision, max_change : float
        A lagging robot's motion is continued if its place is known to this distance, beside the
        noise, and its rate changes more slowly [1/s].
    missed_distance : float
        A robot that rests farther from the end of its motion has left it, whatever its load.
    beside_share : float
        A robot that rests short of the end is this near to its path, as a share of the distance
        left. An unknown load pulls it away from the end in any direction.
    min_rate : float
        Rate below which a robot is being stopped by something else.
    visible_time : float
        Time after publishing from which states show the motion [s].
    start_tolerance : float
        Distance that a robot at rest may move between the choice of a start and publishing. It
        bounds the jump that the controller has to absorb.
    full_rate : float
        Difference from 1 up to which a rate is that of the clock.
    lead : float
        Part of a motion that is kept when another one continues it [s].
    measuring, tracking, servo :
        Parameters of the parts.
    """

    cycle: float = 0.001
    on_time_distance: float = 5e-4
    on_time_rate: float = 0.07
    start_distance: float = 0.002
    start_time: float = 0.5
    taken_distance: float = 0.0015
    refused_distance: float = 0.006
    refused_rest_distance: float = 4e-4
    same_distance: float = 1.5e-4
    load_lag: float = 0.003
    max_age: float = 0.1
    precision: float = 1e-4
    max_change: float = 0.5
    missed_distance: float = 0.02
    beside_share: float = 0.15
    min_rate: float = 0.05
    visible_time: float = 0.05
    start_tolerance: float = 0.005
    full_rate: float = 0.01
    lead: float = 0.35
    measuring: MeasuringOptions = field(default_factory=MeasuringOptions)
    tracking: TrackingOptions = field(default_factory=TrackingOptions)
    servo: ServoOptions = field(default_factory=ServoOptions)


@dataclass(frozen=True, eq=False)
class Following:
    """How a robot follows the motion that was published last.

    Attributes
    ----------
    motion : PublishedMotion
        That motion.
    how : {'on_time', 'lagging', 'held', 'off'}
        How the robot follows it.
    progress : Progress
        The place of its command.
    distance : float
        Largest distance of a joint from there [rad or m].
    joint : str
        The joint with that distance.
    at_rest : bool
        Whether the robot rests.
    """

    motion: PublishedMotion
    how: str
    progress: Progress
    distance: float
    joint: str
    at_rest: bool

    @property
    def is_over(self) -> bool:
        """Whether the robot holds the end of the motion."""
        return self.how == ON_TIME and self.progress.place >= self.motion.duration

    @property
    def is_running(self) -> bool:
        """Whether the robot moves along the motion."""
        return self.how in (ON_TIME, LAGGING) and not self.is_over


def check_continuable(following: Following, is_path_known: bool, min_rate: float) -> None:
    """Raise an `UnconfirmedError` if the robot is being stopped."""
    if following.how == LAGGING and following.progress.rate < min_rate:
        raise UnconfirmedError(
            "the robot comes to rest short of the end of its motion; send the goal again when it "
            "is at rest"
        )
    if not is_path_known:
        raise UnconfirmedError(
            "the robot is being stopped by a single point, so its path is not known; send the goal "
            "again when it is at rest"
        )


def check_place(following: Following, age: float, noise: float, options: FollowingOptions) -> None:
    """Raise an `UnconfirmedError` if the place of a moving robot is not known precisely.

    Parameters
    ----------
    following : Following
        How the robot follows its motion.
    age : float
        Age of the newest state [s].
    noise : float
        Noise of measured positions [rad or m].
    options : FollowingOptions
        Thresholds.
    """
    if age > options.max_age:
        raise UnconfirmedError(
            f"the newest joint_states message is {age:.3g} s old, at most {options.max_age:g} s is "
            "accepted while the robot moves; send the goal again"
        )
    progress = following.progress
    is_precise = progress.error <= options.precision + noise
    is_steady = abs(progress.change) <= options.max_change
    if following.how == LAGGING and not (is_precise and is_steady):
        raise UnconfirmedError(
            "the speed of the robot changes (speed scaling), so its place on the motion is not "
            "known precisely; send the goal again"
        )
