//! Whether the truth lies within the covariance of the navigator, over draws of motions and sensor errors:
//! `cargo run --release -p wimu-nav --example consistency [DRAWS]`.

#[path = "../tests/common/mod.rs"]
mod common;

use common::consistency::{Consistency, KINDS};
use wimu_testkit::{coverage_figure, figure};

fn main() {
    let argument = std::env::args().nth(1);
    let draws: u64 = argument.and_then(|a| a.parse().ok()).unwrap_or(500);
    println!(
        "{draws} draws, twice in motion and once at rest: median error | NEES below 7.81 | median NEES"
    );
    for gyroscope in [true, false] {
        let with = if gyroscope { "with" } else { "without" };
        let mut medians = Vec::new();
        let kinds = KINDS.into_iter();
        for kind in kinds.filter(|kind| kind.gyroscopes().any(|with| with == gyroscope)) {
            let found = Consistency::over(kind, gyroscope, draws);
            println!("{found}");
            let claim = format!("{kind:?}, {with} gyroscope: NEES < 7.81");
            coverage_figure(&claim, &found.below, 0.9..=0.98);
            medians.extend(found.median);
        }
        medians.sort_by(f64::total_cmp);
        // 0.7 to 1.4 of the median of χ² with three degrees of freedom.
        let [least, most] = [medians[0], medians[medians.len() - 1]];
        figure(
            &format!("{with} gyroscope: median NEES of these motions"),
            format!("{least:.2} to {most:.2}"),
            "1.66 to 3.31",
            least >= 1.66 && most <= 3.31,
        );
    }
}
