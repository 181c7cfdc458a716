# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""What commands print: foreign text stays on its line."""

import unicodedata

import pytest

from mp_pca_planner.exceptions import printable


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("Schulter_関節 ½∫‖τ‖²dt → 5°, ρ̂", "Schulter_関節 ½∫‖τ‖²dt → 5°, ρ̂"),
        ("a\nb\r\tc", r"a\nb\r\tc"),
        ("\x1b]0;title\x07\x9b31m", r"\x1b]0;title\x07\x9b31m"),
        ("\u202egnp.exe\u2066\u200b", r"\u202egnp.exe\u2066\u200b"),
        ("bad\udcff", r"bad\udcff"),
    ],
)
def test_printable_escapes_what_moves_the_cursor_or_the_text(text: str, shown: str) -> None:
    assert printable(text) == shown


def test_printable_leaves_no_control_format_or_surrogate_character() -> None:
    shown = printable("".join(map(chr, range(0x110000))))
    assert not {unicodedata.category(c) for c in shown} & {"Cc", "Cf", "Cs", "Zl", "Zp"}
    shown.encode()
