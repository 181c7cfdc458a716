# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The parameters of the node: declared from one table, and changed as the planner accepts them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node
from rclpy.parameter import Parameter

from ..exceptions import PlannerError, unknown_name
from ..execution.parameters import (
    DECLARATIONS,
    LIMITS_PREFIX,
    Declaration,
    Settings,
    check_limit_names,
    limit_declarations,
    split_limit_name,
)
from .messages import to_descriptor

_NAMES_OF_ROS = ("use_sim_time", "qos_overrides.", "start_type_description_service")


class NodeParameters:
    """Declares and reads the parameters of a node that allows undeclared ones.

    Parameters
    ----------
    node : Node
        The node.

    Attributes
    ----------
    is_declaring : bool
        Whether a parameter is set because it is being declared.

    Raises
    ------
    PlannerError
        If a given value is not accepted.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        with node.handle:
            self._given: dict[str, Parameter] = node.handle.get_parameters(Parameter)
        self.is_declaring = False
        self._declare(DECLARATIONS)
        for name, parameter in self._given.items():
            if name.startswith(LIMITS_PREFIX):
                _check_limit(name, parameter.value)

    def settings(self, changes: Iterable[Parameter] = ()) -> Settings:
        """Return the present values, some of which are about to change."""
        present: dict[str, Any] = dict(self._node.get_parameters_by_prefix(""))
        # Limits are declared when the joints are known.
        values = {n: p.value for n, p in self._given.items() if n.startswith(LIMITS_PREFIX)}
        values |= {name: parameter.value for name, parameter in present.items()}
        values |= {parameter.name: parameter.value for parameter in changes}
        # An empty list in a parameter file leaves its parameter without a value.
        return Settings.from_values({k: v for k, v in values.items() if v is not None})

    def use_joints(self, joint_names: Sequence[str]) -> None:
        """Declare the limits of the joints of the primitives, and undeclare all others.

        Raises
        ------
        PlannerError
            If limits are given for other joints, or are out of range.
        """
        if joint_names:
            check_limit_names(self._given, joint_names)
        limits = {declaration.name: declaration for declaration in limit_declarations(joint_names)}
        present = self._node.get_parameters_by_prefix("")
        self._declare([limit for name, limit in limits.items() if name not in present])
        for name in present:
            if name.startswith(LIMITS_PREFIX) and name not in limits:
                self._node.undeclare_parameter(name)

    def check_names(self, names: Sequence[str], joint_names: Sequence[str]) -> None:
        """Raise a `PlannerError` if one of the names is unknown."""
        if joint_names:
            check_limit_names(names, joint_names)
        for name in names:
            if not self._node.has_parameter(name) and not name.startswith(_NAMES_OF_ROS):
                valid = self._node.get_parameters_by_prefix("")
                raise PlannerError(unknown_name("parameter", name, valid))

    def unknown(self) -> list[str]:
        """Describe the given parameters that are unknown; a file may serve several nodes."""
        valid = [declaration.name for declaration in DECLARATIONS]
        known = (*_NAMES_OF_ROS, LIMITS_PREFIX)
        return [
            unknown_name("parameter", name, valid)
            for name in self._given
            if name not in valid and not name.startswith(known)
        ]

    def _declare(self, declarations: Sequence[Declaration]) -> None:
        self.is_declaring = True
        try:
            for declaration in declarations:
                default = declaration.default
                value = list(default) if isinstance(default, tuple) else default
                descriptor = to_descriptor(declaration)
                self._node.declare_parameter(declaration.name, value, descriptor)
        except (InvalidParameterTypeException, InvalidParameterValueException):
            raise declaration.refusal(self._given[declaration.name].value) from None
        finally:
            self.is_declaring = False


def _check_limit(name: str, value: object) -> None:
    """Raise a `PlannerError` if the value of a limit is not accepted."""
    joint, _ = split_limit_name(name)
    (declared,) = (d for d in limit_declarations([joint]) if d.name == name)
    if not isinstance(value, float) or not declared.low <= value <= declared.high:
        raise declared.refusal(value)
