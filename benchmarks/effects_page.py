"""Makes docs/effects.md and docs/effects.png: every effect with its equation, parameters, trace and confusions.

python -m benchmarks.effects_page
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.recovery import logs
from benchmarks.recovery.robots import draw
from benchmarks.recovery.study import model_of
from ljjax import fast
from ljjax.cli import start_jax
from ljjax.effect import Effect
from ljjax.effects import BLOCKS, REGISTRY
from ljjax.effects.varying import HALFWAY, ONSET, WAYS, varying
from ljjax.fit.run import prepared
from ljjax.fit.session import in_order
from ljjax.fit.shooting import together
from ljjax.gap.candidates import pilots, universal
from ljjax.gap.data import span
from ljjax.gap.screening import Screen, gather, screen
from ljjax.gap.search import QUICK
from ljjax.inputs import Inputs
from ljjax.logs import find, read_all
from ljjax.model import Model, replace
from ljjax.modelfile import ModelFile
from ljjax.page import ACCENT, MUTED
from ljjax.simulation import rest

DOCS = Path(__file__).parents[1] / "docs"
SECONDS, STEP_S = 8.0, 0.005
ALIKE = 0.95
HOOKS = (
    *("start", "delay_s", "actuate", "evacuate", "alpha2", "phi", "slip", "inertia", "load", "torque", "remember"),
    *("sense", "unsense", "latency_s"),
)
SHOWN = {
    "actuator_saturation.limit_n": 12.0, "actuator_deadband.band_n": 3.0, "contact.angle_rad": 0.06,
    "actuator_ripple.waves": 25.0,
}  # fmt: skip
SIZE = {
    "actuator_delay": 0.15, "actuator_lag": 0.15, "sensor_delay": 0.15, "sensor_filter": 0.15, "pressure_lag": 0.5,
    "tendon_slack": 3.0, "actuator_deadband": 1.0, "tip_payload": 0.3, "viscous_damping": 0.5, "layer_wear": 0.8,
    "friction_asymmetry": 0.6, "load_dependent_friction": 1.0, "tendon_friction": 0.8, "viscoelastic_creep": 2.0,
    "stiffness_hardening": 60.0, "layer_hysteresis": 0.1, "contact": 10.0, "pressure_leak": 0.7,
    "gravity_distribution": 1.5,
    "friction_saturation": 12.0, "stiffness_saturation": 2.0, "pressure_bias": 4.0, "actuator_ripple": 2.0,
    "thermal_drift": -0.06, "nonuniform_stiffness": 0.6,
}  # fmt: skip
"""How large an effect is drawn, where its typical size would not be seen."""
CLOCK = {"drift": 0.0, "reset_s": 5.0, "phase": 0.0}
"""No residuals tell how a sensor's stamps drift here: they do not."""


def standard() -> Inputs:
    """Bend, vacuum, release, vent; then two triangles."""
    t = np.arange(0, SECONDS, STEP_S)
    at = [0, 0.3, 0.8, 2.0, 2.3, 4.0, 4.5, 5.0, 5.5, 6.0, 6.5, 7.0, 7.5]
    net = np.interp(t, at, [0, 0, 20, 20, 0, 0, 16, -16, 16, -16, 0, 0, 0])
    vacuum = np.interp(t, [1.2, 1.3, 3.2, 3.3], [0, 20, 20, 0])
    u = 0.3 + np.stack([np.maximum(net, 0), np.maximum(-net, 0)], axis=1)
    return Inputs(jnp.asarray(t), jnp.asarray(u), jnp.asarray(vacuum))


def shown(model: Model, kind: Any) -> Model:
    """The model with one effect large enough to see."""
    first = kind.sizes()[0]
    size = SIZE.get(kind.id, 2 * kind.fields()[first]["scale"])
    values = {first: size} | {k.split(".")[1]: v for k, v in SHOWN.items() if k.startswith(kind.id + ".")}
    if kind.id == "pressure_lag":
        values["vent_s"] = size
    return replace(model, {f"effects.{kind.id}.{name}": x for name, x in values.items()})


