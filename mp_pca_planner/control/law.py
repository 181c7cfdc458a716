# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The control law paired with a primitive ([P] Fig. 1, block 2), and sentences on it.

With the error e = q_d − q of the motion q_d and the model's M, h and inverse dynamics τ_d of it:

    feed-forward with PD    τ = τ_d + K_p e + K_d ė
    computed torque         τ = M(q) (q̈_d + K_p e + K_d ė) + h(q, q̇)

Siciliano et al., "Robotics: Modelling, Planning and Control", 2009, sections 8.5 and 8.6.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..arrays import (
    FloatArray,
    by_name,
    check_number,
    frozen_array,
    name_values,
    set_frozen,
    unique_names,
)
from ..exceptions import ControlError, PrimitiveError, quote_names, unknown_name
from ..motion.trajectory import Trajectory
from ..primitives.primitive import MovementPrimitive
from ..robot.model import Robot

FEEDFORWARD_PD, COMPUTED_TORQUE = "feedforward_pd", "computed_torque"
KINDS = (FEEDFORWARD_PD, COMPUTED_TORQUE)

_KEY, _KNOWN = "control_law", "known"
STATEMENT = "statement"
"""Key of the sentence on an error bound, among what is known of a law."""


@dataclass(frozen=True, eq=False)
class ControlLaw:
    """A law and its gains, the same all along a motion.

    Attributes
    ----------
    kind : {'feedforward_pd', 'computed_torque'}
        Which law, see the module.
    joint_names : tuple of str
        The n_joints joints.
    position_gains : array, shape (n_joints,)
        Diagonal of K_p, positive: [N·m/rad] for feed-forward with PD, [1/s²] for computed torque.
    velocity_gains : array, shape (n_joints,)
        Diagonal of K_d, positive: [N·m·s/rad] or [1/s].

    Raises
    ------
    ControlError
        If the kind is unknown, lengths differ or a gain is not positive.
    """

    kind: str
    joint_names: tuple[str, ...]
    position_gains: FloatArray
    velocity_gains: FloatArray

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise ControlError(unknown_name("control law", self.kind, KINDS))
        names = unique_names(self.joint_names, "joints of a control law", ControlError)
        set_frozen(self, joint_names=names)
        for field in ("position_gains", "velocity_gains"):
            gains = frozen_array(getattr(self, field), (len(names),), field, ControlError)
            if not np.all(gains > 0.0):
                joint = names[int(gains.argmin())]
                raise ControlError(
                    f"{field} must be positive, got {gains.min():g} for joint '{joint}'"
                )
            set_frozen(self, **{field: gains})

    @classmethod
    def from_frequency(
        cls,
        kind: str,
        robot: Robot,
        motion: Trajectory,
        natural_frequency: float,
    ) -> ControlLaw:
        """Gains that give every joint a natural frequency and a damping ratio of 1.

        Parameters
        ----------
        kind : {'feedforward_pd', 'computed_torque'}
            The law. With computed torque the joints are decoupled. With PD each joint counts
            alone: its inertia is the geometric mean of that with the other joints held and that
            with them free, averaged along the motion.
        robot : Robot
            The model.
        motion : Trajectory
            The motion along which the inertias are computed.
        natural_frequency : float
            ω [rad/s].

        Raises
        ------
        ControlError
            If the frequency is no positive number.
        RobotError
            If gains are torques, and a moving link has no valid inertia.
        """
        check_number(natural_frequency, "the natural frequency [rad/s]", ControlError, 1e-6)
        inertia = np.ones(robot.n_joints)
        if kind == FEEDFORWARD_PD:
            robot.require_inertias("gains for a natural frequency")
            zero = np.zeros_like(motion.positions)
            _, dtau = robot.inverse_dynamics_derivatives(motion.positions, zero, zero)
            matrices = dtau[:, :, 2 * robot.n_joints :]
            held = matrices.diagonal(axis1=1, axis2=2)
            free = 1.0 / np.linalg.inv(matrices).diagonal(axis1=1, axis2=2)
            inertia = np.sqrt(held * free).mean(axis=0)
        return cls(
            kind,
            robot.joint_names,
            inertia * natural_frequency**2,
            inertia * 2.0 * natural_frequency,
        )

    def to_metadata(self) -> dict[str, Any]:
        """Kind and gains, of JSON types."""
        return {
            "kind": self.kind,
            "position_gains": self.position_gains.tolist(),
            "velocity_gains": self.velocity_gains.tolist(),
        }


