//! What can be asked for.

use std::net::SocketAddr;
use std::path::PathBuf;

use clap::{Args, Parser, Subcommand, ValueEnum};

use crate::command::flash::Board;

/// A wireless IMU from an ordinary accelerometer: stream, record, calibrate, push back, navigate.
///
/// LINK is tcp://127.0.0.1:7100, serial:///dev/ttyACM0?baud=115200, a port (COM5, /dev/rfcomm0) or
/// `auto`.
#[derive(Parser)]
#[command(
    name = "wimu",
    version,
    after_help = "\
Start with `wimu demo`. Exit codes: 0 done, 1 failed, 2 wrong usage or unreadable input,
3 the data do not support an answer, 4 the device refused."
)]
pub struct Arguments {
    /// Print JSON on stdout (streaming commands one object per line), human text on stderr
    #[arg(long, global = true)]
    pub json: bool,
    #[command(subcommand)]
    pub command: Command,
}

#[derive(Subcommand)]
pub enum Command {
    /// The main job on a simulated board, in a few seconds
    Demo(Demo),
    /// A simulated board that listens on two TCP ports
    Simulate(Simulate),
    /// The serial ports of this computer
    Ports(Ports),
    /// Live readings in the terminal
    Monitor(Monitor),
    /// Record everything a board sends, byte for byte
    Record(Record),
    /// What is in a recording, or who is on a link
    Info(Info),
    /// A recording as a table
    Export(Export),
    /// Estimate the error model of an accelerometer
    Calibrate(Calibrate),
    /// How the sensor sits in the body that it is mounted on
    Align(Align),
    /// Noise density and bias instability of an accelerometer at rest
    Allan(Allan),
    /// The calibration on a device
    Params {
        #[command(subcommand)]
        action: Params,
    },
    /// The settings of a device
    Settings {
        #[command(subcommand)]
        action: Settings,
    },
    /// The key that writes to a device are signed with
    Key {
        #[command(subcommand)]
        action: Key,
    },
    /// Wireless against cable: loss, latency, clock, values
    Compare(Compare),
    /// Velocity and position: the device's own, and recomputed from its raw samples
    Navigate(Navigate),
    /// Write the firmware onto a board through its debug probe
    Flash(Flash),
}

#[derive(Args)]
#[command(after_help = "\
Example: wimu flash microbit-v2
         wimu flash --list
         wimu flash pico-adxl345 --image my.elf --probe 2e8a:000c

Without a probe: copy the image onto the drive that the board shows. The calibration stays, unless
the chip is locked and --erase-all unlocks it.")]
pub struct Flash {
    /// The board
    #[arg(value_enum)]
    pub board: Option<Board>,
    /// Its image, as ELF, Intel HEX or UF2; by default what `cargo xtask firmware` has written
    #[arg(long, value_name = "FILE")]
    pub image: Option<PathBuf>,
    /// Which debug probe, where there are several
    #[arg(long, value_name = "VENDOR:PRODUCT[:SERIAL]")]
    pub probe: Option<String>,
    /// Print the debug probes that are plugged in
    #[arg(long)]
    pub list: bool,
    /// Unlock a locked chip, which erases all that is on it: firmware, calibration, key
    #[arg(long)]
    pub erase_all: bool,
}

#[derive(Args)]
#[command(after_help = "Example: wimu demo --seed 7")]
pub struct Demo {
    /// Hidden errors and noise of the simulated sensor
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Where the report with its pictures goes
    #[arg(
        long,
        value_name = "FILE.html",
        default_value = "wimu-demo-report.html"
    )]
    pub report: PathBuf,
    /// Write the pictures of tilts and slide into this folder, as SVG and as PNG
    #[arg(long, value_name = "FOLDER")]
    pub pictures: Option<PathBuf>,
}

