"""Refusing what cannot work: limits, gains and models with which a law would be wrong, in one line with the mend."""

from __future__ import annotations

import itertools
import math

import numpy as np

from ljjax.control.sampled import most_damping, spectral_radius
from ljjax.control.statics import Hardware, Statics, falls, tip_stiffness
from ljjax.errors import InputError
from ljjax.law.parts import UNITS, Law
from ljjax.model import Model

UNIQUE = 4.603
"""Below this nγ/α₂ the desired potential has one critical point: α₂e + γ sin(ne) = 0 has no root but e = θ − θ* = 0.
It is −1 over the least value of sin x/x."""


def plausible(hardware: Hardware) -> None:
    for name, value in hardware._asdict().items():
        if value is not None and not math.isfinite(value):
            raise InputError(f"limits: {name} = {value}: must be a finite number")
    for name in ("tension_max_n", "tension_slew_n_s", "vacuum_max_kpa", "vacuum_slew_kpa_s", "rate_hz"):
        if not getattr(hardware, name) > 0:
            raise InputError(f"limits: {name} = {getattr(hardware, name):g}: must be > 0")
    if hardware.theta_max_rad is not None and not hardware.theta_max_rad > 0:
        raise InputError(f"limits: theta_max_rad = {hardware.theta_max_rad:g}: must be > 0")


def positive(at_rest: Statics, where: str) -> None:
    at = np.asarray(at_rest.vacuum)
    for name, x in (("α₂", at_rest.alpha2), ("φ", at_rest.phi)):
        worst = np.asarray(x).min(axis=1)
        if not (worst > 0).all():
            i = int(np.argmax(~(worst > 0)))
            raise InputError(
                f"{where}: {name} is {worst[i]:.3g} at {at[i]:.3g} kPa with the model's effects, which must be > 0; "
                "lower vacuum_max_kpa, or refit the model"
            )


def largest_angle(model: Model, at_rest: Statics, hardware: Hardware, most: float) -> float:
    """The largest |θ| [rad], to `most`, up to which the tensions hold every angle at every vacuum of the tables, and
    overcome stiction beside."""
    alpha2, phi = np.asarray(at_rest.mean_alpha2), np.asarray(at_rest.phi).max(axis=1)
    theta = np.linspace(0.0, most, 181)
    hold = np.abs(float(model.gravity.alpha1) * np.sin(model.n * theta)[:, None] + alpha2 * theta[:, None])
    stick = float(model.friction.mu_s) * phi
    strongest = float(model.chain.lever_arm_m) * (hardware.tension_max_n - hardware.tension_min_n)
    held = ((hold + stick) <= strongest).all(axis=1)
    if not held[1]:
        raise InputError(
            f"limits: tension_max_n = {hardware.tension_max_n:g}: does not even overcome stiction; it takes more than "
            f"{hardware.tension_min_n + stick.max() / float(model.chain.lever_arm_m):.3g} N"
        )
    return float(theta[-1] if held.all() else theta[int(np.argmin(held)) - 1])


def rising(model: Model, at_rest: Statics, law: Law, where: str) -> None:
    """Refuse a stiffness that rises further up to a lower vacuum than it does from somewhere up to the highest."""
    k = np.asarray(tip_stiffness(model, at_rest.alpha2 + model.friction.sigma0 * at_rest.phi, law.gains.gamma))
    at = np.asarray(at_rest.vacuum)
    ends = [-1, *np.flatnonzero(falls(k)), len(k) - 1]  # each rise begins an entry after the one before has ended
    rises = [k[b] - k[a + 1] for a, b in itertools.pairwise(ends)]
    i = int(ends[int(np.argmax(rises)) + 1])
    if max(rises) <= 0:
        raise InputError(f"{where}: the tip's stiffness rises nowhere up to {at[-1]:.3g} kPa; raise vacuum_max_kpa")
    if i < len(k) - 1:
        raise InputError(
            f"{where}: the tip's stiffness rises no further than {k[i]:.4g} N/m at {at[i]:.3g} kPa; lower "
            f"vacuum_max_kpa to {at[i - 1]:.3g}"
        )


def unique(law: Law) -> float:
    """nγ/α₂ where it is largest."""
    ratio = law.robot.segments * law.gains.gamma / min(law.tables.alpha2)
    if not ratio < UNIQUE:
        most = UNIQUE * min(law.tables.alpha2) / law.robot.segments
        raise InputError(
            f"gains.gamma = {law.gains.gamma:g}: nγ/α₂ = {ratio:.3g}, and the desired potential has one minimum only "
            f"below {UNIQUE}; choose gamma < {most:.4g} N·m"
        )
    return ratio


def routh(model: Model, at_rest: Statics, law: Law) -> None:
    """Refuse integral action under which the equal bend is unstable even while it slides and without delay: Routh's
    condition d k > I n² k_I of Iθ''' + dθ'' + kθ' + n² k_I θ = 0, for a small bend at its worst vacuum."""
    if law.kind == "passivity":
        return
    n, gains = model.n, law.gains
    viscous = n * float(model.friction.sigma2) * np.asarray(at_rest.phi).mean(axis=1)
    d = viscous + gains.damping * (n * law.robot.lever_arm_m) ** 2
    k = n * (n * gains.gamma + np.asarray(at_rest.mean_alpha2))
    most = float(np.min(d * k)) / (float(at_rest.inertia) * n**2)
    if not gains.integral < most:
        raise InputError(
            f"gains.integral = {gains.integral:g}: unstable even without friction's stiction and without delay; choose "
            f"less than {most:.4g} {UNITS['gains.integral']}, or more damping"
        )


def sampled(model: Model, at_rest: Statics, law: Law) -> None:
    """Refuse damping with which the sampled loop grows although it slides (`ljjax.control.sampled`)."""
    gains, t = law.gains, law.period_s
    radius = float(spectral_radius(model, at_rest, gains, t, gains.damping)[0])
    if radius < 1:
        return
    most, unit = most_damping(model, at_rest, gains, t), UNITS["gains.damping"]
    choose = f"less than {most:.3g} {unit}" if gains.damping > most else f"more, up to {most:.3g} {unit}"
    raise InputError(
        f"gains.damping = {gains.damping:g}: with a tick of delay at {1 / t:g} Hz the loop grows even while it slides "
        f"(spectral radius {radius:.3g}); choose {choose if most else 'less gains.gamma'}, or a higher rate"
    )
