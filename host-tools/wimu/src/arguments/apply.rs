//! Options of `wimu apply`, and of reading files of other programs.

use std::path::PathBuf;

use clap::Args;
use wimu_host::formats::ReadOptions;

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

/// How to read a file whose content does not say enough.
#[derive(Args)]
#[command(next_help_heading = "Input")]
pub struct Reading {
    /// Format of the file [default: by its content]
    #[arg(long, value_name = "FORMAT")]
    pub input_format: Option<String>,
    /// Topic or message to read where there are several
    #[arg(long)]
    pub topic: Option<String>,
    /// Columns of a table, such as "t=timestamp:ns,x=ax:g,y=ay:g,z=az:g"
    #[arg(long)]
    pub columns: Option<String>,
    /// Unit of accelerations that the file does not name: m/s2, g, mg or LSB
    #[arg(long, value_name = "UNIT")]
    pub units: Option<String>,
    /// Output at zero, LSB
    #[arg(long, value_name = "LSB", allow_negative_numbers = true)]
    pub zero_count: Option<f64>,
}

impl Reading {
    /// The same for the library.
    pub fn options(&self) -> ReadOptions {
        let mut options = ReadOptions::default();
        options.format.clone_from(&self.input_format);
        options.topic.clone_from(&self.topic);
        options.columns.clone_from(&self.columns);
        options.units.clone_from(&self.units);
        options.zero_count = self.zero_count;
        options
    }
}
