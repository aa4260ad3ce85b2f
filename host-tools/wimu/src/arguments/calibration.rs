//! Options of the commands that estimate a sensor's errors.

use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, ValueEnum, value_parser};
use wimu_calib::Face;
use wimu_model::Sensitivity;

use super::reading::Reading;
use super::values::{Place, acceleration, from_to, place, positive, seconds, sensitivity, side};

#[derive(Args)]
#[command(
    after_help = "Example: wimu calibrate session.mcap -o CAL.json; more with --help",
    after_long_help = "\
Examples:
  wimu calibrate session.mcap -o CAL.json
  wimu calibrate tcp://127.0.0.1:7100 --push -o CAL.json
  wimu calibrate session.csv --model auto+drift --report report.html
  wimu calibrate sides.csv --method six-position --sides x,-x,y,-y,z,-z
  wimu calibrate cold.csv room.csv warm.csv --latitude 47.4,400 -o CAL.json
  wimu calibrate rotation.csv --method four-angle --placement-sd 0.5
  wimu calibrate means.csv --poses --where \"Run=2,IMU=0\" --gravity 9.818
  wimu calibrate later.csv --method update --with CAL.json -o NOW.json
  wimu calibrate session.mcap --method reference
  wimu calibrate two.csv --method reference --reference 0 --sensor 1
  wimu calibrate session.mcap --method magnetometer --with CAL.json -o BOTH.json
  wimu calibrate board.csv --setup geometry=positions.csv -o ARRAY.json"
)]
pub struct Calibrate {
    /// A LINK, or a recording of any format
    pub input: String,
    /// Further sessions of the same sensor
    ///
    /// Further sessions of the same sensor: their parameters are combined, with the change between sessions
    #[arg(value_name = "FILE")]
    pub more: Vec<PathBuf>,

    #[command(flatten)]
    pub reading: Reading,
    /// Index of the accelerometer in the file
    ///
    /// Index of the accelerometer to calibrate in a file that has several
    #[arg(long, value_name = "INDEX", help_heading = "Input")]
    pub sensor: Option<u8>,
    /// Each row of the table is the mean of one static pose
    #[arg(long, help_heading = "Input")]
    pub poses: bool,
    /// Nominal sensitivity, LSB/g
    ///
    /// Nominal sensitivity, LSB/g [default: the board's; for a CSV file the mean scale factor of the fit]
    #[arg(long, value_name = "LSB_PER_G", value_parser = positive, help_heading = "Input")]
    pub sensitivity: Option<f64>,
    /// Full-scale range of a CSV file, ± g [default: 32768 / sensitivity, rounded down to a power of two]
    #[arg(hide_short_help = true, long, value_name = "G", value_parser = value_parser!(u8).range(1..=127), help_heading = "Input")]
    pub range: Option<u8>,
    /// For method reference: index of the accelerometer of a CSV file that is the reference [default: the first]
    #[arg(hide_short_help = true, long, value_name = "INDEX", help_heading = "Input")]
    pub reference: Option<u8>,
    /// Calibration to update, or beside the field
    ///
    /// Calibration to update, or calibration of the accelerometer beside the magnetometer [default: that of the
    /// recording or the device]
    #[arg(hide_short_help = true, long, value_name = "CAL.json", help_heading = "Input")]
    pub with: Option<PathBuf>,

