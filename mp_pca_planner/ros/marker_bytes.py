# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Reading of serialised markers.

rclpy makes an object of each point, in one call that stops all threads of the process: 0.2 s for
100,000 points. Here NumPy takes them as they are.
"""

from __future__ import annotations

from dataclasses import dataclass

from ..arrays import FloatArray
from ..exceptions import WorldError
from .cdr_reader import CdrReader


@dataclass(frozen=True, eq=False)
class MarkerData:
    """The fields of a visualization_msgs/Marker that describe an obstacle.

    Attributes
    ----------
    frame_id, ns, id, type, action, mesh_resource
        As in the message.
    pose : array, shape (7,)
        Position [m] and quaternion (x, y, z, w).
    scale : array, shape (3,)
        Sizes [m], or factors.
    lifetime : float
        Time after which the marker is deleted [s]; 0: never.
    points : array, shape (n_points, 3)
        Points in the frame of the pose [m].
    """

    frame_id: str
    ns: str
    id: int
    type: int
    action: int
    pose: FloatArray
    scale: FloatArray
    lifetime: float
    points: FloatArray
    mesh_resource: str

    @property
    def name(self) -> str:
        """The name of its obstacle: its namespace and number."""
        return f"{self.ns}/{self.id}" if self.ns else f"marker {self.id}"


def read_markers(content: bytes) -> list[MarkerData]:
    """The markers of a serialised visualization_msgs/MarkerArray.

    Raises
    ------
    WorldError
        If the message is malformed.
    """
    try:
        reader = CdrReader(content)
        return [_marker(reader) for _ in range(reader.count(_LEAST_BYTES))]
    except ValueError as error:
        raise WorldError(f"the message of markers is malformed: {error}") from None


# Of a marker without names, points and images.
_LEAST_BYTES = 200


def _marker(reader: CdrReader) -> MarkerData:
    reader.numbers("iI")  # stamp
    frame, namespace = reader.text(), reader.text()
    number, kind, action = reader.numbers("iii")
    pose, scale = reader.array("f8", 7), reader.array("f8", 3)
    reader.array("f4", 4)  # colour
    seconds, nanoseconds = reader.numbers("iI")
    reader.numbers("?")  # frame_locked
    points = reader.array("f8", 3 * reader.count(24)).reshape(-1, 3)
    reader.array("f4", 4 * reader.count(16))  # colours
    reader.text()  # texture
    reader.numbers("iI")
    reader.text()
    reader.text()
    reader.array("u1", reader.count(1))
    reader.array("f4", 2 * reader.count(8))  # its coordinates
    reader.text()
    mesh = reader.text()
    reader.text()  # embedded mesh
    reader.array("u1", reader.count(1))
    reader.numbers("?")
    lifetime = seconds + 1e-9 * nanoseconds
    return MarkerData(frame, namespace, number, kind, action, pose, scale, lifetime, points, mesh)
