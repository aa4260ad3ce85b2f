//! The commands and their options.

mod aids;
mod calibration;
mod convert;
mod device;
mod fleet;
mod navigate;
mod reading;
mod relations;
mod setup;
mod values;

pub use aids::{Aids, MotionProfile};
pub use calibration::{Align, Allan, Calibrate, Method};
pub use convert::{Convert, Target};
pub use device::{
    Board, Carried, Change, Device, Flash, Key, KeyAction, Params, PerLink, Ports, ReportBug,
    Resolution, Settings,
};
pub use fleet::{Fleet, Gateway};
pub use navigate::{Navigate, Smoothing, ZeroVelocity};
pub use reading::Reading;
pub use relations::check;
pub use setup::{EXAMPLE as SETUP_EXAMPLE, Setup};

use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

use clap::{ArgMatches, Args, Parser, Subcommand, ValueEnum};
use wimu_host::csv::Filter;
use wimu_host::{Result, StandardInput};
use wimu_sim::board::SensorPart;

use self::values::{from_to, seconds};
use crate::output::usage;

/// Make a wireless inertial measurement unit of a MEMS accelerometer: record, calibrate, correct, navigate.
///
/// LINK is tcp://127.0.0.1:7100, serial:///dev/ttyACM0?baud=115200, a port (COM5, /dev/rfcomm0),
/// mqtt://HOST/FLEET/BOARD or `auto`.
#[derive(Parser)]
#[command(
    name = "wimu",
    version,
    max_term_width = 100,
    after_help = "\
Start with `wimu demo`.

Exit codes: 0 done, 1 failed, 2 wrong usage or unreadable input, 3 the data do not support an answer, \
4 the device refused."
)]
pub struct Arguments {
    /// Print JSON on stdout (streaming commands one object per line), human text on stderr
    #[arg(long, global = true)]
    pub json: bool,
    /// Show all findings, not only the five most severe
    #[arg(short, long, global = true)]
    pub verbose: bool,
    #[command(subcommand)]
    pub command: Command,
}

impl Arguments {
    /// Replaces `-` as an input by a file with all of standard input, which lasts as long as what is returned.
    ///
    /// # Errors
    /// Those of [`StandardInput::read`]; `usage` where two inputs are `-`.
    pub fn take_standard_input(&mut self) -> Result<Option<StandardInput>> {
        let mut text = None;
        let mut inputs = match &mut self.command {
            Command::Convert(arguments) => {
                arguments.with.iter_mut().chain([&mut arguments.input]).collect()
            }
            Command::Navigate(arguments) => vec![&mut arguments.input],
            Command::Info(Info { input, .. })
            | Command::Calibrate(Calibrate { input, .. })
            | Command::Allan(Allan { input, .. })
            | Command::Align(Align { input, .. }) => {
                let path = PathBuf::from(&*input);
                vec![&mut text.insert((input, path)).1]
            }
            _ => Vec::new(),
        };
        inputs.retain(|path| path.as_os_str() == "-");
        let file = match &mut inputs[..] {
            [] => return Ok(None),
            [path] => {
                let file = StandardInput::read()?;
                file.path().clone_into(path);
                file
            }
            _ => return Err(usage("standard input was given twice", "name a file")),
        };
        if let Some((input, path)) = text {
            *input = path.display().to_string();
        }
        Ok(Some(file))
    }

    /// Reads the setup of `navigate`.
    ///
    /// # Errors
    /// Those of [`Setup::read`].
    pub fn read_setup(&mut self) -> Result<()> {
        match &mut self.command {
            Command::Navigate(navigate) => navigate.aids.read_setup(),
            _ => Ok(()),
        }
    }

    /// Whether a result other than JSON goes to standard output, given as `-o -`.
    pub fn writes_standard_output(matches: &ArgMatches) -> bool {
        let command = matches.subcommand().map(|(_, command)| command);
        let output = command.and_then(|command| command.try_get_raw("output").ok()?);
        output.is_some_and(|mut output| output.any(|path| path == "-"))
    }
}

