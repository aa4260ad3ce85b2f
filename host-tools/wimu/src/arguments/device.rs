//! Options of the commands that read and change a device's state.

use std::path::PathBuf;
use std::str::FromStr;
use std::time::Duration;

use clap::{Args, Subcommand, ValueEnum};
use wimu_link::LinkRole;

use super::Switch;
use super::values::{from_to, seconds};

#[derive(Subcommand)]
pub enum Device {
    /// List the serial ports of this computer
    Ports(Ports),
    /// Show which device is on a link
    #[command(after_help = "Example: wimu device info /dev/ttyACM0")]
    Info {
        /// Serial port, tcp://HOST:PORT, mqtt://HOST/FLEET/BOARD or `auto`
        link: String,
    },
    /// Read, write or erase the calibration on a device
    Params {
        #[command(subcommand)]
        action: Params,
    },
    /// Read or change the settings of a device
    Settings {
        #[command(subcommand)]
        action: Settings,
    },
    /// Manage the key that signs writes to a device
    Key(Key),
    /// Write firmware to a board through its debug probe
    Flash(Flash),
    /// Write a file for a bug report: answers and bytes of a link
    ReportBug(ReportBug),
}

#[derive(Subcommand)]
pub enum Params {
    /// Show the calibration that the device uses
    #[command(after_help = "Example: wimu device params get tcp://127.0.0.1:7100 -o CAL.json")]
    Get {
        /// Serial port, tcp://HOST:PORT, mqtt://HOST/FLEET/BOARD or `auto`
        link: String,
        /// Write it to this file, for `params push`
        #[arg(short, long, value_name = "CAL.json")]
        output: Option<PathBuf>,
    },
    /// Write a calibration: stage, compare, commit
    #[command(after_help = "Example: wimu device params push tcp://127.0.0.1:7100 CAL.json")]
    Push {
        /// Serial port, tcp://HOST:PORT, mqtt://HOST/FLEET/BOARD or `auto`. A device without a key accepts writes over the cable only
        link: String,
        /// File that `wimu calibrate -o` or `wimu device params get -o` wrote
        calibration: PathBuf,
        /// Show what would change, and write nothing
        #[arg(long)]
        dry_run: bool,
        /// Push also the calibration of another device
        #[arg(long)]
        force: bool,
    },
    /// Erase calibration and settings
    #[command(after_help = "Example: wimu device params factory-reset tcp://127.0.0.1:7100")]
    FactoryReset {
        /// Serial port, tcp://HOST:PORT, mqtt://HOST/FLEET/BOARD or `auto`
        link: String,
    },
}

#[derive(Args)]
#[command(after_help = "\
Examples:
  wimu device key set /dev/ttyACM0
  wimu device key status tcp://127.0.0.1:7100")]
pub struct Key {
    /// What to do; all actions but `status` need the cable
    #[arg(value_enum)]
    pub action: KeyAction,
    /// Serial port, tcp://HOST:PORT, mqtt://HOST/FLEET/BOARD or `auto`
    pub link: String,
}

#[derive(Clone, Copy, ValueEnum)]
pub enum KeyAction {
    /// Create a key and store it on a device that has none
    Set,
    /// Show whether a device has a key, and whether this computer has the same one
    Status,
    /// Replace the key of a device by a new one
    Rotate,
    /// Erase the key on a device and on this computer
    Forget,
}

#[derive(Subcommand)]
pub enum Settings {
    /// Show the settings
    #[command(after_help = "Example: wimu device settings get tcp://127.0.0.1:7100")]
    Get {
        /// Serial port, tcp://HOST:PORT, mqtt://HOST/FLEET/BOARD or `auto`
        link: String,
    },
    /// Change settings; those that are not given are kept
    #[command(
        override_usage = "wimu device settings set <LINK> <OPTIONS>",
        after_help = "Examples:
  wimu device settings set tcp://127.0.0.1:7100 --rate 400 --zupt off
  wimu device settings set /dev/ttyACM0 --wireless raw,navigation --every wireless=4
  wimu device settings set /dev/ttyACM0 --wireless-baud 9600"
    )]
    Set {
        /// Serial port, tcp://HOST:PORT, mqtt://HOST/FLEET/BOARD or `auto`
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
    /// Resolution: low saves power, high has less noise
    #[arg(long, value_enum)]
    pub resolution: Option<Resolution>,
    /// Zero-velocity updates at rests
    #[arg(long, value_enum)]
    pub zupt: Option<Switch>,
    /// Local gravity, m/s²
    #[arg(hide_short_help = true, long, value_name = "M_S2", value_parser = from_to(9.7, 9.9))]
    pub gravity: Option<f64>,
    /// Streams on the cable, such as raw,corrected,navigation,environment
    #[arg(long, value_enum, value_delimiter = ',', value_name = "STREAMS")]
    pub cable: Option<Vec<Carried>>,
    /// Streams on the wireless link
    #[arg(long, value_enum, value_delimiter = ',', value_name = "STREAMS")]
    pub wireless: Option<Vec<Carried>>,
    /// Baud rate between the board and its radio adapter from the board's next start on, bit/s
    #[arg(hide_short_help = true, long, value_name = "N")]
    pub wireless_baud: Option<u32>,
    /// Samples per batch, 1 to 32, of both links or of one, such as wireless=4
    #[arg(hide_short_help = true, long, value_name = "[LINK=]N,…", value_delimiter = ',')]
    pub batch: Vec<PerLink>,
    /// Decimation of raw and corrected samples, 1 to 255, of both links or of one. It does not filter: faster motion is
    /// aliased
    #[arg(long, value_name = "[LINK=]N,…", value_delimiter = ',')]
    pub every: Vec<PerLink>,
}

