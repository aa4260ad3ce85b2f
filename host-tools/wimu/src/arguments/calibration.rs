//! What can be asked of the commands that say how wrong a sensor is.

use std::path::PathBuf;

use clap::{Args, ValueEnum};

use super::Role;

#[derive(Args)]
#[command(after_help = "\
Example: wimu calibrate session.mcap -o CAL.json
         wimu calibrate tcp://127.0.0.1:7100 --push -o CAL.json
         wimu calibrate session.csv --model auto+drift --report report.html
         wimu calibrate sides.csv --method six-position --sides x,-x,y,-y,z,-z --placement-sd 0.5
         wimu calibrate turns.csv --method four-angle --placement-sd 0.5
         wimu calibrate means.csv --poses --where \"Run=2,IMU=0\" --gravity 9.818
         wimu calibrate later.csv --method update --with CAL.json -o NOW.json
         wimu calibrate session.mcap --method reference           (wireless against cable)
         wimu calibrate two.csv --method reference --reference 0 --accelerometer 1
         wimu calibrate session.mcap --sensor magnetometer --with CAL.json -o BOTH.json
         wimu calibrate board.csv --geometry places.csv -o ARRAY.json      (several accelerometers)")]
pub struct Calibrate {
    /// A LINK, a recording or a CSV file
    pub input: String,
    /// The recordings of further boards on the same body: together one array, in the order of --geometry
    #[arg(value_name = "BOARD")]
    pub boards: Vec<PathBuf>,
    /// Write the calibration here
    #[arg(short, long, value_name = "CAL.json")]
    pub output: Option<PathBuf>,
    /// Which sensor; the magnetometer from rests in twelve orientations or more, turned about the
    /// vertical too, beside a calibrated accelerometer
    #[arg(long, value_enum, default_value_t = Calibrated::Accelerometer)]
    pub sensor: Calibrated,
    /// The calibration to update, or of the accelerometer beside the magnetometer; without it, as the
    /// recording or the device says
    #[arg(long, value_name = "CAL.json")]
    pub with: Option<PathBuf>,
    /// How: from gravity's magnitude in any poses, from six known ones, from turns about level axes
    /// in steps of 90° or 120°, or against a reference that moves along: the cable's samples, or
    /// another accelerometer of a CSV file; or a stored one, updated by later rests
    #[arg(long, value_enum, default_value_t = Method::MultiPosition)]
    pub method: Method,
    /// How many parameters: 9 = bias, scale and misalignment (default), 6 without misalignment,
    /// 3 bias only, auto = the one that predicts poses left out best, a larger one only for more than
    /// chance; six-position has 12, the turns 6.
    /// On top: +drift (of the bias over the session), +temperature, +quadratic, as in 9+drift
    #[arg(long, value_name = "3|6|9|12|auto[+TERM…]")]
    pub model: Option<String>,
    /// Local gravity; without it 9.80665 ± 0.015
    #[arg(long, value_name = "M_S2")]
    pub gravity: Option<f64>,
    /// Nominal sensitivity; without it the board's, or for a CSV file the fit's mean
    #[arg(long, value_name = "LSB_PER_G")]
    pub sensitivity: Option<f64>,
    /// Full-scale range at which a CSV file was taken, ± g; without it that of 16 bits at the sensitivity
    #[arg(long, value_name = "G", value_parser = clap::value_parser!(u8).range(1..=127))]
    pub range: Option<u8>,
    /// Compare with the datasheet of this sensor, such as MPU-6050; without it the board's sensor
    #[arg(long, value_name = "NAME")]
    pub sensor_model: Option<String>,
    /// The rows are already means over static poses
    #[arg(long)]
    pub poses: bool,
    /// Only the rows of the CSV file with these values
    #[arg(long = "where", value_name = "COLUMN=VALUE,…")]
    pub filter: Option<String>,
    /// Which accelerometer of a CSV file that has several
    #[arg(long, value_name = "N")]
    pub accelerometer: Option<u32>,
    /// Which accelerometer of a CSV file is the reference; without it the first (method reference)
    #[arg(long, value_name = "N")]
    pub reference: Option<u32>,
    /// Nominal sensitivity of the reference of a CSV file of counts, where it is not --sensitivity (method
    /// reference)
    #[arg(long, value_name = "LSB_PER_G")]
    pub reference_sensitivity: Option<f64>,
    /// Noise of the output per noise of the reference (method reference): 2 where it is twice as noisy;
    /// without it as both show at rest, or as neighbouring samples tell
    #[arg(long, value_name = "RATIO")]
    pub noise_ratio: Option<f64>,
    /// How exactly six positions or steps of a turn were placed, 1 σ; without it 1 (six-position,
    /// four-angle, three-angle)
    #[arg(long, value_name = "DEG")]
    pub placement_sd: Option<f64>,
    /// Which side was up in each pose, in order, such as "x,-x,y,-y,z,-z" (six-position): finds
    /// axes that are swapped or mirrored, which gravity alone does not show
    #[arg(long, value_name = "SIDES", allow_hyphen_values = true)]
    pub sides: Option<String>,
    /// Write the report with its pictures here
    #[arg(long, value_name = "FILE.html")]
    pub report: Option<PathBuf>,
    /// Of which link of a recording; without it, the cable if it was recorded
    #[arg(long, value_enum)]
    pub link: Option<Role>,
    /// How many poses to capture (LINK only); without it 12
    #[arg(long, value_name = "N")]
    pub count: Option<usize>,
    /// The dip of the Earth's field at the place, negative south of the magnetic equator; its sign
    /// tells a mirrored axis, and without it the field points down (magnetometer)
    #[arg(long, value_name = "DEG", allow_negative_numbers = true)]
    pub dip: Option<f64>,
    /// Push the result to the device (LINK only)
    #[arg(long)]
    pub push: bool,
    /// All accelerometers of an array at once: their places (see `wimu navigate --help`). Rests in a dozen
    /// orientations tell each one's errors and how they are turned against each other, fast turns besides
    /// their places and delays; -o writes all of it as the geometry that `wimu navigate` takes
    #[arg(long, value_name = "FILE")]
    pub geometry: Option<PathBuf>,
    /// How well --geometry knows a place, mm (1 standard deviation); without it as the geometry says, or 0.5
    #[arg(long, value_name = "MM")]
    pub place_sd: Option<f64>,
    /// How well --geometry knows a sensor's delay, µs; without it as the geometry says, or 300
    #[arg(long, value_name = "US")]
    pub delay_sd: Option<f64>,
}

