"""`fit(model, runs)`: the one verb of this room, and `fit_many` for many robots at once."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Literal

import numpy as np

from ljjax import modelfile
from ljjax.data import OCTROBOT
from ljjax.errors import InputError
from ljjax.fit.coordinates import Coordinates
from ljjax.fit.dynamic import estimate, predict
from ljjax.fit.kernel import at_work
from ljjax.fit.moving import DynamicResult
from ljjax.fit.points import Points, collect, points_of, set_aside
from ljjax.fit.problem import ROUNDS, Estimate, Problem, Round, within
from ljjax.fit.result import NOMINAL, FitResult, StaticResult
from ljjax.fit.session import in_order
from ljjax.fit.shooting import Asking, together
from ljjax.fit.static import Constraints, Weights, fit_static
from ljjax.fit.stochastic import descend
from ljjax.fit.windows import Motion, Source, check_columns, motion
from ljjax.logs import Run
from ljjax.model import UNITS, check, get, replace, units
from ljjax.modelfile import ModelFile
from ljjax.simulation import check_joints

Method = Literal["lm", "adam"]
Progress = Callable[[str, int, int], None]
GEOMETRY = ("chain.half_length_m", "chain.radius_m")
"""What a ruler measures better than any log: fitted only where the model file frees it."""
LEVELS = {"elastic.c1": 3, "elastic.c2": 2, "jamming.c5": 2}
"""Pressure levels [kPa apart] without which a parameter cannot be found from moving logs."""
PROFILE_POINTS, PROFILE_SDS = 9, 3.5


def fit(
    model: ModelFile | None,
    runs: Sequence[Run],
    *,
    held_out: Sequence[Run] = (),
    frozen: Sequence[str] = (),
    inputs: Source = "commands",
    method: Method = "lm",
    restarts: int = 1,
    profile: Sequence[str] = (),
    weights: Weights = "equal",
    constraints: Constraints = "none",
    seed: int = 0,
    model_from: str = "the given model",
    progress: Progress | None = None,
) -> FitResult:
    """Identify a robot from its runs.

    Moving runs give everything (`DynamicResult`); steady operating points and probe stiffness join them. Without a
    moving run, those alone give α₁ and c₁ … c₅ (`StaticResult`).

    Args:
        model: geometry, starting values, what is frozen, bounds and priors; None for OctRobot-I's geometry with
            assumed friction.
        runs: logs of one robot, as `ljjax.logs.read_all` gives them.
        held_out: runs of the robot that are not fitted, even if they are among `runs`, only predicted.
        frozen: parameters not to move, by path, beside those the model file freezes. Geometry moves only if the
            model file frees it, the lever arm also where probe points fix the scale of torques.
        inputs: drive moving runs by their commands or by their measured tension and pressure.
        method: `"lm"`, Levenberg–Marquardt; `"adam"`, stochastic steps on batches of windows before it, for data so
            large that every step on all of them costs too much.
        restarts: how many starts are tried, side by side; the first is the model, the others lie around it.
        profile: parameters whose profile likelihood is wanted.
        weights: (static fits) `"equal"`, or `"published"` to divide by the standard deviations the logs state.
        constraints: (static fits) `"paper"` keeps α₁, c₂, c₃ ≥ 0 as the paper does.
        seed: for restarts and stochastic steps.
        model_from: where the model came from, for the record.
        progress: called with a stage's name, how many problems are done, and of how many.

    Raises:
        InputError: no usable data, parameters that the data cannot fix, several robots, unknown paths.
    """
    robots = sorted({r.robot_id for r in runs})
    if len(robots) > 1:
        raise InputError(f"logs of {len(robots)} robots ({', '.join(robots)}); fit_many fits several")
    found = fit_many(
        model,
        {robots[0] if robots else "": runs},
        held_out={robots[0] if robots else "": held_out},
        frozen=frozen,
        inputs=inputs,
        method=method,
        restarts=restarts,
        profile=profile,
        weights=weights,
        constraints=constraints,
        seed=seed,
        model_from=model_from,
        progress=progress,
    )
    (result,) = found.values()
    if isinstance(result, Exception):
        raise result
    return result


@at_work()
def fit_many(
    model: ModelFile | None | Mapping[str, ModelFile],
    robots: Mapping[str, Sequence[Run]],
    *,
    held_out: Mapping[str, Sequence[Run]] | None = None,
    frozen: Sequence[str] = (),
    inputs: Source = "commands",
    method: Method = "lm",
    restarts: int = 1,
    profile: Sequence[str] = (),
    weights: Weights = "equal",
    constraints: Constraints = "none",
    seed: int = 0,
    model_from: str = "the given model",
    progress: Progress | None = None,
) -> dict[str, FitResult | Exception]:
    """Identify many robots at once, their windows side by side in one batch; arguments as in `fit`.

    Args:
        model: one for all, or one for each by robot.
        robots: runs by robot.

    Returns a result for each robot, or the error that kept it from one; a bad robot never loses the others.
    """
    for path in (*frozen, *profile):
        if path not in UNITS and not path.startswith("effects."):
            raise InputError(f"{path}: no such parameter; expected one of {', '.join(UNITS)}")
    results: dict[str, FitResult | Exception] = {}
    cases: dict[str, _Case] = {}
    options = {"weights": weights, "constraints": constraints, "inputs": inputs, "method": method, "seed": seed}
    for robot, runs in robots.items():
        own = model.get(robot) if isinstance(model, Mapping) else model
        start, said_from = (modelfile.load(OCTROBOT / "nominal.toml"), NOMINAL) if own is None else (own, model_from)
        held = tuple(dict.fromkeys((*start.frozen, *frozen)))
        runs, unseen = parted(runs, (held_out or {}).get(robot, ()))
        try:
            case = prepared(start, said_from, runs, unseen, held, inputs)
            if isinstance(case, _Case):
                cases[robot] = case
            else:
                results[robot] = _statics(start, said_from, runs, held, {"frozen": held, **options}, case)
        except InputError as error:
            results[robot] = error

    def tell(stage: str) -> Callable[[int, int], None]:
        return lambda done, count: progress(stage, done, count) if progress else None

    names = list(cases)
    rng = np.random.default_rng(seed)
    tried = _restarted([cases[r].problem for r in names], restarts, rng, tell("starts")) if restarts > 1 else None
    searches: list[Asking[Estimate]] = []
    for i, robot in enumerate(names):
        x0, rounds = (tried[i][0], ROUNDS[1:]) if tried else (None, ROUNDS)
        if method == "adam":
            searches.append(descend(cases[robot].problem, x0, np.random.default_rng(seed + i)))
        else:
            searches.append(estimate(cases[robot].problem, x0, rounds))
    estimates = dict(zip(names, together(searches, tell("fit")), strict=True))
    known = {robot: e for robot, e in estimates.items() if isinstance(e, Estimate) and cases[robot].tests}
    predictions = together([predict(e, cases[robot].tests) for robot, e in known.items()], tell("held-out runs"))
    after = dict(zip(known, predictions, strict=True))
    for i, robot in enumerate(names):
        found, case = estimates[robot], cases[robot]
        if isinstance(found, Exception):
            results[robot] = found
            continue
        test = after.get(robot)
        results[robot] = DynamicResult(
            estimate=found,
            moving=case.moving,
            held_out=None if isinstance(test, Exception) else test,
            held_out_runs=[m.run for m in case.tests],
            profiles=_profiles(found, [p for p in profile if p in found.problem.coordinates.names], tell("profiles")),
            restarts=tried[i][1] if tried else (),
            start=case.start,
            start_from=case.start_from,
            runs=case.runs,
            said=case.said,
            options={"frozen": case.frozen, **options, "restarts": restarts},
        )
    return {robot: results[robot] for robot in robots}


class _Case:
    """One robot's data, sorted, and its problem."""

    def __init__(self, start, start_from, runs, said, frozen, problem, moving, tests):
        self.start: ModelFile = start
        self.start_from: str = start_from
        self.runs: Sequence[Run] = runs
        self.said: list[str] = said
        self.frozen: tuple[str, ...] = frozen
        self.problem: Problem = problem
        self.moving: list[int] = moving
        self.tests: list[Motion] = tests


