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


def test_every_link_leads_somewhere():
    for path in [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").glob("*.md")]:
        for target in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", path.read_text(encoding="utf-8")):
            assert (path.parent / target).exists(), f"{path.name}: {target}"
