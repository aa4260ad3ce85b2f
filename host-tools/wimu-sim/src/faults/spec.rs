//! Parser of faults.

use std::str::FromStr;
use std::time::Duration;

use wimu_model::STANDARD_GRAVITY_MPS2;

use super::{Jitter, LinkFaults, Loss, Outage, ValueFaults};

/// Names of combinations of faults, with their text and description. Later items in a list are
/// added or replace earlier ones.
pub const PRESETS: [(&str, &str, &str); 4] = [
    ("none", "", "no faults"),
    (
        "bluetooth",
        "baud=115200,latency=15ms,jitter=exp:10ms,buffer=1024",
        "a serial adapter in range, 115,200 baud",
    ),
    (
        "noisy",
        "baud=115200,loss=2%,burst=20,bits=1e-4,jitter=50ms,stall=3s@30s/60s",
        "poor radio link: 2 % of the bytes lost in runs, 1e-4 of the bits flipped, 50 ms of jitter, a stall of 3 s every minute",
    ),
    (
        "other-unit",
        "bias=12/-8/5mg,scale=0.4/-0.3/0.2%,noise=2mg",
        "a wireless unit whose values differ from the cable's",
    ),
];

const LONGEST: Duration = Duration::from_secs(86_400);

/// Why a text is not a list of faults.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum FaultSpecError {
    /// Neither a fault nor a preset.
    #[error("`{0}` is neither a fault nor a preset")]
    Unknown(String),
    /// A value that cannot be read or is out of range.
    #[error("`{key}={value}`: expected {expected}")]
    Value {
        /// The fault.
        key: String,
        /// What was given.
        value: String,
        /// What it takes.
        expected: &'static str,
    },
    /// A length of runs without a loss.
    #[error("`burst` is the length of lost runs, but there is no `loss`")]
    BurstWithoutLoss,
    /// Stalls or disconnects without time between them.
    #[error("`{0}`: the link would never work")]
    NeverWorks(&'static str),
}

impl FromStr for LinkFaults {
    type Err = FaultSpecError;

    fn from_str(text: &str) -> Result<Self, FaultSpecError> {
        let mut faults = Self::default();
        let mut burst = None;
        faults.extend(text, &mut burst)?;
        match (&mut faults.loss, burst) {
            (Some(loss), Some(burst)) => loss.mean_run = burst,
            (None, Some(_)) => return Err(FaultSpecError::BurstWithoutLoss),
            _ => {}
        }
        for (key, outages) in [("stall", &faults.stalls), ("disconnect", &faults.disconnects)] {
            let part = |outage: &Outage| {
                let every = outage.every?.as_secs_f64();
                Some(outage.length.as_secs_f64() / every)
            };
            if outages.iter().filter_map(part).sum::<f64>() >= 0.95 {
                return Err(FaultSpecError::NeverWorks(key));
            }
        }
        Ok(faults)
    }
}

impl LinkFaults {
    fn extend(&mut self, text: &str, burst: &mut Option<f64>) -> Result<(), FaultSpecError> {
        for part in text.split(',').map(str::trim).filter(|part| !part.is_empty()) {
            match part.split_once('=') {
                Some((key, value)) => self.set(key.trim(), value.trim(), burst)?,
                None => match PRESETS.iter().find(|(name, ..)| *name == part) {
                    Some((_, preset, _)) => self.extend(preset, burst)?,
                    None => return Err(FaultSpecError::Unknown(part.to_owned())),
                },
            }
        }
        Ok(())
    }