#[derive(Subcommand)]
pub enum Command {
    /// Record, calibrate and navigate with a simulated board, in a few seconds
    Demo(Demo),
    /// Run a simulated board that listens on two TCP ports
    Simulate(Simulate),
    /// Show readings of a board or a recording
    Monitor(Monitor),
    /// Show boards and recordings in the browser: plots, calibration, parameters
    Dashboard(Dashboard),
    /// Record everything a board sends, byte for byte
    Record(Record),
    /// Show what a recording of any format contains, or which device is on a link
    Info(Info),
    /// Convert a recording of any format, or a calibration to a source file
    Convert(Convert),
    /// Estimate the error model of an accelerometer, an array or a magnetometer
    Calibrate(Calibrate),
    /// Estimate the rotation from the sensor to the body that it is mounted on
    Align(Align),
    /// Estimate noise density and bias instability of an accelerometer at rest
    Allan(Allan),
    /// Compare wireless and cable: loss, latency, clock, values
    Compare(Compare),
    /// Compute velocity and position with their uncertainty
    Navigate(Box<Navigate>),
    /// What happens on a board: ports, parameters, settings, key, firmware
    Device {
        #[command(subcommand)]
        action: Device,
    },
    /// Many boards through an MQTT broker
    Fleet {
        #[command(subcommand)]
        action: Fleet,
    },
    /// Print the completion script of a shell
    #[command(hide = true)]
    Completions(Completions),
    /// Write manual pages
    #[command(hide = true)]
    Man(Man),
}

#[derive(Args)]
#[command(
    after_help = "Example: wimu completions bash > ~/.local/share/bash-completion/completions/wimu"
)]
pub struct Completions {
    /// Shell
    pub shell: clap_complete::Shell,
}

#[derive(Args)]
#[command(after_help = "Example: wimu man ~/.local/share/man/man1")]
pub struct Man {
    /// Folder for the pages
    pub folder: PathBuf,
}

#[derive(Args)]
#[command(after_help = "\
Examples:
  wimu demo --seed 7
  wimu demo --chip lsm6dso
  wimu demo --localize walks")]
pub struct Demo {
    /// Sensor on the board
    #[arg(long, value_enum, default_value_t = Chip::Lsm303agr)]
    pub chip: Chip,
    /// Seed of the simulated sensor's errors and noise
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Write the report with pictures to this file
    #[arg(long, value_name = "FILE.html", default_value = "wimu-demo-report.html")]
    pub report: PathBuf,
    /// Write the pictures to this folder, as SVG
    #[arg(long, value_name = "FOLDER")]
    pub pictures: Option<PathBuf>,
    /// Write files of simulated walks to this folder instead: ranges to anchors, a unit on a shoe, position fixes
    #[arg(long, value_name = "FOLDER", conflicts_with_all = ["chip", "report", "pictures"])]
    pub localize: Option<PathBuf>,
}

#[derive(Args)]
#[command(
    after_help = "Example: wimu simulate --faults noisy --motion twelve-poses,slide; more with --help",
    after_long_help = "\
FAULTS is a list of presets and faults:
  none                    no faults
  bluetooth               serial adapter in range, 115200 baud
  noisy                   2 % of the bytes lost, 1e-4 of the bits flipped, 50 ms of jitter, stalls
  other-unit              samples with other bias, scale factor and noise than on the cable
  baud=115200             rate of the simulated UART, bits/s
  latency=20ms            delay of every byte
  jitter=50ms             further delay of each packet, uniform from 0; exp:50ms exponential, mean 50 ms
  loss=2%                 fraction of the bytes lost, in runs
  burst=20                mean length of a run of lost bytes, bytes
  bits=1e-4               fraction of the bits flipped
  splice=1e-5             probability per byte that an earlier piece is inserted
  duplicate=1e-5          probability per byte that the latest bytes are repeated
  stall=3s@30s/60s        nothing passes for 3 s from 30 s on, every 60 s (without /60s once)
  disconnect=3s@30s/60s   likewise; both ends lose the connection and the bytes under way
  buffer=4096             bytes held during latency and stalls; a UART loses further ones, TCP waits
  bias=10/-5/3mg          added to the samples of X/Y/Z; one number for all axes
  scale=0.5/0/-0.5%       scale factor error of X/Y/Z, in % or ppm; one number for all axes
  noise=2mg               standard deviation of noise added to each axis
Faults of the board itself:
  absent, identity        the sensor does not answer, or has the WHO_AM_I of another chip
  gyroscope-stops=2s@10s  likewise gyroscope-stuck, gyroscope-saturates; duration and start as for stalls
  clock=35ppm             rate error of the board's clock, positive if it is fast; at most 10000
  press=3s                the board's button is pressed at this time

