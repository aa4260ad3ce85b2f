//! Counts → [`Corrector`] → [`Integrator`] in a blocking loop, on any microcontroller: the crates
//! stand alone. `read` is your sensor's driver; `corrector` is what `wimu convert CAL.json --to rust`
//! wrote, or that of a `wimu_model::CompiledSet` (`--to device`). [`blocking`] includes the driver, on `embedded-hal`.
//! `wimu_link::stream` makes such a device one that `wimu monitor` reads.

#![no_std]
#![forbid(unsafe_code)]

pub mod blocking;

use wimu_integrator::{Config, ConfigError, Integrator, Navigation};
use wimu_model::{Corrector, Counts, PeriodNs};

/// Positive full scale of your sensor, LSB: this is that of 12 bits left-justified.
const FULL_SCALE: i32 = 32752;

/// Integrates until `read` ends; `report` sees velocity and position after every sample. A driver
/// that knows when it missed a sample calls [`Integrator::gap`] there.
///
/// # Errors
/// When `period` is outside 100 µs..=1 s.
pub fn run(
    corrector: &Corrector,
    period: PeriodNs,
    mut read: impl FnMut() -> Option<Counts>,
    mut report: impl FnMut(&Navigation),
) -> Result<(), ConfigError> {
    let mut integrator = Integrator::three_axes(Config::new(period)?);
    while let Some(counts) = read() {
        let force = corrector.correct(counts);
        integrator.step(force, counts.saturated(FULL_SCALE));
        report(&integrator.navigation());
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use wimu_model::{ParameterSet, Sensitivity};

    #[test]
    fn a_push_and_a_stop_move_it_by_a_metre() {
        let sensitivity = Sensitivity::from_lsb_per_g(16384.0).unwrap();
        let one_mps2 = (16384.0 / 9.80665) as i16;
        // 2 s of rest, 1 s forward at 1 m/s², 1 s back, 1 s of rest, at 100 Hz.
        let mut samples = (0..500).map(|k| {
            let x = match k {
                200..300 => one_mps2,
                300..400 => -one_mps2,
                _ => 0,
            };
            Counts([x, 0, 16384])
        });
        let mut last = Navigation::default();
        run(
            &Corrector::compile(&ParameterSet::uncalibrated(2, sensitivity), None).unwrap(),
            PeriodNs(10_000_000),
            || samples.next(),
            |navigation| last = *navigation,
        )
        .unwrap();
        assert!((last.position.to_m()[0] - 1.0).abs() < 1e-3);
        assert!(last.flags.is_valid());
    }
}
