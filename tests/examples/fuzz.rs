//! The wire's fuzz bodies and the host's decoder on seeded bytes, or with `store` the store on
//! damaged flash, as many as asked for:
//! `cargo run --release -p wimu-tests --example fuzz [EXECUTIONS [SEED [store]]]`. Panics at the first fault;
//! `cargo xtask test` runs the same for a few seconds.

use std::error::Error;
use std::time::Instant;

use wimu_tests::{Seeded, fuzz_once, fuzz_store_once};

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let executions: u64 = arguments.next().map_or(Ok(10_000_000), |n| n.parse())?;
    let seed: u64 = arguments.next().map_or(Ok(1), |n| n.parse())?;
    let body = match arguments.next().as_deref() {
        None => fuzz_once,
        Some("store") => fuzz_store_once,
        Some(other) => return Err(format!("`{other}` is no fuzz body: store, or nothing").into()),
    };
    let start = Instant::now();
    let mut seeded = Seeded(seed);
    for done in 0..executions {
        if done % 1_000_000 == 0 {
            eprintln!(
                "{done} of {executions}, {:.0} s",
                start.elapsed().as_secs_f64()
            );
        }
        body(&mut seeded);
    }
    println!(
        "{executions} executions from seed {seed}, no fault, {:.0} s",
        start.elapsed().as_secs_f64()
    );
    Ok(())
}