def traces(model: Model) -> np.ndarray:
    """(1 + effects, T) θ [deg] of the base and of each effect in the standard run."""
    inputs = standard()
    whole = universal(model, list(REGISTRY.values()))
    models = [whole, *(shown(whole, kind) for kind in REGISTRY.values())]
    stacked = jax.tree.map(lambda *x: jnp.stack(x), *models)
    steps = round(SECONDS / STEP_S)
    zero, h = jnp.asarray(0.0), jnp.asarray(STEP_S)

    def one(m: Model) -> jax.Array:
        return fast.run(m, inputs, rest(m, inputs), inputs.t, zero, h, steps, 3).seen.mean(axis=1)

    return np.degrees(np.asarray(jax.jit(jax.vmap(one))(stacked)))


def picture(theta: np.ndarray) -> None:
    """docs/effects.png: a small panel an effect."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    t = np.asarray(standard().t)
    figure, axes = plt.subplots(8, 4, figsize=(13, 17), sharex=True, sharey=True, layout="constrained")
    for ax, kind, y in zip(axes.flat, REGISTRY.values(), theta[1:], strict=False):
        ax.plot(t, theta[0], color=MUTED, lw=1)
        ax.plot(t, y, color=ACCENT, lw=1.3)
        ax.set_title(kind.id, fontsize=10)
        ax.grid(alpha=0.25)
    for ax in axes.flat[len(REGISTRY) :]:
        ax.axis("off")
    figure.supxlabel("time [s]")
    figure.supylabel("mean segment angle as logged [°]; grey: without the effect")
    figure.savefig(DOCS / "effects.png", dpi=80)


def screened() -> Screen:
    """The Jacobian of eight runs of a robot without an effect, whose six joint angles are logged."""
    robot = draw(1)[0]
    with tempfile.TemporaryDirectory() as folder:
        list(logs.make([robot], Path(folder), 14.0, 0))
        runs = read_all(find([str(Path(folder) / robot.robot_id / "train")]))
        case = prepared(
            ModelFile(model_of(robot.truth), frozen=robot.known), "truth", runs, (), robot.known, "commands"
        )
    assert not isinstance(case, list)
    motions = in_order(case.problem.motions)
    kinds = list(REGISTRY.values())
    c = case.problem.coordinates
    like, of = universal(c.like, kinds), {**span(motions), **CLOCK}
    asked, said, forms = screen(like, c.names, kinds, motions, c.pressure, QUICK, partial(pilots, span=of))
    found = together(asked)
    return gather([f for f in found if not isinstance(f, Exception)], said, forms)


def _usual(found: Screen, effect: str) -> tuple[str, int]:
    """The form of an effect that has most of its parameters as they usually are; of several the one that gains most."""
    about = REGISTRY[effect].fields()

    def usual(key: tuple[str, int]) -> tuple[int, float]:
        return sum(x == about[n]["null"] for n, x in found.forms[key].items()), found.gains[key]

    return max((k for k in found.forms if k[0] == effect), key=usual)


def page(found: Screen) -> str:
    """docs/effects.md."""
    able = varying(REGISTRY["base_tilt"]).fields()
    out = [
        "# Effects",
        "",
        "Made by `python -m benchmarks.effects_page`. An effect is a cause that the base model lacks. Each is one",
        "small class in `ljjax/effects/`, vanishes exactly at the null values of its sizes, and can be put into any",
        "`model.toml`; one of your own is a class in a file of yours ([example](../examples/own_effect.py)).",
        "Parameters without a null say what form an effect has.",
        "",
        "![What each effect does to one run: bend, vacuum, release, vent, two triangles](effects.png)",
        "",
    ]
    for block in BLOCKS:
        out += [
            f"## {block.capitalize()}",
            "",
            "| id | what | parameters [unit], null, bounds | looks like |",
            "|---|---|---|---|",
        ]
        for kind in (k for k in REGISTRY.values() if k.block == block):
            words = " ".join((kind.__doc__ or "").split()).replace("|", "\\|")
            parameters = [_parameter(name, about) for name, about in kind.fields().items()]
            others = [o for o in found.ids if o != kind.id]
            near = sorted(((found.alike(_usual(found, kind.id), _usual(found, o)), o) for o in others), reverse=True)
            like = ", ".join(f"`{o}` {c:.2f}" for c, o in near[:4] if c > ALIKE) or "–"
            out.append(f"| `{kind.id}` | {words} | {'<br>'.join(parameters)} | {like} |")
        out.append("")
    out += [
        "**Looks like**: cosine of the least angle between the traces of two effects at their nulls, in their usual",
        "forms, the base's own parameters projected off, in eight runs of a robot whose six joint angles are logged",
        "(1.00: these runs cannot tell them apart; above 0.95 listed). Effects with several parameters are alike if",
        "any of their directions are. What a short run does not show (a leak, wear, warming) looks flat in the",
        "picture.",
        "",
        "## How an effect varies",
        "",
        "No real robot's effect has quite the library's form. Every effect but a transport delay may vary: its sizes",
        "are m = (1 + Σ aᵢ gᵢ)₊ times what they say, where any of these aᵢ stand beside its parameters in",
        "`model.toml`. A diagnosis sets them free where an effect explains much and leaves much.",
        "",
        "| a, null, bounds | g |",
        "|---|---|",
        *(f"| {_parameter(name, able[name])} | {g} |" for name, g in WAYS.items()),
        *(
            f"| {_parameter(name, able[name])} | H of `{way}` |"
            for name, way in zip(HALFWAY, ("by_warmth", "by_use", "by_time"), strict=True)
        ),
        "",
        "What is put on, moved or set may begin at a moment of the session, told by the slip S of the mean joint",
        f"since the first run began ({', '.join(f'`{k.id}`' for k in REGISTRY.values() if k.sudden)}): m is also times",
        "1 − b (1 − g), g = (1 + tanh((S − S₁)/S₂))/2, so that with b = 1 there is none of it before.",
        "",
        "| parameter, null, bounds | |",
        "|---|---|",
        *(f"| {_parameter(name, able[name])} | {what} |" for name, what in ONSET.items()),
        "",
        "Or it may be another in each run: m is also times 1 + cᵣ, `in_run1`, `in_run2` …, each from the slip at the",
        "start of its run up to `until1_rad`, `until2_rad` … A delay is m times what it says to first order in m − 1.",
        "",
        "## An effect of your own",
        "",
        "A subclass of `ljjax.effect.Effect` in a file that `--effects` names ([example](../examples/own_effect.py)),",
        "with an id, a block, sizes by `parameter(unit, null, low, high, scale)` and forms by `shape(…)`. What it does",
        "it does in hooks, in this order in a step; those that it lacks do nothing. They are arithmetic by `jax.numpy`",
        "on scalars, one a joint, with `jnp.where` in place of `if`.",
        "",
        "| hook | |",
        "|---|---|",
        *(f"| `{name}` | {_hook(name)} |" for name in HOOKS),
        "",
        "It must do nothing at the nulls of its sizes, and have a finite derivative there (not √a at a = 0). What",
        "`load` adds is frozen over a step of up to 10 ms: a stiff spring or a damper belongs into `torque`, which is",
        "solved for together with the joint's rate. Sizes named `mode1`, `mode2` … are shapes along the body, and not",
        "on trial where too few joints are logged to tell them.",
    ]
    return "\n".join(out) + "\n"


def _hook(name: str) -> str:
    return " ".join((getattr(Effect, name).__doc__ or "").split()).replace("|", "\\|")


def _parameter(name: str, about: Mapping[str, Any]) -> str:
    null = f", {about['null']:g}" if not about["pilots"] else ""
    return f"`{name}` [{about['unit']}]{null}, {about['low']:g} … {about['high']:g}"


if __name__ == "__main__":
    start_jax()
    picture(traces(model_of(draw(1)[0].truth)))
    (DOCS / "effects.md").write_text(page(screened()), encoding="utf-8")
    print(f"wrote {DOCS / 'effects.md'} and effects.png")
