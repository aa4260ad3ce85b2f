//! `wimu demo --localize FOLDER`: files of simulated walks, and the commands that locate them.

use std::fmt::Write as _;
use std::path::Path;

use serde_json::json;
use wimu_host::{OutputFile, Problem, Result};
use wimu_sim::walk::{HALL_M, RangeWalk, Strides, fixes, sensed};

use crate::output::Output;

/// Duration of the walk with ranges, s, and fraction of its ranges without line of sight.
const WALK_S: f64 = 60.0;
const BLOCKED: f64 = 0.05;
/// Corners of the walk on foot, m, east and north: a closed path of 96 m.
const CORNERS_M: [[f64; 2]; 5] = [[0.0, 0.0], [34.0, 0.0], [34.0, 14.0], [0.0, 14.0], [0.0, 0.0]];
/// Rate of the inertial samples, Hz: the least for `--profile foot`.
const RATE_HZ: f64 = 100.0;
/// Interval of the fixes, s, and their standard deviation, m.
const FIX_S: f64 = 5.0;
const FIX_M: f64 = 0.3;

pub fn run(seed: u64, folder: &Path, output: &Output) -> Result<()> {
    std::fs::create_dir_all(folder)
        .map_err(|error| Problem::file(&folder.display().to_string(), "create", &error))?;
    let files = files(seed);
    for (name, text) in &files {
        OutputFile::write(&folder.join(name), text)?;
    }
    let at = folder.display();
    output.print(format!(
        "wrote simulated walks to {at}: ranges to six anchors in a hall; a unit on a shoe, 96 m back to its start; a position fix \
         every {FIX_S} s. Try:\n  wimu navigate {at}/ranges.csv --setup anchors={at}/anchors.csv --report ranges.html\n  \
         wimu navigate {at}/walk.csv --profile foot --report foot.html\n  \
         wimu navigate {at}/walk.csv --profile foot --fixes {at}/fixes.csv --report fixes.html"
    ));
    output.object(&json!({"seed": seed, "files": files.map(|(name, _)| folder.join(name).display().to_string())}));
    Ok(())
}

/// The files in the formats of the guides.
fn files(seed: u64) -> [(&'static str, String); 4] {
    let recording = RangeWalk::new(seed, &HALL_M, WALK_S, BLOCKED).recording;
    let mut anchors = "Anchor,Position E (m),Position N (m),Position U (m)\n".to_owned();
    for anchor in &recording.anchors {
        let [e, n, u] = anchor.position_m;
        let _ = writeln!(anchors, "{},{e},{n},{u}", anchor.id);
    }
    let mut ranges = "Time (s),Anchor,Range (m)\n".to_owned();
    for range in &recording.ranges {
        let id = &recording.anchors[range.source].id;
        let _ = writeln!(ranges, "{:.1},{id},{:.4}", range.time_s, range.value[0]);
    }
    let strides = Strides::along(&CORNERS_M);
    let sensed = sensed(&strides, RATE_HZ, seed);
    let mut walk = "Time (s),Accelerometer X (m/s²),Accelerometer Y (m/s²),Accelerometer Z (m/s²),\
        Gyroscope X (rad/s),Gyroscope Y (rad/s),Gyroscope Z (rad/s)\n"
        .to_owned();
    for (time, sample) in sensed.samples.t.iter().zip(&sensed.samples.v) {
        let _ = write!(walk, "{:.2}", time.s());
        for value in sample.force_mps2.iter().chain(sample.rate_rad_s.iter().flatten()) {
            let _ = write!(walk, ",{value:.5}");
        }
        walk.push('\n');
    }
    let mut table = "Time (s),Position E (m),Position N (m),Position U (m),\
        Position Sigma E (m),Position Sigma N (m),Position Sigma U (m)\n"
        .to_owned();
    for fix in &fixes(&strides, FIX_S, FIX_M, seed).aids {
        let ([e, n, u], [de, dn, du]) = (fix.value, fix.sd);
        let _ = writeln!(table, "{:.1},{e:.3},{n:.3},{u:.3},{de},{dn},{du}", fix.time_s);
    }
    [("anchors.csv", anchors), ("ranges.csv", ranges), ("walk.csv", walk), ("fixes.csv", table)]
}
