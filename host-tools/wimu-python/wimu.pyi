"""Recordings, calibration, noise and paths of accelerometers and IMUs.

All values are in SI units unless a name says otherwise; temperatures are in °C. Sensor axes are those of the data, body
axes those of the alignment in a CAL.json (without one they are the sensor axes), navigation axes are east-north-up.
Every failure raises WimuError; an argument of a wrong type raises TypeError.
"""

from collections.abc import Sequence
from os import PathLike
from typing import Any, Literal, TypedDict, Union

import numpy as np
from numpy.typing import ArrayLike, NDArray

_Path = Union[str, PathLike[str]]
_Floats = NDArray[np.float64]
_Flags = NDArray[np.bool_]

class WimuError(Exception):
    """A failure."""

    code: str
    """For programs: `file_unreadable`, `unknown_format`, `usage`, `no_rows`, `data_refused`, …"""
    message: str
    """What is wrong."""
    where: str | None
    """File, line and column, or name of the recording."""
    remedy: str
    """What to do."""

class Finding(TypedDict, total=False):
    """Something noticed in data."""

    code: str
    severity: Literal["note", "warning", "error"]
    evidence: str
    remedy: str
    sensor: int
    span_s: list[float]
    """First and last time, s since the recording's first sample."""

class Track:
    """One quantity of one sensor over time, n rows. Its arrays are read-only."""

    name: str
    """Topic, message or columns in the file."""
    quantity: str
    """`specific force`, `angular rate`, `magnetic field`, `temperature`, `attitude`, `position`, …"""
    unit: str
    """`m/s²`, `rad/s`, `T`, `°C`, …; `LSB` for counts; `unknown`."""
    si_per_lsb: float | None
    """SI units of one count, where the file gives it."""
    sensor: int
    """Index of the sensor, from 0."""
    origin: str
    """`sensor`, `estimate` (a filter on the device) or `truth` (a reference system)."""
    corrected: bool
    """Whether the device corrected the values by a calibration."""
    rate_hz: float | None
    """Nominal rate, else that of the median step; None without times."""
    times: _Floats
    """s on the clock of the file, shape (n,)."""
    times_ns: NDArray[np.int64]
    """The same in ns, exact, shape (n,)."""
    values: _Floats
    """Sensor axes, shape (n, 3); (n,) for one number a row; (n, 4) for quaternions W, X, Y, Z."""
    valid: _Flags
    """Whether a row can be used, shape (n,)."""
    def __len__(self) -> int: ...

class Recording:
    """What was measured: the content of a file (see `read`), or arrays."""

    def __init__(
        self,
        times: ArrayLike,
        specific_force: ArrayLike,
        *,
        angular_rate: ArrayLike | None = None,
        magnetic_field: ArrayLike | None = None,
        temperature: ArrayLike | None = None,
        unit: Literal["m/s2", "m/s²", "LSB"] = "m/s2",
        poses: bool = False,
        name: str = "arrays",
    ) -> None:
        """Arrays as a recording: times, s, shape (n,); specific force in `unit`, angular rate, rad/s, and magnetic
        field, T, shape (n, 3); temperature, °C, shape (n,). Rows that are not finite or earlier than a row before are
        masked and reported. With `poses` each row is the mean of one static pose.
        """

    @property
    def name(self) -> str: ...
    @property
    def format(self) -> str:
        """As docs/reference/formats.md names it."""

    @property
    def tracks(self) -> list[Track]: ...
    @property
    def findings(self) -> list[Finding]: ...

_Source = Union[Recording, _Path]

def read(
    path: _Path,
    *,
    topic: str | None = None,
    columns: str | None = None,
    units: str | None = None,
    where: str | None = None,
    format: str | None = None,
    zero_count: float | None = None,
    link: Literal["cable", "wireless"] | None = None,
    poses: bool = False,
) -> Recording:
    """Reads a recording of any format in docs/reference/formats.md, detected by content.

    topic: topic, message or log, where the file has several.
    columns: columns of a table, such as "t=timestamp:ns,x=ax:g,y=ay:g,z=az:g".
    units: unit of accelerations that the file does not name: m/s2, g, mg or LSB.
    where: rows of a table to use, such as "Run=2,IMU=0".
    format: the format instead of the detected one.
    zero_count: count at zero acceleration.
    link: link of a recording of wimu; by default the cable if it was recorded.
    poses: each row of the table is the mean of one static pose.
    """

