"""The numbers a fit moves: unconstrained coordinates of a model's free parameters, one a parameter.

Parameters that constrain each other (c₁, c₂, c₃; c₄, c₅; σ₁, σ₂, μ_C, μ_S) go through `ljjax.constraints`, so that
every step is an admissible robot. Where one of such a set is frozen the others move on their own (as logarithms, or
as they are), and inadmissible steps are refused. How large an effect is moves as it is, what form it has as a logarithm
where it must be positive.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ljjax.constraints import parameters, unconstrain
from ljjax.errors import InputError
from ljjax.model import Model, check, get, leaf, limits, passivity_margin, replace

GROUPS = (
    ("elastic.c1", "elastic.c2", "elastic.c3"),
    ("jamming.c4", "jamming.c5"),
    ("friction.sigma1", "friction.sigma2", "friction.mu_c", "friction.mu_s"),
)
LINEAR = ("gravity.alpha1", "elastic.c1", "elastic.c2", "jamming.c5")
"""Parameters of either sign: where they move on their own, they move as they are."""
TINY = 1e-100
"""An imaginary step: f(x + i·TINY)/TINY has the derivative as its imaginary part, exact to rounding."""
STEEPEST = 4.0
"""The largest σ₃ to which a fit goes by itself: a steeper fall of the friction is a jump that no step resolves."""


class Coordinates:
    """A one-to-one map from x (k,) to the free parameters of a model.

    Attributes:
        like: the model that gives everything else.
        names: the free parameters, by path, in the order of x.
        start: (k,) the coordinates of `like`.
        spread: (k,) how far a coordinate can reasonably be from its start: a factor e³ for a logarithm.
        bounds: lowest and highest value of the parameters that have any, by path, in the parameter's unit.
    """

    def __init__(self, like: Model, names: Sequence[str], pressure_max_kpa: float):
        self.names = tuple(names)
        self.pressure = float(max(pressure_max_kpa, 1.0))
        self.like = _inside(like)
        self._leaves, self._form = jax.tree.flatten(self.like)
        self._numbers = [np.asarray(x) for x in self._leaves]
        numbered = jax.tree.unflatten(self._form, range(len(self._leaves)))
        self._places = [leaf(numbered, p) for p in names]
        whole = [p for group in GROUPS if set(group) <= set(names) for p in group]
        alone = ("chain.half_length_m", "chain.radius_m", "chain.lever_arm_m", "chain.segment_mass_kg")
        single = [p for p in names if p in (*alone, "gravity.alpha1", "friction.sigma3", "friction.v_s")]
        about = {f"effects.{e.id}.{name}": x for e in like.effects for name, x in e.fields().items()}
        forms = {p for p, x in about.items() if x["pilots"] and x["low"] > 0}
        self._built = tuple(p for p in names if p in whole or p in single)
        self._log = np.array([p in forms if p in about else p not in (*self._built, *LINEAR) for p in names], bool)
        self._index = np.array([names.index(p) for p in self._built], int)
        bare = jax.tree.map(np.asarray, without_effects(self.like))
        try:
            with np.errstate(divide="ignore"):
                self._free = free = unconstrain(bare, self.pressure, np)
        except InputError as error:
            raise InputError(f"the starting model: {str(error).removeprefix('model: ')}") from None
        value = np.array([float(get(self.like, p)) for p in names])
        self.start = np.where(self._log, np.log(np.where(self._log, value, 1.0)), value)
        self.start[self._index] = [float(free[p]) for p in self._built]
        size = max(float(get(self.like, "elastic.c3")), 0.1)
        linear = {"gravity.alpha1": 3 * size, "elastic.c1": size / 100, "elastic.c2": size / 3}
        linear["jamming.c5"] = 3 * float(get(self.like, "jamming.c4"))
        linear |= {p: 10 * x["scale"] for p, x in about.items() if p not in forms} | dict.fromkeys(forms, 1.5)
        self.spread = np.array([linear.get(p, 3.0) if p in linear and p not in whole else 3.0 for p in names])
        self.bounds = {p: pair for p, pair in limits(like).items() if p in names}
        if "friction.sigma3" in names:
            self.bounds["friction.sigma3"] = 0.0, max(STEEPEST, float(like.friction.sigma3))
        free = -np.inf, np.inf
        self._ends = np.array([self.bounds.get(p, free) if p in about else free for p in names], float).reshape(-1, 2).T
        self._within = np.array([self.ends(i, *pair) or free for i, pair in enumerate(self._ends.T)]).reshape(-1, 2).T

    def __len__(self) -> int:
        return len(self.names)

    def model(self, x: np.ndarray) -> Model:
        """The model at x (k,)."""
        return self._with(self._leaves, [jnp.asarray(v) for v in self.physical(x)])

    def numbers(self, x: np.ndarray) -> Model:
        """The same, its leaves NumPy's."""
        return self._with(self._numbers, self.physical(x))

    def physical(self, x: np.ndarray) -> np.ndarray:
        """(k,) the free parameters at x, in their units."""
        out = np.clip(np.where(self._log, np.exp(np.where(self._log, x, 0.0)), x), *self._ends)
        if self._built:
            out[self._index] = self._values(x[self._index])
        return out

    def ends(self, i: int, low: float, high: float) -> tuple[float, float] | None:
        """Where coordinate i is when its parameter is at its bounds; None for one that says more than a parameter."""
        if i in self._index:
            return None
        if not self._log[i]:
            return low, high
        return (np.log(low) if low > 0 else -np.inf), (np.log(high) if high > 0 else -np.inf)

    def within(self, x: np.ndarray) -> np.ndarray:
        """(k,) x with what belongs to effects moved to its bounds, where it is beyond them."""
        return np.clip(x, *self._within)

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        """(k, k) ∂(parameters)/∂x."""
        out = np.diag(np.where(self._log, np.exp(np.where(self._log, x, 0.0)), 1.0))
        if self._built:
            moved = x[self._index] + 1j * TINY * np.eye(len(self._index))
            out[np.ix_(self._index, self._index)] = np.stack([np.imag(self._values(y)) for y in moved], axis=1) / TINY
        return out

    def _values(self, x: np.ndarray) -> np.ndarray:
        """The parameters that are built of the coordinates x, real or complex."""
        values = parameters({**self._free, **dict(zip(self._built, x, strict=True))}, self.pressure, np)
        return np.array([values[p] for p in self._built])

    def slopes(self, x: np.ndarray) -> Model:
        """A model whose leaves are (k,): the derivatives of the model's parameters by x."""
        return self._with([np.zeros(len(self))] * len(self._leaves), self.jacobian(x))

    def _with(self, leaves: Sequence[Any], values: Iterable[Any]) -> Model:
        """A model of these leaves but for the free parameters (many times faster than `equinox.tree_at`)."""
        new = list(leaves)
        for i, value in zip(self._places, values, strict=True):
            new[i] = value
        return jax.tree.unflatten(self._form, new)

    def admissible(self, x: np.ndarray) -> bool:
        """Whether the model at x is one but for what bounds its effects; always, but where a set of parameters is
        frozen in part."""
        if not np.all(np.isfinite(x)):
            return False
        try:
            check(without_effects(self.numbers(x)), (0.0, self.pressure))
        except InputError:
            return False
        return set(GROUPS[2]) <= set(self.names) or float(passivity_margin(self.model(x))) >= -1e-9


def without_effects(model: Model) -> Model:
    """The model without its effects."""
    return dataclasses.replace(model, effects=())


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
