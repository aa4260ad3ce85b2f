//! The result of a path: as `--json` prints it, and as text.

use serde::Serialize;

use super::horizon::Horizon;
use super::{Aided, Choice, InertialPath, Method, Move, Profile, Zupt, consistency};
use crate::digits::{east_north_up, significant};
use crate::localization::{Parameter, Ranged};
use crate::plural::counted;
use crate::stats::median;

/// A path, as `--json` prints it.
#[derive(Debug, Serialize)]
pub struct Summary {
    source: String,
    method: Method,
    /// Value of the option `--zupt`; null for ranges.
    zupt: Option<&'static str>,
    /// Value of the option `--profile`; null for an array and for ranges.
    profile: Option<&'static str>,
    /// Whether positions and σ rest on all samples. `horizon` is that of the forward filter.
    smoothed: bool,
    /// That of an array while it moves.
    angular_rate: Option<AngularRate>,
    duration_s: f64,
    /// End of the first rest, where position and velocity are zero by definition.
    origin_s: Option<f64>,
    /// Length of the path over the valid samples.
    distance_m: f64,
    final_position_m: [f64; 3],
    final_sigma_m: [f64; 3],
    final_valid: bool,
    /// Median standard deviation of the position in space.
    median_sigma_m: Option<f64>,
    valid_share: f64,
    horizon: Horizons,
    rests: usize,
    rests_s: f64,
    /// Use of `--fixes` and `--ranges`; null without.
    fixes: Option<Aided>,
    ranges: Option<Aided>,
    nees: Option<Nees>,
    /// NEES of an array's angular rate and velocity.
    rate_nees: Option<Nees>,
    velocity_nees: Option<Nees>,
    /// Moves between rests.
    moves: Vec<MoveFound>,
    /// Ranges and anchors, of a path from ranges.
    #[serde(flatten)]
    ranging: Option<Ranged>,
}

#[derive(Debug, Serialize)]
struct AngularRate {
    rms_rad_s: f64,
    /// Median of the standard deviation in space.
    sigma_rad_s: f64,
    /// Whether it rests on all samples.
    smoothed: bool,
}

/// Motion time after which the position's standard deviation exceeds a limit or the position is lost; null if never.
#[derive(Debug, Serialize)]
struct Horizons {
    to_0_1_m_s: Option<f64>,
    to_1_m_s: Option<f64>,
    limit_m: f64,
    to_limit_s: Option<f64>,
    /// The same with the time in the recording.
    ends: Vec<End>,
}

#[derive(Debug, Serialize)]
struct End {
    limit_m: f64,
    #[serde(flatten)]
    horizon: Horizon,
}

/// A move between two rests.
#[derive(Debug, Serialize)]
struct MoveFound {
    from_s: f64,
    to_s: f64,
    /// Null where it is not known: without a gyroscope after a rotation, or contradicted by the rest at its end.
    length_m: Option<f64>,
    length_sd_m: Option<f64>,
    tilted_deg: f64,
}

impl MoveFound {
    fn of(found: &Move) -> Self {
        let known = |value: f64| found.valid.then_some(value);
        Self {
            from_s: found.from_s,
            to_s: found.to_s,
            length_m: known(found.length_m),
            length_sd_m: known(found.length_sd_m),
            tilted_deg: found.tilted_rad.to_degrees(),
        }
    }
}

#[derive(Debug, Serialize)]
struct Nees {
    samples: usize,
    median: f64,
    share_below_7_81: f64,
    /// Heading of the truth: `truth`, or `fitted` to the path if the truth has no heading.
    heading: &'static str,
}

impl Nees {
    fn of(all: &[f64], path: &InertialPath) -> Option<Self> {
        consistency(all).map(|(median, share_below_7_81)| Self {
            samples: all.len(),
            median,
            share_below_7_81,
            heading: if path.heading_fitted { "fitted" } else { "truth" },
        })
    }
}

