"""Log contract v1 as a table: which topic carries which signal, in which message type and unit."""

from __future__ import annotations

from dataclasses import dataclass

VERSION = "1"
RUN_RECORD = "ljjax.run"
ATTACHMENT_RECORD = "ljjax.attachments"
RESULT_RECORD = "ljjax.result"
RESULT_LIBRARY = "ljjax result"

RUN_KEYS = (
    "contract_version",
    "run_id",
    "robot_id",
    "experiment",
    "p_atm_pa",
    "start_utc",
    "law_sha256",
    "software_version",
    "end_reason",
)

JOINT_STATE = "sensor_msgs/msg/JointState"
FLUID_PRESSURE = "sensor_msgs/msg/FluidPressure"
TEMPERATURE = "sensor_msgs/msg/Temperature"
POSE_STAMPED = "geometry_msgs/msg/PoseStamped"
DIAGNOSTIC_ARRAY = "diagnostic_msgs/msg/DiagnosticArray"

TENDONS = ("tendon_left", "tendon_right")
POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")


@dataclass(frozen=True)
class Entry:
    """One signal of the contract.

    Attributes:
        signal: its name in `Run.signals`.
        topic: its topic under `/real`.
        type: ROS 2 message type.
        columns: names of the columns; empty where the log names them (`theta` or `q1 … qn`).
        units: SI unit of each column, or one for all.
        fields: for a JointState, the array each column comes from, or one for all.
        frame_id: what our writer puts in the header.
        needed_for: input, output, or what it is good for.
    """

    signal: str
    topic: str
    type: str
    columns: tuple[str, ...]
    units: tuple[str, ...]
    fields: tuple[str, ...]
    frame_id: str
    needed_for: str


ENTRIES = (
    Entry("cmd_tendons", "/cmd/tendons", JOINT_STATE, TENDONS, ("N",), ("effort",), "rig", "input"),
    Entry("tendons", "/tendons", JOINT_STATE, TENDONS, ("N",), ("effort",), "rig", "optional: actuation"),
    Entry("spool", "/tendons", JOINT_STATE, TENDONS, ("m",), ("position",), "rig", "optional: actuation"),
    Entry("cmd_pressure", "/cmd/pressure", FLUID_PRESSURE, ("pressure",), ("Pa",), (), "jamming", "input"),
    Entry("pressure", "/pressure", FLUID_PRESSURE, ("pressure",), ("Pa",), (), "jamming", "optional: actuation"),
    Entry("shape", "/shape", JOINT_STATE, (), ("rad",), ("position",), "base", "output"),
    Entry("tip", "/tip/pose", POSE_STAMPED, POSE, ("m",) * 3 + ("1",) * 4, (), "base", "optional output"),
    Entry("probe", "/probe", JOINT_STATE, ("position", "force"), ("m", "N"), ("position", "effort"), "base", "probe"),
    Entry("temperature", "/temperature", TEMPERATURE, ("temperature",), ("degC",), (), "ambient", "optional"),
)  # fmt: skip
BY_SIGNAL = {entry.signal: entry for entry in ENTRIES}
DIAGNOSTICS_TOPIC = "/rig/diagnostics"
SD = "/sd"  # suffix of a topic that carries the standard deviations of its parent's samples

_HEADER = """\
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""

SCHEMAS = {
    JOINT_STATE: "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n"
    + _HEADER,
    FLUID_PRESSURE: "std_msgs/Header header\nfloat64 fluid_pressure\nfloat64 variance\n" + _HEADER,
    TEMPERATURE: "std_msgs/Header header\nfloat64 temperature\nfloat64 variance\n" + _HEADER,
    POSE_STAMPED: "std_msgs/Header header\ngeometry_msgs/Pose pose\n"
    + _HEADER
    + """\
================================================================================
MSG: geometry_msgs/Pose
geometry_msgs/Point position
geometry_msgs/Quaternion orientation
================================================================================
MSG: geometry_msgs/Point
float64 x
float64 y
float64 z
================================================================================
MSG: geometry_msgs/Quaternion
float64 x 0
float64 y 0
float64 z 0
float64 w 1
""",
    DIAGNOSTIC_ARRAY: "std_msgs/Header header\ndiagnostic_msgs/DiagnosticStatus[] status\n"
    + _HEADER
    + """\
================================================================================
MSG: diagnostic_msgs/DiagnosticStatus
byte OK=0
byte WARN=1
byte ERROR=2
byte STALE=3
byte level
string name
string message
string hardware_id
diagnostic_msgs/KeyValue[] values
================================================================================
MSG: diagnostic_msgs/KeyValue
string key
string value
""",
}


def fields_of(schema_text: str) -> frozenset[tuple[str, ...]]:
    """A definition without comments, layout, order of its parts and default values, for comparison."""
    parts: list[list[str]] = [[]]
    for raw in schema_text.splitlines():
        line = raw.split("#", 1)[0].strip()
        if line.startswith("====="):
            parts.append([])
        elif line.startswith("MSG:"):
            parts[-1].append(line[4:].strip().replace("/msg/", "/"))
        elif line and "=" not in line:
            kind, name = (line.split() + [""])[:2]
            package, _, short = kind.replace("/msg/", "/").rpartition("/")
            parts[-1].append(f"{short if package else kind} {name}")
    time = ("builtin_interfaces/Time", "int32 sec", "uint32 nanosec")  # some writers leave it out
    return frozenset(tuple(part) for part in parts if part and tuple(part) != time)


def is_standard(type_name: str, schema_text: str) -> bool:
    """Whether a schema text defines the standard message of that name, so that `ljjax.logs.cdr` may decode it."""
    known = SCHEMAS.get(type_name)
    return known is not None and fields_of(known) == fields_of(schema_text)


def full_type(name: str) -> str:
    """`sensor_msgs/JointState` and `sensor_msgs/msg/JointState` are one type."""
    return name if "/msg/" in name else name.replace("/", "/msg/", 1)
