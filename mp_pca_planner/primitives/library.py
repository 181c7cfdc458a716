# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Sets of primitives that are used together."""

from __future__ import annotations

from collections.abc import KeysView, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import overload

import numpy as np

from ..arrays import FloatArray, check_type, repeated_names
from ..exceptions import GoalError, PrimitiveError, quote_names, shown, unknown_name
from .file import load_primitive
from .primitive import MovementPrimitive

# Largest number of ends of demonstrations from which poses are searched.
_MAX_ENDS = 5000


class PrimitiveLibrary(Sequence[MovementPrimitive]):
    """Primitives of the same joints with different names.

    Parameters
    ----------
    primitives : sequence of MovementPrimitive
        The primitives, at least one.

    Attributes
    ----------
    joint_names : tuple of str
        Their joints.
    means : array, shape (n_primitives, 2 n_joints + 1)
        Their mean requests, see :class:`.ConditionalModel`.
    precisions : array, shape (n_primitives, 2 n_joints + 1, 2 n_joints + 1)
        Inverse covariances of their requests.

    Raises
    ------
    PrimitiveError
        If there is no primitive, two have the same name, they move different joints, or one is
        something else, such as a path.
    """

    def __init__(self, primitives: Sequence[MovementPrimitive]) -> None:
        if not primitives:
            raise PrimitiveError("at least one primitive is needed, got none")
        for one in primitives:
            if not isinstance(one, MovementPrimitive):
                raise PrimitiveError(
                    f"{shown(one)} is not a movement primitive; MovementPrimitive.load reads a file"
                )
        _require_same_joints({f"primitive '{p.name}'": p for p in primitives})
        self._index_of = {p.name: i for i, p in enumerate(primitives)}
        if len(self._index_of) < len(primitives):
            twice = repeated_names(p.name for p in primitives)
            raise PrimitiveError(f"several primitives are called {quote_names(twice)}")
        self._primitives = tuple(primitives)
        self.joint_names = primitives[0].joint_names
        self.means = np.array([p.model.mean for p in primitives])
        self.precisions = np.array([p.model.request_precision for p in primitives])

    @classmethod
    def of(cls, primitives: MovementPrimitive | Sequence[MovementPrimitive]) -> PrimitiveLibrary:
        """The library of some primitives, or of a single one; a library is returned as it is."""
        if isinstance(primitives, PrimitiveLibrary):
            return primitives
        return cls(primitives if isinstance(primitives, Sequence) else [primitives])

    @property
    def names(self) -> KeysView[str]:
        """Their names."""
        return self._index_of.keys()

    @cached_property
    def ends(self) -> FloatArray:
        """Starts and goals of demonstrations, shape (n_motions, 2, n_joints)."""
        ends = np.concatenate([p.boundary_states[:, [0, 3]] for p in self])
        return ends[:: -(-len(ends) // _MAX_ENDS)]

    def named(self, name: str) -> MovementPrimitive:
        """The primitive of that name.

        Raises
        ------
        GoalError
            If there is none.
        """
        self.check_name(name)
        return self[self._index_of[name]]

    def check_name(self, name: str) -> None:
        """Reject a name that no primitive has, see :meth:`named`."""
        check_type(name, "the name of a primitive", GoalError, str)
        if name not in self._index_of:
            raise GoalError(unknown_name("primitive", name, self._index_of))

    def __len__(self) -> int:
        return len(self._index_of)

    @overload
    def __getitem__(self, index: int) -> MovementPrimitive: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[MovementPrimitive]: ...
    def __getitem__(self, index: int | slice) -> MovementPrimitive | Sequence[MovementPrimitive]:
        return self._primitives[index]


def load_primitives(paths: Sequence[str | Path]) -> PrimitiveLibrary:
    """Read primitive files that are to be used together.

    Parameters
    ----------
    paths :
        Files, and folders of .npz files in the order of their names.

    Raises
    ------
    PrimitiveError
        If there is none, a file is rejected, two primitives have the same name, or they move
        different joints.
    """
    files: list[Path] = []
    for path in map(Path, paths):
        found = sorted(path.glob("*.npz"), key=str) if path.is_dir() else [path]
        if not found:
            raise PrimitiveError(f"the folder '{path}' holds no primitive file (.npz)")
        files += found
    if not files:
        raise PrimitiveError("no primitive file was named")
    primitives, file_of = [], dict[str, Path]()
    for file in files:
        primitives.append(load_primitive(file))
        name = primitives[-1].name
        if name in file_of:
            raise PrimitiveError(
                f"'{file}' and '{file_of[name]}' both hold a primitive called '{name}': build "
                "one of them again under another name"
            )
        file_of[name] = file
    _require_same_joints({f"'{file_of[p.name]}'": p for p in primitives})
    return PrimitiveLibrary(primitives)


def _require_same_joints(primitives: Mapping[str, MovementPrimitive]) -> None:
    """Reject primitives, given by names for the message, that differ in their joints."""
    first, joints = "", None
    for name, primitive in primitives.items():
        own = primitive.joint_names
        if joints is not None and own != joints:
            raise PrimitiveError(
                f"{name} moves {quote_names(own)}, but {first} moves {quote_names(joints)}: they "
                "can't be used together"
            )
        first, joints = name, own
