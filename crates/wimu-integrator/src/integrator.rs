//! Velocity and position between rests from samples of specific force.

use wimu_model::{PeriodNs, PositionNm, SpecificForceQ16, VelocityNmps};

use crate::attitude::{Attitude, DIRECTION_BITS, direction};
use crate::compass::MagneticHeading;
use crate::inertial::{Gyroscope, Inertial, RateTest, RotationState};
use crate::segment::{Segment, billionth, product, round_shift};
use crate::state::{Config, ConfigError, Flags, Phase, State, StateError};
use crate::stationarity::{
    LONGEST_RUN, REST_WINDOWS, Run, TURNED_REST_WINDOWS, Window, window_steps,
};

/// Cosine of the largest change of the direction of gravity within a leg, 2⁻³⁰: 1°.
const TURN_COSINE: i32 = 1_073_578_288;
/// Limit of a sum before it overflows 64 bits.
const SUM_LIMIT: u64 = 1 << 62;

/// Event of a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Transition {
    /// Nothing changed.
    None,
    /// A window of the stationarity detector is complete; the phase is unchanged. The state is at
    /// its smallest now, which suits an epoch message.
    Window,
    /// A rest has begun, or the first one has been found.
    Rest,
    /// A rest has ended.
    Motion,
}

/// Velocity and position after a sample.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Navigation {
    /// Position since the first rest, nm, east-north-up. Without a compass, body x points east at
    /// that rest; with one, north is magnetic.
    pub position: PositionNm,
    /// Velocity, nm/s, east-north-up.
    pub velocity: VelocityNmps,
    /// Time since the velocity was last zero, ms.
    pub since_rest_ms: u32,
    /// Phase; in `Searching`, velocity and position are zero and invalid.
    pub phase: Phase,
    /// Faults.
    pub flags: Flags,
    /// Standard deviation of the heading at the latest rest relative to magnetic north, mrad;
    /// `None` if uncalibrated: north is held from the first rest or from the last compass heading.
    pub heading_sd_mrad: Option<u16>,
    /// Attitude with a gyroscope, after the first rest: quaternion w, x, y, z from body to navigation
    /// axes, 2⁻³⁰.
    pub attitude: Option<[i32; 4]>,
}

/// How far a sample completed the window of the stationarity detector.
pub(crate) enum Progress {
    /// The first sample after a gap: the window starts here.
    Restarted,
    Within,
    Complete,
}

/// Integrates specific force to velocity and position in integers, with the attitude held between
/// rests, or with a gyroscope ([`step_inertial`](Self::step_inertial)) measured.
///
/// Pass every corrected sample in order, and call [`gap`](Self::gap) where some are missing. Rests
/// are detected automatically. The first one aligns (attitude from gravity, velocity zero). With
/// [`Config::zupt`] every later one sets the velocity to zero, distributes the residual velocity
/// over the leg (equation (8)) and aligns again.
///
/// ```
/// use wimu_integrator::{Config, Integrator, Phase};
/// use wimu_model::{PeriodNs, SpecificForceQ16};
///
/// let mut integrator = Integrator::new(Config::new(PeriodNs(10_000_000))?);
/// for _ in 0..100 {
///     integrator.step(SpecificForceQ16([0, 0, 642_689]), false);
/// }
/// let navigation = integrator.navigation();
/// assert_eq!(navigation.phase, Phase::Resting);
/// assert_eq!(navigation.position.to_m(), [0.0; 3]);
/// # Ok::<(), wimu_integrator::ConfigError>(())
/// ```
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Integrator<G = Option<Inertial>> {
    /// Without its rotation.
    pub(crate) state: State,
    pub(crate) inertial: G,
    // Derived from the state.
    /// Of the integration axes.
    pub(crate) attitude: Attitude,
    /// Gravity subtracted from each sample, 2⁻³² m/s².
    gravity: [i64; 3],
    /// `gravity` rounded to 2⁻¹⁶ m/s².
    whole_gravity: [i32; 3],
    pub(crate) window_steps: u16,
}

