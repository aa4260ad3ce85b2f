//! Whether the truth lies within the covariance of the one-unit filter on journeys between rests, over seeds:
//! `cargo run --release -p wimu-nav --example journeys [SEEDS] [KIND]`.

#[path = "../tests/common/mod.rs"]
mod common;

use std::collections::BTreeMap;

use common::journeys::{Journey, Journeys, Recorded};
use wimu_nav::unit::Zupt;
use wimu_testkit::figure;

/// Cases that share rows of the results.
fn group(journey: Journey, how: &Recorded) -> &'static str {
    let errors = how.rate_matrix + how.force_matrix + how.late_s + how.glitch_mps2 > 0.0;
    match journey {
        _ if errors && how.gyroscope => "errors of scale, axes, delay",
        Journey::Slow(_) | Journey::Cart(_) | Journey::Stairs(_) | Journey::Push(..) => {
            "slow or steady motion"
        }
        _ => "moves and rotations",
    }
}

/// Fractions, %, of valid moving samples with a NEES below 7.81, by row, and the largest errors with ZUPT by default, σ.
#[derive(Default)]
struct Table {
    below: BTreeMap<String, Vec<f64>>,
    greatest: BTreeMap<&'static str, f64>,
}

impl Table {
    fn add(&mut self, journey: Journey, how: &Recorded, found: &Journeys) {
        let with = if how.gyroscope {
            "gyroscope"
        } else {
            "no gyroscope"
        };
        let zupt = match how.zupt {
            Zupt::Assumed => "default",
            Zupt::Stated => "stated",
            Zupt::Off => "off",
        };
        let row = format!("{with}, {}, ZUPT {zupt}", group(journey, how));
        self.below.entry(row).or_default().push(100.0 * found.below);
        if how.zupt == Zupt::Assumed {
            let greatest = self.greatest.entry(with).or_default();
            *greatest = greatest.max(found.greatest);
        }
    }

    fn record(&self) {
        for (row, below) in &self.below {
            let least = below.iter().copied().fold(f64::INFINITY, f64::min);
            let most = below.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            figure(
                &format!("{row}: NEES < 7.81"),
                format!("{least:.0} to {most:.0} %"),
                "90 to 98 %",
                least >= 90.0 && most <= 98.0,
            );
        }
        for (with, greatest) in &self.greatest {
            let claim = format!("{with}, ZUPT default: largest error of a valid position");
            let met = *greatest <= 5.0;
            figure(&claim, format!("{greatest:.1} σ"), "at most 5 σ", met);
        }
    }
}

fn main() {
    let argument = |k: usize| std::env::args().nth(k);
    let seeds: u64 = argument(1).and_then(|a| a.parse().ok()).unwrap_or(500);
    let only = argument(2).unwrap_or_default();
    println!(
        "{seeds} seeds: valid, %, of all samples and of those in motion | NEES below 7.81, % of the valid samples in motion, of a seed but for a tenth | greatest error of a \
         seed in deviations, median and most | stillness taken for rests, % | error at the end | way that even motion at the \
         rests may have been, 1 sd"
    );
    let kinds = [
        Journey::Moves(0.3),
        Journey::Moves(1.5),
        Journey::Turns,
        Journey::Steps,
        Journey::Violent(0.3),
        Journey::Violent(0.4),
        Journey::Violent(0.6),
        Journey::Slow(3.0),
        Journey::Slow(5.0),
        Journey::Slow(8.0),
        Journey::Cart(0.02),
        Journey::Cart(0.05),
        Journey::Cart(0.1),
        Journey::Cart(0.4),
        Journey::Cart(1.0),
        Journey::Stairs(0.05),
        Journey::Push(1.0, 4.0, false),
        Journey::Push(1.0, 4.0, true),
        Journey::Push(0.3, 4.0, false),
        Journey::Push(1.0, 1.0, true),
        Journey::Carried(std::f64::consts::PI),
        Journey::Vehicle(2.0, 4.0),
        Journey::Vehicle(1.0, 2.0),
    ];
    let perfect = Recorded::default();
    let rate = |rate_matrix| Recorded {
        rate_matrix,
        ..perfect
    };
    let force = |force_matrix| Recorded {
        force_matrix,
        ..perfect
    };
    let late = |late_s| Recorded { late_s, ..perfect };
    let turned = [
        rate(0.01),
        rate(0.02),
        rate(0.03),
        force(0.01),
        force(0.015),
        late(0.01),
        late(0.02),
        late(0.05),
        Recorded {
            glitch_mps2: 40.0,
            ..perfect
        },
    ];
    let mut table = Table::default();
    let mut show = |kind, how: Recorded| {
        let found = Journeys::over(kind, how, seeds);
        println!("{found}");
        table.add(kind, &how, &found);
    };
    for kind in kinds {
        if !format!("{kind:?}").contains(&only) {
            continue;
        }
        for (gyroscope, zupt) in [true, false]
            .into_iter()
            .flat_map(|g| [Zupt::Assumed, Zupt::Stated, Zupt::Off].map(|zupt| (g, zupt)))
        {
            let how = Recorded {
                gyroscope,
                zupt,
                ..perfect
            };
            show(kind, how);
            if matches!(kind, Journey::Carried(_) | Journey::Vehicle(..)) {
                for sensors in turned {
                    if !gyroscope && (sensors.rate_matrix > 0.0 || sensors.late_s > 0.0) {
                        continue;
                    }
                    let how = Recorded {
                        gyroscope,
                        zupt,
                        ..sensors
                    };
                    show(kind, how);
                }
            }
            if matches!(kind, Journey::Violent(_)) {
                let clips_mps2 = 2.0 * 9.80665;
                let how = Recorded { clips_mps2, ..how };
                show(kind, how);
            }
        }
    }
    table.record();
}
