"""report.html of a moving diagnosis: the gap, where it lies, its causes, the runs, how it closes, what to do next."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

import numpy as np

from ljjax import page
from ljjax.fit.session import by_start
from ljjax.gap import figures
from ljjax.gap.result import LAST, Diagnosis, Region
from ljjax.gap.static_figures import FALLS, plain, waterfall
from ljjax.gap.story import Course, Story, assumed, cards, degrees, headline, percent
from ljjax.model import get
from ljjax.page import estimate, number

DRAWN, ROWS, LEADERS, CLOSERS, FIRST = 8, 24, 7, 10, 8
"""At most: runs overlaid, timelines drawn, effects compared by their traces and by what they close; rows of the
candidates' table before it folds."""


def report(story: Any, result: Diagnosis, data: Mapping[str, Any]) -> str:
    """The page, from the result and its gap.json content. It loads nothing from anywhere."""
    robots = ", ".join(sorted({r.robot_id for r in result.runs if r.robot_id})) or "Robot"
    samples = sum(len(c.t) for c in story.courses)
    unseen = sum(c.held_out for c in story.courses)
    subtitle = (
        f"Where model and robot part, and why: from {samples:,} samples of {len(story.courses)} moving runs, {unseen} "
        f"of them kept from every fit, ljjax {data['version']}"
    )
    drawn, which = _drawn(story)
    parts = [
        f"<p><strong>{escape(headline(story, result))}</strong></p>",
        page.cards(cards(result)),
        page.beware(result.warnings),
        "<h2>Where it lies</h2>",
        *_grid([*_where(story, result), _regions(story, result)]),
        "<h2>What causes it</h2>",
        *_grid(_causes(story, result)),
        _candidates(story, result),
        _channels(story),
        "<h2>Measured, and predicted</h2>",
        f'<p class="sub">Each model runs freely from the run’s start, never corrected by the measurement. {which} The '
        "selected model beside every run is in <code>result.mcap</code>, laid out by <code>foxglove.json</code>.</p>",
        *_grid([_overlay(c, story.models(result)) for c in drawn]),
        "<h2>How far it closes</h2>",
        *_grid(_closing(story, result)),
        _left_out(result),
        _parameters(story),
        "<h2>What these data cannot tell apart</h2>",
        *_apart(story, result),
        "<h2>What to do next</h2>",
        _next(result),
        "<h2>The smallest effects these data could show</h2>",
        _smallest(story, result),
        "<h2>What was assumed</h2>",
        *_assumed(result),
        "<h2>Made from</h2>",
        _inputs(story, data),
    ]
    return page.page(f"{robots}: the gap between model and robot", subtitle, parts)


def _grid(pictures: Sequence[str]) -> list[str]:
    return ['<div class="grid">', *(x for x in pictures if x), "</div>"]


def _under(note: str, below: str) -> str:
    """A part of the page that follows another: a line of text, and what it is about."""
    return f'<div style="margin-top:1.2em"><p class="sub">{escape(note)}</p>{below}</div>'


# --- where


def _where(story: Story, result: Diagnosis) -> list[str]:
    courses, shown = story.courses, story.models(result)
    maps, out = figures.Maps(courses, shown), []
    for model in shown:
        caption = "RMS of measured − predicted over vacuum and angle, by direction of motion."
        caption += " One scale for both maps." if len(shown) > 1 else ""
        out.append(page.figure(maps.picture(model), f"Map, {figures.NAMES[model]}", caption))
    left = {m: np.array([float(np.sum(c.error(m) ** 2)) for c in courses]) for m in shown}
    first = sorted(np.argsort(-left[shown[0]], kind="stable")[:ROWS])
    for model in shown:
        caption = "Dark: when it errs. Right: each run’s share of this model’s squared error. ◂ not fitted."
        if len(first) < len(courses):
            caption += f" The {len(first)} of {len(courses)} runs with the largest error."
        whole = float(left[model].sum()) or 1.0
        shares = [float(left[model][i]) / whole for i in first]
        picture = figures.timelines([courses[i] for i in first], model, shown[0], shares)
        out.append(page.figure(picture, f"Runs over time, {figures.NAMES[model]}", caption))
    if courses[0].measured.shape[1] > 1:
        caption = "All runs together. An effect of one place on the body shows in its joints alone."
        out.append(page.figure(figures.joints(courses, shown), "Joint by joint", caption))
    return out


