# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A folder of primitive files with all earlier versions and a journal of changes.

    library/NAME.npz                 the primitives in use; any reader takes these
    library/.versions/NAME/0001.npz  every version of each, never changed
    library/.versions/journal.jsonl  one line per change

A change is made under a lock, so that several processes may change a library at once. Its files are
written to temporary names first; then the version, the file in use and the journal are renamed,
each atomically. The journal is authoritative: a change that is not in it was not made, and the next
change first restores the files in use. Reading the history changes nothing.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from functools import partial
from itertools import count
from pathlib import Path

from ..exceptions import PrimitiveError, quote_names, unknown_name
from ..files import Content
from .file import load_primitive, primitive_bytes, write_primitive
from .library_folder import LibraryFolder
from .library_journal import (
    ADD,
    RETIRE,
    ROLLBACK,
    Change,
    change_now,
    check_name,
    locked,
    provenance_of,
    version_to_restore,
)
from .primitive import MovementPrimitive


class VersionedLibrary(LibraryFolder):
    """A folder of primitives with its history, and the changes of it."""

    def add(self, primitive: MovementPrimitive, note: str = "") -> Change:
        """Put a primitive into use; an earlier one of the same name is kept as a version.

        Raises
        ------
        PrimitiveError
            If its name is no file name, or it moves other joints than those in use.
        """
        with locked(self.folder, self.versions):
            return self._change([primitive], [], {}, note)[0]

    def change(
        self,
        primitives: Sequence[MovementPrimitive],
        retired: Collection[str],
        kept: Mapping[str, Content | None],
        *,
        n_before: int,
        note: str = "",
    ) -> tuple[Change, ...]:
        """Put primitives into use and take others out of use, all together or none.

        Parameters
        ----------
        primitives :
            The primitives; one that is in use as it is does not change.
        retired :
            Names of primitives in use.
        kept :
            Content of files to keep beside the versions, by name; None: the file is deleted.
        n_before : int
            Number of changes in the history that these ones are based on.
        note : str
            Reason of the changes.

        Raises
        ------
        PrimitiveError
            If a name is no file name, a primitive moves other joints than those that stay, or
            another process has changed the library meanwhile.
        """
        with locked(self.folder, self.versions):
            if len(self.history()) != n_before:
                raise PrimitiveError(f"the library '{self.folder}' changed meanwhile: try again")
            used = self.in_use()
            new = [
                primitive
                for primitive in primitives
                if primitive.name not in used
                or primitive_bytes(primitive) != self.content(primitive.name, used[primitive.name])
            ]
            return self._change(new, retired, kept, note)

    def retire(self, name: str, note: str = "") -> Change:
        """Take a primitive out of use; its versions are kept.

        Raises
        ------
        PrimitiveError
            If none of this name is in use.
        """
        with locked(self.folder, self.versions):
            self._adopt(name)
            if name not in self.in_use():
                raise PrimitiveError(unknown_name("primitive in use", name, self.in_use()))
            return self._change([], [name], {}, note)[0]

    def roll_back(self, name: str, version: int | None = None, note: str = "") -> Change:
        """Put an earlier version of a primitive into use again.

        Parameters
        ----------
        name : str
            Name of the primitive.
        version : int, optional
            The version; the one that was in use before the present one unless given.
        note : str
            Reason of the change.

        Raises
        ------
        PrimitiveError
            If there is no such version.
        """
        with locked(self.folder, self.versions):
            version = version_to_restore(self.history(), name, version)
            primitive = load_primitive(self.file_of(name, version))
            self._check_joints([primitive], [])
            change = change_now(ROLLBACK, name, version, provenance_of(primitive), note)
            files = {self.file_in_use(name): self.content(name, version)}
            return self.make([change], files)[0]

    def _change(
        self,
        primitives: Sequence[MovementPrimitive],
        retired: Collection[str],
        kept: Mapping[str, Content | None],
        note: str,
    ) -> tuple[Change, ...]:
        for primitive in primitives:
            check_name(primitive.name)
        self._check_joints(primitives, retired)
        for primitive in primitives:
            self._adopt(primitive.name)
        changes: list[Change] = []
        files: dict[Path, Content | None] = {}
        for primitive in primitives:
            change, own = self._addition(primitive, note)
            changes.append(change)
            files |= own
        for name in retired:
            changes.append(change_now(RETIRE, name, None, {}, note))
            files[self.file_in_use(name)] = None
        files |= {self.versions / name: content for name, content in kept.items()}
        return self.make(changes, files)

    def _check_joints(
        self, primitives: Sequence[MovementPrimitive], retired: Collection[str]
    ) -> None:
        """Reject primitives of other joints than those that stay in use, or than each other."""
        replaced = {*retired, *(primitive.name for primitive in primitives)}
        stays = [item for item in self.in_use().items() if item[0] not in replaced]
        # All that stay move the same joints: the first one is enough.
        known = [load_primitive(self.file_of(*item)) for item in stays[:1]] if primitives else []
        every = [*known, *primitives]
        for other in every[1:]:
            if other.joint_names != every[0].joint_names:
                raise PrimitiveError(
                    f"'{other.name}' moves {quote_names(other.joint_names)}, but "
                    f"'{every[0].name}' of the library moves {quote_names(every[0].joint_names)}: "
                    "use another library"
                )

    def _adopt(self, name: str) -> None:
        """Keep a file that was copied into the folder as a version before it is replaced."""
        file = self.file_in_use(name)
        if name not in self.in_use() and file.exists():
            change, files = self._addition(load_primitive(file), "was in the folder already", name)
            self.make([change], files)

    def _addition(
        self, primitive: MovementPrimitive, note: str, name: str = ""
    ) -> tuple[Change, dict[Path, Content | None]]:
        """The change that adds a primitive, and its files."""
        name, content = name or primitive.name, partial(write_primitive, primitive)
        known = [c.version or 0 for c in self.history() if c.name == name]
        # A version that the journal does not name was left by a process that was killed.
        free = (v for v in count(max(known, default=0) + 1) if not self.file_of(name, v).exists())
        version = next(free)
        change = change_now(ADD, name, version, provenance_of(primitive), note)
        return change, {self.file_of(name, version): content, self.file_in_use(name): content}
