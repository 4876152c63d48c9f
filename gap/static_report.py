"""report.html of a diagnosis of steady data: the gap, where it lies, its cause, what is left, what to do next."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from typing import Any

import numpy as np

from ljjax import page
from ljjax.gap import static_figures as figures
from ljjax.gap.candidates import in_words
from ljjax.gap.result import LAST, Diagnosis
from ljjax.gap.static_figures import plain
from ljjax.gap.static_next import absorbed
from ljjax.gap.static_words import unexplained
from ljjax.model import get
from ljjax.page import number

NAMES = {"steady": "tension at rest", "probe": "tip stiffness"}


def report(story: Any, result: Diagnosis, data: Mapping[str, Any]) -> str:
    """The page."""
    robots = ", ".join(sorted({r.robot_id for r in result.runs if r.robot_id})) or "Robot"
    counts = " and ".join(f"{len(c.points)} {c.kind} points" for c in story.channels)
    subtitle = f"Where model and robot part at rest, from {counts}, ljjax {data['version']}"
    parts = [f"<p><strong>{escape(headline(story, result))}</strong></p>", page.cards(_cards(story, result))]
    left = [w for w in result.warnings if not w.startswith("unexplained: ")]
    parts += [page.beware(left)]
    parts += ["<h2>How large the gap is, and where it lies</h2>", '<div class="grid">', *_gap(story), "</div>"]
    parts += ["<h2>What causes it</h2>", '<div class="grid">', *_cause(story, result), "</div>"]
    parts += ["<h2>How far it closes</h2>", '<div class="grid">', *_closing(story), "</div>"]
    parts += ["<h2>The effects in numbers</h2>", _selected(result), "<h2>All candidates</h2>", _effects(story, result)]
    parts += ["<h2>What stays unexplained</h2>", _list(unexplained(story))]
    parts += ['<div class="grid">', *_left(story), "</div>"]
    parts += ["<h2>What these data cannot tell apart</h2>", _list(_confused(story, result))]
    parts += ["<h2>What to measure next</h2>", _next(result)]
    parts += ["<h2>The smallest effects these data could show</h2>", _smallest(result)]
    parts += ["<h2>What was assumed</h2>", _list(_assumed(story)), "<h2>Made from</h2>", _inputs(data)]
    return page.page(f"{robots}: the gap at rest", subtitle, parts)


def headline(story: Any, result: Diagnosis) -> str:
    """The answer in a sentence or two."""
    gap = result.gap
    if result.verdict == "listed_effect":
        said = []
        for c in story.channels:
            if c.added:
                what = " and ".join(f"{plain(e)} ({in_words(story.laws.kinds[e])})" for e in c.added)
                inner = " between the outermost" if c.inner.sum() < len(c.points) and c.kind == "steady" else ""
                keep = c.inner if inner else None
                said.append(
                    f"The {NAMES[c.kind]} shows {what}: the error at pressures left out{inner} falls from "
                    f"{c.base.rms(keep):.3g} to {c.model.rms(keep):.2g} {c.unit}."
                )
        return " ".join(said)
    if result.verdict == "unlisted_effect":
        return (
            f"Something real is left that no listed effect explains: {gap.before:.3g} {gap.unit} at pressures left "
            f"out, against a scatter of {gap.noise_floor:.2g} {gap.unit}."
        )
    if result.verdict == "no_gap":
        return "No gap: the given model already explains these points to their scatter."
    return "No effect is needed: refitting the base model's own parameters closes the gap."


def _cards(story: Any, result: Diagnosis) -> list[tuple[str, str]]:
    first = result.effects[0]
    gap = result.gap
    out = [
        (plain(result.verdict), "verdict"),
        (f"{100 * first.probability:.0f} %", f"that {plain(first.id)} is the main cause"),
    ]
    for c in story.channels:
        keep = c.inner if c.kind == "steady" else None
        where = "inner pressures left out" if keep is not None and keep.sum() < len(c.points) else "pressures left out"
        change = f"{c.base.rms(keep):.3g} → {c.model.rms(keep):.2g} {c.unit}"
        out.append((change, f"error at {where}, {NAMES[c.kind]} (scatter {c.noise:.2g})"))
    if gap.closed_fraction is not None and gap.closed_fraction_ci95 is not None:
        low, high = (100 * x for x in gap.closed_fraction_ci95)
        closed = 100 * gap.closed_fraction
        out.append((f"{closed:z.0f} %", f"of the {gap.channel} gap closed (95 %: {low:z.0f} to {high:z.0f} %)"))
    return out


def _gap(story: Any) -> list[str]:
    out = []
    for c in story.channels:
        title = f"Errors at pressures left out, {NAMES[c.kind]}"
        out.append(
            page.figure(figures.left_out(c), title, "Each pressure in turn is left out of the fit and predicted.")
        )
        if c.kind == "steady":
            caption = "Each pressure predicted by the base model fitted to the others. One colour along a column: "
            caption += "the law over pressure is off; along a row: the law over angle."
            out.append(page.figure(figures.where(c), "Where the base model is off", caption))
    return out


def _cause(story: Any, result: Diagnosis) -> list[str]:
    caption = "Of all 31 candidates and none of them; each refitted together with the base parameters. Dark: selected."
    caption = caption.replace("31", str(len(story.laws.kinds)))
    out = [page.figure(figures.ranking(result), "Causes", caption)]
    for c in story.channels:
        if c.kind == "steady":
            caption = "Dots: measured. Dashed: base model. Solid: with the effects."
            out.append(page.figure(figures.tension(story, c), "Tension that holds an angle", caption))
        title = "Tension over pressure" if c.kind == "steady" else "Tip stiffness over pressure"
        caption = "Hollow: what each model, fitted without a pressure, says there (where it lies in the frame)."
        out.append(page.figure(figures.law(story, c), title, caption))
    return out


def _closing(story: Any) -> list[str]:
    return [
        page.figure(figures.closing(c), f"From error to scatter, {NAMES[c.kind]}", figures.FALLS)
        for c in story.channels
    ]


def _left(story: Any) -> list[str]:
    out = []
    for c in story.channels:
        if c.kind == "steady":
            caption = "A line that does not start at 0 is an intercept that no model here has."
            out.append(page.figure(figures.leftover(c), "What the extended model leaves", caption))
    if story.apart:
        caption = "Not fitted, not averaged in: at the same angles and pressures the logs disagree."
        out.append(page.figure(figures.apart(story.apart), "The other log", caption))
    return out


def _selected(result: Diagnosis) -> str:
    rows = []
    for f in result.effects:
        if f.id in result.selected:
            for name, p in f.parameters.items():
                rows.append(
                    [plain(f.id), f"<code>{name}</code>", number(p["value"], 4), number(p["sd"]), escape(p["unit"])]
                )
    base = []
    for name in ("gravity.alpha1", "elastic.c1", "elastic.c2", "elastic.c3", "jamming.c4", "jamming.c5"):
        old, new = (float(get(m.model, name)) for m in (result.base, result.model))
        gone = '<span class="why">not needed beside the effects</span>' if new == 0 and old != 0 else ""
        base.append([f"<code>{name}</code>", number(old, 4), number(new, 4), gone])
    out = page.table(["effect", "parameter", "value", "± 1 sd", "unit"], rows, numeric=(2, 3)) if rows else ""
    note = "<p class='sub'>Base parameters, refitted alone and together with the effects.</p>"
    return out + note + page.table(["parameter", "alone", "with effects", ""], base, numeric=(1, 2))


def _effects(story: Any, result: Diagnosis) -> str:
    unseen = [set(c.rounds[0].unseen) for c in story.channels]
    nowhere = set.intersection(*unseen) if unseen else set()
    gone = [set(absorbed(c.rounds[0])) for c in story.channels]
    rows = []
    for f in result.effects:
        if f.id in nowhere or f.id in LAST:
            continue
        hidden = all(f.id in a or f.id in u for a, u in zip(gone, unseen, strict=True))
        why = "base parameters take it up" if hidden else ("selected" if f.id in result.selected else "")
        block = story.laws.kinds[f.id].block
        closed = None if f.closed_fraction is None else round(100 * min(max(f.closed_fraction, 0.0), 1.0), 0)
        rows.append([
            plain(f.id), block, f"{100 * f.probability:.0f} %", number(closed), number(f.p_value, 2),
            f'<span class="{"good" if why == "selected" else ""}">{why}</span>',
        ])  # fmt: skip
    for name in LAST:
        p = next(f.probability for f in result.effects if f.id == name)
        rows.append([plain(name), "–", f"{100 * p:.0f} %", "–", "–", ""])
    heads = ["cause", "block", "probability", "misfit closed by itself [%]", "p-value", ""]
    table = page.table(heads, rows, numeric=(2, 3, 4))
    words = ", ".join(plain(e) for e in sorted(nowhere))
    return table + (
        f"<p class='sub'>Not visible in data at rest, so never claimed from them: {words}.</p>" if words else ""
    )


def _confused(story: Any, result: Diagnosis) -> list[str]:
    out = [f"{', '.join(plain(e) for e in group)}: the same change to these data" for group in result.equivalent]
    gone = set.intersection(*(set(absorbed(c.rounds[0])) | set(c.rounds[0].unseen) for c in story.channels))
    gone -= set.intersection(*(set(c.rounds[0].unseen) for c in story.channels))
    if gone:
        out.append(f"{', '.join(plain(e) for e in sorted(gone))}: base parameters take their whole trace up")
    return out or ["nothing among the leaders"]


def _next(result: Diagnosis) -> str:
    n = result.next_experiment
    if not n:
        return "<p>Nothing is left to part.</p>"
    return f"<p><strong>{escape(n['protocol'][:1].upper() + n['protocol'][1:])}.</strong> {escape(n['why'])}.</p>"


def _smallest(result: Diagnosis) -> str:
    rows = [
        [plain(e), f"<code>{a['parameter']}</code>", number(a["value"], 2), escape(a["unit"])]
        for e, a in result.minimum_detectable.items()
    ]
    return page.table(["effect", "parameter", "size", "unit"], rows, numeric=(2,)) if rows else "<p>None.</p>"


def _assumed(story: Any) -> list[str]:
    out = [
        f"Geometry and lever arm from {story.start_from}; at rest friction is averaged out and lags have settled.",
        "Every effect is tried in the form its own page gives; another form of the same cause may fit better still.",
        "Chance is judged on data simulated from the model without the effect, with an offset and a slope of their own "
        "for each pressure, as large as that model's misfit, and scatter alike between neighbouring angles.",
    ]
    for c in story.channels:
        n = c.data.tested.independent
        source = "stated" if c.points.scatter else "of points about their neighbours"
        out.append(
            f"{len(c.points)} {c.kind} points count as {n:.0f} independent ones, with a scatter of {c.noise:.3g} "
            f"{c.unit} ({source})."
        )
    return out


def _inputs(data: Mapping[str, Any]) -> str:
    rows = []
    for x in data["inputs"]:
        role = "fitted, each pressure left out in turn" if x["role"] == "train" else "compared only"
        rows.append(
            [escape(x["run_id"]), f"<code>{escape(x['file'])}</code>", f"<code>{x['sha256'][:16]}…</code>", role]
        )
    return page.table(["run", "file", "sha256", "role"], rows)


def _list(lines: list[str]) -> str:
    return "<ul>" + "".join(f"<li>{escape(np.str_(x))}</li>" for x in lines) + "</ul>"
