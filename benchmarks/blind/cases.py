"""The cases: which there are, drawn from a seed, and how one is made."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.blind import logs, magnitude, mujoco_plant, plant, seal, sensing
from benchmarks.blind.causes import ALIKE, CAUSES, LISTED, UNLISTED, Cause, Setting, row
from benchmarks.recovery.experiments import Experiment, plan
from benchmarks.recovery.robots import Robot, draw

SECONDS = 15.0
KINDS = ("effects", "controls", "parameters", "unlisted", "pairs", "without", "mujoco")
SMALL, LARGE, OUTSIDE, PAIRED = (3.4, 5.0), (8.0, 15.0), (6.0, 15.0), (5.0, 10.0)
"""Gaps over noise, of a small effect, of a large one, of one outside the library, of each of two."""
ATTEMPTS = 3
"""Robots tried until one can show the gap asked for."""
PAIRS, CONTROLS, WITHOUT = 12, 10, 10
SMALL_SET = ("effects", "controls", "parameters", "unlisted", "effects", "mujoco")
NEWEST = (5601, 5901, 6201)
"""The first seeds whose robots come in the last shape but two of a listed cause too, in the last but one, and in its
last: those before are what they were. From the first on also with what is outside the library from `OUTSIDE_BEFORE`
on."""
OUTSIDE_BEFORE = 15
HISTORY = ("layer_wear", "thermal_drift", "glue_failure")
"""What runs leave to later ones in every shape (others do in some: `judge.of_session`)."""


@dataclass(frozen=True)
class Case:
    """What is planted.

    Attributes:
        kind: one of `KINDS`.
        causes: ids.
        size: `small`, `large` or, where that has no meaning, empty.
        seed: of everything random about it.
    """

    case_id: str
    kind: str
    causes: tuple[str, ...]
    size: str
    seed: int

    @property
    def flags(self) -> list[str]:
        """What the command is told beside logs and model."""
        if self.kind != "without":
            return []
        known = [group for group in ALIKE if group & set(self.causes)]
        return ["--without", *sorted(set(self.causes).union(*known))]


def catalogue(seed: int, kinds: tuple[str, ...] = KINDS, count: int | None = None) -> list[Case]:
    """All cases of these kinds, or the first `count` of them, under names that say nothing, in a random order.

    With a count the kinds take turns, so that a short check has something of each.
    """
    rng = np.random.default_rng([seed, 0])
    ids = [cause.id for cause in LISTED]
    outside = [cause.id for cause in UNLISTED[: None if seed >= NEWEST[0] else OUTSIDE_BEFORE]]
    drawn: dict[str, list[tuple[tuple[str, ...], str]]] = {
        "effects": _sized(rng, ids),
        "controls": [((), "")] * CONTROLS,
        "parameters": [((), "")] * CONTROLS,
        "unlisted": [((i,), "") for _ in range(2) for i in rng.permutation(outside)],
        "pairs": [(_pair(rng), "") for _ in range(PAIRS)],
        "without": [((i,), "large") for i in rng.permutation(ids)[:WITHOUT]],
        "mujoco": _sized(rng, mujoco_plant.IDS),
    }
    rows = [(kind, *what, place) for kind in KINDS for place, what in enumerate(drawn[kind])]
    numbers = rng.permutation(len(rows))
    cases = [
        (
            place / len(drawn[kind]),
            Case(f"case-{number:03d}", kind, tuple(map(str, causes)), size, seed * 1000 + number),
        )
        for (kind, causes, size, place), number in zip(rows, map(int, numbers), strict=True)
        if kind in kinds
    ]
    if count is not None:
        cases = sorted(cases, key=lambda x: x[0])[:count]
    return sorted((case for _, case in cases), key=lambda c: c.case_id)


def small_set(seed: int) -> list[Case]:
    """Six cases, one of nearly every kind, large where sizes differ."""
    left, out = catalogue(seed), []
    for kind in SMALL_SET:
        found = next(c for c in left if c.kind == kind and c.size in ("", "large") and c.causes != ("sensor_scale",))
        left.remove(found)
        out.append(found)
    return out


def on_purpose(what: str, number: int, seed: int) -> Case:
    """The case that `what` asks for: cause:shape, or cause:shape:small, or two of them joined by + (a pair).

    Shapes are counted from 0, as in `causes.py`. The case's own seed is the first, from `seed` and `number` on, of
    which the causes come in these shapes. Raises ValueError with a line that says what is wrong.
    """
    parts = [part.split(":") for part in what.split("+")]
    names, shapes = tuple(part[0] for part in parts), []
    for part in parts:
        if part[0] not in CAUSES:
            raise ValueError(f"{part[0]}: no cause of this name; the names are those of causes.py")
        most = len(CAUSES[part[0]].shapes) - 1
        if len(part) < 2 or not part[1].isdigit() or int(part[1]) > most:
            raise ValueError(f"{':'.join(part)}: expected {part[0]}:SHAPE, a shape from 0 to {most}")
        shapes.append(int(part[1]))
    sizes = {size for part in parts for size in part[2:]}
    outside = [CAUSES[name].block is None for name in names]
    kind = "pairs" if len(names) == 2 else "unlisted" if outside[0] else "effects"
    if len(names) > 2 or len(set(names)) < len(names) or (any(outside) and kind == "pairs"):
        raise ValueError(f"{what}: expected one cause, or two different ones that the library has")
    if sizes - {"small", "large"} or len(sizes) > 1 or (sizes and kind != "effects"):
        raise ValueError(f"{what}: a size is small or large, and only of one effect by itself")
    first = NEWEST[0] if outside[0] else max(map(_since, names, shapes))
    own = ((seed + first) * 1000 + number) * 1000
    while [_form(own, 0, place, name) for place, name in enumerate(names)] != shapes:
        own += 1
    return Case(f"case-{number:03d}", kind, names, (sizes or {"large"}).pop() if kind == "effects" else "", own)


def make(case: Case, folder: Path) -> None:
    """Write FOLDER/cases/ID (logs, nominal model, hash) and FOLDER/sealed/ID (label, truth: two unseen runs)."""
    public, sealed = folder / "cases" / case.case_id, folder / "sealed" / case.case_id
    if is_made(case, folder):
        return
    for old in (public, sealed, folder / "answers" / case.case_id):
        shutil.rmtree(old, ignore_errors=True)
    new = folder / "cases" / f".{case.case_id}.new"
    shutil.rmtree(new, ignore_errors=True)
    (new / "logs").mkdir(parents=True)
    (sealed / "truth").mkdir(parents=True)

    rng = np.random.default_rng([case.seed, 1])
    found = []
    for attempt in range(ATTEMPTS):
        found.append(planted(case, attempt))
        if found[-1][3] >= 0.85 * found[-1][4]:
            break
    robot, runs, causes, reached, asked = max(found, key=lambda x: x[3])
    has = bool(rng.uniform() < 2 / 3)
    drift, chance = "thermal_drift" in causes, rng.uniform()
    sensors = logs.Sensors(tension=has, pressure=has, temperature=bool(chance < (0.5 if drift else 0.15)))
    session = mujoco_plant.session if case.kind == "mujoco" else plant.session
    motions = session(robot.truth, causes, runs, plant.SUBSTEPS)
    for i, (run, motion) in enumerate(zip(runs, motions, strict=True)):
        path = (sealed / "truth" if run.held_out else new / "logs") / f"run_{i:02d}.mcap"
        logs.write(path, robot, i, run, motion, sensing.shape(motion, robot.columns, causes, i), sensors)
    off = 0.0 if case.kind == "controls" else 0.25 if case.kind == "parameters" else 0.2
    values = robot.truth if off == 0 else logs.nominal(robot, rng, off)
    (new / "model.toml").write_text(logs.model_text(values, robot.columns == 1), encoding="utf-8")
    label: dict[str, Any] = {
        **asdict(case),
        "numbers": {name: list(map(float, x)) for name, x in causes.items()},
        "forms": {name: plant.form(x) for name, x in causes.items()},
        "gap_over_noise": reached,
        "gap_asked": asked,
        "columns": robot.columns,
        "truth": robot.truth,
        "nominal": values,
        "sensors": asdict(sensors),
        "theta_noise_rad": sensing.noise_sd(robot.columns) / robot.columns**0.5,
    }
    # The label last: what is there without it is begun anew.
    os.replace(new, public)
    seal.close(label, sealed / "label.json", public)


def is_made(case: Case, folder: Path) -> bool:
    """Whether its logs are there, and of this very case: a changed catalogue gives its name to another one."""
    try:
        label = json.loads((folder / "sealed" / case.case_id / "label.json").read_text(encoding="utf-8"))["label"]
    except (OSError, ValueError):
        return False
    return all(label[key] == (list(x) if isinstance(x, tuple) else x) for key, x in asdict(case).items())


Planted = tuple[Robot, list[Experiment], plant.Causes, float, float]


def planted(case: Case, attempt: int) -> Planted:
    """A robot, its runs, its causes with their numbers, the gap they leave over the noise, and the gap asked for."""
    rng = np.random.default_rng([case.seed, 2, attempt])
    robot = draw(1, seed=int(rng.integers(2**31)))[0]
    columns = (6, 1)[(case.seed + attempt) % 2]
    robot = replace(robot, robot_id=f"robot-{int(case.case_id.split('-')[1]):03d}", columns=columns)
    runs = plan(robot, SECONDS, seed=case.seed)
    if not case.causes:
        return robot, runs, {}, 0.0, 0.0
    train = [run for run in runs if not run.held_out]
    of = magnitude.base(robot, train, mujoco_plant.session if case.kind == "mujoco" else plant.session)
    setting = Setting(max(float(run.tendons.max()) for run in train), of.tip_m, SECONDS, plant.APART_S)
    size = OUTSIDE if case.kind == "unlisted" else PAIRED if case.kind == "pairs" else SMALL
    if case.size == "large":
        size = LARGE
    causes: dict[str, list[float]] = {}
    reached, asked = np.inf, rng.uniform(*size)
    for name in case.causes:
        cause = CAUSES[name]
        way = float(rng.choice([-1, 1])) if cause.signed else 1.0
        form = _form(case.seed, attempt, len(causes), name, case.kind == "mujoco")
        shape = cause.shapes[form]
        numbers = shape.numbers(rng, setting)

        def at(
            strength: float, name: str = name, way: float = way, form: int = form, numbers: list[float] = numbers
        ) -> plant.Causes:
            return {name: row(form, way * strength, numbers)}

        strength, gap = magnitude.strength(of, at, asked, shape.start, shape.largest)
        causes |= {name: list(at(strength)[name])}
        reached = min(reached, gap)
    return robot, runs, causes, float(reached), float(asked)


def _since(name: str, shape: int) -> int:
    """The first seed whose robots come in this shape of a cause."""
    late = shape + len(NEWEST) - len(CAUSES[name].shapes)
    return NEWEST[late] if late >= 0 and CAUSES[name].block is not None else 0


def _form(seed: int, attempt: int, place: int, name: str, mujoco: bool = False) -> int:
    """Which of its shapes a case's cause takes. Those that came with `NEWEST` are not MuJoCo's."""
    of = seed // (10**6 if seed >= 10**9 else 1000)  # made on purpose, or drawn
    known = sum(_since(name, shape) <= (0 if mujoco else of) for shape in range(len(CAUSES[name].shapes)))
    return int(np.random.default_rng([seed, 3, attempt, place]).integers(known))


def _sized(rng: np.random.Generator, ids: Sequence[str]) -> list[tuple[tuple[str, ...], str]]:
    """Every cause at both sizes, in a random order."""
    rows = [((name,), size) for name in ids for size in ("large", "small")]
    return [rows[k] for k in rng.permutation(len(rows))]


def _pair(rng: np.random.Generator) -> tuple[str, str]:
    """Two listed causes of different blocks, of a kind that no refit takes up, and that are not known confusions."""
    hard = {"actuator_gain", "sensor_scale", "gravity_distribution", "tip_payload"}
    usual: list[Cause] = [cause for cause in LISTED if cause.id not in hard]
    while True:
        a, b = (usual[int(k)] for k in rng.choice(len(usual), 2, replace=False))
        if a.block != b.block and not any({a.id, b.id} <= alike for alike in ALIKE):
            return a.id, b.id


def read_label(folder: Path, case: Case, answer: Path) -> dict[str, Any]:
    """The case's label, once `answer` is there."""
    return seal.opened(folder / "sealed" / case.case_id / "label.json", folder / "cases" / case.case_id, answer)