Examples:
  wimu simulate --motion twelve-poses,slide --seed 3
  wimu simulate --replay recording.csv --speed 10 --exit-when-done
  wimu simulate --chip lsm6dso --motion carry,hand --faults gyroscope-stops=2s@10s
  wimu simulate --faults noisy,clock=35ppm
  wimu simulate --faults loss=2%,burst=20,bits=1e-4,jitter=50ms,stall=3s@30s
  wimu simulate --faults other-unit --faults cable:latency=2ms"
)]
pub struct Simulate {
    /// Sensor on the board
    ///
    /// Sensor on the board, or lsm303agr,adxl345: two accelerometers, the second of ± 16 g; either may be the first
    #[arg(long, value_enum, value_delimiter = ',', default_value = "lsm303agr")]
    pub chip: Vec<Chip>,
    /// Motions, in order and repeated
    ///
    /// Motions of the board, in order and repeated: rest, six-positions, twelve-poses, tilts, slide,
    /// carry, hand, impact
    #[arg(long, default_value = "twelve-poses,slide", value_name = "NAMES")]
    pub motion: String,
    /// Replay the raw counts of this CSV file
    ///
    /// Replay the raw counts of this CSV file instead; it starts when a host connects
    #[arg(long, value_name = "FILE.csv", conflicts_with = "motion")]
    pub replay: Option<PathBuf>,
    /// Rows of the CSV file: "IMU=0"
    ///
    /// Rows of the CSV file to use: those whose columns have these values, such as "IMU=0"
    #[arg(long = "where", value_name = "COLUMN=VALUE,…", requires = "replay")]
    pub filter: Option<Filter>,
    /// Index of the accelerometer in the CSV file
    ///
    /// Index of the accelerometer in a CSV file that has several
    #[arg(long, value_name = "INDEX", requires = "replay")]
    pub sensor: Option<u8>,
    /// Seed of errors, noise and serial number
    ///
    /// Seed of the sensor's errors and noise, and the board's serial number
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Keep the flash memory in this file
    ///
    /// Keep the board's flash memory in this file [default: in memory only]
    #[arg(long, value_name = "FILE")]
    pub store: Option<PathBuf>,
    /// Erase key and settings at the start
    ///
    /// Start with the key reset at the board: it erases key and settings
    #[arg(hide_short_help = true, long)]
    pub forget_key: bool,
    /// Address of the cable
    #[arg(long, default_value = "127.0.0.1:7100", value_name = "ADDRESS")]
    pub cable: SocketAddr,
    /// Address of the wireless link
    #[arg(long, default_value = "127.0.0.1:7101", value_name = "ADDRESS")]
    pub wireless: SocketAddr,
    /// Faults: noisy, loss=2%, clock=35ppm, …
    ///
    /// Faults, see FAULTS below; those of a link are of the wireless one unless preceded by `cable:`
    #[arg(long, value_name = "[LINK:]FAULT=VALUE,…")]
    pub faults: Vec<String>,
    /// Speed relative to real time
    ///
    /// Speed of the simulated time relative to real time, at most 1000
    #[arg(long, default_value_t = 1.0, value_parser = from_to(1e-3, 1e3))]
    pub speed: f64,
    /// Stop at the end of the motion or of the replayed file
    #[arg(long)]
    pub exit_when_done: bool,
}

#[derive(Clone, Copy, ValueEnum)]
pub enum Chip {
    /// Accelerometer, magnetometer and temperature sensor
    Lsm303agr,
    /// Accelerometer with a FIFO
    Adxl345,
    /// Accelerometer, gyroscope and temperature sensor
    Lsm6dso,
    /// The same as on a XIAO nRF52840 Sense
    #[value(name = "lsm6ds3tr-c")]
    Lsm6ds3trC,
    /// Accelerometer and gyroscope of GY-521 modules
    Mpu6050,
    /// Accelerometer and gyroscope read at intervals of a timer
    Icm42688,
}

impl From<Chip> for SensorPart {
    fn from(chip: Chip) -> Self {
        match chip {
            Chip::Lsm303agr => Self::Lsm303agr,
            Chip::Adxl345 => Self::Adxl345,
            Chip::Lsm6dso => Self::Lsm6dso,
            Chip::Lsm6ds3trC => Self::Lsm6ds3trC,
            Chip::Mpu6050 => Self::Mpu6050,
            Chip::Icm42688 => Self::Icm42688,
        }
    }
}

#[derive(Args)]
#[command(after_help = "\
Examples:
  wimu monitor tcp://127.0.0.1:7100
  wimu monitor tcp://127.0.0.1:7100 --rate 10 --for 5
At a terminal the rows of a LINK are redrawn in place; otherwise, and with --rate or --json, it prints \
lines. `wimu dashboard` plots and records.")]
pub struct Monitor {
    /// A LINK, or a recording
    pub input: String,
    /// Lines per second of device time [default: 1; with --json every reading]
    #[arg(long, value_name = "HZ", value_parser = from_to(1e-6, 1e6))]
    pub rate: Option<f64>,
    /// Stop after this time, s
    #[arg(long = "for", value_name = "SECONDS", value_parser = seconds)]
    pub seconds: Option<Duration>,
}

#[derive(Args)]
#[command(after_help = "\
Examples:
  wimu dashboard tcp://127.0.0.1:7100 --open
  wimu dashboard tcp://127.0.0.1:7101 tcp://127.0.0.1:7100
  wimu dashboard session.mcap --folder recordings
