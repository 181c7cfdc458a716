# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Sets of primitives that are used together, in memory or in files."""

from __future__ import annotations

from collections.abc import Callable, KeysView, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import overload

import numpy as np

from ...arrays import FloatArray, check_type
from ...exceptions import GoalError, PrimitiveError, quote_names, shown, unknown_name
from ..file import load_primitive
from ..primitive import MovementPrimitive
from ..primitive_values import require_same_joints
from .index import index_files, load_unchanged


@dataclass(frozen=True)
class LibraryOptions:
    """Options of reading many primitive files.

    Attributes
    ----------
    max_loaded : int
        Largest number of files that are read at once. Of more, an index is kept in their folder,
        and each file is read when its primitive is used.
    max_kept : int
        Number of primitives that stay in memory then, those used last.
    max_ends : int
        Largest number of ends of demonstrations from which poses are searched.
    """

    max_loaded: int = 500
    max_kept: int = 1000
    max_ends: int = 5000


_OPTIONS = LibraryOptions()


class PrimitiveLibrary(Sequence[MovementPrimitive]):
    """Primitives of the same joints with different names.

    Parameters
    ----------
    names : sequence of str
        Their names.
    joint_names : tuple of str
        Their joints.
    means : array, shape (n_primitives, 2 n_joints + 1)
        Their mean requests, see :class:`.ConditionalModel`.
    precisions : array, shape (n_primitives, 2 n_joints + 1, 2 n_joints + 1)
        Inverse covariances of their requests.
    load : callable
        Returns the primitive of an index.

    Raises
    ------
    PrimitiveError
        If two have the same name.
    """

    def __init__(
        self,
        names: Sequence[str],
        joint_names: tuple[str, ...],
        means: FloatArray,
        precisions: FloatArray,
        load: Callable[[int], MovementPrimitive],
    ) -> None:
        self.joint_names, self.means, self.precisions = joint_names, means, precisions
        self._index_of = {name: i for i, name in enumerate(names)}
        self._load = load
        if len(self._index_of) < len(names):
            twice = sorted({name for i, name in enumerate(names) if self._index_of[name] != i})
            raise PrimitiveError(f"several primitives are called {quote_names(twice)}")

    @classmethod
    def of(cls, primitives: MovementPrimitive | Sequence[MovementPrimitive]) -> PrimitiveLibrary:
        """A library of primitives in memory, or of a single one; a library is returned as it is.

        Raises
        ------
        PrimitiveError
            If there is no primitive, two have the same name, they move different joints, or one is
            something else, such as a path.
        """
        if isinstance(primitives, PrimitiveLibrary):
            return primitives
        if not isinstance(primitives, Sequence):
            primitives = [primitives]
        if not primitives:
            raise PrimitiveError("at least one primitive is needed, got none")
        for one in primitives:
            if not isinstance(one, MovementPrimitive):
                raise PrimitiveError(
                    f"{shown(one)} is not a movement primitive; MovementPrimitive.load reads a file"
                )
        require_same_joints((f"primitive '{p.name}'", p.joint_names) for p in primitives)
        return cls(
            [p.name for p in primitives],
            primitives[0].joint_names,
            np.array([p.model.mean for p in primitives]),
            np.array([p.model.request_precision for p in primitives]),
            tuple(primitives).__getitem__,
        )

    @property
    def names(self) -> KeysView[str]:
        """Their names."""
        return self._index_of.keys()

    @cached_property
    def ends(self) -> FloatArray:
        """Starts and goals of demonstrations, shape (n_motions, 2, n_joints).

        Of primitives in files, their means.
        """
        n = len(self.joint_names)
        ends = self.means[:, : 2 * n].reshape(-1, 2, n)
        if len(self) <= _OPTIONS.max_loaded:
            ends = np.concatenate([p.boundary_states[:, [0, 3]] for p in self])
        return ends[:: -(-len(ends) // _OPTIONS.max_ends)]

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
        indices = range(len(self))[index]
        return self._load(indices) if isinstance(indices, int) else [*map(self._load, indices)]


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
    if len(files) > _OPTIONS.max_loaded:
        return _library_in_files(files)
    primitives = [load_primitive(file) for file in files]
    _check_together(files, [(p.name, p.joint_names) for p in primitives])
    return PrimitiveLibrary.of(primitives)


def _library_in_files(files: Sequence[Path]) -> PrimitiveLibrary:
    """A library that reads each file when its primitive is used."""
    files_in: dict[Path, list[Path]] = {}
    for file in files:
        files_in.setdefault(file.parent, []).append(file)
    indices = [index_files(folder, [x.name for x in own]) for folder, own in files_in.items()]
    paths = [path for own in files_in.values() for path in own]
    primitives = [(name, index.joint_names) for index in indices for name in index.names]
    stamps = np.concatenate([index.stamps for index in indices]).tolist()
    _check_together(paths, primitives)
    return PrimitiveLibrary(
        [name for name, _ in primitives],
        indices[0].joint_names,
        np.concatenate([index.means for index in indices]),
        np.concatenate([index.precisions for index in indices]),
        lru_cache(_OPTIONS.max_kept)(lambda i: load_unchanged(paths[i], *primitives[i], stamps[i])),
    )


def _check_together(
    files: Sequence[Path], primitives: Sequence[tuple[str, tuple[str, ...]]]
) -> None:
    """Reject primitives, given with their joints, that can't be used together."""
    origin: dict[str, Path] = {}
    for file, (name, _) in zip(files, primitives, strict=True):
        other = origin.setdefault(name, file)
        if other is not file:
            raise PrimitiveError(
                f"'{file}' and '{other}' both hold a primitive called '{name}': build "
                "one of them again under another name"
            )
    joints = (joint_names for _, joint_names in primitives)
    require_same_joints(zip((f"'{file}'" for file in files), joints, strict=True))
