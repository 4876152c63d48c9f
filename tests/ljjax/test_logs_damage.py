"""Damaged logs: the good part is read and the damage is said; nothing is ever altered in silence."""

from __future__ import annotations

import math
import random
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter

from ljjax.errors import InputError
from ljjax.logs import Run, Writer, cdr, contract, read, read_attachment

T0 = 1_772_530_837_000_000_000
META = {
    "run_id": "7",
    "robot_id": "octrobot-1",
    "experiment": "bend",
    "p_atm_pa": "101325",
    "start_utc": "2026-03-03T09:40:37Z",
}
N = 60
STEP = 100_000_000
NOT_CHECKED = "metadata ljjax.run has no checksum"


def ours(path: Path) -> None:
    with Writer(path, META) as log:
        for i in range(N):
            log.write("cmd_tendons", T0 + i * STEP, [1.0 + 0.1 * i, 0.5])
            log.write("pressure", T0 + i * STEP, [9e4 - 10 * i], sd=[30 + i])
            log.write("shape", T0 + i * STEP, [0.01 * i, 0.02 * i], sd=[0.001, 0.002])
        log.attach("law.npz", bytes(range(256)))


def theirs(path: Path, end: bool = True, **options: object) -> None:
    """The same run by the mcap library alone, as another program would write it."""
    with path.open("wb") as stream:
        log = McapWriter(stream, **options)  # type: ignore[arg-type]
        log.start(profile="ros2", library="theirs")
        ids = {}
        for topic, kind in (("/real/cmd/tendons", contract.JOINT_STATE), ("/real/pressure", contract.FLUID_PRESSURE),
                            ("/real/shape", contract.JOINT_STATE)):  # fmt: skip
            schema = log.register_schema(kind, "ros2msg", contract.SCHEMAS[kind].encode())
            ids[topic] = log.register_channel(topic, "cdr", schema)
        log.add_metadata(contract.RUN_RECORD, META | {"contract_version": "1", "law_sha256": "", "software_version": ""}
                         | ({"end_reason": "completed"} if end else {}))  # fmt: skip
        for i in range(N):
            t = T0 + i * STEP
            for topic, data in (
                ("/real/cmd/tendons", cdr.joint_state(t, "", contract.TENDONS, (), (), (1.0 + 0.1 * i, 0.5))),
                ("/real/pressure", cdr.scalars(t, "", (9e4 - 10 * i, 0.0))),
                ("/real/shape", cdr.joint_state(t, "", ("q2", "q1"), (0.02 * i, 0.01 * i))),
            ):
                log.add_message(ids[topic], t, data, t, i)
        log.finish()


SMALL: Any = {"chunk_size": 4000}
KINDS: dict[str, Callable[[Path], None]] = {
    "ours": ours,
    "zstd": lambda path: theirs(path, **SMALL),
    "lz4": lambda path: theirs(path, compression=CompressionType.LZ4, **SMALL),
    "plain": lambda path: theirs(path, compression=CompressionType.NONE, **SMALL),
    "unchunked": lambda path: theirs(path, use_chunking=False, enable_data_crcs=True),
    "chunks without checksum": lambda path: theirs(path, enable_crcs=False, enable_data_crcs=True, **SMALL),
}


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[bytes, Run]]:
    folder = tmp_path_factory.mktemp("logs")
    found = {}
    for name, write in KINDS.items():
        write(folder / "run.mcap")
        found[name] = (folder / "run.mcap").read_bytes(), read(folder / "run.mcap")
    return found


def difference(part: Run, whole: Run, prefix: bool) -> str:
    """What differs between two readings; empty where `part` is all of `whole`, or the beginning of it."""
    if not prefix and set(part.signals) != set(whole.signals):
        return "the signals"
    for name, s in part.signals.items():
        ref = whole.signals.get(name)
        if ref is None or (s.columns, s.unit, s.topic) != (ref.columns, ref.unit, ref.topic):
            return f"what {name} is"
        if len(s) > len(ref) or (not prefix and len(s) != len(ref)):
            return f"the length of {name}"
        shift = (part.t0_ns - whole.t0_ns) / 1e9
        for field, offset in (("value", 0), ("sd", 0), ("t", shift), ("log_t", shift), ("publish_t", shift)):
            mine, its = getattr(s, field), getattr(ref, field)
            if (mine is None) != (its is None):
                return f"whether {name} has {field}"
            if mine is not None and not np.array_equal(mine + offset, its[: len(s)]):
                return f"{field} of {name}"
    return ""


