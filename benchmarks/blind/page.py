"""docs/blind.md and its pictures, from the answers kept in answered.json: `python -m benchmarks.blind.page`.

It is of the seed asked last; all seeds kept, each as answered by the code of its day, are counted beside it.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.blind import figures, judge

KEPT = Path(__file__).with_name("answered.json")
DOCS = Path(__file__).parents[2] / "docs"
HEAD = """# The blind check

How well `ljjax gap` names causes, on {count} robots from two simulators that share no code with ljjax. What is planted,
how the labels are sealed and how answers are judged is told [beside the code](../benchmarks/blind/README.md), as is
the score of earlier seeds. This page is written by

```sh
{command}
```

and holds whatever came out, failures included, as the code of {code} answered. A share of few cases is known
roughly: the interval beside it is Wilson's, of 95 %. The simulators' shapes are a fixed set. Robots of seeds before
this one have been opened, and where the diagnosis missed for want of a form it was added, so expect less of shapes that
nobody here has met: how much less, was asked of one of each cause
([shapes that nobody had asked](../benchmarks/blind/README.md#shapes-that-nobody-had-asked)).

"""
GOALS = "goal", "asked", "reached", "95 %", "cases", ""
BEFORE = """The {count} robots of seeds {seeds}, each as answered by the code of its day before its label was opened."""
MARK = {True: "met", False: "**missed**", None: "no cases"}
RIGHT = {True: "yes", False: "**no**", None: "–"}


def keep(found: Mapping[str, Any], command: str, kept: Path = KEPT) -> None:
    """Add the answers of one seed, in the place of earlier ones of it, to the file `kept`, one a line."""
    new = [
        {"seed": found["seed"], "command": command, "timing": found["timing"].get(row["case"]), **row}
        for row in found["cases"]
    ]
    rows = [row for row in _rows(kept) if row["seed"] != found["seed"]] + new
    kept.write_text("[\n" + ",\n".join(json.dumps(row) for row in rows) + "\n]\n", encoding="utf-8")


def write(kept: Path = KEPT, docs: Path = DOCS) -> None:
    """The page, its confusion matrix and its reliability diagram into the folder `docs`."""
    every = _rows(kept)
    if not every:
        raise SystemExit(f"{kept}: holds no answers; python -m benchmarks.blind.study --page keeps those it gets")
    rows = [r for r in every if r["seed"] == every[-1]["seed"]]
    found = _counted(rows)
    command = "\n".join(dict.fromkeys(r["command"] for r in rows))
    code = " and ".join(sorted({f"commit {r['code']}" for r in found["cases"]}))
    lines = [HEAD.format(count=len(found["cases"]), command=command, code=code)]
    lines += _table(GOALS, [_goal(r) for r in found["rows"]])
    lines += _kinds(found)
    if found["calibration"]["bins"]:
        lines.append(f"{_calibration(found)}\n\n![Reliability](blind_reliability.png)\n\n")
        figures.reliability(found, docs / "blind_reliability.png")
    if found["confusion"]:
        lines.append("![Planted against first answer](blind_confusion.png)\n\n")
        figures.confusion(found, docs / "blind_confusion.png")
    if len(rows) < len(every):
        seeds = dict.fromkeys(str(r["seed"]) for r in every)
        together = _counted(every)
        lines.append(f"## With the seeds before it\n\n{BEFORE.format(count=len(every), seeds=', '.join(seeds))}\n\n")
        lines += [*_table(GOALS, [_goal(r) for r in together["rows"]]), *_kinds(together)]
        lines.append(f"{_calibration(together)}\n\n" if together["calibration"]["bins"] else "")
    lines.append("## Every case\n\n")
    head = ("planted", "gap ÷ noise", "verdict", "first", "selected", "right", "closed")
    lines += _table(head, [_case(r) for r in found["cases"]])
    (docs / "blind.md").write_text("".join(lines).rstrip() + "\n", encoding="utf-8")


def _counted(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """The scoreboard of rows, with the times measured of them."""
    return judge.scoreboard(rows, {f"{r['seed']}-{r['case']}": r["timing"] for r in rows if r["timing"]})


def _kinds(found: Mapping[str, Any]) -> list[str]:
    head = ("kind (see [beside the code](../benchmarks/blind/README.md))", "cases", "first answer right")
    rows = [(kind, str(k["cases"]), f"{k['top_right']:.3g}") for kind, k in found["by_kind"].items() if k["cases"]]
    return _table(head, rows)


def _calibration(found: Mapping[str, Any]) -> str:
    c = found["calibration"]
    return (
        f"Calibration of the first answer's probability: expected calibration error {c['ece']:.3f}, where "
        f"true probabilities would show {c['by_chance']:.3f} on average over as many cases; Brier score "
        f"{c['brier']:.3f} over all answers."
    )


def _rows(kept: Path) -> list[dict[str, Any]]:
    return json.loads(kept.read_text(encoding="utf-8")) if kept.exists() else []


def wilson(share: float, count: int) -> tuple[float, float]:
    """95 % interval of a share of so many cases (Wilson, 1927)."""
    z2 = 1.96**2
    middle = (share + z2 / (2 * count)) / (1 + z2 / count)
    half = 1.96 * (share * (1 - share) / count + z2 / (4 * count**2)) ** 0.5 / (1 + z2 / count)
    return max(middle - half, 0.0), min(middle + half, 1.0)


def _goal(r: Mapping[str, Any]) -> list[str]:
    share, count = r["value"], int(r["cases"])
    value, interval = "–" if share is None else f"{share:.3g}", ""
    if share is not None and count > 1 and not any(x in r["name"] for x in ("median", "error", "time")):
        low, high = wilson(float(share), count)
        interval = f"{low:.2f} – {high:.2f}"
    return [r["name"], r["goal"], value, interval, str(count), MARK[r["met"]]]


def _case(r: Mapping[str, Any]) -> list[str]:
    planted = " + ".join(r["truth"]) or r["kind"]
    planted += " (deleted)" * (r["kind"] == "without") + " (MuJoCo)" * (r["kind"] == "mujoco")
    gap = f"{r['gap_over_noise']:.1f}" + " (weak)" * (not r["attained"]) if r["truth"] else "–"
    first = ", ".join(f"{name} {p:.2f}" for name, p in r["top"][:1])
    right = r["exactly"] if r["kind"] == "pairs" and "exactly" in r else r["top_right"]
    closed = "–" if r["closed"] is None else f"{r['closed']:.2f}"
    return [planted, gap, str(r["verdict"]), first, ", ".join(r["selected"]), RIGHT[right], closed]


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    lines = [head, ["---"] * len(head), *rows]
    return ["| " + " | ".join(line) + " |\n" for line in lines] + ["\n"]


if __name__ == "__main__":
    write()
