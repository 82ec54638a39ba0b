"""One HTML page without network, script or other files: its elements and its looks."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Sequence
from html import escape

STYLE = """
:root { --ink: #22272b; --quiet: #5b646c; --rule: #d5dade; --tint: #f4f6f7; --accent: #1f6f8b; }
* { box-sizing: border-box; }
html { background: #fff; color: var(--ink); font: 16px/1.55 system-ui, "Segoe UI", "Helvetica Neue", Arial, sans-serif;
       -webkit-text-size-adjust: 100%; }
body { max-width: 56rem; margin: 0 auto; padding: 2.6rem 1.6rem 5rem; }
h1 { font-size: 1.9rem; line-height: 1.2; margin: 0 0 .35rem; letter-spacing: -.012em; font-weight: 650; }
h2 { font-size: 1.22rem; margin: 3rem 0 .7rem; padding-top: .9rem; border-top: 1px solid var(--rule);
     font-weight: 650; }
h3 { font-size: 1rem; margin: 1.7rem 0 .4rem; font-weight: 650; }
p { margin: 0 0 .85rem; max-width: 44rem; }
.lead { font-size: 1.06rem; color: var(--quiet); margin-bottom: 1.4rem; }
.note { background: #fdf6e3; border-left: 3px solid #e0a526; padding: .6rem .9rem; }
.quiet { color: var(--quiet); }
.tiles { display: grid; grid-template-columns: repeat(auto-fit, minmax(7.4rem, 1fr)); gap: .8rem; margin: 1.5rem 0; }
.tile { background: var(--tint); padding: .8rem .95rem .7rem; border-radius: 3px; }
.tile b { display: block; font-size: 1.55rem; line-height: 1.15; font-weight: 620; font-variant-numeric: tabular-nums; }
.tile b small { font-size: .92rem; font-weight: 450; color: var(--quiet); }
.tile span { display: block; font-size: .84rem; line-height: 1.35; color: var(--quiet); margin-top: .3rem; }
figure { margin: 1.3rem 0 1.6rem; }
figure img, figure video { display: block; max-width: 100%; height: auto; border-radius: 3px; }
figure video { width: 34rem; }
figcaption { font-size: .88rem; line-height: 1.45; color: var(--quiet); margin-top: .5rem; max-width: 44rem; }
.scroll { overflow-x: auto; margin: .9rem 0 1.3rem; }
table { border-collapse: collapse; width: 100%; font-size: .91rem; line-height: 1.4; }
th { text-align: left; font-weight: 600; color: var(--quiet); border-bottom: 1.5px solid var(--ink); }
th, td { padding: .36rem 1.1rem .36rem 0; vertical-align: top; }
td { border-bottom: 1px solid var(--rule); }
table.facts { max-width: 36rem; border-top: 1px solid var(--rule); }
th:last-child, td:last-child { padding-right: 0; }
.number { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
tr.total td { font-weight: 620; border-bottom: 1.5px solid var(--ink); border-top: 1px solid var(--ink); }
code, pre { font: .86rem/1.5 ui-monospace, SFMono-Regular, Menlo, Consolas, monospace; }
code { background: var(--tint); padding: .08em .3em; border-radius: 2px; overflow-wrap: anywhere; }
pre { background: var(--tint); padding: .8rem 1rem; overflow-x: auto; border-radius: 3px; margin: .6rem 0 1.1rem; }
td code { background: none; padding: 0; font-size: .82rem; }
details { margin: .8rem 0; }
summary { cursor: pointer; color: var(--accent); }
ol { padding-left: 1.3rem; } li { margin-bottom: .7rem; }
@media print {
  html { font-size: 10.5pt; } body { max-width: none; padding: 0; }
  h2 { break-after: avoid; } figure, .tile, tr { break-inside: avoid; } video { display: none !important; }
  pre { white-space: pre-wrap; } .scroll { overflow: visible; }
  .tile, pre, code, .note { -webkit-print-color-adjust: exact; print-color-adjust: exact; }
}
"""


def document(title: str, parts: Iterable[str]) -> str:
    """The whole page; parts are HTML."""
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n"
        + "\n".join(part for part in parts if part)
        + "\n</body>\n</html>\n"
    )


def section(title: str, *parts: str) -> str:
    """A heading with what belongs to it; nothing at all if there is nothing below it."""
    filled = [part for part in parts if part]
    return f"<section>\n<h2>{escape(title)}</h2>\n" + "\n".join(filled) + "\n</section>" if filled else ""


def paragraph(text: str, kind: str = "") -> str:
    """A paragraph of plain text."""
    return html_paragraph(escape(text), kind)


def html_paragraph(html: str, kind: str = "") -> str:
    """A paragraph of HTML."""
    return f'<p class="{kind}">{html}</p>' if kind else f"<p>{html}</p>"


def heading(text: str) -> str:
    """A heading within a section."""
    return f"<h3>{escape(text)}</h3>"


def code(text: str) -> str:
    """Inline code."""
    return f"<code>{escape(text)}</code>"


def block(text: str) -> str:
    """Lines as they stand: commands or a file."""
    return f"<pre>{escape(text)}</pre>"


def folded(summary: str, html: str) -> str:
    """Detail that is unfolded by a click."""
    return f"<details><summary>{escape(summary)}</summary>{html}</details>"


def tiles(figures: Sequence[tuple[str, str, str]]) -> str:
    """Headline figures: (value, unit, what it is)."""
    cells = "".join(
        f'<div class="tile"><b>{escape(value)} <small>{escape(unit)}</small></b><span>{escape(what)}</span></div>\n'
        for value, unit, what in figures
    )
    return f'<div class="tiles">\n{cells}</div>' if cells else ""


def table(
    header: Sequence[str], rows: Iterable[Sequence[str]], numbers: Sequence[int] = (), total: bool = False
) -> str:
    """A table of HTML cells.

    Args:
        header: column names, plain text; none for a list of facts.
        rows: cells, HTML.
        numbers: indices of columns that hold numbers.
        total: the last row sums up the others.
    """
    rows = list(rows)

    def cells(tag: str, texts: Sequence[str]) -> str:
        return "".join(
            f'<{tag} class="number">{text}</{tag}>' if k in numbers else f"<{tag}>{text}</{tag}>"
            for k, text in enumerate(texts)
        )

    lines = [f"<tr>{cells('th', [escape(name) for name in header])}</tr>"] if header else []
    kind = "" if header else ' class="facts"'
    for k, row in enumerate(rows):
        opening = '<tr class="total">' if total and k == len(rows) - 1 else "<tr>"
        lines.append(f"{opening}{cells('td', row)}</tr>")
    return f'<div class="scroll"><table{kind}>\n' + "\n".join(lines) + "\n</table></div>"


def picture(png: bytes | None, caption: str, width: int | None = None) -> str:
    """A figure with its caption, inline; nothing without a picture."""
    if png is None:
        return ""
    size = f' style="width:{width}px"' if width else ""
    image = f'<img{size} alt="{escape(caption, quote=True)}" src="data:image/png;base64,{_base64(png)}">'
    return f"<figure>{image}<figcaption>{escape(caption)}</figcaption></figure>"


def film(mp4: bytes | None, caption: str) -> str:
    """A film with its caption, inline; nothing without a film."""
    if mp4 is None:
        return ""
    source = f"data:video/mp4;base64,{_base64(mp4)}"
    video = f'<video controls muted loop playsinline preload="metadata" src="{source}"></video>'
    return f"<figure>{video}<figcaption>{escape(caption)}</figcaption></figure>"


def _base64(data: bytes) -> str:
    return base64.b64encode(data).decode("ascii")
