# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Obstacles of visualization_msgs/Marker messages: received, read, and kept."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Collection, Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from queue import SimpleQueue

import numpy as np
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from visualization_msgs.msg import Marker, MarkerArray

from ..arrays import FloatArray, frozen_array
from ..exceptions import WorldError, printable
from ..input_limits import INPUT_LIMITS
from ..robot.bodies import solid_of_shape
from ..robot.meshes import MeshContent, find_mesh, scaled
from ..robot.world import Box, Cylinder, Mesh, Obstacle, Shape, Sphere
from .nodes import LOG_PERIOD, PolledSubscription
from .serialised import MarkerData, read_markers

_ACCEPTED = "CUBE, SPHERE, CYLINDER, CUBE_LIST, SPHERE_LIST, TRIANGLE_LIST and MESH_RESOURCE"
MANY_POINTS = 3000
"""Points of a mesh from which on its obstacle is made in the thread."""


def to_obstacle(marker: MarkerData, folders: Sequence[Path] = ()) -> Obstacle:
    """The obstacle of a marker that is added or modified.

    Parameters
    ----------
    marker : MarkerData
        The marker.
    folders : sequence of Path
        Folders of packages, for meshes.

    Raises
    ------
    WorldError
        If its type is not supported, or its numbers can't be used.
    """
    try:
        mesh = _mesh_of(marker, folders, None)
        return _obstacle(marker, None if mesh is None else mesh[1])
    except WorldError as error:
        raise rejection(marker, error) from None


def rejection(marker: MarkerData, reason: object) -> WorldError:
    """The error that names a marker."""
    return WorldError(f"marker '{printable(marker.name)}': {reason}")


def is_slow(marker: MarkerData) -> bool:
    """Whether a marker has a mesh that takes long to read or to use."""
    is_large = marker.type == Marker.TRIANGLE_LIST and len(marker.points) > MANY_POINTS
    return marker.type == Marker.MESH_RESOURCE or is_large


_Source = tuple[MeshContent, bytes]


def _mesh_of(
    marker: MarkerData, folders: Sequence[Path], last: tuple[_Source, Mesh] | None
) -> tuple[_Source | None, Mesh] | None:
    """The mesh of a marker and its source; the last one if that is the same, None without mesh."""
    scale = frozen_array(marker.scale, (3,), "scale", WorldError)
    if marker.type == Marker.MESH_RESOURCE:
        found = find_mesh(marker.mesh_resource, folders)
        source = found, scale.tobytes()
        if last is not None and last[0][0] is found and last[0][1] == source[1]:
            return last
        return source, Mesh(scaled(found.vertices, scale), found.triangles)
    if marker.type != Marker.TRIANGLE_LIST:
        return None
    points = _points(marker, 3 * INPUT_LIMITS.triangles)
    if len(points) % 3:
        raise WorldError(f"a TRIANGLE_LIST has 3 points per triangle, got {len(points)} points")
    return None, Mesh(scaled(points, scale), np.arange(len(points)).reshape(-1, 3))


def _obstacle(marker: MarkerData, mesh: Mesh | None) -> Obstacle:
    shapes = [mesh] if mesh is not None else _shapes(marker)
    return Obstacle(
        marker.name, [one.moved(marker.pose) for one in shapes], marker.frame_id.lstrip("/")
    )


def _shapes(marker: MarkerData) -> list[Shape]:
    """The shapes in the frame of the marker's pose, without a mesh."""
    scale, kind = frozen_array(marker.scale, (3,), "scale", WorldError), marker.type
    if kind == Marker.CUBE:
        return [Box(scale)]
    if kind == Marker.SPHERE:
        return [Sphere(0.5 * _diameter(scale, "a sphere"))]
    if kind == Marker.CYLINDER:
        return [Cylinder(0.5 * _diameter(scale[:2], "a cylinder"), scale[2])]
    points = _points(marker, INPUT_LIMITS.shapes)
    if kind == Marker.CUBE_LIST:
        return [Box(scale, point) for point in points]
    if kind == Marker.SPHERE_LIST:
        radius = 0.5 * _diameter(scale, "a sphere")
        return [Sphere(radius, point) for point in points]
    raise WorldError(f"type {kind} is not supported; accepted are {_ACCEPTED}")


