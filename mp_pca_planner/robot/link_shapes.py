# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Collision shapes of the links of a robot."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pinocchio as pin

from ..exceptions import RobotError, WorldError
from ..input_limits import INPUT_LIMITS
from .mesh_files import find_mesh, scaled
from .mesh_pieces import whole_piece
from .shapes import NO_VOLUME, Box, Cylinder, Mesh, Shape, Sphere
from .solids import Solid, link_solid, solids_of
from .urdf import Description
from .urdf_elements import StatedShape


class LinkShapes:
    """The collision shapes of a URDF for the distance library.

    Parameters
    ----------
    description : Description
        The URDF.
    package_dirs : sequence of Path
        Folders of the packages that ``package://`` paths of meshes name.
    source : str
        Name of the description in messages.

    Attributes
    ----------
    solids : tuple of Solid
        The shapes.
    notes : tuple of str
        What is unusual about shapes, as sentences.

    Raises
    ------
    RobotError
        If a shape can't be used, a mesh can't be found or read, or there are too many.
    """

    def __init__(self, description: Description, package_dirs: Sequence[Path], source: str) -> None:
        for link, problem in description.lost_shapes.items():
            raise RobotError(f"{source}: <collision> of link '{link}': {problem}")
        count, most = sum(map(len, description.shapes.values())), INPUT_LIMITS.robot_shapes
        if count > most:
            raise RobotError(f"{source} has {count} collision shapes, at most {most} are accepted")
        self._links, self._places = list[str](), list[Any]()
        solids, notes, n_triangles = list[Solid](), list[str](), 0
        for link, stated in (
            (link, one) for link, many in description.shapes.items() for one in many
        ):
            try:
                shape = _shape(stated, package_dirs)
            except WorldError as error:
                raise RobotError(f"{source}: <collision> of link '{link}': {error}") from None
            if isinstance(shape, Mesh):
                n_triangles += len(shape.triangles)
                if n_triangles > (most := INPUT_LIMITS.mesh_triangles):
                    raise RobotError(
                        f"the collision meshes of the {source} have more than {most} triangles"
                    )
                piece = whole_piece(shape.vertices, shape.triangles)
                solids.append(link_solid(piece))
                notes += [f"link '{link}': {NO_VOLUME}"] if piece.is_thin else []
            else:
                solids += solids_of(shape)
            place = pin.SE3(pin.rpy.rpyToMatrix(*stated.origin[3:]), stated.origin[:3])
            self._links.append(link)
            self._places.append(place)
        self.solids, self.notes = tuple(solids), tuple(dict.fromkeys(notes))

    def __iter__(self) -> Iterator[tuple[str, Any, Solid]]:
        """The link, the placement on the link, and the shape of each one."""
        return zip(self._links, self._places, self.solids, strict=True)


def _shape(stated: StatedShape, package_dirs: Sequence[Path]) -> Shape:
    sizes = stated.sizes
    if stated.kind == "box":
        return Box(sizes)
    if stated.kind == "sphere":
        return Sphere(float(sizes[0]))
    if stated.kind == "cylinder":
        return Cylinder(float(sizes[0]), float(sizes[1]))
    found = find_mesh(stated.file, package_dirs)
    return Mesh(scaled(found.vertices, sizes), found.triangles)
