"""`ljjax rig emulate`: a rig that is not there, for the drivers that are."""

from __future__ import annotations

import contextlib
import dataclasses
import signal
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from ljjax.errors import InputError
from ljjax.rig.emulator import faults
from ljjax.rig.emulator.rig import EmulatedRig

if TYPE_CHECKING:
    from ljjax.model import Model

LIMITS = {
    "tension_max_n": 60.0,
    "tension_slew_n_s": 400.0,
    "vacuum_max_kpa": 40.0,
    "vacuum_slew_kpa_s": 50.0,
    "theta_max_rad": 0.5,
}
"""Those that `ljjax export` sets by default."""


def command(
    model: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="MODEL")],
    out: Annotated[Path, tyro.conf.arg(metavar="FILE.toml")] = Path("rig.toml"),
    effects: Annotated[tuple[str, ...], tyro.conf.arg(metavar="ID.NAME=VALUE…")] = (),
    fault: Annotated[tuple[str, ...], tyro.conf.arg(metavar="KIND[=VALUE][@SECONDS]…")] = (),
    rate_hz: float = 210.0,
    duration_s: Annotated[float | None, tyro.conf.arg(metavar="S")] = None,
    seed: int = 0,
) -> None:
    """Emulate a rig in real time: servos on a pseudo-terminal, a camera's pictures, a vacuum regulator and its gauge.

    Writes a rig.toml with which the drivers of the reference rig reach it, and runs until it is interrupted. A fault
    typed meanwhile (KIND or KIND=VALUE, and Enter) is put in, -KIND takes it out.

    Args:
        model: The robot, a model.toml; its effects act.
        out: The rig.toml to write.
        effects: Parameters of effects to add or change, such as actuator_lag.tau_s=0.05.
        fault: What goes wrong, and when: servo_unplugged=left|right|bus, servo_error=BIT, packet_loss=SHARE,
            packet_corrupt=SHARE, camera_frozen, tag_lost, tag_jump=RAD, gauge_stuck, gauge_nan, vacuum_leak=SHARE;
            @SECONDS after the start.
        rate_hz: Pictures a second, in Hz.
        duration_s: End after so long, in s.
        seed: Seed of noise and lost packets.
    """
    from ljjax.cli import start_jax

    planned = [faults.parse(text) for text in fault]
    if not 1 <= rate_hz <= 1000:
        raise InputError(f"--rate-hz {rate_hz:g}: expected pictures a second from 1 to 1000")
    if duration_s is not None and not duration_s > 0:
        raise InputError(f"--duration-s {duration_s:g}: expected seconds above 0")
    if out.is_dir() or not out.absolute().parent.is_dir():
        raise InputError(f"--out {out}: expected a file name in a folder that exists, such as rig.toml")
    start_jax()
    from ljjax import modelfile
    from ljjax.live import Live

    robot = _with_effects(modelfile.load(model).model, effects)
    rig = EmulatedRig(Live(robot), planned, rate_hz, seed)
    try:
        out.write_text(rig.toml({"limits": LIMITS}), encoding="utf-8")
        servos, camera, pressure = rig.tables().values()
        print(f"servos {servos['port']}, pictures {camera['source']}, vacuum {pressure['port']}")
        print(f"Written: {out}", flush=True)
        threading.Thread(target=_listen, args=(rig,), daemon=True).start()
        with _until_told(rig):
            if duration_s is not None:
                timer = threading.Timer(duration_s, rig.end)
                timer.daemon = True
                timer.start()
            rig.run()
        if rig.dropped_s > 0.01:
            print(f"this machine was too slow for real time by {rig.dropped_s:.3g} s in all")
    finally:
        rig.close()


@contextlib.contextmanager
def _until_told(rig: EmulatedRig) -> Iterator[None]:
    """Interrupt and termination end the rig in good order, so that its files go."""
    before = {s: signal.signal(s, lambda *_: rig.end()) for s in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _listen(rig: EmulatedRig) -> None:
    """Faults typed while it runs: KIND[=VALUE] puts one in, -KIND takes it out."""
    for line in sys.stdin:
        text = line.strip()
        try:
            if text.startswith("-"):
                rig.faults.clear(faults.parse(text[1:]).kind)
            elif text:
                rig.faults.put(text)
        except InputError as error:
            print(error, file=sys.stderr)


def _with_effects(model: Model, given: tuple[str, ...]) -> Model:
    """The model with effects' parameters set, ID.NAME=VALUE. Raises InputError."""
    from ljjax.effects import REGISTRY, build
    from ljjax.effects.varying import varying
    from ljjax.model import check

    found: dict[str, dict[str, float]] = {
        e.id: {name: float(getattr(e, name)) for name in e.fields()} for e in model.effects
    }
    for text in given:
        path, _, value = text.partition("=")
        name, _, parameter = path.partition(".")
        if name not in REGISTRY or parameter not in varying(REGISTRY[name]).fields():
            raise InputError(
                f"--effects {text}: no such parameter; expected ID.NAME=VALUE, such as actuator_lag.tau_s=0.05"
            )
        try:
            found.setdefault(name, {})[parameter] = float(value)
        except ValueError:
            raise InputError(f"--effects {text}: {value!r} is no number") from None
    changed = dataclasses.replace(model, effects=tuple(build(i, found[i]) for i in REGISTRY if i in found))
    check(changed, where="--effects")
    return changed
