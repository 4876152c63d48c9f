"""The servos' driver, the maker's SDK underneath, against servos that are not there."""

import importlib

import pytest

from ljjax.errors import InputError
from ljjax.rig import xm430
from ljjax.rig.dynamixel import Servos
from ljjax.rig.emulator import packets
from ljjax.rig.robot import RigError
from tests.rig.emulated import close, config, emulated, until


@pytest.fixture
def rig():
    with emulated() as rig:
        yield rig


@pytest.fixture
def servos(rig):
    servos = Servos(config(rig).servos)
    servos.connect()
    yield servos
    servos.stop()


def test_a_tension_commanded_is_the_one_the_tendon_has(rig, servos):
    assert rig.tensions == (0.0, 0.0)  # connecting moves nothing
    until(lambda: close(servos.read().n[0], 20.0, 0.3), lambda: servos.command(20.0, 5.0))
    step_n = xm430.CURRENT_MA / 1000 * servos.spools.torque_nm_a / servos.spools.radius_m
    assert close(rig.tensions[0], 20.0, step_n) and close(rig.tensions[1], 5.0, step_n)
    assert servos.command(20.0, 5.0) == pytest.approx(rig.tensions)  # what is logged is what was sent
    until(lambda: close(servos.read().m[0], 0.02 * 0.3, 2e-4), lambda: servos.command(20.0, 5.0))
    said = servos.read()
    assert said.m[1] == pytest.approx(-said.m[0], abs=1e-4)  # the other tendon pays out, a motor that turns backwards
    assert said.ma[0] > said.ma[1] > 0 and said.temperature_c == 31.0 and not said.faults


def test_no_current_pushes_and_none_passes_the_limit(rig):
    servos = Servos(config(rig).servos | {"current_max_ma": 100.0})
    assert (
        servos.spools.current_ma(-5.0) == servos.spools.current_ma(0.0) == servos.spools.current_ma(float("nan")) == 0
    )
    assert servos.spools.current_ma(1e9) == 100.0
    assert servos.spools.tension_n(servos.spools.current_ma(3.0)) == pytest.approx(3.0)


def test_rounding_to_units_of_current_never_passes_the_limit_of_tension(rig):
    servos = Servos(config(rig).servos, most_n=10.0)
    servos.connect()
    told = [servos.command(10.0 + 0.1 * k, 9.8 + 0.01 * k)[side] for k in range(20) for side in (0, 1)]
    servos.stop()
    assert 9.0 < max(told) <= 10.0


def test_stop_takes_tension_and_torque_off(rig, servos):
    until(lambda: rig.tensions[0] > 5, lambda: servos.command(10.0, 1.0))
    servos.stop()
    until(lambda: rig.tensions == (0.0, 0.0))
    assert [one.get(xm430.TORQUE) for one in rig._servos] == [0, 0]
    servos.stop()  # whatever state it is in


def test_when_commands_end_the_servos_stop_by_themselves(rig):
    servos = Servos(config(rig).servos | {"watchdog_ms": 500.0})
    servos.connect()
    try:
        until(lambda: rig.tensions[0] > 5, lambda: servos.command(10.0, 1.0))
        until(lambda: rig.tensions == (0.0, 0.0), servos.read)  # reading does not keep a dead controller alive
        until(lambda: any("watchdog" in fault for fault in servos.read().faults), lambda: servos.command(10.0, 1.0))
        assert rig.tensions == (0.0, 0.0)  # nor does it pull again before someone has looked
    finally:
        servos.stop()


@pytest.mark.parametrize("kind", ["packet_loss=0.01", "packet_loss=0.2", "packet_corrupt=0.05", "packet_corrupt=0.2"])
def test_lost_and_damaged_packets_give_no_wrong_command(rig, servos, kind):
    until(lambda: servos.read().n[0] > 0, lambda: servos.command(5.0, 5.0))
    rig.faults.put(kind)
    tensions, read = set(), set()

    def tick():
        servos.command(10.0, 5.0)
        tensions.update(round(x, 6) for x in rig.tensions)
        read.update(round(x, 6) for x in servos.read().ma)

    begun = servos.read().t
    until(lambda: servos.read().t > begun + 1.0, tick)
    currents = [round(servos.spools.current_ma(n) / xm430.CURRENT_MA) * xm430.CURRENT_MA for n in (5.0, 10.0)]
    assert tensions <= {round(servos.spools.tension_n(ma), 6) for ma in currents}
    assert read <= {round(ma, 6) for ma in currents}
    assert not servos.read().faults