def resting(run: Run) -> bool:
    """Whether a log is of steady points or presses of the probe, not of motion."""
    return run.experiment.lower().startswith("steady") or "probe" in run.signals


def parted(runs: Sequence[Run], held_out: Sequence[Run]) -> tuple[list[Run], list[Run]]:
    """Logs to fit and logs that no fit sees, each of these once: one that is among both is not fitted."""
    unseen = {r.sha256 or id(r): r for r in held_out}
    return [r for r in runs if (r.sha256 or id(r)) not in unseen], list(unseen.values())


def prepared(
    start: ModelFile, start_from: str, runs, held_out, frozen: tuple[str, ...], inputs: Source
) -> _Case | list[str]:
    """The dynamic problem of one robot's runs; where none of them moves, what was said of each."""
    motions: list[Motion] = []
    moving: list[int] = []
    points: list[Points] = []
    said: list[str] = []
    seen: dict[str, str] = {}
    for index, run in enumerate(runs):
        if run.sha256 and run.sha256 in seen:
            said.append(f"left out: {run.path}: the same log as {seen[run.sha256]}")
            continue
        seen[run.sha256] = run.path
        check_joints(run, start.model.n)  # not left out: the model is another robot's
        try:
            if resting(run):
                found, how = points_of(run)
                for p in found:
                    p.run[:] = index
                points += found
                said.append(f"{run.path}: {how}")
            else:
                motions.append(motion(run, start.model.n, inputs))
                moving.append(index)
                said.append(f"{run.path}: {len(motions[-1].t)} samples over {np.ptp(motions[-1].t):.3g} s of motion")
        except InputError as error:
            said.append(f"left out: {error}")
    if not motions:
        return said
    pressures = [float(p) for m in motions for p in (m.vacuum.min(), m.vacuum.max())]
    top = max(pressures)
    check(start.model, pressures, start_from)
    levels = _levels(np.concatenate([m.vacuum for m in motions] + [p.pressure_kpa for p in points]))
    probed = any(p.kind == "probe" for p in points)
    held = set(frozen) | {*GEOMETRY, *([] if probed else ["chain.lever_arm_m"])} - set(start.free)
    for name, needed in LEVELS.items():
        if levels < needed and name not in held:
            held.add(name)
            said.append(f"{name} held: it needs {needed} pressures, and these runs have {levels}")
    known = units(start.model)
    if strange := [p for p in frozen if p not in known]:
        raise InputError(f"{strange[0]}: no such parameter; expected one of {', '.join(known)}")
    free = [p for p in known if p not in held and p != "friction.sigma0"]
    if not free:
        raise InputError("every parameter is frozen; free one of them")
    for name in start.bounds:
        low, high = start.bounds[name]
        value = float(get(start.model, name))
        if name in free and not within(value, start.bounds[name]):
            raise InputError(
                f"{start_from}: fit.bounds.{name} = [{low:g}, {high:g}] does not hold the starting value {value:g}; "
                "move the one or the other"
            )
    tests = []
    for run in held_out:
        try:
            tests.append(motion(run, start.model.n, inputs))
        except InputError as error:
            said.append(f"left out: {error}")
    check_columns([*motions, *tests])
    place = {id(m.run): i for m, i in zip(motions, moving, strict=True)}
    session = in_order([*motions, *tests])
    motions, tests = ([m for m in session if (id(m.run) in place) == fitted] for fitted in (True, False))
    moving = [place[id(m.run)] for m in motions]
    problem = Problem(Coordinates(start.model, free, top), motions, points, start.priors, start.bounds)
    return _Case(start, start_from, list(runs), said, tuple(sorted(held & set(known))), problem, moving, tests)


