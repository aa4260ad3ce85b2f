//! Whether the truth lies within the covariance of the one-unit filter, over seeds of simulated motions:
//! `cargo run --release -p wimu-nav --example consistency [SEEDS]`.

#[path = "../tests/common/mod.rs"]
mod common;

use common::motions::{Consistency, KINDS, Kind};
use wimu_testkit::{coverage_figure, figure};

fn main() {
    let argument = |k: usize| std::env::args().nth(k);
    let seeds: u64 = argument(1).and_then(|a| a.parse().ok()).unwrap_or(500);
    println!(
        "{seeds} seeds, a fifth of them at 1 kHz; after 1 / 2 / 5 s: median error, m | NEES below 7.81, % \
         | median NEES | NIS"
    );
    let (mut medians, mut innovations) = ([Vec::new(), Vec::new()], Vec::new());
    for kind in KINDS {
        for gyroscope in [false, true] {
            let mut below = Vec::new();
            for (rate, seeds) in [
                (10.0, seeds),
                (50.0, seeds),
                (200.0, seeds),
                (1000.0, seeds.div_ceil(5)),
            ] {
                let found = Consistency::over(kind, rate, gyroscope, seeds);
                println!("{found}");
                below.extend(found.below);
                medians[usize::from(gyroscope)].extend(found.nees);
                innovations.push(found.nis);
            }
            let (name, with) = (name(kind), with(gyroscope));
            let claim = format!("{name}, {with} gyroscope, 10 Hz to 1 kHz: NEES < 7.81");
            coverage_figure(&claim, &below, 0.9..=0.98);
        }
    }
    for (gyroscope, medians) in [false, true].into_iter().zip(medians) {
        let claim = format!(
            "median NEES of these motions, {} gyroscope",
            with(gyroscope)
        );
        range_figure(&claim, medians, [1.5, 3.5]);
    }
    range_figure(
        "mean NIS of gravity in these motions",
        innovations,
        [0.8, 1.2],
    );
}

/// Records the least and the largest of several figures.
fn range_figure(claim: &str, mut all: Vec<f64>, [low, high]: [f64; 2]) {
    all.sort_by(f64::total_cmp);
    if let (Some(least), Some(most)) = (all.first(), all.last()) {
        let met = *least >= low && *most <= high;
        let measured = format!("{least:.2} to {most:.2}");
        figure(claim, measured, &format!("{low} to {high}"), met);
    }
}

fn name(kind: Kind) -> &'static str {
    match kind {
        Kind::Hand => "hand",
        Kind::Walk => "walk",
        Kind::Slides => "moves on a table",
        Kind::Robot => "robot",
        Kind::Vibration => "hand, vibration",
    }
}

fn with(gyroscope: bool) -> &'static str {
    if gyroscope { "with" } else { "without" }
}
