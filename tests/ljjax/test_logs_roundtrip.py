"""What the writer writes, our reader, mcap_ros2 and rosbags read; and it survives a crash."""

from __future__ import annotations

import math
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ljjax.errors import InputError
from ljjax.logs import Run, Signal, Writer, copy_overlay, read, read_all, read_attachment

T0 = 1_772_530_837_000_000_000
META = {
    "run_id": "7",
    "robot_id": "octrobot-1",
    "experiment": "bend",
    "p_atm_pa": "101325",
    "start_utc": "2026-03-03T09:40:37Z",
}
SIZES = {
    "cmd_tendons": 2,
    "tendons": 4,
    "cmd_pressure": 1,
    "pressure": 1,
    "shape": 6,
    "tip": 7,
    "probe": 2,
    "temperature": 1,
}
N = 40


def sample(signal: str, i: int) -> list[float]:
    scale = 6e3 if "pressure" in signal else 0.1 if signal == "shape" else 1.0
    return [scale * (math.sin(0.1 * i + j) + 2 + len(signal)) for j in range(SIZES[signal])]


def write_all(path: Path) -> None:
    with Writer(path, META) as log:
        for i in range(N):
            for signal in SIZES:
                sd = [0.01 * (j + 1 + i) for j in range(SIZES[signal])]
                log.write(signal, T0 + i * 5_000_001, sample(signal, i), sd=sd, log_ns=T0 + i * 5_000_001 + 700 + i,
                          publish_ns=T0 + i * 5_000_001 + 300 + i)  # fmt: skip
            log.write_diagnostics(T0 + i * 5_000_001, [(0, "loop", "fine", {"loop_time_us": str(i)})])
        log.attach("law.npz", b"the law", "application/x-npz")


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("logs") / "run.mcap"
    write_all(path)
    return path.read_bytes()


@pytest.fixture
def path(tmp_path: Path, written: bytes) -> Path:
    (tmp_path / "run.mcap").write_bytes(written)
    return tmp_path / "run.mcap"


EXPECTED = {
    "cmd_tendons": ("cmd_tendons", slice(0, 2), ("tendon_left", "tendon_right"), "N"),
    "tendons": ("tendons", slice(0, 2), ("tendon_left", "tendon_right"), "N"),
    "spool": ("tendons", slice(2, 4), ("tendon_left", "tendon_right"), "m"),
    "cmd_pressure": ("cmd_pressure", slice(0, 1), ("pressure",), "Pa"),
    "pressure": ("pressure", slice(0, 1), ("pressure",), "Pa"),
    "shape": ("shape", slice(0, 6), ("q1", "q2", "q3", "q4", "q5", "q6"), "rad"),
    "tip": ("tip", slice(0, 7), ("x", "y", "z", "qx", "qy", "qz", "qw"), "m,m,m,1,1,1,1"),
    "probe": ("probe", slice(0, 2), ("position", "force"), "m,N"),
    "temperature": ("temperature", slice(0, 1), ("temperature",), "degC"),
}


@pytest.mark.parametrize("name", EXPECTED)
def test_every_signal_comes_back_exactly(path: Path, name: str):
    signal = read(path).signals[name]
    source, part, columns, unit = EXPECTED[name]
    np.testing.assert_array_equal(signal.value, [sample(source, i)[part] for i in range(N)])
    assert (signal.columns, signal.unit) == (columns, unit)
    np.testing.assert_array_equal(signal.t, [i * 5_000_001 / 1e9 for i in range(N)])
    assert signal.log_t is not None and signal.publish_t is not None and signal.sd is not None
    np.testing.assert_array_equal(signal.log_t, [(i * 5_000_001 + 700 + i) / 1e9 for i in range(N)])
    np.testing.assert_array_equal(signal.publish_t, [(i * 5_000_001 + 300 + i) / 1e9 for i in range(N)])
    sd = [[0.01 * (j + 1 + i) for j in range(SIZES[source])][part] for i in range(N)]
    np.testing.assert_allclose(signal.sd, sd, rtol=1e-15)


def test_run_and_its_metadata(path: Path):
    run = read(path)
    assert set(run.signals) == set(EXPECTED)
    assert (run.damage, run.notes, run.t0_ns) == (None, (), T0)
    assert {k: run.metadata[k] for k in META} == META
    assert run.metadata["contract_version"] == "1" and run.metadata["end_reason"] == "completed"
    assert read_attachment(path, "law.npz") == b"the law"
    with pytest.raises(InputError, match="law.npz"):
        read_attachment(path, "other")


def test_same_input_gives_the_same_bytes(path: Path, tmp_path: Path):
    write_all(tmp_path / "again.mcap")
    assert path.read_bytes() == (tmp_path / "again.mcap").read_bytes()


