//! Options of the commands for many boards.

use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, Subcommand};

use super::values::seconds;

#[derive(Args)]
#[command(after_help = "\
Example: wimu fleet gateway --config fleet.toml

fleet.toml:
  fleet = \"hall\"
  broker = \"mqtt://127.0.0.1\"        # USER@HOST:PORT; the password is in WIMU_MQTT_PASSWORD
  gateway = \"north\"                  # a name for each gateway of the fleet
  recordings = \"recordings\"          # folder; optional, as all that follows
  rotate_minutes = 60
  spool = \"spool\"                    # folder for data while the broker is away, the default
  spool_mb = 256
  batch_ms = 1000
  metrics = \"127.0.0.1:9180\"         # Prometheus
  [boards]
  left-arm = \"tcp://127.0.0.1:7100\"
  right-arm = \"serial:///dev/ttyACM0\"

A board is then the LINK mqtt://127.0.0.1/hall/left-arm.")]
pub struct Gateway {
    /// Configuration
    #[arg(long, value_name = "fleet.toml")]
    pub config: PathBuf,
    /// End after this time, s
    #[arg(long = "for", value_name = "SECONDS", value_parser = seconds)]
    pub seconds: Option<Duration>,
}

#[derive(Subcommand)]
pub enum Fleet {
    /// Serve many boards: record them, and publish them through an MQTT broker
    Gateway(Gateway),
    /// List the boards: last seen, age of the calibration, self-check, loss
    #[command(after_help = "Example: wimu fleet status mqtt://127.0.0.1/hall")]
    Status {
        /// mqtt://HOST/FLEET
        fleet: String,
        /// Time to listen, s
        #[arg(long = "for", value_name = "SECONDS", default_value = "1.5", value_parser = seconds)]
        seconds: Duration,
    },
    /// Push calibrations: one board, then 10 %, then all; stops at the first disagreement
    #[command(after_help = "\
Example: wimu fleet push mqtt://127.0.0.1/hall calibrations
FOLDER has a calibration for each board: BOARD.json, or DEVICE_ID.json. Run the command again to resume: boards that hold
their calibration are left as they are.")]
    Push {
        /// mqtt://HOST/FLEET
        fleet: String,
        /// Folder of calibrations
        folder: PathBuf,
        /// End after this stage: 1, 2 or 3
        #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u8).range(1..=3))]
        until: u8,
        /// Push also the calibration of another device
        #[arg(long)]
        force: bool,
    },
}
