# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""JSON of external files: bounded parsing, and a check of types and keys."""

from __future__ import annotations

import json
from typing import Any

from .input_limits import INPUT_LIMITS

_WORDS = {
    str: "text",
    int: "an integer",
    float: "a number",
    bool: "true or false",
    dict: "an object",
    type(None): "null",
}


def load_json(text: str | bytes) -> Any:
    """Parse JSON with bounded integers.

    Raises
    ------
    ValueError, RecursionError
        If the text is malformed or exceeds a bound: call it within :func:`.files.reading`.
    """
    return json.loads(text, parse_int=_bounded_integer)


def check_form(value: Any, form: Any, name: str) -> None:
    """Reject a JSON value that has another form than the given one.

    Parameters
    ----------
    value :
        The value.
    form :
        A type or several, float for any number; ``[form]``: a list of any length;
        ``{str: form}``: an object with any keys; ``{"key": form, "other?": form}``: one with
        at least these keys, of which the last may be absent.
    name : str
        Name of the value in the message.

    Raises
    ------
    ValueError
        If the forms differ; the message names the part.
    """
    if isinstance(form, list):
        _expect(isinstance(value, list), name, "a list", value)
        for i, part in enumerate(value):
            check_form(part, form[0], f"{name}[{i}]")
    elif isinstance(form, dict):
        _expect(isinstance(value, dict), name, "an object", value)
        if str in form:
            form = dict.fromkeys(value, form[str])
        for key, part in form.items():
            word = key.removesuffix("?")
            if word in value or word == key:
                _expect(word in value, name, f"an object with '{word}'", value)
                check_form(value[word], part, f"{name}.{word}")
    else:
        kinds = form if isinstance(form, tuple) else (form,)
        accepted = (*kinds, int) if float in kinds else kinds
        fits = isinstance(value, accepted) and (not isinstance(value, bool) or bool in kinds)
        _expect(fits, name, " or ".join(_WORDS[kind] for kind in kinds), value)


def _expect(fits: bool, name: str, expected: str, value: Any) -> None:
    if not fits:
        raise ValueError(f"{name} is {value!r:.40}, expected {expected}")


def _bounded_integer(text: str) -> int:
    if len(text) > INPUT_LIMITS.json_digits:
        raise ValueError(f"an integer has more than {INPUT_LIMITS.json_digits} digits")
    return int(text)