def _points(marker: MarkerData, most: int) -> FloatArray:
    if len(marker.points) > most:
        raise WorldError(f"it has {len(marker.points)} points, at most {most} are accepted")
    return marker.points


def _diameter(scale: FloatArray, what: str) -> float:
    if np.ptp(scale) > 1e-6 * np.abs(scale).max():
        numbers = ", ".join(f"{number:g}" for number in scale)
        raise WorldError(f"the diameters of {what} must be equal, got {numbers}")
    return float(scale[0])


class ObstacleBuilder:
    """Makes the obstacles of markers with meshes in a thread, one after the other.

    The newest marker of a name counts: one that waits is replaced, one that is being made is
    finished, so that a marker that is sent again and again becomes an obstacle, too.

    Attributes
    ----------
    n_asked, n_fetched : int
        Markers that were given, without those that were replaced, and those that were fetched.
    """

    most = 1000
    """Largest number of names that wait."""

    def __init__(self) -> None:
        # By name, in the order in which they came; None ends the thread.
        self._waiting: dict[str, tuple[MarkerData, Sequence[Path]]] = {}
        self._names: SimpleQueue[str | None] = SimpleQueue()
        self._made: SimpleQueue[tuple[MarkerData, Obstacle | WorldError]] = SimpleQueue()
        self._meshes: dict[str, tuple[_Source, Mesh]] = {}
        self.n_asked = self.n_fetched = 0
        # A daemon: a file that is being read must not keep the process alive.
        threading.Thread(target=self._run, name="meshes", daemon=True).start()

    def begin(self, marker: MarkerData, folders: Sequence[Path]) -> None:
        """Make the obstacle of a marker.

        Raises
        ------
        WorldError
            If too many wait.
        """
        if marker.name not in self._waiting:
            if len(self._waiting) >= self.most:
                reason = f"more than {self.most} meshes wait to be read; send it again"
                raise rejection(marker, reason)
            self.n_asked += 1
            self._waiting[marker.name] = marker, folders
            self._names.put(marker.name)
        else:
            self._waiting[marker.name] = marker, folders

    def fetch(self) -> list[tuple[MarkerData, Obstacle | WorldError]]:
        """Return the markers that are finished, each with its obstacle or why there is none."""
        made = []
        while not self._made.empty():
            made.append(self._made.get())
        self.n_fetched += len(made)
        return made

    def close(self) -> None:
        """End the thread after the marker that is being made."""
        self._names.put(None)

    def _run(self) -> None:
        while (name := self._names.get()) is not None:
            marker, folders = self._waiting.pop(name)
            try:
                self._made.put((marker, self._make(marker, folders)))
            except Exception as error:
                self._made.put((marker, rejection(marker, error)))

    def _make(self, marker: MarkerData, folders: Sequence[Path]) -> Obstacle:
        found = _mesh_of(marker, folders, self._meshes.pop(marker.name, None))
        assert found is not None
        source, mesh = found
        if source is not None:
            self._meshes[marker.name] = source, mesh
            while len(self._meshes) > INPUT_LIMITS.kept_meshes:
                del self._meshes[next(iter(self._meshes))]
        with suppress(WorldError):
            solid_of_shape(mesh)  # made here, and kept
        return _obstacle(marker, mesh)


_MAX_NAME = 500  # characters

