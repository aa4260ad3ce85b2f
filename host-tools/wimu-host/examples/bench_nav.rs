//! What the navigation of arrays reaches on recordings and simulated motions, against a plain baseline in the same
//! run: `cargo run --release -p wimu-host --example bench_nav [DATA]`.

#[path = "bench_nav/array.rs"]
mod array;
#[path = "score_navigation/gyroscopes.rs"]
mod gyroscopes;

use std::path::PathBuf;

fn main() {
    let mut arguments = std::env::args().skip(1);
    let data = PathBuf::from(arguments.next().unwrap_or("../shared/data".into()));
    array::bench(&data);
}
