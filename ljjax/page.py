"""One self-contained page: figures as pictures inside the file, tables under them, readable on laptop and phone."""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from html import escape
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure

INK, MUTED, GRID, ACCENT = "#1d2733", "#5d6b7a", "#e3e8ee", "#0b6e99"
_STYLE: Any = {
    "font.size": 12,
    "font.family": "sans-serif",
    "axes.edgecolor": MUTED,
    "axes.labelcolor": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": GRID,
    "grid.linewidth": 0.8,
    "axes.axisbelow": True,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "legend.frameon": False,
    "legend.fontsize": 10.5,
    "svg.hashsalt": "ljjax",
}

_CSS = """
:root{color-scheme:light}*{box-sizing:border-box}
body{margin:0;background:#f5f7f9;color:#1d2733;font:16px/1.5 system-ui,-apple-system,"Segoe UI",Roboto,sans-serif}
main{max-width:1180px;margin:0 auto;padding:28px 20px 60px}h1{font-size:1.75rem;line-height:1.2;margin:.2em 0}
h2{font-size:1.2rem;margin:2.2em 0 .7em}.sub{color:#5d6b7a;margin:0 0 1.4em}
.cards{display:grid;grid-template-columns:repeat(auto-fit,minmax(150px,1fr));gap:12px;margin:0 0 20px}
.card{background:#fff;border:1px solid #e3e8ee;border-radius:10px;padding:12px 16px}
.card b{display:block;font-size:1.4rem;line-height:1.25}.card span{color:#5d6b7a;font-size:.85rem}
.grid{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(100%,440px),1fr));gap:16px}
figure{margin:0;background:#fff;border:1px solid #e3e8ee;border-radius:10px;padding:14px 14px 10px}
figure img{width:100%;height:auto;display:block}figcaption{font-size:.88rem;color:#5d6b7a;margin-top:6px}
figcaption strong{color:#1d2733}
.beware{background:#fff8e6;border:1px solid #f0d58c;border-radius:10px;padding:12px 18px;margin:0 0 20px}
.beware ul{margin:.3em 0;padding-left:1.2em}.scroll{overflow-x:auto;background:#fff;border:1px solid #e3e8ee;
border-radius:10px}table{border-collapse:collapse;width:100%;font-size:.9rem}
th,td{padding:7px 12px;text-align:left;border-bottom:1px solid #eef1f4;vertical-align:top}
th{color:#5d6b7a;font-weight:600;white-space:nowrap}tr:last-child td{border-bottom:0}
td.n{text-align:right;font-variant-numeric:tabular-nums;white-space:nowrap}th.n{text-align:right}
.good{color:#1b7f4b;font-weight:600}.bad{color:#a75b00;font-weight:600}code{font-size:.86em}td code{white-space:nowrap}
.why{display:inline-block;min-width:15rem}
@media(max-width:520px){main{padding:16px 12px 40px}h1{font-size:1.4rem}th,td{padding:6px 8px}}
"""


def axes(width: float = 5.6, height: float = 3.9) -> tuple[Figure, Axes]:
    """A figure in the page's style, in inches, and its axes."""
    with matplotlib.rc_context(_STYLE):
        figure = Figure(figsize=(width, height), layout="constrained")
        return figure, figure.add_subplot()


def panels(heights: Sequence[float], width: float = 5.6) -> tuple[Figure, list[Axes]]:
    """A figure in the page's style of panels one below the other, of these heights in inches, over one x axis."""
    with matplotlib.rc_context(_STYLE):
        figure = Figure(figsize=(width, sum(heights)), layout="constrained")
        rows = figure.subplots(len(heights), 1, sharex=True, squeeze=False, height_ratios=list(heights))
        return figure, list(rows[:, 0])


def legend(owner: Axes | Figure, **kwargs: Any) -> None:
    """A legend in the page's style, on axes or, with `loc="outside …"`, beside them."""
    with matplotlib.rc_context(_STYLE):
        owner.legend(**kwargs)


def figure(plot: Figure, title: str, caption: str) -> str:
    """HTML of a picture with its caption; the caption is also what a screen reader says."""
    buffer = io.BytesIO()
    with matplotlib.rc_context(_STYLE):
        plot.savefig(buffer, format="svg", metadata={"Date": None, "Creator": "ljjax"})
    data = base64.b64encode(buffer.getvalue()).decode()
    alt = escape(f"{title}. {caption}", quote=True)
    return (
        f'<figure><img alt="{alt}" src="data:image/svg+xml;base64,{data}">'
        f"<figcaption><strong>{escape(title)}.</strong> {escape(caption)}</figcaption></figure>"
    )


def table(heads: Sequence[str], rows: Sequence[Sequence[str]], numeric: Sequence[int] = ()) -> str:
    """HTML of a table that scrolls sideways where it is too wide; cells are HTML, those in `numeric` right-aligned."""

    def row(cells: Sequence[str], tag: str) -> str:
        mark = [' class="n"' if i in numeric else "" for i in range(len(cells))]
        return "<tr>" + "".join(f"<{tag}{m}>{c}</{tag}>" for m, c in zip(mark, cells, strict=True)) + "</tr>"

    body = "".join(row(cells, "td") for cells in rows)
    return f'<div class="scroll"><table><thead>{row(heads, "th")}</thead><tbody>{body}</tbody></table></div>'


def cards(entries: Sequence[tuple[str, str]]) -> str:
    """HTML of headline numbers: (number, what it is)."""
    inner = "".join(f'<div class="card"><b>{escape(n)}</b><span>{escape(w)}</span></div>' for n, w in entries)
    return f'<div class="cards">{inner}</div>'


def beware(lines: Sequence[str]) -> str:
    """HTML of what a reader must know before using the numbers; empty for no lines."""
    if not lines:
        return ""
    return f'<div class="beware"><b>Beware</b><ul>{"".join(f"<li>{escape(x)}</li>" for x in lines)}</ul></div>'


def page(title: str, subtitle: str, parts: Sequence[str]) -> str:
    """The whole page; it loads nothing from anywhere."""
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width,initial-scale=1">'
        f"<title>{escape(title)}</title><style>{_CSS}</style></head><body><main><h1>{escape(title)}</h1>"
        f'<p class="sub">{escape(subtitle)}</p>{"".join(parts)}</main></body></html>\n'
    )


def number(x: float | None, digits: int = 3) -> str:
    """A number for people: `digits` significant figures, a dash for None."""
    if x is None:
        return "–"
    return f"{x:.{digits}g}" if x == 0 or 1e-4 <= abs(x) < 1e5 else f"{x:.{digits - 1}e}"


def estimate(x: float, sd: float | None) -> str:
    """An estimate with its standard deviation, for people; what is nothing beside that reads 0."""
    nothing = sd is not None and abs(x) < 1e-3 * sd
    return f"{number(0.0 if nothing else x)} ± {number(sd, 2)}"