@pytest.mark.parametrize("kind", KINDS)
def test_undamaged(logs: dict[str, tuple[bytes, Run]], kind: str):
    run = logs[kind][1]
    assert run.damage is None
    np.testing.assert_array_equal(run.signals["shape"].value, [[0.01 * i, 0.02 * i] for i in range(N)])
    np.testing.assert_array_equal(run.signals["cmd_tendons"].value, [[1.0 + 0.1 * i, 0.5] for i in range(N)])
    assert (NOT_CHECKED in run.notes) == (kind in ("zstd", "lz4", "plain"))
    assert dict(run.metadata) | META == dict(run.metadata)


@pytest.mark.parametrize(("kind", "times"), [(kind, 100 if kind == "ours" else 40) for kind in KINDS])
def test_a_cut_log_gives_its_beginning(logs: dict[str, tuple[bytes, Run]], tmp_path: Path, kind: str, times: int):
    raw, whole = logs[kind]
    rng = random.Random(times)
    longest = 0
    for _ in range(times):
        size = rng.randrange(len(raw))
        (tmp_path / "cut.mcap").write_bytes(raw[:size])
        try:
            run = read(tmp_path / "cut.mcap")
        except InputError as error:
            assert "cut.mcap" in str(error) and size < len(raw) / 2, f"{size} of {len(raw)} bytes: {error}"
            continue
        assert run.damage is not None and f"of {size}" in run.damage.where
        assert difference(run, whole, prefix=True) == "", f"cut at {size}"
        assert all(whole.metadata[k] == v for k, v in run.metadata.items())
        longest = max(longest, *map(len, run.signals.values()))
    assert longest > 0.8 * N


@pytest.mark.parametrize(("kind", "times"), [(kind, 300 if kind == "ours" else 120) for kind in KINDS])
def test_a_flipped_bit_never_alters_data_in_silence(
    logs: dict[str, tuple[bytes, Run]], tmp_path: Path, kind: str, times: int
):
    raw, whole = logs[kind]
    rng = random.Random(1000 + times)
    partly = 0
    for _ in range(times):
        at, bit = rng.randrange(len(raw)), rng.randrange(8)
        altered = bytearray(raw)
        altered[at] ^= 1 << bit
        (tmp_path / "flip.mcap").write_bytes(altered)
        try:
            run = read(tmp_path / "flip.mcap")
        except InputError as error:
            assert "flip.mcap" in str(error)
            continue
        place = f"bit {bit} of byte {at}"
        if run.damage is None:
            assert difference(run, whole, prefix=False) == "", place
            assert run.metadata == whole.metadata or NOT_CHECKED in run.notes, place
        elif kind != "chunks without checksum":
            assert difference(run, whole, prefix=True) == "", place
            partly += len(run.signals["shape"]) < N
    assert partly or kind in ("unchunked", "chunks without checksum")


def test_scribbled_bytes_never_break_the_reader(logs: dict[str, tuple[bytes, Run]], tmp_path: Path):
    raw, whole = logs["ours"]
    rng = random.Random(5)
    for _ in range(60):
        altered = bytearray(raw)
        start = rng.randrange(8, len(raw))
        for i in range(start, min(len(raw), start + rng.randrange(1, 60))):
            altered[i] = rng.choice((0, 255, rng.randrange(256)))
        (tmp_path / "bad.mcap").write_bytes(altered)
        try:
            run = read(tmp_path / "bad.mcap")
        except InputError:
            continue
        assert difference(run, whole, prefix=True) == "" and (run.damage or altered == raw)


def test_absurd_lengths_take_no_memory(logs: dict[str, tuple[bytes, Run]], tmp_path: Path):
    import resource

    raw = logs["ours"][0]
    chunk = raw.index(b"zstd") - 41
    assert raw[chunk] == 6
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for place in (
        chunk + 1,
        chunk + 25,
        chunk + 45,
    ):  # of the record, of the content unpacked, of the content packed
        for size in (2**63, 2**40, 2**31):
            altered = raw[:place] + struct.pack("<Q", size) + raw[place + 8 :]
            (tmp_path / "big.mcap").write_bytes(altered)
            with pytest.raises(InputError, match="no usable signal"):
                read(tmp_path / "big.mcap")
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 300_000  # kB


