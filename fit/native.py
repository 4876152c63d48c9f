"""Programs in C of one robot's arithmetic and its derivatives, where the machine has a C compiler.

They give what XLA does, to rounding, several times as fast: a robot's numbers stay in the processor's caches, and as
many directions are derived as are asked for. One compiles in a second or two. LJJAX_CC names the compiler (`cc` by
default); empty, XLA does it all.
"""

from __future__ import annotations

import contextlib
import ctypes
import hashlib
import os
import platform
import shutil
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Hashable, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

from ljjax import batch
from ljjax.fit import lowering

LANES = 8
"""Robots side by side in one operation."""
# -O2 compiles half as long again what runs a twentieth sooner: a diagnosis wants dozens of programs, for seconds each
FLAGS = ("-O1", "-march=native", "-fno-math-errno", "-fno-trapping-math", "-fPIC", "-w")
PRELUDE = """
#include <math.h>
#include <stdlib.h>
typedef float V __attribute__((vector_size(32)));
typedef float U __attribute__((vector_size(32), aligned(4)));
typedef int B __attribute__((vector_size(32)));
#define S(x) ((V){} + (x))
#define T(x) ((B){} + (x))
static inline V pick(B c, V yes, V no) { return (V)((c & (B)yes) | (~c & (B)no)); }
static inline V v_real(B c) { return (V)(c & (B)S(1.0f)); }
static inline V v_max(V a, V b) { return pick(a > b, a, pick(a != a, a, b)); }
static inline V v_min(V a, V b) { return pick(a < b, a, pick(a != a, a, b)); }
static inline V v_abs(V a) { return (V)((B)a & T(0x7fffffff)); }
static inline V v_sign(V a) { return v_real(a > S(0.0f)) - v_real(a < S(0.0f)); }
#define EACH(name) static V v_##name(V a) { V r; for (int i = 0; i < 8; i++) r[i] = name##f(a[i]); return r; }
#define BOTH(name) \\
static V v_##name(V a, V b) { V r; for (int i = 0; i < 8; i++) r[i] = name##f(a[i], b[i]); return r; }
#if defined(__AVX2__) && defined(__GLIBC__)
#define WIDE(name) V _ZGVdN8v_##name##f(V); static inline V v_##name(V a) { return _ZGVdN8v_##name##f(a); }
#else
#define WIDE(name) EACH(name)
#endif
WIDE(exp) WIDE(log) WIDE(sin) WIDE(cos)
EACH(sqrt) EACH(cbrt) EACH(exp2) EACH(expm1) EACH(log1p) EACH(floor) EACH(ceil)
EACH(tan) EACH(asin) EACH(acos) EACH(atan) EACH(sinh) EACH(cosh) EACH(tanh) BOTH(atan2) BOTH(pow)
"""
WINDOW = """
#define ROW(a, i) (*(U *)((a) + (size_t)(i) * lanes + lane))
int window(int lanes, int steps, int ways, int room, const float *c, const float *ct, const float *d,
           float *s, float *st, float *y, float *yt, const unsigned char *on)
{
    V *p = aligned_alloc(64, 2 * sizeof(V) * (@P@ / 2 + 1));
    V *all = aligned_alloc(64, 2 * sizeof(V) * (@Q@ / 2 + 1) * (ways + 1)), new[@N_STATE@ + 1];
    if (!p || !all) { free(p); free(all); return 1; }
    for (int lane = 0; lane < lanes; lane += 8, on += @N_NEEDS@) {
        @BEGIN_VALUES@
        for (int i = 0; i < @N_VALUE@; i++) p[value[i]] = ROW(c, i);
        for (int i = 0; i < @N_STATE@; i++) p[state[i]] = ROW(s, i);
        for (int w = 0; w < ways; w++) {
            V *q = all + (size_t)@Q@ * w;
            @BEGIN_SLOPES@
            for (int i = 0; i < @N_SLOPE@; i++) q[slope[i]] = ROW(ct, i * ways + w);
            for (int i = 0; i < @N_STATE@; i++) q[state_slope[i]] = ROW(st, i * ways + w);
        }
        for (int k = 0; k < steps; k++) {
            for (int i = 0; i < @N_DRIVE@; i++) p[drive[i]] = ROW(d, i * steps + k);
            @VALUES@
            for (int w = 0; w < ways; w++) {
                V *q = all + (size_t)@Q@ * w;
                @SLOPES@
                @NEW_SLOPES@
                for (int i = 0; i < @N_STATE@; i++) q[state_slope[i]] = new[i];
            }
            @NEW_VALUES@
            for (int i = 0; i < @N_STATE@; i++) p[state[i]] = new[i];
        }
        for (int i = 0; i < @N_STATE@; i++) ROW(s, i) = p[state[i]];
        for (int w = 0; w < ways; w++)
            for (int i = 0; i < @N_STATE@; i++) ROW(st, i * ways + w) = all[(size_t)@Q@ * w + state_slope[i]];
    }
    free(p); free(all);
    return 0;
}
"""
KINDS = "value", "slope", "drive", "state", "state slope"
NOTHING = np.zeros((1, 1, 1), np.float32)
_programs: dict[Any, Program | None] = {}
_lock = threading.Lock()


