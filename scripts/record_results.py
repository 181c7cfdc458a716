#!/usr/bin/env python3
# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Record the tables of benchmarks, for doc/benchmarks.md and the documentation site.

python3 scripts/record_results.py [--data FOLDER] NAME...

runs the command of each name with ``--json`` and writes doc/results/NAME.json: the tables, the
command, the date, the commit and the machine. Then it renews the marked tables in
doc/benchmarks.md. Run it alone on the machine: most tables hold times. Some commands need data
that are not shipped: FOLDER has them under the names in the commands.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import runpy
import shlex
import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
COMMANDS = {
    "planning_speed": "python3 benchmarks/planning.py speed",
    "planning_cases": "python3 benchmarks/planning.py cases",
    "optimality": "python3 -m campaigns.optimality --problems 13",
    "scenes": "python3 benchmarks/compare.py --scenes problems --problems 100",
    "poses": "python3 benchmarks/planning.py poses",
    "sequences": "python3 benchmarks/planning.py sequences",
    "benchmark_human_arm": "python3 benchmarks/compare.py --problems 200",
    "benchmark_panda": "python3 benchmarks/compare.py --robot panda --problems 200",
    "naturalness": "python3 benchmarks/prediction.py joint_states --segments motions.csv "
    "--by-label --robot config/human_arm.urdf --tip wrist",
    "case_study": "python3 benchmarks/paper_case_study.py --recordings markers "
    "--segments motions.csv",
    "node": "python3 benchmarks/node.py",
    "mujoco_arms": "python3 benchmarks/mujoco_arms.py --models mujoco_menagerie",
    "moving_robot": "python3 -m campaigns.moving_robot --events 1000",
    "control_bound": "python3 -m campaigns.control_bound",
    "learning": "python3 benchmarks/learning.py",
}


def machine() -> str:
    """The processor and the versions that times depend on."""
    information = Path("/proc/cpuinfo")
    lines = information.read_text(encoding="utf-8").splitlines() if information.exists() else []
    names = [line.partition(": ")[2] for line in lines if line.startswith("model name")]
    processor = names[0] if names else platform.machine()
    return f"{os.cpu_count()} × {processor}, Python {platform.python_version()}"


def commit() -> str:
    """The commit, with a mark if code differs from it."""

    def answer(*command: str) -> str:
        return subprocess.check_output(["git", *command], cwd=ROOT, text=True).strip()

    changes = answer("status", "--porcelain", "--untracked-files=no", ":!doc")
    return answer("rev-parse", "--short", "HEAD") + ("-dirty" if changes else "")


def record(name: str, data: Path) -> None:
    """Run a command and write its tables."""
    words = shlex.split(COMMANDS[name])
    found = [str(data / word) if (data / word).exists() else word for word in words[1:]]
    state, before = commit(), os.getloadavg()[0]
    command = [sys.executable, *found, "--json"]
    paths = os.pathsep.join([str(ROOT), str(ROOT / "test")])
    environment = os.environ | {"PYTHONPATH": paths}
    done = subprocess.run(
        command, check=True, stdout=subprocess.PIPE, text=True, cwd=ROOT, env=environment
    )
    content = {
        "command": COMMANDS[name],
        "date": f"{datetime.now(UTC):%Y-%m-%d}",
        "commit": state,
        "machine": machine(),
        "load": [before, os.getloadavg()[0]],
        "tables": json.loads(done.stdout)["tables"],
    }
    text = json.dumps(content, indent=1, ensure_ascii=False) + "\n"
    (ROOT / f"doc/results/{name}.json").write_text(text, encoding="utf-8")


def main() -> None:
    """Record what is named."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "names", nargs="+", choices=COMMANDS, metavar="NAME", help=", ".join(COMMANDS)
    )
    parser.add_argument("--data", type=Path, default=ROOT, help="folder of data in the commands")
    arguments = parser.parse_args()
    for name in arguments.names:
        record(name, arguments.data.resolve())
    page = ROOT / "doc/benchmarks.md"
    with_results = runpy.run_path(str(ROOT / "doc/reference.py"))["with_results"]
    page.write_text(with_results(page.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
