"""Rows of the fault table against the emulated rig: what is named, that the tendons go slack, what the log says."""

from pathlib import Path

import pytest

from benchmarks.rig_faults import CASES, LIMITS, tried

PATIENT = "\n".join(
    ["late_s = 30.0", "missed_share = 1e6", "log_s = 60.0", "first_s = 60.0", "shape_s = 1.0", "tendons_s = 5.0",
     "pressure_s = 5.0", "jump_rad = 0.2", "stuck_s = 3.0"]
)  # fmt: skip
"""A loaded machine is no broken robot."""
ROWS = (
    "one servo unplugged",
    "20 % of packets lost",
    "a servo's error bit (overload)",
    "the tag is lost",
    "the gauge says no number",
    "half the vacuum leaks",
    "the wall clock goes back an hour",
    "the logger is killed",
    "the process is killed (−9)",
    "the law was edited by hand",
)


@pytest.mark.parametrize("name", ROWS)
def test_a_row_of_the_fault_table(name: str, tmp_path: Path):
    case = next(case for case in CASES if case.name == name)
    told = tried(case, tmp_path, safety=PATIENT)
    assert told.most_n <= LIMITS["tension_max_n"]
    assert told.slack_s < 30.0  # at 20 N/s and more, however late this machine is
    if "edited" in name:
        assert told.code == 2 and told.end == "no log" and told.most_n == 0 and "sha256" in told.line
    elif told.code == -9:
        assert told.end == "cut short" and told.lost_s < 0.5
    elif "logger" in name:
        assert told.code == 2 and told.end == "cut short" and "the logging process has gone" in told.line
    elif told.code == 0:
        assert told.end == "completed" and (not case.named or "" in case.named)
    else:
        assert told.code == 2 and told.end.removeprefix("fault: ").split(":")[0] in case.named, told
        assert told.line.endswith(told.end.removeprefix("fault: ")) and told.named_s >= 0