impl Integrator {
    /// Starts at position zero, searching for a first rest.
    pub fn new(config: Config) -> Self {
        Self::starting(config, None)
    }

    /// Continues from a state of this or another device.
    ///
    /// # Errors
    /// [`StateError`] when the state cannot have come from an integrator.
    pub fn from_state(state: State) -> Result<Self, StateError> {
        let config = state.config.checked().map_err(StateError::Config)?;
        let rotation = state.rotation.map(RotationState::checked).transpose()?;
        let inertial = rotation.map(|rotation| Inertial::from_state(rotation, config.period));
        let mut integrator =
            Self { state: State { rotation: None, ..state }, ..Self::starting(config, inertial) };
        if state.phase != Phase::Searching {
            if state.rest_mean.iter().any(|mean| mean.unsigned_abs() > 1 << 37) {
                return Err(StateError::Attitude);
            }
            integrator.align().ok_or(StateError::Attitude)?;
        }
        let window = &state.window;
        let run = state.run.unwrap_or_default();
        if window.samples >= integrator.window_steps
            || window.sum.iter().any(|sum| sum.unsigned_abs() > 1 << 25)
            || window.squares > 1 << 42
            || state.segment.steps < window.start.steps
            || [run.sum, run.latest].as_flattened().iter().any(|sum| sum.unsigned_abs() > 1 << 48)
        {
            return Err(StateError::Stationarity);
        }
        Ok(integrator)
    }
}

impl Integrator<()> {
    /// Starts at position zero, searching for a first rest, for a sensor without a gyroscope: the code of rotations is
    /// not linked.
    pub fn three_axes(config: Config) -> Self {
        Self::starting(config, ())
    }
}

impl<G: Gyroscope> Integrator<G> {
    fn starting(config: Config, inertial: G) -> Self {
        Self {
            state: State {
                config,
                phase: Phase::Searching,
                flags: Flags::default(),
                rest_mean: [0; 3],
                east: Attitude::LEVEL.east(),
                base_position_nm: [0; 3],
                base_velocity_nmps: [0; 3],
                base_since_rest_ns: 0,
                segment: Segment::default(),
                window: Window::default(),
                run: None,
                heading_sd_mrad: None,
                rotation: None,
            },
            inertial,
            attitude: Attitude::LEVEL,
            gravity: [0; 3],
            whole_gravity: [0; 3],
            window_steps: window_steps(config.period),
        }
    }

    /// Everything that determines the future outputs.
    pub fn state(&self) -> State {
        State { rotation: self.inertial().map(Inertial::state), ..self.state }
    }

    /// Adds the next corrected sample, body axes; `saturated` if any axis was at full scale. For a
    /// sensor without a gyroscope.
    #[inline]
    pub fn step(&mut self, force: SpecificForceQ16, saturated: bool) -> Transition {
        match self.advance(force, saturated) {
            Progress::Complete => self.end_window(RateTest::PASSED),
            Progress::Restarted | Progress::Within => Transition::None,
        }
    }

    /// Adds the next sample, integration axes. Inlined into both kinds of step: an image has one of them.
    #[inline(always)]
    pub(crate) fn advance(&mut self, force: SpecificForceQ16, saturated: bool) -> Progress {
        let stepped = self.state.segment.step(force, self.whole_gravity);
        if saturated {
            self.state.flags = self.state.flags.with(Flags::SATURATED);
        }
        if !stepped {
            self.state.window = Window::starting_at(&self.state.segment);
            self.state.run = None;
            return Progress::Restarted;
        }
        if self.state.window.add(force) < self.window_steps {
            return Progress::Within;
        }
        Progress::Complete
    }

