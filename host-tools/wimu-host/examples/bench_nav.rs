//! What navigation reaches on recordings and simulated motions, against the plain baseline in the
//! same run: `cargo run --release -p wimu-host --example bench_nav [DATA] [array|unit|slide]`.

#[path = "bench_nav/array.rs"]
mod array;
#[path = "score_navigation/gyroscopes.rs"]
mod gyroscopes;
#[path = "score_navigation/low_pass.rs"]
mod low_pass;
#[path = "bench_nav/slide.rs"]
mod slide;
#[path = "bench_nav/unit.rs"]
mod unit;

use std::path::PathBuf;

fn main() {
    let mut arguments = std::env::args().skip(1);
    let data = PathBuf::from(arguments.next().unwrap_or("../shared/data".into()));
    let only = arguments.next();
    let wanted = |name: &str| only.as_deref().is_none_or(|o| o == name);
    if wanted("array") {
        array::bench(&data);
    }
    if wanted("unit") {
        unit::bench(&data);
    }
    if wanted("slide") {
        slide::bench(&data);
    }
}
