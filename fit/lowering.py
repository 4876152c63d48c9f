"""A step and its derivatives in C, from their jaxpr: plain arithmetic over scalars, each of them eight robots wide.

Values that depend on a derivative's direction are computed once a direction, the others once. Both passes are cut into
functions of some hundred operations, which a C compiler takes in its stride; what outlives its function waits in a
workspace, `p` of the values and `q` of one direction's derivatives.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field
from typing import Any

import jax
import numpy as np

CHUNK = 300
"""Operations in one function of C."""
FOREVER = 10**9
INFIX = {
    **{"mul": "*", "add": "+", "add_any": "+", "sub": "-", "div": "/", "and": "&", "or": "|"},
    **{"gt": ">", "lt": "<", "ge": ">=", "le": "<=", "eq": "==", "ne": "!="},
}
CALLS = {
    *("exp", "exp2", "expm1", "log", "log1p", "sqrt", "cbrt", "pow", "abs", "sign", "floor", "ceil", "max", "min"),
    *("sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh"),
}
TRUTHS = {"gt", "lt", "ge", "le", "eq", "ne", "and", "or", "not"}
SAME = {"optimization_barrier", "stop_gradient", "copy", "copy_p", "broadcast_in_dim", "reshape", "squeeze"}


@dataclass(frozen=True)
class Value:
    """A number known when the step runs; whether there is one a direction, and whether it is true or false."""

    place: int
    directed: bool
    truth: bool


@dataclass(frozen=True)
class Operation:
    name: str
    result: Value
    inputs: tuple[Any, ...]


@dataclass
class Trace:
    """The operations that a jaxpr asks for, none of them twice."""

    operations: list[Operation] = field(default_factory=list)
    known: dict[Hashable, Value] = field(default_factory=dict)
    count: int = 0

    def value(self, directed: bool, truth: bool = False) -> Value:
        self.count += 1
        return Value(self.count, directed, truth)

    def do(self, name: str, *inputs: Any, truth: bool = False) -> Value:
        key = (name, *(x if isinstance(x, Value) else repr(x) for x in inputs))
        if key not in self.known:
            directed = any(isinstance(x, Value) and x.directed for x in inputs)
            self.known[key] = self.value(directed, truth)
            self.operations.append(Operation(name, self.known[key], inputs))
        return self.known[key]

    def run(self, jaxpr: Any, consts: Sequence[Any], inputs: Sequence[Any]) -> list[Any]:
        """What a jaxpr gives of inputs, Values or numbers.

        Raises NotImplementedError for what is no arithmetic of scalars.
        """
        env: dict[Any, Any] = dict(zip(jaxpr.constvars, map(_number, consts), strict=True))
        env |= dict(zip(jaxpr.invars, inputs, strict=True))

        def read(v: Any) -> Any:
            return _number(v.val) if hasattr(v, "val") else env[v]

        for e in jaxpr.eqns:
            given = [read(v) for v in e.invars]
            inner = e.params.get("jaxpr") or e.params.get("call_jaxpr")
            if inner is not None and e.primitive.name not in ("scan", "while"):
                out = self.run(inner.jaxpr, inner.consts, given)
            elif e.primitive.name in SAME:
                out = given
            elif not any(isinstance(x, Value) for x in given):
                with jax.ensure_compile_time_eval():
                    given = [np.asarray(x, v.aval.dtype) for x, v in zip(given, e.invars, strict=True)]
                    out = [_number(e.primitive.bind(*given, **e.params))]
            else:
                out = [self._one(e.primitive.name, given, e.params)]
            env.update(zip(e.outvars, out, strict=False))
        return [read(v) for v in jaxpr.outvars]

    def _one(self, name: str, x: list[Any], params: dict[str, Any]) -> Value:
        one = np.float32(1)
        if name == "integer_pow":
            power = self._power(x[0], abs(params["y"]))
            return power if params["y"] > 0 else self.do("div", one, power)
        if name == "square":
            return self.do("mul", x[0], x[0])
        if name == "one_minus_square":
            return self.do("sub", one, self.do("mul", x[0], x[0]))
        if name == "rsqrt":
            return self.do("div", one, self.do("sqrt", x[0]))
        if name == "is_finite":
            return self.do("lt", self.do("abs", x[0]), np.float32(np.inf), truth=True)
        if name == "logistic":
            return self.do("div", one, self.do("add", one, self.do("exp", self.do("neg", x[0]))))
        if name == "clamp":
            return self.do("min", self.do("max", x[1], x[0]), x[2])
        if name == "select_n":
            return self.do(name, *x, truth=any(isinstance(i, Value) and i.truth for i in x[1:]))
        if name == "convert_element_type" and np.issubdtype(params["new_dtype"], np.floating):
            return self.do("real", x[0]) if x[0].truth else x[0]
        if name in INFIX or name in CALLS or name in ("neg", "not"):
            return self.do(name, *x, truth=name in TRUTHS)
        raise NotImplementedError(name)

    def _power(self, x: Any, n: int) -> Any:
        if n == 1:
            return x
        half = self._power(x, n // 2)
        square = self.do("mul", half, half)
        return self.do("mul", square, x) if n % 2 else square


@dataclass(frozen=True)
class Pass:
    """Operations in functions, and where in the workspace lies what outlives them."""

    name: str
    chunks: list[list[Operation]]
    slot: dict[Value, int]
    size: int


@dataclass(frozen=True)
class Step:
    """A step in C: the bodies of its functions by their heads, the calls of both passes, the sizes of the workspaces,
    and where inputs lie in them and outputs are found, in C."""

    functions: dict[str, str]
    values: str
    derivatives: str
    sizes: tuple[int, int]
    inputs: list[int]
    outputs: list[str]


def step(closed: Any, directed: Sequence[bool]) -> Step:
    """The closed jaxpr of a step in C; `directed` says which inputs there is one of a direction."""
    trace = Trace()
    inputs = [trace.value(d) for d in directed]
    outputs = trace.run(closed.jaxpr, closed.consts, inputs)
    needed, kept = {x for x in outputs if isinstance(x, Value)}, []
    for o in reversed(trace.operations):
        if o.result in needed:
            kept.append(o)
            needed |= {x for x in o.inputs if isinstance(x, Value)}
    kept.reverse()
    passes = []
    for name, which in (("P", False), ("Q", True)):
        mine = [o for o in kept if o.result.directed == which]
        chunks = [mine[a : a + CHUNK] for a in range(0, len(mine), CHUNK)]
        last: dict[Value, int] = defaultdict(lambda: -1)
        for c, chunk in enumerate(chunks):
            last.update({x: c for o in chunk for x in o.inputs if isinstance(x, Value)})
        asked = [x for o in kept if o.result.directed for x in o.inputs] if not which else []
        last.update({x: FOREVER for x in (*asked, *outputs) if isinstance(x, Value)})
        passes.append(_placed(name, chunks, last, [x for x in inputs if x.directed == which]))
    slots = passes[0].slot, passes[1].slot
    functions = {}
    for each, head in zip(passes, ("(V *restrict p)", "(const V *restrict p, V *restrict q)"), strict=True):
        for c, chunk in enumerate(each.chunks):
            functions[f"void {each.name}{c}{head}"] = _body(chunk, slots)
    values, derivatives = (
        " ".join(f"{each.name}{c}({given});" for c in range(len(each.chunks)))
        for each, given in zip(passes, ("p", "p, q"), strict=True)
    )
    places = [slots[x.directed][x] for x in inputs]
    sizes = passes[0].size, passes[1].size
    return Step(functions, values, derivatives, sizes, places, [_place(x, slots) for x in outputs])


def _placed(name: str, chunks: list[list[Operation]], last: dict[Value, int], inputs: Sequence[Value]) -> Pass:
    """Slots of the workspace for the inputs, which keep theirs, and for what is asked for after its own function."""
    slot, free, size, ends = {x: i for i, x in enumerate(inputs)}, [], len(inputs), defaultdict(list)
    for c, chunk in enumerate(chunks):
        for o in chunk:
            if last[o.result] > c:
                if not free:
                    free.append(size)
                    size += 1
                slot[o.result] = free.pop()
                ends[last[o.result]].append(slot[o.result])
        free += ends.pop(c, [])
    return Pass(name, chunks, slot, size)


def _body(chunk: Sequence[Operation], slots: tuple[dict[Value, int], dict[Value, int]]) -> str:
    lines, here = [], set()

    def named(x: Any) -> str:
        if not isinstance(x, Value):
            return _literal(x)
        if x not in here:
            lines.append(f"{_kind(x)} x{x.place} = {'(B)' * x.truth}{_place(x, slots)};")
            here.add(x)
        return f"x{x.place}"

    for o in chunk:
        x = [named(i) for i in o.inputs]
        if o.name in INFIX:
            text = f"{x[0]} {INFIX[o.name]} {x[1]}"
        elif o.name == "select_n":
            text = f"(({x[0]} & {x[2]}) | (~{x[0]} & {x[1]}))" if o.result.truth else f"pick({x[0]}, {x[2]}, {x[1]})"
        elif o.name in ("neg", "not"):
            text = f"{'-' if o.name == 'neg' else '~'}{x[0]}"
        else:
            text = f"v_{o.name}({', '.join(x)})"
        lines.append(f"{_kind(o.result)} x{o.result.place} = {text};")
        here.add(o.result)
        if o.result in slots[o.result.directed]:
            lines.append(f"{_place(o.result, slots)} = (V)x{o.result.place};")
    return "\n".join(lines)


def _kind(x: Value) -> str:
    return "B" if x.truth else "V"


def _place(x: Any, slots: tuple[dict[Value, int], dict[Value, int]]) -> str:
    return f"{'pq'[x.directed]}[{slots[x.directed][x]}]" if isinstance(x, Value) else _literal(x)


def _literal(x: Any) -> str:
    if isinstance(x, bool | np.bool_):
        return f"T({-int(x)})"
    if np.isfinite(x):
        return f"S({float(np.float32(x)).hex()}f)"
    return f"S({'NAN' if np.isnan(x) else 'INFINITY' if x > 0 else '-INFINITY'})"


def _number(x: Any) -> Any:
    """The one number of an array that holds no other."""
    array = np.asarray(x)
    if not array.size or np.any(array != array.flat[0]) or array.dtype.kind not in "fb":
        raise NotImplementedError(f"an array of {array.dtype} in a step")
    return array.flat[0]
