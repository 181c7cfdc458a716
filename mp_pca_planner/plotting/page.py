# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""HTML pages that need nothing else: style, tables, pictures inside."""

from __future__ import annotations

import base64
import io
from collections.abc import Iterable, Sequence
from html import escape

from .. import __version__

_STYLE = """
:root { color-scheme: light; --line: #d0d7de; --soft: #57606a; --accent: #0072b2; }
* { box-sizing: border-box; }
body { margin: 0 auto; padding: 1rem; max-width: 70rem; color: #1f2328; background: #fff;
  font: 1rem/1.5 system-ui, "DejaVu Sans", sans-serif; overflow-wrap: anywhere; }
h1 { font-size: 1.6rem; line-height: 1.25; margin: .5rem 0; }
h2 { font-size: 1.25rem; margin: 2.2rem 0 .5rem; padding-bottom: .25rem;
  border-bottom: 2px solid var(--accent); }
h3 { font-size: 1.05rem; margin: 1.4rem 0 .3rem; }
p { margin: .4rem 0; max-width: 48rem; }
.soft { color: var(--soft); font-size: .9rem; }
dl { display: grid; grid-template-columns: repeat(auto-fill, minmax(9.5rem, 1fr)); gap: .6rem;
  margin: 1rem 0; }
dl div { border: 1px solid var(--line); border-radius: .4rem; padding: .4rem .7rem; }
dt { color: var(--soft); font-size: .85rem; }
dd { margin: 0; font-size: 1.15rem; font-weight: 600; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; margin: .2rem 0; font-size: .92rem; }
figure { margin: .5rem 0; }
figcaption { color: var(--soft); font-size: .9rem; }
th, td { padding: .25rem .7rem; border-bottom: 1px solid var(--line); text-align: right;
  white-space: nowrap; font-variant-numeric: tabular-nums; }
th:first-child, td:first-child { text-align: left; padding-left: .2rem; }
table.text td, table.text th { text-align: left; white-space: normal; vertical-align: top;
  overflow-wrap: normal; }
table.text td:first-child { overflow-wrap: anywhere; min-width: 7rem; }
thead th { color: var(--soft); font-weight: 600; }
.picture { overflow-x: auto; margin: .6rem 0; }
.picture img { display: block; height: auto; max-width: 100%; min-width: 34rem; }
.picture.recording img { width: 46rem; }
details { border: 1px solid var(--line); border-radius: .4rem; margin: .5rem 0; padding: 0 .8rem; }
details[open] { padding-bottom: .6rem; }
summary { cursor: pointer; padding: .5rem 0; }
summary .soft { margin-left: .5rem; }
ul { padding-left: 1.2rem; margin: .4rem 0; }
footer { margin: 3rem 0 1rem; }
@media (max-width: 32rem) {
  body { padding: .7rem; }
  .picture::before { content: "↔ scrolls sideways"; color: var(--soft); font-size: .8rem; }
  th, td { padding: .25rem .4rem; }
  table { font-size: .85rem; }
  dl { grid-template-columns: repeat(auto-fill, minmax(8rem, 1fr)); }
}
@media print { details { break-inside: avoid; } }
"""


def html_page(title: str, body: str) -> str:
    """Make a page of a title and its content, which is HTML."""
    footer = f'<footer class="soft">Made by mp_pca_planner {escape(__version__)}.</footer>'
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>{_STYLE}</style>\n</head>\n"
        f"<body>\n<main>\n{body}\n{footer}\n</main>\n</body>\n</html>\n"
    )


def html_image(content: io.BytesIO, alt: str, kind: str) -> str:
    """A PNG picture; `kind` is a class of the style."""
    data = base64.b64encode(content.getvalue()).decode("ascii")
    picture = f'<img alt="{escape(alt)}" src="data:image/png;base64,{data}">'
    return f'<div class="picture {kind}">{picture}</div>'


def html_table(
    header: Sequence[str], rows: Iterable[Sequence[str]], caption: str, *, text: bool = False
) -> str:
    """A table of text cells; `text` if they are sentences rather than numbers."""
    head = "".join(f'<th scope="col">{escape(cell)}</th>' for cell in header)
    body = "\n".join(
        "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows
    )
    # Beside the part that scrolls: on a phone it would be cut off there.
    title = f"<figcaption>{escape(caption)}</figcaption>" if caption else ""
    return (
        f'<figure>{title}<div class="wide"><table{" class=text" if text else ""}>'
        f"<thead><tr>{head}</tr></thead>\n<tbody>\n{body}\n</tbody></table></div></figure>"
    )