The page is for this computer only; what follows # in its address allows writes. Two links of one \
board are shown as one board.")]
pub struct Dashboard {
    /// LINKs of boards, and recordings; more can be added on the page
    #[arg(value_name = "LINK|FILE")]
    pub inputs: Vec<String>,
    /// Open the page in the browser
    #[arg(long)]
    pub open: bool,
    /// Port of the page; 0 for a free one
    #[arg(long, value_name = "N", default_value_t = 7180)]
    pub port: u16,
    /// Serve other computers too, at this address; every page then needs the token, which the network can read
    #[arg(long, value_name = "ADDRESS:PORT", conflicts_with = "port")]
    pub listen: Option<SocketAddr>,
    /// Folder whose files the page can open, and to which it writes
    #[arg(long, value_name = "FOLDER", default_value = ".")]
    pub folder: PathBuf,
    /// Stop after this time, s
    #[arg(long = "for", value_name = "SECONDS", value_parser = seconds)]
    pub seconds: Option<Duration>,
}

#[derive(Args)]
#[command(after_help = "\
Example: wimu record tcp://127.0.0.1:7101 tcp://127.0.0.1:7100 -o session.mcap
Ctrl-C ends the recording.")]
pub struct Record {
    /// One link of a board, or both
    #[arg(value_name = "LINK", required = true, num_args = 1..=2)]
    pub links: Vec<String>,
    /// Recording to write
    #[arg(short, long, value_name = "FILE.mcap")]
    pub output: PathBuf,
    /// Add decoded ROS 2 topics at the end of the recording
    #[arg(long)]
    pub decoded: bool,
    /// Stop when all links have been lost for this time, s; until then each is opened again. A link through a broker counts
    /// as lost after 10 s without it
    #[arg(long, value_name = "SECONDS", default_value = "30", value_parser = seconds)]
    pub reconnect: Duration,
    /// Stop after this time, s
    #[arg(long = "for", value_name = "SECONDS", value_parser = seconds)]
    pub seconds: Option<Duration>,
}

#[derive(Args)]
#[command(after_help = "Example: wimu info session.mcap")]
pub struct Info {
    /// A recording of any format, a LINK, or - for standard input
    pub input: String,
    #[command(flatten)]
    pub reading: Reading,
}

#[derive(Args)]
#[command(after_help = "\
Examples:
  wimu compare session.mcap --report compare.html -o LINK.json
  wimu compare reference.csv other.csv")]
pub struct Compare {
    /// A recording of both links, or a CSV file of the reference
    pub input: String,
    /// CSV file of another device in the same motion, which must not be periodic
    #[arg(conflicts_with_all = ["output", "report"])]
    pub other: Option<String>,
    /// Write the error model of the wireless link to this file, for `wimu convert --with`
    #[arg(short, long, value_name = "LINK.json")]
    pub output: Option<PathBuf>,
    /// Write a report with pictures to this file
    #[arg(long, value_name = "FILE.html")]
    pub report: Option<PathBuf>,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Switch {
    On,
    Off,
}

/// The same command line, whose options take negative numbers too: the parser of each says what it allows.
pub fn with_negative_numbers(command: clap::Command) -> clap::Command {
    let taking = |option: clap::Arg| {
        let is_value = !option.is_positional() && option.get_action().takes_values();
        option.allow_negative_numbers(is_value)
    };
    command.mut_args(taking).mut_subcommands(with_negative_numbers)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use clap::CommandFactory;

    use super::Arguments;

    /// Names of the options of a command and of its own commands.
    fn options(command: &clap::Command, names: &mut BTreeSet<String>) {
        let longs = command.get_arguments().filter_map(|option| option.get_long());
        names.extend(longs.map(str::to_owned));
        command.get_subcommands().for_each(|inner| options(inner, names));
    }

    /// Short help of a command and of its own commands, which has to fit a screen.
    fn fits(command: &clap::Command) {
        let help = command.clone().term_width(80).render_help().to_string();
        let lines = help.lines().count();
        assert!(lines <= 40, "{}: {lines} lines\n{help}", command.get_name());
        command.get_subcommands().for_each(fits);
    }

    #[test]
    fn there_are_at_most_15_commands_with_150_options_and_short_help_fits_40_lines() {
        let mut root = Arguments::command();
        root.build();
        let visible = root.get_subcommands().filter(|c| !c.is_hide_set() && c.get_name() != "help");
        let (mut commands, mut sum) = (0, 0);
        for command in visible {
            let mut names = BTreeSet::new();
            options(command, &mut names);
            let everywhere = ["help", "json", "verbose", "version"];
            names.retain(|name| !everywhere.contains(&name.as_str()));
            commands += 1;
            sum += names.len();
            fits(command);
        }
        assert!(commands <= 15 && sum <= 150, "{commands} commands, {sum} options");
        fits(&root);
    }
}