@pytest.mark.parametrize(
    ("content", "said"),
    [(b"", "not an MCAP file"), (b"hello, world", "not an MCAP file"), (b"\x89MCAP0\r\n", "no usable signal"),
     (b"\x89MCAP0\r\n" + b"\x01" + b"\xff" * 40, "no usable signal")],
)  # fmt: skip
def test_what_is_no_log(tmp_path: Path, content: bytes, said: str):
    (tmp_path / "x.mcap").write_bytes(content)
    with pytest.raises(InputError, match=said):
        read(tmp_path / "x.mcap")


def test_a_missing_file_and_a_folder(tmp_path: Path):
    for path in (tmp_path / "none.mcap", tmp_path):
        with pytest.raises(InputError, match=str(path)):
            read(path)


def test_a_file_without_any_checksum_says_so(tmp_path: Path):
    theirs(tmp_path / "x.mcap", use_chunking=False)
    run = read(tmp_path / "x.mcap")
    assert run.damage is None and any("no checksums: silent damage cannot be excluded" in note for note in run.notes)


def test_an_unchunked_file_with_one_wrong_bit_is_refused(logs: dict[str, tuple[bytes, Run]], tmp_path: Path):
    raw = logs["unchunked"][0]
    at = raw.index(struct.pack("<d", 0.02 * 7))
    (tmp_path / "x.mcap").write_bytes(raw[: at + 3] + bytes([raw[at + 3] ^ 4]) + raw[at + 4 :])
    with pytest.raises(InputError, match="no sample can be trusted"):
        read(tmp_path / "x.mcap")


def test_metadata_after_a_damaged_chunk_is_found(logs: dict[str, tuple[bytes, Run]], tmp_path: Path):
    raw, whole = logs["ours"]
    at = raw.rindex(b"zstd", 0, raw.index(b"law.npz")) + 40
    (tmp_path / "x.mcap").write_bytes(raw[:at] + bytes([raw[at] ^ 1]) + raw[at + 1 :])
    run = read(tmp_path / "x.mcap")
    assert run.damage is not None and "chunk" in run.damage.why and "t = " in run.damage.where
    assert run.metadata == whole.metadata and 0 < len(run.signals["shape"]) < N


def test_metadata_vouches_for_itself(logs: dict[str, tuple[bytes, Run]], tmp_path: Path):
    """Even where someone has put the checksum of the data section right again."""
    raw = logs["ours"][0]
    at = raw.rindex(b"101325")
    altered = bytearray(raw[:at] + b"101425" + raw[at + 6 :])
    end = altered.rindex(b"\x0f" + struct.pack("<Q", 4), 0, altered.rindex(contract.JOINT_STATE.encode()))
    altered[end + 9 : end + 13] = struct.pack("<I", zlib.crc32(altered[:end]))
    (tmp_path / "x.mcap").write_bytes(altered)
    run = read(tmp_path / "x.mcap")
    assert run.damage is not None and "sha256" in run.damage.why and run.p_atm_pa == 101325


def test_a_log_without_end_reason_was_cut_short(tmp_path: Path):
    theirs(tmp_path / "x.mcap", end=False)
    assert any("cut short" in note for note in read(tmp_path / "x.mcap").notes)


def test_a_lost_chunk_is_noticed(logs: dict[str, tuple[bytes, Run]], tmp_path: Path):
    """A whole chunk taken out leaves every other checksum right; the counts at the end tell."""
    raw = logs["plain"][0]
    starts = []
    at = 8
    while raw[at] != 15:
        if raw[at] == 6:
            starts.append(at)
        at += 9 + struct.unpack_from("<Q", raw, at + 1)[0]
    (tmp_path / "x.mcap").write_bytes(raw[: starts[1]] + raw[starts[2] :])
    run = read(tmp_path / "x.mcap")
    assert run.damage is not None


def one(path: Path, rows: list[tuple], schema: str | None = None, metadata: dict | None = None) -> None:
    """A log of (topic, kind, message bytes, log time); `schema` replaces the text of every schema."""
    with path.open("wb") as stream:
        log = McapWriter(stream)
        log.start("ros2")
        ids: dict[str, int] = {}
        for topic, kind, data, t in rows:
            if topic not in ids:
                text = contract.SCHEMAS.get(kind, "float64 x") if schema is None else schema
                ids[topic] = log.register_channel(topic, "cdr", log.register_schema(kind, "ros2msg", text.encode()))
            log.add_message(ids[topic], t, data, t)
        log.add_metadata(contract.RUN_RECORD, {"contract_version": "1"} if metadata is None else metadata)
        log.finish()


