# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Sets of primitives that are used together."""

from __future__ import annotations

from collections.abc import KeysView, Sequence
from functools import cached_property
from pathlib import Path

import numpy as np

from ..arrays import FloatArray, check_type
from ..exceptions import GoalError, PrimitiveError, quote_names, shown, unknown_name
from .file import load_primitive
from .primitive import MovementPrimitive

# Largest number of ends of demonstrations from which poses are searched.
_MAX_ENDS = 5000


class PrimitiveLibrary(tuple[MovementPrimitive, ...]):
    """Primitives of the same joints with different names, in order.

    Parameters
    ----------
    primitives : sequence of MovementPrimitive
        The primitives, at least one.
    places : sequence of str, optional
        Where each is from, for messages; by default its name.

    Attributes
    ----------
    joint_names : tuple of str
        Their joints.

    Raises
    ------
    PrimitiveError
        If there is no primitive, two have the same name, they move different joints, or one is
        something else, such as a path.
    """

    joint_names: tuple[str, ...]
    _by_name: dict[str, MovementPrimitive]

    def __new__(
        cls, primitives: Sequence[MovementPrimitive], places: Sequence[str] | None = None
    ) -> PrimitiveLibrary:
        """Check the primitives, and index them by name."""
        if not primitives:
            raise PrimitiveError("at least one primitive is needed, got none")
        first, where = primitives[0], dict[str, str]()
        for i, primitive in enumerate(primitives):
            if not isinstance(primitive, MovementPrimitive):
                what = f"{shown(primitive)} is not a movement primitive"
                raise PrimitiveError(f"{what}; MovementPrimitive.load reads a file")
            name, joint_names = primitive.name, primitive.joint_names
            place = places[i] if places else f"primitive '{name}'"
            if name in where:
                raise PrimitiveError(
                    f"{place} and {where[name]} are both called '{name}': build one of them again "
                    "under another name"
                )
            where[name] = place
            if joint_names != first.joint_names:
                raise PrimitiveError(
                    f"{place} moves {quote_names(joint_names)}, but {where[first.name]} moves "
                    f"{quote_names(first.joint_names)}: they can't be used together"
                )
        library = super().__new__(cls, primitives)
        library._by_name = {primitive.name: primitive for primitive in primitives}
        library.joint_names = first.joint_names
        return library

    @classmethod
    def of(cls, primitives: MovementPrimitive | Sequence[MovementPrimitive]) -> PrimitiveLibrary:
        """The library of some primitives, or of a single one; a library is returned as it is."""
        if isinstance(primitives, PrimitiveLibrary):
            return primitives
        return cls(primitives if isinstance(primitives, Sequence) else [primitives])

    @property
    def names(self) -> KeysView[str]:
        """Their names."""
        return self._by_name.keys()

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
        check_type(name, "the name of a primitive", GoalError, str)
        if name not in self._by_name:
            raise GoalError(unknown_name("primitive", name, self._by_name))
        return self._by_name[name]


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
        entries = sorted(path.glob("*.npz"), key=str) if path.is_dir() else [path]
        if not entries:
            raise PrimitiveError(f"the folder '{path}' holds no primitive file (.npz)")
        files += entries
    if not files:
        raise PrimitiveError("no primitive file was named")
    return PrimitiveLibrary([load_primitive(file) for file in files], [f"'{x}'" for x in files])