impl InertialPath {
    /// The result. `choice` is that of a path from inertial samples.
    pub fn summary(&self, source: String, choice: Option<&Choice>) -> Summary {
        let last = self.points.last();
        let rests = self.rests();
        let profiled = choice.filter(|_| self.method != Method::Array);
        let ends = self.limits().into_iter().filter_map(|limit_m| {
            let horizon = self.horizon(limit_m)?;
            Some(End { limit_m, horizon })
        });
        Summary {
            source,
            method: self.method,
            zupt: choice.map(|choice| choice.zupt.name()),
            profile: profiled.map(|choice| profile(choice.profile).0),
            smoothed: self.smoothed,
            angular_rate: self.angular_rate().map(|(rms_rad_s, sigma_rad_s)| AngularRate {
                rms_rad_s,
                sigma_rad_s,
                smoothed: self.smoothed_rate,
            }),
            duration_s: self.duration_s(),
            origin_s: self.points.get(self.origin).map(|p| p.time_s),
            distance_m: self.distance_m(),
            final_position_m: last.map(|p| p.position_m).unwrap_or_default(),
            final_sigma_m: last.map(|p| p.sigma_m()).unwrap_or_default(),
            final_valid: last.is_some_and(|p| p.valid),
            median_sigma_m: self.median_sigma_m(),
            valid_share: self.valid_share(),
            horizon: Horizons {
                to_0_1_m_s: self.horizon_s(0.1),
                to_1_m_s: self.horizon_s(1.0),
                limit_m: self.limit_m,
                to_limit_s: self.horizon_s(self.limit_m),
                ends: ends.collect(),
            },
            rests: rests.rests,
            rests_s: rests.lasted_s,
            fixes: some(self.aided[0]),
            ranges: some(self.aided[1]),
            nees: Nees::of(&self.nees, self),
            rate_nees: Nees::of(&self.rate_nees, self),
            velocity_nees: Nees::of(&self.velocity_nees, self),
            moves: self.moves.iter().map(MoveFound::of).collect(),
            ranging: self.ranging.clone(),
        }
    }

    /// Median standard deviation of the position in space, m.
    fn median_sigma_m(&self) -> Option<f64> {
        median(self.points.iter().map(|point| point.sd_m())).filter(|sd| sd.is_finite())
    }

    /// Position limits of the horizons, m.
    fn limits(&self) -> Vec<f64> {
        let mut limits = vec![0.1, 1.0];
        if !limits.contains(&self.limit_m) {
            limits.push(self.limit_m);
        }
        limits
    }

    /// The moves of known length, the longest first.
    fn moves_text(&self) -> String {
        let mut known: Vec<&Move> = self.moves.iter().filter(|m| m.valid).collect();
        if known.is_empty() {
            return String::new();
        }
        known.sort_by(|a, b| b.length_m.total_cmp(&a.length_m));
        let one = |m: &&Move| {
            format!(
                "{:.3} ± {:.3} m ({:.2} to {:.2} s)",
                m.length_m, m.length_sd_m, m.from_s, m.to_s
            )
        };
        let listed: Vec<String> = known.iter().take(LISTED).map(one).collect();
        let kind = if self.method == Method::Tilt { " without rotation" } else { "" };
        format!(
            "{}{kind} between rests, longest first: {}\n",
            counted(known.len(), "move"),
            listed.join(", ")
        )
    }

    /// From where position is measured.
    fn origin_text(&self, choice: &Choice, has_fixes: bool) -> String {
        // Those of a link are not part of the choice.
        let of_fixes =
            has_fixes && (choice.fixes.fixes.is_empty() || choice.fixes.origin().is_some());
        match self.points.get(self.origin) {
            _ if choice.start.is_some() => "origin: that of --start\n".to_owned(),
            _ if of_fixes => "origin: that of the fixes\n".to_owned(),
            Some(point) if point.resting || self.method == Method::Array => {
                format!("origin: t = {:.2} s (end of the first rest)\n", point.time_s)
            }
            _ => String::new(),
        }
    }

    /// What was assumed of rests and motion.
    fn assumed_text(&self, choice: &Choice) -> String {
        let rests = self.rests();
        let zero = match choice.zupt {
            Zupt::Stated => "velocity zero",
            Zupt::Assumed => "constant velocity of 0 ± 0.1 m/s",
            Zupt::Off => "nothing",
        };
        let rested = counted(rests.rests, "rest");
        let mut text = format!("assumed: {zero} at {rested} ({:.1} s)", rests.lasted_s);
        if self.method != Method::Array {
            let (name, bound) = profile(choice.profile);
            text += &format!("; --profile {name}: {bound}");
        }
        if let Some(within_m) = choice.within_m {
            text += &format!("; within {within_m} m of the start");
        }
        text + "\n"
    }

    /// Where the path ends, and how it was found.
    fn result_text(&self) -> String {
        let mut text = match self.points.iter().rfind(|p| p.valid) {
            None => "no position is known to the limit\n".to_owned(),
            Some(point) => {
                let (at, sd) = (east_north_up(point.position_m), point.sd_m());
                let ends = self.points.last().is_some_and(|last| last.valid);
                let what = if ends { "final position" } else { "last valid position" };
                format!("{what}: {at} m ± {sd:.3} m (1 σ), at {:.2} s\n", point.time_s)
            }
        };
        text += &format!(
            "path: {:.3} m in {:.1} s, {}{}; {:.0} % of the samples are valid (σ below {} m)\n",
            self.distance_m(),
            self.duration_s(),
            match self.method {
                Method::Strapdown => "with a gyroscope",
                Method::Tilt => "without a gyroscope",
                Method::Array => "with an array of accelerometers",
                Method::Ranges => "from ranges",
                Method::Odometry => "from ranges and wheel odometry",
                Method::RangesInertial => "from ranges and a gyroscope",
            },
            if self.smoothed { ", smoothed" } else { "" },
            100.0 * self.valid_share(),
            self.limit_m
        );
        let horizons = self.limits().into_iter().map(|limit| match self.horizon(limit) {
            None => format!("below {limit} m throughout"),
            Some(end) => format!(
                "below {limit} m for {:.1} s of motion (until {:.2} s)",
                end.moving_s, end.at_s
            ),
        });
        let filtered = if self.smoothed { "σ in real time (forward filter)" } else { "σ" };
        let horizons = horizons.collect::<Vec<_>>().join(", ");
        text + &format!("{filtered}: {horizons}\n")
    }

