"""What a user installs: one importable name, every room in it, cheap imports, nothing that harms a neighbour."""

import ast
import os
import subprocess
import sys
import tarfile
import venv
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
ROOMS = ("fit", "gap", "control", "rig")
DATA = ("identification.csv", "identification.mcap", "open_loop_stiffness.mcap", "nominal.toml", "README.md")


def run(*command: str | Path, **kwargs) -> str:
    # A user's PYTHONPATH or configuration must not leak into the empty environment.
    env = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")}
    done = subprocess.run([str(c) for c in command], capture_output=True, text=True, env=env, **kwargs)
    assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    return done.stdout


@pytest.fixture(scope="module")
def built(tmp_path_factory) -> tuple[Path, Path]:
    """An sdist of the tree, and the wheel that is built from that sdist."""
    out = tmp_path_factory.mktemp("dist")
    run(sys.executable, "-m", "build", "--outdir", out, ROOT)
    (sdist,), (wheel,) = out.glob("*.tar.gz"), out.glob("*.whl")
    return sdist, wheel


@pytest.fixture(scope="module")
def installed(built, tmp_path_factory) -> Path:
    """The Python of an empty environment with the wheel and python-control, pinned."""
    home = tmp_path_factory.mktemp("empty")
    venv.create(home, with_pip=True)
    python = home / ("Scripts" if os.name == "nt" else "bin") / "python"
    pip = (python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "-c", ROOT / "constraints.txt")
    run(*pip, built[1])
    run(*pip, "control")
    return python


def modules(names) -> set[str]:
    """Importable modules named by the files of an archive."""
    found = {n.removesuffix(".py").removesuffix("/__init__").replace("/", ".") for n in names if n.endswith(".py")}
    return {n for n in found if n.startswith("ljjax")}


def sources() -> set[str]:
    """Every module in the tree, rooms under their installed names."""
    real = [(ROOT / "ljjax", "ljjax")] + [(ROOT / room, f"ljjax/{room}") for room in ROOMS]
    names = {
        f"{name}/{path.relative_to(folder).as_posix()}"
        for folder, name in real
        for path in folder.rglob("*.py")
        if not any((folder / part).is_symlink() for part in path.relative_to(folder).parts)
    }
    return modules(names)


def test_wheel_holds_every_module_and_the_data_and_no_other_top_level_name(built):
    names = zipfile.ZipFile(built[1]).namelist()
    assert modules(names) == sources()
    assert {n.split("/")[0] for n in names if ".dist-info" not in n} == {"ljjax"}
    assert {f"ljjax/data/octrobot/{name}" for name in DATA} | {"ljjax/py.typed"} <= set(names)


def test_sdist_holds_the_data(built):
    names = {n.split("/", 1)[-1] for n in tarfile.open(built[0]).getnames()}
    assert {f"ljjax/data/octrobot/{name}" for name in DATA} <= names


def test_every_module_imports_from_an_empty_environment(installed, tmp_path):
    names = sorted(sources() - {"ljjax.__main__"})
    code = "import importlib, sys\nfor name in sys.argv[1:]: importlib.import_module(name)\nprint('imported')"
    assert "imported" in run(installed, "-c", code, *names, cwd=tmp_path)


def test_the_command_line_runs_from_an_empty_environment(installed, tmp_path):
    log = run(installed, "-c", "from ljjax.data import OCTROBOT; print(OCTROBOT / 'identification.mcap')", cwd=tmp_path)
    run(installed.parent / "ljjax", "fit", log.strip(), "--out", tmp_path / "out")
    assert {p.name for p in (tmp_path / "out").iterdir()} == {"fit.json", "model.toml", "report.html", "result.mcap"}


def test_python_control_works_beside_it(installed, tmp_path):
    code = "import control, ljjax.control as ours; print(control.tf([1], [1, 1]).poles()[0].real, ours.__name__)"
    assert run(installed, "-c", code, cwd=tmp_path).split() == ["-1.0", "ljjax.control"]


