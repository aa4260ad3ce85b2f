//! What can be asked of `wimu navigate`.

use std::path::PathBuf;

use clap::{Args, ValueEnum};

use wimu_host::inertial::Zupt;

use super::Role;

#[derive(Args)]
#[command(after_help = "\
Example: wimu navigate session.mcap --method slide -o path.csv        (moves between rests, without a turn)
         wimu navigate walk.csv --method tilt --zupt cautious --report path.html
         wimu navigate raw.csv --calibration CAL.json                  (from `wimu calibrate rests.csv`)
         wimu navigate board.csv --geometry places.csv -o path.csv
         wimu navigate board.csv --geometry ARRAY.json                 (from `wimu calibrate --geometry`)
         wimu navigate cube.csv --geometry cube:100mm                  (columns `Accelerometer 0 (m/s²)`, … to 5)
         wimu navigate a.mcap b.mcap c.mcap d.mcap --geometry boards.json --refine refined.json")]
pub struct Navigate {
    /// A recording, or a CSV file: of corrected samples, or with --calibration as the sensor puts them out
    pub input: PathBuf,
    /// The recordings of further boards on the same body: together one array, in the order of --geometry
    #[arg(value_name = "BOARD")]
    pub boards: Vec<PathBuf>,
    /// How the path is found
    #[arg(long, value_enum, default_value_t = NavigateMethod::Auto)]
    pub method: NavigateMethod,
    /// How the bias settles is fitted to this CSV file: the same unit at rest, from its switching on
    #[arg(long, value_name = "STATIC.csv")]
    pub drift: Option<PathBuf>,
    /// Places of an array's accelerometers (triads): a line `X (m),Y (m),Z (m)` or `X (mm),…`, then one for
    /// each; or what `wimu calibrate --geometry` or --refine wrote, which may also hold axes, delays and error
    /// models, or single `axes`, each with `place_m`, `direction` and the `column` of its output (`Accelerometer 0`, … where
    /// it has none). Or a preset: `cube:100mm` (six single axes on a cube of that side), `four:30mm`, `octahedron:30mm`
    /// (triads so far from the centre), `board:9.5mm,2mm` (eight triads, half the side and half the thickness).
    /// The path is that of the sensors' centre, wherever the origin of the places is
    #[arg(long, value_name = "FILE|PRESET")]
    pub geometry: Option<PathBuf>,
    /// Estimate the places of all axes and the delays of all sensors from this recording; use them and write them
    /// here if they predict parts of it that they were not fitted to better than --geometry does
    #[arg(long, value_name = "GEOMETRY.json", requires = "geometry")]
    pub refine: Option<PathBuf>,
    /// How well --geometry knows a place, mm (1 standard deviation), which rate and position hold; without it as
    /// the geometry says, or 0.5
    #[arg(long, value_name = "MM")]
    pub place_sd: Option<f64>,
    /// How well --geometry knows a sensor's delay, µs, which rate and position hold; without it as the geometry
    /// says, or 300
    #[arg(long, value_name = "US")]
    pub delay_sd: Option<f64>,
    /// Sensitivity of counts; without it as the calibration or a column `Sensitivity (LSB/g)` says, of an array 2048
    #[arg(long, value_name = "LSB_PER_G")]
    pub sensitivity: Option<f64>,
    /// Position counts as usable while its standard deviation is below this, m
    #[arg(long, value_name = "M", default_value_t = 1.0)]
    pub limit: f64,
    /// Write a report with pictures here
    #[arg(long, value_name = "FILE.html")]
    pub report: Option<PathBuf>,
    /// Write velocity and position here, as a CSV file
    #[arg(short, long, value_name = "PATH.csv")]
    pub output: Option<PathBuf>,
    /// What `wimu calibrate -o` wrote. Of a CSV file it corrects the samples, in the unit that it was made from: counts,
    /// or m/s² and g. Of a recording it takes the place of the device's own. Of an array once for each sensor, in the
    /// order of --geometry
    #[arg(long, value_name = "CAL.json")]
    pub calibration: Vec<PathBuf>,
    /// Zero velocity at rests; without this, `on`. Position is zero where the first rest ends. The device's own path is
    /// as it computed it, unless this is given
    #[arg(long, value_enum)]
    pub zupt: Option<ZeroVelocity>,
    /// Of which link; without it, the cable if it was recorded
    #[arg(long, value_enum)]
    pub link: Option<Role>,
}

/// What `wimu navigate` takes a rest for. An accelerometer cannot tell one from constant velocity.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ZeroVelocity {
    /// Velocity is zero there: σ and Valid are right where the unit did rest
    On,
    /// The same, and σ includes what constant velocity could have hidden there: Valid ends the sooner
    Cautious,
    /// Nothing, except at the start
    Off,
}

impl ZeroVelocity {
    /// That of the option, and its default.
    pub fn of(option: Option<Self>) -> Zupt {
        match option {
            None | Some(Self::On) => Zupt::Stated,
            Some(Self::Cautious) => Zupt::Assumed,
            Some(Self::Off) => Zupt::Off,
        }
    }
}

/// How `wimu navigate` finds the path.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum NavigateMethod {
    /// `array` with --geometry, `strapdown` where there is a gyroscope, `tilt` otherwise
    Auto,
    /// With the gyroscope's angular rate
    Strapdown,
    /// Accelerometer and magnetometer alone
    Tilt,
    /// With the angular rate of several accelerometers
    Array,
    /// Straight moves between rests
    Slide,
}
