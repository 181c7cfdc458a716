# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Bounded reading and atomic writing of files, and checks of the form of JSON."""

from __future__ import annotations

import math
import os
import stat
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import yaml

from .exceptions import PlannerError, unknown_name
from .input_limits import INPUT_LIMITS

PACKAGE = "mp_pca_planner"
INDEX_MARKER = Path("share/ament_index/resource_index/packages") / PACKAGE


def config_file(name: str) -> Path:
    """Return the path of a file shipped in ``config/``, such as ``planner.yaml``.

    Raises
    ------
    PlannerError
        If there is no such file, or the package was installed without its ``config/``.

    Examples
    --------
    >>> import mp_pca_planner as mp
    >>> mp.config_file("human_arm.urdf").name
    'human_arm.urdf'
    """
    folder = config_folder(Path(__file__))
    path = folder / name
    if not path.is_file():
        shipped = sorted(entry.name for entry in folder.iterdir() if entry.is_file())
        raise PlannerError(unknown_name("configuration file", name, shipped))
    return path


def config_folder(module: Path) -> Path:
    """Return the ``config/`` that belongs to a module file of this package.

    The search starts from the code that runs, not from the environment: two installations on one
    machine never use each other's files, and no environment has to be sourced.

    Raises
    ------
    PlannerError
        If the module is neither in a source tree nor in an installation with the ament index.
    """
    # The links of an editable or symlink installation lead back to the source tree.
    module = module.resolve()
    source_tree = module.parents[1]
    if (source_tree / "package.xml").is_file():
        return source_tree / "config"
    for prefix in module.parents:
        if (prefix / INDEX_MARKER).is_file():
            return prefix / "share" / PACKAGE / "config"
    raise PlannerError(
        f"no configuration files belong to '{module.parent}': expected a source tree with "
        f"package.xml, or an installation prefix above it that has '{INDEX_MARKER}'"
    )


Content = bytes | Callable[[BinaryIO], object]

_WORKSPACE = ".mp_pca_planner-tmp-"
_LFS = b"version https://git-lfs.github.com/spec/"


@contextmanager
def reading(what: str, error: type[PlannerError]) -> Iterator[None]:
    """Translate errors of parsers into the error of a format.

    Parameters
    ----------
    what : str
        Subject of the message "… can't be read: reason".
    error : type of PlannerError
        The error of the format. Other errors of this package pass unchanged.
    """
    try:
        yield
    except PlannerError:
        raise
    except Exception as problem:  # parsers raise errors of many kinds
        raise error(f"{what} can't be read: {_reason(problem)}") from None


def open_regular(path: str | Path) -> BinaryIO:
    """Open a regular file for reading.

    Raises
    ------
    OSError
        If it can't be opened.
    ValueError
        If it is a folder, a pipe or a device, which may block or never end, or a pointer of Git
        LFS instead of the file.
    """
    # Without O_NONBLOCK, opening a pipe waits for its writer.
    file = os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), "rb")
    if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
        file.close()
        raise ValueError("it is not a regular file")
    if file.read(len(_LFS)) == _LFS:
        file.close()
        raise ValueError("it is a pointer of Git LFS and not the file: run 'git lfs pull'")
    file.seek(0)
    return file


def read_bytes(path: str | Path, max_bytes: int = INPUT_LIMITS.text_bytes) -> bytes:
    """Read a regular file of at most `max_bytes`.

    Raises
    ------
    OSError
        If it can't be read.
    ValueError
        If it is no regular file, or larger.
    """
    with open_regular(path) as file:
        # The size of the file, because a read allocates what it may return.
        content = file.read(min(os.fstat(file.fileno()).st_size, max_bytes) + 1)
    if len(content) > max_bytes:
        raise ValueError(f"it is larger than {max_bytes:,} bytes, the largest size accepted")
    return content


def read_text(path: str | Path, max_bytes: int = INPUT_LIMITS.text_bytes) -> str:
    """Read a regular file of UTF-8 text, see :func:`read_bytes`; a byte order mark is removed."""
    return read_bytes(path, max_bytes).decode("utf-8-sig")


def load_yaml(text: str | bytes) -> Any:
    """Parse YAML of bounded size, without aliases.

    Raises
    ------
    yaml.YAMLError, ValueError, …
        If the text is malformed or exceeds a bound: call it within :func:`reading`.
    """
    if len(text) > INPUT_LIMITS.yaml_bytes:
        raise ValueError(
            f"it is larger than {INPUT_LIMITS.yaml_bytes:,} bytes, the largest size accepted"
        )
    if any(isinstance(event, yaml.AliasEvent) for event in yaml.parse(text, Loader=_Loader)):
        raise ValueError("aliases of YAML, such as *name, are not accepted")
    return yaml.load(text, Loader=_Loader)


