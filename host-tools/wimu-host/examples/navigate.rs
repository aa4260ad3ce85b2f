//! What `wimu navigate FILE.csv` says, from the library:
//! `cargo run -p wimu-host --example navigate -- FILE.csv`.

use std::path::Path;

use wimu_host::formats::{ReadOptions, load};
use wimu_host::imu::{Imu, ImuOptions};
use wimu_host::inertial::{Choice, InertialPath, navigate};

/// The path of a file.
pub fn path_of(file: &Path) -> wimu_host::Result<InertialPath> {
    let recording = load(file, &ReadOptions::default())?;
    navigate(&Imu::of(&recording, &ImuOptions::default())?, &Choice::default())
}

fn main() -> wimu_host::Result<()> {
    let file = std::env::args().nth(1).unwrap_or("path.csv".into());
    let path = path_of(Path::new(&file))?;
    let last = path.points[path.points.len() - 1];
    let [e, n, u] = last.position_m;
    println!(
        "{:?}: path {:.3} m, ends at E {e:+.3} N {n:+.3} U {u:+.3} m ± {:.3} m",
        path.method,
        path.distance_m(),
        last.sd_m()
    );
    match path.horizon_s(1.0) {
        Some(seconds) => println!("1 σ passes 1 m after {seconds:.1} s"),
        None => println!("1 σ stays below 1 m"),
    }
    if let Some((median, below)) = path.consistency() {
        println!("NEES: median {median:.2}, below 7.81 in {:.0} %", 100.0 * below);
    }
    for finding in &path.findings {
        println!("note: {finding}");
    }
    Ok(())
}
