#!/usr/bin/env python3
# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Write examples/notebook.ipynb: the parts of examples/notebook.py as cells, executed.

python3 scripts/execute_notebook.py    # needs nbclient and ipykernel
"""

from __future__ import annotations

import ast
import tempfile
from pathlib import Path

FOLDER = Path(__file__).resolve().parents[1] / "examples"
TITLE = "# From a recording to a motion"


def cells(program: str) -> list[str]:
    """The parts of a program between blank lines, without its docstring."""
    docstring = ast.parse(program).body[0]
    code = program.splitlines()[docstring.end_lineno :]
    return [part.strip() for part in "\n".join(code).split("\n\n") if part.strip()]


def main() -> None:
    """Execute the cells in a temporary folder and write the notebook."""
    import nbclient
    import nbformat

    parts = cells((FOLDER / "notebook.py").read_text(encoding="utf-8"))
    v4 = nbformat.v4
    notebook = v4.new_notebook(cells=[v4.new_markdown_cell(TITLE), *map(v4.new_code_cell, parts)])
    for number, cell in enumerate(notebook.cells):
        cell["id"] = f"cell-{number}"  # the same on each run
    with tempfile.TemporaryDirectory() as folder:
        nbclient.NotebookClient(notebook, resources={"metadata": {"path": folder}}).execute()
    for cell in notebook.cells:
        cell.metadata.pop("execution", None)  # times
    nbformat.write(notebook, FOLDER / "notebook.ipynb")


if __name__ == "__main__":
    main()