    /// How to calibrate
    #[arg(long, value_enum, default_value_t = Method::MultiPosition, help_heading = "Model")]
    pub method: Method,
    /// Parameters: 9, 12 or auto, +drift, …
    ///
    /// 9: bias, scale factors and misalignments from the poses alone. auto: also drift and temperature, with the tolerances
    /// of typical datasheets as priors, for fewer or uneven poses. Append +drift (of the bias), +temperature or +quadratic,
    /// as in 9+drift [default: 9; six-position has 12, four-angle and three-angle have 6]
    #[arg(long, value_name = "9|12|auto[+TERM…]", help_heading = "Model")]
    pub model: Option<String>,
    /// Local gravity, m/s²
    ///
    /// Local gravity, m/s² [default: 9.80665 m/s², uncertainty ± 0.015 m/s² (1 σ)]
    #[arg(hide_short_help = true, long, value_name = "M_S2", value_parser = from_to(9.7, 9.9), help_heading = "Model")]
    pub gravity: Option<f64>,
    /// Latitude of the place, and its height
    ///
    /// Latitude of the place, degrees, negative in the south, and its height, m: gravity by the WGS 84 formula,
    /// ± 0.0005 m/s² (1 σ)
    #[arg(hide_short_help = true, long, value_name = "DEG[,M]", allow_hyphen_values = true, value_parser = place, conflicts_with = "gravity", help_heading = "Model")]
    pub latitude: Option<Place>,
    /// Compare with the datasheet of this sensor, such as MPU-6050 [default: the board's sensor]
    #[arg(hide_short_help = true, long, value_name = "NAME", help_heading = "Model")]
    pub chip: Option<String>,
    /// Largest error that is wanted, such as 10mg
    ///
    /// Largest error in the worst orientation that is wanted, such as 10mg: a warning if it is missed [default: compare
    /// with the noise of a sample]
    #[arg(long, value_name = "ERROR", value_parser = acceleration, help_heading = "Model")]
    pub target: Option<f64>,
    /// For method magnetometer: dip of the Earth's field, degrees, negative south of the magnetic equator. Its sign shows a
    /// mirrored axis [default: the field points down]
    #[arg(hide_short_help = true, long, value_name = "DEG", allow_negative_numbers = true, value_parser = from_to(-90.0, 90.0), help_heading = "Model")]
    pub dip: Option<f64>,

    /// For methods with known orientations: placement error, degrees, 1 σ [default: 1]
    #[arg(hide_short_help = true, long, value_name = "DEG", help_heading = "Placement")]
    pub placement_sd: Option<f64>,
    /// For method six-position: the side that is up in each pose, in order, such as "x,-x,y,-y,z,-z". Shows swapped and
    /// mirrored axes
    #[arg(hide_short_help = true, long, value_name = "SIDES", allow_hyphen_values = true, value_delimiter = ',', value_parser = side, help_heading = "Placement")]
    pub sides: Option<Vec<Face>>,

    /// Calibrate an array of this geometry
    ///
    /// Calibrate all accelerometers of an array, whose `geometry` is in this setup, see `wimu navigate --print-setup`. Rests in a dozen orientations give errors and relative rotations
    #[arg(
        hide_short_help = true,
        long,
        value_name = "SETUP.toml|KEY=VALUE",
        help_heading = "Arrays",
        conflicts_with_all = [
            "method", "sensor", "model", "with", "chip", "range", "poses", "filter", "reference", "placement_sd", "sides",
            "report", "count", "dip", "push",
        ]
    )]
    pub setup: Vec<String>,

    /// Write the calibration to this file
    #[arg(short, long, value_name = "CAL.json", help_heading = "Output")]
    pub output: Option<PathBuf>,
    /// Write a report with pictures to this file
    #[arg(long, value_name = "FILE.html", help_heading = "Output")]
    pub report: Option<PathBuf>,

    /// Push the result to the device (LINK only)
    #[arg(long, help_heading = "Device")]
    pub push: bool,
    /// Number of poses to capture (LINK only)
    ///
    /// Number of poses to capture (LINK only), at most 64 [default: 12]
    #[arg(hide_short_help = true, long, value_name = "N", value_parser = value_parser!(u8).range(..=64), help_heading = "Device")]
    pub count: Option<u8>,
}

#[derive(Args)]
#[command(
    after_help = "Example: wimu align rests.mcap --up z,x -o CAL.json; more with --help",
    after_long_help = "\
Examples:
  wimu align rests.mcap --up z,x -o CAL.json
      rests level (body z up), then on its tail (body x up)
  wimu align rests.mcap --up z,x --rests 0,2
      ignores the second of three rests
  wimu align move.mcap --forward --with CAL.json -o ALIGNED.json
      rests level, moves straight ahead, rests again
  wimu align tcp://127.0.0.1:7100 --up z,x --push
      listens until both rests were found
  wimu align imu.csv --camera poses.csv --report camera.html
      pose of a camera in the body, from its poses and inertial data or poses of the body