    /// Marks missing samples, or a change of range, rate or parameters, before the next sample. The
    /// leg is flagged; nothing is interpolated, and the attitude is held.
    pub fn gap(&mut self) {
        self.state.segment.previous = None;
        if let Some(inertial) = self.inertial.get_mut() {
            inertial.rotation.gap();
        }
        if self.state.phase == Phase::Moving {
            self.state.flags = self.state.flags.with(Flags::GAP);
        }
    }

    /// Changes the sample period from the next step on; velocity and position continue.
    ///
    /// # Errors
    /// [`ConfigError::Period`] outside 100 µs..=1 s; nothing changes then.
    pub fn set_period(&mut self, period: PeriodNs) -> Result<(), ConfigError> {
        if period == self.state.config.period {
            return Ok(());
        }
        let config = Config { period, ..self.state.config }.checked()?;
        let now = self.navigation();
        self.state.base_position_nm = now.position.0;
        self.state.base_velocity_nmps = now.velocity.0;
        self.state.base_since_rest_ns = self.since_rest_ns(&self.state.segment);
        self.state.config = config;
        self.state.segment =
            Segment { previous: self.state.segment.previous, ..Segment::default() };
        if let Some(inertial) = self.inertial.get_mut() {
            *inertial = inertial.with_period(period);
        }
        self.window_steps = window_steps(period);
        self.state.window = Window::starting_at(&self.state.segment);
        self.state.run = None;
        Ok(())
    }

    /// Replaces the held heading by one from the compass at a rest, until the next rest. Returns
    /// false, without a change, unless the phase is [`Phase::Resting`].
    ///
    /// If the body has moved and the heading changes by more than 10°, it rotated during the motion
    /// or north was unknown: the position is flagged.
    pub fn set_heading(&mut self, heading: MagneticHeading) -> bool {
        self.hold(self.in_integration_axes(heading.east), heading.sd_mrad)
    }

    /// The same with the heading of the state after [`set_heading`](Self::set_heading) elsewhere, so that
    /// a replay is bit-exact.
    pub fn adopt_heading(&mut self, state: &State) -> bool {
        (state.heading_sd_mrad).is_some_and(|sd_mrad| self.hold(state.east, sd_mrad))
    }

    /// Holds a direction of east, integration axes.
    fn hold(&mut self, east: [i32; 3], sd_mrad: u16) -> bool {
        if self.state.phase != Phase::Resting {
            return false;
        }
        let held = self.attitude;
        let before = core::mem::replace(&mut self.state.east, east);
        if self.align().is_none() {
            self.state.east = before;
            return false;
        }
        self.state.heading_sd_mrad = Some(sd_mrad);
        if self.state.base_position_nm != [0; 3] && !self.attitude.is_headed_as(&held) {
            self.state.flags = self.state.flags.with(Flags::POSITION_LOST);
        }
        true
    }

    /// Angle of body x clockwise from north, rad, −π..=π, without a gyroscope held since the latest
    /// rest; `None` before the first. 0 if body x is vertical.
    pub fn heading_rad(&self) -> Option<f64> {
        let x = self.in_integration_axes([1 << DIRECTION_BITS, 0, 0]);
        (self.state.phase != Phase::Searching).then(|| self.attitude.heading_rad(x))
    }

    /// Velocity and position after the latest sample.
    pub fn navigation(&self) -> Navigation {
        let state = &self.state;
        match state.phase {
            Phase::Moving => self.at(&state.segment),
            phase => Navigation {
                position: PositionNm(state.base_position_nm),
                phase,
                flags: state.flags,
                heading_sd_mrad: state.heading_sd_mrad,
                attitude: self.quaternion(),
                ..Navigation::default()
            },
        }
    }

