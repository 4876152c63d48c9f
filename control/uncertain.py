"""What is not known of a robot and its loop, as independent standard normal numbers ξ, and how they become quantities.

A normal quantity is m + s·y with y = Lξ, where LLᵀ is the quantities' correlation; one with bounds is the normal
distribution cut off there, a uniform one low + (high − low)·Φ(y). All of it has derivatives by ξ.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import ndtr, ndtri
from jaxtyping import Array

from ljjax.control.robots import TRIES
from ljjax.errors import InputError
from ljjax.model import Model
from ljjax.sweep_run import inadmissible

FAR = 8.0
"""Bounds further away than so many standard deviations cut nothing off."""
LOOSE = 0.1
"""Correlations below this do not tie quantities into one group, and are taken as 0 between groups."""
COURSE = "noise course"
"""The group of the noise's course: which numbers it takes, not how large they are."""


class Input(NamedTuple):
    """A quantity that is drawn: normal with mean `a` and standard deviation `b`, cut off at `low` and `high`; or
    uniform from `a` to `b`."""

    name: str
    unit: str
    form: str
    a: float
    b: float
    low: float = -np.inf
    high: float = np.inf

    @property
    def said(self) -> str:
        """In words."""
        if self.form == "uniform":
            return f"uniform, {self.a:.4g} to {self.b:.4g} {self.unit}"
        cut = [f"{x:.4g}" if abs(x - self.a) < FAR * self.b else "" for x in (self.low, self.high)]
        tail = f", cut off at {' and '.join(x for x in cut if x)}" if any(cut) else ""
        return f"normal, {self.a:.4g} ± {self.b:.4g} {self.unit}{tail}"


@dataclass(frozen=True, eq=False)
class Inputs:
    """Everything that is drawn.

    Attributes:
        entries: (d,) one a coordinate of ξ.
        factor: (d, d) L.
        groups: name → coordinates that vary together in a sensitivity study: correlated parameters, the shape.
    """

    entries: tuple[Input, ...]
    factor: np.ndarray
    groups: Mapping[str, tuple[int, ...]]

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(x.name for x in self.entries)

    def away(self, xi: np.ndarray) -> dict[str, float]:
        """How far each quantity lies from its centre, in its own standard deviations, for ξ (d,)."""
        return dict(zip(self.names, (self.factor @ xi).tolist(), strict=True))

    def physical(self, xi: Array) -> dict[str, Array]:
        """The quantities by name, from ξ (d,); pure."""
        y = jnp.asarray(self.factor, xi.dtype) @ xi
        return {x.name: _quantity(x, y[i]) for i, x in enumerate(self.entries)}

    def columns(self, xi: np.ndarray) -> dict[str, np.ndarray]:
        """(N,) of every quantity, from ξ (N, d)."""
        if not self.entries:
            return {}
        rows = 2 ** max(0, len(xi) - 1).bit_length()  # few sizes, and so few compilations
        found = self._many(np.concatenate([xi, np.zeros((rows - len(xi), xi.shape[1]))]))
        return {name: np.asarray(found[name])[: len(xi)] for name in self.names}

    @cached_property
    def _many(self) -> Any:
        return jax.jit(jax.vmap(self.physical))


def _quantity(x: Input, y: Array) -> Array:
    if x.form == "uniform":
        return x.a + (x.b - x.a) * ndtr(y)
    ends = [(end - x.a) / x.b if abs(end - x.a) < FAR * x.b else np.sign(end - x.a) * FAR for end in (x.low, x.high)]
    if ends == [-FAR, FAR]:
        return x.a + x.b * y
    low, high = (ndtr(jnp.asarray(end, y.dtype)) for end in ends)
    tiny = jnp.finfo(y.dtype).eps
    share = jnp.clip(low + ndtr(y) * (high - low), tiny, 1 - tiny)
    return jnp.clip(x.a + x.b * ndtri(share), x.low, x.high)


def inputs(
    entries: list[Input], correlation: Mapping[tuple[str, str], float], joined: Mapping[str, tuple[str, ...]]
) -> Inputs:
    """Quantities with the correlations between pairs of them; `joined` names quantities that are one group anyhow.

    Correlated quantities form groups: linked by |r| ≥ `LOOSE`, directly or by others.

    Raises:
        InputError: correlations that no distribution has.
    """
    names = [x.name for x in entries]
    matrix = np.eye(len(names))
    for (one, other), r in correlation.items():
        if one in names and other in names:
            matrix[names.index(one), names.index(other)] = matrix[names.index(other), names.index(one)] = r
    tied = np.abs(matrix) >= LOOSE
    for members in joined.values():
        own = [i for i, name in enumerate(names) if name in members]
        tied[np.ix_(own, own)] = True
    for _ in names:
        tied = (tied.astype(int) @ tied.astype(int)) > 0
    matrix = np.where(tied, matrix, 0.0)
    try:
        factor = np.linalg.cholesky(matrix + 1e-9 * np.eye(len(names))) if names else matrix
    except np.linalg.LinAlgError:
        raise InputError("fit: its correlations are those of no distribution; fit again, or leave --fit out") from None
    groups: dict[str, tuple[int, ...]] = {}
    for i in range(len(names)):
        together = tuple(int(k) for k in np.flatnonzero(tied[i]))
        if together[0] == i:
            own = [names[k] for k in together]
            whole = [group for group, members in joined.items() if len(own) > 1 and set(own) <= set(members)]
            groups[whole[0] if whole else " + ".join(own)] = together
    return Inputs(tuple(entries), factor, groups)


def possible(model: Model, given: Inputs, xi: np.ndarray, vacuum_max_kpa: float) -> np.ndarray:
    """(N,) whether the robots of ξ (N, d) can be: `ljjax.model.check` up to a vacuum."""
    columns = {k: x for k, x in given.columns(xi).items() if "." in k and not k.startswith(("shape.", "effects."))}
    if not columns:
        return np.ones(len(xi), bool)
    return np.array([not why for why in inadmissible(model, columns, len(xi), (0.0, vacuum_max_kpa))])


def draw(
    model: Model, given: Inputs, count: int, rng: np.random.Generator, vacuum_max_kpa: float
) -> tuple[np.ndarray, int]:
    """ξ (count, d) of robots that can be, impossible ones drawn anew, and how many were.

    Raises:
        InputError: distributions within which hardly any robot is possible.
    """
    xi = rng.standard_normal((count, len(given.entries)))
    bad, anew = np.flatnonzero(~possible(model, given, xi, vacuum_max_kpa)), 0
    for _ in range(TRIES):
        if not len(bad):
            return xi, anew
        anew += len(bad)
        xi[bad] = rng.standard_normal((len(bad), xi.shape[1]))
        bad = bad[~possible(model, given, xi[bad], vacuum_max_kpa)]
    raise InputError(
        f"uncertainty: {len(bad)} of {count} robots were impossible {TRIES} times over (positive α₂, φ, μ_C ≤ μ_S); "
        "lower the standard deviations"
    )
