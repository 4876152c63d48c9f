"""The blind check: `python -m benchmarks.blind.study`, or `make blind`.

Plants causes of gaps in simulated robots that share no code with ljjax, seals the labels, lets `ljjax gap` answer in
processes that get nothing but logs and a nominal model, opens the labels, and prints the goals with what was reached.
Writes OUT/scoreboard.json, confusion.json, confusion.png and reliability.png. What is done already is kept.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from functools import cache
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from benchmarks.blind import cases, figures, judge, page
from benchmarks.blind.cases import Case

ROOT = Path(__file__).parents[2]
LIMIT_S = 3600.0
"""When a diagnosis is given up."""


def diagnose(case: Case, folder: Path) -> None:
    """Logs, then the command's answer: FOLDER/answers/ID, with `failed.txt` in it where the command failed."""
    answer = folder / "answers" / case.case_id
    cases.make(case, folder)
    if (answer / "gap.json").exists():
        return
    public = folder / "cases" / case.case_id
    with tempfile.TemporaryDirectory(prefix="gap-") as place:
        shutil.copytree(public / "logs", Path(place) / "logs")
        shutil.copy(public / "model.toml", place)
        begin = time.perf_counter()
        done = command(["gap", "logs", "--model", "model.toml", "--out", "out", *case.flags], Path(place))
        took = time.perf_counter() - begin
        new = Path(place) / "out"
        new.mkdir(exist_ok=True)
        (new / "result.mcap").unlink(missing_ok=True)  # as large as the logs
        if done.returncode or not (new / "gap.json").exists():
            (new / "gap.json").unlink(missing_ok=True)
            (new / "failed.txt").write_text(f"exit code {done.returncode}\n{done.stderr}", encoding="utf-8")
        (new / "took.json").write_text(json.dumps({"seconds": took, "code": code()}), encoding="utf-8")
        shutil.rmtree(answer, ignore_errors=True)
        answer.parent.mkdir(parents=True, exist_ok=True)
        shutil.copytree(new, partial := answer.with_name(f".{answer.name}.new"), dirs_exist_ok=True)
        os.replace(partial, answer)