def _levels(pressure: np.ndarray) -> int:
    """How many pressures at least 1 kPa apart there are."""
    ordered, count, last = np.unique(np.round(pressure, 2)), 0, -np.inf
    for p in ordered:
        if p > last + 1.0:
            count, last = count + 1, p
    return count


def calm(runs: Sequence[Run], moving: Sequence[str]) -> tuple[Points, Points, list[str]]:
    """The steady points and presses of runs none of which moves, of which `moving` says why."""
    try:
        return collect(runs)
    except InputError as error:
        still = [line for line in set_aside(moving) if "no excitation" in line]
        raise InputError("; ".join(still)) if len(still) == len(runs) else error from None


def _statics(start: ModelFile, start_from: str, runs: Sequence[Run], held, options, moving) -> StaticResult:
    steady, probe, said = calm(runs, moving)
    static = fit_static(
        start.model, steady, probe, frozen=held, weights=options["weights"], constraints=options["constraints"]
    )
    pressures = [float(p) for s in static.stages.values() for p in s.points.pressure_kpa]
    check(static.model, pressures, "the fit")
    options = {name: options[name] for name in ("frozen", "weights", "constraints", "seed")}
    return StaticResult(static=static, start=start, start_from=start_from, runs=runs, said=said, options=options)


def _restarted(problems: Sequence[Problem], count: int, rng, progress) -> list[tuple[np.ndarray, list[float]]]:
    """Where the best of several starts ended in the first round, and the errors of all, for each problem."""
    starts = [
        [p.coordinates.start + (0.1 * p.coordinates.spread * rng.normal(size=len(p.coordinates)) if i else 0.0)]
        for p in problems
        for i in range(count)
    ]
    asked = [estimate(p, starts[j * count + i][0], ROUNDS[:1]) for j, p in enumerate(problems) for i in range(count)]
    found = together(asked, progress)
    out = []
    for j, p in enumerate(problems):
        mine = found[j * count : (j + 1) * count]
        error = [np.inf if isinstance(e, Exception) else float(np.exp(np.mean(np.log(e.sigma)))) for e in mine]
        best = mine[int(np.argmin(error))]
        out.append((p.coordinates.start if isinstance(best, Exception) else best.x, error))
    return out


