# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The dialogue of a teaching session: what it says of motions, and recordings played into it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..exceptions import PlannerError
from ..plotting.text import DEGREES, Unit, unit_of
from ..primitives.build import PrimitiveOptions
from ..primitives.differences import leave_one_out
from ..primitives.prediction import OFFSET, RequestFeatures
from ..recordings.bags import choose_topic, open_bag, to_cdr
from ..recordings.bags.bag import damage_reported
from ..recordings.demonstration import Demonstration
from ..recordings.joint_states import slice_joint_states
from ..recordings.segmentation import extent
from ..robot.limits import JointLimits
from ..robot.model import Robot
from .session import SessionUpdate, TeachingSession

KEYS = "d discards the last motion, b builds the primitive, q quits; the recording is kept"

# Pauses are at least so many times as long as an update of the session, and a silent source is
# named after so many pauses.
_IDLE_RATIO, _MAX_SILENCE = 4.0, 10

Record = Callable[[Sequence[tuple[int, bytes]]], None]
"""Stores serialised messages with their times of reception [ns]."""


def hold_dialogue(
    session: TeachingSession,
    feed: Callable[[Record], bool],
    pressed: Callable[[float | None], str | None],
    words: SessionWords,
    say: Callable[..., None],
    *,
    pause: float = 0.0,
    silence: Callable[[], str] = lambda: "",
) -> bool:
    """Show motions as they end, until a person ends the session.

    Parameters
    ----------
    session :
        The session.
    feed :
        Records what has come; returns whether more may follow.
    pressed :
        Returns the next key; '' if none is pressed within a time [s], None if none can be any more.
    words :
        Describes the motions.
    say :
        Prints lines.
    pause :
        Least time between two looks at what was recorded [s]; 0: keys count when nothing follows.
    silence :
        Returns why nothing has come, as far as that is known.

    Returns
    -------
    is_built :
        Whether the primitive is to be built.
    """
    is_fed, n_silent, n_known = True, 0, session.n_messages
    while True:
        started = time.monotonic()
        is_fed = is_fed and feed(session.record)
        update = session.update(is_over=not is_fed, explains=not is_fed or pause > 0.0)
        say(*words.update_lines(update, session.motions))
        if is_fed and not pause:
            continue
        n_silent = n_silent + 1 if session.n_messages == n_known else 0
        if n_silent == _MAX_SILENCE and is_fed:
            say(silence())
        idle = max(pause, _IDLE_RATIO * (time.monotonic() - started))
        key = pressed(idle if is_fed else None)
        if key is None or key == "q":
            return False
        if key == "b":
            say(*words.update_lines(session.update(is_over=True), session.motions))
            if session.motions:
                return True
            say("there is no motion to build a primitive from")
        elif key == "d":
            discarded = session.discard_last()
            say("there is no motion to discard" if discarded is None else _discarded(session))
        elif key:
            say(f"'{key}' does nothing: {KEYS}")


def _discarded(session: TeachingSession) -> str:
    n = len(session.motions)
    return f"motion {n + 1} is discarded: {n} left"