    /// The result first, then what it rests on, then remarks. `choice` is that of a path from inertial samples.
    pub fn text(&self, choice: Option<&Choice>, has_fixes: bool) -> String {
        let mut text = match self.angular_rate() {
            Some((rate, sd)) => format!(
                "angular rate: {rate:.3} rad/s rms in motion ± {sd:.3} rad/s (median 1 σ){}\n",
                if self.smoothed_rate { ", smoothed" } else { "" }
            ),
            None => String::new(),
        };
        text += &self.result_text();
        if let Some(choice) = choice {
            text += &self.assumed_text(choice);
            text += &self.origin_text(choice, has_fixes);
        }
        for (kind, aided) in ["fixes", "ranges"].iter().zip(self.aided) {
            if let Some(Aided { used, rejected, late }) = some(aided) {
                text += &format!("{kind}: {used} used, {rejected} rejected, {late} late\n");
            }
        }
        text += &self.moves_text();
        if let Some(ranging) = &self.ranging {
            text += &ranging_text(ranging, self.method);
        }
        let fitted = if self.heading_fitted { ", heading fitted" } else { "" };
        for (what, nees) in [
            ("", &self.nees),
            ("angular rate, ", &self.rate_nees),
            ("velocity, ", &self.velocity_nees),
        ] {
            if let Some((median, share)) = consistency(nees) {
                text += &format!(
                    "against the truth{fitted}, in motion: {what}NEES median {median:.2} (expected 2.37), below 7.81 in {:.0} % (expected \
                     95 %)\n",
                    100.0 * share
                );
            }
        }
        text
    }
}

/// Moves that are listed in the text.
const LISTED: usize = 4;

fn some(aided: Aided) -> Option<Aided> {
    (aided != Aided::default()).then_some(aided)
}

/// Value of the option, and what it assumes.
fn profile(profile: Profile) -> (&'static str, &'static str) {
    match profile {
        Profile::Hand => ("hand", "velocity 0 ± 2 m/s"),
        Profile::Foot => ("foot", "velocity zero in stances"),
        Profile::Vehicle => ("vehicle", "motion along the forward axis where it is known"),
        _ => ("free", "no bound"),
    }
}

/// Noise of the ranges, and the calibration of their anchors.
fn ranging_text(found: &Ranged, method: Method) -> String {
    let noise = &found.noise;
    let mut text = format!(
        "ranges: noise {} m, correlated error {} m over 1 s, {} % without line of sight (estimated)\n",
        significant(noise.white_m, 2),
        significant(noise.correlated_m, 2),
        significant(100.0 * noise.blocked, 2)
    );
    text += "anchor  ranges  bias, m           scale error, %    blocked, %\n";
    for anchor in &found.anchors {
        text += &format!(
            "{:<7} {:<7} {:<17} {:<17} {:.0}\n",
            anchor.id,
            anchor.ranges,
            shown(anchor.bias_m, 1.0),
            shown(anchor.scale, 100.0),
            100.0 * anchor.blocked
        );
        if let Some(sd) = anchor.position_sd_m {
            let axis = |k: usize| format!("{:+.3} ± {:.3}", anchor.position_m[k], sd[k]);
            text += &format!("        at E {} N {} U {} m\n", axis(0), axis(1), axis(2));
        }
    }
    if let Some(scale) = found.odometer_scale {
        text += &format!("scale error of the odometer: {} %\n", shown(Some(scale), 100.0));
    }
    if let Some(delay) = found.delay_s {
        let other = if method == Method::Odometry { "odometry" } else { "inertial samples" };
        text += &format!("ranges after the {other}: {} ms\n", shown(Some(delay), 1e3));
    }
    text
}

/// Value and standard deviation, marked where the data do not show it.
fn shown(parameter: Option<Parameter>, factor: f64) -> String {
    let Some(p) = parameter else {
        return "-".to_owned();
    };
    let mark = if p.is_observed() { "" } else { " (prior)" };
    format!("{:+.3} ± {:.3}{mark}", p.value * factor, p.sigma * factor)
}