def _regions(story: Story, result: Diagnosis) -> str:
    if not result.where:
        return "<p>Beyond the noise nothing is left to place.</p>"
    rows = []
    for r in result.where:
        unit = "" if r.unit == "1" else r.unit.replace("rad", "deg")
        rows.append([r.block, r.channel, r.axis, escape(_span(story, r)), unit, f"{100 * r.share:.0f} %"])
    whose = "what the selected effects change" if result.selected else "what the base leaves"
    note = f"Along each axis the shortest range that holds most of {whose}; time counts from the first run’s start."
    return _under(note, page.table(["block", "channel", "along", "range", "unit", "share"], rows, numeric=(3, 5)))


def _span(story: Story, r: Region) -> str:
    """The range of a place, in words where its numbers stand for something."""
    low, high = (float(np.degrees(x)) if r.unit.startswith("rad") else x for x in r.range)
    if r.axis == "everywhere":
        return "everywhere"
    if r.axis == "direction":
        return "back to straight" if high <= 0 else ("away from straight" if low >= 0 else "both ways")
    if r.axis == "run":
        runs = by_start([*story.base.estimate.problem.motions, *story.setting.test])
        first, last = (runs[round(x) - 1].run.run_id for x in (low, high))
        return first if first == last else f"{first} … {last}"
    return number(low) if low == high else f"{number(low)} … {number(high)}"


# --- causes


def _causes(story: Story, result: Diagnosis) -> list[str]:
    caption = (
        f"Of {len(story.kinds)} candidates and none of them, the base refitted with each. Dark blue: selected; grey: "
        "no effect."
    )
    shown = [f for i, f in enumerate(result.effects) if f.probability >= 5e-3 or i < 6][:CLOSERS]
    out = [page.figure(figures.ranking(shown, result), "Probability of each cause", caption)]
    listed = [f for f in result.effects if f.id not in LAST and f.closed_fraction is not None]
    listed = sorted(listed, key=lambda f: (f.id not in story.found.single, -(f.closed_fraction or 0.0)))[:CLOSERS]
    if listed and result.verdict in ("listed_effect", "unlisted_effect"):
        caption = "Of the fitted runs’ gap, by itself. Hollow: not refitted, at most what the derivatives promise."
        picture = figures.closing(listed, result, story.found.single)
        out.append(page.figure(picture, "What each closes", caption))
    return out


def _candidates(story: Story, result: Diagnosis) -> str:
    rows = []
    for f in result.effects:
        block = story.kinds[f.id].block if f.id in story.kinds else "–"
        closed = "–" if f.closed_fraction is None else f"{100 * f.closed_fraction + 0.0:.0f}"
        closed = closed if f.id in story.found.single or closed == "–" else f"≤ {closed}"
        chance = "–" if f.p_value is None else ("&lt; 0.001" if f.p_value < 1e-3 else number(f.p_value, 2))
        values = "<br>".join(
            f"<code>{escape(n)}</code> {estimate(p['value'], p['sd'])} {_unit(p['unit'])}"
            for n, p in f.parameters.items()
        )
        mark = ' <span class="good">selected</span>' if f.id in result.selected else ""
        rows.append([escape(plain(f.id)) + mark, block, escape(percent(f.probability)), closed, chance, values])
    note = (
        "Closes: share of the fitted runs’ gap, by itself. p-value: how often data without any effect would gain as "
        "much by the best of all candidates."
    )
    heads = ["cause", "block", "probability", "closes [%]", "p-value", "parameters ± 1 sd"]
    return _under(note, _long(heads, rows, (2, 3, 4)))


def _long(heads: Sequence[str], rows: Sequence[Sequence[str]], numeric: Sequence[int]) -> str:
    """A table whose rows after the first few fold."""
    out = page.table(heads, rows[:FIRST], numeric)
    rest = rows[FIRST:]
    return out + (_folded(f"The other {len(rest)}", page.table(heads, rest, numeric)) if rest else "")


