"""`diagnose(model, runs)`: the one verb of this room."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import jax
import numpy as np

from ljjax import effects, modelfile
from ljjax.data import OCTROBOT
from ljjax.effect import Effect
from ljjax.errors import InputError, SolverError
from ljjax.fit.kernel import one_blas_thread
from ljjax.fit.points import set_aside
from ljjax.fit.result import NOMINAL
from ljjax.fit.run import calm, parted, prepared, resting
from ljjax.fit.session import in_order
from ljjax.fit.windows import Motion, Source, check_columns, motion, with_tips
from ljjax.gap.answer import answer
from ljjax.gap.candidates import sizes
from ljjax.gap.data import FITTED, span, unseen
from ljjax.gap.inquiry import Inquiry, Setting
from ljjax.gap.result import Diagnosis
from ljjax.gap.search import Study
from ljjax.logs import Run
from ljjax.model import check
from ljjax.modelfile import ModelFile

LEAST = 15.0
"""The least range of an angle in units of its noise."""


@one_blas_thread()
def diagnose(
    model: ModelFile | None,
    runs: Sequence[Run],
    *,
    held_out: Sequence[Run] = (),
    without: Sequence[str] = (),
    inputs: Source = "commands",
    seed: int = 0,
    model_from: str = "the given model",
    progress: Callable[[str, int, int], None] | None = None,
) -> Diagnosis:
    """Where the gap between a model and its robot lies, which effect causes it, how far it shrinks with that effect.

    Args:
        model: the robot's model; its base parameters are refitted. None for OctRobot-I's.
        runs: logs of one robot. Without any that moves, its steady points and probe presses are diagnosed.
        held_out: runs on which the gap is measured, even if they are among `runs`; a quarter of these by default.
        without: effects that are not on trial, by id.
        inputs: drive the model by commands, or by measured tension and pressure.
        seed: of what is drawn at random.
        model_from: where the model came from, for the record.
        progress: called with a stage's name, how many problems are done, and of how many.

    Raises:
        InputError: no usable data, several robots, too few runs, unknown effects, hardly any motion, JAX in float32.
    """
    if jax.dtypes.canonicalize_dtype(float) != np.float64:
        raise InputError("a diagnosis wants float64: call jax.config.update('jax_enable_x64', True) before JAX is used")
    robots = sorted({r.robot_id for r in (*runs, *held_out)})
    if len(robots) > 1:
        raise InputError(f"logs of {len(robots)} robots ({', '.join(robots)}); diagnose one at a time")
    for name in without:
        if name not in effects.REGISTRY:
            raise InputError(f"--without {name}: no such effect; expected one of {', '.join(effects.REGISTRY)}")
    start = modelfile.load(OCTROBOT / "nominal.toml") if model is None else model
    start_from = NOMINAL if model is None else model_from
    if start.model.effects:
        raise InputError(
            f"{start_from}: has effects already; a diagnosis starts from a base model, so remove [[effects]]"
        )
    options = {"without": list(without), "inputs": inputs, "model": start_from}
    runs, held_out = parted(runs, held_out)
    moving = [r for r in runs if not resting(r)]
    case = prepared(start, start_from, moving, (), start.frozen, inputs)
    if isinstance(case, list):
        if held_out:
            raise InputError("--held-out: no run to fit moves; of steady points every pressure is left out in turn")
        from ljjax.gap.static import diagnose_static

        steady, probe, said = calm(runs, case)
        try:
            return diagnose_static(
                start, start_from, steady, probe, runs, said, without=without, seed=seed, options=options
            )
        except InputError as error:
            still = [line for line in set_aside(case) if "no excitation" in line]
            raise InputError(f"{still[0]}; and as steady points: {error}" if still else str(error)) from None
    beside = "steady points and presses beside moving runs; diagnose them by themselves"
    said = [*case.said, *(f"left out: {r.path}: {beside}" for r in runs if resting(r))]
    train, test = _parted(case.problem.motions, held_out, start.model.n, inputs, said)
    both = with_tips([*train, *test])
    train, test = both[: len(train)], both[len(train) :]
    if train[0].tip is not None:
        said.append("the tip's orientation, logged in all of these runs, counts beside the shape")
    _moves_enough(train)
    kinds, c = _on_trial(without, start.model.n, train, said), case.problem.coordinates
    top = max(c.pressure, *(float(m.vacuum.max()) for m in test))
    check(start.model, [0.0, top], start_from)
    again = prepared(start, start_from, [m.run for m in train], (), start.frozen, inputs)  # held by what is fitted
    assert not isinstance(again, list)
    said += [line for line in again.said if line not in case.said]
    names = again.problem.coordinates.names
    study = Study(start.model, names, kinds, train, top, span(train), start.bounds, start.priors, progress)
    rng = np.random.default_rng(seed)
    setting = Setting(start, start_from, options, seed, rng, [*runs, *held_out], train, test, said, study)
    try:
        return answer(Inquiry(setting))
    except FloatingPointError as error:
        raise SolverError(f"{start_from}: {error}; give a model nearer to the robot") from None


def _on_trial(without: Sequence[str], n: int, train: Sequence[Motion], said: list[str]) -> list[type[Effect]]:
    """The candidates; those of which runs that log so little say nothing are left out and added to `said`."""
    kinds = [k for i, k in effects.REGISTRY.items() if i not in without]
    logged = train[0].y.shape[1]
    shown = [k for k in kinds if sizes(k, n, logged)]
    said += [f"{k.id} is not on trial: logs of so few joints say nothing of it" for k in kinds if k not in shown]
    if not shown:
        raise InputError("--without leaves no effect to try; leave out fewer")
    return shown


def _parted(
    motions: Sequence[Motion], held_out: Sequence[Run], joints: int, inputs: Source, said: list[str]
) -> tuple[list[Motion], list[Motion]]:
    """The runs that are fitted and those on which the gap is measured, both in the order in which they were recorded;
    what could not be used is added to `said`."""
    if not held_out:
        ordered = in_order(motions)
        keep = unseen(ordered)
        return [m for i, m in enumerate(ordered) if i not in keep], [ordered[i] for i in keep]
    tests = []
    for run in held_out:
        try:
            tests.append(motion(run, joints, inputs))
        except InputError as error:
            said.append(f"left out: {error}")
    if not tests:
        raise InputError("--held-out: none of these runs moves; give runs of moving tensions")
    check_columns([*motions, *tests])
    parts: tuple[list[Motion], list[Motion]] = ([], [])
    for m in in_order([*motions, *tests]):
        parts[any(m.run is t.run for t in tests)].append(m)
    if len(parts[0]) < FITTED:
        raise InputError(
            f"cannot tell from {len(parts[0])} moving run beside those of --held-out: a diagnosis fits two or more, "
            "each foretold by the others; give more logs"
        )
    return parts


def _moves_enough(train: Sequence[Motion]) -> None:
    """Refuse runs in which an effect could not be told from noise."""
    moved = max(float(np.max(np.ptp(m.y, axis=0))) for m in train)
    clear = max(float(np.max(np.ptp(m.y, axis=0) / m.noise)) for m in train)
    if clear < LEAST:
        raise InputError(
            f"cannot tell from these data: the shape moves by {np.degrees(moved):.2g}° at most, {clear:.2g} "
            f"times its noise, and a diagnosis needs {LEAST:g}; record runs of larger tensions"
        )
