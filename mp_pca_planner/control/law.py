# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The control law paired with a primitive ([P] Fig. 1, block 2), and sentences on it.

With the error e = q_d − q of the motion q_d and the model's M, h and inverse dynamics τ_d of it:

    feed-forward with PD    τ = τ_d + K_p e + K_d ė
    computed torque         τ = M(q) (q̈_d + K_p e + K_d ė) + h(q, q̇)

Siciliano et al., "Robotics: Modelling, Planning and Control", 2009, sections 8.5 and 8.6.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..arrays import FloatArray, check_choice, check_number, frozen_array, set_frozen
from ..exceptions import ControlError, PrimitiveError
from ..motion.trajectory import Trajectory
from ..primitives.primitive import MovementPrimitive
from ..robot.model import Robot

FEEDFORWARD_PD, COMPUTED_TORQUE = "feedforward_pd", "computed_torque"
KINDS = (FEEDFORWARD_PD, COMPUTED_TORQUE)

_KEY, _STATEMENT = "control_law", "statement"

NO_LAW = "none; run verify to pair one with this primitive"


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
        check_choice(self.kind, "the kind of a control law", ControlError, KINDS)
        for field in ("position_gains", "velocity_gains"):
            shape = (len(self.joint_names),)
            gains = frozen_array(getattr(self, field), shape, field, ControlError)
            if not np.all(gains > 0.0):
                joint = self.joint_names[int(gains.argmin())]
                raise ControlError(
                    f"{field} must be positive, got {gains.min():g} for joint '{joint}'"
                )
            set_frozen(self, **{field: gains})

    @classmethod
    def from_frequency(
        cls, kind: str, robot: Robot, motion: Trajectory, natural_frequency: float
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
        gains = inertia * natural_frequency**2, inertia * 2.0 * natural_frequency
        return cls(kind, robot.joint_names, *gains)


def pair_law(
    primitive: MovementPrimitive, law: ControlLaw, statement: str = ""
) -> MovementPrimitive:
    """The primitive with a control law of its joints, and a sentence on the law's error bound."""
    stored = {
        "kind": law.kind,
        "position_gains": law.position_gains.tolist(),
        "velocity_gains": law.velocity_gains.tolist(),
        _STATEMENT: statement,
    }
    return replace(primitive, metadata={**primitive.metadata, _KEY: stored})


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
        gains = stored["position_gains"], stored["velocity_gains"]
        return ControlLaw(stored["kind"], primitive.joint_names, *gains)
    except (ControlError, KeyError, TypeError) as error:
        raise PrimitiveError(
            f"the control law of primitive '{primitive.name}' can't be used: {error}"
        ) from None


def without_bound(metadata: Mapping[str, Any]) -> dict[str, Any]:
    """Metadata without the error bound of the law, which holds for the original motion only."""
    law = metadata.get(_KEY)
    return {**metadata, _KEY: {**law, _STATEMENT: ""}} if law else dict(metadata)


def control_statement(primitive: MovementPrimitive) -> str:
    """Sentences on the control law of a primitive, also on one that can't be read."""
    try:
        law = paired_law(primitive)
    except PrimitiveError as error:
        return f"unusable: {error}; run verify again"
    if law is None:
        return NO_LAW
    statement = primitive.metadata[_KEY].get(_STATEMENT)
    return f"{law.kind}; {statement or 'no error bound: run verify for this primitive'}"
