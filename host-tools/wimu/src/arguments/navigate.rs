//! Options of `wimu navigate`.

use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, ValueEnum};
use wimu_host::inertial::{Profile, StartPose, Zupt};

use super::reading::Reading;
use super::values::{TimeSpans, from_to, numbers, positive, seconds, start_pose, time_spans};

#[derive(Args)]
#[command(after_help = "\
GEOMETRY is a file or a preset:
  FILE.csv         header `X (m),Y (m),Z (m)` (or mm), one row per triad of axes
  FILE.json        as `wimu calibrate --geometry -o` or --refine wrote it
  FILE.json        single `axes` with `place_m`, `direction`, `column` of output
  cube:100mm       six single axes on a cube with this side
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
  wimu navigate raw.csv --calibration CAL.json
  wimu navigate board.csv --geometry positions.csv -o path.csv
  wimu navigate board.csv --geometry ARRAY.json
  wimu navigate cube.csv --geometry cube:100mm
  wimu navigate a.mcap b.mcap c.mcap d.mcap --geometry boards.json
  wimu navigate ranges.csv --anchors anchors.csv -o path.csv
  wimu navigate ranges.csv --anchors anchors.csv --odometry wheels.csv
  wimu navigate imu.csv --ranges ranges.csv --anchors anchors.csv")]
pub struct Navigate {
    /// A LINK, or a recording of any format; of other programs: corrected samples, or with --calibration the sensor's
    /// output. With --anchors alone: ranges
    pub input: PathBuf,
    /// Stop after this time, s
    #[arg(long = "for", value_name = "SECONDS", value_parser = seconds, help_heading = "Output")]
    pub seconds: Option<Duration>,
    /// Positions a second that are computed while a board sends [default: 10]
    #[arg(long, value_name = "HZ", value_parser = from_to(0.01, 1000.0), help_heading = "Output")]
    pub rate: Option<f64>,
    /// With --geometry: recordings of further boards on the same body, in the order of the geometry
    #[arg(value_name = "BOARD", requires = "geometry")]
    pub boards: Vec<PathBuf>,

    #[command(flatten)]
    pub reading: Reading,
    /// Calibration that `wimu calibrate -o` wrote. Counts need a calibration made from counts; m/s² or g need one made from
    /// m/s² or g. It replaces the calibration in a recording. For an array, give one for each sensor, in the order of
    /// --geometry
    #[arg(long, value_name = "CAL.json", help_heading = "Input")]
    pub calibration: Vec<PathBuf>,
    /// Sensitivity of counts, LSB/g [default: that of the calibration or of a column `Sensitivity (LSB/g)`; for an array
    /// 2048]
    #[arg(long, value_name = "LSB_PER_G", value_parser = positive, help_heading = "Input")]
    pub sensitivity: Option<f64>,

