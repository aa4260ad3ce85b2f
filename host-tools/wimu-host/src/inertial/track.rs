//! A navigator along the samples of a unit, with what aids it.

use nalgebra::Vector3;
use wimu_nav::navigator::{Navigator, Profile, Sample, SampleFault};

use super::fixes::{self, Aiding, Fixes};
use super::segments::Segments;
use super::{Choice, PathPoint, vehicle};
use crate::localization::Ranging;
use crate::plural::counted;
use crate::{Code, Problem};

/// A start in motion ends with the first rest of this length, s.
pub(super) const FIRST_REST_S: f64 = 0.5;

/// Part of the readings of the magnetic field above which rejected ones are reported: indoors iron explains some.
const MAGNET: f64 = 0.2;

/// A sample with what is known of the motion at its time.
pub(super) struct Input<'a> {
    pub time_s: f64,
    pub sample: &'a Sample,
    pub resting: bool,
    /// Standard deviation of the velocity of a foot in a stance, m/s.
    pub stance_mps: Option<f64>,
    /// Whether the accelerometer clips.
    pub clipped: bool,
}

/// A navigator with the fixes up to its time.
#[derive(Clone, Debug)]
pub(super) struct Track {
    pub navigator: Navigator,
    pub aiding: Aiding,
    pub segments: Segments,
    profile: Profile,
    /// Whether its positions are in a frame that was given: that of fixes, or of a pose at the start.
    framed: bool,
    /// Number of the sample at which position is zero: the last of the first rest.
    pub origin: Option<usize>,
    in_first_rest: bool,
    rest_s: f64,
    samples: usize,
    no_time: usize,
    not_finite: usize,
}

impl Track {
    /// At the first sample, at `time_s`.
    pub fn new(navigator: Navigator, choice: &Choice, time_s: f64, at_rest: bool) -> Self {
        Self {
            navigator,
            aiding: Aiding::from(time_s),
            segments: Segments::from(time_s),
            profile: choice.profile,
            framed: choice.start.is_some(),
            origin: at_rest.then_some(0),
            in_first_rest: at_rest,
            rest_s: 0.0,
            samples: 0,
            no_time: 0,
            not_finite: 0,
        }
    }

    /// Moves to a position in the frame of fixes, m, with its standard deviation, at a heading, rad; with a velocity, m/s,
    /// where it is known.
    pub fn place(
        &mut self,
        position: (Vector3<f64>, f64),
        velocity: Option<(Vector3<f64>, f64)>,
        heading_rad: f64,
    ) {
        fixes::place(&mut self.navigator, position, velocity, heading_rad);
        self.framed = true;
    }

    /// Whether position is measured from a place that is known.
    pub fn has_origin(&self) -> bool {
        self.framed || self.origin.is_some()
    }

    /// The next sample, and the fixes up to its time.
    pub fn step(&mut self, input: &Input, fixes: &Fixes) -> PathPoint {
        let Input { sample, resting, .. } = *input;
        // A foot's shocks are short: the largest reading is nearer to them than none.
        if self.profile != Profile::Foot && input.clipped {
            self.navigator.interrupt(sample.step_s);
        } else {
            match self.navigator.push(sample, resting) {
                Ok(()) => {}
                Err(SampleFault::NoTime) => self.no_time += 1,
                Err(_) => self.not_finite += 1,
            }
        }
        if let Some(deviation_mps) = input.stance_mps {
            self.navigator.stance(deviation_mps);
        }
        self.rest_s = if resting { self.rest_s + sample.step_s } else { 0.0 };
        self.aiding.update(fixes, input.time_s, &mut self.navigator, &mut self.segments);
        let found = self.navigator.take_consistency();
        self.segments.see(input.time_s, &found, resting);
        let lies = self.rest_s >= FIRST_REST_S || input.stance_mps.is_some();
        if !self.has_origin() && lies {
            self.navigator.set_origin();
            (self.origin, self.in_first_rest) = (Some(self.samples), true);
        }
        self.in_first_rest &= resting;
        if self.in_first_rest {
            self.origin = Some(self.samples);
        }
        self.samples += 1;
        self.point(input)
    }

    fn point(&self, input: &Input) -> PathPoint {
        let at_rest = input.resting && self.navigator.is_at_rest();
        let mut point = PathPoint {
            rate_rad_s: self.navigator.angular_rate().into(),
            resting: at_rest || input.stance_mps.is_some(),
            ..PathPoint::of(input.time_s, self.navigator.filter())
        };
        vehicle::by_clock_of_fixes(&mut point, &self.navigator);
        point
    }

    /// A magnetic field that is not that of the Earth for part of the time.
    fn magnet(&self) -> Option<Problem> {
        let [used, rejected] = self.navigator.fields().map(f64::from);
        let part = rejected / (used + rejected).max(1.0);
        let text = format!(
            "the magnetic field contradicted the motion in {:.0} % of its readings, not used: magnet or iron near the unit?",
            100.0 * part
        );
        (part > MAGNET).then(|| Code::Navigation.warning(text))
    }

    /// What was noticed: samples that were not used, recoveries and restarts of the filter, and the use of fixes.
    pub fn findings(&self, ranging: Option<&Ranging>) -> Vec<Problem> {
        let left_out = [
            (self.no_time, "whose time goes back: not used"),
            (self.not_finite, "that is not finite: not used"),
        ];
        let mut found = counted_findings(Code::SamplesLeftOut, "sample", &left_out);
        found.extend(self.aiding.findings(ranging));
        found.extend(self.magnet());
        found.extend(vehicle::findings(&self.navigator));
        let recoveries = self.navigator.recoveries() as usize;
        let contradicted = "contradicted the estimated velocity: σ was enlarged there";
        found.extend(counted_findings(Code::Navigation, "rest", &[(recoveries, contradicted)]));
        let divergences = self.navigator.divergences() as usize;
        let diverged =
            "the filter diverged and began again. Check axes, signs and units of the sensors";
        found.extend(counted_findings(Code::Navigation, "time", &[(divergences, diverged)]));
        found
    }
}

/// A warning for each count above zero: the number of something, and what happened to it.
pub(super) fn counted_findings(code: Code, one: &str, counts: &[(usize, &str)]) -> Vec<Problem> {
    let some = counts.iter().filter(|(count, _)| *count > 0);
    some.map(|(count, what)| code.warning(format!("{} {what}", counted(*count, one)))).collect()
}
