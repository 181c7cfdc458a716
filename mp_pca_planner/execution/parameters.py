# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The parameters of the node: one table of declarations, and their values.

The node, ``config/planner.yaml`` and the documentation are made from this table. It needs no ROS.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from ..arrays import read_values
from ..exceptions import (
    PlannerError,
    quote_names,
    shown,
    unknown_name,
)
from ..input_limits import INPUT_LIMITS
from ..planning.objectives import objective_weights
from ..planning.options import MAX_NATURALNESS, TIMINGS, PlannerOptions


def locked_positions(text: str) -> dict[str, float]:
    """Read the parameter ``locked_joints``: positions by joint [rad or m].

    Raises
    ------
    PlannerError
        If it has another form.
    """
    return read_values(text, "parameter 'locked_joints'", "joint")


def fixed_frames(texts: Sequence[str]) -> dict[str, list[float]]:
    """Read the parameter ``fixed_frames``: poses by frame, each x, y, z and a unit quaternion.

    Raises
    ------
    PlannerError
        If a text has another form.
    """
    found: dict[str, list[float]] = {}
    for text in filter(None, texts):
        name, _, numbers = (piece.strip() for piece in text.partition(":"))
        try:
            values = [float(word) for word in numbers.replace(",", " ").split()]
        except ValueError:
            values = []
        values += [0.0, 0.0, 0.0, 1.0] * (len(values) == 3)
        length = math.hypot(*values[3:])
        is_pose = len(values) == 7 and abs(length - 1.0) <= 1e-3 and math.isfinite(sum(values))
        if not name or name in found or not is_pose:
            raise PlannerError(
                f"parameter 'fixed_frames': '{text:.80}' is not accepted; expected each frame once "
                "as FRAME: X Y Z, or FRAME: X Y Z QX QY QZ QW with a quaternion of length 1"
            )
        found[name] = [*values[:3], *(value / length for value in values[3:])]
    return found


AUTO = "auto"
MEASURED = "measured"
COMMANDED = "commanded"

REFUSE = "refuse"
WARN = "warn"

_ROS_NAME = r"(~?/)?[A-Za-z_]\w*(/[A-Za-z_]\w*)*"
LIMITS_PREFIX = "limits."
_LIMIT_QUANTITIES = {
    "max_velocity": "velocity [rad/s or m/s]",
    "max_acceleration": "acceleration [rad/s² or m/s²]",
    "max_jerk": "jerk [rad/s³ or m/s³]",
    "max_effort": "torque or force [N·m or N]",
}

ParameterValue = bool | int | float | str | tuple[str, ...]


@dataclass(frozen=True)
class Declaration:
    """Declaration of a parameter.

    Attributes
    ----------
    name : str
        Its name.
    default : bool, int, float, str or tuple of str
        Its default, which also fixes its type.
    description : str
        A sentence or two about its meaning, with the unit.
    low, high : float
        Range of a number, ends included.
    choices : tuple of str
        The valid texts; empty if all texts are valid.
    """

    name: str
    default: ParameterValue
    description: str
    low: float = 0.0
    high: float = 0.0
    choices: tuple[str, ...] = ()

    @property
    def accepted(self) -> str:
        """The accepted values, for messages."""
        if isinstance(self.default, bool):
            return "true or false"
        if isinstance(self.default, float):
            return f"a number with a decimal point from {self.low:g} to {self.high:g}"
        if isinstance(self.default, tuple):
            return "a list of texts"
        return f"one of {quote_names(self.choices)}" if self.choices else "a text"

    def refusal(self, value: object) -> PlannerError:
        """The error for a value that is not accepted."""
        return PlannerError(
            f"parameter '{self.name}' is {shown(value)}, but it must be {self.accepted}"
        )


def _declared(default: ParameterValue, description: str, **accepted: Any) -> Any:
    return field(
        default=default, metadata={"description": " ".join(description.split()), **accepted}
    )


