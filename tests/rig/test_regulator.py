"""Vacuum regulator and gauge: by serial lines and by volts."""

import math
import sys
from types import SimpleNamespace

import pytest

from ljjax.errors import InputError
from ljjax.rig.regulator import Vacuum
from ljjax.rig.robot import RigError
from tests.rig.emulated import close, config, emulated, until

ANALOG = {
    "kind": "analog",
    "device": "a_card:open_it",
    "set_scale": 10.0,
    "set_offset_kpa": -10.0,
    "gauge_scale": 10.0,
    "gauge_offset_kpa": -10.0,
    "vacuum_max_kpa": 40.0,
}


class Volts:
    """A regulator of 10 kPa a volt, from 1 V for none, that holds what it is told."""

    volts = 1.0
    broken = closed = False

    def write_volts(self, volts: float) -> None:
        self.volts = volts

    def read_volts(self) -> float:
        if self.broken:
            raise OSError("the card is gone")
        return self.volts

    def close(self) -> None:
        self.closed = True


@pytest.fixture
def card(monkeypatch):
    card = Volts()
    monkeypatch.setitem(sys.modules, "a_card", SimpleNamespace(open_it=lambda: card))
    return card


def test_volts_are_calibrated_both_ways(card):
    vacuum = Vacuum(ANALOG)
    assert math.isnan(vacuum.read().vacuum_kpa)
    vacuum.connect()
    assert vacuum.read().vacuum_kpa == pytest.approx(0.0) and card.volts == 1.0  # connecting moves nothing
    vacuum.command(25.0)
    until(lambda: close(vacuum.read().vacuum_kpa, 25.0, 1e-9))
    assert card.volts == pytest.approx(3.5)
    vacuum.command(1e9)
    until(lambda: close(card.volts, 5.0, 1e-9))  # what the table allows
    card.broken = True
    until(lambda: vacuum.read().faults)
    assert "the card is gone; check its cable" in vacuum.read().faults[0]
    card.broken = False
    until(lambda: not vacuum.read().faults)
    vacuum.stop()
    assert card.closed and card.volts == pytest.approx(5.0)  # the vacuum is kept
    vacuum.connect()
    vacuum.stop(vent=True)
    assert card.volts == pytest.approx(1.0)


def test_serial_lines():
    with emulated() as rig:
        vacuum = Vacuum(config(rig).pressure)
        vacuum.connect()
        vacuum.command(30.0)
        until(lambda: close(vacuum.read().vacuum_kpa, 30.0, 0.1))
        rig.faults.put("gauge_stuck")
        vacuum.command(10.0)
        until(lambda: close(rig.vacuum_kpa, 10.0, 0.1))
        assert vacuum.read().vacuum_kpa > 25.0
        rig.faults.clear("gauge_stuck")
        rig.faults.put("vacuum_leak=0.5")
        until(lambda: close(vacuum.read().vacuum_kpa, 5.0, 0.1))
        vacuum.stop(vent=True)
        until(lambda: close(rig.vacuum_kpa, 0.0, 0.1))
        vacuum.stop()


def test_a_port_that_is_not_there_is_named():
    with pytest.raises(RigError, match="/dev/nowhere.*check cable"):
        Vacuum({"port": "/dev/nowhere"}).connect()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"kind": "steam"}, 'pressure.kind is .steam.; expected "serial"'),
        ({"gauge_scale": 0}, "pressure.gauge_scale is 0"),
        ({"device": 5}, "pressure.device"),
        ({"port": "a"}, "unknown key pressure.port"),
    ],
)
def test_a_wrong_key_is_named(change, said):
    with pytest.raises(InputError, match=said):
        Vacuum(ANALOG | change)
