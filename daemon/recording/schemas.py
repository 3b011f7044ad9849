"""The message layouts of a recording as ROS 2 message texts: every field with its unit.

The constants of an enumeration stand right before their field: viewers then show their names instead of numbers.
"""

from __future__ import annotations

from collections.abc import Iterable

from daemon.recording.cdr import Layout
from drivers.adis16448.burst import Fault
from estimation.records import CanState, MoveKind, ReadingFault, Segment, Tier, TimeKind


def _constants(prefix: str, names: Iterable[tuple[str, int]]) -> str:
    return "".join(f"uint8 {prefix}_{name}={code}\n" for name, code in names)


def _positions(kind: Iterable[Segment] | Iterable[Tier] | Iterable[CanState] | Iterable[MoveKind]) -> str:
    """Constants of a textual enum: its members are numbered in their order."""
    members = list(kind)
    return _constants(type(members[0]).__name__.upper(), ((m.name, code) for code, m in enumerate(members)))


_TIME = "int64 t_ns  # [ns] monotonic clock of the recording\n"
_TIME_KIND = (
    _constants("TIME", ((m.name, m.value) for m in TimeKind)) + "uint8 time_kind  # where t_ns comes from: TIME_*\n"
)

BURST = Layout(
    "ramstroke_msgs/msg/Adis16448Burst",
    "# One burst read of an ADIS16448: register words as read (data sheet Rev. E, burst read)\n"
    + _TIME
    + """\
uint16 diag_stat  # [-] DIAG_STAT bits
int16 x_gyro  # [LSB] 0.04 deg/s at the +-1000 deg/s range, 0.02 at +-500, 0.01 at +-250
int16 y_gyro  # [LSB] as x_gyro
int16 z_gyro  # [LSB] as x_gyro
int16 x_accl  # [LSB] 0.833 mg
int16 y_accl  # [LSB] 0.833 mg
int16 z_accl  # [LSB] 0.833 mg
int16 x_magn  # [LSB] 142.9 uGs
int16 y_magn  # [LSB] 142.9 uGs
int16 z_magn  # [LSB] 142.9 uGs
uint16 baro  # [LSB] 0.02 mbar
int16 temp  # [LSB] 0.07386 degC in bits 0 to 11, two's complement, 0 = 31 degC
uint16 crc  # [-] check word that followed, meaningful when has_crc
bool has_crc
"""
    + _TIME_KIND
    + _constants("FAULT", ((m.name, m.value) for m in Fault))
    + "uint8 fault  # what is wrong with this burst: FAULT_*\n",
)

IDENTITY = Layout(
    "ramstroke_msgs/msg/Adis16448Identity",
    "# Who answers from here on\n"
    + _TIME
    + """\
uint16 product_id  # [-] PROD_ID
uint32 lot_id  # [-] LOT_ID1 in the upper half, LOT_ID2
uint16 serial  # [-] SERIAL_NUM, bits 0 to 11
""",
)

JY901 = Layout(
    "ramstroke_msgs/msg/Jy901Sample",
    "# One sample of a JY901: the words of an acceleration and of a rate packet as received\n"
    + _TIME
    + """\
int16 x_accl  # [LSB] 16 g / 32768
int16 y_accl  # [LSB] as x_accl
int16 z_accl  # [LSB] as x_accl
int16 accl_temp  # [LSB] 0.01 degC
int16 x_gyro  # [LSB] 2000 deg/s / 32768
int16 y_gyro  # [LSB] as x_gyro
int16 z_gyro  # [LSB] as x_gyro
int16 gyro_temp  # [LSB] 0.01 degC
bool is_frozen  # the part repeats itself: not used
""",
)

JY901_IDENTITY = Layout(
    "ramstroke_msgs/msg/Jy901Identity",
    "# Who answers from here on, and how it was set up\n"
    + _TIME
    + """\
uint16 firmware  # [-] register VERSION, 0 if it does not tell
uint32 baud  # [Bd]
float64 rate  # [Hz] samples a second, as asked for
""",
)

