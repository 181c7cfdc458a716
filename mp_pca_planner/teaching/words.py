# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A teaching session in words."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from ..arrays import FloatArray
from ..exceptions import PlannerError
from ..plotting.text import DEGREES, Unit, unit_of
from ..recordings.demonstration import Demonstration
from ..recordings.segmentation import extent
from ..robot.model import Robot
from .learned import Learned
from .session import SessionUpdate


class SessionWords:
    """Describes motions and what they teach; places of the end effector with a robot only.

    Parameters
    ----------
    robot : Robot or None
        The robot.
    frame : str
        Its end effector; by default the link that most joints move.
    """

    def __init__(self, robot: Robot | None = None, frame: str = "") -> None:
        self._robot = robot
        self._frame = frame

    def update_lines(
        self, update: SessionUpdate, motions: Sequence[Demonstration]
    ) -> Iterator[str]:
        """What an update of a session with these motions says."""
        for note in update.notes:
            yield f"left out: {note}" if motions else f"no motion yet: {note}"
        if update.n_lost:
            yield f"{update.n_lost} earlier motions now have other cuts"
        for motion in update.found:
            number = motions.index(motion) + 1
            yield f"motion {number}: {motion.duration:.2f} s, {self._length(motion)}, accepted"
        if update.found:
            yield from self.learned_lines(motions)

    def learned_lines(self, motions: Sequence[Demonstration]) -> Iterator[str]:
        """What motions teach."""
        try:
            learned = self._learned(motions)
        except PlannerError as error:
            yield f"  nothing is learned yet: {error}"
            return
        unit = self._unit(motions[0].joint_names)
        names = motions[0].joint_names
        yield (
            f"  left-out error {unit.number(learned.error)} {unit.name} (straight motions: "
            f"{unit.number(learned.straight_error)} {unit.name}); {learned.covered:.0%} of the "
            "motions between shown starts and goals are covered"
        )
        yield f"  goals shown {self._si(names)}: {_ranges(names, learned.low, learned.high)}"
        if self._robot is not None:
            goals = np.array([motion.positions[-1] for motion in motions])
            frame, places = self._places(names, goals)
            shown = _ranges("xyz", places.min(axis=0), places.max(axis=0))
            yield f"  {frame} at goals [m]: {shown}"
        for start, goal in learned.suggested:
            yield f"  least known: from {self.place(names, start)} to {self.place(names, goal)}"

    def place(self, joint_names: Sequence[str], q: FloatArray) -> str:
        """Positions of joints, shape (n_joints,), and the place of the end effector."""
        rounded = np.round(q, 2) + 0.0  # no minus before zero
        joints = ",".join(f"{name}={x:.2f}" for name, x in zip(joint_names, rounded, strict=True))
        joints = f"{joints} {self._si(joint_names)}"
        if self._robot is None:
            return joints
        frame, places = self._places(joint_names, q[None])
        x, y, z = (f"{value:.2f}" for value in places[0])
        return f"{joints} ({frame} at {x} {y} {z} m)"

    def _places(self, joint_names: Sequence[str], q: FloatArray) -> tuple[str, FloatArray]:
        """The end effector that these joints move, and its places [m], shape (n_steps, 3)."""
        assert self._robot is not None
        robot = self._robot.with_joints(joint_names)
        frame = self._frame or robot.end_effector  # of a gripper at rest, the hand
        return frame, robot.frame_positions(q, [frame])[:, 0]

    def _learned(self, motions: Sequence[Demonstration]) -> Learned:
        if len(motions) < 2:
            raise PlannerError("two motions are needed")
        robot = self._robot and self._robot.with_joints(motions[0].joint_names)
        return Learned.of(motions, robot.limits() if robot else None)

    def _length(self, motion: Demonstration) -> str:
        unit = self._unit(motion.joint_names)
        text = f"{unit.number(extent(motion.positions))} {unit.name}"
        if self._robot is None:
            return text
        frame, path = self._places(motion.joint_names, motion.positions)
        length = np.linalg.norm(np.diff(path, axis=0), axis=1).sum()
        return f"{text}, {frame} over {length:.2f} m"

    def _si(self, joint_names: Sequence[str]) -> str:
        """The unit of positions that commands read."""
        unit = self._unit(joint_names)
        return "[rad]" if unit is DEGREES else f"[{unit.name}]"

    def _unit(self, joint_names: Sequence[str]) -> Unit:
        return unit_of(joint_names, self._robot.prismatic_joints if self._robot else ())


def _ranges(names: Sequence[str], low: FloatArray, high: FloatArray) -> str:
    rows = zip(names, *(np.round([low, high], 2) + 0.0), strict=True)  # no minus before zero
    return ", ".join(f"{name} {a:.2f} to {b:.2f}" for name, a, b in rows)
