# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Finding the shipped files from where the code is, in every way it gets installed."""

from pathlib import Path

import pytest

from mp_pca_planner.exceptions import PlannerError
from mp_pca_planner.files import INDEX_MARKER, config_file, config_folder

ROOT = Path(__file__).parents[2]


def make_file(path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.touch()
    return path


def make_prefix(prefix: Path, site_packages: str) -> Path:
    """Lay out an installation; return the module in it."""
    make_file(prefix / INDEX_MARKER)
    return make_file(prefix / site_packages / "mp_pca_planner" / "resources.py")


@pytest.mark.parametrize(
    "site_packages",
    [
        pytest.param("lib/python3.11/site-packages", id="venv, user or colcon"),
        pytest.param("local/lib/python3.12/dist-packages", id="debian"),
        pytest.param("", id="pip --target"),
    ],
)
def test_installed_module_gets_the_files_of_its_own_prefix(
    tmp_path: Path, site_packages: str
) -> None:
    make_prefix(tmp_path / "other", site_packages)
    module = make_prefix(tmp_path / "prefix", site_packages)
    assert config_folder(module) == tmp_path / "prefix/share/mp_pca_planner/config"


def test_module_of_a_source_tree_gets_the_files_of_the_tree(tmp_path: Path) -> None:
    make_file(tmp_path / "package.xml")
    module = make_file(tmp_path / "mp_pca_planner/files.py")
    assert config_folder(module) == tmp_path / "config"


def test_link_of_a_symlink_installation_leads_to_the_source_tree(tmp_path: Path) -> None:
    make_file(tmp_path / "src/package.xml")
    make_file(tmp_path / "src/mp_pca_planner/files.py")
    (tmp_path / "build").mkdir()
    (tmp_path / "build/mp_pca_planner").symlink_to(tmp_path / "src/mp_pca_planner")
    assert config_folder(tmp_path / "build/mp_pca_planner/files.py") == tmp_path / "src/config"


def test_module_without_prefix_or_source_tree_is_refused(tmp_path: Path) -> None:
    module = make_file(tmp_path / "mp_pca_planner/files.py")
    with pytest.raises(PlannerError, match=r"expected a source tree .* or an installation prefix"):
        config_folder(module)


def test_every_shipped_file_is_found() -> None:
    shipped = [path for path in (ROOT / "config").iterdir() if path.is_file()]
    assert shipped
    for path in shipped:
        assert config_file(path.name).read_bytes() == path.read_bytes()
