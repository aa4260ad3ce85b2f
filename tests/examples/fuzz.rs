//! The wire's fuzz bodies and the host's decoder on seeded bytes, or with `store` the store on
//! damaged flash, as many as asked for:
//! `cargo run --release -p wimu-tests --example fuzz [EXECUTIONS [SEED [store]]]`. Panics at the first fault;
//! `cargo xtask test` runs the same for a few seconds.

use std::error::Error;
use std::time::Instant;

use wimu_testkit::figure;
use wimu_tests::{Random, fuzz_once, fuzz_store};

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let executions: u64 = arguments.next().map_or(Ok(10_000_000), |n| n.parse())?;
    let seed: u64 = arguments.next().map_or(Ok(1), |n| n.parse())?;
    let which = arguments.next();
    let body = match which.as_deref() {
        None => |seeded: &mut Random| {
            fuzz_once(seeded);
            1
        },
        Some("store") => fuzz_store,
        Some(other) => return Err(format!("`{other}` is no fuzz body: store, or nothing").into()),
    };
    let start = Instant::now();
    let mut seeded = Random::new(seed);
    let (mut done, mut tell) = (0, 0);
    while done < executions {
        if done >= tell {
            eprintln!("{done} of {executions}, {:.0} s", start.elapsed().as_secs_f64());
            tell += 1_000_000;
        }
        done += body(&mut seeded);
    }
    println!("seed {seed}, {:.0} s", start.elapsed().as_secs_f64());
    let claim = match which {
        None => "faults in random, damaged and reordered frames, all decoders",
        Some(_) => "faults of the store on damaged images of flash",
    };
    figure(&format!("{claim}, seed {seed}"), format!("0 of {done}"), "none", true);
    Ok(())
}
