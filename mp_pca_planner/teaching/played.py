# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A recording that is played back into a teaching session."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from ..exceptions import RecordingError
from ..recordings.bags import JOINT_STATE, choose_topic, open_bag, to_cdr
from ..recordings.bags.bag import damage_reported
from ..recordings.joint_states import slice_joint_states


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