    /// Zero-velocity updates at rests. The path that the device itself has computed does not change
    #[arg(long, value_enum, help_heading = "Model")]
    pub zupt: Option<ZeroVelocity>,
    /// What is assumed of the motion
    #[arg(
        long,
        value_enum,
        default_value_t,
        conflicts_with = "geometry",
        help_heading = "Model"
    )]
    pub profile: MotionProfile,
    /// The unit stays within M metres of its start (1 σ of a component)
    #[arg(long, value_name = "M", value_parser = positive, conflicts_with = "geometry", help_heading = "Model")]
    pub within: Option<f64>,
    /// Times at which the unit rested, s, as in the file: "0-3,10.5-12" [default: those that are detected]
    #[arg(
        long,
        value_name = "FROM-TO,…",
        value_parser = time_spans,
        conflicts_with = "geometry",
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
    /// Position, velocity or heading by another system: a CSV file, or with INPUT a LINK also a LINK that sends its lines, with `Time (s)` and any of `Position E (m)`, `Position N (m)`,
    /// `Position U (m)` or `Height (m)`, `Velocity E (m/s)`, …, `Heading (deg)`, each with `Position Sigma E (m)`, …. The path
    /// is in their frame, and starts with the heading that explains them
    #[arg(
        long,
        value_name = "FIXES.csv|LINK",
        conflicts_with_all = ["geometry", "anchors"],
        help_heading = "Aiding"
    )]
    pub fixes: Option<PathBuf>,
    /// Time from a fix to its time stamp, s
    #[arg(
        long,
        value_name = "S",
        default_value_t = 0.0,
        value_parser = from_to(-2.0, 2.0),
        allow_hyphen_values = true,
        requires = "fixes",
        help_heading = "Aiding"
    )]
    pub fix_delay: f64,
    /// Position of the antenna from the inertial sensor or the odometer, m, body axes
    #[arg(
        long,
        value_name = "X,Y,Z",
        value_parser = numbers::<3>,
        allow_hyphen_values = true,
        help_heading = "Aiding"
    )]
    pub lever_arm: Option<[f64; 3]>,
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
    #[arg(long, value_name = "GEOMETRY", help_heading = "Arrays")]
    pub geometry: Option<PathBuf>,
    /// Estimate the positions of all axes and the delays of all sensors. Use them and write them to this file if they
    /// predict other parts of the recording better than --geometry does
    #[arg(
        long,
        value_name = "GEOMETRY.json",
        requires = "geometry",
        help_heading = "Arrays"
    )]
    pub refine: Option<PathBuf>,
    /// Standard deviation of the positions in the geometry, mm [default: that of the geometry file, or 0.5]
    #[arg(long, value_name = "MM", value_parser = positive, requires = "geometry", help_heading = "Arrays")]
    pub place_sd: Option<f64>,
    /// Standard deviation of the sensors' delays, µs [default: that of the geometry file, or 300]
    #[arg(long, value_name = "US", value_parser = positive, requires = "geometry", help_heading = "Arrays")]
    pub delay_sd: Option<f64>,

    /// Positions of the anchors of ranges: CSV with columns `Anchor`, `Position E (m)`, `Position N (m)` and, in space,
    /// `Position U (m)`. Ranges are INPUT, or --ranges beside an inertial recording
    #[arg(
        long,
        value_name = "ANCHORS.csv",
        conflicts_with_all = ["geometry", "zupt", "within", "rests", "profile"],
        help_heading = "Aiding"
    )]
    pub anchors: Option<PathBuf>,
    /// Ranges beside an inertial recording: CSV with columns `Time (s)`, `Anchor`, `Range (m)`, or `Range ID (m)` for each
    /// anchor. The times are those of INPUT
    #[arg(
        long,
        value_name = "RANGES.csv",
        requires = "anchors",
        help_heading = "Aiding"
    )]
    pub ranges: Option<PathBuf>,
    /// Wheel odometry: CSV with columns `Time (s)` and, with --profile vehicle, `Speed (m/s)` or `Distance Increment (m)`;
    /// beside ranges in the plane `Distance Increment (m)` and `Heading Increment (rad)`
    #[arg(
        long,
        value_name = "WHEELS.csv",
        conflicts_with_all = ["ranges", "geometry"],
        help_heading = "Aiding"
    )]
    pub odometry: Option<PathBuf>,
    /// Standard deviations of noise, m, bias, m, and scale error of the ranges, before the calibration from the recording
    /// [default: 0.03,0.1,0; with --odometry 0.5,0.5,0.1]
    #[arg(
        long,
        value_name = "NOISE,BIAS,SCALE",
        value_parser = numbers::<3>,
        requires = "anchors",
        help_heading = "Aiding"
    )]
    pub range_errors: Option<[f64; 3]>,
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

/// Motion profiles.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum MotionProfile {
    /// In a hand or on a small robot: velocity 0 ± 2 m/s
    #[default]
    Hand,
    /// On a foot: velocity zero in the stances of steps, walking, running or on stairs
    Foot,
    /// In a vehicle: motion along its forward axis, which is found; 0 ± 30 m/s
    Vehicle,
    /// No assumption
    Free,
}

impl From<MotionProfile> for Profile {
    fn from(profile: MotionProfile) -> Self {
        match profile {
            MotionProfile::Hand => Self::Hand,
            MotionProfile::Foot => Self::Foot,
            MotionProfile::Vehicle => Self::Vehicle,
            MotionProfile::Free => Self::Free,
        }
    }
}
