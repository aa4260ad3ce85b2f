//! Options of `wimu navigate`.

use std::path::PathBuf;
use std::time::Duration;

use clap::builder::{OsStringValueParser, TypedValueParser as _};
use clap::{Args, ValueEnum};
use wimu_host::inertial::{StartPose, Zupt};

use super::aids::Aids;
use super::reading::Reading;
use super::values::{TimeSpans, from_to, positive, seconds, start_pose, time_spans};

#[derive(Args)]
#[command(
    after_help = "Example: wimu navigate walk.csv --profile foot -o path.csv; more with --help",
    after_long_help = "\
Examples:
  wimu navigate session.mcap -o path.csv --report path.html
  wimu navigate walk.csv --profile foot
  wimu navigate desk.csv --rests \"0-3,10.5-12\" --within 0.5
  wimu navigate walk.csv --smooth off
  wimu navigate drive.csv --profile vehicle --fixes gnss.csv --odometry wheels.csv
  wimu navigate walk.csv --profile foot --loop
  wimu navigate /dev/ttyACM0 --profile foot --fixes tcp://127.0.0.1:9000
  wimu navigate raw.csv --with CAL.json
  wimu navigate board.csv --setup geometry=positions.csv -o path.csv
  wimu navigate board.csv --setup geometry=four:30mm
  wimu navigate ranges.csv --setup anchors=anchors.csv --odometry wheels.csv
  wimu navigate imu.csv --ranges ranges.csv --setup anchors=anchors.csv
  wimu navigate fine.csv coarse.csv --setup full_scales_g=[2,16]
  wimu navigate thigh.csv shank.csv --relative -o angle.csv"
)]
pub struct Navigate {
    /// A LINK or a recording of any format
    ///
    /// A LINK, or a recording of any format; of other programs: corrected samples, or with --with the sensor's
    /// output. With anchors in the setup alone: ranges
    // The parser of paths refuses the empty default.
    #[arg(
        required_unless_present = "print_setup",
        default_value = "",
        hide_default_value = true,
        value_parser = OsStringValueParser::new().map(PathBuf::from)
    )]
    pub input: PathBuf,
    /// Stop after this time, s
    #[arg(hide_short_help = true, long = "for", value_name = "SECONDS", value_parser = seconds, help_heading = "Output")]
    pub seconds: Option<Duration>,
    /// Positions a second that are computed while a board sends [default: 10]
    #[arg(hide_short_help = true, long, value_name = "HZ", value_parser = from_to(0.01, 1000.0), help_heading = "Output")]
    pub updates: Option<f64>,
    /// Further recordings of one body
    ///
    /// Recordings of the coarser accelerometers; with --relative that of the second unit
    #[arg(value_name = "BOARD")]
    pub boards: Vec<PathBuf>,

    #[command(flatten)]
    pub reading: Reading,
    /// Calibration that `wimu calibrate -o` wrote
    ///
    /// Counts need a calibration made from counts; m/s² or g need one made from
    /// m/s² or g. It replaces the calibration in a recording. For an array, give one for each sensor, in the order of
    /// its geometry
    #[arg(long, value_name = "CAL.json", help_heading = "Input")]
    pub with: Vec<PathBuf>,
    /// Sensitivity of counts, LSB/g [default: that of the calibration or of a column `Sensitivity (LSB/g)`; for an array
    /// 2048]
    #[arg(hide_short_help = true, long, value_name = "LSB_PER_G", value_parser = positive, help_heading = "Input")]
    pub sensitivity: Option<f64>,

    /// Zero-velocity updates at rests
    ///
    /// The path that the device itself has computed does not change
    #[arg(long, value_enum, help_heading = "Model")]
    pub zupt: Option<ZeroVelocity>,
    /// The unit stays within M metres of its start (1 σ of a component)
    #[arg(hide_short_help = true, long, value_name = "M", value_parser = positive, help_heading = "Model")]
    pub within: Option<f64>,
    /// Times of rests: "0-3,10.5-12"
    ///
    /// Times at which the unit rested, s, as in the file: "0-3,10.5-12" [default: those that are detected]
    #[arg(
        long,
        value_name = "FROM-TO,…",
        value_parser = time_spans,
        help_heading = "Model"
    )]
    pub rests: Option<TimeSpans>,
    /// Position at the start, m, and heading (body x from east towards north), deg: "1.5,0,0.8,90" or "1.5,0,0.8"
    #[arg(
        hide_short_help = true,
        long,
        value_name = "E,N,U[,DEG]",
        value_parser = start_pose,
        allow_hyphen_values = true,
        help_heading = "Model"
    )]
    pub start: Option<StartPose>,
    #[command(flatten)]
    pub aids: Aids,
    /// The path ends where it began, within M metres (1 σ of a component)
    #[arg(
        hide_short_help = true,
        long = "loop",
        value_name = "M",
        num_args = 0..=1,
        default_missing_value = "0.1",
        value_parser = positive,
        help_heading = "Aiding"
    )]
    pub closes: Option<f64>,
    /// Smooth over the whole recording
    ///
    /// The real-time σ is reported in either case
    #[arg(long, value_enum, value_name = "ON|OFF", default_value_t, help_heading = "Model")]
    pub smooth: Smoothing,

    /// Angle and rotation between two units on two bodies that a joint connects: INPUT and BOARD. Two calibrations are those
    /// of both, in this order
    #[arg(hide_short_help = true, long, requires = "boards", help_heading = "Model")]
    pub relative: bool,
    /// Print a setup with all keys explained
    #[arg(hide_short_help = true, long, exclusive = true, help_heading = "Output")]
    pub print_setup: bool,

    /// Wheel odometry, CSV
    ///
    /// Wheel odometry: CSV with columns `Time (s)` and, with --profile vehicle, `Speed (m/s)` or `Distance Increment (m)`;
    /// beside ranges in the plane `Distance Increment (m)` and `Heading Increment (rad)`
    #[arg(hide_short_help = true, long, value_name = "WHEELS.csv", help_heading = "Aiding")]
    pub odometry: Option<PathBuf>,
    /// Write the path to this file, CSV or MCAP
    ///
    /// Write velocity and position to this CSV file, or as ROS 2 odometry, path and transforms where its name ends in
    /// .mcap; - is standard output, as CSV
    #[arg(short, long, value_name = "PATH.csv", help_heading = "Output")]
    pub output: Option<PathBuf>,
    /// Write a report with pictures to this file
    #[arg(long, value_name = "FILE.html", help_heading = "Output")]
    pub report: Option<PathBuf>,
}

impl Navigate {
    /// Standard deviation up to which a position is valid, m.
    pub fn limit_m(&self) -> f64 {
        self.aids.setup.limit_m.unwrap_or(1.0)
    }
}

/// Use of rests. An accelerometer cannot tell rest from constant velocity.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ZeroVelocity {
    /// Velocity is zero at each rest (default)
    On,
    /// Velocity is an unknown constant of 0 ± 0.1 m/s at each rest: σ includes it
    Cautious,
    /// Rests are not used
    Off,
}

impl ZeroVelocity {
    /// The option's value, or its default.
    pub fn of(option: Option<Self>) -> Zupt {
        match option {
            None | Some(Self::On) => Zupt::Stated,
            Some(Self::Cautious) => Zupt::Assumed,
            Some(Self::Off) => Zupt::Off,
        }
    }
}

/// Samples that a point rests on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Smoothing {
    /// All samples: fixed-interval smoother
    #[default]
    On,
    /// The samples up to the point, as on a device: forward filter
    Off,
}