def test_mcap_ros2_reads_it(path: Path):
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    found: dict[str, list] = {}
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        assert reader.get_header().profile == "ros2"
        for schema, channel, message, msg in reader.iter_decoded_messages():
            assert schema is not None and schema.encoding == "ros2msg" and channel.message_encoding == "cdr"
            found.setdefault(channel.topic, []).append((message, msg))
    assert all(len(messages) == N for messages in found.values())
    assert {t for t in found if not t.endswith("/sd")} == {
        "/real/cmd/tendons", "/real/tendons", "/real/cmd/pressure", "/real/pressure", "/real/shape", "/real/tip/pose",
        "/real/probe", "/real/temperature", "/real/rig/diagnostics",
    }  # fmt: skip
    message, tendons = found["/real/tendons"][3]
    assert list(tendons.name) == ["tendon_left", "tendon_right"]
    assert list(tendons.effort) + list(tendons.position) == sample("tendons", 3)
    assert tendons.header.stamp.sec * 10**9 + tendons.header.stamp.nanosec == T0 + 3 * 5_000_001
    assert (message.log_time, message.publish_time) == (T0 + 15_000_706, T0 + 15_000_306)
    pose = found["/real/tip/pose"][3][1]
    p, q = pose.pose.position, pose.pose.orientation
    assert [p.x, p.y, p.z, q.x, q.y, q.z, q.w] == sample("tip", 3) and pose.header.frame_id == "base"
    assert found["/real/pressure"][3][1].variance == pytest.approx(0.04**2)
    status = found["/real/rig/diagnostics"][3][1].status[0]
    assert (status.name, status.values[0].key, status.values[0].value) == ("loop", "loop_time_us", "3")


def test_rosbags_reads_it(path: Path):
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    counts: dict[str, int] = {}
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as bag:
        for connection, t_ns, raw in bag.messages():
            i = counts.get(connection.topic, 0)
            counts[connection.topic] = i + 1
            msg: Any = bag.deserialize(raw, connection.msgtype)
            if connection.topic == "/real/shape":
                assert list(msg.position) == sample("shape", i) and t_ns == T0 + i * 5_000_001 + 700 + i
            if connection.topic == "/real/tip/pose":
                assert msg.pose.orientation.w == sample("tip", i)[6]
            if connection.topic == "/real/rig/diagnostics":
                assert msg.status[0].values[0].value == str(i)
    assert counts["/real/shape"] == counts["/real/tip/pose"] == counts["/real/rig/diagnostics"] == N


REFUSED = [
    ("shape", [0.1, math.nan], {}, "finite"),
    ("shape", [0.1, math.inf], {}, "finite"),
    ("tendons", [1.0, 2.0, 3.0], {}, "2 or 4"),
    ("cmd_tendons", [1.0], {}, "expected 2"),
    ("cmd_tendons", np.ones((1, 2)), {}, "expected 2"),
    ("shape", [0.1, 0.2], {"columns": ("q1", "q3")}, "q1"),
    ("shape", [0.1, 0.2], {"columns": ("q1",)}, "expected 1"),
    ("tendons", [1.0, 2.0], {"sd": [0.1, -0.1]}, "≥ 0"),
    ("tendons", [1.0, 2.0], {"sd": [0.1]}, "1 standard deviations for 2"),
    ("spool", [1.0, 2.0], {}, "goes with tendons"),
    ("bend", [1.0], {}, "no signal"),
    ("shape", [0.1], {"log_ns": 0}, "more than 0"),
]


@pytest.mark.parametrize(("signal", "value", "options", "said"), REFUSED)
def test_writer_refuses(tmp_path: Path, signal: str, value: Any, options: dict, said: str):
    with Writer(tmp_path / "run.mcap", META) as log, pytest.raises(InputError, match=said):
        log.write(signal, T0, value, **options)


@pytest.mark.parametrize(
    ("change", "said"),
    [({"robot_id": ""}, "robot_id"), ({"p_atm_pa": 101325}, "string"), ({"end_reason": "x"}, "own"),
     ({"contract_version": "2"}, "contract_version")],
)  # fmt: skip
def test_writer_refuses_metadata(tmp_path: Path, change: dict, said: str):
    with pytest.raises(InputError, match=said):
        Writer(tmp_path / "run.mcap", META | change)
    assert not (tmp_path / "run.mcap").exists()


def test_shape_keeps_its_columns(tmp_path: Path):
    with Writer(tmp_path / "run.mcap", META) as log:
        log.write("shape", T0, [0.1])
        with pytest.raises(InputError, match="earlier theta"):
            log.write("shape", T0, [0.1], columns=("q1",))
    assert read(tmp_path / "run.mcap").signals["shape"].columns == ("theta",)


