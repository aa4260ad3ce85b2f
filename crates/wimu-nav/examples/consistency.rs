//! Whether the truth lies within the covariance of the one-unit filter, over seeds of simulated motions:
//! `cargo run --release -p wimu-nav --example consistency [SEEDS]`.

#[path = "../tests/common/mod.rs"]
mod common;

use common::motions::{Consistency, KINDS};

fn main() {
    let argument = |k: usize| std::env::args().nth(k);
    let seeds: u64 = argument(1).and_then(|a| a.parse().ok()).unwrap_or(500);
    let rates = if seeds < 50 {
        vec![50.0, 200.0]
    } else {
        vec![10.0, 50.0, 200.0, 1000.0]
    };
    println!(
        "{seeds} seeds; after 1 / 2 / 5 s: median error, m | NEES below 7.81, % | median NEES | NIS"
    );
    for kind in KINDS {
        for gyroscope in [false, true] {
            for rate in &rates {
                println!("{}", Consistency::over(kind, *rate, gyroscope, seeds));
            }
        }
    }
}
