/// I²C address of the chip, by the level of its pin AD0.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Address {
    /// The pin is low or open, as on GY-521 modules: 0x68.
    #[default]
    Low = 0x68,
    /// The pin is high: 0x69.
    High = 0x69,
}

impl From<Address> for u8 {
    fn from(address: Address) -> u8 {
        address as u8
    }
}

/// Register layout of a chip, from WHO_AM_I.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Model {
    /// One filter for both sensors, FIFO of 1024 bytes: MPU-6050.
    Mpu6050,
    /// A filter of its own for the accelerometer, FIFO of 512 bytes: MPU-6500 and its successors.
    Mpu6500,
}

impl Model {
    /// The layout of a chip with this WHO_AM_I; `None` for an unknown one.
    pub const fn of(who_am_i: u8) -> Option<Self> {
        match who_am_i {
            0x68 => Some(Self::Mpu6050),
            0x70..=0x75 | 0x98 => Some(Self::Mpu6500),
            _ => None,
        }
    }

    /// Samples that the FIFO holds.
    pub const fn depth(self) -> u16 {
        match self {
            Self::Mpu6050 => 1024 / 12,
            Self::Mpu6500 => 512 / 12,
        }
    }

    /// Temperature of a count, 1/100 °C (register maps, TEMP_OUT).
    pub fn centi_celsius(self, counts: i16) -> i16 {
        let counts = i32::from(counts);
        let centi = match self {
            // 340 LSB/K, 0 at 36.53 °C.
            Self::Mpu6050 => 3653 + counts * 10 / 34,
            // 333.87 LSB/K, 0 at 21 °C.
            Self::Mpu6500 => 2100 + counts * 10_000 / 33_387,
        };
        centi.clamp(i16::MIN.into(), i16::MAX.into()) as i16
    }
}

/// Full-scale range of the accelerometer, 16,384 LSB/*g* at ±2 *g*; tolerance ±3 %.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum AccelerationRange {
    /// ±2 *g*.
    G2,
    /// ±4 *g*.
    G4,
    /// ±8 *g*.
    G8,
    /// ±16 *g*.
    G16,
}

impl AccelerationRange {
    /// Nominal sensitivity, LSB/*g*: 16,384 to 2048.
    pub const fn lsb_per_g(self) -> u16 {
        16_384 >> self as u8
    }
}

/// Full-scale range of the gyroscope, 32,768 LSB; tolerance ±3 %.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum AngularRateRange {
    /// ±250 °/s.
    Dps250,
    /// ±500 °/s.
    Dps500,
    /// ±1000 °/s.
    Dps1000,
    /// ±2000 °/s.
    Dps2000,
}

impl AngularRateRange {
    /// Full scale, °/s.
    pub const fn dps(self) -> u16 {
        250 << self as u8
    }
}

/// All settings of a measurement.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Setup {
    /// Full scale of the accelerometer.
    pub acceleration: AccelerationRange,
    /// Full scale of the gyroscope.
    pub angular_rate: AngularRateRange,
    /// SMPLRT_DIV: the rate is 1 kHz / (1 + divider). The low-pass filter's bandwidth is below half the rate down to
    /// 50 Hz: 184, 94, 44 or 21 Hz.
    pub divider: u8,
}

impl Setup {
    /// Nominal sample period, ns.
    pub const fn period_ns(&self) -> u32 {
        1_000_000 * (self.divider as u32 + 1)
    }

    /// DLPF_CFG.
    pub(crate) const fn filter(&self) -> u8 {
        match self.divider {
            0..=1 => 1,
            2..=4 => 2,
            5..=9 => 3,
            _ => 4,
        }
    }
}
