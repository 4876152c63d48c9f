"""report.html of a static fit: pictures first, tables under them; and the tables that every fit has."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from typing import Any

import numpy as np

from ljjax import page
from ljjax.fit import figures
from ljjax.fit.points import UNIT
from ljjax.fit.result import FitResult, StaticResult
from ljjax.page import number


def report(result: StaticResult, data: Mapping[str, Any]) -> str:
    """The page, from the result and its fit.json content. It loads nothing from anywhere."""
    robots = data["robot_id"] if isinstance(data["robot_id"], str) else ", ".join(data["robot_id"])
    fitted = [p for p in result.parameters.values() if p.source != "model"]
    known = sum(p.verdict == "identifiable" for p in fitted)
    counts = ", ".join(f"{len(s.points)} {k} points" for k, s in result.static.stages.items())
    subtitle = f"Identified from {counts} in {len(result.runs)} logs, ljjax {data['version']}"
    moving = sum(p.unsettled for p in fitted)
    note = f", {moving} of them moving with the pressures used" if moving else ""
    headline = [(f"{known} of {len(fitted)}", f"fitted parameters identifiable{note}")]
    for kind, stage in result.static.stages.items():
        unit = data["residuals"][kind]["unit"]
        headline.append((f"{stage.rmse:.3g} {unit}", f"RMS error, {kind} points (R² {stage.r_squared:.3f})"))
        if (inner := data["held_out"][kind]["rmse_inner"]) is not None:
            headline.append((f"{inner:.3g} {unit}", f"RMS error at inner pressures left out, {kind}"))
    parts = [page.cards(headline), page.beware(result.warnings), '<div class="grid">', *_figures(result), "</div>"]
    parts += ["<h2>Parameters</h2>", parameters_table(result, data), "<h2>In the paper’s units</h2>", _paper(data)]
    parts += ["<h2>Errors by pressure</h2>", _errors(result, data), "<h2>Where the fit is worst</h2>", _worst(result)]
    parts += ["<h2>Made from</h2>", inputs_table(data), "<h2>Assumed, not fitted</h2>", assumed_table(result, data)]
    return page.page(f"{robots or 'Robot'}: identified model", subtitle, parts)


def _figures(result: StaticResult) -> list[str]:
    out = []
    if stage := result.static.stages.get("steady"):
        worst = int(np.argmax(np.abs(stage.error)))
        at = f"{np.degrees(stage.points.theta[worst]):.3g}° and {stage.points.pressure_kpa[worst]:.3g} kPa"
        out += [
            page.figure(
                figures.tension(result, stage), "Tension that holds an angle", "Dots: measured ± 1 sd. Lines: model."
            ),
            page.figure(
                figures.residuals(stage), "What the model leaves over angle", "A trend is structure the model lacks."
            ),
            page.figure(figures.error_map(stage), "Where the fit is worst", f"Largest error (framed) at {at}."),
        ]
    if stage := result.static.stages.get("probe"):
        out.append(
            page.figure(figures.probe(result, stage), "Tip stiffness", "K_T = 1/(aᵀK⁻¹a), measured by a probe at rest.")
        )
    for kind, stage in result.static.stages.items():
        if np.any(np.isfinite(stage.held_out)):
            out.append(
                page.figure(
                    figures.left_out(stage),
                    f"Pressures left out, {kind}",
                    "How well the law over pressure predicts a pressure it has not seen.",
                )  # fmt: skip
            )
    out.append(
        page.figure(
            figures.intervals(result),
            "Intervals",
            "Line: 95 %, if the model’s form holds; green where it excludes 0 and holds over pressures. "
            "Grey: ± 2 sd over left-out pressures. "
            "Past a dotted line the sign is unknown.",
        )  # fmt: skip
    )
    out.append(page.figure(figures.correlation(result), "Correlations", "Near ± 1: the data cannot part the two."))
    return out


def parameters_table(result: FitResult, data: Mapping[str, Any]) -> str:
    """Every fitted parameter, its uncertainty, and why it is or is not known."""
    rows = []
    pressures = any(p.sd_over_pressures is not None for p in result.fitted)
    for p in result.fitted:
        low, high = p.ci95 or (None, None)
        mark = "good" if p.settled else "bad"
        rows.append(
            [
                f"<code>{p.name}</code>",
                number(p.value, 4),
                number(p.sd),
                escape(p.unit),
                f'<span class="{mark}">{p.judgement}</span>',
                f"{number(low, 4)} … {number(high, 4)}",
                *([number(p.sd_over_pressures)] if pressures else []),
                f'<span class="why">{escape(p.reason)}</span>',
            ]  # fmt: skip
        )
    heads = ["parameter", "value", "± 1 sd", "unit", "verdict", "95 % interval"]
    heads += [*(["± over pressures"] if pressures else []), "why"]
    note = f"<p class='sub'>SI, with lever arm {data['lever_arm_m']:g} m; gauge {escape(data['gauge'])}.</p>"
    return note + page.table(heads, rows, numeric=(1, 2, 5, 6) if pressures else (1, 2, 5))


def _paper(data: Mapping[str, Any]) -> str:
    paper = data["paper"]
    published = paper.get("published", {})
    rows = []
    for name in ("alpha1", "c1", "c2", "c3", "c3_without_alpha1", "c4", "c5"):
        if name in paper:
            unit = paper["units"][name.split("_")[0]]
            known = published.get(name.split("_")[0])
            rows.append(
                [
                    name.replace("_", " "),
                    number(paper[name], 6),
                    number(paper["sd"][name]),
                    number(known, 7),
                    escape(unit),
                ]
            )
    if "rmse_n" in paper:
        rows.append(["RMSE of tension", number(paper["rmse_n"], 4), "–", number(published.get("rmse_n"), 4), "N"])
    if "r_squared" in paper:
        rows.append(["R² of K_T", number(paper["r_squared"], 4), "–", number(published.get("r_squared"), 4), ""])
    laws = "u = α₁ sin(nθ) + α₂(u_P)θ, K_T = c₄ + c₅√u_P"
    note = f"<p class='sub'>g = 1, angles in degrees, plain least squares: {laws}.</p>"
    return note + page.table(["quantity", "identified", "± 1 sd", "published", "unit"], rows, numeric=(1, 2, 3))


def _errors(result: StaticResult, data: Mapping[str, Any]) -> str:
    rows = []
    for kind, stage in result.static.stages.items():
        held, levels = data["held_out"][kind], stage.points.levels
        for k, (p, out) in enumerate(zip(held["pressure_kpa"], held["rmse"], strict=True)):
            error = stage.error[levels == k]
            rms = float(np.sqrt(np.mean(error**2)))
            rows.append(
                [
                    kind,
                    number(round(p, 1)),
                    str(len(error)),
                    number(rms),
                    number(float(error.mean())),
                    number(out),
                    held["unit"],
                ]
            )
    heads = ["points", "u_P [kPa]", "count", "RMS error", "mean error", "RMS, left out", "unit"]
    return page.table(heads, rows, numeric=(1, 2, 3, 4, 5))


def _worst(result: StaticResult) -> str:
    rows = []
    for kind, stage in result.static.stages.items():
        p = stage.points
        for i in np.argsort(-np.abs(stage.error))[:5]:
            run = escape(result.runs[int(p.run[i])].run_id)
            sd = float(p.sd[i]) if np.isfinite(p.sd[i]) else None
            cells = [p.pressure_kpa[i], np.degrees(p.theta[i]), p.value[i], stage.predicted[i], stage.error[i]]
            rows.append([kind, run, *(number(float(x), 4) for x in cells), number(sd), UNIT[kind]])
    heads = ["points", "run", "u_P [kPa]", "θ [deg]", "measured", "model", "error", "stated sd", "unit"]
    return page.table(heads, rows, numeric=(2, 3, 4, 5, 6, 7))


def inputs_table(data: Mapping[str, Any]) -> str:
    """The logs it was made from."""
    rows = []
    for x in data["inputs"]:
        state = escape(x["partial"] or "whole") + (", not fitted" if x["role"] == "held_out" else "")
        file, digest = f"<code>{escape(x['file'])}</code>", f"<code>{x['sha256'][:16]}…</code>"
        rows.append([escape(x["run_id"]), escape(x["experiment"]), file, digest, state])
    return page.table(["run", "experiment", "file", "sha256", "state"], rows)


def assumed_table(result: FitResult, data: Mapping[str, Any]) -> str:
    """What was not fitted, and where its values came from."""
    rows = [
        [f"<code>{p.name}</code>", number(p.value, 6), escape(p.unit), p.verdict]
        for p in result.parameters.values()
        if p.source == "model"
    ]
    return f"<p class='sub'>From {escape(data['start'])}.</p>" + page.table(
        ["parameter", "value", "unit", ""], rows, numeric=(1,)
    )