#[derive(Args)]
#[command(after_help = "\
Example: wimu simulate --motion twelve-poses,slide --seed 3
         wimu simulate --replay recording.csv --speed 10 --exit-when-done
         wimu simulate --faults noisy --clock-ppm 35
         wimu simulate --faults loss=2%,burst=20,bits=1e-4,jitter=50ms,stall=3s@30s
         wimu simulate --faults other-unit --faults cable:latency=2ms")]
pub struct Simulate {
    /// The sensor on the board
    #[arg(long, value_enum, default_value_t = Sensor::Lsm303agr)]
    pub sensor: Sensor,
    /// What happens to the board, in order and again: rest, six-positions, twelve-poses, tilts,
    /// slide, hand
    #[arg(long, default_value = "twelve-poses,slide", value_name = "NAMES")]
    pub motion: String,
    /// Stream the raw counts of this CSV file instead; time begins when a host connects
    #[arg(long, value_name = "FILE.csv", conflicts_with = "motion")]
    pub replay: Option<PathBuf>,
    /// Only the rows of the CSV file with these values, e.g. "IMU=0"
    #[arg(long = "where", value_name = "COLUMN=VALUE,…", requires = "replay")]
    pub filter: Option<String>,
    /// Which accelerometer of a CSV file that has several
    #[arg(long, value_name = "N", requires = "replay")]
    pub accelerometer: Option<u32>,
    /// Hidden errors and noise of the sensor
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Keep the board's memory in this file; without it, it ends with the program
    #[arg(long, value_name = "FILE")]
    pub store: Option<PathBuf>,
    /// Begin with the gesture of an owner who has lost the key: the board forgets key and settings
    #[arg(long)]
    pub forget_key: bool,
    /// Where the cable listens
    #[arg(long, default_value = "127.0.0.1:7100", value_name = "ADDRESS")]
    pub cable: SocketAddr,
    /// Where the wireless link listens
    #[arg(long, default_value = "127.0.0.1:7101", value_name = "ADDRESS")]
    pub wireless: SocketAddr,
    /// What goes wrong on a link, the wireless one unless `cable:` stands before it: presets (none,
    /// bluetooth, noisy, other-unit) and baud, latency, jitter, loss, burst, bits, splice, duplicate,
    /// stall, disconnect, buffer, bias, scale, noise; may be given for each link
    #[arg(long, value_name = "[LINK:]FAULT=VALUE,…")]
    pub faults: Vec<String>,
    /// How much faster the board's clock runs than this computer's, ppm
    #[arg(long, default_value_t = 0.0, allow_negative_numbers = true)]
    pub clock_ppm: f64,
    /// Board seconds per second
    #[arg(long, default_value_t = 1.0)]
    pub speed: f64,
    /// When the board's button is pressed: a mark in the stream, the next position of a live calibration
    #[arg(long, value_name = "SECONDS,…", value_delimiter = ',')]
    pub press: Vec<f64>,
    /// Stop when the motion or the recording is over
    #[arg(long)]
    pub exit_when_done: bool,
}

#[derive(Clone, Copy, ValueEnum)]
pub enum Sensor {
    /// Accelerometer, magnetometer, thermometer
    Lsm303agr,
    /// Accelerometer only, through a FIFO
    Adxl345,
}

#[derive(Args)]
#[command(after_help = "Example: wimu ports --probe")]
pub struct Ports {
    /// Open the ports that look like a board and ask who is there, 1 s each
    #[arg(long)]
    pub probe: bool,
}

#[derive(Args)]
#[command(after_help = "Example: wimu monitor tcp://127.0.0.1:7100 --for 5")]
pub struct Monitor {
    /// A LINK, or a recording
    pub input: String,
    /// Stop after this many seconds
    #[arg(long = "for", value_name = "SECONDS")]
    pub seconds: Option<f64>,
}

