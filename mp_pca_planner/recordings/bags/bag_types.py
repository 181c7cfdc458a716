# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Types of the messages of a bag, and joint states within other messages."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from typing import Any

from ...exceptions import RecordingError, unknown_name
from .discovery import BagFormat
from .serialisation import (
    JOINT_STATE,
    Types,
    decoder,
    defined_types,
    encoder,
    field_of_states,
    known_types,
)
from .storage import Key


class BagTypes:
    """Types of messages, as rosbags knows them or as the bag defines them.

    Parameters
    ----------
    bag_format :
        Format of the bag.
    definitions :
        Definitions in the bag as .msg text, by topic and type.
    """

    def __init__(self, bag_format: BagFormat, definitions: Mapping[Key, str]) -> None:
        self._format, self._definitions = bag_format, definitions
        self._defined: dict[Key, Types] = {}

    def decode(self, key: Key, data: bytes) -> Any:
        """Deserialise a message of a known type, else of a type that the bag defines."""
        known = known_types(self._format)
        types = known if key[1] in known.types else self._own(key)
        return decoder(types, self._format)(data, key[1])

    def states_field(self, key: Key) -> str:
        """Name of a field that is a JointState, '' if the type has none."""
        return field_of_states(self._own(key), key[1])

    def field_reader(self, key: Key, field: str) -> Callable[[bytes], bytes]:
        """A function from a message to the joint states in a field of it, both serialised."""
        decode = decoder(self._own(key), self._format)
        encode = encoder(known_types(self._format), self._format)
        return lambda data: bytes(encode(_field(decode(data, key[1]), field), JOINT_STATE))

    def _own(self, key: Key) -> Types:
        """Types as the bag itself defines them."""
        if key not in self._defined:
            if key not in self._definitions:
                raise RecordingError(
                    f"'{key[0]}' has messages of type {key[1]}, which the bag does not define "
                    "as .msg text: only fields of defined messages can be read"
                )
            self._defined[key] = defined_types(self._definitions[key], key[1])
        return self._defined[key]


def _field(message: Any, field: str) -> Any:
    for name in field.split("."):
        valid = [item.name for item in fields(message)] if is_dataclass(message) else []
        if name not in valid:
            raise RecordingError(unknown_name(f"field of '{field}'", name, valid))
        message = getattr(message, name)
    kind = getattr(message, "__msgtype__", type(message).__name__)
    if kind != JOINT_STATE:
        raise RecordingError(f"the field '{field}' is a {kind}; expected a {JOINT_STATE}")
    return message