/// A number for one link, or for both.
#[derive(Clone, Copy)]
pub struct PerLink {
    link: Option<LinkRole>,
    value: u8,
}

impl PerLink {
    /// The number for a link; `None` if it is not among them.
    pub fn of(all: &[Self], link: LinkRole) -> Option<u8> {
        let mut given = all.iter().filter(|one| one.link.is_none_or(|role| role == link));
        given.next_back().map(|one| one.value)
    }
}

impl FromStr for PerLink {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (link, value) = match text.split_once('=') {
            Some(("cable", value)) => (Some(LinkRole::Cable), value),
            Some(("wireless", value)) => (Some(LinkRole::Wireless), value),
            Some(_) => return Err("the links are cable and wireless".to_owned()),
            None => (None, text),
        };
        let value = value.parse().map_err(|_| "give a number up to 255, or LINK=NUMBER")?;
        Ok(Self { link, value })
    }
}

#[derive(Clone, Copy, ValueEnum)]
pub enum Resolution {
    Low,
    Normal,
    High,
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
#[command(after_help = "Example: wimu device ports --probe")]
pub struct Ports {
    /// Open the ports that look like a board and identify it, 1 s each
    #[arg(long)]
    pub probe: bool,
}

#[derive(Args)]
#[command(after_help = "\
Examples:
  wimu device flash
  wimu device flash pico --image target/firmware/pico.uf2
  wimu device flash microbit-v2 --probe 0d28:0204

The image is copied to the drive that the board shows, otherwise written through a debug probe. The calibration \
is kept, except when --erase-all unlocks a locked chip.")]
pub struct Flash {
    /// Board to write [default: the one whose drive is there]
    #[arg(value_enum)]
    pub board: Option<Board>,
    /// Firmware image: Intel HEX or UF2 [default: the one that `cargo xtask firmware` wrote]
    #[arg(long, value_name = "FILE")]
    pub image: Option<PathBuf>,
    /// Folder at which the board's drive is mounted [default: search]
    #[arg(long, value_name = "FOLDER")]
    pub drive: Option<PathBuf>,
    /// Debug probe to use, also if there is a drive
    #[arg(long, value_name = "VENDOR:PRODUCT[:SERIAL]")]
    pub probe: Option<String>,
    /// Unlock a locked chip; this erases its firmware, calibration and key
    #[arg(long)]
    pub erase_all: bool,
}

/// Boards whose images are copied to a drive or written through a debug probe.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Board {
    /// BBC micro:bit v2
    MicrobitV2,
    /// Raspberry Pi Pico
    Pico,
    /// Seeed XIAO nRF52840 Sense
    #[value(name = "xiao-nrf52840")]
    XiaoNrf52840,
}

#[derive(Args)]
#[command(after_help = "\
Example: wimu device report-bug /dev/ttyACM0 /dev/ttyUSB0
The file is JSON: version, operating system, serial ports, answers of the board, received bytes. It has no key.")]
pub struct ReportBug {
    /// One link of a board, or both
    #[arg(value_name = "LINK", required = true, num_args = 1..=2)]
    pub links: Vec<String>,
    /// File to write
    #[arg(short, long, value_name = "FILE.json", default_value = "wimu-bug-report.json")]
    pub output: PathBuf,
    /// Time to listen, s
    #[arg(long = "for", value_name = "SECONDS", default_value = "30", value_parser = seconds)]
    pub seconds: Duration,
}