    /// Velocity and position at the end of `segment`, which starts where that of the state does.
    fn at(&self, segment: &Segment) -> Navigation {
        let state = &self.state;
        let period = state.config.period;
        let remainder: [i32; 3] = core::array::from_fn(|axis| {
            (self.gravity[axis] - (i64::from(self.whole_gravity[axis]) << 16)) as i32
        });
        let velocity = self.attitude.velocity(segment.velocity_nmps(remainder, period));
        let position = self.attitude.position(segment.position_nm(remainder, period));
        let elapsed_ns = i128::from(u64::from(segment.steps) * u64::from(period.0));
        let since_rest_ms = self.since_rest_ns(segment) / 1_000_000;
        Navigation {
            velocity: VelocityNmps(core::array::from_fn(|axis| {
                velocity.0[axis].saturating_add(state.base_velocity_nmps[axis])
            })),
            position: PositionNm(core::array::from_fn(|axis| {
                let coasted = billionth(product(elapsed_ns, state.base_velocity_nmps[axis]));
                position.0[axis]
                    .saturating_add(state.base_position_nm[axis])
                    .saturating_add(saturate(coasted))
            })),
            since_rest_ms: u32::try_from(since_rest_ms).unwrap_or(u32::MAX),
            phase: state.phase,
            flags: state.flags,
            heading_sd_mrad: state.heading_sd_mrad,
            attitude: self.quaternion(),
        }
    }

    fn since_rest_ns(&self, segment: &Segment) -> u64 {
        u64::from(segment.steps)
            .wrapping_mul(u64::from(self.state.config.period.0))
            .wrapping_add(self.state.base_since_rest_ns)
    }

    /// Evaluates the complete window and starts the next one.
    #[cold]
    pub(crate) fn end_window(&mut self, rate: RateTest) -> Transition {
        let window = self.state.window;
        let steps = i64::from(self.window_steps);
        let total: [i64; 3] = core::array::from_fn(|axis| {
            self.state.segment.velocity_sum[axis]
                .wrapping_sub(window.start.velocity_sum[axis])
                .wrapping_add(2 * steps * i64::from(self.whole_gravity[axis]))
        });
        let quiet = rate.quiet && window.is_quiet(total);
        let goes_on = match &self.state.run {
            Some(run) => quiet && rate.agrees && run.agrees(total, window.tolerance()),
            // After a gap or a change of period there is no run, but the previous rest may
            // continue.
            None => quiet && rate.as_held && self.is_as_held(&window, total),
        };
        let run = quiet.then(|| match self.state.run {
            Some(run) if goes_on => run.with(total),
            _ => Run::starting_with(total, &self.state.segment),
        });
        let windows = run.map_or(0, |run| run.windows);
        let transition = match (self.state.phase, run) {
            (Phase::Searching, Some(run)) if windows >= REST_WINDOWS => {
                self.rest(&window, &run);
                Transition::Rest
            }
            (Phase::Resting, Some(run)) if goes_on => {
                if windows >= REST_WINDOWS {
                    self.rest(&window, &run);
                }
                Transition::Window
            }
            (Phase::Resting, _) => {
                self.state.phase = Phase::Moving;
                Transition::Motion
            }
            (Phase::Moving, Some(run))
                if windows >= self.windows_of_a_rest(&window, total, rate.as_held) =>
            {
                if self.inertial().is_none() && self.attitude.cosine_to(run.sum) < TURN_COSINE {
                    self.state.flags = self.state.flags.with(Flags::TURNED);
                }
                if self.state.config.zupt {
                    self.close_leg(&run.start);
                    self.rest(&window, &run);
                    Transition::Rest
                } else {
                    Transition::Window
                }
            }
            _ => Transition::Window,
        };
        self.state.run = run;
        let out_of_range = |sums: &[i64; 3]| sums.iter().any(|s| s.unsigned_abs() > SUM_LIMIT);
        if self.state.phase == Phase::Moving
            && (out_of_range(&self.state.segment.position_sum)
                || out_of_range(&self.state.segment.velocity_sum))
        {
            self.state.flags = self.state.flags.with(Flags::OUT_OF_RANGE);
        }
        if self.state.phase == Phase::Searching {
            // Nothing is integrated yet; the sums would overflow in a long search.
            self.state.segment =
                Segment { previous: self.state.segment.previous, ..Segment::default() };
        }
        self.state.window = Window::starting_at(&self.state.segment);
        transition
    }

