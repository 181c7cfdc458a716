# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Recordings on a real S3 server on this machine, against the same recordings in files."""

import http.server
import logging
import re
import shutil
import socket
import tempfile
import threading
from collections.abc import Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from mp_pca_planner.exceptions import RecordingError
from mp_pca_planner.primitives.build import PrimitiveOptions, build_from_statistics
from mp_pca_planner.primitives.motion_statistics import MotionStatistics
from mp_pca_planner.recordings.bags import (
    discovery,
    find_recordings,
    recording_names,
    write_joint_states,
)
from mp_pca_planner.recordings.load import load_recordings
from mp_pca_planner.recordings.reading import inspect_recording
from mp_pca_planner.recordings.recording_set import RecordingSet
from mp_pca_planner.recordings.synthetic import continuous_recording, generate_motions

SECRET = "hush-hush"
OPTIONS = PrimitiveOptions(n_components=3)


class Proxy(threading.Thread):
    """Passes connections on, and closes one after some bytes of the answer, once.

    Parameters
    ----------
    port : int
        Port of the server.
    cut_after : int
        Bytes of an answer after which its connection is cut.
    """

    def __init__(self, port: int, cut_after: int) -> None:
        super().__init__(daemon=True)
        self._target, self._cut_after = port, cut_after
        self.is_cut, self._lock = False, threading.Lock()
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.port = self._listening.getsockname()[1]

    def run(self) -> None:
        """Accept connections until :meth:`close`."""
        while True:
            try:
                client, _ = self._listening.accept()
            except OSError:
                return
            server = socket.create_connection(("127.0.0.1", self._target))
            for source, sink, is_answer in ((client, server, False), (server, client, True)):
                arguments = (source, sink, is_answer)
                threading.Thread(target=self._pass_on, args=arguments, daemon=True).start()

    def close(self) -> None:
        """Accept no more connections."""
        self._listening.close()

    def _pass_on(self, source: socket.socket, sink: socket.socket, is_answer: bool) -> None:
        passed = 0
        with suppress(OSError):
            while block := source.recv(1 << 16):
                passed += len(block)
                with self._lock:
                    is_cut = is_answer and not self.is_cut and passed > self._cut_after
                    self.is_cut |= is_cut
                if is_cut:
                    break
                sink.sendall(block)
        for end in (source, sink):
            with suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Recordings of all formats; two have the same name."""
    path = tmp_path_factory.mktemp("bags") / "runs"
    places = ["a.bag", "b.mcap", "day1/c", "day1/x.mcap", "day2/x.mcap"]
    for i, place in enumerate(places):
        file = path / place
        file.parent.mkdir(parents=True, exist_ok=True)
        made = continuous_recording(generate_motions(2, i), seed=i)
        bag_format = "rosbag1" if file.suffix == ".bag" else "mcap"
        content = made.joint_names, made.stamps, made.positions
        write_joint_states(file, bag_format, *content)
    (path / "notes.txt").write_text("no recording")
    return path


@pytest.fixture(scope="module")
def server(folder: Path) -> Iterator[int]:
    """An S3 server that holds the recordings in the bucket 'bucket'; its port."""
    moto_server = pytest.importorskip("moto.server", reason="moto is not installed")
    boto3 = pytest.importorskip("boto3")
    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    running = moto_server.ThreadedMotoServer("127.0.0.1", 0, verbose=False)
    running.start()
    _, port = running.get_host_and_port()
    client = boto3.client(
        "s3",
        region_name="us-east-1",
        endpoint_url=f"http://127.0.0.1:{port}",
        aws_access_key_id="key",
        aws_secret_access_key=SECRET,
    )
    client.create_bucket(Bucket="bucket")
    for file in folder.rglob("*"):
        if file.is_file():
            client.upload_file(str(file), "bucket", str(file.relative_to(folder.parent)))
    yield port
    running.stop()


@pytest.fixture
def access(server: int, monkeypatch: pytest.MonkeyPatch) -> Iterator[Proxy]:
    """Credentials in the environment, and a connection to the server that is cut once."""
    pytest.importorskip("s3fs", reason="s3fs is not installed (extra 'cloud')")
    proxy = Proxy(server, cut_after=60_000)
    proxy.start()
    variables = {
        "AWS_ACCESS_KEY_ID": "key",
        "AWS_SECRET_ACCESS_KEY": SECRET,
        "AWS_DEFAULT_REGION": "us-east-1",
        "AWS_ENDPOINT_URL": f"http://127.0.0.1:{proxy.port}",
        "AWS_EC2_METADATA_DISABLED": "true",
    }
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    __import__("s3fs").S3FileSystem.clear_instance_cache()
    yield proxy
    proxy.close()


def learned(path: str | Path, jobs: int) -> tuple[RecordingSet, bytes]:
    """The reports of recordings, and all arrays and facts of the primitive that is learned."""
    loaded = load_recordings(
        path, summarise=partial(MotionStatistics.of, options=OPTIONS), most_samples=0, jobs=jobs
    )
    statistics = MotionStatistics.merged(loaded.summaries)
    primitive = build_from_statistics(statistics, "x", OPTIONS)
    arrays = b"".join(array.tobytes() for array in primitive.arrays().values())
    # Demonstrations are made when they are used.
    metadata = primitive.metadata | {"demonstrations": list(primitive.metadata["demonstrations"])}
    return loaded, arrays + repr(metadata).encode()


@pytest.mark.parametrize("jobs", [1, 2])
def test_the_primitive_is_that_of_the_files_though_the_network_is_cut(
    folder: Path, access: Proxy, jobs: int
) -> None:
    _, expected = learned(folder, 1)
    loaded, found = learned("s3://bucket/runs", jobs)
    assert access.is_cut
    assert found == expected
    assert not loaded.refused
    assert {report.path for report in loaded.reports} == {
        *(f"s3://bucket/runs/{name}" for name in ("a.bag", "b.mcap", "day1/c")),
        *(f"s3://bucket/runs/day{i}/x.mcap" for i in (1, 2)),
    }


def test_recordings_are_those_of_the_folder_in_its_order(folder: Path, access: Proxy) -> None:
    expected = recording_names(find_recordings(folder))
    assert recording_names(find_recordings("s3://bucket/runs/")) == expected
    assert recording_names(find_recordings("s3://bucket/runs/day*/x.mcap")) == ("day1/x", "day2/x")
    assert recording_names(find_recordings("s3://bucket/runs/day1/c")) == ("c",)
    assert recording_names(find_recordings("s3://bucket/runs/a.bag")) == ("a",)
    assert recording_names(find_recordings(f"file://{folder}")) == expected


def test_copies_are_removed(access: Proxy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    facts = inspect_recording("s3://bucket/runs/b.mcap")
    assert facts.path == "s3://bucket/runs/b.mcap"
    assert facts.refusal is None and facts.n_messages
    assert not list(tmp_path.iterdir())


def test_a_recording_without_space_for_its_copy_is_refused(
    access: Proxy, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda _: shutil._ntuple_diskusage(9, 8, 1000))
    loaded = load_recordings("s3://bucket/runs/b.mcap")
    assert "set TMPDIR" in loaded.refused[0].reason


@pytest.mark.parametrize(
    ("url", "reason"),
    [
        ("s3://bucket/nothing/", "there is nothing at 's3://bucket/nothing/'"),
        ("s3://no-bucket/x.bag", "there is nothing at 's3://no-bucket/x.bag'"),
        ("s3://bucket/runs/*.csv", "there is nothing"),
        (f"s3://user:{SECRET}@bucket/x.bag", "URL 's3://bucket/x.bag' holds a user name"),
        (f"https://{SECRET}@host/x.bag", "URL 'https://host/x.bag' holds a user name"),
        (f"ftp://host/x.bag?key={SECRET}", "'ftp://host/x.bag' is not a URL of s3://, gs://"),
        (f"simplecache::s3://bucket/?{SECRET}", "is not a URL of"),
    ],
)
def test_urls_that_cannot_be_used_are_refused_in_one_sentence(
    access: Proxy, url: str, reason: str
) -> None:
    with pytest.raises(RecordingError, match=reason) as refusal:
        find_recordings(url)
    assert SECRET not in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_a_server_that_does_not_answer_is_named_without_secrets(
    access: Proxy, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(discovery, "_WAITS", (0.0,))
    with socket.create_server(("127.0.0.1", 0)) as unused:
        port = unused.getsockname()[1]
    url = f"http://127.0.0.1:{port}/x.mcap?signature={SECRET}"
    with pytest.raises(RecordingError, match=r"x\.mcap' can't be read: .*, 2 times") as refusal:
        find_recordings(url)
    assert SECRET not in str(refusal.value)


def test_a_file_of_a_web_server_is_read_and_its_query_is_not_shown(folder: Path) -> None:
    pytest.importorskip("aiohttp")
    handler = partial(http.server.SimpleHTTPRequestHandler, directory=str(folder))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as running:
        threading.Thread(target=running.serve_forever, daemon=True).start()
        place = f"http://127.0.0.1:{running.server_port}/day1/x.mcap"
        loaded = load_recordings(f"{place}?signature={SECRET}")
        running.shutdown()
    (expected,) = load_recordings(folder / "day1" / "x.mcap").reports
    (report,) = loaded.reports
    assert (report.name, report.path, report.checksum) == ("x", place, expected.checksum)
    assert len(loaded) == len(expected.motions)
    assert np.all([motion.duration > 0.0 for motion in loaded])
    assert SECRET not in repr(loaded.reports)
    (found,) = find_recordings(find_recordings(f"file://{folder}/day1/x.mcap"))
    assert found == folder / "day1" / "x.mcap"


class EndlessHandler(http.server.BaseHTTPRequestHandler):
    """Answers in chunks without an end, or that it is forbidden."""

    protocol_version = "HTTP/1.1"

    def do_HEAD(self) -> None:
        """Send the headers."""
        if "forbidden" in self.path:
            self.send_error(403)
            return
        self.send_response(200)
        self.send_header("Transfer-Encoding", "chunked")
        self.end_headers()

    def do_GET(self) -> None:
        """Send chunks until the client leaves."""
        self.do_HEAD()
        with suppress(OSError):
            while "forbidden" not in self.path:
                self.wfile.write(b"10000\r\n" + bytes(1 << 16) + b"\r\n")
                if "slow" in self.path:
                    threading.Event().wait(0.05)
        self.close_connection = True

    def log_message(self, *_: object) -> None:
        """Stay silent."""


@pytest.fixture
def endless() -> Iterator[str]:
    """The address of a web server whose files don't end."""
    pytest.importorskip("aiohttp")
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), EndlessHandler) as running:
        threading.Thread(target=running.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{running.server_port}"
        running.shutdown()


@pytest.mark.parametrize(
    ("name", "changed", "reason"),
    [
        ("x.mcap", {"_UNKNOWN_BYTES": 8 << 20}, "states no size, and it has more than 8 MiB"),
        ("x.mcap", {"_DISK_RESERVE": 1 << 60}, "set TMPDIR to a folder with more space"),
        ("slow.mcap", {"_PATIENCE": 0.1, "_SLOWEST": 1e12}, "arrives at .* bytes per second"),
    ],
)
def test_a_file_without_an_end_is_rejected(
    endless: str,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    name: str,
    changed: dict[str, float],
    reason: str,
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    for constant, value in changed.items():
        monkeypatch.setattr(discovery, constant, value)
    (refused,) = load_recordings(f"{endless}/{name}").refused
    assert re.search(reason, refused.reason)
    assert not list(tmp_path.iterdir())


def test_a_forbidden_file_is_called_forbidden(endless: str) -> None:
    with pytest.raises(RecordingError, match=r"can't be read: access is forbidden .*403"):
        find_recordings(f"{endless}/forbidden.mcap")


@pytest.mark.parametrize(
    "url", ["http://[", f"http://{SECRET}[/x", "https://host:99999/x", "s3://"]
)
def test_a_malformed_url_is_rejected_without_its_parts(url: str) -> None:
    with pytest.raises(RecordingError, match=r"is malformed \(.*expected scheme://host") as refusal:
        find_recordings(url)
    assert SECRET not in str(refusal.value)