def paired_law(primitive: MovementPrimitive) -> ControlLaw | None:
    """The control law of a primitive; None if it has none.

    Raises
    ------
    PrimitiveError
        If the metadata of the primitive hold no valid control law of its joints.
    """
    stored = primitive.metadata.get(_KEY)
    if stored is None:
        return None
    try:
        return ControlLaw(
            stored["kind"],
            primitive.joint_names,
            stored["position_gains"],
            stored["velocity_gains"],
        )
    except (ControlError, KeyError, TypeError) as error:
        raise PrimitiveError(
            f"the control law of primitive '{primitive.name}' can't be used: {error}"
        ) from None


def with_gains_only(metadata: Mapping[str, Any]) -> dict[str, Any]:
    """Metadata without the stability of the law, which holds for the original motion only."""
    law = metadata.get(_KEY)
    if not isinstance(law, Mapping):
        return dict(metadata)
    gains = {key: value for key, value in law.items() if key != _KNOWN}
    return {**metadata, _KEY: gains}


def pair_law(
    primitive: MovementPrimitive, law: ControlLaw, known: Mapping[str, Any]
) -> MovementPrimitive:
    """The primitive with a control law.

    Parameters
    ----------
    primitive : MovementPrimitive
        The primitive; an existing law is replaced.
    law : ControlLaw
        Of the same joints.
    known : mapping
        Stability of the law, of JSON types.

    Raises
    ------
    ControlError
        If the joints of the law differ from those of the primitive.
    """
    if law.joint_names != primitive.joint_names:
        raise ControlError(
            f"the control law is of {quote_names(law.joint_names)}, primitive "
            f"'{primitive.name}' of {quote_names(primitive.joint_names)}"
        )
    metadata = {**primitive.metadata, _KEY: law.to_metadata() | {_KNOWN: dict(known)}}
    return replace(primitive, metadata=metadata)


_EXCLUDED = (
    "errors of centres of mass and of the velocity at the start, elasticity, backlash, and noise "
    "of the sensors"
)

NO_LAW = "none; run verify to pair one with this primitive"


def verified_case(robot: Robot, trajectory: Trajectory) -> dict[str, Any]:
    """The motion and the robot of an error bound, of JSON types."""
    names, positions = trajectory.joint_names, trajectory.positions
    return {
        "start": by_name(names, positions[0]),
        "goal": by_name(names, positions[-1]),
        "duration": trajectory.duration,
        "robot": robot.name,
    }


def excluded(assumed: Mapping[str, Any]) -> str:
    """What an error bound does not include, given the errors that it assumes."""
    friction = [] if any(assumed["friction"]) else ["friction"]
    rotors = [] if assumed["armature"] else ["inertias of the rotors"]
    return ", ".join([*friction, *rotors, _EXCLUDED])


def control_statement(primitive: MovementPrimitive) -> str:
    """Sentences on the control law of a primitive, also on one that can't be read."""
    try:
        law = paired_law(primitive)
    except PrimitiveError as error:
        return f"unusable: {error}; run verify again"
    if law is None:
        return NO_LAW
    known = primitive.metadata[_KEY].get(_KNOWN)
    statement = known.get(STATEMENT) if isinstance(known, Mapping) else None
    return f"{law.kind}; {statement or 'no error bound: run verify for this primitive'}"


def bound_statement(names: Sequence[str], known: Mapping[str, Any]) -> str:
    """A sentence on the error bound of a law, of joints with some names.

    Parameters
    ----------
    names : sequence of str
        The joints.
    known : mapping
        What `verify` has found.
    """
    if not known["bound_holds"]:
        verdict = "no error bound"
    else:
        bound = dict(zip(names, known["error_bound"], strict=True))
        verdict = f"errors stay within {name_values(bound)} rad or m"
    case, assumed = known["holds_for"], known["assumed"]
    friction, rubbing = dict(zip(names, assumed["friction"], strict=True)), ""
    if any(friction.values()):
        rubbing = f"friction within {name_values(friction)} N·m or N, "
    start, goal = (name_values(case[end]) for end in ("start", "goal"))
    return (
        f"{verdict} on the motion from {start} to {goal} in "
        f"{case['duration']:.6g} s of robot '{case['robot']}', if each mass and moment of inertia "
        f"is within {100.0 * assumed['inertia_error']:g} %, the payload within "
        f"{assumed['payload']:g} kg, {rubbing}the start within "
        f"{assumed['start_error']:g} rad or m, the control period "
        f"{1e3 * assumed['control_period']:g} ms, and the delay {assumed['delay']} samples; "
        f"not included: {excluded(assumed)}"
    )
