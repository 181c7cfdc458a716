# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Mesh files of obstacles and links, which come from others.

They are parsed in another process with limits of time and memory. It is started for the first file
and ends with this process. It gets the bytes of a file, and opens no file itself.
"""

from __future__ import annotations

import atexit
import hashlib
import json
import os
import resource
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

import numpy as np

from ..arrays import FloatArray
from ..exceptions import PlannerError, WorldError, printable, quote_names
from ..files import read_bytes, reading
from ..input_limits import INPUT_LIMITS
from .mesh_formats import PARSERS, MeshContent, parse_mesh

# What stops the robot goes before.
_CODE = "import os; os.nice(5); from mp_pca_planner.robot.mesh_files import serve; serve()"
_NO_MEMORY = 12  # status of a process that ends without memory
_LONGEST_LINE = 4096  # bytes of the header of a request or an answer


class MeshProcess:
    """Parses mesh files in another process, one after the other; any thread may call it.

    A file is parsed once, whether it is accepted or not. The least recently used ones are
    forgotten.
    """

    def __init__(self) -> None:
        self._lock, self._kept_lock = threading.Lock(), threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._owner = 0
        self._kept: dict[tuple[bytes, str], MeshContent | str] = {}

    def parsed(self, content: bytes, suffix: str) -> MeshContent:
        """The mesh in the content of a file; ValueError or TimeoutError with the reason if none."""
        key = hashlib.sha256(content).digest(), suffix
        with self._kept_lock:
            found = self._kept.pop(key, None)
        if found is None:
            try:
                found = self.parse(content, suffix)
            except (ValueError, RuntimeError) as error:
                found = str(error)
        with self._kept_lock:
            kept = self._kept
            kept[key] = found
            while len(kept) > 1 and (
                len(kept) > INPUT_LIMITS.kept_meshes
                or sum(len(x.triangles) for x in kept.values() if isinstance(x, MeshContent))
                > INPUT_LIMITS.mesh_triangles
            ):
                del kept[next(iter(kept))]
        if isinstance(found, str):
            raise ValueError(found)
        return found

    def parse(self, content: bytes, suffix: str) -> MeshContent:
        """Parse the content of a file, see :func:`.parse_mesh`.

        Raises
        ------
        ValueError
            If it is rejected or demands too much, with the reason.
        TimeoutError
            If this machine is too busy.
        RuntimeError
            If the process ends.
        """
        with self._lock:
            process = self._started()
            try:
                answer, arrays = _asked(process, content, suffix)
            except (EOFError, OSError):
                reason = f"the process that parses it has ended (status {_end(process)})"
                raise RuntimeError(reason) from None
            except KeyboardInterrupt:  # in the middle of an answer
                _end(process)
                raise
        if "error" in answer:
            raise ValueError(answer["error"])
        if "late" in answer:
            raise TimeoutError(answer["late"])
        vertices = np.frombuffer(arrays[0]).reshape(-1, 3)
        triangles = np.frombuffer(arrays[1], np.int32).reshape(-1, 3)
        colours = [np.frombuffer(one, np.uint8).reshape(-1, 4) for one in arrays[2:]]
        return MeshContent(vertices, triangles, *colours)

    def _started(self) -> subprocess.Popen[bytes]:
        """The running process, or a new one; a copy of this process needs its own."""
        if self._owner != os.getpid() or self._process is None or self._process.poll() is not None:
            folders = [str(Path(__file__).parents[2]), *filter(None, sys.path)]
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-c", _CODE],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                env={
                    **os.environ,
                    "PYTHONPATH": os.pathsep.join(folders),
                    "OPENBLAS_NUM_THREADS": "1",  # each thread takes memory
                },
                start_new_session=True,  # Ctrl-C is for this process
            )
            self._owner = os.getpid()
            atexit.register(_end_own, self._process, self._owner)
        return self._process


def _end(process: subprocess.Popen[bytes]) -> int:
    """End the process with its copies, and return its status."""
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    return process.wait()


def _end_own(process: subprocess.Popen[bytes], owner: int) -> None:
    if owner == os.getpid():
        _end(process)


def _asked(
    process: subprocess.Popen[bytes], content: bytes, suffix: str
) -> tuple[dict[str, Any], list[bytes]]:
    """The answer of the process; EOFError or OSError if it has ended."""
    assert process.stdin is not None
    assert process.stdout is not None
    seconds = INPUT_LIMITS.mesh_wall_seconds
    _send(process.stdin, {"suffix": suffix, "seconds": seconds, "size": len(content)}, content)
    answer = _header(process.stdout)
    return answer, [_exactly(process.stdout, size) for size in answer.get("sizes", ())]


def serve() -> None:
    """Parse the files that arrive on the standard input until it is closed.

    Each is parsed by a copy of this process, which may end. A process that starts anew would load
    its modules again, while the one that asks stops a robot on the same machine.
    """
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))
    requests, answers = sys.stdin.buffer, sys.stdout.buffer
    with suppress(EOFError):
        while True:
            request = _header(requests)
            content = _exactly(requests, request["size"])
            answers.write(_answer_of_copy(content, request["suffix"], request["seconds"]))
            answers.flush()


def _answer_of_copy(content: bytes, suffix: str, seconds: float) -> bytes:
    """The answer of a copy of this process that parses a file within some time [s]."""
    here, there = os.pipe()
    copy = os.fork()
    if copy == 0:
        status = 1
        try:
            _limit(len(content))
            with os.fdopen(there, "wb") as answers:
                _parse(content, suffix, answers)
            status = 0
        except MemoryError:  # even a sentence may need more
            status = _NO_MEMORY
        finally:
            os._exit(status)
    os.close(there)
    answer, end = bytearray(), time.monotonic() + seconds
    while is_ready := select.select([here], [], [], max(end - time.monotonic(), 0.0))[0]:
        part = os.read(here, 1 << 20)
        if not part:
            break
        answer += part
    if not is_ready:
        os.kill(copy, signal.SIGKILL)
    os.close(here)
    status = os.waitstatus_to_exitcode(os.waitpid(copy, 0)[1])
    if not is_ready:
        return _header_line({"late": f"it was not parsed within {seconds:g} s"})
    if status == 0:
        return bytes(answer)
    reasons = {
        -signal.SIGXCPU: f"it takes more than {INPUT_LIMITS.mesh_cpu_seconds} s to parse",
        _NO_MEMORY: "it needs more memory to parse than it may take",
    }
    ended = f"the process that parses it has ended (status {status})"
    return _header_line({"error": reasons.get(status, ended)})


def _parse(content: bytes, suffix: str, answers: IO[bytes]) -> None:
    """Parse a file, and write the mesh or the reason why there is none."""
    try:
        with reading("it", PlannerError):
            found = parse_mesh(content, suffix)
    except PlannerError as error:
        if isinstance(error.__context__, MemoryError):
            raise error.__context__ from None
        reason = str(error).removeprefix("it can't be read: ")
        _send(answers, {"error": reason[:1000]})
        return
    arrays = (found.vertices, found.triangles, found.colours)
    parts = [one.tobytes() for one in arrays if one is not None]
    _send(answers, {"sizes": list(map(len, parts))}, *parts)


def _limit(n_bytes: int) -> None:
    """Limit the memory and the computing time of this process for a file of a size."""
    memory = INPUT_LIMITS.mesh_memory + INPUT_LIMITS.mesh_memory_ratio * n_bytes
    resource.setrlimit(resource.RLIMIT_AS, (memory, resource.RLIM_INFINITY))
    seconds = INPUT_LIMITS.mesh_cpu_seconds
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, resource.RLIM_INFINITY))


def _send(stream: IO[bytes], header: Mapping[str, object], *parts: bytes) -> None:
    stream.write(_header_line(header))
    for part in parts:
        stream.write(part)
    stream.flush()


def _header_line(header: Mapping[str, object]) -> bytes:
    return json.dumps(header).encode() + b"\n"


def _header(stream: IO[bytes]) -> dict[str, Any]:
    line = stream.readline(_LONGEST_LINE)
    if not line.endswith(b"\n"):
        raise EOFError
    found: dict[str, Any] = json.loads(line)
    return found


def _exactly(stream: IO[bytes], size: int) -> bytes:
    content = stream.read(size)
    if len(content) < size:
        raise EOFError
    return content


_FILES = MeshProcess()


def read_mesh(path: Path, resource: str = "") -> MeshContent:
    """Read a mesh file, STL, OBJ or COLLADA (.dae).

    Parameters
    ----------
    path : Path
        The file.
    resource : str
        Its name in messages; the path by default.

    Raises
    ------
    WorldError
        If it can't be read, is of another format, or is too large.
    """
    with reading(f"mesh '{printable(resource or str(path))}'", WorldError):
        suffix = path.suffix.lower()
        if suffix not in PARSERS:
            raise ValueError(f"accepted are files of the formats {', '.join(PARSERS)}")
        return _FILES.parsed(read_bytes(path, INPUT_LIMITS.mesh_bytes), suffix)


def find_mesh(resource: str, folders: Sequence[Path]) -> MeshContent:
    """Read the mesh file that a URDF or a marker names.

    Parameters
    ----------
    resource : str
        ``package://package/path``, ``file:///path`` or a path.
    folders : sequence of Path
        Folders of packages, and of relative paths.

    Raises
    ------
    WorldError
        If the file can't be found or read.
    """
    with reading(f"mesh '{printable(resource):.200}'", WorldError):
        path = find_file(resource, folders)
    if path is None:
        raise WorldError(
            f"mesh '{printable(resource):.200}' was not found, searched in "
            f"{quote_names(map(str, folders))} (package_dirs); accepted are "
            "package://package/path, file:///path and a path"
        )
    return read_mesh(path, resource)


def scaled(vertices: FloatArray, scale: FloatArray) -> FloatArray:
    """Vertices times the scale of a mesh along x, y and z.

    Raises
    ------
    WorldError
        If a scale is 0: the mesh would have no extent there.
    """
    if not np.all(scale):
        numbers = ", ".join(f"{number:g}" for number in scale)
        raise WorldError(f"scale of a mesh must not be 0, got {numbers}")
    with np.errstate(over="ignore"):
        return np.asarray(vertices * scale)


def find_file(resource: str, folders: Sequence[Path]) -> Path | None:
    """The file of a mesh: ``package://package/path``, ``file:///path``, or a path.

    Relative paths, and packages by their names, are searched in some folders; a folder may be the
    package itself, as the URDF reader accepts it.
    """
    scheme, mark, rest = resource.partition("://")
    relative = Path(rest if mark else resource)
    if relative.is_absolute():
        return relative if relative.exists() else None
    candidates = [folder / relative for folder in folders]
    if scheme == "package":
        package, *inner = relative.parts
        candidates += [folder.joinpath(*inner) for folder in folders if folder.name == package]
    return next((path for path in candidates if path.exists()), None)