Push a written result with `wimu device params push LINK CAL.json`."
)]
pub struct Align {
    /// A LINK, or a recording of any format
    pub input: String,
    #[command(flatten)]
    pub reading: Reading,
    /// Body axes that point up: z,x
    ///
    /// Body axis that points up at each rest, in order: z is level, -x is nose down
    #[arg(
        long,
        value_name = "AXES",
        value_delimiter = ',',
        default_value = "z",
        allow_hyphen_values = true
    )]
    pub up: Vec<String>,
    /// Numbers of these rests, from 0
    ///
    /// Numbers of these rests, from 0, where the recording has more rests than --up names
    #[arg(long, value_name = "N", value_delimiter = ',')]
    pub rests: Option<Vec<usize>>,
    /// It moves straight ahead, along its x axis
    ///
    /// After the first of these rests the body moves straight ahead, along its x axis
    #[arg(long)]
    pub forward: bool,
    /// Calibration of the accelerometer
    ///
    /// Calibration of the accelerometer [default: that of the recording or the device]
    #[arg(long, value_name = "CAL.json")]
    pub with: Option<PathBuf>,
    /// Placement error of the body, degrees, 1 σ
    #[arg(long, value_name = "DEG", default_value_t = 1.0, value_parser = from_to(0.01, 20.0))]
    pub placement_sd: f64,
    /// Write the calibration with the alignment to this file
    #[arg(short, long, value_name = "CAL.json")]
    pub output: Option<PathBuf>,
    /// Longest time to listen, s (LINK only)
    ///
    /// Longest time to listen, s (LINK only) [default: until the alignment is known, or Ctrl-C]
    #[arg(long = "for", value_name = "SECONDS", value_parser = seconds)]
    pub seconds: Option<Duration>,
    /// Push the result to the device (LINK only)
    #[arg(long)]
    pub push: bool,
    /// Find the pose of a camera in the body
    ///
    /// Find the pose of a camera in the body instead: its poses, a CSV table or a TUM trajectory
    #[arg(long, value_name = "POSES", conflicts_with_all = ["up", "rests", "forward", "placement_sd", "output", "seconds", "push"])]
    pub camera: Option<PathBuf>,
    /// Write a report with the residuals to this file
    #[arg(long, value_name = "FILE.html", requires = "camera")]
    pub report: Option<PathBuf>,
}

#[derive(Args)]
#[command(after_help = "\
Examples:
  wimu allan rest.mcap --report noise.html
  wimu allan tcp://127.0.0.1:7100 --for 600
Ten minutes at rest show the noise density, an hour or more the bias instability.")]
pub struct Allan {
    /// A LINK, a recording or a CSV file of a sensor at rest
    pub input: String,
    /// Write a report with the Allan deviation to this file
    #[arg(long, value_name = "FILE.html")]
    pub report: Option<PathBuf>,
    /// Nominal sensitivity, LSB/g [default: the board's; for a CSV file such that gravity is 1 g]
    #[arg(long, value_name = "LSB_PER_G", value_parser = sensitivity)]
    pub sensitivity: Option<Sensitivity>,
    #[command(flatten)]
    pub reading: Reading,
    /// Index of the accelerometer in a file that has several
    #[arg(long, value_name = "INDEX")]
    pub sensor: Option<u8>,
    /// Time to listen, s (LINK only) [default: until Ctrl-C]
    #[arg(long = "for", value_name = "SECONDS", value_parser = seconds)]
    pub seconds: Option<Duration>,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Method {
    /// Any poses; only the magnitude of gravity is known
    MultiPosition,
    /// Each of six sides up; the orientations are known
    SixPosition,
    /// Rotation about a level axis in steps of 90°
    FourAngle,
    /// Rotation about a level axis in steps of 120°
    ThreeAngle,
    /// Against a reference in the same motion: the cable's samples, or another accelerometer of a CSV file
    Reference,
    /// A stored calibration (--with), checked and updated with later rests
    Update,
    /// Hard and soft iron of a magnetometer beside a calibrated accelerometer: rests in twelve or more orientations,
    /// also rotated about the vertical
    Magnetometer,
}
