# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Letters of a person at a terminal, and of another program."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from mp_pca_planner.cli.teach import Keys


@contextmanager
def standard_input(monkeypatch: pytest.MonkeyPatch, descriptor: int) -> Iterator[None]:
    with open(descriptor, encoding="utf-8") as stream:
        monkeypatch.setattr("sys.stdin", stream)
        yield


def test_each_line_is_one_letter_and_the_end_is_known(monkeypatch: pytest.MonkeyPatch) -> None:
    reader, writer = os.pipe()
    with standard_input(monkeypatch, reader):
        keys = Keys()
        assert keys.pressed(0.0) == ""
        os.write(writer, b"Discard\n\nb\nq")
        assert [keys.pressed(0.0) for _ in range(4)] == ["d", "", "b", ""]
        os.write(writer, b"uit\ny")
        os.close(writer)
        assert [keys.pressed(0.0) for _ in range(3)] == ["q", "y", None]
        assert keys.answer() is False


@pytest.mark.parametrize(("text", "is_yes"), [(b"y\n", True), (b"n\ny\n", False), (b"", False)])
def test_only_a_y_is_a_yes(monkeypatch: pytest.MonkeyPatch, text: bytes, is_yes: bool) -> None:
    reader, writer = os.pipe()
    os.write(writer, text)
    os.close(writer)
    with standard_input(monkeypatch, reader):
        assert Keys().answer() is is_yes


def test_what_was_typed_before_the_question_is_no_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    person, terminal = os.openpty()
    with standard_input(monkeypatch, terminal):
        keys = Keys()
        os.write(person, b"y\ny\n")
        assert keys.pressed(1.0) == "y"
        answering = threading.Timer(0.3, os.write, (person, b"n\n"))
        answering.start()
        assert keys.answer() is False
        answering.join()
    os.close(person)
