# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Results of many recordings, in temporary files, so that their number takes no memory."""

from __future__ import annotations

import os
import pickle
import tempfile
from array import array
from collections.abc import Iterator, Sequence
from dataclasses import fields
from typing import Any, TypeVar, overload

import numpy as np

from ..exceptions import RecordingError
from .recording_set import RecordingReport, RecordingSet, Refusal

Value = TypeVar("Value")


class Spool(Sequence[Value]):
    """The values of all groups, in order. Sixteen bytes of memory are held for each group.

    Parameters
    ----------
    n_groups : int
        Number of groups, each empty at first.
    """

    def __init__(self, n_groups: int) -> None:
        # Unnamed: the system removes it when the process ends, however it ends.
        self._file = tempfile.TemporaryFile(prefix="mp_pca_planner-")  # noqa: SIM115
        self._places = array("q", [-1]) * n_groups
        self._lengths = array("q", [0]) * n_groups

    def put(self, group: int, values: Sequence[Value]) -> None:
        """Set the values of a group.

        Raises
        ------
        RecordingError
            If there is no space for them.
        """
        self._lengths[group] = len(values)
        if not values:
            return
        try:
            self._places[group] = self._file.seek(0, os.SEEK_END)
            pickle.dump(values, self._file)
            self._file.flush()  # a process that is forked must not write it again
        except OSError as error:
            raise RecordingError(
                f"the data read can't be kept in '{tempfile.gettempdir()}' ({error.strerror}): set "
                "TMPDIR to a folder with more space"
            ) from None

    def group(self, group: int) -> Sequence[Value]:
        """The values of a group."""
        if not self._lengths[group]:
            return ()
        self._file.seek(self._places[group])
        found: Sequence[Value] = pickle.load(self._file)  # written by this process
        return found

    def __iter__(self) -> Iterator[Value]:
        for group in range(len(self._lengths)):
            yield from self.group(group)

    def __len__(self) -> int:
        return sum(self._lengths)

    @overload
    def __getitem__(self, index: int) -> Value: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[Value]: ...
    def __getitem__(self, index: int | slice) -> Value | Sequence[Value]:
        indices = range(len(self))[index]
        if isinstance(indices, range):
            return [self[i] for i in indices]
        ends = np.cumsum(self._lengths)
        group = int(np.searchsorted(ends, indices, "right"))
        return self.group(group)[indices - int(ends[group])]


class GatheredSets:
    """Results by recording, in memory or in temporary files."""

    def __init__(self, n_recordings: int, *, on_disk: bool) -> None:
        names = [f.name for f in fields(RecordingSet)] if on_disk else []
        self._spools: dict[str, Any] = {name: Spool[Any](n_recordings) for name in names}
        self._sets = [RecordingSet()] * n_recordings

    def __setitem__(self, index: int, found: RecordingSet) -> None:
        if not self._spools:
            self._sets[index] = found
        for name, spool in self._spools.items():
            spool.put(index, getattr(found, name))

    def found(self, index: int) -> tuple[Sequence[RecordingReport], Sequence[Refusal]]:
        """The report of a recording if it is used, else its refusal."""
        if not self._spools:
            return self._sets[index].reports, self._sets[index].refused
        return self._spools["reports"].group(index), self._spools["refused"].group(index)

    def refuse(self, index: int, name: str, reason: str) -> None:
        """Reject a recording after all."""
        self[index] = RecordingSet(refused=(Refusal(name, reason),))

    def result(self) -> RecordingSet:
        """The results of all recordings, in order."""
        if self._spools:
            return RecordingSet(**self._spools)
        names = (f.name for f in fields(RecordingSet))
        return RecordingSet(*(tuple(x for s in self._sets for x in getattr(s, n)) for n in names))
