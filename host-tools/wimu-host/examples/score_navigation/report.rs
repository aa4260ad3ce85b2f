//! The figures that are printed and stored, rounded to four significant digits.

use std::collections::BTreeMap;

use serde::Serialize;

use crate::array::ArrayScores;
use crate::methods::{LOW_PASS, STAYS, Scored, ZUPT_FILTER};
use crate::score::{CHI_SQUARE_95, CHI_SQUARE_MEDIAN};
use crate::score::{Consistency, Whole, Windows, fraction_below, mean, median, rms};

/// Version of the JSON layout.
const SCHEMA: u32 = 1;

/// How the figures are made.
pub const NOTES: [&str; 9] = [
    "scored: moving samples (column Moving, else truth above 0.05 m/s over 0.2 s; arrays: above 1 rad/s)",
    "windows: from the true position, velocity and heading, at whole seconds whose next 2 s move",
    "windows: no zero-velocity updates within; *_smoothed differs in the whole run only; walks have no heading",
    "whole run: truth moved to the estimate's origin and heading there; walks: the heading that fits best",
    "consistency: samples without a valid estimate are excluded; `valid` is the fraction that remains",
    "truth: 1 mm, 0.02 m/s (robot arm 10 mm, 0.05 m/s; simulated 1 mm, 2 mm/s) added to each covariance",
    "robot arm: the truth's lag of 0.09 s is taken off",
    "wimu: velocity is that of its filter alone, without the repairs of times and samples; it gives no NIS",
    "zupt_filter: 15 states, SHOE; walks as foot.py FIXED, everything else as reference/estimator",
];

#[derive(Debug, Serialize)]
pub struct Report {
    pub schema: u32,
    pub data: String,
    pub seed: u64,
    pub notes: [&'static str; 9],
    /// Median of the NEES and NIS of a consistent estimate, and the point below which 95 % of them are.
    pub chi_square_median: f64,
    pub chi_square_95: f64,
    pub horizons_s: [f64; 3],
    /// Scored values that were not finite, in all.
    pub non_finite: usize,
    pub recordings: Vec<RecordingReport>,
    /// All hand and robot together, and all walks.
    pub pooled: Vec<RecordingReport>,
    pub arrays: Vec<ArrayReport>,
    pub journeys: Option<JourneysReport>,
}

#[derive(Debug, Serialize)]
pub struct RecordingReport {
    pub name: String,
    pub moving_samples: usize,
    pub windows: usize,
    pub methods: Vec<MethodReport>,
}

#[derive(Debug, Serialize)]
pub struct JourneysReport {
    pub count: u64,
    pub all: RecordingReport,
    pub kinds: Vec<RecordingReport>,
}

#[derive(Debug, Serialize)]
pub struct MethodReport {
    pub name: &'static str,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub refused: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub closure_m: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub windows: Option<WindowsReport>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub whole: Option<WholeReport>,
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub ratio_to: BTreeMap<&'static str, Ratio>,
    pub non_finite: usize,
}

/// Position errors over those of a baseline: median of the windows at each horizon, RMS and last rest of the whole run.
#[derive(Debug, Serialize)]
pub struct Ratio {
    #[serde(skip_serializing_if = "Option::is_none")]
    pub windows: Option<[f64; 3]>,
    pub rms: f64,
    pub last_rest: f64,
}

#[derive(Debug, Serialize)]
pub struct WindowsReport {
    pub median_m: [f64; 3],
    pub rms_m: [f64; 3],
    #[serde(skip_serializing_if = "Option::is_none")]
    pub position: Option<WindowConsistency>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub velocity: Option<WindowConsistency>,
}

/// At each horizon.
#[derive(Debug, Serialize)]
pub struct WindowConsistency {
    pub log_score: [f64; 3],
    pub nees_below_95: [f64; 3],
    pub nees_median: [f64; 3],
}

#[derive(Debug, Serialize)]
pub struct WholeReport {
    /// Fraction of the moving samples that are valid.
    pub valid: f64,
    /// Position error at the moving samples, valid or not, m.
    pub median_m: f64,
    pub rms_m: f64,
    /// Error and standard deviation in space, m; over several recordings the medians.
    pub end_m: [f64; 2],
    pub last_rest_m: [f64; 2],
    /// Of the valid moving samples; `null` where there is none or the method has no covariance.
    pub position: Option<ConsistencyReport>,
    pub velocity: Option<ConsistencyReport>,
    /// Innovations of the zero-velocity updates; `null` where the method does not give them.
    pub nis: Option<NisReport>,
}

#[derive(Debug, Serialize)]
pub struct ConsistencyReport {
    pub samples: usize,
    pub log_score: f64,
    pub nees_below_95: f64,
    pub nees_median: f64,
    pub worst_sigma: f64,
}

#[derive(Debug, Serialize)]
pub struct NisReport {
    pub updates: usize,
    pub below_95: f64,
    pub median: f64,
}

#[derive(Debug, Serialize)]
pub struct ArrayReport {
    pub name: String,
    pub moving_samples: usize,
    pub next_to_clipping: usize,
    pub methods: Vec<RateReport>,
}

#[derive(Debug, Serialize)]
pub struct RateReport {
    pub name: &'static str,
    pub rms_deg_s: f64,
    pub median_deg_s: f64,
    pub wrong_sign: f64,
    /// Fraction of the samples at which the position is valid; `null` without a position.
    pub valid: Option<f64>,
    pub rate: Option<ConsistencyReport>,
    pub non_finite: usize,
}

/// To four significant digits.
pub fn rounded(value: f64) -> f64 {
    format!("{value:.3e}").parse().unwrap_or(value)
}

impl Report {
    pub fn new(data: String, seed: u64) -> Self {
        Self {
            schema: SCHEMA,
            data,
            seed,
            notes: NOTES,
            chi_square_median: CHI_SQUARE_MEDIAN,
            chi_square_95: CHI_SQUARE_95,
            horizons_s: crate::recording::HORIZONS_S,
            non_finite: 0,
            recordings: Vec::new(),
            pooled: Vec::new(),
            arrays: Vec::new(),
            journeys: None,
        }
    }

