"""The law as a C99 header for a microcontroller: `ljjax.law.step` run on symbols that note what is done to them.

One file, `math.h` alone, no allocation, no loop; `double`, or `float` where LJJAX_FLOAT is defined before its #include.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from ljjax.law.parts import KINDS, STATE_UNITS, UNITS, Command, Law, Measured, Output, State
from ljjax.law.step import start, step

PREFIX = "ljjax_law"
_INPUT_UNITS = {"q_sum": "rad", "vacuum": "kPa", "theta": "rad", "stiffness": "N/m", "left": "N", "right": "N"}


class _Lines:
    """What is written down: one constant a line, each expression once."""

    def __init__(self) -> None:
        self.lines: list[tuple[str, str, str]] = []
        self.known: dict[str, str] = {}

    def keep(self, code: str, kind: str = "ljjax_real") -> Symbol:
        if code not in self.known:
            self.known[code] = f"x{len(self.lines)}"
            self.lines.append((self.known[code], kind, code))
        return Symbol(self, self.known[code])

    def live(self, results: Iterable[str]) -> list[str]:
        """The lines that lead to these results, in order."""
        needed, out = set(results), []
        for name, kind, code in reversed(self.lines):
            if name in needed:
                needed.update(re.findall(r"\bx\d+\b", code))
                out.append(f"const {kind} {name} = {code};")
        return out[::-1]


class Symbol:
    """A number that is known only when the header runs."""

    def __init__(self, lines: _Lines, name: str):
        self.lines, self.name = lines, name

    def _with(self, sign: str, other: Any, swap: bool = False, kind: str = "ljjax_real") -> Symbol:
        a, b = self.name, _name(other)
        if swap:
            a, b = b, a
        return self.lines.keep(f"{a} {sign} {b}", kind)

    def __add__(self, other: Any) -> Symbol:
        return self._with("+", other)

    def __radd__(self, other: Any) -> Symbol:
        return self._with("+", other, True)

    def __sub__(self, other: Any) -> Symbol:
        return self._with("-", other)

    def __rsub__(self, other: Any) -> Symbol:
        return self._with("-", other, True)

    def __mul__(self, other: Any) -> Symbol:
        return self._with("*", other)

    def __rmul__(self, other: Any) -> Symbol:
        return self._with("*", other, True)

    def __truediv__(self, other: Any) -> Symbol:
        return self._with("/", other)

    def __rtruediv__(self, other: Any) -> Symbol:
        return self._with("/", other, True)

    def __neg__(self) -> Symbol:
        return self.lines.keep(f"-{self.name}")

    def __gt__(self, other: Any) -> Symbol:
        return self._with(">", other, kind="int")

    def __bool__(self) -> bool:
        raise TypeError("the law must not branch on a number; use ops.where")


class Table(Symbol):
    """An array of the header."""

    def __init__(self, lines: _Lines, name: str, size: int):
        super().__init__(lines, name)
        self.size = size

    def __len__(self) -> int:
        return self.size


def _name(x: Any) -> str:
    return x.name if isinstance(x, Symbol) else _number(x)


def _number(x: float) -> str:
    return f"LJJAX_R({float(x)!r})"


class _Ops:
    """`ljjax.law.ops` on symbols."""

    def __init__(self, lines: _Lines):
        self._lines = lines

        def call(name: str) -> Callable[..., Symbol]:
            return lambda *x: lines.keep(f"LJJAX_M({name})({', '.join(_name(a) for a in x)})")

        self.sin, self.exp, self.sqrt, self.power = call("sin"), call("exp"), call("sqrt"), call("pow")
        self.floor, self.absolute = call("floor"), call("fabs")

    def smaller(self, a: Any, b: Any) -> Symbol:
        a, b = _name(a), _name(b)
        return self._lines.keep(f"{b} < {a} ? {b} : {a}")

    def larger(self, a: Any, b: Any) -> Symbol:
        a, b = _name(a), _name(b)
        return self._lines.keep(f"{b} > {a} ? {b} : {a}")

    def where(self, condition: Any, yes: Any, no: Any) -> Symbol:
        return self._lines.keep(f"{_name(condition)} ? {_name(yes)} : {_name(no)}")

    def take(self, table: Any, index: Any) -> Symbol:
        return self._lines.keep(f"{table.name}[(int){_name(index)}]")


def header(law: Law, sha256: str = "", about: Mapping[str, Any] | None = None) -> str:
    """The text of the header.

    Args:
        law: of Python floats.
        sha256: of the law.json that it goes with.
        about: further lines for its top, by name.
    """
    lines = _Lines()
    symbols = _symbols(law, lines)
    given = Measured(*(Symbol(lines, f"measured->{x}") for x in Measured._fields))
    wanted = Command(*(Symbol(lines, f"command->{x}") for x in Command._fields))
    before = State(*(Symbol(lines, f"state->{x}") for x in State._fields))
    after, output = step(_Ops(lines), symbols, before, given, wanted)
    begun = _Lines()
    first = start(symbols, *(Symbol(begun, x) for x in ("q_sum", "vacuum", "left", "right")))

    results = [_name(x) for x in (*after, *output)]
    body, opening = lines.live(results), begun.live([_name(x) for x in first])
    top = {
        "law": f"{law.kind}: {KINDS[law.kind]}",
        "period": f"{law.period_s!r} s",
        "sha256 of law.json": sha256 or "-",
        **(about or {}),
    }
    groups = {"state": State, "measured": Measured, "command": Command}
    inputs = [f"{name}->{x}" for name, group in groups.items() for x in group._fields]
    parts = [
        "/* A control law of ljjax for a layer-jamming continuum robot. Generated; do not edit.",
        *(f" * {_ascii(name)}: {_ascii(str(value))}" for name, value in top.items()),
        " * Call the step once a period. Multiply-adds may be contracted (GCC does so unless told -std=c99 or",
        " * -ffp-contract=off): results then differ in the last digits. Do not compile with -ffast-math: it takes the",
        " * check of the inputs away. */",
        f"#ifndef {PREFIX.upper()}_H",
        f"#define {PREFIX.upper()}_H",
        "#include <math.h>",
        "#ifdef LJJAX_FLOAT",
        "typedef float ljjax_real;",
        "#define LJJAX_M(x) x##f",
        "#else",
        "typedef double ljjax_real;",
        "#define LJJAX_M(x) x",
        "#endif",
        "#define LJJAX_R(x) ((ljjax_real)(x))",
        "",
        *_struct("state", State._fields, STATE_UNITS),
        *_struct("measured", Measured._fields, _INPUT_UNITS),
        *_struct("command", Command._fields, _INPUT_UNITS),
        *_struct("output", Output._fields, _INPUT_UNITS),
        "",
        *_constants(law, "\n".join([*body, *results])),
        "",
        "/* The state in which the law takes over: bend and vacuum measured, tensions applied. */",
        f"static inline {PREFIX}_state {PREFIX}_start(ljjax_real q_sum, ljjax_real vacuum, ljjax_real left,",
        "    ljjax_real right) {",
        *(f"  {line}" for line in opening),
        f"  const {PREFIX}_state state = {{{', '.join(_name(x) for x in first)}}};",
        "  return state;",
        "}",
        "",
        "/* One tick. Returns 1; or 0, with state and output untouched, where an input, the state or a result is not",
        " * finite: hold the last output then, and start again where it is the state. */",
        f"static inline int {PREFIX}_step({PREFIX}_state *state, const {PREFIX}_measured *measured,",
        f"    const {PREFIX}_command *command, {PREFIX}_output *output) {{",
        *_finite(inputs),
        *(f"  {line}" for line in body),
        *_finite(dict.fromkeys(results)),
        *(f"  state->{field} = {_name(x)};" for field, x in zip(State._fields, after, strict=True)),
        *(f"  output->{field} = {_name(x)};" for field, x in zip(Output._fields, output, strict=True)),
        "  return 1;",
        "}",
        f"#endif /* {PREFIX.upper()}_H */",
    ]
    return "\n".join(parts) + "\n"


def _symbols(law: Law, lines: _Lines) -> Law:
    def of(path: str, value: Any) -> Symbol:
        name = f"{PREFIX}_{path.split('.')[-1]}"
        return Table(lines, name, len(value)) if hasattr(value, "__len__") else Symbol(lines, name)

    groups = {
        name: type(group)(*(of(f"{name}.{k}", v) for k, v in group._asdict().items()))
        for name in ("gains", "robot", "limits", "tables")
        for group in (getattr(law, name),)
    }
    return Law(kind=law.kind, period_s=of("period_s", law.period_s), **groups)


def _constants(law: Law, used: str) -> list[str]:
    out = []
    for path, unit in UNITS.items():
        *group, name = path.split(".")
        if not re.search(rf"\b{PREFIX}_{name}\b", used):
            continue
        value = getattr(getattr(law, group[0]) if group else law, name)
        if hasattr(value, "__len__"):
            rows = [", ".join(_number(x) for x in value[i : i + 4]) for i in range(0, len(value), 4)]
            out += [f"static const ljjax_real {PREFIX}_{name}[{len(value)}] = {{ /* {_ascii(unit)} */"]
            out += ["  " + ",\n  ".join(rows) + "};"]
        else:
            out.append(f"static const ljjax_real {PREFIX}_{name} = {_number(value)}; /* {_ascii(unit)} */")
    return out


def _finite(names: Iterable[str]) -> list[str]:
    return [f"  if (!isfinite({x})) return 0;" for x in names]


def _struct(name: str, fields: tuple[str, ...], units: Mapping[str, str]) -> list[str]:
    return [
        "typedef struct {",
        *(f"  ljjax_real {x}; /* {_ascii(units[x])} */" for x in fields),
        f"}} {PREFIX}_{name};",
    ]


def _ascii(text: str) -> str:
    for sign, plain in (("·", "*"), ("²", "^2"), ("√", "sqrt "), ("*/", "* /")):
        text = text.replace(sign, plain)
    return text.encode("ascii", "replace").decode("ascii")
