# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The dialogue of a teaching session, and recordings that are played back into one."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Protocol

from ..exceptions import RecordingError
from ..recordings.bags import JOINT_STATE, choose_topic, open_bag, to_cdr
from ..recordings.bags.bag import damage_reported
from ..recordings.joint_states import slice_joint_states
from .session import TeachingSession
from .words import SessionWords

KEYS = "d discards the last motion, b builds the primitive, q quits; the recording is kept"


class MessageSource(Protocol):
    """Where the joint states of a session come from."""

    @property
    def pause(self) -> float:
        """Least time between two looks at it [s]; 0: keys count when nothing follows."""

    def feed(self, record: Callable[[Sequence[tuple[int, bytes]]], None]) -> bool:
        """Record what has come; returns whether more may follow."""

    def silence(self) -> str:
        """Why nothing has come, as far as that is known."""


def hold_dialogue(
    session: TeachingSession,
    source: MessageSource,
    pressed: Callable[[float | None], str | None],
    words: SessionWords,
    say: Callable[..., None],
    idle_ratio: float = 4.0,
    max_silence: int = 10,
) -> bool:
    """Show motions as they end, until a person ends the session.

    Parameters
    ----------
    session :
        The session.
    source :
        Feeds it.
    pressed :
        Returns the next key; '' if none is pressed within a time [s], None if none can be any more.
    words :
        Describes the motions.
    say :
        Prints lines.
    idle_ratio :
        Pauses are at least so many times as long as an update of the session.
    max_silence :
        Number of pauses at the beginning without a message after which that is said.

    Returns
    -------
    is_built :
        Whether the primitive is to be built.
    """
    is_fed, n_silent, n_known = True, 0, session.n_messages
    while True:
        started = time.monotonic()
        is_fed = is_fed and source.feed(session.record)
        update = session.update(is_over=not is_fed, explains=not is_fed or source.pause > 0.0)
        say(*words.update_lines(update, session.motions))
        if is_fed and not source.pause:
            continue
        n_silent = n_silent + 1 if session.n_messages == n_known else 0
        if n_silent == max_silence and is_fed:
            say(source.silence())
        pause = max(source.pause, idle_ratio * (time.monotonic() - started))
        key = pressed(pause if is_fed else None)
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
    pause : float
        Least time between two parts [s].

    Raises
    ------
    RecordingError
        If it can't be read, or has no such topic of joint states.
    """

    pause = 0.0

    def __init__(self, path: Path, topic: str | None = None, n_parts: int = 50) -> None:
        with open_bag(path) as bag, damage_reported(path, bag.format):
            chosen = choose_topic(bag.topics, topic)
            if chosen.type != JOINT_STATE:
                raise RecordingError(f"'{chosen.name}' of '{path}' holds no joint states")
            convert = to_cdr if bag.format == "rosbag1" else bytes
            self._left = bag.read([chosen], lambda stored: [(t, convert(x)) for _, t, x in stored])
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

    def feed(self, record: Callable[[Sequence[tuple[int, bytes]]], None]) -> bool:
        """Record the next part; returns whether another one follows."""
        part, self._left = self._left[: self._n], self._left[self._n :]
        record(part)
        return bool(self._left)

    def silence(self) -> str:
        """Why nothing has come; not asked, since there are no pauses."""
        return ""