#[derive(Args)]
#[command(after_help = "\
Example: wimu record tcp://127.0.0.1:7101 --cable tcp://127.0.0.1:7100 -o session.mcap
Ctrl-C ends the recording.")]
pub struct Record {
    /// A LINK
    pub link: String,
    /// A second link of the same board, recorded beside the first
    #[arg(long, value_name = "LINK")]
    pub cable: Option<String>,
    /// The recording
    #[arg(short, long, value_name = "FILE.mcap")]
    pub output: PathBuf,
    /// Add the decoded ROS 2 topics when the recording is over
    #[arg(long)]
    pub decoded: bool,
    /// A lost link is opened again; end when every link has been lost for this long
    #[arg(long, value_name = "SECONDS", default_value_t = 30.0)]
    pub reconnect: f64,
    /// Stop after this many seconds
    #[arg(long = "for", value_name = "SECONDS")]
    pub seconds: Option<f64>,
}

#[derive(Args)]
#[command(after_help = "Example: wimu info session.mcap")]
pub struct Info {
    /// A recording, or a LINK
    pub input: String,
    /// The input is another maker's file
    #[arg(long, value_enum)]
    pub format: Option<Foreign>,
}

#[derive(Args)]
#[command(after_help = "\
Example: wimu compare session.mcap --report compare.html -o LINK.json
         wimu compare reference.csv other.csv")]
pub struct Compare {
    /// A recording of both links, or the CSV file of the reference
    pub input: String,
    /// The CSV file of another device in the same motion, which must not repeat itself (that of
    /// `wimu simulate --motion hand` does, every 10 s)
    pub other: Option<String>,
    /// Write the wireless link's error model here; `wimu export --link-model` takes it off
    #[arg(short, long, value_name = "LINK.json")]
    pub output: Option<PathBuf>,
    /// Write a page with pictures here
    #[arg(long, value_name = "FILE.html")]
    pub report: Option<PathBuf>,
    /// Write each picture into this folder, as SVG and as PNG
    #[arg(long, value_name = "FOLDER")]
    pub pictures: Option<PathBuf>,
}

#[derive(Args)]
#[command(after_help = "\
Example: wimu export session.mcap -o session.csv --stream corrected
         wimu export CAL.json --format c -o wimu_calibration.h
         wimu export CAL.json --format kalibr --noise NOISE.json -o imu.yaml")]
pub struct Export {
    /// A recording, or a calibration for the formats rust, c and kalibr
    pub input: PathBuf,
    /// The table, or the file for your own firmware or tools; without it a calibration is printed
    #[arg(short, long, value_name = "FILE")]
    pub output: Option<PathBuf>,
    /// How it is written
    #[arg(long, value_enum, default_value_t = ExportFormat::Csv)]
    pub format: ExportFormat,
    /// What `wimu allan --json` printed, for the noise that kalibr wants
    #[arg(long, value_name = "NOISE.json")]
    pub noise: Option<PathBuf>,
    /// Take this error model off its link, as `wimu compare -o` wrote it
    #[arg(long, value_name = "LINK.json")]
    pub link_model: Option<PathBuf>,
    /// What is written; the magnetic field is corrected with corrected only, where Field Calibrated
    /// is 1
    #[arg(long, value_enum, default_value_t = Stream::Raw)]
    pub stream: Stream,
    /// Of which link; without it, the cable if it was recorded
    #[arg(long, value_enum)]
    pub link: Option<Role>,
}

#[derive(Clone, Copy, ValueEnum)]
pub enum ExportFormat {
    /// A table
    Csv,
    /// A recording with decoded ROS 2 topics beside the bytes
    Mcap,
    /// A table, from a capture of a MIMU4444's Bluetooth stream
    Mimu4444,
    /// A calibration as a Rust module for wimu-model
    Rust,
    /// A calibration as a C header without dependencies
    C,
    /// A calibration as Kalibr's IMU file
    Kalibr,
}

/// A file of another maker.
#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Foreign {
    /// A capture of a MIMU4444's Bluetooth stream
    Mimu4444,
}

/// A stream of a recording.
#[derive(Clone, Copy, ValueEnum)]
pub enum Stream {
    Raw,
    Corrected,
    Navigation,
}

