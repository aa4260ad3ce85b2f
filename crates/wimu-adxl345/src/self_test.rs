use embedded_hal_async::delay::DelayNs;

use crate::registers::*;
use crate::{Adxl345, Bus, DataFormat, Error, Fifo, Interrupts, Justify, Range, Rate, Resolution};

/// ±16 *g* at full resolution: 256 LSB/*g*, the sensitivity that [`LIMITS`] are for.
const FORMAT: DataFormat =
    DataFormat { range: Range::G16, resolution: Resolution::Full, justify: Justify::Right };
/// Output data rate: the lowest one for which the datasheet's limits are valid.
const RATE: Rate = Rate::Hz100;
/// A sample period with a tolerance of 10 %, µs.
const PERIOD_US: u32 = 11_000;
/// Samples discarded after a change, while the output settles.
const SETTLING: u32 = 5;
/// Samples averaged: 0.1 s at 100 Hz.
const AVERAGED: i32 = 10;

/// Shift at 2.5 V: minimum and maximum, LSB at 256 LSB/*g*, positive on x and z, negative on y (ADXL345
/// datasheet, revision E, table 15).
const LIMITS: [(i32, i32); 3] = [(50, 540), (50, 540), (75, 875)];
/// Scale of the limits by supply voltage: mV, then percent for x and y, and for z (ADXL345 datasheet,
/// revision E, table 14).
const SCALES: [(i32, i32, i32); 4] =
    [(2000, 64, 80), (2500, 100, 100), (3300, 177, 147), (3600, 211, 169)];

/// Shift of each axis by the electrostatic force of the self-test.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct SelfTest {
    /// Mean with the force minus mean without it, x, y, z, at 256 LSB/*g*.
    pub shift: [i16; 3],
}

impl SelfTest {
    /// Which axes are within the datasheet's limits at a supply of `supply_mv`, clamped to 2000..=3600 mV.
    pub fn passed(&self, supply_mv: u16) -> [bool; 3] {
        let scales = scales(i32::from(supply_mv));
        let [x, y, z] = self.shift.map(i32::from);
        let within = |shift: i32, (least, most): (i32, i32), scale: i32| {
            (least * scale..=most * scale).contains(&(shift * 100))
        };
        let [of_x, of_y, of_z] = LIMITS;
        [within(x, of_x, scales.0), within(-y, of_y, scales.0), within(z, of_z, scales.1)]
    }
}

/// Percent for x and y, and for z, interpolated between the datasheet's rows.
fn scales(supply_mv: i32) -> (i32, i32) {
    let [first, .., last] = SCALES;
    let supply_mv = supply_mv.clamp(first.0, last.0);
    for pair in SCALES.windows(2) {
        if let [low, high] = pair
            && supply_mv <= high.0
        {
            let between = |from: i32, to: i32| {
                let rise = (to - from) * (supply_mv - low.0);
                from + rise.checked_div(high.0 - low.0).unwrap_or(0)
            };
            return (between(low.1, high.1), between(low.2, high.2));
        }
    }
    (last.1, last.2)
}

impl<B: Bus> Adxl345<B> {
    /// Measures the shift of each axis in 0.34 s. The chip must be at rest. Afterwards it is in standby, and
    /// format, rate and FIFO must be configured again.
    ///
    /// # Errors
    /// [`Error::NotAnswering`], [`Error::Bus`].
    pub async fn self_test(
        &mut self,
        delay: &mut impl DelayNs,
    ) -> Result<SelfTest, Error<B::Error>> {
        self.standby().await?;
        self.set_interrupts(Interrupts::NONE, Interrupts::NONE).await?;
        self.set_fifo(Fifo::Bypass).await?;
        self.set_rate(RATE, false).await?;
        self.set_data_format(FORMAT).await?;
        self.measure().await?;
        let without = self.mean(delay).await?;
        self.registers.write(DATA_FORMAT, FORMAT.register() | DATA_FORMAT_SELF_TEST).await?;
        let with = self.mean(delay).await?;
        self.set_data_format(FORMAT).await?;
        self.standby().await?;
        let mut shift = [0; 3];
        for ((shift, with), without) in shift.iter_mut().zip(with).zip(without) {
            // 13-bit samples: it fits.
            *shift = (with - without) as i16;
        }
        Ok(SelfTest { shift })
    }

    async fn mean(&mut self, delay: &mut impl DelayNs) -> Result<[i32; 3], Error<B::Error>> {
        delay.delay_us(SETTLING * PERIOD_US).await;
        let mut sum = [0; 3];
        for _ in 0..AVERAGED {
            delay.delay_us(PERIOD_US).await;
            for (sum, axis) in sum.iter_mut().zip(self.sample().await?) {
                *sum += i32::from(axis);
            }
        }
        Ok(sum.map(|sum| sum / AVERAGED))
    }
}