    /// Counts the values that were not finite.
    pub fn count(&mut self) {
        let of = |r: &RecordingReport| r.methods.iter().map(|m| m.non_finite).sum::<usize>();
        let rates = |r: &ArrayReport| r.methods.iter().map(|m| m.non_finite).sum::<usize>();
        self.non_finite = self.recordings.iter().map(of).sum::<usize>()
            + self.arrays.iter().map(rates).sum::<usize>()
            + self.journeys.iter().map(|j| of(&j.all)).sum::<usize>();
    }
}

impl RecordingReport {
    pub fn of(name: &str, methods: &[Scored]) -> Self {
        let windows = methods.iter().filter_map(|m| m.windows.as_ref()).map(|w| w.count).max();
        Self {
            name: name.to_owned(),
            moving_samples: methods.iter().map(|m| m.whole.moving).max().unwrap_or(0),
            windows: windows.unwrap_or(0),
            methods: methods.iter().map(|method| MethodReport::of(method, methods)).collect(),
        }
    }
}

impl MethodReport {
    fn of(method: &Scored, all: &[Scored]) -> Self {
        let windows = method.windows.as_ref().filter(|w| w.count > 0);
        let scored = method.whole.moving > 0;
        let baselines = all.iter().filter(|m| [ZUPT_FILTER, LOW_PASS, STAYS].contains(&m.name));
        let ratio_to = baselines
            .filter(|_| method.name.starts_with("wimu") && !method.whole.errors.is_empty())
            .map(|baseline| (baseline.name, Ratio::of(method, baseline)));
        Self {
            name: method.name,
            refused: method.refused.clone(),
            closure_m: method.closure.map(rounded),
            windows: windows.map(WindowsReport::of),
            whole: scored.then(|| WholeReport::of(&method.whole)),
            ratio_to: ratio_to.collect(),
            non_finite: method.whole.non_finite + windows.map_or(0, |w| w.non_finite),
        }
    }
}

impl Ratio {
    fn of(method: &Scored, baseline: &Scored) -> Self {
        let over = |of: fn(&Whole) -> f64| rounded(of(&method.whole) / of(&baseline.whole));
        let windows = method.windows.as_ref().filter(|w| w.count > 0);
        let windows = windows.zip(baseline.windows.as_ref()).map(|(one, other)| {
            std::array::from_fn(|h| rounded(median(&one.errors[h]) / median(&other.errors[h])))
        });
        Self {
            windows,
            rms: over(|w| rms(&w.errors)),
            last_rest: over(|w| medians(&w.last_rest)[0]),
        }
    }
}

fn medians(pairs: &[[f64; 2]]) -> [f64; 2] {
    let of = |i: usize| median(&pairs.iter().map(|p| p[i]).collect::<Vec<f64>>());
    [rounded(of(0)), rounded(of(1))]
}

impl WindowsReport {
    fn of(windows: &Windows) -> Self {
        let errors = |of: fn(&[f64]) -> f64| windows.errors.each_ref().map(|e| rounded(of(e)));
        Self {
            median_m: errors(median),
            rms_m: errors(rms),
            position: WindowConsistency::of(&windows.position),
            velocity: WindowConsistency::of(&windows.velocity),
        }
    }
}

impl WindowConsistency {
    fn of(scores: &[Consistency; 3]) -> Option<Self> {
        if scores.iter().all(|s| s.nees.is_empty()) {
            return None;
        }
        let of = |f: fn(&Consistency) -> f64| scores.each_ref().map(|s| rounded(f(s)));
        Some(Self {
            log_score: of(|s| mean(&s.log_density)),
            nees_below_95: of(Consistency::below_95),
            nees_median: of(|s| median(&s.nees)),
        })
    }
}

impl WholeReport {
    fn of(whole: &Whole) -> Self {
        let nis = (!whole.nis.is_empty()).then(|| NisReport {
            updates: whole.nis.len(),
            below_95: rounded(fraction_below(&whole.nis, CHI_SQUARE_95)),
            median: rounded(median(&whole.nis)),
        });
        Self {
            valid: rounded(whole.valid as f64 / whole.moving as f64),
            median_m: rounded(median(&whole.errors)),
            rms_m: rounded(rms(&whole.errors)),
            end_m: medians(&whole.last),
            last_rest_m: medians(&whole.last_rest),
            position: ConsistencyReport::of(&whole.position),
            velocity: ConsistencyReport::of(&whole.velocity),
            nis,
        }
    }
}

impl ConsistencyReport {
    fn of(score: &Consistency) -> Option<Self> {
        (!score.nees.is_empty()).then(|| Self {
            samples: score.nees.len(),
            log_score: rounded(mean(&score.log_density)),
            nees_below_95: rounded(score.below_95()),
            nees_median: rounded(median(&score.nees)),
            worst_sigma: rounded(score.worst),
        })
    }
}

impl ArrayReport {
    pub fn of(scores: &ArrayScores) -> Self {
        let methods = scores.methods.iter().map(|m| {
            let [rms, median] = m.rms_and_median_deg_s().map(rounded);
            RateReport {
                name: m.name,
                rms_deg_s: rms,
                median_deg_s: median,
                wrong_sign: rounded(m.wrong_sign),
                valid: m.valid.map(rounded),
                rate: ConsistencyReport::of(&m.rate),
                non_finite: m.non_finite,
            }
        });
        Self {
            name: scores.name.clone(),
            moving_samples: scores.moving,
            next_to_clipping: scores.clipped,
            methods: methods.collect(),
        }
    }
}
