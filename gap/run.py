"""`diagnose(model, runs)`: the one verb of this room."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np

from ljjax import effects, modelfile, step
from ljjax.data import OCTROBOT
from ljjax.effect import Effect
from ljjax.errors import InputError, SolverError
from ljjax.fit.kernel import at_work
from ljjax.fit.points import set_aside
from ljjax.fit.result import NOMINAL
from ljjax.fit.run import calm, parted, prepared, resting
from ljjax.fit.windows import Motion, Source, with_tips
from ljjax.gap.answer import answer
from ljjax.gap.candidates import path, sizes, universal
from ljjax.gap.data import FITTED, span, unseen
from ljjax.gap.inquiry import Inquiry, Setting
from ljjax.gap.result import Diagnosis
from ljjax.gap.search import Study
from ljjax.logs import Run
from ljjax.model import Model, check, replace
from ljjax.modelfile import ModelFile

LEAST = 15.0
"""The least range of an angle in units of its noise."""


@at_work()
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
    case = prepared(start, start_from, moving, held_out, start.frozen, inputs)
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
    train, test = _parted(case.problem.motions, case.tests, bool(held_out))
    both = with_tips([*train, *test])
    train, test = both[: len(train)], both[len(train) :]
    if train[0].tip is not None:
        said.append("the tip's orientation, logged in all of these runs, counts beside the shape")
    _moves_enough(train)
    kinds, c = _on_trial(without, start.model, train, said), case.problem.coordinates
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


def _on_trial(without: Sequence[str], model: Model, train: Sequence[Motion], said: list[str]) -> list[type[Effect]]:
    """The candidates; those of which runs that log so little say nothing are left out and added to `said`."""
    kinds = [k for i, k in effects.REGISTRY.items() if i not in without]
    n, logged = model.n, train[0].y.shape[1]
    shown = [k for k in kinds if sizes(k, n, logged)]
    said += [f"{k.id} is not on trial: logs of so few joints say nothing of it" for k in kinds if k not in shown]
    if not shown:
        raise InputError("--without leaves no effect to try; leave out fewer")
    for kind in shown:
        if kind not in effects.LIBRARY and not _smooth(kind, model):
            raise InputError(
                f"{kind.id}: its derivative where it vanishes is not a finite number (of a root, say); write it so "
                f"that it is, or leave it out (--without {kind.id})"
            )
    return shown


def _smooth(kind: type[Effect], model: Model) -> bool:
    """Whether a step of a bent robot has finite derivatives by an effect's sizes where it vanishes; one that has not
    would spoil all others', which are simulated beside it."""
    whole = universal(model, [kind])
    left, right, vacuum, t = (jnp.asarray(x) for x in (5.0, 1.0, 10.0, 0.0))
    drive = step.Drive(left, right, vacuum, t=t)

    @jax.jit
    def moved(x: jax.Array) -> jax.Array:
        robot = replace(whole, {path(kind, n): x[i] for i, n in enumerate(kind.sizes())})
        begun = step.at_rest(robot, (jnp.asarray(0.1),) * model.n, drive)
        end = step.advance(robot, step.constants(robot), begun, drive, jnp.asarray(0.005), step.How(2, loops=True))
        return jnp.stack([*end.q, *(() if end.sensed is None else end.sensed)])

    nulls = jnp.asarray([float(kind.fields()[n]["null"]) for n in kind.sizes()])
    return bool(jnp.isfinite(jax.jacfwd(moved)(nulls)).all())


def _parted(motions: Sequence[Motion], tests: Sequence[Motion], told: bool) -> tuple[list[Motion], list[Motion]]:
    """The runs that are fitted and those on which the gap is measured: `tests`, if it is told which, else some."""
    if not told:
        keep = unseen(motions)
        return [m for i, m in enumerate(motions) if i not in keep], [motions[i] for i in keep]
    if not tests:
        raise InputError("--held-out: none of these runs moves; give runs of moving tensions")
    if len(motions) < FITTED:
        raise InputError(
            f"cannot tell from {len(motions)} moving run beside those of --held-out: a diagnosis fits two or more, "
            "each foretold by the others; give more logs"
        )
    return list(motions), list(tests)


def _moves_enough(train: Sequence[Motion]) -> None:
    """Refuse runs in which an effect could not be told from noise."""
    moved = max(float(np.max(np.ptp(m.y, axis=0))) for m in train)
    clear = max(float(np.max(np.ptp(m.y, axis=0) / m.noise)) for m in train)
    if clear < LEAST:
        raise InputError(
            f"cannot tell from these data: the shape moves by {np.degrees(moved):.2g}° at most, {clear:.2g} "
            f"times its noise, and a diagnosis needs {LEAST:g}; record runs of larger tensions"
        )
