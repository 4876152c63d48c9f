"""Shape locking: bend, apply vacuum, release; how far the tip moves on release.

The published sheath has five layers, that of all other data two. φ is taken to grow with the sliding interfaces, from
one to four; α₂ is that of two layers. Its form saturates: the published polynomial is negative beyond 74.6 kPa. μ_S is
one number, chosen by least squares of the three published displacements' logarithms.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure

from benchmarks.control.octrobot import LEVER_ARM_M, saturating, table
from benchmarks.control.rows import Row, Size
from ljjax import batch
from ljjax.chain import tip_pose
from ljjax.model import Model, get, replace
from ljjax.step import Drive, How, advance, at_rest, constants, settled

INTERFACES = 4
THETA_DEG = 10.0
STICTIONS = np.geomspace(0.003, 0.01, 49)
STEP_S, RELEASE_S, END_S = 0.0025, 4.0, 7.0


def sheath() -> Model:
    """The robot with five layers."""
    model = saturating()
    return replace(model, {path: INTERFACES * get(model, path) for path in ("jamming.c4", "jamming.c5")})


def released(model: Model, mu_s: jax.Array, vacuum: jax.Array) -> tuple[jax.Array, jax.Array]:
    """How far the tip moves on release [mm], and the mean segment angle before it [deg]; pure.

    Pull to θ in 1 s, hold, draw the vacuum from 2 to 3 s, hold, let go from 4 to 5 s, wait until 7 s.
    """
    ratio = get(model, "friction.mu_c") / get(model, "friction.mu_s")
    model = replace(model, {"friction.mu_s": mu_s, "friction.mu_c": ratio * mu_s})
    c, zero = constants(model), jnp.zeros_like(mu_s)
    still = Drive(zero, zero, zero)
    alpha2, phi = settled(model, (zero,) * model.n, still, 1.0)
    pull = (alpha2[0] * jnp.radians(THETA_DEG) + phi[0] * mu_s) / LEVER_ARM_M

    def onward(state, t):
        left = pull * jnp.clip(t, 0.0, 1.0) * jnp.clip(RELEASE_S + 1 - t, 0.0, 1.0)
        drive = Drive(left, zero, vacuum * jnp.clip(t - 2.0, 0.0, 1.0), t=t)
        return advance(model, c, state, drive, STEP_S, How(3, loops=True)), jnp.stack(state.q)

    _, q = jax.lax.scan(
        onward, at_rest(model, (zero,) * model.n, still), STEP_S * jnp.arange(round(END_S / STEP_S), dtype=float)
    )
    before, after = q[round(RELEASE_S / STEP_S)], q[-1]
    way = tip_pose(model.chain, after)[:2] - tip_pose(model.chain, before)[:2]
    return 1e3 * jnp.linalg.norm(way), jnp.degrees(jnp.mean(before))


def locking(size: Size, out: Path, say: Callable[[str], None]) -> list[Row]:
    """The displacement on release over the vacuum."""
    rows, model = table("shape_lock"), sheath()
    u, theirs = rows["pressure_kpa"], rows["displacement_mm"]
    mu, at = (x.ravel() for x in np.meshgrid(STICTIONS, u, indexing="ij"))
    moved, held = (
        np.asarray(x).reshape(len(STICTIONS), len(u)) for x in batch.over(lambda m, x: released(model, m, x))(mu, at)
    )
    best = int(np.argmin(np.sum(np.log(moved / theirs) ** 2, axis=1)))
    mine, off = moved[best], moved[best] - theirs
    falls = bool(np.all(np.diff(mine) < 0))
    draw(u, theirs, moved, best).savefig(out / "locking.png", dpi=110)
    words = ", ".join(
        f"{a:g} kPa {m:.1f} for {x:.1f} mm ({d:+.1f} mm, {100 * d / x:+.0f} %)"
        for a, x, m, d in zip(u, theirs, mine, off, strict=True)
    )
    note = (
        f"simulated for measured: {words}; φ times {INTERFACES} for the interfaces of five layers, μ_S = "
        f"{STICTIONS[best]:.3g} chosen (one number for three), α₂ saturating, as the polynomial is negative beyond "
        f"74.6 kPa; held at {held[best].mean():.1f}° before"
    )
    beside = {"simulated_mm": mine.tolist(), "published_mm": theirs.tolist(), "mu_s": float(STICTIONS[best])}
    worst = 100 * float(np.max(np.abs(off / theirs)))
    name = "shape locking: displacement on release over 30, 60, 80 kPa, largest relative error"
    return [Row(name, worst, "%", "falls with the vacuum; errors stated", falls, len(u), note, beside)]


def draw(u: np.ndarray, theirs: np.ndarray, moved: np.ndarray, best: int) -> Figure:
    """Displacement over the vacuum, for the stiction chosen and others."""
    figure = Figure(figsize=(6, 4), layout="constrained")
    ax = figure.add_subplot(xlabel="vacuum [kPa]", ylabel="displacement on release [mm]", ylim=(0, 20))
    for i in range(0, len(moved), 6):
        ax.plot(u, moved[i], color="0.8", label=None if i else f"μ_S {STICTIONS[0]:.2g} to {STICTIONS[-1]:.2g}")
    ax.plot(u, moved[best], "s-", label=f"simulated, μ_S = {STICTIONS[best]:.3g}")
    ax.plot(u, theirs, "o", color="tab:orange", label="published")
    ax.legend(frameon=False)
    return figure
