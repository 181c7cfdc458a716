# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Keys at a real terminal, and lines of another program."""

from __future__ import annotations

import os
import termios
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from mp_pca_planner.cli.teach import Keys


@contextmanager
def standard_input(monkeypatch: pytest.MonkeyPatch, descriptor: int) -> Iterator[None]:
    with open(descriptor, encoding="utf-8") as stream:
        monkeypatch.setattr("sys.stdin", stream)
        yield


def test_each_line_is_one_key_and_the_end_is_known(monkeypatch: pytest.MonkeyPatch) -> None:
    reader, writer = os.pipe()
    with standard_input(monkeypatch, reader), Keys() as keys:
        assert keys.pressed(0.0) == ""
        os.write(writer, b"Discard\n\nb\nq")
        assert [keys.pressed(0.0) for _ in range(3)] == ["d", "b", ""]
        os.write(writer, b"uit\ny")
        os.close(writer)
        assert [keys.pressed(0.0) for _ in range(3)] == ["q", "y", None]
        assert keys.answer() is False


@pytest.mark.parametrize(("text", "is_yes"), [(b"y\n", True), (b"n\ny\n", False), (b"", False)])
def test_only_a_y_is_a_yes(monkeypatch: pytest.MonkeyPatch, text: bytes, is_yes: bool) -> None:
    reader, writer = os.pipe()
    os.write(writer, text)
    os.close(writer)
    with standard_input(monkeypatch, reader), Keys() as keys:
        assert keys.answer() is is_yes


def test_keys_of_a_terminal_count_at_once_and_its_settings_return(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    person, terminal = os.openpty()
    with standard_input(monkeypatch, terminal):
        before = termios.tcgetattr(terminal)
        with Keys() as keys:
            os.write(person, b"dB")
            assert [keys.pressed(1.0), keys.pressed(1.0)] == ["d", "b"]
            assert keys.pressed(0.0) == ""
        assert termios.tcgetattr(terminal) == before
    os.close(person)
