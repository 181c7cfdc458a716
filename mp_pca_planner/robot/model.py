# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The robot model (block 1 of [P] Fig. 1): a URDF, a choice of joints, and their dynamics."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from functools import cached_property
from html import escape
from pathlib import Path
from types import NoneType
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ..arrays import FloatArray, check_number, check_type, frozen_array, html_table, unique_names
from ..exceptions import RobotError, quote_names, unknown_name
from ..files import as_path, read_text, reading
from .dynamics import Dynamics
from .inertias import inertia_flaws, joint_of, listed_flaws
from .kinematics import AttachedPoints as AttachedPoints
from .kinematics import Kinematics
from .limits import JointLimits, Overrides, given_limits, merge_limits
from .link_inertias import LinkInertias
from .link_shapes import LinkShapes
from .locked_model import LockedModel
from .urdf import read_description

_SHOWN = {
    "lowest [rad or m]": "min_position",
    "highest": "max_position",
    "speed [/s]": "max_velocity",
    "effort [N·m or N]": "max_effort",
}


class Robot(Dynamics, Kinematics):
    """Rigid-body model of some joints of a robot, the others locked.

    Parameters
    ----------
    urdf : str
        The robot description, XML text.
    joint_names : sequence of str, optional
        The joints that move, in the order of every array of this class. All movable
        joints but those that mimic others, in the order of the kinematic tree, unless given.
    locked : mapping, optional
        Positions [rad or m] of locked joints; 0 (or the nearest limit) unless given. Those of
        joints that mimic one of these follow from it.
    source : str
        Name of the description in messages.

    Attributes
    ----------
    name : str
        The robot's name in its description.
    joint_names : tuple of str
        The joints, n_joints of them.
    continuous : array of bool, shape (n_joints,)
        Whether each joint turns without end.
    prismatic_joints : tuple of str
        The joints of `joint_names` that are measured in metres.
    movable_joints : tuple of str
        All movable joints of the description, in the order of the kinematic tree.
    frame_names, end_effector : tuple of str, str
        The links, and the last one of those that most joints move.
    path : Path or None
        The file that the description was read from.

    Raises
    ------
    RobotError
        If the description is no URDF, or a joint is unknown or can't move.

    Examples
    --------
    >>> import mp_pca_planner as mp
    >>> robot = mp.Robot.from_file(mp.config_file("human_arm.urdf"))
    >>> robot
    Robot 'human_arm': shoulder1, shoulder2, shoulder3, elbow
    >>> robot.frame_positions([[0.0, 0.0, 0.0, 0.0]], ["wrist"]).round(2).tolist()
    [[[-0.02, -0.17, -0.57]]]
    """

    def __init__(
        self,
        urdf: str,
        joint_names: Sequence[str] | None = None,
        *,
        locked: Mapping[str, float] | None = None,
        source: str = "robot description",
    ) -> None:
        check_type(urdf, "a robot description", RobotError, str)
        check_type(locked, "locked joints", RobotError, Mapping, NoneType)
        self._source, self._given = source, (urdf, dict(locked or {}))
        self.path: Path | None = None
        self._description = found = read_description(urdf, source)
        self.name = found.name
        try:
            full = pin.buildModelFromXML(found.xml)
        except (ValueError, RuntimeError) as error:
            raise RobotError(f"{source} is refused by Pinocchio: {error}") from None
        self.movable_joints = tuple(name for name in full.names if name in found.types)
        driven = [name for name in self.movable_joints if name not in found.mimics]
        names = driven if joint_names is None else joint_names
        names = _movable(names, self.movable_joints, source)
        if both := sorted(set(locked or ()) & set(names)):
            raise RobotError(f"{quote_names(both)} can't be locked and move at the same time")
        if locked:
            _movable(tuple(locked), self.movable_joints, source)
        self._locked = LockedModel(full, names, locked or {}, found)
        model, _ = self._locked.reduced([])
        self._inertia_flaws, unknown = inertia_flaws(model, found)
        for joint in unknown:  # efforts that can't be computed become NaN, not 0
            model.inertias[joint] = pin.Inertia(np.nan, np.zeros(3), np.zeros((3, 3)))
        super().__init__(model, names, source)
        self.continuous = np.array([found.types[name] == "continuous" for name in names])
        self.continuous.setflags(write=False)
        self.prismatic_joints = tuple(n for n in names if found.types[n] == "prismatic")

    def __repr__(self) -> str:
        return f"Robot '{self.name}': {', '.join(self.joint_names)}"

    def _repr_html_(self) -> str:
        limits = self._description.limits
        rows = [
            [
                name,
                self._description.types[name],
                *(f"{limits.get(name, {}).get(key, np.inf):.4g}" for key in _SHOWN.values()),
            ]
            for name in self.joint_names
        ]
        table = html_table(["joint", "type", *_SHOWN], rows)
        return (
            f"<p>Robot '{escape(self.name)}', end effector '{escape(self.end_effector)}'</p>{table}"
        )

    @classmethod
    def from_file(
        cls,
        path: str | Path,
        joint_names: Sequence[str] | None = None,
        *,
        locked: Mapping[str, float] | None = None,
    ) -> Robot:
        """Read the robot description from a URDF file (see the class)."""
        check_type(path, "the path of a URDF file", RobotError, str, Path)
        path = as_path(path, RobotError)
        with reading(f"the URDF file {str(path)!r:.100}", RobotError):
            urdf = read_text(path)
        robot = cls(urdf, joint_names, locked=locked, source=f"URDF file '{path}'")
        robot.path = Path(path)
        return robot

    @property
    def described_joints(self) -> tuple[str, ...]:
        """The joints that move, in the order of the robot description."""
        return tuple(name for name in self.movable_joints if name in self.joint_names)

    @property
    def locked_positions(self) -> Mapping[str, float]:
        """The known positions of locked joints [rad or m]; others count as 0."""
        return self._locked.known

    def relevant_joints(self, *, pairs: bool, links: Collection[str] = ()) -> tuple[str, ...]:
        """The locked joints whose positions make a difference to the motion of the others.

        These place joints that move, or they place a mass or a collision shape that these carry.

        Parameters
        ----------
        pairs : bool
            Whether pairs of links are checked for collisions: then collision shapes that the base
            carries matter, too.
        links : collection of str
            Links whose poses are needed.
        """
        return self._locked.relevant(pairs=pairs, links=links)

    def limits(self, *overrides: Overrides | str | Path) -> JointLimits:
        """Limits of the joints: those of the URDF, replaced by mappings or limits files in turn.

        Raises
        ------
        LimitsError
            If an override can't be used, or a limit is invalid, such as a velocity limit of 0.
        """
        layers = (given_limits(one, self.movable_joints) for one in overrides)
        return JointLimits(
            self.joint_names,
            merge_limits(self._description.limits, *layers),
            source=f"limits of the {self._source}",
        )

    def with_joints(self, joint_names: Sequence[str]) -> Robot:
        """The robot with these joints moving; itself, if they are its own in this order.

        Raises
        ------
        RobotError
            If a joint is unknown or can't move.
        """
        if tuple(joint_names) == self.joint_names:
            return self
        urdf, given = self._given
        locked = {name: value for name, value in given.items() if name not in joint_names}
        robot = Robot(urdf, joint_names, locked=locked, source=self._source)
        robot.path = self.path
        return robot

    def require_inertias(self, purpose: str, instead: str = "") -> None:
        """Reject a robot whose efforts can't be computed.

        Parameters
        ----------
        purpose : str
            The feature that needs the efforts, in the plural, for the message.
        instead : str
            An alternative to correcting the description, for the message.

        Raises
        ------
        RobotError
            If a moving link has no valid inertia.
        """
        if not self._inertia_flaws:
            return
        alternative = f", or {instead}" if instead else ""
        raise RobotError(
            f"{self._source}: {purpose} need the inertia of every moving link, but these have no "
            f"valid one: {listed_flaws(self._inertia_flaws)}; give each an <inertial> with a "
            "positive mass and a positive definite inertia tensor, of which no principal moment "
            f"exceeds the sum of the others{alternative}"
        )

    def pinocchio_model(self) -> tuple[Any, NDArray[np.intp]]:
        """Pinocchio's model of the joints that move, and the index of each joint in its vectors."""
        return self._model.copy(), self._order.to_pin

    def with_payload(self, mass: float, frame: str | None = None) -> Robot:
        """The same robot with a point mass [kg] at a link, by default the end effector.

        Raises
        ------
        RobotError
            If there is no such link, or the mass is no number of at least 0.
        """
        (frame_id,) = self._frame_ids([self.end_effector if frame is None else frame])
        check_number(mass, "the mass of a payload [kg]", RobotError, 0.0, 1e9)
        model = self._model.copy()
        carrier = model.frames[frame_id]
        joint = joint_of(carrier)
        if joint > 0 and mass != 0.0:
            point = pin.Inertia(float(mass), carrier.placement.translation, np.zeros((3, 3)))
            model.inertias[joint] = model.inertias[joint] + point
        return self._with_model(model)

    @cached_property
    def link_inertias(self) -> LinkInertias:
        """Masses and principal moments of inertia of the links that the joints move."""
        return LinkInertias.of(self._description.inertials, self._model)

    def with_link_inertias(self, factors: FloatArray) -> Robot:
        """The same robot with other masses and moments of inertia.

        Parameters
        ----------
        factors : array, shape (n_links, 4)
            Factors of the mass and of the three principal moments of inertia about the centre of
            mass of each link of `link_inertias`.
        """
        shape = (len(self.link_inertias.links), 4)
        factors = frozen_array(factors, shape, "factors of inertias", RobotError)
        model = self._model.copy()
        self.link_inertias.change(model, factors)
        return self._with_model(model)

    def collision_geometry(
        self, package_dirs: Sequence[Path]
    ) -> tuple[Any, Any, NDArray[np.intp], LinkShapes]:
        """Pinocchio's model, the collision geometry of the links, and the order of the joints.

        Parameters
        ----------
        package_dirs : sequence of Path
            Folders of the packages that ``package://`` paths of meshes name.

        Returns
        -------
        model : pinocchio.Model
            The model of the joints that move.
        geometry : pinocchio.GeometryModel
            Its collision geometry, with the pairs of links that are no neighbours: more than one
            joint is between them, locked ones included.
        order : array of int, shape (n_joints,)
            For each joint of the model, its index in `joint_names`.
        shapes : LinkShapes
            The shapes of the geometry.

        Raises
        ------
        RobotError
            If a shape can't be used, or a mesh can't be found or read.
        """
        shapes = LinkShapes(self._description, package_dirs, self._source)
        model, geometry = self._locked.collision_geometry(shapes)
        return model, geometry, self._order.from_pin, shapes


def _movable(names: Sequence[str], movable: Sequence[str], source: str) -> tuple[str, ...]:
    """The names of joints, if they differ and can move."""
    for name in unique_names(names, f"joints of the {source}", RobotError):
        if name not in movable:
            raise RobotError(f"{source}: {unknown_name('movable joint', name, movable)}")
    return tuple(names)