@cache
def code() -> str:
    """The commit of the code that answers, with a + where the work tree differs from it."""
    line = ["git", "describe", "--always", "--dirty=+", "--exclude=*"]
    try:
        return subprocess.run(line, cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return "unknown"


def command(args: Sequence[str], where: Path, env: dict[str, str] | None = None) -> subprocess.CompletedProcess[str]:
    """`ljjax ARGS` of this work tree, whichever is installed, in a process of its own, started in the folder `where`;
    exit code 124 where it took too long."""
    line = [sys.executable, "-m", "ljjax", *args]
    env = {**os.environ, "PYTHONPATH": str(ROOT), **(env or {})}
    try:
        return subprocess.run(line, cwd=where, capture_output=True, text=True, timeout=LIMIT_S, env=env)
    except subprocess.TimeoutExpired:
        return subprocess.CompletedProcess(line, 124, "", f"no answer within {LIMIT_S:.0f} s")


def judged(case: Case, folder: Path) -> judge.Row:
    """Open the label, replay the unseen runs through the claimed models, judge."""
    answer = folder / "answers" / case.case_id
    failed = answer / "failed.txt"
    by = json.loads((answer / "took.json").read_text(encoding="utf-8")).get("code", "unknown")
    label = cases.read_label(folder, case, failed if failed.exists() else answer / "gap.json")
    if failed.exists():
        return judge.judge(label, None, None) | {"code": by}
    counts = case.kind in ("effects", "mujoco") and not judge.of_session(case.causes, label["forms"])
    errors = replayed(case, folder) if counts else None
    return judge.judge(label, json.loads((answer / "gap.json").read_text(encoding="utf-8")), errors) | {"code": by}


def replayed(case: Case, folder: Path) -> list[float] | None:
    """Errors of base.toml and of model.toml on the two unseen runs [rad]; None where they cannot be simulated."""
    answer, truth = folder / "answers" / case.case_id, folder / "sealed" / case.case_id / "truth"
    out = answer / "unseen.json"
    if not out.exists():
        logs, models = sorted(truth.glob("*.mcap")), [answer / "base.toml", answer / "model.toml"]
        parts = [str(path.absolute()) for path in [out, *logs]] + ["--"] + [str(path.absolute()) for path in models]
        line = [sys.executable, "-m", "benchmarks.blind.replays", *parts]
        done = subprocess.run(line, cwd=ROOT, capture_output=True, text=True)
        if done.returncode:
            (answer / "unseen.txt").write_text(done.stderr, encoding="utf-8")
            return None
    return json.loads(out.read_text(encoding="utf-8"))


def timed(case: Case, folder: Path) -> dict[str, float]:
    """Seconds of `ljjax fit` and of `ljjax gap` on one case's logs, one after the other, with nothing compiled yet."""
    kept = folder / "timing" / f"{case.case_id}.json"
    if kept.exists():
        return json.loads(kept.read_text(encoding="utf-8"))
    took = {}
    with tempfile.TemporaryDirectory(prefix="gap-") as place:
        public = folder / "cases" / case.case_id
        shutil.copytree(public / "logs", Path(place) / "logs")
        shutil.copy(public / "model.toml", place)
        for name in ("fit", "gap"):
            begin = time.perf_counter()
            line = [name, "logs", "--model", "model.toml", "--out", name]
            done = command(line, Path(place), {"LJJAX_CACHE": ""})
            if done.returncode:
                raise RuntimeError(f"ljjax {' '.join(line)}: exit code {done.returncode}: {done.stderr.strip()}")
            took[f"{name}_s"] = time.perf_counter() - begin
    took["ratio"] = took["gap_s"] / took["fit_s"]
    kept.parent.mkdir(exist_ok=True)
    kept.write_text(json.dumps(took), encoding="utf-8")
    return took


def study(chosen: Sequence[Case], folder: Path, jobs: int, timing: bool = True) -> dict[str, Any]:
    """Diagnose and judge these cases; returns what `scoreboard.json` holds."""
    bar = Console(stderr=True)
    folder.mkdir(parents=True, exist_ok=True)

    def whole(case: Case) -> judge.Row:
        diagnose(case, folder)
        return judged(case, folder)

    rows = []
    with ThreadPoolExecutor(jobs) as pool:
        for future in as_completed([pool.submit(whole, case) for case in chosen]):
            row = future.result()
            rows.append(row)
            said = "failed" if row["failed"] else f"{row['verdict']} {', '.join(row['selected'])}"
            bar.print(f"{len(rows)}/{len(chosen)} {row['case']}: {said}", markup=False)
    rows.sort(key=lambda r: r["case"])
    took = {}
    # A gap that no effect explains takes longest: every effect is refitted before that is said.
    for case in [next((c for c in chosen if c.kind == kind), None) for kind in ("effects", "unlisted")]:
        if timing and case:
            try:
                took[case.case_id] = timed(case, folder)
            except RuntimeError as error:
                bar.print(f"{case.case_id} not timed: {error}", markup=False)
    return judge.scoreboard(rows, took)


def save(found: dict[str, Any], folder: Path) -> None:
    """The scoreboard and its pictures."""
    for name, data in (("scoreboard", found), ("confusion", found["confusion"])):
        text = json.dumps(data, indent=1, ensure_ascii=False)
        (folder / f"{name}.json").write_text(text + "\n", encoding="utf-8")
    if found["confusion"]:
        figures.confusion(found, folder / "confusion.png")
    figures.reliability(found, folder / "reliability.png")


def show(found: dict[str, Any], console: Console) -> None:
    """The goals, then every case, on a terminal."""
    table = Table("goal", "asked", "reached", "cases", "", title="Blind check")
    for r in found["rows"]:
        value = "–" if r["value"] is None else f"{r['value']:.3g}"
        met = "no cases" if r["met"] is None else "[green]met[/]" if r["met"] else "[red]missed[/]"
        table.add_row(r["name"], r["goal"], value, str(r["cases"]), met)
    console.print(table)
    table = Table("case", "planted", "gap/noise", "verdict", "first three", "selected", "block", "axis", "closed")
    mark = {True: "ok", False: "NO", None: "–"}
    for r in found["cases"]:
        planted = " + ".join(r["truth"]) or r["kind"]
        planted += " (deleted)" * (r["kind"] == "without") + " (mujoco)" * (r["kind"] == "mujoco")
        top = ", ".join(f"{name} {p:.2f}" for name, p in r["top"])
        closed = "–" if r["closed"] is None else f"{r['closed']:.2f}"
        if r["ci95"] and None not in r["ci95"]:
            closed += f" [{r['ci95'][0]:.2f}, {r['ci95'][1]:.2f}]"
        marks = (mark[r.get("block_right")], mark[r.get("axis_right")])
        gap = f"{r['gap_over_noise']:.1f}" + " (weak)" * (not r["attained"])
        table.add_row(r["case"], planted, gap, str(r["verdict"]), top, ", ".join(r["selected"]), *marks, closed)
    console.print(table)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.blind.study", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out/blind"))
    parser.add_argument("--cases", default="all", help="how many (kinds take turns), `small` for a set of six, or all")
    parser.add_argument("--case", default="", metavar="CASE,…", help="these cases only, to ask again")
    parser.add_argument(
        "--made", default="", metavar="CAUSE:SHAPE[:small],…", help="robots made on purpose instead; + joins a pair"
    )
    parser.add_argument("--only", default="", help=f"kinds, with commas: {', '.join(cases.KINDS)}; or small")
    parser.add_argument("--jobs", type=int, default=1, help="diagnoses side by side")
    parser.add_argument("--seed", type=int, default=cases.NEWEST[-1])
    parser.add_argument("--no-timing", action="store_true", help="leave out the comparison with the time of ljjax fit")
    parser.add_argument("--time", default="", metavar="CASE,…", help="do nothing but that comparison, for these cases")
    parser.add_argument(
        "--page", action="store_true", help="keep the answers and write docs/blind.md, beside those kept"
    )
    given = parser.parse_args()
    if "small" in (given.cases, given.only):
        chosen = cases.small_set(given.seed)
    else:
        kinds = tuple(given.only.split(",")) if given.only else cases.KINDS
        if unknown := set(kinds) - set(cases.KINDS):
            parser.error(f"--only {', '.join(sorted(unknown))}: expected some of {', '.join(cases.KINDS)}, or small")
        if given.cases != "all" and not given.cases.isdigit():
            parser.error(f"--cases {given.cases}: expected a whole number, small or all")
        chosen = cases.catalogue(given.seed, kinds, None if given.cases == "all" else int(given.cases))
    out = given.out / f"seed-{given.seed}"
    if given.made:
        if given.page:
            parser.error("--page keeps what was drawn; what is made on purpose is not")
        try:
            made = enumerate(given.made.split(","))
            chosen = [cases.on_purpose(what, number, given.seed) for number, what in made]
        except ValueError as error:
            parser.error(f"--made {error}")
        out = given.out / f"made-{given.seed}"
    if named := given.case or given.time:
        ids = named.split(",")
        if unknown := set(ids) - {c.case_id for c in chosen}:
            parser.error(f"{', '.join(sorted(unknown))}: not among this seed's, such as {chosen[0].case_id}")
        chosen = [c for c in chosen if c.case_id in ids]
    if given.time:
        for case in chosen:
            cases.make(case, out)
            took = timed(case, out)
            ratio = f"{took['ratio']:.1f} times as long"
            print(f"{case.case_id}: fit {took['fit_s']:.0f} s, gap {took['gap_s']:.0f} s, {ratio}")
        return
    found = study(chosen, out, given.jobs, not given.no_timing)
    found |= {"seed": given.seed}
    save(found, given.out)
    if given.page:
        said = ["python -m benchmarks.blind.study", f"--seed {given.seed}", f"--cases {given.cases}"]
        said += [f"--case {given.case}"] if given.case else []
        said += [f"--only {given.only}"] if given.only else []
        said += ["--no-timing"] if given.no_timing else []
        page.keep(found, " ".join([*said, "--page"]))
        page.write()
    show(found, Console(width=None if sys.stdout.isatty() else 170))


if __name__ == "__main__":
    main()
