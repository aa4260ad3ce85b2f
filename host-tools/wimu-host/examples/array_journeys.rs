//! Whether the truth lies within what an array says of rate and position, over seeds of simulated journeys with
//! uncalibrated sensors: `cargo run --release -p wimu-host --example array_journeys [SEEDS]`.

#[path = "../tests/array_journeys/mod.rs"]
mod array_journeys;
#[path = "../tests/common/mod.rs"]
mod common;

use array_journeys::{Case, Kind, Places};
use wimu_host::inertial::Zupt;
use wimu_testkit::figure;

/// Target of NEES below 7.81, %.
const CONSISTENT: std::ops::RangeInclusive<f64> = 90.0..=98.0;

fn main() {
    let argument = |k: usize| std::env::args().nth(k);
    let seeds: u64 = argument(1).and_then(|a| a.parse().ok()).unwrap_or(100);
    let only = argument(2);
    println!(
        "{seeds} seeds; bias b m/s², scale and direction s, places p mm, times t µs that nobody told; valid and NEES below \
         7.81 of the valid positions, greatest of a seed in deviations (median / most) and m; rates while it turns: NEES below \
         7.81, error and deviation"
    );
    let base = Case::default();
    let wrong = Case { bias: 0.1, scale: 0.015, place: 1e-3, ..base };
    // Nothing stated of the rests.
    let open = Case { zupt: Zupt::Assumed, ..base };
    let open_wrong = Case { zupt: Zupt::Assumed, ..wrong };
    let groups: [(&str, Vec<Case>); 8] = [
        (
            "errors",
            vec![
                base,
                Case { bias: 0.05, ..base },
                Case { bias: 0.2, ..base },
                Case { scale: 0.01, ..base },
                Case { scale: 0.02, ..base },
                Case { place: 0.5e-3, ..base },
                Case { place: 1e-3, ..base },
                Case { skew: 3e-4, ..base },
                Case { skew: 1e-3, ..base },
                Case { places: Places::Four(0.03), skew: 3e-4, ..base },
                wrong,
                Case { kind: Kind::Moves(0.3, 0.3), ..wrong },
                Case { kind: Kind::Moves(0.3, 1.0), ..wrong },
                Case { places: Places::Board, ..wrong },
                Case { places: Places::Board, kind: Kind::Moves(0.3, 0.3), ..wrong },
                Case { places: Places::Four(0.03), ..wrong },
            ],
        ),
        (
            "one-move",
            [0.3, 1.0, 3.0]
                .into_iter()
                .flat_map(|radians| {
                    [Places::Octahedron(0.03), Places::Board, Places::Four(0.03)]
                        .map(|places| Case { kind: Kind::Move(0.3, radians), places, ..wrong })
                })
                .collect(),
        ),
        (
            "cube",
            [0.3, 1.0, 3.0]
                .into_iter()
                .flat_map(|radians| {
                    let cube =
                        Case { kind: Kind::Moves(0.3, radians), places: Places::Cube(0.1), ..base };
                    let wrong = Case { bias: 0.1, scale: 0.015, place: 1e-3, ..cube };
                    let off = Case { zupt: Zupt::Off, ..cube };
                    [cube, wrong, off]
                })
                .collect(),
        ),
        (
            "quiet",
            vec![
                Case { kind: Kind::Moves(0.3, 0.3), ..base },
                Case { kind: Kind::Moves(0.3, 1.0), ..base },
                Case { places: Places::Board, kind: Kind::Moves(0.3, 0.3), ..base },
                Case { places: Places::Octahedron(0.01), ..base },
            ],
        ),
        (
            "rates",
            [25.0, 50.0, 100.0, 400.0]
                .into_iter()
                .flat_map(|rate_hz| {
                    [
                        Case { rate_hz, ..base },
                        Case { rate_hz, kind: Kind::Moves(0.3, 1.0), ..base },
                        Case { rate_hz, ..wrong },
                    ]
                })
                .collect(),
        ),
        (
            "zupt-off",
            [50.0, 200.0]
                .into_iter()
                .flat_map(|rate_hz| {
                    let off = Case { rate_hz, zupt: Zupt::Off, ..base };
                    [
                        off,
                        Case { kind: Kind::Still(10.0), ..off },
                        Case { kind: Kind::Still(10.0), places: Places::Octahedron(0.01), ..off },
                        Case { kind: Kind::Moves(0.3, 1.0), ..off },
                        Case { zupt: Zupt::Off, rate_hz, ..wrong },
                    ]
                })
                .collect(),
        ),
        (
            "even",
            vec![
                Case { kind: Kind::Cart(0.1, 10.0), ..open },
                Case { kind: Kind::Cart(0.3, 10.0), ..open },
                Case { kind: Kind::Cart(1.0, 8.0), ..open },
                Case { kind: Kind::Cart(2.0, 8.0), ..open },
                Case { kind: Kind::Cart(0.3, 10.0), ..open_wrong },
                Case { kind: Kind::Slow(4.0, 0.3, 0.3), ..open },
                Case { kind: Kind::Slow(4.0, 0.3, 1.0), ..open },
            ],
        ),
        (
            "turntable",
            [(0.3, 1.0), (0.5, 0.5), (1.0, 0.3), (1.0, 1.0), (2.0, 0.3), (3.0, 0.3), (6.0, 0.1)]
                .into_iter()
                .map(|(spin, away)| Case { kind: Kind::Turntable(spin, away), ..open })
                .collect(),
        ),
    ];
    let mut refused = 0;
    for (name, cases) in groups {
        if only.as_deref().is_some_and(|only| only != name) {
            continue;
        }
        println!("# {name}");
        let mut below = [Vec::new(), Vec::new()];
        for case in cases {
            let found = case.over(seeds);
            println!("{found}");
            // Bodies that do not rotate have no rate that is scored.
            if found.outcomes.iter().any(|o| !o.position.is_empty()) {
                below[0].push(found.position());
            }
            if found.outcomes.iter().any(|o| !o.rate.is_empty()) {
                below[1].push(found.rate());
            }
            refused += found.refused;
        }
        let range = |all: &Vec<f64>| {
            let least = all.iter().copied().fold(f64::INFINITY, f64::min);
            let most = all.iter().copied().fold(0.0, f64::max);
            format!("{least:.0}–{most:.0} %")
        };
        let met = below.iter().flatten().all(|below| CONSISTENT.contains(below));
        let claim = format!("arrays, {}: NEES < 7.81, position / rate", about(name));
        let measured = below.each_ref().map(range).join(" / ");
        figure(&claim, measured, "90–98 %", met);
    }
    let claim = "arrays: journeys that are refused";
    figure(claim, refused, "none", refused == 0);
}

/// What the cases of a group have in common.
fn about(group: &str) -> &str {
    match group {
        "errors" => "uncalibrated sensors",
        "one-move" => "one move, uncalibrated",
        "cube" => "six axes on a cube",
        "quiet" => "slow rotations",
        "rates" => "25 to 400 Hz",
        "zupt-off" => "ZUPT off",
        "even" => "constant velocity",
        other => other,
    }
}