@pytest.mark.parametrize(
    "name", ["ljjax", "ljjax.law", "ljjax.rig", "ljjax.gap", "ljjax.control", "ljjax.fit", "ljjax.logs", "ljjax.cli"]
)
def test_import_loads_no_jax(name):
    code = f"import sys, {name}; print([m for m in ('jax', 'diffrax', 'matplotlib', 'scipy') if m in sys.modules])"
    assert run(sys.executable, "-c", code, cwd=ROOT).strip() == "[]"


def test_the_facade_names_exist():
    code = "import ljjax; print(all(getattr(ljjax, n) is not None for n in dir(ljjax)))"
    assert run(sys.executable, "-c", code, cwd=ROOT).strip() == "True"


def test_the_law_that_runs_on_a_rig_imports_nothing_but_errors():
    names = set()
    for path in (ROOT / "ljjax" / "law").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names |= {alias.name for alias in node.names} if isinstance(node, ast.Import) else set()
            names |= {node.module or "."} if isinstance(node, ast.ImportFrom) else set()
    ours = {name for name in names if name.split(".")[0] not in sys.stdlib_module_names}
    assert {name for name in ours if name.split(".")[:2] != ["ljjax", "law"]} == {"ljjax.errors"}


def test_rooms_import_only_what_the_house_allows():
    allowed = {"ljjax": (), "fit": ("fit",), "gap": ("fit", "gap"), "control": ("control",), "rig": ("rig",)}
    wrong = []
    for room, others in allowed.items():
        for path in (ROOT / room).rglob("*.py"):
            inside = path.relative_to(ROOT / room).parts
            if room == "ljjax" and ((ROOT / room / inside[0]).is_symlink() or inside[0] == "cli"):
                continue  # the command line imports a room when its command runs
            for line in path.read_text(encoding="utf-8").splitlines():
                words = line.split()
                if len(words) > 1 and words[0] in ("from", "import"):
                    parts = words[1].split(".")
                    if parts[0] == "ljjax" and len(parts) > 1 and parts[1] in ROOMS and parts[1] not in others:
                        wrong.append(f"{path.relative_to(ROOT)}: {line.strip()}")
    wrong = [w for w in wrong if not w.startswith("ljjax/__init__.py")]
    assert not wrong


COMPREHENSIONS = ast.ListComp, ast.SetComp, ast.DictComp


def hidden(source: str) -> list[str]:
    """Names of the module that a comprehension of a function takes for its variable while another expression of that
    function means the module's. CPython 3.12 to 3.12.3 takes such a name for a variable of the function throughout."""
    tree = ast.parse(source)
    own = {a.asname or a.name for x in tree.body if isinstance(x, ast.Import | ast.ImportFrom) for a in x.names}
    own |= {x.name for x in tree.body if isinstance(x, ast.FunctionDef | ast.ClassDef)}
    found = []
    for function in ast.walk(tree):
        if not isinstance(function, ast.FunctionDef):
            continue
        taken: dict[str, set[int]] = {}
        for each in ast.walk(function):
            if isinstance(each, COMPREHENSIONS):
                for x in (x for part in each.generators for x in ast.walk(part.target) if isinstance(x, ast.Name)):
                    taken.setdefault(x.id, set()).update(id(y) for y in ast.walk(each))
        for x in ast.walk(function):
            if isinstance(x, ast.Name) and x.id in own and id(x) not in taken.get(x.id, {id(x)}):
                found.append(f"line {x.lineno}: {x.id}")
    return found


def test_no_comprehension_takes_a_name_of_the_module_that_its_function_uses():
    assert hidden("def leaf(): 0\ndef f(): return [leaf for leaf in ()], [leaf(x) for x in ()]") == ["line 2: leaf"]
    sources = [path for room in ("ljjax", *ROOMS) for path in (ROOT / room).rglob("*.py")]
    assert not {str(path): names for path in sources if (names := hidden(path.read_text(encoding="utf-8")))}