@dataclass(frozen=True)
class Settings:
    """Values of all parameters; its fields are the table of declarations.

    `limits` is not a parameter: it collects the parameters ``limits.<joint>.<quantity>``, which are
    declared when the joints are known (see :func:`limit_declarations`).

    Raises
    ------
    PlannerError
        If a text is none of the choices.
    """

    # The default is a list with an empty text, because an empty list has no type in ROS.
    primitives: tuple[str, ...] = _declared(
        ("",), "Primitive files, or folders of them (*.npz); empty texts are ignored."
    )
    robot_description: str = _declared(
        "", "URDF of the robot, XML text; empty: taken from the topic robot_description."
    )
    end_effector_frame: str = _declared(
        "",
        """Link for pose goals and for the path in the preview; empty: the last link that most
        joints move.""",
    )
    limits_file: str = _declared(
        "",
        """Joint limits in the form of MoveIt's joint_limits.yaml, with max_jerk and max_effort,
        instead of those of the URDF. Empty: none.""",
    )
    collision: bool = _declared(
        True,
        "Enables self-collision avoidance, where the robot description has collision shapes.",
    )
    locked_joints: str = _declared(
        "",
        """Positions of joints that the primitives do not move, name=value,… [rad or m], for those
        that joint_states lacks. Goals are rejected while a position that makes a difference is
        unknown.""",
    )
    fixed_frames: tuple[str, ...] = _declared(
        ("",),
        """Poses of frames of obstacles and pose goals that tf2 does not have, such as 'map: 0 0
        -0.8' (FRAME: X Y Z, or FRAME: X Y Z QX QY QZ QW) in the base frame of the robot [m].""",
    )
    unplaced_obstacles: str = _declared(
        REFUSE,
        """What an obstacle in an unknown frame does: 'refuse' (goals are rejected) or 'warn' (it is
        not avoided, and reports say so).""",
        choices=(REFUSE, WARN),
    )
    obstacle_margin: float = _declared(
        0.01,
        "Least clearance from the obstacles of ~/obstacles [m]: what is nearer is a collision.",
        high=10.0,
    )
    srdf: str = _declared(
        "",
        """SRDF file with the pairs of links that are not checked for self-collision; empty:
        neighbours, and pairs in contact in the neutral configuration.""",
    )
    package_dirs: tuple[str, ...] = _declared(
        ("",),
        "Folders of the packages with the meshes of the robot description, before those of ROS.",
    )
    start_from: str = _declared(
        AUTO,
        """Start of a motion: 'auto' (the commanded state of a robot on a motion of this node, else
        the measured one at rest), 'measured' (always; goals are rejected while the robot moves) or
        'commanded' (same as 'auto').""",
        choices=(AUTO, MEASURED, COMMANDED),
    )
    controller_state_topic: str = _declared(
        "",
        """Topic on which the controller states its command
        (control_msgs/JointTrajectoryControllerState), used where control_msgs is installed. Empty:
        'controller_state' beside the topic of trajectories.""",
    )
    controller_action: str = _declared(
        "",
        """Action of the controller (control_msgs/FollowJointTrajectory) that motions are sent to,
        for example 'arm_controller/follow_joint_trajectory'; empty: they are sent on the topic
        alone. Unless the same controller listens to it, the topic gets a copy.""",
    )
    stamp_trajectories: bool = _declared(
        True,
        """Stamps trajectories with the time of their first point, so that the delay of a message
        causes no jump; a motion from rest begins with a hold of 20 ms. Not applied where the stamps
        of joint_states show that the clocks of robot and node differ.""",
    )
    following_tolerance: float = _declared(
        0.02,
        """Largest distance [rad or m] of a joint from where the published motion was in the last
        `servo_lag` seconds at which the robot counts as following it.""",
        low=1e-4,
        high=10.0,
    )
    servo_lag: float = _declared(
        0.1,
        "Longest time [s] by which the drives of the robot lag behind their commands.",
        high=1.0,
    )
    state_timeout: float = _declared(
        0.5,
        "Age [s] above which the newest joint_states is too old to plan from; 0: no limit.",
        high=3600.0,
    )
    duration: float = _declared(
        0.0,
        """Duration of motions to a single goal [s]; 0: by the parameter timing. Longer if the
        limits require it.""",
        high=INPUT_LIMITS.duration,
    )
    naturalness: float = _declared(
        -1.0,
        """Cost of a motion one standard deviation away from the demonstrations, as a share of the
        predicted motion's effort; 0: least effort alone. Below 0: 1 for goals like the
        demonstrations, (3 / score)³ for in-span scores above 3.""",
        low=-1.0,
        high=MAX_NATURALNESS,
    )
    max_in_span_score: float = _declared(
        PlannerOptions.max_in_span_score,
        """Largest accepted in-span score, the distance of a goal and its start from the
        demonstrations (about 1 is usual, above 3 is unlike them). 0: none.""",
        high=1e6,
    )
    demonstrated_margin: float = _declared(
        PlannerOptions.demonstrated_margin,
        """Largest velocities and accelerations of motions from rest, as multiples of the
        demonstrated ones of each joint. Timing 'shortest' and 'free' keep this for accelerations
        without a limit only. 0: only the limits.""",
        high=1e6,
    )
    objective: str = _declared(
        "effort",
        """Weighted sum to minimise, NAME=WEIGHT,…, of effort, energy, jerk, time and straightness
        (of the path of the end effector); a name alone has the weight 1.""",
    )
    constraints: str = _declared(
        "",
        """Constraints on every configuration, NAME=VALUE;…: upright=FRAME,DEGREES keeps the z axis
        of a frame within an angle of the vertical (upright=FRAME,DEGREES,X,Y,Z: that axis).""",
    )
    timing: str = _declared(
        PlannerOptions.timing,
        """Duration of motions for which none is given: 'demonstrated', 'shortest', 'free' (of least
        cost), or 'auto' (demonstrated; free, but not slower, for in-span scores above 3 and for
        detours). Sequences are timed as demonstrated.""",
        choices=TIMINGS,
    )
    max_solve_time: float = _declared(
        PlannerOptions.max_solve_time,
        "Longest time for the optimisation [s]; the best motion found by then is used.",
        low=1e-3,
        high=3600.0,
    )
    sample_period: float = _declared(
        PlannerOptions.sample_period,
        "Longest time between points of a trajectory [s].",
        low=1e-3,
        high=1.0,
    )
    publish_effort: bool = _declared(
        False,
        """Publishes efforts with each point; a controller without an effort interface rejects such
        a trajectory.""",
    )
    allow_nonzero_end_velocity: bool = _declared(
        False,
        """Accepts goals with a velocity at the end, which the controller needs to allow, too
        (allow_nonzero_velocity_at_trajectory_end).""",
    )
    save_folder: str = _declared(
        "",
        "Folder for the primitive files of ~/save_motion; empty: motions can't be saved.",
    )
    limits: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for declaration in DECLARATIONS:
            value = getattr(self, declaration.name)
            if declaration.choices and value not in declaration.choices:
                raise declaration.refusal(value)
        objective_weights(self.objective, "parameter 'objective'")
        fixed_frames(self.fixed_frames)
        locked_positions(self.locked_joints)
        # Checked without `collision`, too, which may be set later.
        if self.srdf and not os.path.isfile(self.srdf):
            raise PlannerError(f"parameter 'srdf': there is no file '{self.srdf:.200}'")
        for folder in filter(None, self.package_dirs):
            if not os.path.isdir(folder):
                raise PlannerError(f"parameter 'package_dirs': there is no folder '{folder:.200}'")
        for name in ("controller_state_topic", "controller_action"):
            given = getattr(self, name)
            if given and not re.fullmatch(_ROS_NAME, given, re.ASCII):
                raise PlannerError(
                    f"parameter '{name}' is '{given:.200}', expected a name of ROS such as "
                    "'arm_controller/controller_state'"
                )
            if given and find_spec("control_msgs") is None:
                raise PlannerError(
                    f"parameter '{name}' is set, but the package control_msgs is not installed: "
                    "install ros-jazzy-control-msgs, or leave the parameter empty"
                )

    @classmethod
    def from_values(cls, values: Mapping[str, Any]) -> Settings:
        """Make settings of parameter values by name, those of ``limits.…`` included.

        Values must have the types of their declarations.
        """
        own = {d.name: values[d.name] for d in DECLARATIONS if d.name in values}
        own |= {name: tuple(value) for name, value in own.items() if isinstance(value, list)}
        limits: dict[str, dict[str, float]] = {}
        for name, value in values.items():
            # 0 stands for the limit of the limits file or the URDF.
            if name.startswith(LIMITS_PREFIX) and value != 0.0:
                joint, quantity = split_limit_name(name)
                limits.setdefault(joint, {})[quantity] = value
        return cls(**own, limits=limits)

    @property
    def primitive_paths(self) -> tuple[str, ...]:
        """The given files and folders of primitives."""
        return tuple(path for path in self.primitives if path)

    @property
    def package_folders(self) -> tuple[Path, ...]:
        """The given folders of packages."""
        return tuple(Path(path) for path in self.package_dirs if path)

    @property
    def planner_options(self) -> PlannerOptions:
        """The options of the planner, without objectives and constraints, which need a robot."""
        names = {f.name for f in fields(PlannerOptions)} & {d.name for d in DECLARATIONS}
        names.remove("constraints")  # a text here
        values = {name: getattr(self, name) for name in names}
        if self.naturalness < 0.0:
            values["naturalness"] = None
        return PlannerOptions(**values)