def test_an_exception_ends_the_log_soundly(tmp_path: Path):
    with pytest.raises(ZeroDivisionError), Writer(tmp_path / "run.mcap", META) as log:
        log.write("shape", T0, [0.1])
        _ = 1 / 0
    run = read(tmp_path / "run.mcap")
    assert run.metadata["end_reason"] == "error: ZeroDivisionError: division by zero"
    assert run.damage is None and len(run.signals["shape"]) == 1


def test_a_killed_writer_leaves_what_it_wrote(tmp_path: Path):
    code = (
        "import os, sys\nfrom ljjax.logs import Writer\n"
        f"log = Writer(sys.argv[1], {META!r})\n"
        f"for i in range(1000): log.write('shape', {T0} + i * 10_000_000, [0.001 * i])\n"
        "os._exit(1)\n"
    )
    subprocess.run([sys.executable, "-c", code, str(tmp_path / "run.mcap")], check=False)
    run = read(tmp_path / "run.mcap")
    theta = run.signals["shape"].value[:, 0]
    np.testing.assert_array_equal(theta, 0.001 * np.arange(len(theta)))
    assert len(theta) >= 890  # of 10 s, at most the last second is lost
    assert run.damage is not None and any("cut short" in note for note in run.notes)
    assert run.robot_id == "octrobot-1"


def overlaid(path: Path, out: Path) -> Run:
    run = read(path)
    shape = run.signals["shape"]
    residual = Signal(shape.t, shape.value * 0.5, shape.columns, "rad", "")
    copy_overlay([run], out, [{"/sim": {"shape": shape, "tip": run.signals["tip"]}, "/residual": {"shape": residual}}])
    return run


def test_an_overlay_copies_the_measured_messages_unchanged(path: Path, tmp_path: Path):
    from mcap.reader import make_reader

    out = tmp_path / "result.mcap"
    run = overlaid(path, out)

    def raw(file: Path, beginning: str) -> list[tuple]:
        with file.open("rb") as stream:
            return [
                (c.topic, s.name, s.data, m.data, m.log_time, m.publish_time, m.sequence)
                for s, c, m in make_reader(stream).iter_messages(log_time_order=False)
                if s is not None and c.topic.startswith(beginning)
            ]

    assert sorted(raw(path, "/real/")) == sorted(raw(out, "/real/"))
    simulated = [("/real/shape", *rest) for _, *rest in raw(out, "/sim/shape")]
    assert simulated == [row for row in raw(path, "/real/shape") if row[0] == "/real/shape"]
    back = read(out, prefix="/residual")
    np.testing.assert_array_equal(back.signals["shape"].value, run.signals["shape"].value * 0.5)
    np.testing.assert_array_equal(back.signals["shape"].t, run.signals["shape"].t)
    assert read(out).metadata == run.metadata
    assert os.listdir(tmp_path).count("result.mcap") == 1 and not list(tmp_path.glob("*.part"))


def test_an_overlay_that_fails_leaves_nothing(path: Path, tmp_path: Path):
    run = read(path)
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(InputError, match="changed since"):
        copy_overlay([run], tmp_path / "result.mcap", [{}])
    assert sorted(os.listdir(tmp_path)) == ["run.mcap"]


def test_an_overlay_of_several_runs_is_no_log_of_one(path: Path, tmp_path: Path):
    run = read(path)
    copy_overlay([run, run], tmp_path / "result.mcap", [{}, {}])
    with pytest.raises(InputError, match="overlays 2 runs"):
        read(tmp_path / "result.mcap")


def test_runs_come_by_robot_and_start(tmp_path: Path):
    order = [
        ("b", "2026-01-01T00:00:00Z"),
        ("a", "2026-01-02T00:00:00.5+01:00"),
        ("a", "2026-01-01T23:00:01Z"),
        ("a", "2026-01-01"),
    ]
    for i, (robot, start) in enumerate(order):
        with Writer(tmp_path / f"{i}.mcap", META | {"robot_id": robot, "start_utc": start, "run_id": str(i)}) as log:
            log.write("shape", T0, [0.1])
    runs = read_all([tmp_path / f"{i}.mcap" for i in range(4)])
    assert [run.run_id for run in runs] == ["3", "1", "2", "0"]


def test_the_logs_part_never_loads_jax():
    code = (
        "import sys, ljjax.logs, ljjax.logs.info, ljjax.logs.mapped_signals, ljjax.logs.decode\n"
        "found = [m for m in ('jax', 'jaxlib', 'equinox', 'rosbags') if m in sys.modules]\n"
        "sys.exit(f'loaded {found}' if found else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
