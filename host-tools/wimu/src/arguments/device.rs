//! Options of the commands that read and change a device's state.

use std::path::PathBuf;

use clap::{Args, Subcommand, ValueEnum};

use super::Switch;
use super::values::from_to;

#[derive(Subcommand)]
pub enum Params {
    /// Show the calibration that the device uses
    #[command(after_help = "Example: wimu params get tcp://127.0.0.1:7100 -o CAL.json")]
    Get {
        /// Serial port, tcp://HOST:PORT, mqtt://HOST/FLEET/BOARD or `auto`
        link: String,
        /// Write it to this file, for `params push`
        #[arg(short, long, value_name = "CAL.json")]
        output: Option<PathBuf>,
    },
    /// Write a calibration: stage, compare, commit
    #[command(after_help = "Example: wimu params push tcp://127.0.0.1:7100 CAL.json")]
    Push {
        /// Serial port, tcp://HOST:PORT, mqtt://HOST/FLEET/BOARD or `auto`. A device without a key accepts writes over the cable only
        link: String,
        /// File that `wimu calibrate -o` or `wimu params get -o` wrote
        calibration: PathBuf,
        /// Show what would change, and write nothing
        #[arg(long)]
        dry_run: bool,
        /// Push also the calibration of another device
        #[arg(long)]
        force: bool,
    },
    /// Erase calibration and settings
    #[command(after_help = "Example: wimu params factory-reset tcp://127.0.0.1:7100")]
    FactoryReset {
        /// Serial port, tcp://HOST:PORT, mqtt://HOST/FLEET/BOARD or `auto`
        link: String,
    },
}

#[derive(Args)]
#[command(after_help = "\
Examples:
  wimu key set /dev/ttyACM0
  wimu key status tcp://127.0.0.1:7100")]
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
    #[command(after_help = "Example: wimu settings get tcp://127.0.0.1:7100")]
    Get {
        /// Serial port, tcp://HOST:PORT, mqtt://HOST/FLEET/BOARD or `auto`
        link: String,
    },
    /// Change settings; those that are not given are kept
    #[command(
        override_usage = "wimu settings set <LINK> <OPTIONS>",
        after_help = "Examples:
  wimu settings set tcp://127.0.0.1:7100 --rate 400 --zupt off
  wimu settings set /dev/ttyACM0 --wireless raw,navigation --wireless-every 4
  wimu settings set /dev/ttyACM0 --wireless-baud 9600"
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
    #[arg(long, value_name = "M_S2", value_parser = from_to(9.7, 9.9))]
    pub gravity: Option<f64>,
    /// Streams on the cable, such as raw,corrected,navigation,environment
    #[arg(long, value_enum, value_delimiter = ',', value_name = "STREAMS")]
    pub cable: Option<Vec<Carried>>,
    /// Streams on the wireless link
    #[arg(long, value_enum, value_delimiter = ',', value_name = "STREAMS")]
    pub wireless: Option<Vec<Carried>>,
    /// Baud rate between the board and its radio adapter from the board's next start on, bit/s
    #[arg(long, value_name = "N")]
    pub wireless_baud: Option<u32>,
    /// Samples per batch on both links, 1 to 32
    #[arg(long, value_name = "N")]
    pub batch: Option<u8>,
    /// Samples per batch on the cable
    #[arg(long, value_name = "N", conflicts_with = "batch")]
    pub cable_batch: Option<u8>,
    /// Samples per batch on the wireless link
    #[arg(long, value_name = "N", conflicts_with = "batch")]
    pub wireless_batch: Option<u8>,
    /// Decimation of raw and corrected samples on the cable, 1 to 255. It does not filter: faster
    /// motion is aliased
    #[arg(long, value_name = "N")]
    pub cable_every: Option<u8>,
    /// Decimation of raw and corrected samples on the wireless link, 1 to 255
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
pub enum Carried {
    Raw,
    Corrected,
    Navigation,
    Environment,
    None,
}
