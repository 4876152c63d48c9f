"""Make the OctRobot-I logs from the published tables: `python -m ljjax.data.make_octrobot_logs [FOLDER]`.

Every row is a sample with its published standard deviation. The same tables give the same bytes.
"""

from __future__ import annotations

import hashlib
import math
import sys
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from ljjax.data import OCTROBOT
from ljjax.logs import Writer

P_ATM_PA = 101_325.0
PROBE_M = 0.001
SOURCE = "Fan, Yi, Liu: Modeling, Control, and Stiffness Regulation of Layer Jamming-based Continuum Robots"
LOGS = {
    "identification": ("steady operating points", "2024-01-01T00:00:00Z"),
    "open_loop_stiffness": ("probe stiffness at rest", "2024-01-02T00:00:00Z"),
    "steady_tension": ("steady operating points, second experiment", "2024-01-03T00:00:00Z"),
}

Sample = tuple[str, list[float], list[float] | None]


def samples(table: str, row: np.void) -> Iterator[Sample]:
    """Signal name, values and standard deviations that one row of a table gives, in SI."""
    yield "pressure", [P_ATM_PA - 1e3 * float(row["pressure_kpa"])], None
    if table == "open_loop_stiffness":
        force, sd = (float(row[k]) * PROBE_M for k in ("stiffness_mean_n_per_m", "stiffness_sd_n_per_m"))
        yield "shape", [0.0], None
        yield "probe", [PROBE_M, force], [0.0, sd]
    else:
        yield "shape", [math.radians(float(row["theta_deg"]))], None
        yield "tendons", [float(row["force_mean_n"]), 0.0], [float(row["force_sd_n"]), 0.0]


def make(folder: Path) -> list[Path]:
    """Write every log into `folder`; returns their paths."""
    made = []
    for table, (experiment, start_utc) in LOGS.items():
        source = OCTROBOT / f"{table}.csv"
        rows = np.genfromtxt(source, delimiter=",", names=True)
        start_ns = int(datetime.fromisoformat(start_utc).astimezone(UTC).timestamp()) * 1_000_000_000
        metadata = {
            "run_id": table,
            "robot_id": "OctRobot-I",
            "experiment": experiment,
            "p_atm_pa": str(P_ATM_PA),
            "start_utc": start_utc,
            "software_version": "make_octrobot_logs 1",
            "source": SOURCE,
            "stamps": "place in the table, one second a row; not times of measurement",
            "assumed": f"p_atm_pa; probe displacement {PROBE_M} m",
            "table": source.name,
            "table_sha256": hashlib.sha256(source.read_bytes()).hexdigest(),
        }
        path = folder / f"{table}.mcap"
        with Writer(path, metadata, library="ljjax") as log:
            for i, row in enumerate(rows):
                for signal, value, sd in samples(table, row):
                    log.write(signal, start_ns + i * 1_000_000_000, value, sd=sd)
        made.append(path)
    return made


if __name__ == "__main__":
    for path in make(Path(sys.argv[1]) if len(sys.argv) > 1 else OCTROBOT):
        print(path)
