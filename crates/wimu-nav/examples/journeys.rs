//! Whether the truth lies within the covariance of the one-unit filter on journeys between rests, over seeds:
//! `cargo run --release -p wimu-nav --example journeys [SEEDS] [KIND]`.

#[path = "../tests/common/mod.rs"]
mod common;

use common::journeys::{Journey, Journeys, Recorded};
use wimu_nav::unit::Zupt;
use wimu_testkit::figure;

/// Kinds that share a row of the results.
fn group(journey: Journey, how: &Recorded) -> &'static str {
    let perfect = how.rate_matrix + how.force_matrix + how.late_s + how.glitch_mps2 == 0.0;
    match journey {
        _ if !perfect => "errors of scale, axes, delay; a spike",
        Journey::Moves(_) | Journey::Turns | Journey::Steps => "moves, turns, steps",
        Journey::Violent(_) => "moves of up to 5 g, clipping",
        Journey::Slow(_) => "moves in 3 to 8 s",
        Journey::Cart(_) | Journey::Stairs(_) => "constant velocity after a push",
        Journey::Push(..) => "constant acceleration for 3 to 6 s",
        Journey::Carried(_) => "moves with turns of up to 180°",
        Journey::Vehicle(..) => "vehicle",
    }
}

/// Fractions, %, of valid moving samples with a NEES below 7.81, by default, with rests stated and with ZUPT off, and the
/// largest error by default, σ.
#[derive(Default)]
struct Row {
    below: [Vec<f64>; 3],
    greatest: f64,
}

/// Rows in the order in which they first appear.
#[derive(Default)]
struct Table(Vec<(String, Row)>);

impl Table {
    fn add(&mut self, journey: Journey, how: &Recorded, found: &Journeys) {
        let with = if how.gyroscope {
            "gyroscope"
        } else {
            "no gyroscope"
        };
        let name = format!("{with}, {}", group(journey, how));
        let index = self.0.iter().position(|(known, _)| *known == name);
        let index = index.unwrap_or_else(|| {
            self.0.push((name, Row::default()));
            self.0.len() - 1
        });
        let row = &mut self.0[index].1;
        row.below[how.zupt as usize].push(100.0 * found.below);
        if how.zupt == Zupt::Assumed {
            row.greatest = row.greatest.max(found.greatest);
        }
    }

    fn record(mut self) {
        self.0.sort_by(|a, b| a.0.cmp(&b.0));
        for (name, row) in &self.0 {
            let range = |all: &Vec<f64>| {
                let least = all.iter().copied().fold(f64::INFINITY, f64::min);
                let most = all.iter().copied().fold(f64::NEG_INFINITY, f64::max);
                format!("{least:.0}–{most:.0}")
            };
            let met = row
                .below
                .iter()
                .flatten()
                .all(|b| (90.0..=98.0).contains(b));
            let measured = row.below.each_ref().map(range).join(" / ") + " %";
            figure(&format!("{name}: NEES < 7.81"), measured, "90–98 %", met);
        }
        for with in ["gyroscope", "no gyroscope"] {
            let rows = self.0.iter().filter(|(name, _)| name.starts_with(with));
            let greatest = rows.map(|(_, row)| row.greatest).fold(0.0, f64::max);
            let claim = format!("{with}: largest valid error, ZUPT by default");
            figure(
                &claim,
                format!("{greatest:.1} σ"),
                "at most 5 σ",
                greatest <= 5.0,
            );
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
