//! The integrator's state on the wire.

use core::fmt;

use serde::de::{self, Deserializer, SeqAccess, Visitor};
use serde::{Deserialize, Serialize};
use wimu_integrator::{Config, Flags, Phase, Run, Segment, State, Window};
use wimu_model::PeriodNs;

/// [`wimu_integrator::State`] as it travels, field by field. Whether it is one that an integrator
/// can be in, [`Integrator::from_state`](wimu_integrator::Integrator::from_state) finds out.
///
/// It is the last of an epoch and begins with its revision, so that a host that knows another one
/// still reads the epoch: [`is_ours`](Self::is_ours) is false then, and all other fields are 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct WireState {
    /// The revision of the arithmetic that made it, and of the fields that follow.
    pub revision: u8,
    /// Sample period, ns.
    pub period_ns: u32,
    /// Whether velocity is taken as zero at every rest.
    pub zupt: bool,
    /// Magnitude of local gravity, µm/s².
    pub gravity_um_s2: u32,
    /// Where it stands.
    pub phase: WirePhase,
    /// What is wrong: the bits of [`Flags`].
    pub flags: u8,
    /// Mean specific force over the latest rest, 2⁻³² m/s², body axes.
    pub rest_mean: [i64; 3],
    /// Direction of east in body axes, 2⁻³⁰ per LSB.
    pub east: [i32; 3],
    /// Position at the start of the segment, nm, east-north-up.
    pub base_position_nm: [i64; 3],
    /// Velocity at the start of the segment, nm/s, east-north-up.
    pub base_velocity_nmps: [i64; 3],
    /// Time from the latest rest to the start of the segment, ns.
    pub base_since_rest_ns: u64,
    /// The samples since.
    pub segment: WireSegment,
    /// The stillness detector's window.
    pub window: WireWindow,
    /// The quiet windows before it.
    pub run: Option<WireRun>,
    /// Standard deviation of the heading against magnetic north, mrad; `None`: uncalibrated.
    pub heading_sd_mrad: Option<u16>,
}

/// The revision of what `wimu_model::Corrector` and `wimu_integrator::Integrator` compute, bit for bit,
/// and of their state. Whoever changes a bit of either gives them another one.
pub const ARITHMETIC_REVISION: u8 = 1;

impl WireState {
    /// Whether this crate's revision made it: only then can samples be replayed from it.
    pub fn is_ours(&self) -> bool {
        self.revision == ARITHMETIC_REVISION
    }

    /// One that says nothing but its revision.
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
        }
    }
}

impl Default for WireState {
    fn default() -> Self {
        Self::of_revision(ARITHMETIC_REVISION)
    }
}

impl<'de> Deserialize<'de> for WireState {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        /// The fields behind the revision, in their order.
        type Fields = (
            (u32, bool, u32, WirePhase, u8),
            ([i64; 3], [i32; 3], [i64; 3], [i64; 3], u64),
            (WireSegment, WireWindow, Option<WireRun>, Option<u16>),
        );
        struct Revised;

        impl<'de> Visitor<'de> for Revised {
            type Value = WireState;

            fn expecting(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
                out.write_str("an integrator's state")
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<WireState, A::Error> {
                let missing = || de::Error::missing_field("state");
                let revision = seq.next_element()?.ok_or_else(missing)?;
                if revision != ARITHMETIC_REVISION {
                    return Ok(WireState::of_revision(revision));
                }
                let fields: Fields = seq.next_element()?.ok_or_else(missing)?;
                let (first, second, (segment, window, run, heading_sd_mrad)) = fields;
                let (period_ns, zupt, gravity_um_s2, phase, flags) = first;
                let (rest_mean, east, base_position_nm, base_velocity_nmps, base_since_rest_ns) =
                    second;
                Ok(WireState {
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
                })
            }
        }

        deserializer.deserialize_tuple(2, Revised)
    }
}

/// [`Phase`] as it travels. Append only.
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

/// [`Segment`] as it travels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct WireSegment {
    /// Steps taken.
    pub steps: u32,
    /// Velocity, 2⁻¹⁷·Δt m/s, body axes.
    pub velocity_sum: [i64; 3],
    /// Position, 2⁻¹⁸·Δt² m, body axes.
    pub position_sum: [i64; 3],
    /// The latest sample, 2⁻¹⁶ m/s².
    pub previous: Option<[i32; 3]>,
}

/// [`Window`] as it travels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct WireWindow {
    /// The segment as it stood when the window began.
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

/// [`Run`] as it travels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct WireRun {
    /// How many windows.
    pub windows: u16,
    /// Sum over all of them but the latest, 2⁻¹⁶ m/s².
    pub sum: [i64; 3],
    /// Sum over the latest, 2⁻¹⁶ m/s².
    pub latest: [i64; 3],
    /// The segment as it stood when the first window ended.
    pub start: WireSegment,
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

// The patterns name every field, so that a field added to the state cannot be forgotten here.

/// Both directions of a struct whose fields travel as they are, or through `into()`.
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

mirror!(
    WireSegment,
    Segment,
    [steps, velocity_sum, position_sum, previous],
    []
);
mirror!(
    WireWindow,
    Window,
    [samples, reference, sum, squares],
    [start]
);
mirror!(WireRun, Run, [windows, sum, latest], [start]);

impl From<State> for WireState {
    fn from(state: State) -> Self {
        let State {
            config:
                Config {
                    period: PeriodNs(period_ns),
                    zupt,
                    gravity_um_s2,
                },
            phase,
            flags: Flags(flags),
            rest_mean,
            east,
            base_position_nm,
            base_velocity_nmps,
            base_since_rest_ns,
            segment,
            window,
            run,
            heading_sd_mrad,
        } = state;
        Self {
            revision: ARITHMETIC_REVISION,
            period_ns,
            zupt,
            gravity_um_s2,
            phase: phase.into(),
            flags,
            rest_mean,
            east,
            base_position_nm,
            base_velocity_nmps,
            base_since_rest_ns,
            segment: segment.into(),
            window: window.into(),
            run: run.map(WireRun::from),
            heading_sd_mrad,
        }
    }
}

impl From<WireState> for State {
    fn from(wire: WireState) -> Self {
        let WireState {
            revision: _,
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
        } = wire;
        Self {
            config: Config {
                period: PeriodNs(period_ns),
                zupt,
                gravity_um_s2,
            },
            phase: phase.into(),
            flags: Flags(flags),
            rest_mean,
            east,
            base_position_nm,
            base_velocity_nmps,
            base_since_rest_ns,
            segment: segment.into(),
            window: window.into(),
            run: run.map(Run::from),
            heading_sd_mrad,
        }
    }
}
