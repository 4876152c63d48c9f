"""`diagnose(model, runs)`: the one verb of this room."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import jax
import numpy as np

from ljjax import effects, modelfile
from ljjax.data import OCTROBOT
from ljjax.errors import InputError
from ljjax.fit.kernel import one_blas_thread
from ljjax.fit.points import set_aside
from ljjax.fit.result import NOMINAL
from ljjax.fit.run import calm, parted, prepared, resting
from ljjax.fit.windows import Motion, Source, check_columns, motion, with_tips
from ljjax.gap.answer import answer
from ljjax.gap.data import FITTED, in_order, span, unseen
from ljjax.gap.inquiry import Inquiry, Setting
from ljjax.gap.result import Diagnosis
from ljjax.gap.search import Study
from ljjax.logs import Run
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
    kinds = [k for i, k in effects.REGISTRY.items() if i not in without]
    c = case.problem.coordinates
    study = Study(start.model, c.names, kinds, train, c.pressure, span(train), start.bounds, start.priors, progress)
    rng = np.random.default_rng(seed)
    setting = Setting(start, start_from, options, seed, rng, [*runs, *held_out], train, test, said, study)
    return answer(Inquiry(setting))


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
    moved, noise = (max(float(np.max(x(m))) for m in train) for x in (lambda m: np.ptp(m.y, axis=0), lambda m: m.noise))
    if moved < LEAST * noise:
        raise InputError(
            f"cannot tell from these data: the shape moves by {np.degrees(moved):.2g}° at most, {moved / noise:.2g} "
            f"times its noise, and a diagnosis needs {LEAST:g}; record runs of larger tensions"
        )
