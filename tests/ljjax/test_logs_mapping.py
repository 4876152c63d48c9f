"""Other people's logs through a mapping: encodings, clocks, units, and what is refused rather than guessed."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, timestamp_pb2
from mcap.writer import Writer as McapWriter

from ljjax.errors import InputError
from ljjax.logs import Writer, cdr, contract, load_mapping, read

T0 = 1_700_000_000_000_000_000
STEP = 20_000_000
LOG, PUBLISH = 5_000_000, 3_000_000  # how much later the other clocks are
HEAD = 'schema = "ljjax.mapping/1"\n[run]\nrobot_id = "borrowed"\np_atm_pa = 100000\n'


def ros(log: McapWriter) -> None:
    joints = log.register_schema(contract.JOINT_STATE, "ros2msg", contract.SCHEMAS[contract.JOINT_STATE].encode())
    gauge = log.register_schema("std_msgs/msg/Float64", "ros2msg", b"float64 data")
    dxl, bend = log.register_channel("/dxl", "cdr", joints), log.register_channel("/bend", "cdr", joints)
    dial = log.register_channel("/gauge", "cdr", gauge)
    for i in range(5):
        t = T0 + i * STEP
        data = cdr.joint_state(t, "", ("tendon_right", "tendon_left"), (1.0, 2.0), (), (20.0 * i, 10.0 * i))
        log.add_message(dxl, t + LOG, data, t + PUBLISH)
        log.add_message(bend, t + LOG, cdr.joint_state(t, "", ("a", "b"), (0.0, 9.0 * i)), t + PUBLISH)
        log.add_message(dial, t + LOG, b"\0\1\0\0" + np.float64(-4.0 * i).tobytes(), t + PUBLISH)


def as_json(log: McapWriter) -> None:
    schema = log.register_schema("state", "jsonschema", b"{}")
    ids = [log.register_channel("/state", "json", schema), log.register_channel("/bare", "json", 0)]
    for i in range(5):
        t = T0 + i * STEP
        stamp = {"sec": t // 10**9, "nsec": t % 10**9}
        value = {
            "timestamp": stamp,
            "angles": [{"name": "left", "deg": 9.0 * i}, {"name": "right", "deg": -1}],
            "gauge": {"kpa": 4 * i},
        }
        for channel in ids:
            log.add_message(channel, t + LOG, json.dumps(value).encode(), t + PUBLISH)


def as_protobuf(log: McapWriter) -> None:
    file = descriptor_pb2.FileDescriptorProto(name="rig.proto", package="rig", syntax="proto3",
                                              dependency=["google/protobuf/timestamp.proto"])  # fmt: skip
    message = file.message_type.add(name="State")
    kind = descriptor_pb2.FieldDescriptorProto
    message.field.add(name="timestamp", number=1, type=kind.TYPE_MESSAGE, label=kind.LABEL_OPTIONAL,
                      type_name=".google.protobuf.Timestamp")  # fmt: skip
    message.field.add(name="angle", number=2, type=kind.TYPE_DOUBLE, label=kind.LABEL_REPEATED)
    stamp_file = descriptor_pb2.FileDescriptorProto()
    timestamp_pb2.DESCRIPTOR.CopyToProto(stamp_file)
    pool = descriptor_pool.DescriptorPool()
    pool.Add(stamp_file)
    pool.Add(file)
    state = message_factory.GetMessageClass(pool.FindMessageTypeByName("rig.State"))
    files = descriptor_pb2.FileDescriptorSet(file=[stamp_file, file])
    schema = log.register_schema("rig.State", "protobuf", files.SerializeToString())
    channel = log.register_channel("/state", "protobuf", schema)
    for i in range(5):
        t = T0 + i * STEP
        data = state(timestamp={"seconds": t // 10**9, "nanos": t % 10**9}, angle=[0.0, 9.0 * i])
        log.add_message(channel, t + LOG, data.SerializeToString(), t + PUBLISH)


@pytest.fixture
def log(tmp_path: Path, request: pytest.FixtureRequest) -> Path:
    with (tmp_path / "theirs.mcap").open("wb") as stream:
        writer = McapWriter(stream)
        writer.start()
        request.param(writer)
        writer.finish()
    return tmp_path / "theirs.mcap"


def through(log: Path, text: str):
    path = log.with_name("m.toml")
    path.write_text(text)
    return read(log, path)


def signal(name: str, **entries: object) -> str:
    return f"[signals.{name}]\n" + "".join(f"{k} = {json.dumps(v)}\n" for k, v in entries.items())


DEGREES = np.deg2rad(9.0 * np.arange(5))
ANGLES = {
    "ros": (ros, {"topic": "/bend", "path": "position[name=b]"}),
    "ros index": (ros, {"topic": "/bend", "path": "position[1]"}),
    "json": (as_json, {"topic": "/state", "path": "angles[name=left].deg"}),
    "json index": (as_json, {"topic": "/state", "path": "angles[0].deg"}),
    "json without schema": (as_json, {"topic": "/bare", "path": "angles[name=left].deg"}),
    "protobuf": (as_protobuf, {"topic": "/state", "path": "angle[1]"}),
}


@pytest.mark.parametrize("time", ["header", "log", "publish"])
@pytest.mark.parametrize(("log", "entry"), ANGLES.values(), ids=ANGLES, indirect=["log"])
def test_each_encoding_and_each_clock(log: Path, entry: dict, time: str):
    run = through(log, HEAD + signal("theta", **entry, unit="deg", time=time))
    s = run.signals["shape"]
    np.testing.assert_allclose(s.value[:, 0], DEGREES, rtol=1e-15)
    assert (s.columns, s.unit, s.topic) == (("theta",), "rad", entry["topic"])
    assert run.t0_ns == T0 + {"header": 0, "log": LOG, "publish": PUBLISH}[time]
    assert s.log_t is not None and s.publish_t is not None
    np.testing.assert_allclose(s.log_t - s.publish_t, (LOG - PUBLISH) / 1e9, atol=1e-9)


@pytest.mark.parametrize(
    ("reference", "sign", "expected"),
    [("vacuum", -1, 100e3 - 4e3 * np.arange(5)), ("gauge", 1, 100e3 - 4e3 * np.arange(5)),
     ("absolute", -1, 4e3 * np.arange(5)),
     ("vacuum", 1, 100e3 + 4e3 * np.arange(5))],
)  # fmt: skip
@pytest.mark.parametrize("log", [ros], indirect=True)
def test_pressures_by_their_reference(log: Path, reference: str, sign: int, expected: np.ndarray):
    text = signal("pressure", topic="/gauge", path="data", unit="kPa", reference=reference, sign=sign, time="log")
    run = through(log, HEAD + text)
    np.testing.assert_allclose(run.signals["pressure"].value[:, 0], expected)
    assert run.signals["pressure"].unit == "Pa" and run.robot_id == "borrowed" and run.p_atm_pa == 1e5


UNITS = [
    ("theta", "deg", 180.0, np.pi), ("theta", "mrad", 1.0, 1e-3), ("probe_position", "mm", 5.0, 5e-3),
    ("probe_position", "cm", 5.0, 0.05),
    ("probe_force", "kgf", 2.0, 19.6133), ("probe_force", "gf", 2.0, 0.0196133), ("probe_force", "mN", 2.0, 2e-3),
    ("pressure", "hPa", 900.0, 9e4), ("pressure", "bar", 0.9, 9e4), ("pressure", "mbar", 900.0, 9e4),
    ("pressure", "psi", 14.5, 99973.98),
    ("pressure", "mmHg", 700.0, 93325.67), ("temperature", "K", 300.0, 26.85), ("temperature", "degC", 20.0, 20.0),
    ("q1", "rad", 2.0, 2.0),
]  # fmt: skip


@pytest.mark.parametrize(("name", "unit", "raw", "si"), UNITS)
def test_units(tmp_path: Path, name: str, unit: str, raw: float, si: float):
    extra = {"reference": "absolute"} if name == "pressure" else {}
    text = HEAD + signal(name, topic="/a", path="x", unit=unit, **extra)
    for partner in {"probe_position": ["probe_force"], "probe_force": ["probe_position"]}.get(name, []):
        text += signal(partner, topic="/a", path="x", unit="m" if partner.endswith("position") else "N")
    (tmp_path / "m.toml").write_text(text)
    assert load_mapping(tmp_path / "m.toml").sources[name].si(raw) == pytest.approx(si, rel=1e-6)


@pytest.mark.parametrize("log", [ros], indirect=True)
def test_scale_offset_and_sign_of_a_motor_current(log: Path):
    """sign · (scale · raw + offset), scale in N per mA."""
    both = {"topic": "/dxl", "unit": "mA", "scale": 0.01, "sign": -1}
    text = HEAD + signal("cmd_tendon_left", path="effort[name=tendon_left]", offset=-2.0, **both)
    text += signal("cmd_tendon_right", path="effort[name=tendon_right]", **both)
    s = through(log, text).signals["cmd_tendons"]
    i = np.arange(5)
    np.testing.assert_allclose(s.value, np.stack([2 - 0.1 * i, -0.2 * i], axis=1))
    assert s.columns == contract.TENDONS and s.unit == "N" and s.topic == "/dxl"


@pytest.mark.parametrize("log", [ros], indirect=True)
def test_columns_with_their_own_stamps_are_held(log: Path):
    text = HEAD + signal("tendon_left", topic="/dxl", path="effort[name=tendon_left]", unit="N")
    text += signal("tendon_right", topic="/gauge", path="data", unit="N", time="publish")
    run = through(log, text)
    s = run.signals["tendons"]
    ms = np.arange(5) * 20
    np.testing.assert_allclose(s.t * 1e3, np.sort(np.concatenate([ms + 3, ms[1:] + 20 - 20])) - 3, atol=1e-6)
    np.testing.assert_allclose(s.value[:, 0], [0, 10, 10, 20, 20, 30, 30, 40, 40])
    np.testing.assert_allclose(s.value[:, 1], [0, 0, -4, -4, -8, -8, -12, -12, -16])
    assert any("held" in note for note in run.notes)


THETA = {"topic": "/bend", "path": "position[1]", "unit": "deg"}
PRESSURE = {"topic": "/gauge", "path": "data", "unit": "kPa", "time": "log", "reference": "vacuum"}
BAD = {
    "no unit": (
        signal("theta", topic="/bend", path="position[1]"),
        "line 5: .signals.theta. unit: is missing",
    ),
    "unknown unit": (
        signal("theta", **THETA | {"unit": "degrees"}),
        "line 8: .signals.theta. unit: unknown unit 'degrees'",
    ),
    "no reference": (
        signal("pressure", topic="/gauge", path="data", unit="kPa"),
        "reference: is missing.*not guessed",
    ),
    "bad reference": (signal("pressure", **PRESSURE | {"reference": "relative"}), "reference: is 'relative'"),
    "reference of an angle": (signal("theta", **THETA, reference="gauge"), "only a pressure"),
    "raw unit without scale": (signal("theta", **THETA | {"unit": "counts"}), "scale: is missing; counts"),
    "unit of another quantity": (
        signal("theta", **THETA | {"unit": "kPa"}),
        "scale: is missing; kPa is no unit of angle",
    ),
    "unknown key": (signal("theta", **THETA, gain=2), "line 9: .signals.theta. gain: unknown key"),
    "unknown signal": (signal("bend", **THETA), "line 5: .signals.bend.: unknown signal"),
    "unknown run key": ("[run2]\n", "run2: unknown key"),
    "no topic": (signal("theta", path="data", unit="deg"), "topic: is missing"),
    "sign": (signal("theta", **THETA, sign=2), "sign: is 2"),
    "scale 0": (signal("theta", **THETA, scale=0), "scale: is 0"),
    "scale as text": (signal("theta", **THETA, scale="2"), "scale: is '2'"),
    "clock": (signal("theta", **THETA, time="arrival"), "time: is 'arrival'"),
    "path": (signal("theta", **THETA | {"path": "position[name="}), "path: .* cannot be read"),
    "half a pair": (signal("tendon_left", **THETA | {"unit": "N"}), "goes together with tendon_right"),
    "gap in segments": (signal("q1", **THETA) + signal("q3", **THETA), "without a gap"),
    "theta and q1": (signal("q1", **THETA) + signal("theta", **THETA), "not both"),
    "no TOML": ("= 3", "not TOML"),
    "no such joint": (signal("theta", **THETA | {"path": "position[name=c]"}), "'c' 0 times in name"),
    "no such field": (signal("theta", **THETA | {"path": "angle"}), "has no angle"),
    "no such index": (signal("theta", **THETA | {"path": "position[2]"}), "no item 2"),
    "no number": (signal("theta", **THETA | {"path": "header"}), "where a number is expected"),
    "no header": (
        signal("theta", topic="/gauge", path="data", unit="deg"),
        'no header.stamp; say time = "log"',
    ),
    "no such topic": (signal("theta", **THETA | {"topic": "/bnd"}), "none of the topics.*/bend"),
}


@pytest.mark.parametrize("case", BAD)
@pytest.mark.parametrize("log", [ros], indirect=True)
def test_refused_with_key_and_line(log: Path, case: str):
    text, said = BAD[case]
    with pytest.raises(InputError, match=said) as caught:
        through(log, HEAD + text)
    assert "m.toml" in str(caught.value)


@pytest.mark.parametrize("log", [ros], indirect=True)
def test_a_relative_pressure_needs_the_atmosphere(log: Path):
    with pytest.raises(InputError, match="p_atm_pa = 101325"):
        through(log, HEAD.replace("p_atm_pa = 100000\n", "") + signal("pressure", **PRESSURE))
    for bad in ("100", "true", '"high"'):
        with pytest.raises(InputError, match="p_atm_pa"):
            through(log, HEAD.replace("100000", bad) + signal("pressure", **PRESSURE))


@pytest.mark.parametrize("log", [ros], indirect=True)
def test_another_version_and_a_missing_file(log: Path):
    with pytest.raises(InputError, match="expected 'ljjax.mapping/1'"):
        through(log, HEAD.replace("mapping/1", "mapping/2") + signal("theta", **THETA))
    with pytest.raises(InputError, match="no such file; give a mapping file"):
        read(log, log.with_name("none.toml"))


def test_the_example_is_a_mapping():
    path = Path(__file__).parents[2] / "examples" / "mapping.toml"
    assert {"cmd_tendon_left", "pressure", "theta"} <= set(load_mapping(path).sources)


def written(path: Path, signal: str, values: list[list[float]]) -> None:
    """A log of the contract with one signal."""
    meta = {"run_id": "1", "robot_id": "r", "experiment": "e", "p_atm_pa": "1e5", "start_utc": "2026-01-01T00:00:00Z"}
    with Writer(path, meta) as log:
        for i, value in enumerate(values):
            log.write(signal, 10**18 + i, value)


def test_a_mapping_without_signals_states_metadata_for_a_contract_log(tmp_path: Path):
    """A log cut short has lost its metadata; its topics are the contract's all the same."""
    path = tmp_path / "run.mcap"
    written(path, "pressure", [[9e4]])
    stated = tmp_path / "m.toml"
    stated.write_text('schema = "ljjax.mapping/1"\n[run]\np_atm_pa = "101000"\n', encoding="utf-8")
    run = read(path, stated)
    assert (run.p_atm_pa, run.robot_id, run.vacuum_kpa("pressure").value[0, 0]) == (101000.0, "r", 11.0)
    stated.write_text('schema = "ljjax.mapping/1"\n', encoding="utf-8")
    with pytest.raises(InputError, match="signals: is empty"):
        read(path, stated)


DOUBTS = {
    "angles in degrees": ("shape", [[2.0], [15.0]], "degrees"),
    "vacuum in kPa": ("pressure", [[0.0], [40.0]], "no absolute pressure"),
    "gauge turned round": ("pressure", [[1.0e5], [1.4e5]], "above the atmosphere"),
    "a tendon that pushes": ("cmd_tendons", [[1.0, 0.0], [-5.0, 0.0]], "only pull"),
}


@pytest.mark.parametrize("case", DOUBTS)
def test_values_that_cannot_be_in_the_contracts_units_are_doubted(tmp_path: Path, case: str):
    signal, values, said = DOUBTS[case]
    path = tmp_path / "run.mcap"
    written(path, signal, values)
    run = read(path)
    assert any(said in doubt for doubt in run.doubts) and set(run.doubts) <= set(run.notes)
    with pytest.raises(InputError, match=said):
        run.trusted()
