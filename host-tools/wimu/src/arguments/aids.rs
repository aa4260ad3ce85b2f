//! Options of the filter that is aided by fixes or ranges.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use wimu_host::Result;
use wimu_host::inertial::Profile;

use super::setup::Setup;

#[derive(Args)]
#[command(next_help_heading = "Aiding")]
pub struct Aids {
    /// What is assumed of the motion
    #[arg(long, value_enum, default_value_t, help_heading = "Model")]
    pub profile: MotionProfile,
    /// Measurements of other systems, CSV or LINK
    ///
    /// Position, velocity, heading, pressure or speed by another system (columns: docs/explanation/fixes.md); a LINK too if
    /// INPUT is one
    #[arg(long, value_name = "FIXES.csv|LINK")]
    pub fixes: Option<PathBuf>,
    /// Ranges to anchors, CSV or LINK
    ///
    /// Ranges to the anchors of the setup beside inertial samples: columns `Time (s)`, `Anchor`, `Range (m)`; a LINK too if
    /// INPUT is one
    #[arg(long, value_name = "RANGES.csv|LINK")]
    pub ranges: Option<PathBuf>,
    /// Rare inputs: a file, or one of its keys
    ///
    /// Anchors, lever arms, delays, an array, two units: a file or one of its keys; --print-setup explains them
    #[arg(long = "setup", value_name = "SETUP.toml|KEY=VALUE", help_heading = "Model")]
    pub given: Vec<String>,
    /// The same, read.
    #[arg(skip)]
    pub setup: Setup,
}

impl Aids {
    /// Reads the setup.
    ///
    /// # Errors
    /// Those of [`Setup::read`].
    pub fn read_setup(&mut self) -> Result<()> {
        self.setup = Setup::read(&self.given)?;
        Ok(())
    }
}

/// Motion profiles.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum MotionProfile {
    /// In a hand or on a small robot: velocity 0 ± 2 m/s
    #[default]
    Hand,
    /// On a foot: velocity zero in the stances of steps, walking, running or on stairs
    Foot,
    /// In a vehicle: motion along its forward axis, which is found; 0 ± 30 m/s
    Vehicle,
    /// No assumption
    Free,
}

impl From<MotionProfile> for Profile {
    fn from(profile: MotionProfile) -> Self {
        match profile {
            MotionProfile::Hand => Self::Hand,
            MotionProfile::Foot => Self::Foot,
            MotionProfile::Vehicle => Self::Vehicle,
            MotionProfile::Free => Self::Free,
        }
    }
}
