"""A step and its derivatives in C, from their jaxpr: plain arithmetic over scalars, each of them eight robots wide.

Values that depend on a derivative's direction are computed once a direction, the others once. Both passes are cut into
functions of some hundred operations, which a C compiler takes in its stride; what outlives its function waits in a
workspace, `p` of the values and `q` of one direction's derivatives. What an absent part of the model would do
(`Part`) is not computed: its functions are not called, and the workspace holds the constants that would come of them.
"""

from __future__ import annotations

import heapq
from collections import defaultdict
from collections.abc import Hashable, Mapping, Sequence
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
NUMPY = {
    **{"mul": np.multiply, "add": np.add, "add_any": np.add, "sub": np.subtract, "div": np.divide},
    **{"and": np.logical_and, "or": np.logical_or, "not": np.logical_not, "neg": np.negative, "real": np.float32},
    **{"gt": np.greater, "lt": np.less, "ge": np.greater_equal, "le": np.less_equal},
    **{"eq": np.equal, "ne": np.not_equal, "max": np.maximum, "min": np.minimum, "pow": np.power},
    **{"atan2": np.arctan2, "asin": np.arcsin, "acos": np.arccos, "atan": np.arctan},
    **{n: getattr(np, n) for n in ("exp", "exp2", "expm1", "log", "log1p", "sqrt", "cbrt", "abs", "sign", "floor")},
    **{n: getattr(np, n) for n in ("ceil", "sin", "cos", "tan", "sinh", "cosh", "tanh")},
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
class Part:
    """A part of the model that may be absent, in terms of a step's inputs, by their numbers: it is where the `nulls`
    have these values and all of the `slopes` are 0. What becomes of the `states`, inputs too, is of no account then."""

    nulls: Mapping[int, float]
    slopes: Sequence[int]
    states: Sequence[int]


@dataclass(frozen=True)
class Pass:
    """Operations in functions, which parts (bits) each of these needs, and where in the workspace lies what outlives
    them."""

    name: str
    chunks: list[list[Operation]]
    needs: list[int]
    slot: dict[Value, int]
    size: int


@dataclass(frozen=True)
class Step:
    """A step in C: the bodies of its functions by their heads; the calls of both passes, those with a need under
    `if (on[i])`, i its place among `needs` (the bits of the parts that must all be there); what the workspaces hold to
    begin with, their sizes, and where inputs lie in them and outputs are found, in C."""

    functions: dict[str, str]
    values: str
    derivatives: str
    needs: list[int]
    begin: tuple[str, str]
    sizes: tuple[int, int]
    inputs: list[int]
    outputs: list[str]


def step(closed: Any, directed: Sequence[bool], states: Sequence[int] = (), parts: Sequence[Part] = ()) -> Step:
    """The closed jaxpr of a step in C; `directed` says which inputs there is one of a direction, `states` which of them
    the first outputs replace."""
    trace = Trace()
    inputs = [trace.value(d) for d in directed]
    outputs = trace.run(closed.jaxpr, closed.consts, inputs)
    needed, kept = {x for x in outputs if isinstance(x, Value)}, []
    for o in reversed(trace.operations):
        if o.result in needed:
            kept.append(o)
            needed |= {x for x in o.inputs if isinstance(x, Value)}
    kept.reverse()
    need, constant = _needs(kept, inputs, outputs, states, parts)
    passes = []
    for name, which in (("P", False), ("Q", True)):
        mine = [o for o in kept if o.result.directed == which]
        chunks, needs = _ordered(mine, need) if parts else _cut(mine, 0)
        last: dict[Value, int] = defaultdict(lambda: -1)
        for c, chunk in enumerate(chunks):
            last.update({x: c for o in chunk for x in o.inputs if isinstance(x, Value)})
        asked = [x for o in kept if o.result.directed for x in o.inputs] if not which else []
        last.update({x: FOREVER for x in (*asked, *outputs) if isinstance(x, Value)})
        passes.append(_placed(name, chunks, needs, last, [x for x in inputs if x.directed == which], constant))
    slots = passes[0].slot, passes[1].slot
    functions = {}
    for each, head in zip(passes, ("(V *restrict p)", "(const V *restrict p, V *restrict q)"), strict=True):
        for c, chunk in enumerate(each.chunks):
            functions[f"void {each.name}{c}{head}"] = _body(chunk, slots)
    every = list(dict.fromkeys(n for each in passes for n in each.needs if n))
    calls = []
    for each, given in zip(passes, ("p", "p, q"), strict=True):
        on = [f"if (on[{every.index(n)}]) " if n else "" for n in each.needs]
        calls.append(" ".join(f"{when}{each.name}{c}({given});" for c, when in enumerate(on)))
    held = [(x, number) for x, number in constant.items() if x in slots[x.directed]]
    begin = tuple(
        " ".join(f"{_place(x, slots)} = (V){_literal(number)};" for x, number in held if x.directed == which)
        for which in (False, True)
    )
    places = [slots[x.directed][x] for x in inputs]
    sizes = passes[0].size, passes[1].size
    found = [_place(x, slots) for x in outputs]
    return Step(functions, calls[0], calls[1], every, (begin[0], begin[1]), sizes, places, found)


def _needs(
    operations: Sequence[Operation],
    inputs: Sequence[Value],
    outputs: Sequence[Any],
    states: Sequence[int],
    parts: Sequence[Part],
) -> tuple[dict[Value, int], dict[Value, Any]]:
    """The parts (bits) without any of which an operation need not be done, by its result, and the constants that stand
    for results without them."""
    users: dict[Value, list[int]] = defaultdict(list)
    for k, o in enumerate(operations):
        for x in {x for x in o.inputs if isinstance(x, Value)}:
            users[x].append(k)
    constant: dict[Value, Any] = {}
    still: dict[Value, int] = defaultdict(int)
    unread: dict[tuple[int, Value], int] = defaultdict(int)
    for bit, part in enumerate(parts):
        known: dict[Value, Any] = {inputs[i]: np.float32(x) for i, x in part.nulls.items()}
        known |= {inputs[i]: np.float32(0) for i in part.slopes}
        waiting = sorted({k for x in known for k in users[x]})
        seen = set(waiting)
        while waiting:
            k = heapq.heappop(waiting)
            o = operations[k]
            given = [known.get(x) if isinstance(x, Value) else x for x in o.inputs]
            number = _folded(o.name, given)
            if number is not None and constant.get(o.result, number) == number:
                known[o.result] = constant[o.result] = number
                still[o.result] |= 1 << bit
                for after in users[o.result]:
                    if after not in seen:
                        seen.add(after)
                        heapq.heappush(waiting, after)
            elif o.name == "select_n" and given[0] is not None:
                left = o.inputs[1 if given[0] else 2]
                if isinstance(left, Value) and left not in (o.inputs[0], o.inputs[2 if given[0] else 1]):
                    unread[k, left] |= 1 << bit
    own = {i: sum(1 << bit for bit, part in enumerate(parts) if i in part.states) for i in states}
    while True:
        idle: dict[Value, int] = defaultdict(lambda: -1)
        for k, x in enumerate(outputs):
            if isinstance(x, Value):
                idle[x] &= own[states[k]] if k < len(states) else 0
        need: dict[Value, int] = {}
        for k in reversed(range(len(operations))):
            o = operations[k]
            need[o.result] = still[o.result] | idle[o.result]
            for x in {x for x in o.inputs if isinstance(x, Value)}:
                idle[x] &= need[o.result] | unread[k, x]
        read = {i: by & ~idle[inputs[i]] for i, by in own.items()}
        if not any(read.values()):
            return need, constant
        own = {i: by & ~read[i] for i, by in own.items()}  # what a part remembers is read without it: it is kept


def _folded(name: str, x: Sequence[Any]) -> Any:
    """What an operation gives where those of its inputs that are not None are known; None if these do not say."""
    zero = any(i is not None and i == 0 for i in x)
    if name == "mul" and zero:
        return np.float32(0)
    if name == "and" and zero:
        return np.bool_(False)
    if name == "div" and x[0] is not None and x[0] == 0 and (x[1] is None or x[1] != 0):
        return np.float32(0)
    if name == "select_n" and x[0] is not None:
        return x[2 if x[0] else 1]
    if name not in NUMPY or any(i is None for i in x):
        return None
    with np.errstate(all="ignore"):
        out = NUMPY[name](*x)
    return out if np.isfinite(out) else None


def _ordered(operations: Sequence[Operation], need: Mapping[Value, int]) -> tuple[list[list[Operation]], list[int]]:
    """Operations in functions of those of one need, none before what it is made of, in few functions; and the needs."""
    made_by = {o.result: k for k, o in enumerate(operations)}
    before = [len({x for x in o.inputs if x in made_by}) for o in operations]
    users: dict[int, list[int]] = defaultdict(list)
    for k, o in enumerate(operations):
        for x in {x for x in o.inputs if x in made_by}:
            users[made_by[x]].append(k)
    ready: dict[int, list[int]] = defaultdict(list)
    for k, count in enumerate(before):
        if not count:
            ready[need[operations[k].result]].append(k)
    chunks, needs = [], []
    while any(ready.values()):
        which = max(ready, key=lambda n: (n != 0 and bool(ready[n]), len(ready[n])))  # the body waits for its parts
        mine = []
        while ready[which]:
            k = heapq.heappop(ready[which])
            mine.append(operations[k])
            for after in users[k]:
                before[after] -= 1
                if not before[after]:
                    heapq.heappush(ready[need[operations[after].result]], after)
        cut, same = _cut(mine, which)
        chunks += cut
        needs += same
    return chunks, needs


def _cut(operations: Sequence[Operation], need: int) -> tuple[list[list[Operation]], list[int]]:
    chunks = [list(operations[a : a + CHUNK]) for a in range(0, len(operations), CHUNK)]
    return chunks, [need] * len(chunks)


def _placed(
    name: str,
    chunks: list[list[Operation]],
    needs: list[int],
    last: dict[Value, int],
    inputs: Sequence[Value],
    own: Mapping[Value, Any],
) -> Pass:
    """Slots of the workspace for the inputs, which keep theirs as what is in `own` does, and for what is asked for
    after its own function."""
    slot, free, size, ends = {x: i for i, x in enumerate(inputs)}, [], len(inputs), defaultdict(list)
    for c, chunk in enumerate(chunks):
        for o in chunk:
            if last[o.result] > c:
                if not free or o.result in own:
                    free.append(size)
                    size += 1
                slot[o.result] = free.pop()
                if o.result not in own:
                    ends[last[o.result]].append(slot[o.result])
        free += ends.pop(c, [])
    return Pass(name, chunks, needs, slot, size)


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
