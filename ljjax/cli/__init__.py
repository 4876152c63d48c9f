"""The command line: `ljjax COMMAND …`. A command's module, and what it needs, is imported when the command runs.

Exit 0: done. Exit 2: bad input or usage, one line on stderr. Exit 1: a fault of ours.
"""

from __future__ import annotations

import contextlib
import dataclasses
import importlib
import io
import os
import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Annotated, Any, get_args, get_origin, get_type_hints

from ljjax.errors import InputError, SolverError

COMMANDS = {
    "fit": "identify a robot's parameters from logs",
    "gap": "find where model and robot disagree, and which effect causes it",
    "simulate": "replay a log's commands through a model",
    "sweep": "simulate over ranges of parameters",
    "tune": "tune a robot's control law through the simulated closed loop",
    "robust": "how robust a law is: thousands of closed loops on robots as they may turn out",
    "export": "write a robot's control law as one file for the rig",
    "rig": "run an exported law or an experiment on hardware",
    "info": "what logs hold, and whether they meet the contract",
}


def main(args: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit code."""
    args = list(sys.argv[1:] if args is None else args)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal or a pipe that knows no Greek gets a "?", not a failure
    try:
        if not args or args[0] in ("-h", "--help"):
            print(_help(COMMANDS, "simulate, identify, diagnose and control layer-jamming continuum robots", "ljjax"))
            return 0
        if args[0] == "--version":
            from importlib.metadata import version

            print(f"ljjax {version('ljjax')}")
            return 0
        if args[0] not in COMMANDS:
            raise InputError(f"no command {args[0]!r}; expected {', '.join(COMMANDS)} (ljjax --help)")
        run = _parse(args[0], args[1:])
        if run is not None:
            run()
        return 0
    except InputError as error:
        print(f"ljjax: {error}", file=sys.stderr)
        return 2
    except SolverError as error:
        print(f"ljjax: {error}", file=sys.stderr)
        return 1
    except BrokenPipeError:  # the reader of our output has gone, as in `ljjax info … | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except KeyboardInterrupt:
        print("ljjax: interrupted; nothing written", file=sys.stderr)
        return 130


def start_jax(large: bool = False) -> None:
    """Float64, and programs compiled once kept for the next call, in the user's cache folder.

    LJJAX_CACHE names another folder; empty, nothing is kept.

    Args:
        large: thousands of loops or runs are simulated at once: on a graphics card where JAX has one. Otherwise on the
            processor, which is quicker with few (`benchmarks/devices.py`). JAX_PLATFORMS has the last word.
    """
    import jax

    if not large and not os.environ.get("JAX_PLATFORMS"):
        jax.config.update("jax_platforms", "cpu")
    jax.config.update("jax_enable_x64", True)
    home = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
    folder = os.environ.get("LJJAX_CACHE", os.path.join(home, "ljjax"))
    if folder:
        with contextlib.suppress(OSError):
            os.makedirs(folder, exist_ok=True)
            jax.config.update("jax_compilation_cache_dir", folder)
            jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.5)


@contextlib.contextmanager
def progress() -> Iterator[Callable[[str, int, int], None]]:
    """`tell(stage, done, count)`, shown on the terminal; silent where standard error is none."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    console = Console(stderr=True)
    if not console.is_terminal:
        yield lambda stage, done, count: None
        return
    columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[note]}"))
    with Progress(*columns, TimeElapsedColumn(), console=console, transient=True) as bars:
        tasks: dict[str, Any] = {}
        rounds: dict[str, int] = {}

        def tell(stage: str, done: int, count: int) -> None:
            if stage not in tasks:
                tasks[stage] = bars.add_task(stage, total=count, note="")
            rounds[stage] = rounds.get(stage, 0) + 1
            bars.update(tasks[stage], completed=done, note=f"{done} of {count} done, pass {rounds[stage]}")

        yield tell


def _help(commands: Mapping[str, str], what: str, prog: str) -> str:
    width = max(map(len, commands))
    rows = "\n".join(f"  {prog} {name:<{width}}  {about}" for name, about in commands.items())
    return f"{prog}: {what}\n\n{rows}\n\n{prog} COMMAND --help says it all."


def _parse(name: str, args: Sequence[str]):
    """The command's call with its arguments bound, or None where only help was asked for."""
    import tyro

    module = importlib.import_module(f"ljjax.cli.{name}")
    if hasattr(module, "COMMANDS"):  # a command of several
        if not args or args[0] in ("-h", "--help"):
            print(_help(module.COMMANDS, COMMANDS[name], f"ljjax {name}"))
            return None
        if args[0] not in module.COMMANDS:
            raise InputError(f"{name}: no command {args[0]!r}; expected {', '.join(module.COMMANDS)}")
        command, name, args = getattr(module, args[0]), f"{name} {args[0]}", args[1:]
    else:
        command = module.command
    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said):
            bound = tyro.cli(
                tyro.conf.configure(tyro.conf.AvoidSubcommands)(_bind(command)),
                prog=f"ljjax {name}",
                args=_gathered(name, command, args),
            )
    except SystemExit as stop:
        if not stop.code:
            return None
        raise InputError(f"{name}: {_one_line(said.getvalue())} (ljjax {name} --help)") from None
    return bound


def _gathered(name: str, command: Callable, args: Sequence[str]) -> list[str]:
    """The arguments with what an option of several values is given a second time added to the first, where the parser
    would forget that one; an option of one value given twice is an InputError."""
    import tyro

    hints = get_type_hints(command, include_extras=True)
    for hint in list(hints.values()):  # a group's flags are the command's own
        group = get_args(hint)[0] if get_origin(hint) is Annotated else hint
        if dataclasses.is_dataclass(group):
            hints |= get_type_hints(group, include_extras=True)
    groups: dict[str | int, list[str]] = {"": []}
    words = groups[""]
    for arg in args:
        if not (arg.startswith("--") and len(arg) > 2):
            words.append(arg)
            continue
        option, *value = arg.split("=", 1)
        hint = hints.get(option[2:].replace("-", "_"))
        kind, *about = get_args(hint) if get_origin(hint) is Annotated else (hint,)
        key = len(groups) if hint is None or tyro.conf.UseAppendAction in about else option
        if key in groups and get_origin(kind) is not tuple:
            raise InputError(f"{name}: {option} is given twice; give it once")
        words = groups.setdefault(key, [option])
        words += value
    return [word for group in groups.values() for word in group]


def _bind(command):
    """The same signature and help, returning the bound call instead of making it."""
    import functools

    @functools.wraps(command)
    def bind(*args, **kwargs):
        return functools.partial(command, *args, **kwargs)

    bind.__annotations__ = {k: v for k, v in command.__annotations__.items() if k != "return"}
    return bind


def _one_line(boxed: str) -> str:
    """The words of tyro's boxed message, without the box, its title and its pointer to --help."""
    inside = [m.group(1).strip() for m in re.finditer(r"^│(.*)│\s*$", boxed, re.MULTILINE)]
    rows = inside or [line.strip() for line in boxed.splitlines()]
    keep = [
        row for row in rows if row and not set(row) <= set("─- ") and "--help" not in row and "full helptext" not in row
    ]
    return " ".join(keep) or "bad usage"