def available() -> bool:
    """Whether there is a C compiler, which has taken every step so far, and no faster device."""
    return batch.platform() == "cpu" and bool(_compiler()) and None not in _programs.values()


class Program:
    """A function of one robot, compiled for many side by side.

    Args:
        function: of trees of numbers, one for each of `kinds`; to new states, their derivatives, values and their
            derivatives, which are linear in the derivatives given.
        kinds: `value` or `slope`, alike in all steps; `state` or `state slope`, replaced by the new ones after each
            step; `drive`, others in each step.
        given: such trees, whatever their numbers.
        parts: what may be absent (`ljjax.fit.lowering.Part`), of a tree of the numbers of all inputs.

    Raises:
        NotImplementedError, OSError: the function, or the machine's compiler, is not up to it.
    """

    def __init__(
        self,
        function: Callable,
        kinds: Sequence[str],
        given: Sequence[Any],
        parts: Callable[..., list[lowering.Part]] = lambda *_: [],
    ):
        def one(kind: str, tree: Any) -> Any:  # any number of directions would do: the C takes as many as there are
            shape = (2,) if "slope" in kind else ()
            return jax.tree.map(lambda x: jax.ShapeDtypeStruct(shape, np.float32), tree)

        trees = [one(kind, tree) for kind, tree in zip(kinds, given, strict=True)]
        kind_of = [kind for kind, tree in zip(kinds, trees, strict=True) for _ in jax.tree.leaves(tree)]
        jaxpr, out = jax.make_jaxpr(function, return_shape=True)(*trees)
        form = jax.tree.structure(trees)
        place: dict[str, list[int]] = {kind: [] for kind in KINDS}
        for i, kind in enumerate(kind_of):
            place[kind].append(i)
        self.parts = parts(*jax.tree.unflatten(form, range(len(kind_of))))
        states = [*place["state"], *place["state slope"]]
        lowered = lowering.step(jaxpr, ["slope" in kind for kind in kind_of], states, self.parts)
        self.needs = lowered.needs
        self._rows = {i: row for kind in ("value", "slope") for row, i in enumerate(place[kind])}
        places = {kind: [x for x, k in zip(lowered.inputs, kind_of, strict=True) if k == kind] for kind in KINDS}
        count = len(place["state"])
        new, new_slopes, rest = np.split(np.array(lowered.outputs), [count, 2 * count])
        values = [f"new[{i}] = {x};" for i, x in enumerate(new)]
        slopes = [f"new[{i}] = {x};" for i, x in enumerate(new_slopes)]
        self.count = len(rest) // 2
        values += [f"ROW(y, {i} * (steps + room) + room + k) = {x};" for i, x in enumerate(rest[: self.count])]
        slopes += [
            f"ROW(yt, ({i} * ways + w) * (steps + room) + room + k) = {x};" for i, x in enumerate(rest[self.count :])
        ]
        window = WINDOW
        for name, text in {
            **{f"N_{kind.upper().replace(' ', '_')}": len(x) for kind, x in places.items()},
            **{"VALUES": lowered.values, "SLOPES": lowered.derivatives},
            **{"NEW_VALUES": "\n".join(values), "NEW_SLOPES": "\n".join(slopes)},
            **{"P": lowered.sizes[0], "Q": lowered.sizes[1], "N_NEEDS": len(self.needs)},
            **dict(zip(("BEGIN_VALUES", "BEGIN_SLOPES"), lowered.begin, strict=True)),
        }.items():
            window = window.replace(f"@{name}@", str(text))
        tables = [f"static const int {k.replace(' ', '_')}[] = {{{_listed(x or [0])}}};\n" for k, x in places.items()]
        heads = "".join(f"{head};\n" for head in lowered.functions)
        bodies = [f"{head} {{\n{body}\n}}\n" for head, body in lowered.functions.items()]
        files = min(4, os.cpu_count() or 1)
        sources = [PRELUDE + heads + "".join(bodies[i::files]) for i in range(files)]
        sources[0] += "".join(tables) + window
        self.window = _compiled(sources)
        self.form = jax.tree.structure(out[2])

    def there(self, value: np.ndarray, slope: np.ndarray) -> np.ndarray:
        """(W / `LANES`, needs) what any of so many robots needs of the parts, by values and slopes (`run`)."""
        lanes = value.shape[-1]
        parts = np.zeros((len(self.parts), lanes // LANES), bool)
        moves = np.any(slope != 0, axis=1) if slope.shape[1] else np.zeros((len(slope), lanes), bool)
        for k, part in enumerate(self.parts):
            rows, nulls = [self._rows[i] for i in part.nulls], np.array([*part.nulls.values()], np.float32)
            off = np.any(value[rows] != nulls[:, None], axis=0)
            off |= np.any(moves[[self._rows[i] for i in part.slopes]], axis=0)
            parts[k] = off.reshape(-1, LANES).any(axis=1)
        needed = [parts[[k for k in range(len(parts)) if n >> k & 1]].all(axis=0) for n in self.needs]
        return np.array(needed, np.uint8).reshape(len(self.needs), lanes // LANES).T.copy()

    def run(
        self, value, slope, drive, state, state_slope, room: int = 0, there: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """The values (v, room + steps, W) and their derivatives (v, K, room + steps, W), nothing in the room, from rows
        of what is given: (i, W), (i, K, W) and, drives, (i, steps, W); states and their derivatives are replaced by the
        last ones. W a multiple of `LANES`. `there` is what `there` says, if that is known."""
        (ways, lanes), steps = slope.shape[1:], drive.shape[1]
        assert lanes % LANES == 0
        y, yt = (np.empty((self.count, *k, room + steps, lanes), np.float32) for k in ((), (ways,)))
        there = self.there(value, slope) if there is None else there
        arrays = value, slope, drive, state, state_slope, y, yt, there
        if self.window(lanes, steps, ways, room, *(x.ctypes.data_as(ctypes.c_void_p) for x in arrays)):
            raise MemoryError
        return y, yt


def program(
    name: Hashable,
    function: Callable,
    kinds: Sequence[str],
    given: Sequence[Any],
    parts: Callable[..., list[lowering.Part]] = lambda *_: [],
) -> Program | None:
    """The program of a function known by its name and the forms of what is given; None where there can be none."""
    key = (name, *map(jax.tree.structure, given))
    with _lock:
        if key not in _programs:
            try:
                _programs[key] = Program(function, kinds, given, parts)
            except (NotImplementedError, OSError, subprocess.SubprocessError):
                _programs[key] = None
        return _programs[key]


def rows(*trees: Any) -> np.ndarray:
    """The leaves of trees as one array, along a new first axis."""
    leaves = jax.tree.leaves(trees)
    return np.ascontiguousarray(np.stack([np.asarray(x, np.float32) for x in leaves]) if leaves else NOTHING)


def _listed(x: Sequence[int]) -> str:
    return ", ".join(map(str, x))


def _compiler() -> str:
    return shutil.which(os.environ.get("LJJAX_CC", "cc")) or ""


def _compiled(sources: list[str]) -> Any:
    """The function `window` of these files of C, kept where JAX keeps its programs."""
    linux = ["-lmvec"] if sys.platform == "linux" and platform.machine() in ("x86_64", "AMD64") else []
    machine = Path("/proc/cpuinfo")
    flags = next((x for x in machine.read_text().splitlines() if x.startswith("flags")), "") if machine.exists() else ""
    about = "\0".join([*sources, *FLAGS, *linux, _compiler(), platform.platform(), flags])
    name = f"ljjax-step-{hashlib.sha256(about.encode()).hexdigest()[:32]}.so"
    cache = getattr(jax.config, "jax_compilation_cache_dir", None)
    kept = Path(cache or "") / name
    with tempfile.TemporaryDirectory(prefix="ljjax-") as folder:
        library = Path(folder) / name
        if cache and kept.exists():
            shutil.copy(kept, library)
        else:
            files = [Path(folder) / f"part{i}.c" for i in range(len(sources))]
            for file, source in zip(files, sources, strict=True):
                file.write_text(source)
            compiling = [
                subprocess.Popen([_compiler(), *FLAGS, "-c", f], cwd=folder, stderr=subprocess.DEVNULL) for f in files
            ]
            if any([c.wait() for c in compiling]):
                raise OSError("the C compiler does not take the step")
            line = [_compiler(), "-shared", "-o", library, *(f.with_suffix(".o") for f in files), *linux, "-lm"]
            subprocess.run(line, check=True, capture_output=True)
            if cache:
                with contextlib.suppress(OSError):
                    os.replace(shutil.copy(library, kept.with_suffix(f".{os.getpid()}")), kept)
        return ctypes.CDLL(str(library)).window
