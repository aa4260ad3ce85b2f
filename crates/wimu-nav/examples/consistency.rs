//! Whether the truth lies within the covariance of the one-unit filter, over seeds of simulated motions:
//! `cargo run --release -p wimu-nav --example consistency [SEEDS]`.

#[path = "../tests/common/mod.rs"]
mod common;

use common::motions::{Consistency, KINDS};

fn main() {
    let argument = |k: usize| std::env::args().nth(k);
    let seeds: u64 = argument(1).and_then(|a| a.parse().ok()).unwrap_or(500);
    println!(
        "{seeds} seeds, a fifth of them at 1 kHz; after 1 / 2 / 5 s: median error, m | NEES below 7.81, % \
         | median NEES | NIS"
    );
    for kind in KINDS {
        for gyroscope in [false, true] {
            for (rate, seeds) in [
                (10.0, seeds),
                (50.0, seeds),
                (200.0, seeds),
                (1000.0, seeds.div_ceil(5)),
            ] {
                println!("{}", Consistency::over(kind, rate, gyroscope, seeds));
            }
        }
    }
}