/// A link of a board.
#[derive(Clone, Copy, ValueEnum)]
pub enum Role {
    Cable,
    Wireless,
}

impl From<Role> for wimu_link::LinkRole {
    fn from(role: Role) -> Self {
        match role {
            Role::Cable => Self::Cable,
            Role::Wireless => Self::Wireless,
        }
    }
}

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
    /// The input is another maker's file; choose with --accelerometer
    #[arg(long, value_enum)]
    pub format: Option<Foreign>,
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

#[derive(Subcommand)]
pub enum Params {
    /// What the device corrects with
    #[command(after_help = "Example: wimu params get tcp://127.0.0.1:7100 -o CAL.json")]
    Get {
        /// A LINK
        link: String,
        /// Write it here, for `params push`
        #[arg(short, long, value_name = "CAL.json")]
        output: Option<PathBuf>,
    },
    /// Send a calibration: stage, compare, commit
    #[command(after_help = "Example: wimu params push tcp://127.0.0.1:7100 CAL.json")]
    Push {
        /// A LINK; only the cable writes as long as the device has no key
        link: String,
        /// What `wimu calibrate -o` or `wimu params get -o` wrote
        calibration: PathBuf,
        /// Say what would change, and change nothing
        #[arg(long)]
        dry_run: bool,
    },
    /// Forget calibration and settings
    #[command(after_help = "Example: wimu params factory-reset tcp://127.0.0.1:7100")]
    FactoryReset {
        /// A LINK
        link: String,
    },
}

#[derive(Subcommand)]
pub enum Key {
    /// Make a key and give it to a device that has none, over the cable
    #[command(after_help = "Example: wimu key set /dev/ttyACM0")]
    Set {
        /// A LINK to the cable
        link: String,
    },
    /// Whether a device has a key, and whether this computer has it
    #[command(after_help = "Example: wimu key status tcp://127.0.0.1:7100")]
    Status {
        /// A LINK
        link: String,
    },
    /// Give a device a new key in place of this computer's, over the cable
    #[command(after_help = "Example: wimu key rotate /dev/ttyACM0")]
    Rotate {
        /// A LINK to the cable
        link: String,
    },
    /// Have a device and this computer forget the key, over the cable
    #[command(after_help = "Example: wimu key forget /dev/ttyACM0")]
    Forget {
        /// A LINK to the cable
        link: String,
    },
}

#[derive(Subcommand)]
pub enum Settings {
    /// How the device measures and what it sends
    #[command(after_help = "Example: wimu settings get tcp://127.0.0.1:7100")]
    Get {
        /// A LINK
        link: String,
    },
    /// Change some settings; the others stay
    #[command(
        after_help = "Example: wimu settings set tcp://127.0.0.1:7100 --rate 400 --zupt off
         wimu settings set tcp://127.0.0.1:7100 --wireless raw,navigation --wireless-every 4
         wimu settings set /dev/ttyACM0 --baud 460800"
    )]
    Set {
        /// A LINK
        link: String,
        #[command(flatten)]
        change: Change,
    },
}

