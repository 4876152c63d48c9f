"""The example that goes from experiments to a law that knows what the model lacked, on an emulated rig."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
LIMIT_S = 1800.0


@pytest.mark.long
def test_the_full_circle_names_the_hidden_effect_and_the_law_that_knows_it_tracks_better(tmp_path: Path):
    line = [sys.executable, "examples/full_circle.py", "--quick", "--out", str(tmp_path / "out")]
    done = subprocess.run(line, cwd=ROOT, capture_output=True, text=True, timeout=LIMIT_S)
    said = done.stdout
    assert done.returncode == 0, said[-3000:] + done.stderr[-3000:]
    assert "effect found: actuator_lag (hidden: actuator_lag.tau_s=0.2)" in said
    before, after = (float(re.findall(rf"tracking error {name}: ([\d.]+)°", said)[0]) for name in ("before", "after"))
    assert after < 0.5 * before and after < 0.3, (before, after)
