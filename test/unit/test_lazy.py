# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Modules that are imported at their first use."""

import sys
from concurrent.futures import ThreadPoolExecutor

from mp_pca_planner.lazy import LazyModule


def test_module_is_imported_by_its_first_name_once_in_all_threads(tmp_path, monkeypatch):
    count = tmp_path / "count"
    source = (
        f"open({str(count)!r}, 'a').write('x')\nimport time; time.sleep(0.05)\nvalue = object()"
    )
    (tmp_path / "imported_late.py").write_text(source)
    monkeypatch.syspath_prepend(tmp_path)
    late = LazyModule("imported_late")
    assert not count.exists()
    with ThreadPoolExecutor(8) as threads:
        values = set(threads.map(lambda _: late.value, range(8)))
    assert values == {sys.modules.pop("imported_late").value} and count.read_text() == "x"
