//! Options of `wimu apply`.

use std::path::PathBuf;

use clap::Args;

use super::reading::Reading;

#[derive(Args)]
#[command(after_help = "\
The calibration and the recording must have the same unit: counts need a calibration made from counts; \
m/s² or g need one made from m/s² or g.

Examples:
  wimu apply CAL.json walk.csv -o corrected.csv
  wimu apply CAL.json flight.ulg -o corrected.mcap
  cat walk.csv | wimu apply CAL.json - -o - > corrected.csv")]
pub struct Apply {
    /// Calibration that `wimu calibrate -o` wrote
    #[arg(value_name = "CAL.json")]
    pub calibration: PathBuf,
    /// Recording of the same sensor, in any format of docs/FORMATS.md; - is standard input
    pub input: PathBuf,
    /// CSV file, or ROS 2 messages where its name ends in .mcap; - is standard output, as CSV
    #[arg(short, long, value_name = "FILE")]
    pub output: PathBuf,
    #[command(flatten)]
    pub reading: Reading,
}
