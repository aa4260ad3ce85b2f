//! The integrator's state on the wire.

use serde::de::{Error as _, SeqAccess};
use serde::ser::SerializeTuple;
use serde::{Deserialize, Serialize};
use wimu_integrator::{Config, Flags, Phase, RotationState, Run, Segment, State, Window};
use wimu_model::PeriodNs;

/// Wire form of [`wimu_integrator::State`].
/// [`Integrator::from_state`](wimu_integrator::Integrator::from_state) validates it.
///
/// In an epoch its revision precedes it, and it is the last field, so that a host that does not know the
/// revision can decode the epoch: [`is_ours`](Self::is_ours) is false then, and all other fields are 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct WireState {
    /// Revision of the arithmetic, and of the following fields.
    pub revision: u8,
    /// Sample period, ns.
    pub period_ns: u32,
    /// Whether zero-velocity updates (ZUPT) are applied.
    pub zupt: bool,
    /// Magnitude of local gravity, µm/s².
    pub gravity_um_s2: u32,
    /// Its phase.
    pub phase: WirePhase,
    /// The bits of [`Flags`].
    pub flags: u8,
    /// Mean specific force over the latest rest, 2⁻³² m/s², integration axes: body axes without a
    /// gyroscope, with one the body axes of the first rest, fixed to the earth.
    pub rest_mean: [i64; 3],
    /// Direction of east in integration axes, 2⁻³⁰ per LSB.
    pub east: [i32; 3],
    /// Position at the start of the segment, nm, east-north-up.
    pub base_position_nm: [i64; 3],
    /// Velocity at the start of the segment, nm/s, east-north-up.
    pub base_velocity_nmps: [i64; 3],
    /// Time from the latest rest to the start of the segment, ns.
    pub base_since_rest_ns: u64,
    /// The segment: samples since then.
    pub segment: WireSegment,
    /// The present window of the stationarity detector.
    pub window: WireWindow,
    /// The preceding windows at rest.
    pub run: Option<WireRun>,
    /// Standard deviation of the heading against magnetic north, mrad; `None`: uncalibrated.
    pub heading_sd_mrad: Option<u16>,
    /// Rotation, since revision 2; `None`: no gyroscope.
    pub rotation: Option<WireRotation>,
}

/// Revision of the results of `wimu_model::Corrector` and `wimu_integrator::Integrator`, bit for bit, and of
/// their state. It changes with any change of a result.
///
/// The results of revision 1 are those of revision 2 without a gyroscope.
pub const ARITHMETIC_REVISION: u8 = 2;

/// The first revision with a rotation.
const ROTATION_SINCE: u8 = 2;

/// The fields of a state of revision 1.
type Fields = (
    (u32, bool, u32, WirePhase, u8),
    ([i64; 3], [i32; 3], [i64; 3], [i64; 3], u64),
    (WireSegment, WireWindow, Option<WireRun>, Option<u16>),
);

impl WireState {
    /// Whether this crate has the arithmetic of its revision, so that samples can be replayed from it.
    pub fn is_ours(&self) -> bool {
        matches!(self.revision, 1..=ARITHMETIC_REVISION)
    }

    /// Writes all fields except the revision.
    pub(super) fn write<T: SerializeTuple>(&self, fields: &mut T) -> Result<(), T::Error> {
        let state: Fields = (
            (self.period_ns, self.zupt, self.gravity_um_s2, self.phase, self.flags),
            (
                self.rest_mean,
                self.east,
                self.base_position_nm,
                self.base_velocity_nmps,
                self.base_since_rest_ns,
            ),
            (self.segment, self.window, self.run, self.heading_sd_mrad),
        );
        fields.serialize_element(&state)?;
        match self.revision {
            0..ROTATION_SINCE => Ok(()),
            _ => fields.serialize_element(&self.rotation),
        }
    }

    /// Reads what [`write`](Self::write) writes; nothing of an unknown revision.
    pub(super) fn read<'de, A: SeqAccess<'de>>(
        revision: u8,
        fields: &mut A,
    ) -> Result<Self, A::Error> {
        let state = Self::of_revision(revision);
        if !state.is_ours() {
            return Ok(state);
        }
        let read: Option<Fields> = fields.next_element()?;
        let (first, second, third) = read.ok_or_else(|| A::Error::missing_field("state"))?;
        let (period_ns, zupt, gravity_um_s2, phase, flags) = first;
        let (rest_mean, east, base_position_nm, base_velocity_nmps, base_since_rest_ns) = second;
        let (segment, window, run, heading_sd_mrad) = third;
        let missing = || A::Error::missing_field("rotation");
        let rotation = match revision {
            0..ROTATION_SINCE => None,
            _ => fields.next_element()?.ok_or_else(missing)?,
        };
        Ok(Self {
            revision,
            period_ns,
            zupt,
            gravity_um_s2,
            phase,
            flags,
            rest_mean,
            east,
            base_position_nm,
            base_velocity_nmps,
            base_since_rest_ns,
            segment,
            window,
            run,
            heading_sd_mrad,
            rotation,
        })
    }

    /// A state with only a revision.
    fn of_revision(revision: u8) -> Self {
        Self {
            revision,
            period_ns: 0,
            zupt: false,
            gravity_um_s2: 0,
            phase: WirePhase::default(),
            flags: 0,
            rest_mean: [0; 3],
            east: [0; 3],
            base_position_nm: [0; 3],
            base_velocity_nmps: [0; 3],
            base_since_rest_ns: 0,
            segment: WireSegment::default(),
            window: WireWindow::default(),
            run: None,
            heading_sd_mrad: None,
            rotation: None,
        }
    }
}

impl Default for WireState {
    fn default() -> Self {
        Self::of_revision(ARITHMETIC_REVISION)
    }
}

