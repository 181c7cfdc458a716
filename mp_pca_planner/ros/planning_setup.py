# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The parameters of the node, and its planning context.

The context is made of primitives, robot description and parameters.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node
from rclpy.parameter import Parameter

from ..exceptions import GoalError, PlannerError, quote_names, unknown_name
from ..execution.parameters import (
    DECLARATIONS,
    LIMITS_PREFIX,
    Declaration,
    Settings,
    check_limit_names,
    limit_declarations,
)
from ..execution.serving.assembly import LOCKED_TOLERANCE, Model, assemble_model, is_outdated
from ..primitives.library import PrimitiveLibrary, load_primitives
from ..robot.model import Robot
from ..robot.world import World
from .messages import to_descriptor

# Least time between models of a robot whose other joints are moving [s].
_LOCK_PERIOD = 0.3
# Parameters that rclpy declares.
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

    def settings(self, changes: Iterable[Parameter] = ()) -> Settings:
        """Return the present values, some of which are about to change."""
        present: dict[str, Any] = dict(self._node.get_parameters_by_prefix(""))
        values = {name: parameter.value for name, parameter in present.items()}
        values |= {parameter.name: parameter.value for parameter in changes}
        # An empty list in a parameter file leaves its parameter without a value.
        return Settings.from_values({k: v for k, v in values.items() if v is not None})

    def declare_limits(self, joint_names: Sequence[str]) -> None:
        """Declare the limits of the joints of the primitives.

        Raises
        ------
        PlannerError
            If limits are given for other joints, or are out of range.
        """
        if joint_names:
            check_limit_names(self._given, joint_names)
        limits = limit_declarations(joint_names)
        self._declare([d for d in limits if not self._node.has_parameter(d.name)])

    def forget_limits_except(self, joint_names: Sequence[str]) -> None:
        """Undeclare the limits of all joints except these."""
        names = {declaration.name for declaration in limit_declarations(joint_names)}
        for name in self._node.get_parameters_by_prefix(""):
            if name.startswith(LIMITS_PREFIX) and name not in names:
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


