"""A bridge for rigs that speak ROS 2: the topics of the logs (docs/logs.md), published and subscribed live.

Commands go out on `/real/cmd/tendons` and `/real/cmd/pressure`, what is measured comes in on `/real/tendons`,
`/real/pressure`, `/real/shape`, `/real/probe` and `/real/temperature`. ROS is imported when it connects. Nothing is
published but what `command` is given, so that a watchdog on the other side sees a dead controller.
"""

from __future__ import annotations

import contextlib
import importlib
import math
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

from ljjax.rig.keys import Keys
from ljjax.rig.robot import NAN, Reading, RigError, Robot

TENDONS = ["tendon_left", "tendon_right"]


class Config(Protocol):
    """What a rig.toml says: the atmosphere's pressure [Pa], and the table [ros2]."""

    @property
    def p_atm_pa(self) -> float: ...

    @property
    def ros2(self) -> Mapping[str, Any]: ...


class Ros2Robot(Robot):
    """A robot behind ROS 2 topics as a `ljjax.rig.robot.Robot`.

    Stamps are those of the messages' headers, brought from the node's clock to `time.monotonic()`.

    Args:
        config: `p_atm_pa`, and in [ros2] node (its name), prefix (of the topics) and wait_s (for the first shape).

    Raises:
        InputError: a key that is unknown or wrong.
    """

    def __init__(self, config: Config):
        keys = Keys("ros2", config.ros2)
        self._node_name = keys.text("node", "ljjax_rig")
        self._prefix = keys.text("prefix", "/real").rstrip("/")
        self._wait = keys.number("wait_s", 5.0, "s", 0.0)
        keys.done()
        self._p_atm = config.p_atm_pa
        self._lock = threading.Lock()
        self._last = Reading()
        self._node: Any = None
        self._thread: threading.Thread | None = None

    def connect(self) -> None:
        """Make a node, and wait for the first shape. Raises RigError."""
        try:
            rclpy: Any = importlib.import_module("rclpy")
            sensor: Any = importlib.import_module("sensor_msgs.msg")
        except ImportError as error:
            raise RigError(
                f"ros2: {error}; source the set-up of your ROS 2, such as /opt/ros/jazzy/setup.bash"
            ) from None
        self._sensor, self._last = sensor, Reading()
        self._context = rclpy.Context()
        try:
            rclpy.init(context=self._context)
            self._node = node = rclpy.create_node(self._node_name, context=self._context)
            qos = importlib.import_module("rclpy.qos").qos_profile_sensor_data  # the latest, and none twice
            self._tendons = node.create_publisher(sensor.JointState, f"{self._prefix}/cmd/tendons", 1)
            self._pressure = node.create_publisher(sensor.FluidPressure, f"{self._prefix}/cmd/pressure", 1)
            heard: tuple[tuple[str, Any, Callable[[Any], dict[str, Any]]], ...] = (
                ("tendons", sensor.JointState, self._tendons_said),
                ("pressure", sensor.FluidPressure, self._pressure_said),
                ("shape", sensor.JointState, self._shape_said),
                ("probe", sensor.JointState, self._probe_said),
                ("temperature", sensor.Temperature, lambda m: {"temperature_c": float(m.temperature)}),
            )
            for topic, kind, said in heard:
                node.create_subscription(kind, f"{self._prefix}/{topic}", self._keeping(said), qos)
            executors: Any = importlib.import_module("rclpy.executors")
            self._executor = executors.SingleThreadedExecutor(context=self._context)
            self._executor.add_node(node)
            self._thread = threading.Thread(target=self._spin, name="ros2", daemon=True)
            self._thread.start()
            end = time.monotonic() + self._wait
            while not math.isfinite(self.read().t_shape):
                if time.monotonic() > end:
                    raise RigError(
                        f"ros2: nothing on {self._prefix}/shape in {self._wait:g} s; start the robot's nodes"
                    )
                time.sleep(0.005)
        except BaseException:
            self._close()
            raise

    def read(self) -> Reading:
        """The latest of every topic."""
        with self._lock:
            return self._last

    def command(self, left_n: float, right_n: float, vacuum_kpa: float) -> None:
        """Publish tensions [N] and vacuum [kPa]. Raises RigError where it is not connected."""
        if self._node is None:
            raise RigError("ros2: not connected; call connect first")
        stamp = self._node.get_clock().now().to_msg()
        tendons = self._sensor.JointState()
        tendons.header.stamp, tendons.name = stamp, list(TENDONS)
        tendons.effort = [float(max(0.0, left_n)), float(max(0.0, right_n))]
        self._tendons.publish(tendons)
        self._publish_vacuum(stamp, vacuum_kpa)

    def stop(self, vent: bool = False) -> None:
        """Publish no tension, and the atmosphere's pressure where it is to vent; end the node. Never raises."""
        if self._node is None:
            return
        with contextlib.suppress(Exception):
            stamp = self._node.get_clock().now().to_msg()
            tendons = self._sensor.JointState()
            tendons.header.stamp, tendons.name, tendons.effort = stamp, list(TENDONS), [0.0, 0.0]
            self._tendons.publish(tendons)
            if vent:
                self._publish_vacuum(stamp, 0.0)
        self._close()

    def _publish_vacuum(self, stamp: Any, vacuum_kpa: float) -> None:
        pressure = self._sensor.FluidPressure()
        pressure.header.stamp, pressure.fluid_pressure = stamp, self._p_atm - 1000 * vacuum_kpa
        self._pressure.publish(pressure)

    def _close(self) -> None:
        for end in (
            lambda: self._executor.shutdown(),
            lambda: self._thread and self._thread.join(5.0),
            lambda: self._node.destroy_node(),
            lambda: self._context.try_shutdown(),
        ):
            with contextlib.suppress(Exception):
                end()
        self._node = self._thread = None

    def _spin(self) -> None:
        try:
            self._executor.spin()
        except Exception as error:  # the context was shut down, or a callback failed
            with self._lock:
                self._last = self._last._replace(faults=(f"ros2: {error}; connect again",))

    def _keeping(self, said: Callable[[Any], dict[str, Any]]) -> Callable[[Any], None]:
        def keep(message: Any) -> None:
            values = said(message)
            with self._lock:
                self._last = self._last._replace(**values)

        return keep

    def _stamp(self, message: Any) -> float:
        """A header's stamp on the clock of `time.monotonic()` [s]."""
        stamp = message.header.stamp
        age = self._node.get_clock().now().nanoseconds * 1e-9 - (stamp.sec + stamp.nanosec * 1e-9)
        return time.monotonic() - age

    def _tendons_said(self, m: Any) -> dict[str, Any]:
        return {
            "t_tendons": self._stamp(m),
            "left_n": _of(m, m.effort, TENDONS[0]),
            "right_n": _of(m, m.effort, TENDONS[1]),
            "left_m": _of(m, m.position, TENDONS[0]),
            "right_m": _of(m, m.position, TENDONS[1]),
        }

    def _pressure_said(self, m: Any) -> dict[str, Any]:
        return {"t_pressure": self._stamp(m), "vacuum_kpa": (self._p_atm - m.fluid_pressure) / 1000}

    def _shape_said(self, m: Any) -> dict[str, Any]:
        if "theta" in m.name:
            return {"t_shape": self._stamp(m), "theta": _of(m, m.position, "theta"), "joints": ()}
        count = sum(name[:1] == "q" and name[1:].isdecimal() for name in m.name)
        joints = tuple(_of(m, m.position, f"q{i + 1}") for i in range(count))
        return {"t_shape": self._stamp(m), "theta": sum(joints) / count if count else NAN, "joints": joints}

    def _probe_said(self, m: Any) -> dict[str, Any]:
        return {"t_probe": self._stamp(m), "probe_m": _of(m, m.position, "probe"), "probe_n": _of(m, m.effort, "probe")}


def _of(message: Any, values: Sequence[float], name: str) -> float:
    """The value of a joint by name, NaN where there is none."""
    index = list(message.name).index(name) if name in message.name else len(values)
    return float(values[index]) if index < len(values) else NAN
