# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Settings, options and fixtures of all tests."""

from __future__ import annotations

import importlib
import importlib.util
import os
import subprocess
import sys
from hashlib import sha256
from pathlib import Path

# One thread for linear algebra, as in the node, in all processes of tests: the matrices are small,
# and threads that wait for each other were measured to take up to twice the time.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import hypothesis
import pytest
from support.bags import FORMATS
from support.commands import with_folder

# The same examples on every run, and no verdict that depends on the machine's speed.
hypothesis.settings.register_profile(
    "repeatable",
    derandomize=True,
    deadline=None,
    # It depends on how busy the machine is.
    suppress_health_check=[hypothesis.HealthCheck.too_slow],
)
hypothesis.settings.load_profile("repeatable")

_SHARED = Path(__file__).resolve().parents[2] / "shared" / "data"
SHARED_DATA = _SHARED if _SHARED.exists() else None
"""Real recordings beside the project, where they exist."""


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Tests with the special kinds of slowness are slow."""
    for item in items:
        if any(item.get_closest_marker(name) for name in ("campaign", "browser", "realtime")):
            item.add_marker(pytest.mark.slow)


@pytest.fixture(params=FORMATS)
def bag_format(request: pytest.FixtureRequest) -> str:
    """Every storage format in turn."""
    return str(request.param)


@pytest.fixture
def shared_data() -> Path:
    """Folder of real recordings; the test is skipped where there is none."""
    if SHARED_DATA is None:
        pytest.skip("the real recordings (../shared/data) are not beside this checkout")
    return SHARED_DATA


_MAKE_CONTROL_MSGS = Path(__file__).resolve().parents[1] / "scripts" / "control_messages.py"


@pytest.fixture(scope="session")
def _control_msgs_folder(request, tmp_path_factory):
    """The folder that has to be on the path; None if the package is installed."""
    if importlib.util.find_spec("control_msgs") is not None:
        return None
    name = (
        "control_msgs_"
        + sha256(_MAKE_CONTROL_MSGS.read_bytes() + sys.version.encode()).hexdigest()[:16]
    )
    cache = getattr(request.config, "cache", None)
    folder = tmp_path_factory.mktemp("made") if cache is None else Path(cache.mkdir(name))
    if not (folder / "control_msgs").exists():
        command = [sys.executable, str(_MAKE_CONTROL_MSGS), str(folder)]
        made = subprocess.run(command, capture_output=True, text=True, check=False)
        if made.returncode:
            pytest.skip(f"control_msgs can't be made: {made.stderr.splitlines()[-1]}")
    return folder


@pytest.fixture
def control_msgs(_control_msgs_folder, monkeypatch):
    """Make control_msgs importable, here and in processes that are started."""
    if _control_msgs_folder is not None:
        monkeypatch.setenv("PYTHONPATH", with_folder(_control_msgs_folder))
        monkeypatch.syspath_prepend(str(_control_msgs_folder))
    return importlib.import_module("control_msgs")