class _Loader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]
    """PyYAML's safe loader, compiled if available."""


def _angle(factor: float) -> Callable[[Any, yaml.Node], float]:
    """A constructor of YAML for a number with a unit, as files for rosparam and xacro have it."""
    return lambda loader, node: factor * float(loader.construct_scalar(node))


_Loader.add_constructor("!degrees", _angle(math.pi / 180.0))
_Loader.add_constructor("!radians", _angle(1.0))


def _reason(error: Exception) -> str:
    """One line on the cause of an error."""
    if isinstance(error, UnicodeError):
        return "it is not UTF-8 text"
    if isinstance(error, RecursionError):
        return "it is nested too deeply"
    if isinstance(error, yaml.MarkedYAMLError) and error.problem_mark:
        return f"it is not YAML (line {error.problem_mark.line + 1}: {error.problem})"
    reason: str = getattr(error, "strerror", None) or " ".join(str(error).split())
    if isinstance(error, KeyError | MemoryError) or not reason:
        reason = f"{type(error).__name__} {reason}".strip()
    return reason if len(reason) <= 200 else reason[:200] + "…"


def write_whole(path: str | Path, content: Content, *, overwrite: bool = False) -> None:
    """Write a file whole or not at all.

    Parameters
    ----------
    path : str or Path
        The file.
    content : bytes or callable
        Its content, or a function that writes it into an open file.
    overwrite : bool
        Whether an existing file may be replaced.

    Raises
    ------
    PlannerError
        If it exists and may not be overwritten, or can't be written.
    """
    target = Path(path)
    try:
        if os.path.lexists(target) and not overwrite:
            raise exists_already(target)
        with workspace_beside(target) as workspace:
            written = workspace / ".new"
            with written.open("wb") as file:
                if callable(content):
                    content(file)
                else:
                    file.write(content)
                file.flush()
                os.fsync(file.fileno())
            put_in_place(written, target)
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        reason = getattr(error, "strerror", None) or error
        raise PlannerError(f"'{target}' can't be written: {reason}") from None


@contextmanager
def workspace_beside(target: Path) -> Iterator[Path]:
    """A hidden folder beside a file to write; removed afterwards.

    Raises
    ------
    PlannerError
        If a device or a pipe has the name of the file.
    """
    _check_kind(target)
    with tempfile.TemporaryDirectory(prefix=_WORKSPACE, dir=target.parent) as folder:
        yield Path(folder)


def put_in_place(source: Path, target: Path) -> None:
    """Give a complete file or folder of a workspace its name, in place of an earlier one."""
    if target.exists() and (source.is_dir() or target.is_dir()):
        os.rename(target, source.with_name(f"{source.name}.replaced"))
    os.replace(source, target)


def check_writable(path: Path, *, overwrite: bool) -> None:
    """Reject an output file that can't be written, before its content is computed.

    Raises
    ------
    PlannerError
        If it exists and may not be overwritten, is a device or a pipe, or its folder doesn't exist
        or is read-only.
    """
    if os.path.lexists(path) and not overwrite:
        raise exists_already(path)
    _check_kind(path)
    if not os.path.isdir(path.parent):
        raise PlannerError(f"'{path}' can't be written: there is no folder '{path.parent}'")
    if not os.access(path.parent, os.W_OK):
        raise PlannerError(f"'{path}' can't be written: its folder may not be changed")


def _check_kind(path: Path) -> None:
    """Reject a device or a pipe: a file in its place would take it from the whole machine."""
    is_file = path.is_file() or path.is_dir()
    is_link_to_stream = path.is_symlink() and path.absolute().parent == Path("/dev")
    if is_link_to_stream or (path.exists() and not is_file):
        raise PlannerError(f"'{path}' is a device or a pipe, expected the name of a file")


def exists_already(path: Path) -> PlannerError:
    """The error for an output that would overwrite a file or folder."""
    return PlannerError(
        f"'{path}' exists already: choose another name, or overwrite it "
        "(--force, in Python overwrite=True)"
    )


_WORDS = {
    str: "text",
    int: "an integer",
    float: "a number",
    bool: "true or false",
    dict: "an object",
    type(None): "null",
}


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