/// Wire form of [`Phase`]. Append only.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum WirePhase {
    /// No rest has been seen yet.
    #[default]
    Searching,
    /// At rest.
    Resting,
    /// Between rests.
    Moving,
}

/// Wire form of [`Segment`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct WireSegment {
    /// Steps taken.
    pub steps: u32,
    /// Velocity, 2⁻¹⁷·Δt m/s, integration axes.
    pub velocity_sum: [i64; 3],
    /// Position, 2⁻¹⁸·Δt² m, integration axes.
    pub position_sum: [i64; 3],
    /// Latest sample minus gravity (rounded to 2⁻¹⁶ m/s²), 2⁻¹⁶ m/s².
    pub previous: Option<[i32; 3]>,
}

/// Wire form of [`Window`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct WireWindow {
    /// The segment at the start of the window.
    pub start: WireSegment,
    /// Samples so far.
    pub samples: u16,
    /// The window's first sample, 2⁻¹⁶ m/s².
    pub reference: [i32; 3],
    /// Σ of the samples less the reference, 2⁻¹⁰ m/s².
    pub sum: [i32; 3],
    /// Σ of their squares, 2⁻²⁰ m²/s⁴.
    pub squares: u64,
}

/// Wire form of [`Run`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct WireRun {
    /// Number of windows.
    pub windows: u16,
    /// Σ (f_k + f_k+1) over all windows except the latest, 2⁻¹⁶ m/s².
    pub sum: [i64; 3],
    /// Σ (f_k + f_k+1) over the latest window, 2⁻¹⁶ m/s².
    pub latest: [i64; 3],
    /// The segment at the end of the first window.
    pub start: WireSegment,
}

/// Wire form of [`RotationState`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct WireRotation {
    /// Quaternion w, x, y, z from body to integration axes, 2⁻⁵⁹.
    pub quaternion: [i64; 4],
    /// Latest angular rate minus bias, 2⁻²⁰ rad/s.
    pub previous: Option<[i32; 3]>,
    /// Part of the latest half angle below 2⁻²⁹ rad, 2⁻⁶¹ rad.
    pub remainder: [u32; 3],
    /// Bias of the gyroscope at the latest rest, 2⁻²⁰ rad/s.
    pub bias: [i32; 3],
    /// Σ of the angular rates of the window, 2⁻²⁰ rad/s.
    pub window: [i64; 3],
    /// Σ of the angular rates over all windows of the run except the latest, 2⁻²⁰ rad/s.
    pub sum: [i64; 3],
    /// Σ of the angular rates over the latest window of the run, 2⁻²⁰ rad/s.
    pub latest: [i64; 3],
}

impl From<Phase> for WirePhase {
    fn from(phase: Phase) -> Self {
        match phase {
            Phase::Searching => Self::Searching,
            Phase::Resting => Self::Resting,
            Phase::Moving => Self::Moving,
        }
    }
}

impl From<WirePhase> for Phase {
    fn from(phase: WirePhase) -> Self {
        match phase {
            WirePhase::Searching => Self::Searching,
            WirePhase::Resting => Self::Resting,
            WirePhase::Moving => Self::Moving,
        }
    }
}

// Both directions name every field, so a field added to the state cannot be forgotten here.

/// Both conversions of a struct whose fields are equal or converted with `into()`.
macro_rules! mirror {
    ($wire:ident, $model:ident, [$($same:ident),*], [$($into:ident),*]) => {
        impl From<$model> for $wire {
            fn from($model { $($same,)* $($into,)* }: $model) -> Self {
                Self { $($same,)* $($into: $into.into(),)* }
            }
        }

        impl From<$wire> for $model {
            fn from($wire { $($same,)* $($into,)* }: $wire) -> Self {
                Self { $($same,)* $($into: $into.into(),)* }
            }
        }
    };
}

mirror!(WireSegment, Segment, [steps, velocity_sum, position_sum, previous], []);
mirror!(WireWindow, Window, [samples, reference, sum, squares], [start]);
mirror!(WireRun, Run, [windows, sum, latest], [start]);
mirror!(
    WireRotation,
    RotationState,
    [quaternion, previous, remainder, bias, window, sum, latest],
    []
);

impl From<State> for WireState {
    fn from(state: State) -> Self {
        Self {
            revision: ARITHMETIC_REVISION,
            period_ns: state.config.period.0,
            zupt: state.config.zupt,
            gravity_um_s2: state.config.gravity_um_s2,
            phase: state.phase.into(),
            flags: state.flags.0,
            rest_mean: state.rest_mean,
            east: state.east,
            base_position_nm: state.base_position_nm,
            base_velocity_nmps: state.base_velocity_nmps,
            base_since_rest_ns: state.base_since_rest_ns,
            segment: state.segment.into(),
            window: state.window.into(),
            run: state.run.map(WireRun::from),
            heading_sd_mrad: state.heading_sd_mrad,
            rotation: state.rotation.map(WireRotation::from),
        }
    }
}

impl From<WireState> for State {
    fn from(wire: WireState) -> Self {
        Self {
            config: Config {
                period: PeriodNs(wire.period_ns),
                zupt: wire.zupt,
                gravity_um_s2: wire.gravity_um_s2,
            },
            phase: wire.phase.into(),
            flags: Flags(wire.flags),
            rest_mean: wire.rest_mean,
            east: wire.east,
            base_position_nm: wire.base_position_nm,
            base_velocity_nmps: wire.base_velocity_nmps,
            base_since_rest_ns: wire.base_since_rest_ns,
            segment: wire.segment.into(),
            window: wire.window.into(),
            run: wire.run.map(Run::from),
            heading_sd_mrad: wire.heading_sd_mrad,
            rotation: wire.rotation.map(RotationState::from),
        }
    }
}
