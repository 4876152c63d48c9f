"""What the README shows runs, and prints what the README says it prints."""

import io
import re
import subprocess
import sys
from pathlib import Path

from rich.console import Console

from ljjax.data import OCTROBOT
from tests.house.readme import ROOT, blocks, same


def test_the_demo_prints_the_table_shown():
    from ljjax.fit import fit
    from ljjax.fit.show import show
    from ljjax.logs import read_all

    screen = io.StringIO()
    result = fit(None, read_all([OCTROBOT / "identification.mcap", OCTROBOT / "open_loop_stiffness.mcap"]))
    show(result, Path("out/demo/fit"), Console(file=screen, highlight=False))
    same(screen.getvalue().splitlines(), blocks("text")[0].splitlines())


def test_the_python_shown_runs(tmp_path):
    (code,) = blocks("python")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "jamming.c5" in done.stdout and "identifiable" in done.stdout


def test_the_log_shown_in_the_docs_can_be_written_and_fitted(tmp_path):
    text = (ROOT / "docs" / "logs.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    code += "\nfrom ljjax.fit import fit\nprint(fit(None, [run]))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "elastic.c2 = " in done.stdout


def test_the_effect_shown_can_be_simulated():
    """The outer sleeve pulls the neighbour of a segment that is pushed along with it."""
    done = subprocess.run([sys.executable, "examples/own_effect.py"], capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    without, with_it = ([float(x) for x in re.findall(r"-?\d+\.\d*", line)] for line in done.stdout.splitlines())
    assert len(with_it) == 6 and with_it[0] < without[0] and with_it[1] > without[1]


def anchors(path: Path) -> set[str]:
    """What the headings of a page may be linked by."""
    heads = re.findall(r"^#+ (.*)$", path.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", h.lower()).replace(" ", "-") for h in heads}


def test_every_link_leads_somewhere():
    pages = [*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md"), *(ROOT / "benchmarks").rglob("*.md")]
    assert len(pages) > 10
    for path in pages:
        for target, anchor in re.findall(r"\]\(([^)#:]*)(?:#([^)]*))?\)", path.read_text(encoding="utf-8")):
            to = path.parent / target if target else path
            assert to.exists(), f"{path.name}: {target}"
            assert not anchor or anchor in anchors(to), f"{path.name}: {target}#{anchor}"
