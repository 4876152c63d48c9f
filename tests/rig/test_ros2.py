"""The bridge to ROS 2, with a stand-in for rclpy: messages in, messages out, nothing else published."""

import math
import sys
import threading
import time
import tomllib
from types import SimpleNamespace
from typing import Any, NamedTuple

import pytest

from ljjax.errors import InputError
from ljjax.rig.config import parse
from ljjax.rig.drivers import open_robot
from ljjax.rig.robot import RigError
from ljjax.rig.ros2 import Ros2Robot

from .conftest import TOML

T0 = time.monotonic()


def message(**fields):
    return SimpleNamespace(header=SimpleNamespace(stamp=None), name=[], position=[], effort=[], **fields)


class Node:
    def __init__(self):
        self.published, self.heard, self.gone = [], {}, False

    def create_publisher(self, kind, topic, depth):
        return SimpleNamespace(publish=lambda m: self.published.append((topic, m)))

    def create_subscription(self, kind, topic, callback, qos):
        self.heard[topic] = callback
        if topic == "/real/shape":
            self.say(topic, name=["q2", "q1"], position=[0.2, 0.1])

    def get_clock(self):
        now = time.monotonic() - T0 + 1000.0
        stamp = SimpleNamespace(sec=int(now), nanosec=int(now % 1 * 1e9))
        return SimpleNamespace(now=lambda: SimpleNamespace(nanoseconds=now * 1e9, to_msg=lambda: stamp))

    def destroy_node(self):
        self.gone = True

    def say(self, topic, **fields):
        m = message()
        m.header.stamp = self.get_clock().now().to_msg()
        for name, value in fields.items():
            setattr(m, name, value)
        self.heard[topic](m)


@pytest.fixture
def node(monkeypatch):
    node, ended = Node(), threading.Event()
    executor = SimpleNamespace(add_node=lambda n: None, spin=ended.wait, shutdown=ended.set)
    modules = {
        "rclpy": SimpleNamespace(
            Context=lambda: SimpleNamespace(try_shutdown=lambda: None),
            init=lambda context: None,
            create_node=lambda name, context: node,
        ),
        "rclpy.qos": SimpleNamespace(qos_profile_sensor_data=None),
        "rclpy.executors": SimpleNamespace(SingleThreadedExecutor=lambda context: executor),
        "sensor_msgs": SimpleNamespace(),
        "sensor_msgs.msg": SimpleNamespace(JointState=message, FluidPressure=message, Temperature=message),
    }
    for name, module in modules.items():
        monkeypatch.setitem(sys.modules, name, module)
    return node


class Config(NamedTuple):
    p_atm_pa: float
    ros2: dict[str, Any]


def config(**ros2):
    return Config(100_000.0, ros2)


def test_topics_in_and_out(node):
    text = tomllib.loads(TOML.replace('"mock"', '"ros2"', 1).format(safety="", mock="") + "[ros2]\nwait_s = 60.0\n")
    with open_robot(parse(text | {"p_atm_pa": 100_000}, "rig.toml")) as robot:
        shape = robot.read()
        assert shape.theta == pytest.approx(0.15) and shape.joints == (0.1, 0.2)
        assert abs(shape.t_shape - time.monotonic()) < 60 and math.isnan(shape.left_n)
        node.say("/real/shape", name=["theta"], position=[0.3])
        node.say("/real/tendons", name=["tendon_right", "x", "tendon_left"], effort=[5.0, 0.0, 7.0])
        node.say("/real/pressure", fluid_pressure=80_000.0)
        node.say("/real/probe", name=["probe"], position=[0.01], effort=[2.0])
        node.say("/real/temperature", temperature=25.0)
        now = robot.read()
        assert (now.theta, now.joints, now.left_n, now.right_n, now.vacuum_kpa) == (0.3, (), 7.0, 5.0, 20.0)
        assert (now.probe_m, now.probe_n, now.temperature_c) == (0.01, 2.0, 25.0) and math.isnan(now.left_m)
        assert not node.published  # reading is no sign of life
        robot.command(12.0, -1.0, 30.0)
        (_, tendons), (_, pressure) = node.published
        assert tendons.name == ["tendon_left", "tendon_right"] and tendons.effort == [12.0, 0.0]
        assert pressure.fluid_pressure == 70_000.0
        node.published.clear()
    assert [(topic, m.effort) for topic, m in node.published] == [("/real/cmd/tendons", [0.0, 0.0])] and node.gone


def test_venting_and_silence(node):
    robot = Ros2Robot(config())
    robot.connect()
    robot.stop(vent=True)
    assert node.published[-1][1].fluid_pressure == 100_000.0
    robot.stop()
    with pytest.raises(RigError, match="not connected"):
        robot.command(1.0, 1.0, 0.0)
    node.create_subscription = lambda *_: None
    with pytest.raises(RigError, match="nothing on /real/shape"):
        Ros2Robot(config(wait_s=0.01)).connect()


def test_without_ros_the_mend_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "rclpy", None)
    with pytest.raises(RigError, match="source the set-up of your ROS 2"):
        Ros2Robot(config()).connect()
    with pytest.raises(InputError, match="unknown key ros2.topic"):
        Ros2Robot(config(topic="a"))
