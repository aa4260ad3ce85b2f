//! A blocking driver of `embedded-hal` → [`Corrector`] → [`Integrator`]: everything between the bus and the position. The
//! sensor is an ADXL345 at 100 Hz, ±16 g, polled without an interrupt line.

use embedded_hal::i2c::I2c;
use wimu_integrator::{Integrator, Navigation};
use wimu_model::{Corrector, Counts};

/// The sensor's address with its pin SDO at ground.
const ADDRESS: u8 = 0x53;
/// Full resolution, ±16 g: 256 LSB/g; 100 Hz; measure. Registers DATA_FORMAT, BW_RATE, POWER_CTL.
const SETUP: [[u8; 2]; 3] = [[0x31, 0x0B], [0x2C, 0x0A], [0x2D, 0x08]];
const INT_SOURCE: u8 = 0x30;
const DATA_READY: u8 = 1 << 7;
const OVERRUN: u8 = 1;
const DATAX0: u8 = 0x32;
/// 13 bits.
const FULL_SCALE: i32 = 4095;

/// Integrates until `goes_on`, which sees velocity and position after every sample, returns false. The period of
/// `integrator` is 10 ms. A sample that was overwritten before it was read is reported as a gap.
///
/// # Errors
/// That of the bus, on which the sensor may not answer.
pub fn run<I: I2c>(
    i2c: &mut I,
    corrector: &Corrector,
    integrator: &mut Integrator<()>,
    mut goes_on: impl FnMut(&Navigation) -> bool,
) -> Result<(), I::Error> {
    for write in SETUP {
        i2c.write(ADDRESS, &write)?;
    }
    loop {
        let mut source = [0];
        while source[0] & DATA_READY == 0 {
            i2c.write_read(ADDRESS, &[INT_SOURCE], &mut source)?;
        }
        if source[0] & OVERRUN != 0 {
            integrator.gap();
        }
        let mut data = [0; 6];
        i2c.write_read(ADDRESS, &[DATAX0], &mut data)?;
        let [x, hx, y, hy, z, hz] = data;
        let counts = Counts([[x, hx], [y, hy], [z, hz]].map(i16::from_le_bytes));
        integrator.step(corrector.correct(counts), counts.saturated(FULL_SCALE));
        if !goes_on(&integrator.navigation()) {
            return Ok(());
        }
    }
}

#[cfg(test)]
mod tests {
    extern crate std;

    use std::vec::Vec;

    use embedded_hal::i2c::{ErrorKind, NoAcknowledgeSource};
    use embedded_hal_mock::eh1::i2c::{Mock, Transaction};
    use wimu_integrator::{Config, Flags};
    use wimu_model::{ParameterSet, PeriodNs, Sensitivity};

    use super::*;

    const SAMPLES: usize = 500;

    /// 2 s of rest, 1 s forward at 1 m/s², 1 s back, 1 s of rest; the sensor is asked once too early before each sample,
    /// and has lost one before those of `overrun`.
    fn bus(overrun: &[usize]) -> Mock {
        let mut expected: Vec<_> = SETUP.map(|w| Transaction::write(ADDRESS, w.to_vec())).into();
        let mut ask = |register, answer: Vec<u8>| {
            expected.push(Transaction::write_read(ADDRESS, [register].into(), answer));
        };
        for k in 0..SAMPLES {
            let x: i16 = match k {
                200..300 => 26,
                300..400 => -26,
                _ => 0,
            };
            let lost = u8::from(overrun.contains(&k));
            ask(INT_SOURCE, [0x02].into());
            ask(INT_SOURCE, [DATA_READY | 0x02 | lost].into());
            let data = [x, 0, 256].map(i16::to_le_bytes);
            ask(DATAX0, data.concat());
        }
        Mock::new(&expected)
    }

    /// What is seen after each sample.
    fn seen(i2c: &mut Mock) -> Vec<Navigation> {
        let sensitivity = Sensitivity::from_lsb_per_g(256.0).unwrap();
        let set = ParameterSet::uncalibrated(2, sensitivity);
        let corrector = Corrector::compile(&set, None).unwrap();
        let mut integrator = Integrator::three_axes(Config::new(PeriodNs(10_000_000)).unwrap());
        let mut seen = Vec::new();
        let goes_on = |navigation: &Navigation| {
            seen.push(*navigation);
            seen.len() < SAMPLES
        };
        run(i2c, &corrector, &mut integrator, goes_on).unwrap();
        seen
    }

    #[test]
    fn a_push_and_a_stop_on_the_bus_move_it_by_a_metre() {
        let mut i2c = bus(&[]);
        let navigation = seen(&mut i2c)[SAMPLES - 1];
        i2c.done();
        // 26 LSB are 0.996 m/s².
        assert!((navigation.position.to_m()[0] - 0.996).abs() < 1e-3);
        assert!(navigation.flags.is_valid());
    }

    #[test]
    fn a_sample_that_was_overwritten_during_a_move_flags_the_leg() {
        let mut i2c = bus(&[250]);
        let seen = seen(&mut i2c);
        i2c.done();
        let flagged = |navigation: &Navigation| navigation.flags.contains(Flags::GAP);
        assert_eq!(seen.iter().position(flagged), Some(250));
    }

    #[test]
    fn a_sensor_that_does_not_answer_is_an_error_of_the_bus() {
        let absent = ErrorKind::NoAcknowledge(NoAcknowledgeSource::Address);
        let first = Transaction::write(ADDRESS, SETUP[0].to_vec()).with_error(absent);
        let mut i2c = Mock::new(&[first]);
        let sensitivity = Sensitivity::from_lsb_per_g(256.0).unwrap();
        let set = ParameterSet::uncalibrated(2, sensitivity);
        let corrector = Corrector::compile(&set, None).unwrap();
        let mut integrator = Integrator::three_axes(Config::new(PeriodNs(10_000_000)).unwrap());
        let outcome = run(&mut i2c, &corrector, &mut integrator, |_| true);
        assert_eq!(outcome, Err(absent));
        i2c.done();
    }
}
