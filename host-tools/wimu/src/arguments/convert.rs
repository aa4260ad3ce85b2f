//! Options of `wimu convert`.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use wimu_host::calibration::ExportTarget;
use wimu_host::export::ExportStream;

use super::reading::Reading;

#[derive(Args)]
#[command(after_help = "\
Examples:
  wimu convert session.mcap -o session.csv --stream corrected
  wimu convert session.mcap -o topics.mcap
  wimu convert flight.ulg -o flight.mcap
  wimu convert flight.ulg --with CAL.json -o corrected.csv
  wimu convert CAL.json --to c -o wimu_calibration.h

- stands for standard input or output.")]
pub struct Convert {
    /// A recording of any format, or a calibration with --to
    pub input: PathBuf,
    /// File to write: CSV, or ROS 2 messages (.mcap)
    ///
    /// File to write: a CSV table, or ROS 2 messages where its name ends in .mcap [default: a calibration is printed]
    #[arg(short, long, value_name = "FILE")]
    pub output: Option<PathBuf>,
    /// Correct the recording by this calibration
    ///
    /// Correct the recording by this calibration, or by the link model of `wimu compare -o`. Counts need a calibration
    /// made from counts; m/s² or g need one made from m/s² or g
    #[arg(long, value_name = "CAL.json", conflicts_with = "to")]
    pub with: Option<PathBuf>,
    /// Convert a calibration to this form
    #[arg(long, value_enum)]
    pub to: Option<Target>,
    /// Output of `wimu allan --json`: noise figures for kalibr
    #[arg(long, value_name = "NOISE.json", requires = "to")]
    pub noise: Option<PathBuf>,
    /// Stream of a recording of wimu [default: raw]
    ///
    /// Only `corrected` has the corrected magnetic field, where `Field
    /// Calibrated` is 1
    #[arg(long, value_enum, conflicts_with = "to")]
    pub stream: Option<Stream>,
    /// Index of the sensor [default: 0]
    ///
    /// Index of the sensor of a recording of wimu [default: 0]; those above 0 have raw samples only
    #[arg(long, value_name = "INDEX", conflicts_with = "to")]
    pub sensor: Option<u8>,
    #[command(flatten)]
    pub reading: Reading,
}

/// A form of a calibration.
#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Target {
    /// C header without dependencies
    C,
    /// For the ROS package imu_calib
    Ros,
    /// IMU file for Kalibr
    Kalibr,
    /// Python module with NumPy
    Numpy,
    /// MATLAB or Octave function
    Matlab,
    /// Bytes of a `CompiledSet`, for `wimu-model` on a device
    Device,
}

impl Target {
    /// The same for the library; `None` for bytes, which no other program reads.
    pub fn program(self) -> Option<ExportTarget> {
        Some(match self {
            Self::C => ExportTarget::C,
            Self::Ros => ExportTarget::Ros,
            Self::Kalibr => ExportTarget::Kalibr,
            Self::Numpy => ExportTarget::Numpy,
            Self::Matlab => ExportTarget::Matlab,
            Self::Device => return None,
        })
    }
}

/// A stream of a recording.
#[derive(Clone, Copy, ValueEnum)]
pub enum Stream {
    Raw,
    Corrected,
    Navigation,
}

impl From<Stream> for ExportStream {
    fn from(stream: Stream) -> Self {
        match stream {
            Stream::Raw => Self::Raw,
            Stream::Corrected => Self::Corrected,
            Stream::Navigation => Self::Navigation,
        }
    }
}
