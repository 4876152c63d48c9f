"""Tension sensors and a probe on analog channels, beside the emulated rig's servos."""

import math

import pytest

from ljjax.errors import InputError
from ljjax.rig.reference import ReferenceRig
from ljjax.rig.robot import RigError
from ljjax.rig.sensors import Sensors
from tests.rig.emulated import config, emulated, named, until

VOLTS = {0: 1.0, 1: 2.0, 2: 0.5, 3: 0.25}
TABLE = {
    "device": "tests.rig.test_sensors:Adc",
    "left_n": [0, 10.0, -0.5],
    "right_n": [1, 10.0, 0.0],
    "probe_m": [2, 0.01, 0.0],
    "probe_n": [3, 4.0, 0.0],
}


class Adc:
    closed = 0

    def read_volts(self, channel):
        return VOLTS[channel]

    def close(self):
        Adc.closed += 1


def test_channels_are_read_in_newtons_and_metres():
    before = Adc.closed
    sensors = Sensors(TABLE)
    sensors.connect()
    assert sensors.read()[1:5] == (9.5, 20.0, 0.005, 1.0)
    first = sensors.read().t
    until(lambda: sensors.read().t > first)
    sensors.stop()
    assert Adc.closed == before + 1


def test_measured_tensions_take_the_place_of_those_that_currents_tell():
    with emulated() as rig:
        for table, measured in ((TABLE, True), ({k: v for k, v in TABLE.items() if k != "left_n"}, False)):
            with ReferenceRig(config(rig, "servos")._replace(sensors=table)) as robot:
                reading = robot.read()
                assert (reading.left_n == 9.5, reading.right_n == 20.0) == (measured, measured)
                assert reading.by_current == (0.0 if measured else 1.0)
                assert reading.probe_n == 1.0 and reading.t_probe > 0
        with ReferenceRig(config(rig, "servos")) as robot:
            assert robot.read().by_current == 1.0 and math.isnan(robot.read().probe_n)


def test_a_device_that_fails_is_a_fault(monkeypatch):
    def silent(self, channel):
        raise OSError("no device")

    sensors = Sensors(TABLE | {"lost_reads": 2})
    sensors.connect()
    monkeypatch.setattr(Adc, "read_volts", silent)
    until(lambda: named(sensors.read(), "no device; check its cable"))
    sensors.stop()
    with pytest.raises(RigError, match="sensors tests.rig.test_sensors:Adc: no device"):
        Sensors(TABLE).connect()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"left_n": [0, 10.0]}, r"sensors.left_n is \[0, 10.0\]; expected \[channel, scale, offset\]"),
        ({"probe_n": [3, 0.0, 1.0]}, "the scale not 0"),
        ({"top_n": [3, 1.0, 1.0]}, "unknown key sensors.top_n"),
        ({"rate_hz": 0}, "sensors.rate_hz is 0"),
    ],
)
def test_a_wrong_key_is_refused(change, said):
    with pytest.raises(InputError, match=said):
        Sensors(TABLE | change)