#[derive(Args)]
#[group(required = true, multiple = true)]
pub struct Change {
    /// Full-scale range, ± g
    #[arg(long, value_name = "G")]
    pub range: Option<u8>,
    /// Output data rate, Hz
    #[arg(long, value_name = "HZ")]
    pub rate: Option<u16>,
    /// Power against noise
    #[arg(long, value_enum)]
    pub resolution: Option<Resolution>,
    /// Take velocity at every rest as zero
    #[arg(long, value_enum)]
    pub zupt: Option<Switch>,
    /// Local gravity, m/s²
    #[arg(long, value_name = "M_S2")]
    pub gravity: Option<f64>,
    /// What the cable carries: raw,corrected,navigation,environment
    #[arg(long, value_enum, value_delimiter = ',', value_name = "STREAMS")]
    pub cable: Option<Vec<Carried>>,
    /// What the wireless link carries, likewise
    #[arg(long, value_enum, value_delimiter = ',', value_name = "STREAMS")]
    pub wireless: Option<Vec<Carried>>,
    /// Rate of this LINK's line, bits/s, at both ends; back at the old one if the board is not heard
    #[arg(long, value_name = "N")]
    pub baud: Option<u32>,
    /// Rate of the board's line to its radio adapter, bits/s, after the adapter was set to it
    #[arg(long, value_name = "N")]
    pub wireless_baud: Option<u32>,
    /// Samples to a batch on both links, 1 to 32
    #[arg(long, value_name = "N")]
    pub batch: Option<u8>,
    /// Samples to a batch on the cable
    #[arg(long, value_name = "N", conflicts_with = "batch")]
    pub cable_batch: Option<u8>,
    /// Samples to a batch on the wireless link
    #[arg(long, value_name = "N", conflicts_with = "batch")]
    pub wireless_batch: Option<u8>,
    /// Raw and corrected samples on the cable: every n-th, 1 to 255; not filtered, so that faster
    /// motion is aliased
    #[arg(long, value_name = "N")]
    pub cable_every: Option<u8>,
    /// Those on the wireless link
    #[arg(long, value_name = "N")]
    pub wireless_every: Option<u8>,
}

#[derive(Clone, Copy, ValueEnum)]
pub enum Resolution {
    Low,
    Normal,
    High,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Switch {
    On,
    Off,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Carried {
    Raw,
    Corrected,
    Navigation,
    Environment,
    None,
}

#[derive(Args)]
#[command(after_help = "\
Example: wimu navigate session.mcap -o path.csv
         wimu navigate walk.csv --method tilt --zupt off --report path.html
         wimu navigate board.csv --geometry places.csv -o path.csv
         wimu navigate board.csv --geometry ARRAY.json                 (from `wimu calibrate --geometry`)
         wimu navigate cube.csv --geometry cube:100mm                  (columns `Accelerometer 0 (m/s²)`, … to 5)
         wimu navigate a.mcap b.mcap c.mcap d.mcap --geometry boards.json --refine refined.json")]
pub struct Navigate {
    /// A recording, or a CSV file of corrected samples
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
    /// (triads so far from the centre), `board:9.5mm,2mm` (eight triads, half the side and half the thickness)
    #[arg(long, value_name = "FILE|PRESET")]
    pub geometry: Option<PathBuf>,
    /// Estimate the places of all axes and the delays of all sensors from this recording, use them and write
    /// them here
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
    /// Sensitivity of an array's counts
    #[arg(long, value_name = "LSB_PER_G", default_value_t = 2048.0)]
    pub sensitivity: f64,
    /// Position counts as usable while its standard deviation is below this, m
    #[arg(long, value_name = "M", default_value_t = 1.0)]
    pub limit: f64,
    /// Write a report with pictures here
    #[arg(long, value_name = "FILE.html")]
    pub report: Option<PathBuf>,
    /// Write velocity and position here, as a CSV file
    #[arg(short, long, value_name = "PATH.csv")]
    pub output: Option<PathBuf>,
    /// Recompute with this calibration instead of the device's own; of an array once for each sensor, in the
    /// order of --geometry
    #[arg(long, value_name = "CAL.json")]
    pub calibration: Vec<PathBuf>,
    /// `on`: it is known that it rested wherever it seems to, and σ and Valid depend on that; `off`: no zero velocity at
    /// rests. Without this stillnesses are taken for rests, too, but even motion would look the same: σ holds what it
    /// could have hidden, and Valid ends with it. Either way position is zero where the first rest ends, by definition. The
    /// device's own path is as it did
    #[arg(long, value_enum)]
    pub zupt: Option<Switch>,
    /// Of which link; without it, the cable if it was recorded
    #[arg(long, value_enum)]
    pub link: Option<Role>,
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
