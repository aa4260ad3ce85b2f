//! Options of the filter that is aided by fixes or ranges.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use wimu_host::inertial::Profile;

use super::values::{from_to, numbers};

#[derive(Args)]
#[command(next_help_heading = "Aiding")]
pub struct Aids {
    /// What is assumed of the motion
    #[arg(long, value_enum, default_value_t, help_heading = "Model")]
    pub profile: MotionProfile,
    /// Position, velocity or heading by another system (columns: docs/localization/fixes.md); a LINK too if INPUT is one
    #[arg(long, value_name = "FIXES.csv|LINK", group = "aids", conflicts_with = "anchors")]
    pub fixes: Option<PathBuf>,
    /// Time from a fix or range to its time stamp, s
    #[arg(
        long,
        value_name = "S",
        default_value_t = 0.0,
        value_parser = from_to(-2.0, 2.0),
        allow_hyphen_values = true,
        requires = "aids"
    )]
    pub fix_delay: f64,
    /// Position of the antenna from the inertial sensor or the odometer, m, body axes
    #[arg(
        long,
        value_name = "X,Y,Z",
        value_parser = numbers::<3>,
        allow_hyphen_values = true
    )]
    pub lever_arm: Option<[f64; 3]>,
    /// Positions of anchors: columns `Anchor`, `Position E (m)`, `Position N (m)`, in space `Position U (m)`
    #[arg(long, value_name = "ANCHORS.csv")]
    pub anchors: Option<PathBuf>,
    /// Ranges beside inertial samples: columns `Time (s)`, `Anchor`, `Range (m)`; a LINK too if INPUT is one
    #[arg(long, value_name = "RANGES.csv|LINK", group = "aids", requires = "anchors")]
    pub ranges: Option<PathBuf>,
    /// Prior σ of noise, m, bias, m, scale error of ranges [default: 0.03,0.1,0; with --odometry 0.5,0.5,0.1]
    #[arg(
        long,
        value_name = "NOISE,BIAS,SCALE",
        value_parser = numbers::<3>,
        requires = "anchors"
    )]
    pub range_errors: Option<[f64; 3]>,
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
