//! The table, and its figures in a campaign.

use serde::Serialize;
use wimu_testkit::figure;

use crate::manifest::{Half, Metric, Source};
use crate::score::{Score, quantile};

/// Errors that a standard deviation does not explain, σ.
pub const BEYOND_SIGMA: f64 = 6.0;
const HEAD: [&str; 2] = [
    "system             recording                       metric      figure                ",
    "baseline                              ratio              NEES < 95 %  valid samples worst σ end σ exit",
];

/// A recording, or all of a system, beside one baseline.
#[derive(Clone, Serialize)]
pub struct Row {
    pub system: String,
    /// Name of the recording; of a pool, what the figures are of its recordings.
    pub recording: String,
    pub metric: Metric,
    pub half: Option<Half>,
    pub bar: Vec<f64>,
    #[serde(flatten)]
    pub score: Score,
    pub baseline: Option<Source>,
    pub baseline_figures: Vec<f64>,
    pub ratios: Vec<f64>,
    /// Of a pool: recordings with a valid sample beyond 6 σ, and headlines within 1 and 2 σ.
    pub note: String,
}

/// The table with its header.
pub fn print(rows: &[Row]) {
    println!("\n{}{}", HEAD[0], HEAD[1]);
    rows.iter().for_each(|row| println!("{}", row.line()));
}

impl Row {
    fn line(&self) -> String {
        let Score { samples, worst_sigma, headline_sigma, exit, .. } = self.score;
        let [consistent, valid] = self.shares();
        format!(
            "{:18} {:31} {:11} {:21} {:37} {:18} {consistent:11} {valid:>6} {samples:7} {worst_sigma:7.1} {:>5} {exit:4} {}",
            self.system,
            self.recording,
            name(self.metric),
            list(&self.score.figures),
            self.beside(),
            list(&self.ratios),
            headline_sigma.map_or(String::new(), |sigma| format!("{sigma:.2}")),
            self.note,
        )
    }

    /// Consistent samples, and valid ones.
    fn shares(&self) -> [String; 2] {
        let share = |[part, all]: [usize; 2]| part as f64 / all.max(1) as f64;
        let Score { consistent, valid, .. } = self.score;
        let of = format!("{:.2} of {}", share(consistent), consistent[1]);
        [of, format!("{:.0} %", 100.0 * share(valid))]
    }

    /// Name and figures of the baseline.
    fn beside(&self) -> String {
        let baseline = self.baseline.map_or(String::new(), name);
        format!("{baseline} {}", list(&self.baseline_figures))
    }

    /// Records the row as a figure of a campaign.
    pub fn record(&self) {
        let [_, valid] = self.shares();
        let claim = format!("{}, {}: {}", self.system, self.recording, name(self.metric));
        let measured = format!("{}; valid {valid}", list(&self.score.figures));
        let beside = self.beside();
        let target = match &*self.bar {
            [] => beside,
            bar => format!("{} ({beside})", list(bar)),
        };
        // A figure that is not known misses its bar.
        let met = self.score.figures.iter().zip(&self.bar).all(|(figure, bar)| figure <= bar);
        figure(&claim, measured, &target, met);
    }
}

/// For each system, metric and baseline the median of its recordings, then the 90 % quantile.
pub fn pools(rows: &[Row]) -> Vec<Row> {
    let mut pools: Vec<Row> = Vec::new();
    for first in rows {
        let key = |row: &Row| (row.system.clone(), row.metric, row.baseline);
        if pools.iter().any(|pool| key(pool) == key(first)) {
            continue;
        }
        let all: Vec<&Row> = rows.iter().filter(|row| key(row) == key(first)).collect();
        let scores: Vec<&Score> = all.iter().map(|row| &row.score).collect();
        let beyond = scores.iter().filter(|score| score.worst_sigma > BEYOND_SIGMA).count();
        let ends: Vec<f64> = scores.iter().filter_map(|score| score.headline_sigma).collect();
        let within = |sigma: f64| ends.iter().filter(|end| **end <= sigma).count();
        let ends = format!("end σ < 1, 2: {}, {} of {}", within(1.0), within(2.0), ends.len());
        let sum = |of: fn(&Score) -> [usize; 2]| {
            [0, 1].map(|k| scores.iter().map(|score| of(score)[k]).sum())
        };
        for (part, what) in [(0.5, "median"), (0.9, "90 %")] {
            let column = |of: fn(&Row) -> &Vec<f64>| {
                let known = |k| {
                    all.iter().filter_map(move |row| of(row).get(k)).filter(|v: &&f64| !v.is_nan())
                };
                (0..3).map(|k| quantile(known(k).copied(), part)).take(of(first).len()).collect()
            };
            let score = Score {
                figures: column(|row| &row.score.figures),
                samples: scores.iter().map(|score| score.samples).sum(),
                consistent: sum(|score| score.consistent),
                valid: sum(|score| score.valid),
                worst_sigma: scores.iter().map(|score| score.worst_sigma).fold(0.0, f64::max),
                headline_sigma: None,
                exit: scores.iter().map(|score| score.exit).max().unwrap_or(0),
            };
            pools.push(Row {
                recording: format!("{what} of {}", all.len()),
                note: format!(" {beyond} > 6 σ, {ends}"),
                half: None,
                score,
                baseline_figures: column(|row| &row.baseline_figures),
                ratios: column(|row| &row.ratios),
                ..first.clone()
            });
        }
    }
    pools
}

/// Values with three significant digits.
fn list(values: &[f64]) -> String {
    let one = |value: &f64| {
        let digits = (2 - value.abs().max(1e-3).log10().floor() as i32).clamp(0, 3) as usize;
        if value.is_finite() { format!("{value:.digits$}") } else { "-".to_owned() }
    };
    values.iter().map(one).collect::<Vec<String>>().join(" / ")
}

/// The name in the manifest.
fn name(value: impl Serialize) -> String {
    let value = serde_json::to_value(value).unwrap_or_default();
    value.as_str().unwrap_or_default().replace('-', " ")
}