    /// Whether a window with this Σ (f_k + f_k+1) has the mean of the latest rest.
    fn is_as_held(&self, window: &Window, total: [i64; 3]) -> bool {
        (0..3).all(|axis| {
            let mean = 2 * i64::from(self.window_steps) * (self.state.rest_mean[axis] >> 16);
            total[axis].abs_diff(mean) <= 2 * window.tolerance()
        })
    }

    /// Number of windows that are a rest after a motion; `rate_as_held`: whether the angular rate is the
    /// bias of the latest rest.
    ///
    /// If not, either the bias has changed, or the body rotates about the vertical, which the specific force does not
    /// show. A run of [`LONGEST_RUN`] windows, 16 s, is taken for a changed bias: the body would rotate by at least
    /// 0.32 rad at a rate that is constant within 0.02 rad/s, which is not hand motion. A turntable is not excluded.
    fn windows_of_a_rest(&self, window: &Window, total: [i64; 3], rate_as_held: bool) -> u16 {
        if !rate_as_held {
            LONGEST_RUN
        } else if self.is_as_held(window, total) {
            REST_WINDOWS
        } else {
            TURNED_REST_WINDOWS
        }
    }

    /// At rest: averages gravity, aligns, and starts the next leg at the start of `window`, the
    /// latest of `run`, so that the onset of motion within it is included.
    fn rest(&mut self, window: &Window, run: &Run) {
        if self.state.phase != Phase::Resting {
            // The heading is held until the compass provides one.
            self.state.east = self.attitude.east();
            self.state.heading_sd_mrad = None;
            self.state.flags = match self.state.phase {
                Phase::Searching => Flags::default(),
                _ => self.state.flags.for_next_leg(),
            };
        }
        self.state.phase = Phase::Resting;
        self.state.rest_mean = run.mean(self.window_steps);
        let taken_before = self.whole_gravity;
        // A quiet window has a specific force, so the up direction exists.
        let _ = self.align();
        let change =
            core::array::from_fn(|axis| self.whole_gravity[axis].wrapping_sub(taken_before[axis]));
        self.state.segment = self.state.segment.since(&window.start, change);
        self.state.base_velocity_nmps = [0; 3];
        self.state.base_since_rest_ns = 0;
    }

    /// Computes attitude and gravity from the mean at rest: with ZUPT gravity is that mean, without
    /// it has the local magnitude. `None` if the mean is zero.
    fn align(&mut self) -> Option<()> {
        let mean = self.state.rest_mean;
        self.attitude = Attitude::from_rest(mean, self.state.east)?;
        self.gravity = if self.state.config.zupt {
            mean
        } else {
            let magnitude = (i64::from(self.state.config.gravity_um_s2) << 32) / 1_000_000;
            direction(mean)?
                .map(|axis| round_shift(product(magnitude.into(), axis.into()), DIRECTION_BITS))
        };
        self.whole_gravity = self.gravity.map(|gravity| ((gravity + (1 << 15)) >> 16) as i32);
        Some(())
    }

    /// Ends a leg at `end`, where the velocity is zero: the residual velocity is distributed over
    /// the leg.
    fn close_leg(&mut self, end: &Segment) {
        let left = self.at(end);
        let leg_ns = i128::from(self.since_rest_ns(end));
        for axis in 0..3 {
            let twice = billionth(product(leg_ns, left.velocity.0[axis]));
            // Half of it, rounded towards zero, without a 128-bit division.
            let correction = (twice - (twice >> 127)) >> 1;
            self.state.base_position_nm[axis] =
                left.position.0[axis].saturating_sub(saturate(correction));
        }
    }
}

fn saturate(value: i128) -> i64 {
    value.clamp(i128::from(i64::MIN), i128::from(i64::MAX)) as i64
}