class Calibration:
    """An error model with its uncertainty, sensor axes: output = matrix @ specific force + bias.

    In m/s²; of counts, the output is counts / sensitivity · 9.80665 m/s².
    """

    @property
    def bias(self) -> _Floats:
        """m/s², shape (3,)."""

    @property
    def matrix(self) -> _Floats:
        """Scale factors and misalignments, shape (3, 3)."""

    @property
    def bias_sd(self) -> _Floats:
        """Standard deviation of `bias`, m/s², shape (3,)."""

    @property
    def matrix_sd(self) -> _Floats:
        """Standard deviations of `matrix`, shape (3, 3); 0 for what was not fitted."""

    @property
    def covariance(self) -> _Floats:
        """Covariance of `bias`, then of `matrix` row by row, shape (12, 12)."""

    @property
    def rms(self) -> float:
        """|f| − g over the poses after correction, m/s² rms."""

    @property
    def poses(self) -> int:
        """Number of static poses."""

    @property
    def sensitivity(self) -> float | None:
        """Nominal sensitivity, LSB/g; None for data in m/s² without a given one."""

    @property
    def findings(self) -> list[Finding]: ...
    def save(self, path: _Path) -> None:
        """Writes the CAL.json that `wimu calibrate -o` writes."""

    def to_dict(self) -> dict[str, Any]:
        """The object that `wimu calibrate --json` prints."""

def calibrate(
    source: _Source,
    *,
    method: Literal["multi-position", "six-position", "four-angle", "three-angle"] = "multi-position",
    model: str = "",
    sides: list[str] | None = None,
    gravity: float | None = None,
    sensitivity: float | None = None,
    range_g: int | None = None,
    placement_sd: float | None = None,
    sensor_model: str | None = None,
    accelerometer: int | None = None,
) -> Calibration:
    """Estimates the error model of an accelerometer from rests in different orientations.

    model: 3, 6, 9 or auto, with +drift, +temperature or +quadratic; "" is that of the method.
    sides: of six-position, the side that is up in each pose: x, -x, y, -y, z, -z.
    gravity: local gravity, m/s²; by default 9.80665 ± 0.015.
    sensitivity: nominal sensitivity of counts, LSB/g.
    range_g: full-scale range, ± g, where the file does not contain it.
    placement_sd: placement error of known orientations, degrees, 1 σ; by default 1.
    sensor_model: datasheet to compare with, such as "MPU-6050".
    accelerometer: index of the accelerometer, where there are several.

    Raises WimuError with code `data_refused` where the data do not determine a result.
    """

class Noise:
    """Noise of an accelerometer at rest, or of a gyroscope: rad/s wherever m/s² is written here. Arrays of shape (3,) hold
    X, Y, Z; NaN where a term is not observed."""

    @property
    def tau(self) -> _Floats:
        """Averaging times, s, shape (k,)."""

    @property
    def deviation(self) -> _Floats:
        """Allan deviation, m/s², shape (k, 3)."""

    @property
    def deviation_sd(self) -> _Floats:
        """Standard deviation of `deviation`, m/s², shape (k, 3)."""

    @property
    def noise_density(self) -> _Floats:
        """One-sided, m/s²/√Hz, shape (3,)."""

    @property
    def noise_density_sd(self) -> _Floats: ...
    @property
    def velocity_random_walk(self) -> _Floats:
        """Noise density / √2, m/s/√s, shape (3,)."""

    @property
    def angle_random_walk(self) -> _Floats:
        """Of a gyroscope: noise density / √2, rad/s/√Hz, shape (3,)."""

    @property
    def angle_random_walk_sd(self) -> _Floats: ...
    @property
    def gyroscope(self) -> Noise | None:
        """The noise of the gyroscope beside the accelerometer, or of the gyroscope alone."""

    @property
    def bias_instability(self) -> _Floats:
        """m/s², shape (3,)."""

    @property
    def bias_instability_sd(self) -> _Floats: ...
    @property
    def rate_hz(self) -> float: ...
    @property
    def findings(self) -> list[Finding]: ...
    def to_dict(self) -> dict[str, Any]:
        """The object that `wimu allan --json` prints."""

def allan(source: _Source, *, sensitivity: float | None = None, accelerometer: int | None = None) -> Noise:
    """Computes the Allan deviation of an accelerometer at rest, of the gyroscope beside it, or of a gyroscope alone.

    sensitivity: of counts, LSB/g; by default that of the file, else such that gravity is 1 g.

    Raises WimuError with code `data_refused` where the recording is too short.
    """