IMU_SAMPLE = Layout(
    "ramstroke_msgs/msg/ImuSample",
    "# One inertial sample in the sensor's axes; specific force, +g on the axis that points up\n"
    + _TIME
    + """\
float64 gyro_x  # [rad/s]
float64 gyro_y  # [rad/s]
float64 gyro_z  # [rad/s]
float64 accel_x  # [m/s^2]
float64 accel_y  # [m/s^2]
float64 accel_z  # [m/s^2]
float64 temperature  # [degC], NaN when not measured
"""
    + _TIME_KIND,
)

CAN_FRAME = Layout(
    "ramstroke_msgs/msg/CanFrame",
    "# One CAN frame\n"
    + _TIME
    + """\
uint32 arbitration_id  # [-] 11 bits, or 29 when is_extended
bool is_extended
bool is_fd
bool is_error
bool is_remote
uint8[] data  # [-] payload
""",
)

DISPLACEMENT = Layout(
    "ramstroke_msgs/msg/Displacement",
    "# One reading of a displacement sensor\n"
    + _TIME
    + "float64 value  # [m], NaN where the frame holds none\n"
    + _constants("FAULT", ((m.name, m.value) for m in ReadingFault))
    + """\
uint8 fault  # what the reading itself shows to be wrong: FAULT_*
bool decoded  # true: derived from a frame on /can/rx of this recording; false: an input of its own
""",
)

TICK = Layout("ramstroke_msgs/msg/Tick", "# Time passed although no inertial sample came\n" + _TIME)

ESTIMATE = Layout(
    "ramstroke_msgs/msg/Estimate",
    "# State of the stroke at one step, with the reasons behind it\n"
    + _TIME
    + """\
float64 displacement  # [m]
float64 sigma  # [m] 1-sigma of displacement
float64 velocity  # [m/s]
float64 velocity_sigma  # [m/s] 1-sigma of velocity
float64 acceleration  # [m/s^2] along the push axis, levelled: what the chart sees
float64 chart_lower  # [m/s^2]
float64 chart_upper  # [m/s^2]
float64 step  # [m/s] velocity-step statistic
float64 innovation  # [m] last reading minus its prediction, NaN without one
float64 gate  # [m] largest innovation that would have been accepted, NaN without one
uint32 move  # [-] number of the current or last move, 0 before the first
"""
    + _positions(Segment)
    + "uint8 segment  # SEGMENT_*\n"
    + _positions(Tier)
    + "uint8 tier  # TIER_*\n"
    + _positions(CanState)
    + "uint8 can_state  # what the displacement sensor is thought to be: CANSTATE_*\n",
)

MOVE = Layout(
    "ramstroke_msgs/msg/Move",
    "# Summary of one finished move\n"
    + """\
int64 onset_ns  # [ns] start of acceleration, monotonic clock of the recording
int64 stop_ns  # [ns] start of deceleration
float64 start  # [m]
float64 end  # [m]
float64 sigma  # [m] 1-sigma of end
float64 end_before_stop  # [m] before any mechanical-stop constraint
float64 sigma_before_stop  # [m]
float64 velocity  # [m/s] signed mean speed of the constant-velocity segment
uint32 number  # [-]
"""
    + _positions(MoveKind)
    + "uint8 kind  # MOVEKIND_*\n"
    + _positions(CanState)
    + "uint8 can_state  # CANSTATE_*\n"
    + _positions(Tier)
    + "uint8 tier  # TIER_*\n",
)

EVENT = Layout("ramstroke_msgs/msg/Event", "# Something that happened, in words\n" + _TIME + "string what  # [text]\n")

LOG = Layout(
    "rcl_interfaces/msg/Log",
    """\
# One line of the program's log; the standard type, which viewers show as a log
uint8 DEBUG=10
uint8 INFO=20
uint8 WARN=30
uint8 ERROR=40
uint8 FATAL=50
builtin_interfaces/Time stamp  # [s, ns] monotonic clock of the recording
uint8 level  # DEBUG to FATAL
string name  # [text] logger
string msg  # [text]
string file  # [text] always empty
string function  # [text] always empty
uint32 line  # [-] always 0
================================================================================
MSG: builtin_interfaces/Time
int32 sec  # [s]
uint32 nanosec  # [ns]
""",
)

HEALTH = Layout(
    "ramstroke_msgs/msg/Health",
    "# Health of the program\n" + _TIME + "string json  # [text] one JSON object\n",
)
