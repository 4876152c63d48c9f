"""A robustness study told: on the terminal, as robust.json, samples.nc and report.html, its worst case as a run."""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.markup import escape as plainly
from rich.table import Table

from ljjax import modelfile, sweep_file
from ljjax.control.chance import Difference
from ljjax.control.files import provenance
from ljjax.control.robust_page import page_of
from ljjax.control.robust_result import Robust
from ljjax.control.robust_run import PARTIAL, SAMPLES
from ljjax.control.spec import MEASURES
from ljjax.control.telling import SHOWN, finite
from ljjax.control.worst import write_log
from ljjax.errors import InputError
from ljjax.outputs import artefacts
from ljjax.page import number
from ljjax.sweep_file import LARGEST, Unfinished, Variable

PathLike = str | os.PathLike[str]
SCHEMA = "ljjax.robust/1"
NAMES = ("robust.json", SAMPLES, "report.html", "worst.mcap", "worst.toml")


def save(
    study: Robust,
    out: PathLike,
    *,
    law_path: PathLike | None = None,
    model_path: PathLike | None = None,
    keep: tuple[PathLike, ...] = (),
) -> None:
    """Write robust.json, samples.nc, report.html, worst.mcap and worst.toml into a folder: all or none. The batches
    kept there while the study ran are removed.

    Args:
        law_path, model_path: for the provenance; they and the files of `keep` are never replaced.

    Raises:
        InputError: a folder that cannot be written, or in which an input would be replaced.
    """
    inputs = [*keep, *(path for path in (law_path, model_path) if path is not None)]
    about = {**provenance(model_path), **_law(law_path)}
    now = datetime.now(UTC).isoformat(timespec="seconds").replace("+00:00", "Z")
    law = None if law_path is None else Path(law_path).read_bytes()
    said = "the worst case nearby, of a robustness study; its run is worst.mcap"
    with artefacts(out, keep=inputs) as folder:
        apart = write_log(folder / "worst.mcap", study.one, study.worst, now, law, about.get("law_sha256", ""))
        text = modelfile.dumps(modelfile.ModelFile(study.worst.robot), said)
        (folder / "worst.toml").write_text(text, encoding="utf-8")
        content = as_dict(study, about, apart)
        text = json.dumps(content, ensure_ascii=False, indent=1, allow_nan=False) + "\n"
        (folder / "robust.json").write_text(text, encoding="utf-8")
        sweep_file.write(folder / SAMPLES, variables(study), {**_attributes(study), **about})
        (folder / "report.html").write_text(page_of(study, about["software"]), encoding="utf-8")
    Unfinished(Path(out) / PARTIAL).remove()


def refuse_inputs(out: PathLike, inputs: Sequence[PathLike]) -> None:
    """Refuse a folder in which an artefact would replace an input, before hours are spent.

    Raises:
        InputError: naming the input.
    """
    for path in inputs:
        if any(os.path.realpath(path) == os.path.realpath(Path(out) / name) for name in NAMES):
            raise InputError(f"{path}: is an input and would be replaced; choose another --out")


def _law(path: PathLike | None) -> dict[str, str]:
    if path is None:
        return {}
    return {"law": Path(path).name, "law_sha256": hashlib.sha256(Path(path).read_bytes()).hexdigest()}