def shape(i: int, **change: object) -> tuple:
    fields = {
        "t_ns": T0 + i * STEP,
        "frame_id": "base",
        "name": ("q1", "q2"),
        "position": (0.1 * i, 0.2 * i),
    } | change
    return "/real/shape", contract.JOINT_STATE, cdr.joint_state(**fields), T0 + i * STEP  # type: ignore[arg-type]


def test_a_broken_schema_elsewhere_does_no_harm(tmp_path: Path):
    path = tmp_path / "x.mcap"
    with path.open("wb") as stream:
        log = McapWriter(stream)
        log.start("ros2")
        bad = log.register_channel(
            "/camera", "cdr", log.register_schema("a/msg/B", "ros2msg", b"\xff\xfe Foo[[ bar\n====\n")
        )
        none = log.register_channel("/other", "cdr", 99)
        good = log.register_channel(
            "/real/shape",
            "cdr",
            log.register_schema(contract.JOINT_STATE, "ros2msg", contract.SCHEMAS[contract.JOINT_STATE].encode()),
        )
        for i in range(3):
            log.add_message(bad, T0 + i, b"\0", T0 + i)
            log.add_message(none, T0 + i, b"", T0 + i)
            log.add_message(good, T0 + i, shape(i)[2], T0 + i)
        log.finish()
    run = read(path)
    assert run.damage is None and len(run.signals["shape"]) == 3