    fn set(
        &mut self,
        key: &str,
        value: &str,
        burst: &mut Option<f64>,
    ) -> Result<(), FaultSpecError> {
        let wrong = |expected| FaultSpecError::Value {
            key: key.to_owned(),
            value: value.to_owned(),
            expected,
        };
        let rate = |most: f64, expected| part(value, most).ok_or_else(|| wrong(expected));
        match key {
            "baud" => {
                let baud = value.parse().ok();
                let baud = baud.filter(|baud| (300..=4_000_000).contains(baud));
                self.baud = Some(baud.ok_or_else(|| wrong("300 to 4000000 bits a second"))?);
            }
            "latency" => {
                self.latency = duration(value).ok_or_else(|| wrong("a time such as 20ms"))?;
            }
            "jitter" => {
                let jitter = match value.strip_prefix("exp:") {
                    Some(mean) => duration(mean).map(Jitter::Exponential),
                    None => duration(value).map(Jitter::Uniform),
                };
                self.jitter = Some(jitter.ok_or_else(|| wrong("a time, 50ms or exp:50ms"))?);
            }
            "loss" => {
                let fraction = rate(0.9, "0 to 90 % of the bytes, such as 2%")?;
                self.loss = Some(Loss { fraction, mean_run: 20.0 });
            }
            "burst" => {
                let run: Option<f64> = value.parse().ok();
                let run = run.filter(|run| (1.0..=1e6).contains(run));
                *burst = Some(run.ok_or_else(|| wrong("1 to 1000000 bytes"))?);
            }
            "bits" => self.bit_error_rate = rate(0.5, "0 to 0.5, such as 1e-4")?,
            "splice" => self.splice_rate = rate(0.1, "0 to 0.1 per byte, such as 1e-5")?,
            "duplicate" => self.duplicate_rate = rate(0.1, "0 to 0.1 per byte, such as 1e-5")?,
            "stall" | "disconnect" => {
                let outage = outage(value).ok_or_else(|| {
                    wrong("how long, when, and how often if not once, such as 3s@30s or 3s@30s/60s")
                })?;
                match key {
                    "stall" => self.stalls.push(outage),
                    _ => self.disconnects.push(outage),
                }
            }
            "buffer" => {
                let buffer = value.parse().ok();
                let buffer = buffer.filter(|buffer| (16..=16_777_216).contains(buffer));
                self.buffer = Some(buffer.ok_or_else(|| wrong("16 to 16777216 bytes"))?);
            }
            "bias" => {
                let mg = value.strip_suffix("mg").and_then(|mg| axes(mg, 1000.0));
                let mg = mg.ok_or_else(|| {
                    wrong("up to 1000 mg, such as 10mg, or of each axis, such as 10/-5/3mg")
                })?;
                self.values().bias_mps2 = mg.map(|mg| mg * 1e-3 * STANDARD_GRAVITY_MPS2);
            }
            "scale" => {
                let scale = match (value.strip_suffix('%'), value.strip_suffix("ppm")) {
                    (Some(percent), _) => axes(percent, 50.0).map(|s| s.map(|s| s * 1e-2)),
                    (_, Some(ppm)) => axes(ppm, 500_000.0).map(|s| s.map(|s| s * 1e-6)),
                    _ => None,
                };
                self.values().scale = scale.ok_or_else(|| {
                    wrong("up to 50 %, such as 0.5%, 100ppm, or of each axis, such as 0.5/0/-0.5%")
                })?;
            }
            "noise" => {
                let mg: Option<f64> = value.strip_suffix("mg").and_then(|mg| mg.parse().ok());
                let mg = mg.filter(|mg| (0.0..=1000.0).contains(mg));
                let mg = mg.ok_or_else(|| wrong("0 to 1000 mg, such as 2mg"))?;
                self.values().noise_mps2 = mg * 1e-3 * STANDARD_GRAVITY_MPS2;
            }
            _ => return Err(FaultSpecError::Unknown(key.to_owned())),
        }
        Ok(())
    }

    fn values(&mut self) -> &mut ValueFaults {
        self.values.get_or_insert_default()
    }
}

/// A fraction, as number or percentage.
fn part(text: &str, most: f64) -> Option<f64> {
    let value: f64 = match text.strip_suffix('%') {
        Some(percent) => percent.parse::<f64>().ok()? * 1e-2,
        None => text.parse().ok()?,
    };
    (0.0..=most).contains(&value).then_some(value)
}

/// A duration of at most a day, such as `250us`, `20ms`, `3s` or `2min`.
fn duration(text: &str) -> Option<Duration> {
    let end = text.find(|c: char| c.is_ascii_alphabetic() || c == 'µ')?;
    let (number, unit) = text.split_at(end);
    let unit_s = match unit {
        "us" | "µs" => 1e-6,
        "ms" => 1e-3,
        "s" => 1.0,
        "min" => 60.0,
        "h" => 3600.0,
        _ => return None,
    };
    let seconds = number.parse::<f64>().ok()? * unit_s;
    let duration = Duration::try_from_secs_f64(seconds).ok()?;
    (duration <= LONGEST).then_some(duration)
}

pub(super) fn outage(text: &str) -> Option<Outage> {
    let (length, when) = text.split_once('@')?;
    let (start, every) = match when.split_once('/') {
        Some((start, every)) => (start, Some(duration(every)?)),
        None => (when, None),
    };
    let outage = Outage { start: duration(start)?, length: duration(length)?, every };
    let ends = outage.every.is_none_or(|every| every > outage.length);
    (ends && !outage.length.is_zero()).then_some(outage)
}

/// One number for all axes, or three separated by `/`, each within ±`most`.
fn axes(text: &str, most: f64) -> Option<[f64; 3]> {
    let number = |text: &str| {
        let value: f64 = text.trim().parse().ok()?;
        (value.abs() <= most).then_some(value)
    };
    let parts: Vec<&str> = text.split('/').collect();
    match parts.as_slice() {
        [all] => number(all).map(|value| [value; 3]),
        [x, y, z] => Some([number(x)?, number(y)?, number(z)?]),
        _ => None,
    }
}
