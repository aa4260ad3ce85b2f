/// Full-scale range of the accelerometer. Sensitivities are typical values (DS12140 §4.1, Table 2);
/// the part's own is within ±1 %.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum AccelerationRange {
    /// ±2 *g*, 0.061 m*g*/LSB.
    G2,
    /// ±4 *g*, 0.122 m*g*/LSB.
    G4,
    /// ±8 *g*, 0.244 m*g*/LSB.
    G8,
    /// ±16 *g*, 0.488 m*g*/LSB.
    G16,
}

impl AccelerationRange {
    /// Nominal size of a count, µ*g*/LSB: 61 to 488.
    pub const fn ug_per_lsb(self) -> u16 {
        61 << self as u8
    }

    /// FS_XL of CTRL1_XL.
    pub(crate) const fn bits(self) -> u8 {
        let code = match self {
            Self::G2 => 0b00,
            Self::G16 => 0b01,
            Self::G4 => 0b10,
            Self::G8 => 0b11,
        };
        code << 2
    }
}

/// Full-scale range of the gyroscope. Sensitivities are typical values (DS12140 §4.1, Table 2); the
/// part's own is within ±1 %.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum AngularRateRange {
    /// ±125 °/s, 4.375 m°/s/LSB.
    Dps125,
    /// ±250 °/s, 8.75 m°/s/LSB.
    Dps250,
    /// ±500 °/s, 17.5 m°/s/LSB.
    Dps500,
    /// ±1000 °/s, 35 m°/s/LSB.
    Dps1000,
    /// ±2000 °/s, 70 m°/s/LSB.
    Dps2000,
}

impl AngularRateRange {
    /// Nominal size of a count, µ°/s/LSB: 4375 to 70 000.
    pub const fn udps_per_lsb(self) -> u32 {
        4_375 << self as u8
    }

    /// FS_G and FS_125 of CTRL2_G.
    pub(crate) const fn bits(self) -> u8 {
        match self {
            Self::Dps125 => 1 << 1,
            Self::Dps250 => 0b00 << 2,
            Self::Dps500 => 0b01 << 2,
            Self::Dps1000 => 0b10 << 2,
            Self::Dps2000 => 0b11 << 2,
        }
    }
}

/// Output data rate of both sensors, named as in the datasheet. The chip divides one oscillator by
/// powers of two, so that [`period_ns`](Self::period_ns) is exact where the names are rounded. A
/// sample takes 140 clocks on I²C: a bus of 400 kHz carries up to 1.666 kHz.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Rate {
    /// 12.5 Hz (13.02 Hz by the datasheet's formula for the effective rate).
    Hz12_5,
    /// 26 Hz.
    Hz26,
    /// 52 Hz.
    Hz52,
    /// 104 Hz.
    Hz104,
    /// 208 Hz.
    Hz208,
    /// 416 Hz.
    Hz416,
    /// 833 Hz.
    Hz833,
    /// 1.666 kHz.
    Hz1666,
    /// 3.332 kHz.
    Hz3332,
    /// 6.664 kHz.
    Hz6664,
}

impl Rate {
    /// All of them, slow to fast.
    pub const ALL: [Self; 10] = [
        Self::Hz12_5,
        Self::Hz26,
        Self::Hz52,
        Self::Hz104,
        Self::Hz208,
        Self::Hz416,
        Self::Hz833,
        Self::Hz1666,
        Self::Hz3332,
        Self::Hz6664,
    ];

    /// Its code in ODR_XL, ODR_G, BDR_XL and BDR_GY: 1..=10.
    pub(crate) const fn code(self) -> u8 {
        1 + self as u8
    }

    /// Nominal time between two samples, ns: 150 µs (6.667 kHz / 1) times a power of two
    /// (DS12140 §9, INTERNAL_FREQ_FINE).
    pub const fn period_ns(self) -> u32 {
        150_000 << (10 - self.code())
    }

    /// Whether [`Power::Low`] saves power at this rate: 12.5 to 208 Hz.
    pub const fn has_low_power(self) -> bool {
        self.code() <= 5
    }
}

/// Power mode of both sensors (DS12140 §6.2).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Power {
    /// High-performance mode: 70 µ*g*/√Hz at ±2 *g* and 3.8 m°/s/√Hz.
    #[default]
    High,
    /// Low-power mode up to 52 Hz, normal mode at 104 and 208 Hz: more noise. Faster rates always
    /// run in high-performance mode, see [`Rate::has_low_power`].
    Low,
}

/// All settings of a measurement.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Setup {
    /// Full scale of the accelerometer.
    pub acceleration: AccelerationRange,
    /// Full scale of the gyroscope.
    pub angular_rate: AngularRateRange,
    /// Rate of both sensors.
    pub rate: Rate,
    /// Power mode of both sensors.
    pub power: Power,
    /// INT1 is high while the FIFO holds at least this number of samples; 1..=255, 0 counts as 1.
    pub watermark: u8,
}