class PlanningSetup:
    """Keeps the planning context consistent with primitives, robot description and parameters.

    Parameters
    ----------
    parameters : NodeParameters
        The parameters of the node.
    explain : callable
        Describes an error in one sentence.
    expect : callable
        Called with the joints of the primitives and the context before; returns whether the joints
        have changed.
    topic : str
        The topic of the robot description, for messages.

    Attributes
    ----------
    settings : Settings
        The values of the parameters.
    context : Model or None
        The planning context; None while a part is missing.
    last_context : Model or None
        The newest one of these joints, to stop and monitor the motion of a goal at any time.
    problem : str
        Reason why the primitive files can't be used; empty if they can.
    hold : str
        Reason why goals are rejected although all parts are present; empty if they are accepted.

    Raises
    ------
    PlannerError
        If the parameters don't fit together.
    """

    def __init__(
        self,
        parameters: NodeParameters,
        explain: Callable[[Exception], str],
        expect: Callable[[tuple[str, ...], Model | None], bool],
        topic: str,
    ) -> None:
        self._parameters, self._explain = parameters, explain
        self._expect, self._topic = expect, topic
        self.settings: Settings = parameters.settings()
        self.context: Model | None = None
        self.last_context: Model | None = None
        self.problem, self.hold = "", ""
        self._primitives: PrimitiveLibrary | None = None
        self._description = ""
        self._context_problem = ""
        self._measured: Mapping[str, float] = {}
        self._next_lock = 0.0
        _check_description(self.settings)

    @property
    def library(self) -> str:
        """The names of the primitives, for messages."""
        return quote_names(self._primitives.names if self._primitives else ())

    @property
    def locked_joints(self) -> str:
        """The positions at which joints are locked, for messages."""
        known = self.context.robot.locked_positions if self.context else {}
        return ", ".join(f"{name}={position:.4g}" for name, position in known.items()) or "none"

    @property
    def missing(self) -> str:
        """The reason why goals are rejected; empty if they are accepted."""
        if self.hold or self.context is not None:
            return self.hold
        if not self._primitives:
            return self.problem or (
                "no primitives are loaded: set the parameter 'primitives' to primitive files or "
                "folders of them"
            )
        return self._context_problem or (
            f"waiting for a robot description: nothing has arrived on '{self._topic}' yet, and the "
            "parameter 'robot_description' is empty"
        )

    def ready(self) -> Model:
        """Return the planning context.

        Raises
        ------
        GoalError
            If goals are rejected.
        """
        context = self.context  # read once: another thread may replace it
        if context is None or self.hold:
            raise GoalError(
                self.missing or "the robot model is being replaced; send the goal again"
            )
        return context

    def load(self) -> bool:
        """Read the primitive files; returns False if they can't be read, see `problem`.

        Raises
        ------
        PlannerError
            If they don't fit the parameters; those in use stay.
        """
        try:
            primitives = load_primitives(self.settings.primitive_paths)
        except Exception as error:
            self.problem = self._explain(error)
            return False
        self._adopt(primitives)
        return True

    def unload(self) -> None:
        """Drop the primitives."""
        self._adopt(None)

    def use_description(self, urdf: str) -> bool:
        """Use a robot description of the topic; returns whether it makes a difference.

        Raises
        ------
        Exception
            If no planning context can be made of it; there is none then.
        """
        is_new, self._description = urdf != self._description, urdf
        if self.settings.robot_description or not is_new:
            return False
        try:
            self._adopt(self._primitives)
        except Exception as error:
            # The robot has changed, so the old context is invalid.
            self.context, self._context_problem = None, self._explain(error)
            raise
        return True

    def lock(self, measured: Mapping[str, float], world: World) -> None:
        """Lock the joints that the primitives do not move at measured positions.

        A model at new positions replaces the present one if they make a difference.

        Parameters
        ----------
        measured : mapping of str to float
            Measured positions of any joints [rad or m].
        world : World
            The obstacles.
        """
        last, self._measured = self._measured, measured
        before, primitives = self.context, self._primitives
        if before is None or primitives is None or not is_outdated(before, measured, world):
            return
        moves = any(abs(x - last.get(name, x)) > LOCKED_TOLERANCE for name, x in measured.items())
        if moves and time.monotonic() < self._next_lock:
            return
        self._next_lock = time.monotonic() + _LOCK_PERIOD
        context = assemble_model(before.urdf, primitives, before.settings, measured)
        if self.last_context is before:
            self.last_context = context
        self.context = context

    def change(self, changes: Sequence[Parameter]) -> None:
        """Use changed parameters.

        Raises
        ------
        Exception
            If they are not accepted; then nothing changes.
        """
        self._parameters.check_names([p.name for p in changes], _joint_names(self._primitives))
        old, new = self.settings, self._parameters.settings(changes)
        primitives = self._primitives
        if new.primitives != old.primitives:
            primitives = load_primitives(new.primitive_paths) if new.primitive_paths else None
        if new.robot_description != old.robot_description:
            # With all joints of a long chain, the model would take half a second.
            _check_description(new, _joint_names(primitives) if self.context else ())
        if new != old:
            self._adopt(primitives, changes)

    def _adopt(
        self, primitives: PrimitiveLibrary | None, changes: Sequence[Parameter] = ()
    ) -> None:
        """Use these primitives and changed parameters.

        Raises
        ------
        Exception
            If they are inconsistent; then nothing changes. If there is no usable context anyway,
            the changes are accepted: a fix may need several changes.
        """
        joint_names = _joint_names(primitives)
        self._parameters.declare_limits(joint_names)
        settings = self._parameters.settings(changes)
        urdf = settings.robot_description or self._description
        context, problem = None, ""
        try:
            if urdf and primitives:
                context = assemble_model(urdf, primitives, settings, self._measured)
        except Exception as error:
            if not self._context_problem:
                self._parameters.forget_limits_except(_joint_names(self._primitives))
                raise
            problem = self._explain(error)
        if primitives is not self._primitives:
            self.problem = ""
        self.settings, self._primitives = settings, primitives
        # Before the context, so that no motion of other joints is running in it.
        if self._expect(joint_names, self.last_context) or context is not None:
            self.last_context = context
        self.context, self._context_problem = context, problem
        self._parameters.forget_limits_except(joint_names)


def _check_description(settings: Settings, joint_names: tuple[str, ...] = ()) -> None:
    """Raise a `PlannerError` if no robot can be made of the parameter, even if unused."""
    if settings.robot_description:
        source = "parameter 'robot_description'"
        Robot(settings.robot_description, joint_names or None, source=source)


def _joint_names(primitives: PrimitiveLibrary | None) -> tuple[str, ...]:
    return primitives.joint_names if primitives else ()