class PlayedBag:
    """Joint states of a bag, part by part and as fast as they are taken.

    Parameters
    ----------
    path : Path
        The recording.
    topic : str or None
        Topic of the joint states; by default the only one.
    n_parts : int
        Number of parts.

    Attributes
    ----------
    topic : str
        Topic of the joint states.

    Raises
    ------
    RecordingError
        If it can't be read, or has no such topic of joint states.
    """

    def __init__(self, path: Path, topic: str | None = None, n_parts: int = 50) -> None:
        with open_bag(path) as bag, damage_reported(path, bag.format):
            chosen = choose_topic(bag.topics, topic)
            convert = to_cdr if bag.format == "rosbag1" else bytes
            self._left = [(stamp, convert(x)) for _, stamp, x in bag.messages([chosen])]
        self.topic = chosen.name
        self._n = -(-len(self._left) // n_parts)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Joints of its first message."""
        messages = ((None, *message) for message in self._left[:1])
        return slice_joint_states(self.topic, messages, ros1=False).listed_joints

    def skip_until(self, stamp: int) -> int:
        """Leave out what was received up to a time [ns]; returns the number of these messages."""
        before = len(self._left)
        self._left = [message for message in self._left if message[0] > stamp]
        return before - len(self._left)

    def feed(self, record: Record) -> bool:
        """Record the next part; returns whether another one follows."""
        part, self._left = self._left[: self._n], self._left[self._n :]
        record(part)
        return bool(self._left)


# Variance of the noise of a demonstration.
_NOISE = 0.02
# Number of suggested motions.
_N_SUGGESTED = 2
# A motion is covered while this share of the variance of its shape, or less, is unknown.
_MAX_UNKNOWN = 0.5
# Suggested goals are at most this share of the distance from the mean goal beyond the
# demonstrated ones.
_BEYOND = 0.25
# A suggested motion is longer than this share of the shortest demonstrated one.
_MIN_DISTANCE = 0.5
# Largest numbers of motions that are compared, and of demonstrations that are left out.
_MAX_CANDIDATES = 200
_MAX_LEFT_OUT = 20


@dataclass(frozen=True, eq=False)
class Learned:
    """What demonstrations teach.

    Attributes
    ----------
    error, straight_error : float
        RMS distance of left-out demonstrations from their prediction by the others, and from
        the minimum-jerk motion between their ends [rad or m].
    low, high : array, shape (n_joints,)
        Range of the demonstrated goals.
    covered : float
        Share of the motions from a demonstrated start to the goal of another demonstration of
        which more is known than unknown.
    suggested : array, shape (n_suggested, 2, n_joints)
        Starts and goals of the motions of which least is known, each given those before it.
    """

    error: float
    straight_error: float
    low: FloatArray
    high: FloatArray
    covered: float
    suggested: FloatArray

    @classmethod
    def of(cls, motions: Sequence[Demonstration], limits: JointLimits | None = None) -> Learned:
        """Find out what demonstrations teach.

        Parameters
        ----------
        motions :
            Demonstrations of the same joints, at least two.
        limits :
            Suggested goals are within these.

        Raises
        ------
        PrimitiveError
            If no primitive can be built from them.
        """
        every = -(-len(motions) // _MAX_LEFT_OUT)
        errors = leave_one_out(motions, PrimitiveOptions(), range(0, len(motions), every)).rms()
        ends = np.array([motion.positions[[0, -1]] for motion in motions])
        shown, new = _requests(ends, limits)
        demonstrated = ends.reshape(len(ends), -1)
        requests = np.concatenate([shown, new])
        covariance = remaining_covariance(demonstrated, requests)
        suggested = requests[_least_known(covariance, _N_SUGGESTED)]
        is_covered = np.diag(covariance)[: len(shown)] <= _MAX_UNKNOWN
        return cls(
            error=float(errors[2, 0]),
            straight_error=float(errors[0, 0]),
            low=ends[:, 1].min(axis=0),
            high=ends[:, 1].max(axis=0),
            covered=float(is_covered.mean()) if len(shown) else 0.0,
            suggested=suggested.reshape(-1, *ends.shape[1:]),
        )


def _requests(ends: FloatArray, limits: JointLimits | None) -> tuple[FloatArray, FloatArray]:
    """Requests from demonstrated starts to the goals of other demonstrations, and to new goals.

    New goals are halfway between two demonstrated ones, and beyond them.

    Parameters
    ----------
    ends : array, shape (n_demonstrations, 2, n_joints)
        Starts and goals.

    Returns
    -------
    shown, new : array, shape (n_requests, 2 n_joints)
        Start and goal of each request.
    """
    starts, goals = ends.transpose(1, 0, 2)
    n = len(ends)
    halfway = 0.5 * np.sum(goals[_some(np.argwhere(np.tri(n, k=-1)), _MAX_CANDIDATES)], axis=1)
    further = np.concatenate([halfway, goals + _BEYOND * (goals - goals.mean(axis=0))])
    least = _MIN_DISTANCE * np.linalg.norm(goals - starts, axis=1).min()

    def requests(to: FloatArray, pairs: NDArray[np.intp]) -> FloatArray:
        first, second = _some(pairs, _MAX_CANDIDATES).T
        start, goal = starts[first], to[second]
        kept = np.linalg.norm(goal - start, axis=1) > least
        if limits is not None:
            kept &= np.all((goal >= limits.lower) & (goal <= limits.upper), axis=1)
        return np.asarray(np.concatenate([start, goal], axis=1)[kept])

    others = np.argwhere(~np.eye(n, dtype=bool))
    return requests(goals, others), requests(further, np.argwhere(np.ones((n, len(further)))))


def _some(rows: NDArray[np.intp], most: int) -> NDArray[np.intp]:
    """All rows, or at most so many of them at random, always the same ones."""
    return rows[np.random.default_rng(0).permutation(len(rows))[:most]]


def remaining_covariance(demonstrated: FloatArray, requests: FloatArray) -> FloatArray:
    """Covariance of the shapes of requests that demonstrations leave, in units of the prior's.

    That of a Gaussian process with the least noise (Rasmussen and Williams, equation 2.24). The
    common offset of all shapes counts as known. It does not depend on the shapes, so it is known
    before a motion is demonstrated.

    Parameters
    ----------
    demonstrated : array, shape (n_demonstrations, 2 n_joints)
        Start and goal of each demonstration [rad or m].
    requests : array, shape (n_requests, 2 n_joints)
        Start and goal of each request.

    Returns
    -------
    covariance : array, shape (n_requests, n_requests)
        On its diagonal, 0 is at a demonstration and 1 far from all.
    """
    every, n = np.concatenate([demonstrated, requests]), len(demonstrated)
    similar, _ = RequestFeatures(every)(every)
    prior = similar[0, 0] - OFFSET
    gram = prior[:n, :n] + _NOISE * np.eye(n)
    return np.asarray(prior[n:, n:] - prior[n:, :n] @ np.linalg.solve(gram, prior[:n, n:]))


def _least_known(covariance: FloatArray, n: int) -> list[int]:
    """Requests of largest variance, each given the demonstration of those before it.

    Parameters
    ----------
    covariance : array, shape (n_requests, n_requests)
        See :func:`remaining_covariance`.
    n : int
        Largest number of requests.
    """
    chosen: list[int] = []
    for _ in range(min(n, len(covariance))):
        best = int(np.argmax(np.diag(covariance)))
        column = covariance[:, best]
        covariance = covariance - np.outer(column, column) / (column[best] + _NOISE)
        chosen.append(best)
    return chosen


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
        found, n_lost, notes = update
        for note in notes:
            yield f"left out: {note}" if motions else f"no motion yet: {note}"
        if n_lost:
            yield f"{n_lost} earlier motions now have other cuts"
        for motion in found:
            number = motions.index(motion) + 1
            yield f"motion {number}: {motion.duration:.2f} s, {self._length(motion)}, accepted"
        if found:
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
