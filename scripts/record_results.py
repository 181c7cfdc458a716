#!/usr/bin/env python3
# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Record the tables that a command prints with ``--json``, for the documentation site.

python3 scripts/record_results.py NAME COMMAND...

runs ``COMMAND... --json`` and writes doc/results/NAME.json: the tables, the command, the date, the
commit and the machine. For example::

    python3 scripts/record_results.py planning_speed python3 benchmarks/planning_speed.py
"""

from __future__ import annotations

import json
import os
import platform
import shlex
import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def machine() -> str:
    """The processor and the versions that times depend on."""
    information = Path("/proc/cpuinfo")
    lines = information.read_text(encoding="utf-8").splitlines() if information.exists() else []
    names = [line.partition(": ")[2] for line in lines if line.startswith("model name")]
    processor = names[0] if names else platform.machine()
    return f"{os.cpu_count()} × {processor}, Python {platform.python_version()}"


def commit() -> str:
    """The commit, with a mark if files differ from it."""
    command = ["git", "describe", "--always", "--dirty", "--exclude", "*"]
    return subprocess.check_output(command, cwd=ROOT, text=True).strip()


def main() -> None:
    """Run the command and write its tables."""
    name, *command = sys.argv[1:]
    state, before = commit(), os.getloadavg()[0]
    done = subprocess.run([*command, "--json"], check=True, stdout=subprocess.PIPE, text=True)
    record = {
        "command": shlex.join(command),
        "date": f"{datetime.now(UTC):%Y-%m-%d}",
        "commit": state,
        "machine": machine(),
        "load": [before, os.getloadavg()[0]],
        "tables": json.loads(done.stdout)["tables"],
    }
    file = ROOT / "doc/results" / f"{name}.json"
    file.parent.mkdir(exist_ok=True)
    file.write_text(json.dumps(record, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
