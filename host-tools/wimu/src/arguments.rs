//! What can be asked for.

mod calibration;
mod device;
mod navigate;

pub use calibration::{Align, Allan, Calibrate, Calibrated, Method};
pub use device::{Carried, Change, Key, Params, Resolution, Settings};
pub use navigate::{Navigate, NavigateMethod, ZeroVelocity};

use std::net::SocketAddr;
use std::path::PathBuf;

use clap::{Args, Parser, Subcommand, ValueEnum};

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

/// Boards that are written through a debug probe.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Board {
    /// BBC micro:bit v2
    MicrobitV2,
    /// Raspberry Pi Pico with an ADXL345
    #[value(name = "pico-adxl345")]
    PicoAdxl345,
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
    /// Lines a second of device time; by default 1, with --json every reading; a terminal's line is
    /// renewed 20 times a second
    #[arg(long, value_name = "HZ")]
    pub rate: Option<f64>,
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
    /// A calibration as a Rust module for wimu-model
    Rust,
    /// A calibration as a C header without dependencies
    C,
    /// A calibration as Kalibr's IMU file
    Kalibr,
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

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Switch {
    On,
    Off,
}
