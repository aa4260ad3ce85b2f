//! Options of `wimu navigate`.

use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, ValueEnum};
use wimu_host::inertial::{StartPose, Zupt};

use super::aids::Aids;
use super::reading::Reading;
use super::values::{TimeSpans, from_to, numbers, positive, seconds, start_pose, time_spans};

#[derive(Args)]
#[command(after_help = "\
GEOMETRY is a file or a preset:
  FILE.csv         header `X (m),Y (m),Z (m)` (or mm), one row per triad of axes
  FILE.json        as `wimu calibrate --geometry -o` or --refine wrote it
  four:30mm        four triads at this distance from the centre
  octahedron:30mm  six triads at this distance from the centre
  board:9.5mm,2mm  eight triads; half side and half thickness of the board
The path is that of the centre of the sensors.

Examples:
  wimu navigate session.mcap -o path.csv --report path.html
  wimu navigate walk.csv --profile foot
  wimu navigate desk.csv --rests \"0-3,10.5-12\" --within 0.5
  wimu navigate walk.csv --smooth off
  wimu navigate drive.csv --profile vehicle --fixes gnss.csv --odometry wheels.csv
  wimu navigate walk.csv --profile foot --loop
  wimu navigate /dev/ttyACM0 --profile foot --fixes tcp://127.0.0.1:9000
  wimu navigate raw.csv --with CAL.json
  wimu navigate board.csv --geometry positions.csv -o path.csv
  wimu navigate board.csv --geometry ARRAY.json
  wimu navigate a.mcap b.mcap c.mcap d.mcap --geometry boards.json
  wimu navigate ranges.csv --anchors anchors.csv -o path.csv
  wimu navigate ranges.csv --anchors anchors.csv --odometry wheels.csv
  wimu navigate imu.csv --ranges ranges.csv --anchors anchors.csv
  wimu navigate /dev/ttyACM0 --ranges tcp://127.0.0.1:9000 --anchors anchors.csv
  wimu navigate fine.csv coarse.csv --full-scales 2,16
  wimu navigate thigh.csv shank.csv --relative -o angle.csv")]
pub struct Navigate {
    /// A LINK, or a recording of any format; of other programs: corrected samples, or with --with the sensor's
    /// output. With --anchors alone: ranges
    pub input: PathBuf,
    /// Stop after this time, s
    #[arg(long = "for", value_name = "SECONDS", value_parser = seconds, help_heading = "Output")]
    pub seconds: Option<Duration>,
    /// Positions a second that are computed while a board sends [default: 10]
    #[arg(long, value_name = "HZ", value_parser = from_to(0.01, 1000.0), help_heading = "Output")]
    pub updates: Option<f64>,
    /// With --geometry: recordings of further boards on the same body, in the order of the geometry. With --full-scales: those
    /// of the coarser accelerometers. With --relative: that of the second unit
    #[arg(value_name = "BOARD", requires = "several")]
    pub boards: Vec<PathBuf>,

    #[command(flatten)]
    pub reading: Reading,
    /// Calibration that `wimu calibrate -o` wrote. Counts need a calibration made from counts; m/s² or g need one made from
    /// m/s² or g. It replaces the calibration in a recording. For an array, give one for each sensor, in the order of
    /// --geometry
    #[arg(long, value_name = "CAL.json", help_heading = "Input")]
    pub with: Vec<PathBuf>,
    /// Sensitivity of counts, LSB/g [default: that of the calibration or of a column `Sensitivity (LSB/g)`; for an array
    /// 2048]
    #[arg(long, value_name = "LSB_PER_G", value_parser = positive, help_heading = "Input")]
    pub sensitivity: Option<f64>,