def _folded(title: str, inside: str) -> str:
    return f'<details style="margin-top:10px"><summary>{escape(title)}</summary>{inside}</details>'


def _unit(unit: str) -> str:
    return "" if unit == "1" else escape(unit)


def _channels(story: Story) -> str:
    """What the measured inputs say by themselves."""
    rows = []
    for c in story.measured.channels:
        unit = {"tension": "N", "pressure": "kPa"}.get(c.name, "")
        best = f"{plain(c.best)} explains {100 * (1 - c.left[c.best]):z.0f} %" if c.left else "agrees with its command"
        rows.append([f"measured {c.name}", number(c.rms), number(c.noise), unit, best])
    if not rows:
        return ""
    note = "Measured inputs beside their commands, without the body between them."
    return _under(note, page.table(["channel", "RMS − command", "white noise", "unit", ""], rows, numeric=(1, 2)))


# --- runs


def _drawn(story: Story) -> tuple[list[Course], str]:
    """The runs that are overlaid, and which those are in words."""
    courses = story.courses
    if len(courses) <= DRAWN:
        return courses, ""
    which = f"{DRAWN} of {len(courses)} runs: those not fitted first, then those that the base explains worst."
    return courses[:DRAWN], which


def _overlay(c: Course, shown: Sequence[str]) -> str:
    role = "not fitted" if c.held_out else "fitted"
    errors = ", ".join(f"{figures.NAMES[m]} {degrees(float(np.sqrt(np.mean(c.error(m) ** 2))))}" for m in shown)
    joint = "" if c.measured.shape[1] == 1 else f" Drawn: joint {c.worst + 1}, in which the base errs most."
    caption = f"RMS error: {errors}.{joint} Grey band: ± 2 sd of white noise."
    return page.figure(figures.overlay(c, shown), f"{c.run_id}, {role}", caption)


# --- how far


def _closing(story: Story, result: Diagnosis) -> list[str]:
    names, level = [s.what for s in story.steps], [float(np.degrees(s.test)) for s in story.steps]
    floor = float(np.degrees(result.gap.noise_floor))
    picture = waterfall(names, level, floor, "°", "RMS error on runs that no fit has seen")
    rows = [[escape(s.what), degrees(s.train), degrees(s.test)] for s in story.steps]
    fitted = float(np.sqrt(np.mean(story.setting.study.noise**2)))
    rows.append(["noise floor", degrees(fitted), degrees(result.gap.noise_floor)])
    table = page.table(["RMS error", "runs fitted", "runs not fitted"], rows, numeric=(1, 2))
    return [page.figure(picture, "From error to noise", FALLS), f"<div>{table}</div>"]


def _left_out(result: Diagnosis) -> str:
    """How far the gap closes in conditions that are left out of the fits."""
    if not result.folds:
        return ""
    rows = [
        [escape(", ".join(f.runs)), number(f.pressure_kpa), _whole_percent(f.closed_fraction)]
        for f in sorted(result.folds, key=lambda f: f.pressure_kpa if f.by == "pressure" else 0.0)
    ]
    what = "every pressure" if result.folds[0].by == "pressure" else "every run"
    note = (
        f"Fitted runs, {what} in turn left out of both fits and predicted (to first order): how much of its gap the "
        "selected effects close there. –: no gap there."
    )
    return _under(note, page.table(["left out", "mean vacuum [kPa]", "closes"], rows, numeric=(1, 2)))


def _whole_percent(share: float | None) -> str:
    return "–" if share is None else f"{100 * share:z.0f} %"


def _parameters(story: Story) -> str:
    """The base's own parameters along the way."""
    models = [story.setting.study.start, story.base.model, *([story.extended.model] if story.extended else [])]
    rows = [
        [f"<code>{escape(n)}</code>", *(number(float(get(m, n)), 4) for m in models)]
        for n in story.base.estimate.problem.coordinates.names
    ]
    heads = ["parameter", "given", "base refitted", "with the effects"][: 1 + len(models)]
    note = "The base’s own parameters, as given, refitted alone, and refitted together with what was added."
    if not story.extended:
        note = "The base’s own parameters, as given and refitted."
    return _under(note, page.table(heads, rows, numeric=(1, 2, 3)))