def as_dict(study: Robust, about: dict[str, Any], replay_error_rad: float) -> dict[str, Any]:
    """The content of robust.json (schema ljjax.robust/1); infinities and NaN are null."""
    worst, one = study.worst, study.one

    def chance(c: Any) -> dict[str, Any]:
        limit = {} if c.limit is None else {"limit": c.limit}
        return {**limit, "met": c.met, "count": c.draws, "probability": c.share, "ci95": c.ci95}

    return finite(
        {
            "schema": SCHEMA,
            "provenance": about,
            "options": dict(study.options),
            "spec": one.spec.as_dict(),
            "assumed": list(study.assumed),
            "inputs": [{k: x for k, x in entry._asdict().items()} for entry in one.given.entries],
            "groups": {name: [one.given.names[i] for i in members] for name, members in one.given.groups.items()},
            "correlation": (one.given.factor @ one.given.factor.T).tolist(),
            "units": {name: unit for name, (unit, _, _) in MEASURES.items()},
            "requirements": {c.name: chance(c) for c in study.chances},
            "targets": [chance(c) for c in study.by_target],
            "failed": {
                "count": len(study.failed),
                "loops": [
                    {"sample": i, "target": t, "inputs": {k: float(x[i]) for k, x in study.columns.items()}}
                    for i, t in study.failed
                ],
            },
            "redrawn": study.redrawn,
            "in_common": {k: [d._asdict() for d in found] for k, found in study.in_common.items()},
            "sensitivity": {
                "rows": study.sobol_rows[0],
                "rows_asked": study.sobol_rows[1],
                "failed_loops": int(np.sum(~study.sobol_told.ok)),
                "of": "the worst target's smooth measure, and what the loop costs",
                "indices": {k: {g: x._asdict() for g, x in row.items()} for k, row in study.sensitivity.items()},
            },
            "worst": {
                "target": worst.target,
                "distance_sd": worst.away,
                "radius_sd": worst.radius,
                "inputs": worst.values,
                "noise_course": worst.course,
                "cost": worst.cost,
                "cost_of_worst_sample_inside": worst.begun,
                "cost_of_worst_sample": float(np.nanmax(np.where(study.told.ok, study.told.price, np.nan))),
                "cost_of_centre": worst.centre,
                "measures": worst.measures,
                "measures_of_centre": worst.centre_measures,
                "loops": worst.loops,
                "replay_error_rad": replay_error_rad,
                "pushed": one.vary.push_n is not None,
            },
            "loops": {"samples": study.told.ok.size, "sensitivity": study.sobol_told.ok.size},
        }
    )


def variables(study: Robust) -> dict[str, Variable]:
    """Every sample, as the variables of samples.nc: quantities by draw, measures by draw and target, angles over time;
    names that begin with `all_` hold the draws of the sensitivity study too."""
    one, told = study.one, study.told
    units = {entry.name: entry.unit for entry in one.given.entries}
    out = {
        name: Variable(("sample",), x, {"units": units[name], "long_name": f"drawn: {name}"})
        for name, x in study.columns.items()
    }
    out["coordinates"] = Variable(("sample", "coordinate"), study.xi, {"units": "1", "long_name": "standard normal"})
    out["noise_course"] = Variable(("sample",), study.courses.astype(float), {"long_name": "the noise's course"})
    for i, (name, (unit, meaning, _)) in enumerate(MEASURES.items()):
        about = {"units": unit.replace("²", "2"), "long_name": _ascii(meaning)}
        out[name] = Variable(("sample", "target"), np.asarray(told.plain[..., i], float), about)
    for name in ("theta_rad", "stiffness_n_m"):
        unit = {"theta_rad": "rad", "stiffness_n_m": "N/m"}[name]
        data = np.array([getattr(x, name) for x in one.spec.targets])
        out[f"target_{name}"] = Variable(("target",), data, {"units": unit, "long_name": "asked for"})
    about = {"long_name": "what became of the loop", "flag_values": np.arange(2, dtype="i1")}
    status = Variable(("sample", "target"), (~told.ok).astype("i1"), {**about, "flag_meanings": "ok failed"})
    out["status"] = status
    out["time"] = Variable(("time",), one.stamps, {"units": "s", "long_name": "time since the loop began"})
    both = {k: np.concatenate([a, b]) for k, a, b in zip(told._fields, told, study.sobol_told, strict=True)}
    both["ok"] = both["ok"].astype("i1")
    last = {"plain": ("measure",), "smooth": ("measure",), "theta": ("time",)}
    for name, x in both.items():
        if 8 * x.size < LARGEST:
            out[f"all_{name}"] = Variable(("draw", "target", *last.get(name, ())), x, {"long_name": name})
    return out


def _ascii(text: str) -> str:
    return text.replace("θ*", "theta wanted").replace("θ", "theta").replace("−", "-")


def _attributes(study: Robust) -> dict[str, Any]:
    return {
        "title": "Closed loops of a robustness study of a layer-jamming continuum robot",
        "Conventions": "CF-1.11",
        "seed": study.options["seed"],
        "measures": " ".join(MEASURES),
        "identity": json.dumps({k: str(x) if k == "inputs" else x for k, x in study.identity.items()}),
    }


def in_words(difference: Difference, unit: str) -> str:
    """A difference between failing and other draws in words."""
    means = f"{number(difference.failing)} against {number(difference.passing)} {unit} on average"
    side = "higher" if difference.size > 0 else "lower"
    if difference.away:
        side = "further from its mean" if difference.size > 0 else "nearer to its mean"
    return f"{difference.name} {side} ({means}, {difference.size:+.2f} sd)"


