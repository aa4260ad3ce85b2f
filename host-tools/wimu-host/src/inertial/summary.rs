//! What a path shows, and the path as text.

use serde::Serialize;

use super::truth::consistency;
use super::{AidUse, Choice, InertialPath, Method, Move, PathPoint, Profile, Zupt};
use crate::digits::{east_north_up, significant};
use crate::localization::{Parameter, Ranged};
use crate::plural::counted;
use crate::stats::{median, norm};

/// What the points of a path show.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Figures {
    /// That of an array while it moves.
    pub angular_rate: Option<AngularRate>,
    /// From the first point to the last, s.
    pub duration_s: f64,
    /// End of the first rest, where position and velocity are zero by definition.
    pub origin_s: Option<f64>,
    /// Length of the path over the valid samples.
    pub distance_m: f64,
    /// Position at the end, m.
    pub final_position_m: [f64; 3],
    /// Its standard deviations, m.
    pub final_sigma_m: [f64; 3],
    /// Whether it is known to the limit.
    pub final_valid: bool,
    /// Median standard deviation of the position in space.
    pub median_sigma_m: Option<f64>,
    /// Share of the points that are valid.
    pub valid_share: f64,
    /// From samples up to then alone.
    pub horizon: Horizons,
    /// Number of rests at which zero velocity was used, and their time, s.
    pub rests: usize,
    /// See [`rests`](Self::rests).
    pub rests_s: f64,
}

/// Angular rate of an array at valid points in motion.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct AngularRate {
    /// Root mean square, rad/s.
    pub rms_rad_s: f64,
    /// Median of the standard deviation in space.
    pub sigma_rad_s: f64,
    /// Whether it rests on all samples.
    pub smoothed: bool,
}

/// Motion time after which the position's standard deviation exceeds a limit or the position is lost; null if never.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Horizons {
    to_0_1_m_s: Option<f64>,
    to_1_m_s: Option<f64>,
    limit_m: f64,
    to_limit_s: Option<f64>,
}

impl InertialPath {
    /// The path with its figures, at its end, and with what was assumed of inertial samples.
    #[must_use]
    pub(crate) fn assumed(mut self, choice: &Choice) -> Self {
        let is_unit = self.method != Method::Array;
        self.zupt = Some(choice.zupt.name());
        self.profile = is_unit.then(|| profile(choice.profile).0);
        self.ended()
    }

    /// The path with its figures.
    #[must_use]
    pub(crate) fn ended(mut self) -> Self {
        let points = &self.points;
        let (last, rests) = (points.last(), self.rests());
        let sigmas = points.iter().map(PathPoint::sd_m);
        let valid = points.iter().filter(|point| point.valid).count();
        self.figures = Figures {
            angular_rate: self.angular_rate(),
            duration_s: points.first().zip(last).map_or(0.0, |(a, b)| b.time_s - a.time_s),
            origin_s: points.get(self.origin).map(|p| p.time_s),
            distance_m: self.distance_m(),
            final_position_m: last.map(|p| p.position_m).unwrap_or_default(),
            final_sigma_m: last.map(PathPoint::sigma_m).unwrap_or_default(),
            final_valid: last.is_some_and(|p| p.valid),
            median_sigma_m: median(sigmas).filter(|sd| sd.is_finite()),
            valid_share: valid as f64 / points.len().max(1) as f64,
            horizon: Horizons {
                to_0_1_m_s: self.horizon_s(0.1),
                to_1_m_s: self.horizon_s(1.0),
                limit_m: self.limit_m,
                to_limit_s: self.horizon_s(self.limit_m),
            },
            rests: rests.rests,
            rests_s: rests.lasted_s,
        };
        self
    }

    fn angular_rate(&self) -> Option<AngularRate> {
        let moving = || self.points.iter().filter(|p| p.valid && !p.resting);
        let squares = moving().flat_map(|p| p.rate_rad_s).map(|w| w * w).sum::<f64>();
        let sigmas = moving().filter_map(PathPoint::rate_sigma_rad_s).map(norm);
        let sigma_rad_s = median(sigmas.filter(|s| s.is_finite()))?;
        let rms_rad_s = (squares / moving().count() as f64).sqrt();
        Some(AngularRate { rms_rad_s, sigma_rad_s, smoothed: self.smoothed_rate })
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
        let of_fixes = has_fixes && (choice.aids.aids.is_empty() || choice.aids.origin().is_some());
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
        let zero = match choice.zupt {
            Zupt::Stated => "velocity zero",
            Zupt::Assumed => "constant velocity of 0 ± 0.1 m/s",
            Zupt::Off => "nothing",
        };
        let rested = counted(self.figures.rests, "rest");
        let mut text = format!("assumed: {zero} at {rested} ({:.1} s)", self.figures.rests_s);
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
            self.figures.distance_m,
            self.figures.duration_s,
            match self.method {
                Method::Strapdown => "with a gyroscope",
                Method::Tilt => "without a gyroscope",
                Method::Array => "with an array of accelerometers",
                Method::Ranges => "from ranges",
                Method::Odometry => "from ranges and wheel odometry",
                Method::RangesInertial => "from ranges and a gyroscope",
            },
            if self.smoothed { ", smoothed" } else { "" },
            100.0 * self.figures.valid_share,
            self.limit_m
        );
        let mut limits = self.limits();
        limits.sort_by(f64::total_cmp);
        // Below one limit it is below all larger ones.
        let kept = limits.iter().position(|limit| self.horizon(*limit).is_none());
        limits.truncate(kept.map_or(limits.len(), |kept| kept + 1));
        let horizons = limits.into_iter().map(|limit| match self.horizon(limit) {
            None => format!("stays below {limit} m"),
            Some(end) => format!(
                "exceeds {limit} m from {:.1} s on (after {:.1} s of motion)",
                end.at_s, end.moving_s
            ),
        });
        let filtered = if self.smoothed { "in real time (without later data): σ" } else { "σ" };
        let horizons = horizons.collect::<Vec<_>>().join(", ");
        text + &format!("{filtered} {horizons}\n")
    }

    /// The result first, then what it rests on, then remarks. `choice` is that of a path from inertial samples.
    pub fn text(&self, choice: Option<&Choice>, has_fixes: bool) -> String {
        let mut text = match &self.figures.angular_rate {
            Some(rate) => format!(
                "angular rate: {:.3} rad/s rms in motion ± {:.3} rad/s (median 1 σ){}\n",
                rate.rms_rad_s,
                rate.sigma_rad_s,
                if rate.smoothed { ", smoothed" } else { "" }
            ),
            None => String::new(),
        };
        text += &self.result_text();
        if let Some(choice) = choice {
            text += &self.assumed_text(choice);
            text += &self.origin_text(choice, has_fixes);
        }
        if self.ranging.is_none() {
            text.extend(self.aids.values().map(AidUse::text));
        }
        for state in &self.states {
            let [value, sd] = [state.value, state.sigma].map(|value| significant(value, 3));
            text += &format!("{}: {value} ± {sd} {}\n", state.name, state.unit);
        }
        text += &self.moves_text();
        if let Some(ranging) = &self.ranging {
            text += &ranging_text(ranging, self.method);
        }
        let fitted = if self.nees.is_heading_fitted { ", heading fitted" } else { "" };
        for (what, nees) in [("", &self.nees), ("angular rate, ", &self.rate_nees)] {
            if let Some((median, share)) = consistency(&nees.all) {
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
