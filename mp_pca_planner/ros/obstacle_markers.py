# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Obstacles of visualization_msgs/Marker messages."""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Iterable, Sequence
from pathlib import Path

from visualization_msgs.msg import Marker

from ..exceptions import WorldError
from ..robot.world import Obstacle
from .marker_bytes import MarkerData
from .obstacle_builder import ObstacleBuilder, is_slow, rejection, to_obstacle

_MAX_NAME = 500  # characters


class MarkerMessages:
    """Applies messages of markers to a world, each once.

    Obstacles with large meshes appear when these are ready, and those with a lifetime vanish: call
    :meth:`refresh` again and again.

    Attributes
    ----------
    rejected : dict
        Why the last marker of a name can't be used, by the names of such markers.
    """

    most = 400
    """Largest numbers of remembered messages, of rejections, and of names that were deleted."""

    def __init__(self) -> None:
        self.rejected: dict[str, str] = {}
        # The latest messages, because a message may arrive on several subscriptions.
        self._seen: deque[int] = deque(maxlen=self.most)
        # Source time of the last change of each obstacle, and of all of them [ns]; the latest last.
        self._changed: dict[str, int] = {}
        self._cleared = 0
        self._ends: dict[str, float] = {}
        self._builder = ObstacleBuilder()
        # Names of obstacles with meshes, unless another marker came since.
        self._expected: set[str] = set()

    @property
    def meshes(self) -> tuple[int, int]:
        """How many meshes had to be read, and how many of these, in the same order, were."""
        return self._builder.n_asked, self._builder.n_fetched

    def close(self) -> None:
        """Read no further mesh."""
        self._builder.close()

    def apply(
        self,
        world: Iterable[Obstacle],
        markers: Sequence[MarkerData],
        stamp: int,
        *,
        is_late: bool,
        folders: Sequence[Path],
        now: float,
    ) -> tuple[list[Obstacle], list[str]] | None:
        """Apply a message; a marker that can't be used changes nothing.

        Parameters
        ----------
        world :
            The obstacles before, each in the frame in which it is stated.
        markers :
            The markers of the message.
        stamp :
            Its source time [ns].
        is_late :
            Whether it may be older than others, because it was latched.
        folders :
            Folders of packages, for meshes.
        now :
            The time that lifetimes are counted from [s].

        Returns
        -------
        obstacles, problems :
            The obstacles after, and why markers were rejected; None if the message came before.
        """
        if stamp and stamp in self._seen:
            return None
        self._seen.append(stamp)
        obstacles, problems = {one.name: one for one in world}, list[str]()
        for marker in markers:
            # A latched message may come after a newer one.
            if is_late and stamp < max(self._changed.get(marker.name, 0), self._cleared):
                continue
            try:
                self._apply_marker(marker, obstacles, folders)
            except WorldError as error:
                problems.append(self._reject(marker, error))
                continue
            for cleared in [x for x in self.rejected if _concerns(marker, x)]:
                del self.rejected[cleared]
            self._note_change(marker, stamp, now)
        self._forget(obstacles)
        return list(obstacles.values()), problems

    def refresh(
        self, world: Iterable[Obstacle], now: float
    ) -> tuple[list[Obstacle], list[str]] | None:
        """Add the obstacles whose meshes have been read, and drop those whose lifetime is over.

        Returns
        -------
        obstacles, problems :
            See :meth:`apply`; None if nothing has changed.
        """
        over = [name for name, end in self._ends.items() if end <= now]
        made = self._builder.fetch()
        if not (over or made):
            return None
        obstacles, problems = {one.name: one for one in world}, list[str]()
        for marker, obstacle in made:
            if marker.name not in self._expected:
                continue
            if isinstance(obstacle, Obstacle):
                obstacles[marker.name] = obstacle
                self.rejected.pop(marker.name, None)
            else:
                problems.append(self._reject(marker, obstacle))
        for name in over:
            del self._ends[name]
            self._expected.discard(name)
            obstacles.pop(name, None)
        return list(obstacles.values()), problems

    def _reject(self, marker: MarkerData, error: WorldError) -> str:
        text = str(error)
        if len(self.rejected) < self.most:
            self.rejected[marker.name[:_MAX_NAME]] = text
        return text

    def _note_change(self, marker: MarkerData, stamp: int, now: float) -> None:
        if marker.action == Marker.DELETEALL:
            if not marker.ns:
                self._cleared = stamp
            return
        self._changed.pop(marker.name, None)
        self._changed[marker.name] = stamp
        self._ends.pop(marker.name, None)
        if marker.action == Marker.ADD and marker.lifetime > 0.0:
            self._ends[marker.name] = now + marker.lifetime

    def _forget(self, obstacles: Collection[str]) -> None:
        """Forget the first of too many deleted names: a late message may bring them back."""
        deleted = [name for name in self._changed if name not in obstacles]
        for name in deleted[: max(len(deleted) - self.most, 0)]:
            del self._changed[name]

    def _apply_marker(
        self, marker: MarkerData, obstacles: dict[str, Obstacle], folders: Sequence[Path]
    ) -> None:
        name = marker.name
        if len(name) > _MAX_NAME:
            raise WorldError(
                f"a marker's name has {len(name)} characters, at most {_MAX_NAME} are used"
            )
        if marker.action == Marker.ADD:
            if is_slow(marker):
                self._builder.begin(marker, folders)
                self._expected.add(name)
            else:
                obstacles[name] = to_obstacle(marker)
                self._expected.discard(name)
        elif marker.action in (Marker.DELETE, Marker.DELETEALL):
            for other in [other for other in obstacles if _concerns(marker, other)]:
                del obstacles[other]
            self._expected -= {other for other in self._expected if _concerns(marker, other)}
        else:
            raise rejection(
                marker,
                f"its action is {marker.action}; accepted are 0 (add or modify), 2 (delete) and 3 "
                "(delete all)",
            )


def _concerns(marker: MarkerData, name: str) -> bool:
    """Whether a marker changes or deletes the obstacle of a name."""
    if marker.action != Marker.DELETEALL:
        return name == marker.name
    return name.startswith(f"{marker.ns}/" if marker.ns else "")