def common(study: Robust) -> list[str]:
    """What draws that miss a requirement have in common, a line each requirement."""
    units = {entry.name: entry.unit for entry in study.one.given.entries}
    lines = []
    for name, found in study.in_common.items():
        what = "any requirement" if name == "all" else SHOWN[name][0]
        if found:
            lines.append(f"{what}: " + "; ".join(in_words(d, units[d.name]) for d in found[:3]))
    return lines or ["nothing that differs by more than three standard errors, or too few on one side to tell"]


def show(study: Robust, out: PathLike, console: Console | None = None) -> None:
    """What was assumed, the probabilities, what drives them, the worst case, and where the files are."""
    console = console or Console()

    def say(line: str, style: str = "") -> None:
        console.print(f"[{style}]{plainly(line)}[/]" if style else plainly(line), soft_wrap=True)

    one = study.one
    say("Assumed:")
    for line in study.assumed:
        say(f"  {line}")
    targets = len(one.spec.targets)
    title = f"Of {len(study.xi)} draws, at {'all ' if targets > 1 else ''}{targets} target{'s' * (targets > 1)}"
    table = Table(title=title, title_justify="left")
    for i, head in enumerate(("requirement", "limit", "met by", "probability", "95 %")):
        table.add_column(head, justify="left" if i == 0 else "right")
    for c in study.chances:
        low, high = c.ci95
        name, limit = ("all together", "") if c.limit is None else (SHOWN[c.name][0], _limit(c.name, c.limit))
        style = "green" if low > 0.9 else "yellow"
        table.add_row(name, limit, str(c.met), f"[{style}]{c.share:.3f}[/]", f"{low:.3f} – {high:.3f}")
    console.print(table)
    if study.failed:
        named = ", ".join(f"{i} at target {t}" for i, t in study.failed[:8])
        more = f" and {len(study.failed) - 8} more" if len(study.failed) > 8 else ""
        say(f"beware: {len(study.failed)} loops failed (numbers that are not finite): draw {named}{more}", "yellow")
    if study.redrawn:
        say(f"{study.redrawn} draws were no possible robot and were drawn anew")
    say("Draws that miss a requirement have in common:")
    for line in common(study):
        say(f"  {line}")
    if indices := study.sensitivity.get("cost"):
        table = Table(title=f"What drives the cost (Sobol, {study.sobol_rows[0]} rows)", title_justify="left")
        for i, head in enumerate(("quantity", "alone", "95 %", "with others", "95 %")):
            table.add_column(head, justify="left" if i == 0 else "right")
        for name, x in sorted(indices.items(), key=lambda row: -row[1].total):
            cells = (f"{a:.2f} – {b:.2f}" for a, b in (x.first_ci95, x.total_ci95))
            first, total = cells
            table.add_row(name, f"{x.first:.2f}", first, f"{x.total:.2f}", total)
        console.print(table)
    for line in worst_lines(study):
        say(line)
    if study.fresh:
        rate = study.fresh / study.seconds
        say(f"{study.fresh} loops in {study.seconds:.1f} s ({rate:.0f} a second, compilation included)")
    say("Written: " + ", ".join(str(Path(out) / name) for name in NAMES))


def _limit(name: str, limit: float) -> str:
    _, unit, scale = SHOWN[name]
    return f"{number(scale(limit))} {unit}"


def worst_lines(study: Robust) -> list[str]:
    """The worst case in words."""
    worst, target = study.worst, study.one.spec.targets[study.worst.target]
    missed = [SHOWN[k][0] for k, x in study.required.items() if not worst.measures[k] <= x]
    what = f"misses {', '.join(missed)}" if missed else "meets every requirement"
    driving = sorted(study.one.given.away(worst.xi).items(), key=lambda row: -abs(row[1]))[:4]
    return [
        f"Worst case within {worst.radius:.2f} sd, at {math.degrees(target.theta_rad):.3g}° and "
        f"{target.stiffness_n_m:.4g} N/m: cost {number(worst.cost)} (worst sample there {number(worst.begun)}, "
        f"centre {number(worst.centre)}), {worst.away:.2f} sd away; {what}",
        "  farthest out: " + ", ".join(f"{k} = {number(worst.values[k])} ({x:+.2f} sd)" for k, x in driving),
    ]
