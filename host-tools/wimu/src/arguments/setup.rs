//! Rare inputs of `navigate` and `calibrate`: a file, or single values of it.

use std::path::{Path, PathBuf};

use serde::Deserialize;
use wimu_host::{Problem, Result};

use crate::output::usage;

/// The setup as `wimu navigate --print-setup` writes it: every key with its meaning.
pub const EXAMPLE: &str = r#"# Setup of wimu navigate --setup SETUP.toml; a single value: --setup limit_m=0.5
# Standard deviation up to which a position is valid, m:
#limit_m = 1.0

# Ranges to anchors. Positions: columns `Anchor`, `Position E (m)`, `Position N (m)`, in space `Position U (m)`.
#anchors = "anchors.csv"
# Prior σ of noise, m, bias, m, scale error; with --odometry [0.5, 0.5, 0.1]:
#range_errors = [0.03, 0.1, 0.0]
# Estimate the positions of the anchors, which are known to this, m (1 σ of a component):
#survey_m = 0.1

# Time from a fix or range to its time stamp, s, and position of the antenna from the inertial sensor or the odometer, m,
# body axes:
#fix_delay_s = 0.0
# Standard deviation of the time of a fix, s:
#fix_time_sd_s = 0.01
#lever_arm_m = [0.0, 0.0, 0.0]

# An array of accelerometers: positions.csv (header `X (m),Y (m),Z (m)` or mm, one row per triad of axes), ARRAY.json as
# `wimu calibrate --setup geometry=… -o` wrote it, or a preset: four:30mm, octahedron:30mm (triads at this distance
# from the centre), board:9.5mm,2mm (half side and half thickness).
#geometry = "positions.csv"
# σ of its positions, mm, and of the sensors' delays, µs:
#place_sd_mm = 0.5
#delay_sd_us = 300

# Full scale of each accelerometer of one body, ± g: they are merged into one. A recording of wimu has them.
#full_scales_g = [2, 16]

# Two units on two bodies that a hinge connects (--relative): its axis in the axes of both; found from the motion without.
#hinge = [0.0, 0.0, 1.0]
"#;

/// Keys whose value is a path, which is relative to the folder of the file.
const PATHS: [&str; 2] = ["anchors", "geometry"];

/// What [`EXAMPLE`] explains.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Setup {
    pub limit_m: Option<f64>,
    pub anchors: Option<PathBuf>,
    pub range_errors: Option<[f64; 3]>,
    pub survey_m: Option<f64>,
    pub fix_delay_s: f64,
    pub fix_time_sd_s: f64,
    pub lever_arm_m: Option<[f64; 3]>,
    pub geometry: Option<PathBuf>,
    pub place_sd_mm: Option<f64>,
    pub delay_sd_us: Option<f64>,
    pub full_scales_g: Vec<f64>,
    pub hinge: Option<[f64; 3]>,
    /// The keys that were given.
    #[serde(skip)]
    pub given: Vec<String>,
}

impl Setup {
    /// Reads files and values, `FILE.toml` or `KEY=VALUE`, in their order.
    ///
    /// # Errors
    /// `usage`, with what is wrong.
    pub fn read(texts: &[String]) -> Result<Self> {
        let mut all = toml::Table::new();
        for text in texts {
            all.extend(table(text)?);
        }
        let given = all.keys().cloned().collect();
        let setup: Self = all.try_into().map_err(|error| refused(&error.to_string()))?;
        setup.check()?;
        Ok(Self { given, ..setup })
    }

    fn check(&self) -> Result<()> {
        let positive = [
            ("limit_m", self.limit_m),
            ("survey_m", self.survey_m),
            ("place_sd_mm", self.place_sd_mm),
            ("delay_sd_us", self.delay_sd_us),
        ];
        let positive = positive.into_iter().filter_map(|(key, value)| Some((key, value?)));
        let scales = self.full_scales_g.iter().map(|scale| ("full_scales_g", *scale));
        for (key, value) in positive.chain(scales) {
            if !(value > 0.0 && value.is_finite()) {
                return Err(refused(&format!("{key} is {value}, and must be above 0")));
            }
        }
        if !(-2.0..=2.0).contains(&self.fix_delay_s) {
            return Err(refused("fix_delay_s is not from -2 to 2"));
        }
        if !(0.0..=2.0).contains(&self.fix_time_sd_s) {
            return Err(refused("fix_time_sd_s is not from 0 to 2"));
        }
        let vectors = [self.lever_arm_m, self.range_errors, self.hinge];
        if vectors.iter().flatten().flatten().all(|value| value.is_finite()) {
            return Ok(());
        }
        Err(refused("it has a number that is not finite"))
    }
}

fn refused(what: &str) -> Problem {
    let first = what.lines().filter(|line| !line.trim().is_empty()).collect::<Vec<_>>().join(" ");
    usage(format!("--setup: {first}"), "`wimu navigate --print-setup` explains the keys")
}

/// A file, or one value of it.
fn table(text: &str) -> Result<toml::Table> {
    if let Some((key, value)) = text.split_once('=').filter(|_| !Path::new(text).exists()) {
        // A text needs no quotes.
        let line = format!("{key} = {value}");
        let parsed = line.parse();
        return Ok(parsed.unwrap_or_else(|_| {
            toml::Table::from_iter([(key.trim().to_owned(), value.trim().into())])
        }));
    }
    let file = Path::new(text);
    let content =
        std::fs::read_to_string(file).map_err(|error| Problem::file(text, "read", &error))?;
    let mut table: toml::Table =
        content.parse().map_err(|error: toml::de::Error| refused(&error.to_string()).at(text))?;
    let folder = file.parent().unwrap_or(Path::new(""));
    for key in PATHS {
        if let Some(toml::Value::String(path)) = table.get_mut(key)
            && folder.join(&*path).exists()
        {
            *path = folder.join(&*path).display().to_string();
        }
    }
    Ok(table)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_key_of_the_example_is_read_and_others_are_refused() {
        let keys = EXAMPLE.lines().filter_map(|line| line.strip_prefix('#'));
        let keys: Vec<String> =
            keys.filter(|line| !line.starts_with(' ')).map(str::to_owned).collect();
        let setup = Setup::read(&keys).unwrap();
        assert_eq!(setup.given.len(), keys.len());
        assert_eq!((setup.limit_m, setup.full_scales_g), (Some(1.0), vec![2.0, 16.0]));
        for wrong in
            ["speed=3", "limit_m=0", "limit_m=soon", "hinge=[1]", "absent.toml", "fix_delay_s=3"]
        {
            assert!(Setup::read(&[wrong.to_owned()]).is_err(), "{wrong}");
        }
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("a.csv"), "").unwrap();
        let file = folder.path().join("setup.toml");
        std::fs::write(&file, "anchors = \"a.csv\"").unwrap();
        let setup = Setup::read(&[file.display().to_string()]).unwrap();
        assert_eq!(setup.anchors, Some(folder.path().join("a.csv")));
    }
}
