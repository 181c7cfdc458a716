# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Names of joints of one source in place of those of another: ``OLD=NEW`` with ``*``."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence

from .exceptions import PlannerError, quote_names

Rename = Mapping[str, str]
"""New names by patterns of old ones. Each ``*`` of a pattern stands for any text, also for none,
and is put in place of the ``*`` of the new name: ``{"left_*": "*"}`` strips a prefix."""


def read_rename(texts: Iterable[str]) -> dict[str, str]:
    """Patterns and new names of texts ``OLD=NEW``.

    Raises
    ------
    PlannerError
        If a text has another form.
    """
    rename = {}
    for text in texts:
        old, equals, new = (part.strip() for part in text.partition("="))
        if not (equals and old and new):
            raise PlannerError(f"'{text}' can't rename a joint: expected OLD=NEW, as in left_*=*")
        rename[old] = new
    check_rename(rename)
    return rename


def check_rename(rename: Rename) -> None:
    """Reject new names with more ``*`` than their patterns.

    Raises
    ------
    PlannerError
        If there is one.
    """
    for old, new in rename.items():
        if new.count("*") > old.count("*"):
            raise PlannerError(
                f"'{old}={new}' can't rename a joint: '{new}' has more * than '{old}'"
            )


def new_name(name: str, rename: Rename, source: str = "") -> str:
    """The new name by the first pattern that the name, or ``SOURCE/NAME``, matches."""
    for old, new in rename.items():
        if match := _match(old, name, source):
            first, *others = new.split("*")
            texts = zip(match.groups(), others, strict=False)
            return first + "".join(text + after for text, after in texts)
    return name


def notes_on_rename(rename: Rename, names: Mapping[str, Sequence[str]]) -> tuple[str, ...]:
    """A note on each pattern that matches none of the names, which are by their sources."""
    unused = [
        f"{old}={new}"
        for old, new in rename.items()
        if not any(_match(old, name, source) for source, own in names.items() for name in own)
    ]
    every = quote_names(dict.fromkeys(name for own in names.values() for name in own))
    return tuple(f"--rename {text} renames nothing: none of {every} matches" for text in unused)


def _match(pattern: str, name: str, source: str) -> re.Match[str] | None:
    whole = re.compile("(.*)".join(map(re.escape, pattern.split("*"))))
    return whole.fullmatch(name) or (whole.fullmatch(f"{source}/{name}") if source else None)