def _profiles(found: Estimate, names: Sequence[str], progress) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """χ² above its least along each parameter, the others fitted anew at every value."""
    if not names:
        return {}
    c = found.problem.coordinates
    slope = c.jacobian(found.x)
    sd = np.sqrt(np.diag(slope @ found.covariance @ slope.T))
    grid, searches = {}, []
    once = [Round(ROUNDS[-1].step_s, True, 1e-5, ROUNDS[-1].windows, 0.05, 0.0)]
    for name in names:
        i = c.names.index(name)
        value = c.physical(found.x)[i]
        values = value + sd[i] * np.linspace(-PROFILE_SDS, PROFILE_SDS, PROFILE_POINTS)
        grid[name] = [v for v in values if v > 0 or value < 0 or name in ("gravity.alpha1", "jamming.c5")]
        for v in grid[name]:
            others = [n for n in c.names if n != name]
            held = Coordinates(replace(found.model, {name: v}), others, c.pressure)
            searches.append(estimate(Problem(held, found.problem.motions, found.problem.points), None, once))
    ended = iter(together(searches, progress))
    widening = np.diag(found.covariance) / np.diag(found.white)
    out = {}
    for name in names:
        chi2 = []
        for _ in grid[name]:
            e = next(ended)
            chi2.append(np.nan if isinstance(e, Exception) else e.chi2_by(found))
        wide = float(widening[c.names.index(name)])
        out[name] = (np.array(grid[name]), (np.array(chi2) - np.nanmin(chi2)) / wide)
    return out