    /// Zero-velocity updates at rests. The path that the device itself has computed does not change
    #[arg(long, value_enum, help_heading = "Model")]
    pub zupt: Option<ZeroVelocity>,
    /// The unit stays within M metres of its start (1 σ of a component)
    #[arg(long, value_name = "M", value_parser = positive, conflicts_with = "geometry", help_heading = "Model")]
    pub within: Option<f64>,
    /// Times at which the unit rested, s, as in the file: "0-3,10.5-12" [default: those that are detected]
    #[arg(
        long,
        value_name = "FROM-TO,…",
        value_parser = time_spans,
        conflicts_with_all = ["geometry", "anchors"],
        help_heading = "Model"
    )]
    pub rests: Option<TimeSpans>,
    /// Position at the start, m, and heading (body x from east towards north), deg: "1.5,0,0.8,90" or "1.5,0,0.8"
    #[arg(
        long,
        value_name = "E,N,U[,DEG]",
        value_parser = start_pose,
        allow_hyphen_values = true,
        conflicts_with = "geometry",
        help_heading = "Model"
    )]
    pub start: Option<StartPose>,
    #[command(flatten)]
    pub aids: Aids,
    /// The path ends where it began, within M metres (1 σ of a component)
    #[arg(
        long = "loop",
        value_name = "M",
        num_args = 0..=1,
        default_missing_value = "0.1",
        value_parser = positive,
        conflicts_with_all = ["geometry", "anchors"],
        help_heading = "Aiding"
    )]
    pub closes: Option<f64>,
    /// Standard deviation up to which a position is valid, m
    #[arg(long, value_name = "M", default_value_t = 1.0, value_parser = positive, help_heading = "Model")]
    pub limit: f64,

    /// Whether each point rests on the whole recording. How long σ stays below a limit is always that of the samples up to
    /// then, as in real time
    #[arg(
        long,
        value_enum,
        value_name = "ON|OFF",
        default_value_t,
        conflicts_with = "geometry",
        help_heading = "Model"
    )]
    pub smooth: Smoothing,

    /// Positions of the accelerometers of an array: a file or a preset, see GEOMETRY below
    #[arg(
        long,
        value_name = "GEOMETRY",
        conflicts_with_all = ["profile", "fixes", "anchors"],
        group = "several",
        help_heading = "Arrays"
    )]
    pub geometry: Option<PathBuf>,
    /// Full scale of each accelerometer of a body, ± g: they are merged into one. A recording of wimu has them
    #[arg(
        long,
        value_name = "G,G[,G]",
        value_delimiter = ',',
        value_parser = positive,
        group = "several",
        conflicts_with_all = ["geometry", "relative", "anchors"],
        help_heading = "Arrays"
    )]
    pub full_scales: Vec<f64>,
    /// Estimate the positions of all axes and the delays of all sensors. Use them and write them to this file if they
    /// predict other parts of the recording better than --geometry does
    #[arg(long, value_name = "GEOMETRY.json", requires = "geometry", help_heading = "Arrays")]
    pub refine: Option<PathBuf>,
    /// Standard deviation of the positions in the geometry, mm [default: that of the geometry file, or 0.5]
    #[arg(long, value_name = "MM", value_parser = positive, requires = "geometry", help_heading = "Arrays")]
    pub place_sd: Option<f64>,
    /// Standard deviation of the sensors' delays, µs [default: that of the geometry file, or 300]
    #[arg(long, value_name = "US", value_parser = positive, requires = "geometry", help_heading = "Arrays")]
    pub delay_sd: Option<f64>,

    /// Angle and rotation between two units on two bodies that a joint connects: INPUT and BOARD. Two calibrations are those
    /// of both, in this order
    #[arg(
        long,
        group = "several",
        requires = "boards",
        conflicts_with_all = ["geometry", "anchors", "fixes", "zupt", "within", "rests", "start", "closes"],
        help_heading = "Two units"
    )]
    pub relative: bool,
    /// Axis of the hinge, in the axes of both units [default: found from the motion]
    #[arg(
        long,
        value_name = "X,Y,Z",
        value_parser = numbers::<3>,
        allow_hyphen_values = true,
        requires = "relative",
        help_heading = "Two units"
    )]
    pub hinge: Option<[f64; 3]>,
    /// Use the magnetometers of both units: calibrated, and away from iron
    #[arg(long, requires = "relative", help_heading = "Two units")]
    pub magnetometers: bool,

    /// Wheel odometry: CSV with columns `Time (s)` and, with --profile vehicle, `Speed (m/s)` or `Distance Increment (m)`;
    /// beside ranges in the plane `Distance Increment (m)` and `Heading Increment (rad)`
    #[arg(
        long,
        value_name = "WHEELS.csv",
        conflicts_with_all = ["ranges", "geometry"],
        help_heading = "Aiding"
    )]
    pub odometry: Option<PathBuf>,
    /// Estimate the positions of the anchors, which are known to M metres (1 σ of a component)
    #[arg(long, value_name = "M", value_parser = positive, requires = "anchors", help_heading = "Aiding")]
    pub survey: Option<f64>,

    /// Write velocity and position to this CSV file, or as ROS 2 odometry, path and transforms where its name ends in
    /// .mcap; - is standard output, as CSV
    #[arg(short, long, value_name = "PATH.csv", help_heading = "Output")]
    pub output: Option<PathBuf>,
    /// Write a report with pictures to this file
    #[arg(long, value_name = "FILE.html", help_heading = "Output")]
    pub report: Option<PathBuf>,
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