#[derive(Args)]
#[command(after_help = "\
Example: wimu align rests.mcap --up z,x -o CAL.json
           it stood level (the body's z up), then on its tail (the body's x up)
         wimu align rests.mcap --up z,x --rests 0,2
           the second of three rests was an accident
         wimu align push.mcap --forward --calibration CAL.json -o ALIGNED.json
           it stood level, was pushed straight ahead, and stood still again
         wimu align tcp://127.0.0.1:7100 --up z,x --push
           as soon as the board has stood so
Push the result with `wimu params push LINK CAL.json`.")]
pub struct Align {
    /// A LINK, a recording or a CSV file
    pub input: String,
    /// The body axis that points up at each rest, in order: z is level, -x on its nose
    #[arg(
        long,
        value_name = "AXES",
        value_delimiter = ',',
        default_value = "z",
        allow_hyphen_values = true
    )]
    pub up: Vec<String>,
    /// Which rests these are, from 0, where it rested more often than --up names
    #[arg(long, value_name = "N", value_delimiter = ',')]
    pub rests: Option<Vec<usize>>,
    /// After the first of these rests it was moved straight ahead, along the body's x
    #[arg(long)]
    pub forward: bool,
    /// How the sensor is calibrated; without it, as the recording or the device says
    #[arg(long, value_name = "CAL.json")]
    pub calibration: Option<PathBuf>,
    /// How well the body was placed and pushed, 1 σ
    #[arg(long, value_name = "DEG", default_value_t = 1.0)]
    pub placement_sd: f64,
    /// Write the calibration with the alignment here
    #[arg(short, long, value_name = "CAL.json")]
    pub output: Option<PathBuf>,
    /// Of which link of a recording; without it, the cable if it was recorded
    #[arg(long, value_enum)]
    pub link: Option<Role>,
    /// Listen for so long at most (LINK only); without it until it is known, or Ctrl-C
    #[arg(long = "for", value_name = "SECONDS")]
    pub seconds: Option<f64>,
    /// Push the result to the device (LINK only)
    #[arg(long)]
    pub push: bool,
}

#[derive(Args)]
#[command(after_help = "\
Example: wimu allan rest.mcap --report noise.html
         wimu allan tcp://127.0.0.1:7100 --for 600
Ten minutes at rest tell the noise density, an hour or more the bias instability.")]
pub struct Allan {
    /// A LINK, a recording or a CSV file of a sensor that lies still
    pub input: String,
    /// Write a report with the curve here
    #[arg(long, value_name = "FILE.html")]
    pub report: Option<PathBuf>,
    /// Nominal sensitivity; without it the board's, or for a CSV file so that gravity is 1 g
    #[arg(long, value_name = "LSB_PER_G")]
    pub sensitivity: Option<f64>,
    /// Only the rows of the CSV file with these values
    #[arg(long = "where", value_name = "COLUMN=VALUE,…")]
    pub filter: Option<String>,
    /// Which accelerometer of a CSV file that has several
    #[arg(long, value_name = "N")]
    pub accelerometer: Option<u32>,
    /// Of which link of a recording; without it, the cable if it was recorded
    #[arg(long, value_enum)]
    pub link: Option<Role>,
    /// Listen for so long (LINK only); without it until Ctrl-C
    #[arg(long = "for", value_name = "SECONDS")]
    pub seconds: Option<f64>,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Calibrated {
    Accelerometer,
    Magnetometer,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Method {
    MultiPosition,
    SixPosition,
    FourAngle,
    ThreeAngle,
    Reference,
    /// A stored calibration (--with) checked by later rests and brought up to date
    Update,
}
