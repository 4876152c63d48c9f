"""The numbers a fit moves: unconstrained coordinates of a model's free parameters, one a parameter.

Parameters that constrain each other (c₁, c₂, c₃; c₄, c₅; σ₁, σ₂, μ_C, μ_S) go through `ljjax.constraints`, so that
every step is an admissible robot. Where one of such a set is frozen the others move on their own (as logarithms, or
as they are), and inadmissible steps are refused. Parameters of effects move as they are, between their bounds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ljjax.constraints import constrain, unconstrain
from ljjax.errors import InputError
from ljjax.model import Model, check, get, leaf, passivity_margin, replace

GROUPS = (
    ("elastic.c1", "elastic.c2", "elastic.c3"),
    ("jamming.c4", "jamming.c5"),
    ("friction.sigma1", "friction.sigma2", "friction.mu_c", "friction.mu_s"),
)
LINEAR = ("gravity.alpha1", "elastic.c1", "elastic.c2", "jamming.c5")
"""Parameters of either sign: where they move on their own, they move as they are."""


class Coordinates:
    """A one-to-one map from x (k,) to the free parameters of a model.

    Attributes:
        like: the model that gives everything else.
        names: the free parameters, by path, in the order of x.
        start: (k,) the coordinates of `like`.
        lower, upper: (k,) bounds of x; ±inf for none.
        spread: (k,) how far a coordinate can reasonably be from its start: a factor e³ for a logarithm.
    """

    def __init__(self, like: Model, names: Sequence[str], pressure_max_kpa: float):
        self.names = tuple(names)
        self.pressure = float(max(pressure_max_kpa, 1.0))
        self.like = _inside(like)
        whole = [p for group in GROUPS if set(group) <= set(names) for p in group]
        alone = ("chain.half_length_m", "chain.radius_m", "chain.lever_arm_m", "chain.segment_mass_kg")
        single = [p for p in names if p in (*alone, "gravity.alpha1", "friction.sigma3", "friction.v_s")]
        self._built = tuple(p for p in names if p in whole or p in single)
        self._own = tuple(p for p in names if p not in self._built)
        self._log = tuple(p for p in self._own if p not in LINEAR and not p.startswith("effects."))
        try:
            free = unconstrain(self.like, self.pressure)
        except InputError as error:
            raise InputError(f"the starting model: {str(error).removeprefix('model: ')}") from None
        own = {p: float(get(self.like, p)) for p in self._own}
        built = {p: float(free[p]) for p in self._built}
        self.start = np.array([built[p] if p in built else np.log(own[p]) if p in self._log else own[p] for p in names])
        size = max(float(get(self.like, "elastic.c3")), 0.1)
        linear = {"gravity.alpha1": 3 * size, "elastic.c1": size / 100, "elastic.c2": size / 3}
        linear["jamming.c5"] = 3 * float(get(self.like, "jamming.c4"))
        self.spread = np.array([linear.get(p, 3.0) if p in (*LINEAR,) and p not in whole else 3.0 for p in names])
        self.lower, self.upper = np.full(len(names), -np.inf), np.full(len(names), np.inf)
        self._base = (self.like, self.names, self._built, self._log, self.pressure)

    def __len__(self) -> int:
        return len(self.names)

    def model(self, x: np.ndarray) -> Model:
        """The model at x (k,)."""
        values = _values(*self._base, jnp.asarray(x))
        return replace(self.like, dict(zip(self.names, values, strict=True)))

    def physical(self, x: np.ndarray) -> np.ndarray:
        """(k,) the free parameters at x, in their units."""
        return np.asarray(_values(*self._base, jnp.asarray(x)))

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        """(k, k) ∂(parameters)/∂x."""
        return np.asarray(_jacobian(*self._base, jnp.asarray(x)))

    def slopes(self, x: np.ndarray) -> Model:
        """A model whose leaves are (k,): the derivatives of the model's parameters by x."""
        zero = jax.tree.map(lambda _: np.zeros(len(self)), self.like)
        rows = dict(zip(self.names, self.jacobian(x), strict=True))
        return eqx.tree_at(lambda m: [leaf(m, p) for p in rows], zero, list(rows.values()))

    def admissible(self, x: np.ndarray) -> bool:
        """Whether the model at x is one; always, but where a set of parameters is frozen in part."""
        if not np.all(np.isfinite(x)):
            return False
        model = self.model(x)
        try:
            check(model, (0.0, self.pressure))
        except InputError:
            return False
        return float(passivity_margin(model)) >= -1e-9 or set(GROUPS[2]) <= set(self.names)


@eqx.filter_jit
def _values(like: Model, names, built, log, pressure, x: jax.Array) -> jax.Array:
    given = dict(zip(names, x, strict=True))
    model = constrain({p: given[p] for p in built}, like, pressure)
    return jnp.stack([get(model, p) if p in built else jnp.exp(given[p]) if p in log else given[p] for p in names])


@eqx.filter_jit
def _jacobian(like: Model, names, built, log, pressure, x: jax.Array) -> jax.Array:
    return jax.jacfwd(lambda y: _values(like, names, built, log, pressure, y))(x)


def _inside(model: Model) -> Model:
    """The model moved off its bounds, where logarithms would have no value."""
    f: Mapping[str, float] = {name: float(getattr(model.friction, name)) for name in ("sigma1", "sigma3", "mu_c")}
    moved = {
        "friction.sigma1": max(f["sigma1"], 1e-5),
        "friction.sigma3": max(f["sigma3"], 1.02),
        "friction.mu_s": max(float(model.friction.mu_s), f["mu_c"] * 1.01),
    }
    gap = moved["friction.mu_s"] - f["mu_c"]
    least = 1.01 * moved["friction.sigma1"] * gap / f["mu_c"] + 1e-6
    moved["friction.sigma2"] = max(float(model.friction.sigma2), least)
    return replace(model, moved)
