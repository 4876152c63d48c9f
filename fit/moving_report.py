"""report.html of a dynamic fit: whether to trust it, pictures, tables under them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

import numpy as np

from ljjax import page
from ljjax.fit import figures, moving_figures
from ljjax.fit.moving import DynamicResult
from ljjax.fit.moving_figures import Axis, Trace
from ljjax.fit.points import UNIT
from ljjax.fit.report import assumed_table, inputs_table, parameters_table
from ljjax.page import number

ALL, SOME = 12, 8
"""Up to so many runs are all drawn; of more than that, so many."""
WORSE = 1.5
"""By how much an error must exceed another to be said to be larger."""


def report(result: DynamicResult, data: Mapping[str, Any]) -> str:
    """The page, from the result and its fit.json content. It loads nothing from anywhere."""
    robots = data["robot_id"] if isinstance(data["robot_id"], str) else ", ".join(data["robot_id"])
    shown = moving_figures.traces(result)
    drawn, which = _drawn(shown)
    trust, why = verdict(result)
    inputs = "measured tensions and pressure" if result.options.get("inputs") == "measured" else "commands"
    parts = [
        page.cards(_headline(result)),
        f'<p><b class="{"good" if trust else "bad"}">{escape(why)}</b></p>',
        page.beware(result.warnings),
        "<h2>What was identified, and how well</h2>",
        *_grid(_knowledge(result)),
        f"<h2>Runs: measured, and simulated from {inputs}</h2>",
        f'<p class="sub">Simulated freely from rest, never corrected by the measurement. {which}</p>',
        *_grid(_runs(result, drawn)),
        "<h2>Friction, and what the model leaves</h2>",
        *_grid(_left(result, [t for t in shown if t.said.role == "train"])),
        "<h2>The search</h2>",
        f'<p class="sub">{escape(_search(data))}</p>',
        *_grid(_course(result, data)),
        "<h2>Parameters</h2>",
        parameters_table(result, data),
        "<h2>Run by run</h2>",
        _errors(data),
    ]
    if result.estimate.problem.points:
        parts += ["<h2>Steady and probe points</h2>", _points(result)]
    parts += ["<h2>Made from</h2>", inputs_table(data), "<h2>Assumed or frozen, not fitted</h2>"]
    parts += [assumed_table(result, data)]
    samples = len(result.estimate.windows.y)
    subtitle = f"Identified from {samples:,} samples of {len(result.moving)} moving runs, ljjax {data['version']}"
    return page.page(f"{robots or 'Robot'}: identified model", subtitle, parts)


# --- in short


def rms_deg(result: DynamicResult, role: str = "train") -> float | None:
    """RMS error of θ [deg] over all samples of free runs, fitted (`train`) or not (`held_out`); None for no run."""
    own = [e for e in result.run_errors if e.role == role]
    count = sum(e.samples for e in own)
    return float(np.degrees(np.sqrt(sum(e.samples * e.rms**2 for e in own) / count))) if count else None


def left_out_deg(result: DynamicResult) -> float | None:
    """RMS error of θ [deg] over fitted runs, each predicted without its own data; None for a single run."""
    own = [e for e in result.run_errors if e.left_out is not None]
    count = sum(e.samples for e in own)
    total = sum(e.samples * (e.left_out or 0.0) ** 2 for e in own)
    return float(np.degrees(np.sqrt(total / count))) if len(own) > 1 else None


def noise_deg(result: DynamicResult) -> float:
    """Standard deviation of the white noise of θ [deg]."""
    return float(np.degrees(np.sqrt(np.mean(result.noise**2) / len(result.noise))))


def verdict(result: DynamicResult) -> tuple[bool, str]:
    """Whether to trust the fit, and why, in a sentence."""
    fitted = result.fitted
    known = sum(p.verdict == "identifiable" for p in fitted)
    values = f"{known} of {len(fitted)} fitted parameters can be relied on"
    if known == len(fitted):
        values = f"all {known} fitted parameters can be relied on"
    if not result.estimate.converged:
        return False, "Do not use it yet: the search did not converge."
    if result.structured:
        return False, (
            f"With care: errors are {result.unexplained:.1f} × the noise, so the model lacks something they show; "
            "the values are a best compromise, and their standard deviations are too small."
        )
    train, held = rms_deg(result), rms_deg(result, "held_out")
    if train and held and held > WORSE * train:
        return False, (
            f"With care: it explains the runs it was fitted to, but errors on runs it has not seen are "
            f"{held / train:.1f} × as large."
        )
    unseen = ", runs it has not seen included" if held else ""
    return known == len(fitted), f"The model explains these runs down to their noise{unseen}; {values}."


def _headline(result: DynamicResult) -> list[tuple[str, str]]:
    fitted = result.fitted
    known = sum(p.verdict == "identifiable" for p in fitted)
    cards = [
        (f"{known} of {len(fitted)}", "fitted parameters identifiable"),
        (f"{number(rms_deg(result))}°", f"RMS error of θ, free runs (white noise {number(noise_deg(result))}°)"),
    ]
    if (held := rms_deg(result, "held_out")) is not None:
        count = len(result.held_out_runs)
        cards.append((f"{number(held)}°", f"RMS error of θ, {count} run{'s' if count > 1 else ''} not fitted"))
    if (left := left_out_deg(result)) is not None:
        cards.append((f"{number(left)}°", "RMS error of θ, each run predicted without its own data (first order)"))
    return cards


# --- pictures


def _grid(pictures: Sequence[str]) -> list[str]:
    return ['<div class="grid">', *pictures, "</div>"]


def _drawn(shown: Sequence[Trace]) -> tuple[list[Trace], str]:
    """The runs that are drawn, and which those are in words."""
    if len(shown) <= ALL:
        return list(shown), ""
    ordered = sorted(shown, key=lambda t: t.said.rms)
    chosen = [ordered[i] for i in np.linspace(0, len(ordered) - 1, SOME).round().astype(int)]
    return chosen, f"{SOME} of {len(shown)} runs, from the best explained to the worst."


def _knowledge(result: DynamicResult) -> list[str]:
    return [
        page.figure(
            figures.intervals(result),
            "Intervals",
            "Line: 95 %, if the model’s form holds; green where identifiable. Past a dotted line the sign is unknown.",
        ),
        page.figure(figures.correlation(result), "Correlations", "Near ± 1: the data cannot part the two."),
    ]


def _runs(result: DynamicResult, drawn: Sequence[Trace]) -> list[str]:
    noise, out = noise_deg(result), []
    for trace in drawn:
        name = f"{trace.said.run_id}, {_role(trace.said.role)}" if trace.said.role != "train" else trace.said.run_id
        error = f"RMS error {_deg(trace.said.rms)}°, largest {_deg(trace.said.largest)}°"
        flag = " Sensitive: hangs on the solver’s step (stick-slip)." if trace.said.sensitive else ""
        out += [
            page.figure(moving_figures.course(trace, noise), name, f"{error}. Grey band: ± 2 sd of white noise.{flag}"),
            page.figure(
                moving_figures.loop(trace), f"{name}, loop", "Its width is hysteresis, its tilt stiffness and gravity."
            ),
        ]
    return out


def _left(result: DynamicResult, shown: Sequence[Trace]) -> list[str]:
    said: dict[Axis, str] = {
        "rate": "A trend, or a step at 0, is friction or damping that the model lacks.",
        "angle": "A trend is elasticity, gravity or a lever arm that the model lacks.",
        "pressure": "A trend is a law over pressure that does not fit.",
    }
    low, high = np.degrees(moving_figures.rates_seen(shown))
    noise = noise_deg(result)
    friction = page.figure(
        moving_figures.friction(result, shown),
        "Friction in steady sliding",
        "φ(u_P)[ρ(v) + σ₂v] at the least, middle and largest vacuum. Band: ± 2 sd, where it is wider than the line. "
        f"Solid where these runs slid ({number(low, 2)} … {number(high, 2)} deg/s); dotted beyond, where it is the "
        "model’s form alone.",
    )
    return [friction] + [
        page.figure(moving_figures.residuals(shown, over, noise), f"Residuals over {over}", why)
        for over, why in said.items()
    ]


def _search(data: Mapping[str, Any]) -> str:
    search = data["search"]
    end = "Converged" if search["converged"] else "Did not converge"
    text = f"{end} after {len(search['evaluations'])} steps."
    if search["restarts"]:
        text += f" Of {len(search['restarts'])} starts the best was taken."
    return text


def _course(result: DynamicResult, data: Mapping[str, Any]) -> list[str]:
    out = []
    rounds = "Dashed: a new round begins."
    if len({h[0] for h in result.estimate.history}) == 3:
        rounds = "Rounds: 1 windows that start from the data, 2 free runs from rest, 3 the same with half the step."
    if result.estimate.history:
        out += [
            page.figure(
                moving_figures.descent(result),
                "Descent",
                rounds,
            ),
            page.figure(
                moving_figures.approach(result),
                "Estimates on the way",
                "Every parameter’s distance from its final value. Grey: within one standard deviation.",
            ),
        ]
    for name, found in data["profiles"].items():
        low, high = found["ci95"]
        out.append(
            page.figure(
                moving_figures.profile(result, name, found["ci95"]),
                f"Profile of {name}",
                f"Every other parameter fitted anew at each point. 95 % interval {number(low, 4)} … {number(high, 4)}.",
            )
        )
    return out


# --- tables


def _deg(rad: float | None) -> str:
    return number(None if rad is None else float(np.degrees(rad)))


def _role(role: str) -> str:
    return "not fitted" if role == "held_out" else "fitted"


def _errors(data: Mapping[str, Any]) -> str:
    experiments = {x["run_id"]: x["experiment"] for x in data["inputs"]}
    rows = []
    for r in data["runs"]:
        cells = [_deg(r[key]) for key in ("rms", "largest", "left_out", "step_error")]
        flag = '<span class="bad">sensitive</span>' if r["sensitive"] else ""
        name = escape(r["run_id"])
        rows.append([name, escape(experiments[r["run_id"]]), _role(r["role"]), f"{r['samples']:,}", *cells, flag])
    note = (
        "<p class='sub'>Left out: predicted without the run’s own data, to first order. Step error: how far halving "
        "the solver’s step moves the run; where it is large the run is sensitive.</p>"
    )
    heads = ["run", "experiment", "", "samples", "RMS [deg]", "largest [deg]", "left out [deg]", "step error [deg]", ""]
    return note + page.table(heads, rows, numeric=(3, 4, 5, 6, 7))


def _points(result: DynamicResult) -> str:
    rows = []
    problem = result.estimate.problem
    for points, (predicted, _) in zip(problem.points, result.estimate.statics, strict=True):
        error = points.value - predicted
        for k, p in enumerate(points.level_pressures()):
            e = error[points.levels == k]
            cells = [float(np.sqrt(np.mean(e**2))), float(e.mean()), float(e[np.argmax(np.abs(e))])]
            rows.append(
                [points.kind, number(round(float(p), 1)), str(len(e)), *(number(x) for x in cells), UNIT[points.kind]]
            )
    heads = ["points", "u_P [kPa]", "count", "RMS error", "mean error", "largest", "unit"]
    return page.table(heads, rows, numeric=(1, 2, 3, 4, 5))