Applied = tuple[list[Obstacle], list[str]]
"""Obstacles, and why markers were rejected."""


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
        message: MarkerMessage,
        *,
        folders: Sequence[Path],
        now: float,
    ) -> Applied | None:
        """Apply a message; a marker that can't be used changes nothing.

        Parameters
        ----------
        world :
            The obstacles before, each in the frame in which it is stated.
        message :
            The message.
        folders :
            Folders of packages, for meshes.
        now :
            The time that lifetimes are counted from [s].

        Returns
        -------
        obstacles, problems :
            The obstacles after, and why markers were rejected; None if the message came before.

        Raises
        ------
        WorldError
            If the message is malformed.
        """
        content, stamp, is_late = message
        markers = read_markers(content)
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

    def refresh(self, world: Iterable[Obstacle], now: float) -> Applied | None:
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


_DEPTH = 100  # bursts of messages wait
_DISCOVERY_PERIOD = 0.1  # [s]
# Time after which a subscription that is not lasting has received what it can [s]: publishers
# discover it within 3 s.
_FETCHING = 5.0


MarkerMessage = tuple[bytes, int, bool]
"""A serialised message of markers, when it was sent [ns], and whether it may be older than others
because it was latched."""


class MarkerSubscription:
    """Receives the markers of all publishers of a topic, and those they have latched.

    Parameters
    ----------
    node : Node
        The node.
    topic : str
        The topic.
    """

    def __init__(self, node: Node, topic: str) -> None:
        self._node, self._topic = node, topic
        self._name = node.resolve_topic_name(topic)
        self._is_reliable: bool | None = None
        self._lasting: PolledSubscription | None = None
        # Subscriptions that end, and when.
        self._ending: list[tuple[float, PolledSubscription, bool]] = []
        self._known: set[bytes] = set()
        self._discovered = 0.0

    def poll(self) -> list[MarkerMessage]:
        """Return the messages that have arrived; a message may be returned twice."""
        now = time.monotonic()
        if now - self._discovered >= _DISCOVERY_PERIOD:
            self._discovered = now
            self._follow_publishers(now)
        messages = [(one, False) for one in (self._lasting.poll() if self._lasting else ())]
        for _, subscription, is_latched in self._ending:
            messages += [(one, is_latched) for one in subscription.poll()]
        for end in [one for one in self._ending if one[0] < now]:
            self._ending.remove(end)
            end[1].destroy()
        return [
            (bytes(content), facts["source_timestamp"], is_late)
            for (content, facts), is_late in messages
        ]

    def _follow_publishers(self, now: float) -> None:
        publishers = self._node.get_publishers_info_by_topic(self._name)
        offers = {bytes(one.endpoint_gid): one.qos_profile for one in publishers}
        reliable = {
            key for key, qos in offers.items() if qos.reliability == ReliabilityPolicy.RELIABLE
        }
        if offers and (len(reliable) == len(offers)) != self._is_reliable:
            self._is_reliable = len(reliable) == len(offers)
            if self._lasting is not None:
                self._ending.append((now + _FETCHING, self._lasting, False))
            self._lasting = self._subscribe(is_reliable=self._is_reliable)
        latched = {
            key for key in reliable if offers[key].durability == DurabilityPolicy.TRANSIENT_LOCAL
        }
        if latched - self._known:
            self._fetch_latched(now, n_others=len(offers) - len(latched))
        self._known = latched

    def _fetch_latched(self, now: float, n_others: int) -> None:
        latched = self._subscribe(is_reliable=True, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._ending.append((now + _FETCHING, latched, True))
        if n_others:
            self._node.get_logger().info(
                f"'{self._name}' has publishers that latch their messages and {n_others} that do "
                "not: what these log now on incompatible QoS concerns a second subscription, and "
                "their messages are received",
                throttle_duration_sec=LOG_PERIOD,
            )

    def _subscribe(
        self, *, is_reliable: bool, durability: DurabilityPolicy = DurabilityPolicy.VOLATILE
    ) -> PolledSubscription:
        best = ReliabilityPolicy.RELIABLE if is_reliable else ReliabilityPolicy.BEST_EFFORT
        qos = QoSProfile(depth=_DEPTH, reliability=best, durability=durability)
        return PolledSubscription(self._node, MarkerArray, self._topic, qos, gives_way=True)