DECLARATIONS: tuple[Declaration, ...] = tuple(
    Declaration(f.name, f.default, **f.metadata)
    for f in fields(Settings)
    if f.default is not MISSING
)
"""All parameters except limits.<joint>.<quantity>."""


def limit_declarations(joint_names: Sequence[str]) -> tuple[Declaration, ...]:
    """Declare the limits of each joint."""
    text = "Largest {} of joint '{}'; 0: as in the limits file or the URDF."
    return tuple(
        Declaration(f"{LIMITS_PREFIX}{joint}.{name}", 0.0, text.format(what, joint), high=1e9)
        for joint in joint_names
        for name, what in _LIMIT_QUANTITIES.items()
    )


def split_limit_name(name: str) -> tuple[str, str]:
    """Return joint and quantity of a parameter ``limits.<joint>.<quantity>``.

    Raises
    ------
    PlannerError
        If the name has another form.
    """
    joint, _, quantity = name.removeprefix(LIMITS_PREFIX).rpartition(".")
    if not joint or quantity not in _LIMIT_QUANTITIES:
        raise PlannerError(
            f"unknown parameter '{name}': expected limits.<joint>.<quantity> with one of the "
            f"quantities {quote_names(_LIMIT_QUANTITIES)}"
        )
    return joint, quantity


def check_limit_names(names: Iterable[str], joint_names: Sequence[str]) -> None:
    """Check that limits are named after joints of the primitives.

    Raises
    ------
    PlannerError
        If a name that starts with ``limits.`` doesn't name one of the joints and a quantity.
    """
    for name in names:
        if name.startswith(LIMITS_PREFIX):
            joint, _ = split_limit_name(name)
            if joint not in joint_names:
                raise PlannerError(
                    f"parameter '{name}' can't be used: "
                    f"{unknown_name('joint of the primitives', joint, joint_names)}"
                )
