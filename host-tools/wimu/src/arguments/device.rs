//! What can be asked of the commands that read and change a device's state.

use std::path::PathBuf;

use clap::{Args, Subcommand, ValueEnum};

use super::Switch;

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
pub enum Carried {
    Raw,
    Corrected,
    Navigation,
    Environment,
    None,
}