# --- what next


def _apart(story: Story, result: Diagnosis) -> list[str]:
    out = [
        f"<p><strong>{escape(', '.join(plain(i) for i in group))}</strong>: with any of them these runs are explained "
        "as well; the most probable was selected.</p>"
        for group in result.equivalent
    ]
    if not out:
        nothing = "No effect was selected; how alike the candidates’ traces would be all the same:"
        said = "No other candidate explains these runs as well as what was selected." if result.selected else nothing
        out = [f"<p>{said}</p>"]
    ids = story.leaders([f.id for f in result.effects], LEADERS)
    if len(ids) > 1:
        caption = (
            "1: to first order one mimics the other, once the base’s parameters have taken up what they can; 0: "
            "nothing in common. Traces that are alike while small may part once they are as large as here."
        )
        picture = page.figure(figures.likeness(ids, story.likeness(ids)), "How alike the leaders’ traces are", caption)
        out.append(f'<div style="max-width:36rem">{picture}</div>')
    return out


def _next(result: Diagnosis) -> str:
    n = result.next_experiment
    if not n:
        return "<p>Nothing is left to part.</p>"
    title, pair = plain(n["protocol"]), " from ".join(plain(i) for i in n["separates"])
    why = n["why"][:1].upper() + n["why"][1:]
    return (
        f"<p><strong>{escape(title[:1].upper() + title[1:])}</strong> parts {escape(pair)} best, by "
        f"{number(n['expected_separation'])} × the noise. {escape(why)}.</p>"
    )


def _smallest(story: Story, result: Diagnosis) -> str:
    found = {f.id: f.parameters for f in result.effects if f.id in result.selected}
    rows = []
    for i in (f.id for f in result.effects if f.id in result.minimum_detectable):
        a = result.minimum_detectable[i]
        here = found.get(i, {}).get(a["parameter"])
        block = story.kinds[i].block if i in story.kinds else "–"
        name, seen = f"<code>{escape(a['parameter'])}</code>", "" if here is None else number(here["value"])
        rows.append([escape(plain(i)), block, name, number(a["value"], 2), _unit(a["unit"]), seen])
    if not rows:
        return "<p>None.</p>"
    note = (
        "What would stand out of what is left by 3.5 standard deviations, to first order; the likeliest causes first."
    )
    heads = ["effect", "block", "parameter", "size", "unit", "found here"]
    return f"<p class='sub'>{note}</p>" + _long(heads, rows, (3, 5))


# --- what was assumed


def _assumed(result: Diagnosis) -> list[str]:
    out = [x for x in result.said if x.startswith("left out")]
    each = [x for x in result.said if x not in out]
    return [_list([*assumed(result), *out]), _folded("What each log gave", _list(each)) if each else ""]


def _inputs(story: Story, data: Mapping[str, Any]) -> str:
    before = {c.run_id: (c.error("base"), c.error("extended")) for c in story.courses}
    rows = []
    for x in data["inputs"]:
        errors = [degrees(float(np.sqrt(np.mean(e**2)))) for e in before.get(x["run_id"], ())] or ["–", "–"]
        name, file = (
            f'<span style="white-space:nowrap">{escape(x["run_id"])}</span>',
            f"<code>{escape(x['file'])}</code>",
        )
        role = "fitted" if x["role"] == "train" else "not fitted" if x["run_id"] in before else "left out"
        cells = [name, role, *errors[: 2 if story.extended else 1]]
        rows.append([*cells, file, f"<code>{x['sha256'][:16]}…</code>"])
    heads = ["run", "role", "base error", *(["with the effects"] if story.extended else []), "file", "sha256"]
    return page.table(heads, rows, numeric=(2, 3) if story.extended else (2,))


def _list(lines: Sequence[str]) -> str:
    return "<ul>" + "".join(f"<li>{escape(x)}</li>" for x in lines) + "</ul>"