class Corrected:
    """Corrected samples, body axes: the m valid rows of the recording. NaN where a row has no value."""

    times: _Floats
    """s on the clock of the file, shape (m,)."""
    specific_force: _Floats
    """m/s², shape (m, 3)."""
    angular_rate: _Floats | None
    """rad/s, shape (m, 3)."""
    magnetic_field: _Floats | None
    """T, shape (m, 3); as measured where the magnetometer is not calibrated."""
    temperature: _Floats | None
    """°C, shape (m,)."""
    findings: list[Finding]

def apply(calibration: Calibration | _Path, source: _Source, *, output: _Path | None = None) -> Corrected:
    """Corrects a recording with a calibration or a CAL.json, of the same unit.

    output: also written to this file, as CSV, or as ROS 2 messages where its name ends in .mcap.
    """

class Move:
    """A move between two rests."""

    start: float
    """s on the clock of the recording."""
    end: float
    length: float
    """m."""
    length_sd: float
    """Standard deviation of `length`, m, if the unit was at rest before and after."""
    tilted: float
    """Angle by which gravity rotated in the body frame, rad."""
    valid: bool
    """Whether the length is known: without a gyroscope not after a rotation."""

class Path:
    """A path with its uncertainty, n rows, one a sample, east-north-up axes."""

    @property
    def times(self) -> _Floats:
        """s on the clock of the recording, shape (n,)."""

    @property
    def position(self) -> _Floats:
        """m, shape (n, 3)."""

    @property
    def velocity(self) -> _Floats:
        """m/s, shape (n, 3)."""

    @property
    def attitude(self) -> _Floats:
        """Quaternion W, X, Y, Z from body to navigation axes, shape (n, 4)."""

    @property
    def angular_rate(self) -> _Floats:
        """rad/s, body axes, shape (n, 3)."""

    @property
    def position_covariance(self) -> _Floats:
        """m², shape (n, 3, 3)."""

    @property
    def position_sd(self) -> _Floats:
        """m, shape (n, 3)."""

    @property
    def velocity_sd(self) -> _Floats:
        """m/s, shape (n, 3); 0 where it is not estimated."""

    @property
    def attitude_sd(self) -> _Floats:
        """rad about east, north and up, shape (n, 3); 0 where it is not estimated."""

    @property
    def valid(self) -> _Flags:
        """Whether the position can be used: σ below `limit`, no gap since the last rest, shape (n,)."""

    @property
    def resting(self) -> _Flags:
        """Whether the unit is taken to be at rest, shape (n,)."""

    @property
    def origin(self) -> int:
        """Row at which position and velocity are zero by definition."""

    @property
    def distance(self) -> float:
        """Length of the path over the valid rows, m."""

    @property
    def moves(self) -> list[Move]:
        """Moves between rests."""

    @property
    def method(self) -> str: ...
    @property
    def findings(self) -> list[Finding]: ...
    def save(self, path: _Path) -> None:
        """Writes CSV, or ROS 2 odometry, path and transforms where the name ends in .mcap."""

    def __len__(self) -> int: ...

def navigate(
    source: _Source,
    *,
    calibration: Calibration | _Path | None = None,
    profile: Literal["hand", "foot", "vehicle", "free"] = "hand",
    zupt: Literal["on", "cautious", "off"] = "on",
    within: float | None = None,
    rests: Sequence[tuple[float, float]] | None = None,
    start: tuple[float, float, float, float | None] | None = None,
    smooth: bool = True,
    limit: float = 1.0,
    sensitivity: float | None = None,
) -> Path:
    """Computes position, velocity and attitude of one unit.

    calibration: corrects the samples; without it they are taken as corrected, or as the device corrects them.
    profile: what is assumed of the motion. hand: velocity 0 ± 2 m/s; foot: rests are stances; vehicle: motion along
    its forward axis, 0 ± 30 m/s; free: nothing.
    zupt: velocity is zero at rests; cautious: an unknown constant of 0 ± 0.1 m/s; off: rests are not used.
    within: the unit stays within this distance of its start, m, 1 σ of a component.
    rests: times at which the unit rested, s, as in the file; None: those that are detected.
    start: position, m, east-north-up, and heading of body x from east towards north, rad, or None.
    smooth: each point rests on the whole recording; otherwise on the samples before it.
    limit: standard deviation up to which a position is valid, m.
    sensitivity: of counts, LSB/g, where neither calibration nor file gives it.
    """
