# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Demonstrations of several recordings, with a report or a refusal for each recording."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

from ..exceptions import RecordingError, listed
from .checks import ABSURD
from .demonstration import Demonstration
from .recording import DROPPED, REPAIRS, Recording, Refusal

NORMALISED = (
    "its values are from -100 to 100, as degrees of an SO-100 or SO-101 may be: if they are "
    "LeRobot's shares of the calibrated ranges, pass --scale CALIBRATION.json (scale= in Python) "
    "instead of --degrees (degrees=True)"
)
"""The note on a dataset whose values may be no degrees."""


@dataclass(frozen=True)
class RecordingSet:
    """Demonstrations from several recordings, with a report or a refusal for each of these.

    Attributes
    ----------
    reports : sequence of Recording
        The recordings that are used, without their samples.
    refused : sequence of Refusal
        One for each that is not.
    notes : sequence of str
        Findings on the set, one sentence each.
    """

    reports: Sequence[Recording] = ()
    refused: Sequence[Refusal] = ()
    notes: Sequence[str] = ()

    @cached_property
    def demonstrations(self) -> tuple[Demonstration, ...]:
        """The motions of all recordings, in order."""
        return tuple(motion for one in self.reports for motion in one.motions)

    def __len__(self) -> int:
        return len(self.demonstrations)

    def __iter__(self) -> Iterator[Demonstration]:
        return iter(self.demonstrations)

    def __getitem__(self, index: int) -> Demonstration:
        return self.demonstrations[index]

    def __repr__(self) -> str:
        return (
            f"RecordingSet: {len(self.demonstrations)} demonstrations of {len(self.reports)} "
            f"recording(s), {len(self.refused)} rejected"
        )

    @property
    def repairs(self) -> dict[str, int]:
        """Repairs in all recordings, by kind."""
        totals = Counter[str]()
        for one in self.reports:
            totals.update(one.repairs)
        return {kind: count for kind, count in sorted(totals.items()) if count}

    @property
    def report(self) -> str:
        """What was repaired, dropped and rejected, one line for each kind and note."""
        repairs = []
        for kind, count in sorted(self.repairs.items(), key=lambda one: one[0] in DROPPED):
            what, n = "dropped" if kind in DROPPED else "repaired", len(self.reports)
            where = f"{sum(kind in one.repairs for one in self.reports)} of {n} recording(s)"
            repairs.append(f"{what}: {count} {kind} in {where} ({REPAIRS[kind]})")
        return "\n".join(
            [
                f"{len(self.demonstrations)} motions in {len(self.reports)} usable recording(s)",
                *repairs,
                *self.notes,
                *(
                    f"{listed(several, 3)}: {note}"
                    for note, several in self._names_by_note().items()
                ),
                *(f"rejected {one.recording}: {one.reason}" for one in self.refused),
            ]
        )

    @property
    def warning(self) -> str:
        """Why recordings and motions are not used, in one sentence; empty if all are."""
        not_used = self._not_used()
        return f"{not_used}; print(demonstrations.report) lists all defects" if not_used else ""

    def _not_used(self) -> str:
        found = []
        if self.refused:
            n, first = len(self.refused), self.refused[0]
            found.append(
                f"{n} of {n + len(self.reports)} recordings are rejected (first "
                f"'{first.recording}': {first.reason})"
            )
        if n := self.repairs.get("cut_off", 0):
            why = REPAIRS["cut_off"].split(": ")[1]
            found.append(f"{n} of {n + len(self.demonstrations)} motions are dropped ({why})")
        return "; ".join(found)

    @property
    def unit_warning(self) -> str:
        """A sentence on joints that seem to be in other units; empty if none do."""
        return "; ".join(
            f"{listed(names, 3)}: {note}"
            for note, names in self._names_by_note().items()
            if note == NORMALISED or ABSURD in note
        )

    def _names_by_note(self) -> dict[str, list[str]]:
        """Names of the recordings that have each note."""
        names: dict[str, list[str]] = {}
        for one in self.reports:
            for note in one.notes:
                names.setdefault(note, []).append(one.name)
        return names

    def require_motion(self) -> None:
        """Raise a RecordingError, with the first reason, if no recording holds a motion."""
        if not self.demonstrations:
            raise RecordingError(f"no motion was found: {self._not_used()}")
