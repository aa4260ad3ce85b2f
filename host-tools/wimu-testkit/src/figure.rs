//! Measured figures.

use std::fmt::Display;
use std::fs::OpenOptions;
use std::io::Write;

use serde_json::json;

/// Prints what was measured for a claim. In a campaign it is also appended, as a line of JSON, to the
/// file that the environment variable `WIMU_RESULTS` names.
///
/// `target` is what the figure should be, in the same words; `met` whether it is.
///
/// # Panics
/// When the file cannot be written.
pub fn figure(claim: &str, measured: impl Display, target: &str, met: bool) {
    let measured = measured.to_string();
    println!("{claim}: {measured} (target: {target})");
    let Some(file) = std::env::var_os("WIMU_RESULTS") else {
        return;
    };
    let test = std::thread::current().name().unwrap_or_default().to_owned();
    let row =
        json!({ "claim": claim, "figure": measured, "target": target, "met": met, "test": test });
    let opened = OpenOptions::new().create(true).append(true).open(&file);
    // One write a line: lines of parallel tests stay whole.
    let written = opened.and_then(|mut file| file.write_all(format!("{row}\n").as_bytes()));
    written.unwrap_or_else(|error| panic!("{}: {error}", file.display()));
}
