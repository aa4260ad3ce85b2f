//! What is scored: `scores.toml`, which describes the keys and metrics.

use serde::{Deserialize, Serialize};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Manifest {
    pub score: Vec<Entry>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Entry {
    pub system: String,
    pub metric: Metric,
    pub half: Half,
    pub recordings: Vec<String>,
    pub second: Option<String>,
    pub truth: Option<String>,
    #[serde(default)]
    pub options: Vec<String>,
    #[serde(default)]
    pub aids: Vec<[String; 2]>,
    #[serde(default)]
    pub delete: Vec<String>,
    #[serde(default)]
    pub baselines: Vec<Source>,
    #[serde(default)]
    pub bar: Vec<f64>,
    pub span_s: Option<[f64; 2]>,
    pub moving_mps: Option<f64>,
    #[serde(default)]
    pub left_handed: bool,
    #[serde(default)]
    pub inverse_attitude: bool,
    pub lag_s: Option<f64>,
    pub shift_s: Option<f64>,
    pub fastest_mps: Option<f64>,
    pub truth_sd_m: Option<f64>,
    #[serde(default)]
    pub planar: bool,
    pub lasts_s: Option<f64>,
    pub bias_m: Option<f64>,
}

#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Metric {
    Windows,
    Track,
    Walk,
    Ranges,
    Outages,
    Starts,
    Rate,
    Angle,
    HandEye,
    MultiRange,
    Journeys,
}

/// What estimates.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Source {
    Command,
    ColumnsDeleted,
    ZuptHand,
    ZuptFoot,
    Stays,
    ConstantVelocity,
    LeastSquares,
    ZeroRate,
    Complementary,
    FinestAlone,
}

#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Half {
    Choose,
    Show,
}
