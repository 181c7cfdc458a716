# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The package as a whole: its imports, its commands, and its installation by pip."""

import os
import re
import shutil
import subprocess
import sys
import venv
from importlib.util import find_spec
from pathlib import Path

import pytest

import mp_pca_planner
from mp_pca_planner.cli.main import COMMANDS, main

ROOT = Path(__file__).parents[2]
PACKAGE = "mp_pca_planner"
ROS_COMMANDS = ["cli.demo", "cli.simulate"]


def run(
    command: list[str | Path], cwd: Path = ROOT, **environment: str
) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        command,
        cwd=cwd,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=False,
    )


def run_python(code: str) -> subprocess.CompletedProcess[str]:
    return run([sys.executable, "-c", code])


def test_everything_but_the_node_imports_without_ros() -> None:
    code = f"""
import pkgutil, sys
from importlib import import_module
import {PACKAGE}
for module in pkgutil.walk_packages({PACKAGE}.__path__, "{PACKAGE}."):
    name = module.name.removeprefix("{PACKAGE}.")
    if not name.startswith(("ros", "__main__")) and name not in {ROS_COMMANDS}:
        import_module(module.name)
print(*sorted(name for name in sys.modules if name.startswith("rclpy") or "_msgs" in name))
"""
    result = run_python(code)
    assert result.returncode == 0, result.stderr
    assert result.stdout.strip() == ""


# Commands


def test_help_lists_every_command_once_and_loads_none() -> None:
    code = f"""
import atexit, runpy, sys
atexit.register(lambda: print(*sys.modules, file=sys.stderr))
sys.argv = ["{PACKAGE}", "--help"]
runpy.run_module("{PACKAGE}", run_name="__main__")
"""
    result = run_python(code)
    assert result.returncode == 0
    listed = re.findall(r"^  (\w+)  ", result.stdout, re.MULTILINE)
    assert sorted(listed) == sorted({*COMMANDS} - {"sequence"})
    loaded = set(result.stderr.split())
    assert loaded.isdisjoint({"rclpy", "numpy", *(f"{PACKAGE}.cli.{name}" for name in COMMANDS)})


def test_unknown_command_is_refused_in_one_line_with_the_valid_ones(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["pln", "--json"]) == 2
    output = capsys.readouterr()
    assert output.out == ""
    assert output.err.count("\n") == 1
    assert "'pln' (did you mean 'plan'?)" in output.err
    assert all(f"'{name}'" in output.err for name in COMMANDS)


def test_commands_without_ros_say_what_to_install(tmp_path: Path) -> None:
    # An entry of None is how Python itself marks a module that must not be found.
    code = f"""
import sys
sys.modules["rclpy"] = None
from {PACKAGE}.cli.main import main
for words in (["planner_node"], ["simulate", "--robot", "a.urdf"], ["demo", "--output", "out"]):
    print(main(words))
"""
    result = run([sys.executable, "-c", code], tmp_path, PYTHONPATH=str(ROOT))
    assert result.stdout.split() == ["2"] * 3
    lines = result.stderr.splitlines()
    assert len(lines) == 3 and all("mp_pca_planner[ros]" in line for line in lines)
    assert list(tmp_path.iterdir()) == []


# Installation by pip


@pytest.fixture(scope="module")
def prefix(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a virtual environment with the package installed from a copy of the source tree."""
    if find_spec("pip") is None or find_spec("setuptools") is None:
        pytest.skip("pip and setuptools are needed to install the package")
    folder = tmp_path_factory.mktemp("pip")
    source = folder / "source"
    source.mkdir()
    for name in (PACKAGE, "resource", "config", "launch", "scripts"):
        ignore = shutil.ignore_patterns("__pycache__")
        shutil.copytree(ROOT / name, source / name, symlinks=True, ignore=ignore)
    for name in ("setup.py", "setup.cfg", "package.xml", "pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)

    environment = folder / "venv"
    venv.create(environment)
    site_packages = next((environment / "lib").glob("python*/site-packages"))
    # The dependencies are those of the tests' own environment, found after what is installed here.
    (site_packages / "dependencies.pth").write_text(
        "".join(f"import site; site.addsitedir({path!r})\n" for path in filter(None, sys.path)),
        encoding="utf-8",
    )
    options = ["--no-deps", "--no-build-isolation", "--no-index", str(source)]
    pip: list[str | Path] = [environment / "bin/python3", "-m", "pip"]
    result = run([*pip, "install", "--quiet", *options], PYTHONPATH="")
    assert result.returncode == 0, result.stderr
    return environment


@pytest.mark.slow
def test_pip_installs_what_runs_from_any_folder_and_where_ros2_looks(
    prefix: Path, tmp_path: Path
) -> None:
    assert (prefix / f"share/ament_index/resource_index/packages/{PACKAGE}").is_file()
    assert (prefix / f"share/{PACKAGE}/package.xml").is_file()
    for folder in (ROOT / "scripts/ros2_run", prefix / "lib" / PACKAGE):
        executables = sorted(folder.iterdir())
        assert [path.name for path in executables] == sorted(COMMANDS)
        for path in executables:
            assert path.read_bytes() == (ROOT / "scripts/run_command").read_bytes()
            assert os.access(path, os.X_OK)
    # A module in the working directory must not get in the way.
    (tmp_path / "numpy.py").write_text("raise SystemExit('shadowed')", encoding="utf-8")
    result = run([prefix / "lib" / PACKAGE / "inspect", "--help"], cwd=tmp_path, PYTHONPATH="")
    assert result.stdout.startswith("usage: mp-pca inspect"), result.stderr
    result = run([prefix / "bin/mp-pca", "--version"], cwd=tmp_path, PYTHONPATH="")
    assert result.stdout == f"{PACKAGE} {mp_pca_planner.__version__}\n", result.stderr
    (tmp_path / "numpy.py").unlink()
    code = f"from {PACKAGE}.files import config_file; print(config_file('planner.yaml'))"
    result = run([prefix / "bin/python3", "-c", code], cwd=tmp_path, PYTHONPATH="")
    assert result.stdout.strip() == str(prefix / f"share/{PACKAGE}/config/planner.yaml")
