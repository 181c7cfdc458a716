# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Where demonstrations come from."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..exceptions import PrimitiveError
from ..rows import row_blocks

_FACTS = ("recording", "label", "checksum", "start_time_s", "end_time_s")


class MotionSource(NamedTuple):
    """Where a demonstration comes from.

    Attributes
    ----------
    recording, label, checksum : str
        Of the demonstration.
    start_time, end_time : float
        When it starts and ends, in seconds after the first message of the recording.
    """

    recording: str
    label: str
    checksum: str
    start_time: float
    end_time: float

    @classmethod
    def of_facts(cls, facts: Mapping[str, Any]) -> MotionSource:
        """The source with these facts (see :func:`source_rows`); the checksum may be missing."""
        return cls(*(facts.get(name, "") for name in _FACTS))

    @property
    def identity(self) -> tuple[str, float, float]:
        """Equal for the same part of the same recording, whatever its name and label."""
        return self.checksum, round(self.start_time, 6), round(self.end_time, 6)


def source_rows(sources: Iterable[MotionSource]) -> NDArray[np.bytes_]:
    """Sources as rows of JSON: objects of Python take several times the memory.

    Each row has the facts of a source, by their names in the metadata of a primitive.
    """
    encode = json.JSONEncoder(sort_keys=True).encode
    rows = [encode(dict(zip(_FACTS, source, strict=True))) for source in sources]
    return np.array(rows, dtype=np.bytes_)


class MotionSources(Sequence[Any]):
    """The sources in the rows of :func:`source_rows`, each made when it is used.

    Parameters
    ----------
    rows : array of bytes, shape (n_demonstrations,)
        The rows.
    as_facts : bool
        Whether the items are the facts.
    """

    def __init__(self, rows: NDArray[np.bytes_], *, as_facts: bool = False) -> None:
        self._rows = rows
        self._item: Callable[[Any], Any] = dict if as_facts else MotionSource.of_facts

    def __len__(self) -> int:
        return len(self._rows)

    def __getitem__(self, index: Any) -> Any:
        return self._item(json.loads(self._rows[index]))

    def __iter__(self) -> Iterator[Any]:
        for text in self.texts():
            yield from map(self._item, json.loads(f"[{text}]"))

    def labels(self) -> list[str]:
        """The labels of all."""
        return [json.loads(row).get("label", "") for row in self._rows]

    def texts(self) -> Iterator[str]:
        """The JSON of all facts without the brackets around them, in blocks."""
        for (block,) in row_blocks(self._rows):
            yield b", ".join(block.tolist()).decode()


def indices_of(name: str, motions: Iterable[MotionSource]) -> list[int]:
    """Indices of the demonstrations of a recording; none if there is no such recording.

    Parameters
    ----------
    name :
        Its name, or its checksum, or the first 8 or more digits of that.
    motions :
        The demonstrations.

    Raises
    ------
    PrimitiveError
        If several recordings have this name.
    """
    found = {
        i: motion.checksum
        for i, motion in enumerate(motions)
        if motion.recording == name or (len(name) >= 8 and motion.checksum.startswith(name))
    }
    checksums = sorted(set(found.values()))
    if len(checksums) > 1:
        raise PrimitiveError(
            f"several recordings are called '{name}': name one by its checksum, "
            + " or ".join(checksum[:12] for checksum in checksums)
        )
    return list(found)