@pytest.mark.parametrize(("side", "name"), [("left", "left servo (id 1)"), ("right", "right servo (id 2)")])
def test_an_unplugged_servo_is_named_within_its_ticks(rig, servos, side, name):
    until(lambda: servos.read().n[0] > 0, lambda: servos.command(5.0, 5.0))
    rig.faults.put(f"servo_unplugged={side}")
    ticks = [0]
    publish = servos._publish
    servos._publish = lambda blocks: (ticks.__setitem__(0, ticks[0] + 1), publish(blocks))[1]
    until(lambda: servos.read().faults, lambda: servos.command(5.0, 5.0))
    assert servos.read().faults[0].startswith(f"{name}: no answer for 10 ticks")
    assert abs(ticks[0] - servos.lost_ticks) <= 2
    rig.faults.clear("servo_unplugged")
    until(lambda: len(servos.read().faults) > 1, lambda: servos.command(5.0, 5.0))
    assert "its torque went off" in servos.read().faults[1]  # it is back, and knows nothing of its settings


def test_an_adapter_pulled_out_is_an_error_of_the_next_command(rig, servos):
    until(lambda: servos.read().n[0] > 0, lambda: servos.command(5.0, 5.0))
    rig.faults.put("servo_unplugged=bus")
    with pytest.raises(RigError, match="the bus .* is gone"):
        until(lambda: False, lambda: servos.command(5.0, 5.0))
    assert any("is gone" in fault for fault in servos.read().faults)
    servos.stop()


@pytest.mark.parametrize(("bit", "words"), [(2, "overheating"), (4, "electrical shock"), (5, "overload")])
def test_a_hardware_error_is_named(rig, servos, bit, words):
    until(lambda: servos.read().n[0] > 0, lambda: servos.command(5.0, 5.0))
    rig.faults.put(f"servo_error={bit}")
    until(lambda: servos.read().faults, lambda: servos.command(5.0, 5.0))
    assert servos.read().faults[0].startswith(f"left servo (id 1): {words}")
    servos.stop()
    with pytest.raises(RigError, match=f"{words}.*power off and on"):
        servos.connect()


def test_a_bus_without_servos_is_refused_with_the_mend(rig):
    table = config(rig).servos
    with pytest.raises(RigError, match=r"left servo \(id 7\): no answer .* check power"):
        Servos(table | {"ids": [7, 2], "reply_ms": 5.0}).connect()
    with pytest.raises(RigError, match="/dev/nowhere"):
        Servos(table | {"port": "/dev/nowhere"}).connect()
    with pytest.raises(RigError, match="not connected"):
        Servos(table).command(1.0, 1.0)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"port": ""}, "servos.port"),
        ({"ids": [1]}, "servos.ids"),
        ({"spool_radius_m": 0}, "servos.spool_radius_m"),
        ({"direction": [1, 0.5]}, "servos.direction"),
        ({"direction": [1, 0]}, "servos.direction"),
        ({"watchdog_ms": 5000}, "servos.watchdog_ms"),
        ({"color": "red"}, "unknown key servos.color"),
    ],
)
def test_a_wrong_key_is_named(change, said):
    with pytest.raises(InputError, match=said):
        Servos({"port": "/dev/null", "spool_radius_m": 0.01} | change)


def test_packets_are_the_makers():
    sdk = importlib.import_module("dynamixel_sdk")
    theirs = sdk.PacketHandler(2.0)
    data = bytes(range(256))
    assert packets.crc16(data) == theirs.updateCRC(0, list(data), len(data))
    inside = b"\x01\xff\xff\xfd\xff\xff\xfd\x02\xff\xff\xfd"
    raw = packets.build(1, packets.WRITE, inside)
    assert raw[7:-2].count(b"\xff\xff\xfd\xfd") == 3
    reader = packets.Reader()
    noise = b"\x00\xff\xff\xfd\x00\x01\xff\xff"
    found = [p for byte in noise + raw[:-1] + b"\x00" + raw for p in reader.feed(bytes([byte]))]
    assert found == [packets.Packet(1, packets.WRITE, inside)]  # after noise, and one that was damaged


def test_a_position_that_looks_like_a_header_comes_through(rig, servos):
    position = int.from_bytes(b"\xff\xff\xfd\x00", "little")
    travel = (position - 2048) * xm430.RAD * servos.spools.radius_m
    rig.plant.advance = lambda *_: None
    rig.plant.bend = travel / rig.plant.lever_arm_m
    until(lambda: close(servos.read().m[0], travel, 1e-4 * travel), lambda: servos.command(1.0, 1.0))


def test_errors_in_words():
    assert xm430.errors(0) == []
    assert [text.split()[0] for text in xm430.errors(0b100101)] == ["input", "overheating", "overload"]
    assert xm430.errors(0x80) == ["hardware error bits 0x80"]
    assert [xm430.signed(x, 2) for x in (0, 1, 0x7FFF, 0x8000, 0xFFFF)] == [0, 1, 32767, -32768, -1]