REFUSED: dict[str, tuple[list[tuple], str | None, dict | None, str]] = {
    "NaN": ([shape(0), shape(1, position=(0.1, math.nan))], None, None, "/real/shape.*sample 1.*q2 is nan"),
    "inf": ([shape(0, position=(math.inf, 0.0))], None, None, "/real/shape.*sample 0.*inf"),
    "zero stamps": ([shape(0, t_ns=0), shape(1, t_ns=0)], None, None, 'stamp is 0.*time = "log"'),
    "gap in segments": ([shape(0, name=("q1", "q3"))], None, None, "without a gap"),
    "joints change": ([shape(0), shape(1, name=("q1", "q9"))], None, None, "without a gap|expected each"),
    "too few values": ([shape(0, position=(0.1,))], None, None, "1 values of position for 2 names"),
    "another contract": ([shape(0)], None, {"contract_version": "2"}, "contract_version is '2'"),
    "no version": ([shape(0)], None, {"robot_id": "a"}, "contract_version is none"),
    "broken schema": ([shape(0)], "std_msgs/Header header\nFoo[[ bar", None, "/real/shape"),
    "another message": ([shape(0)], "float64 x\nfloat64 y", None, "/real/shape.*mapping"),
    "wrong "
    "type": ([("/real/shape", contract.TEMPERATURE, b"\0\1\0\0", T0)], None, None, "expected sensor_msgs/msg/Joint"),
    "cut message": ([(*shape(0)[:2], shape(0)[2][:-9], T0)], None, None, "message 0 .* is no sensor_msgs"),
    "left-over bytes": ([(*shape(0)[:2], shape(0)[2] + bytes(16), T0)], None, None, "left over"),
    "no topic of "
    "ours": ([("/joint_states", *shape(0)[1:])], None, None, "no usable signal.*/joint_states.*mapping"),
    "negative "
    "variance": ([("/real/pressure", contract.FLUID_PRESSURE, cdr.scalars(T0, "", (9e4, -1.0)), T0)], None, None,
                          "variance -1"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_refused_with_the_place(tmp_path: Path, case: str):
    rows, schema, metadata, said = REFUSED[case]
    one(tmp_path / "x.mcap", rows, schema, metadata)
    with pytest.raises(InputError, match=said) as caught:
        read(tmp_path / "x.mcap")
    assert "x.mcap" in str(caught.value) and "\n" not in str(caught.value)


def test_joints_in_any_order_and_among_others(tmp_path: Path):
    rows = [shape(0), shape(1, name=("gripper", "q2", "q1"), position=(9.0, 0.2, 0.1)), shape(2)]
    one(tmp_path / "x.mcap", rows)
    np.testing.assert_allclose(read(tmp_path / "x.mcap").signals["shape"].value, [[0, 0], [0.1, 0.2], [0.2, 0.4]])


def test_stamps_out_of_order_are_sorted_and_twins_kept(tmp_path: Path):
    one(tmp_path / "x.mcap", [shape(0), shape(2), shape(1), shape(2, position=(7.0, 8.0))])
    run = read(tmp_path / "x.mcap")
    np.testing.assert_allclose(run.signals["shape"].value[:, 0], [0, 0.1, 0.2, 7])
    assert any("go back in time" in note for note in run.notes) and any(
        "same as the one before" in n for n in run.notes
    )


def test_big_endian_and_commented_schemas_read_alike(tmp_path: Path):
    data = b"\x00\x00\x00\x00" + struct.pack(">iII", 5, 6, 1) + b"\0\0\0\0" + struct.pack(">I", 1)
    data += struct.pack(">I", 6) + b"theta\0" + b"\0\0" + struct.pack(">I", 1)
    data += bytes(-(len(data) - 4) % 8) + struct.pack(">d", 0.25) + struct.pack(">II", 0, 0)
    text = "# a comment\n" + contract.SCHEMAS[contract.JOINT_STATE].replace(
        "float64[] effort", "float64[] effort # in N"
    )
    one(tmp_path / "x.mcap", [("/real/shape", contract.JOINT_STATE, data, 7)], text)
    run = read(tmp_path / "x.mcap")
    assert run.signals["shape"].value[0, 0] == 0.25 and run.t0_ns == 5_000_000_006


def test_values_in_another_unit_are_remarked_on(tmp_path: Path):
    pressure = "/real/pressure", contract.FLUID_PRESSURE, cdr.scalars(T0, "", (-40.0, 0.0)), T0
    one(tmp_path / "x.mcap", [shape(0), shape(1, position=(45.0, 0.0)), pressure])
    notes = " ".join(read(tmp_path / "x.mcap").notes)
    assert "degrees" in notes and "gauge or kPa" in notes


def altered(raw: bytes, old: bytes, new: bytes, last: bool = False) -> bytes:
    at = raw.rindex(old) if last else raw.index(old)
    return raw[:at] + new + raw[at + len(old) :]


def test_a_renamed_topic_is_noticed_by_its_repetition(tmp_path: Path):
    theirs(tmp_path / "x.mcap", use_chunking=False)
    (tmp_path / "x.mcap").write_bytes(altered((tmp_path / "x.mcap").read_bytes(), b"/real/shape", b"/real/shapd"))
    run = read(tmp_path / "x.mcap")
    assert run.damage is not None and "channel 3 reads differently" in run.damage.why and "shape" not in run.signals


def test_renamed_metadata_is_noticed_by_the_index(logs: dict[str, tuple[bytes, Run]], tmp_path: Path):
    (tmp_path / "x.mcap").write_bytes(altered(logs["zstd"][0], b"ljjax.run", b"ljjax.ruo"))
    run = read(tmp_path / "x.mcap")
    assert run.damage is not None and "metadata 'ljjax.run'" in run.damage.why


def test_a_chunk_hidden_by_one_bit_is_noticed_without_any_index(tmp_path: Path):
    """Readers pass over records of private kinds; a flipped bit must not make one of a chunk."""
    theirs(tmp_path / "x.mcap", use_statistics=False, **SMALL)
    raw = (tmp_path / "x.mcap").read_bytes()
    assert read(tmp_path / "x.mcap").damage is None
    second = raw.index(b"zstd", raw.index(b"zstd") + 1) - 41
    (tmp_path / "x.mcap").write_bytes(raw[:second] + bytes([raw[second] | 0x80]) + raw[second + 1 :])
    run = read(tmp_path / "x.mcap")
    assert run.damage is not None and "a bit is wrong" in run.damage.why


def test_a_damaged_attachment_is_not_given(tmp_path: Path):
    with (tmp_path / "x.mcap").open("wb") as stream:
        log = McapWriter(stream)
        log.start("ros2")
        log.add_attachment(T0, T0, "law.npz", "application/x-npz", b"the law")
        log.finish()
    assert read_attachment(tmp_path / "x.mcap", "law.npz") == b"the law"
    (tmp_path / "x.mcap").write_bytes(altered((tmp_path / "x.mcap").read_bytes(), b"the law", b"the low"))
    with pytest.raises(InputError, match="law.npz.*checksum"):
        read_attachment(tmp_path / "x.mcap", "law.npz")


def test_equal_stamps_keep_the_order_of_the_file(tmp_path: Path):
    rows = [shape(i % 3, position=(float(i), 0.0)) for i in range(300)]
    one(tmp_path / "x.mcap", rows)
    found = read(tmp_path / "x.mcap").signals["shape"].value[:, 0]
    np.testing.assert_array_equal(found, np.concatenate([np.arange(k, 300.0, 3) for k in range(3)]))
