//! The complete state of the integrator, as carried by an epoch message.

use core::fmt;

use wimu_model::PeriodNs;

use crate::inertial::RotationState;
use crate::segment::Segment;
use crate::stationarity::{Run, Window};

/// Configuration of the integrator.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Config {
    /// Sample period, 100 µs to 1 s.
    pub period: PeriodNs,
    /// Zero-velocity updates: every rest sets the velocity to zero and gravity to the measured
    /// specific force. Off: only the first rest aligns, and gravity has the magnitude below.
    pub zupt: bool,
    /// Magnitude of local gravity, µm/s², 9.7 to 9.9 m/s².
    pub gravity_um_s2: u32,
}

impl Config {
    /// Standard gravity, ZUPT on.
    ///
    /// # Errors
    /// [`ConfigError::Period`] outside 100 µs..=1 s.
    pub fn new(period: PeriodNs) -> Result<Self, ConfigError> {
        Self { period, zupt: true, gravity_um_s2: 9_806_650 }.checked()
    }

    /// Checks the ranges.
    ///
    /// # Errors
    /// [`ConfigError`] names the field that is outside its range.
    pub fn checked(self) -> Result<Self, ConfigError> {
        if !(100_000..=1_000_000_000).contains(&self.period.0) {
            Err(ConfigError::Period(self.period))
        } else if !(9_700_000..=9_900_000).contains(&self.gravity_um_s2) {
            Err(ConfigError::Gravity(self.gravity_um_s2))
        } else {
            Ok(self)
        }
    }
}

/// Phase of the integration.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Phase {
    /// No rest yet: attitude, velocity and position are unknown.
    #[default]
    Searching,
    /// At rest: velocity is zero, position is held, gravity is averaged.
    Resting,
    /// Between rests.
    Moving,
}

/// Faults of the current leg, or of an earlier one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Flags(pub u8);

impl Flags {
    /// Samples were missed in this leg.
    pub const GAP: Self = Self(1);
    /// An axis was saturated in this leg.
    pub const SATURATED: Self = Self(2);
    /// The direction of gravity changed since the start of the leg: the unit rotated. Not with a
    /// gyroscope.
    pub const TURNED: Self = Self(4);
    /// The position exceeded the numeric range.
    pub const OUT_OF_RANGE: Self = Self(8);
    /// An earlier leg was invalid: the position includes its error.
    pub const POSITION_LOST: Self = Self(16);
    /// An axis of the gyroscope was saturated in this leg: the attitude is lost.
    pub const GYROSCOPE_SATURATED: Self = Self(32);

    /// The union of both sets.
    #[must_use]
    pub const fn with(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    /// Whether all of `other` are set.
    pub const fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }

    /// Whether no fault is set.
    pub const fn is_valid(self) -> bool {
        self.0 == 0
    }

    /// The flags at the start of the next leg.
    pub(crate) const fn for_next_leg(self) -> Self {
        if self.is_valid() { self } else { Self::POSITION_LOST }
    }
}

/// Everything that determines the future outputs of the integrator.
///
/// [`Integrator::state`](crate::Integrator::state) returns it, and
/// [`Integrator::from_state`](crate::Integrator::from_state) continues from it, bit for bit, on any
/// target.
///
/// Vectors are in integration axes: body axes without a gyroscope, with one the body axes of the first
/// rest, fixed to the earth.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct State {
    /// Configuration.
    pub config: Config,
    /// Phase.
    pub phase: Phase,
    /// Faults.
    pub flags: Flags,
    /// Mean specific force over the latest rest, 2⁻³² m/s², integration axes.
    pub rest_mean: [i64; 3],
    /// Direction of east in integration axes, 2⁻³⁰ per LSB: held from the previous rest, or from the
    /// compass at this one.
    pub east: [i32; 3],
    /// Position at the start of the segment, nm, navigation frame.
    pub base_position_nm: [i64; 3],
    /// Velocity at the start of the segment, nm/s, navigation frame.
    pub base_velocity_nmps: [i64; 3],
    /// Time from the latest rest to the start of the segment, ns.
    pub base_since_rest_ns: u64,
    /// The samples since the start of the segment.
    pub segment: Segment,
    /// Window of the stationarity detector.
    pub window: Window,
    /// The preceding quiet windows, if any.
    pub run: Option<Run>,
    /// Standard deviation of the heading at the latest rest relative to magnetic north, mrad;
    /// `None` if uncalibrated: the heading is held from the previous rest.
    pub heading_sd_mrad: Option<u16>,
    /// Rotation from a gyroscope, if there is one.
    pub rotation: Option<RotationState>,
}

impl Default for State {
    /// All zeros, from which no integrator continues.
    fn default() -> Self {
        Self {
            config: Config { period: PeriodNs(0), zupt: false, gravity_um_s2: 0 },
            phase: Phase::Searching,
            flags: Flags(0),
            rest_mean: [0; 3],
            east: [0; 3],
            base_position_nm: [0; 3],
            base_velocity_nmps: [0; 3],
            base_since_rest_ns: 0,
            segment: Segment::default(),
            window: Window::default(),
            run: None,
            heading_sd_mrad: None,
            rotation: None,
        }
    }
}

/// A configuration outside its range.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ConfigError {
    /// The sample period is outside 100 µs..=1 s.
    Period(PeriodNs),
    /// Local gravity, µm/s², is outside 9.7..=9.9 m/s².
    Gravity(u32),
}

impl fmt::Display for ConfigError {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Period(period) => {
                write!(out, "sample period {} ns is outside 100000 to 1000000000 ns", period.0)
            }
            Self::Gravity(gravity) => {
                write!(out, "local gravity {gravity} µm/s² is outside 9700000 to 9900000 µm/s²")
            }
        }
    }
}

impl core::error::Error for ConfigError {}

/// Why a state is refused: no integrator can have produced it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum StateError {
    /// Its configuration is outside its range.
    Config(ConfigError),
    /// The mean specific force at rest is zero or beyond ±2³⁷ LSB (32 m/s²).
    Attitude,
    /// The window of the stationarity detector is impossible.
    Stationarity,
    /// The quaternion has not length 1, or a bias or sum of angular rates is out of range.
    Rotation,
}

impl fmt::Display for StateError {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Config(error) => write!(out, "the integrator's state: {error}"),
            Self::Attitude => out.write_str("the integrator's state has no attitude"),
            Self::Rotation => out.write_str("the integrator's state has an impossible rotation"),
            Self::Stationarity => out.write_str("the integrator's state has an impossible window"),
        }
    }
}

impl core::error::Error for StateError {}
