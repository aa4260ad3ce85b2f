use crate::registers::*;

/// Full-scale range.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Range {
    /// ±2 *g*.
    G2,
    /// ±4 *g*.
    G4,
    /// ±8 *g*.
    G8,
    /// ±16 *g*.
    G16,
}

impl Range {
    /// Its code: 0 for ±2 *g* to 3 for ±16 *g*.
    const fn code(self) -> u8 {
        self as u8
    }
}

/// Resolution of the output.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Resolution {
    /// 10 bits over the range: 256 LSB/*g* at ±2 *g* down to 32 LSB/*g* at ±16 *g*.
    TenBits,
    /// 256 LSB/*g* at every range: 10 bits at ±2 *g* up to 13 bits at ±16 *g* (FULL_RES).
    Full,
}

/// Justification of a sample in its 16 bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Justify {
    /// At the lower end, with the sign extended.
    Right,
    /// At the upper end, with zeros below: full scale is then ±2¹⁵ at every setting.
    Left,
}

/// Format of a sample: register DATA_FORMAT.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct DataFormat {
    /// Full scale.
    pub range: Range,
    /// Resolution.
    pub resolution: Resolution,
    /// Justification in 16 bits.
    pub justify: Justify,
}

impl DataFormat {
    /// Bits of a sample that carry data: 10..=13.
    pub const fn bits(&self) -> u8 {
        match self.resolution {
            Resolution::TenBits => 10,
            Resolution::Full => 10 + self.range.code(),
        }
    }

    /// Nominal sensitivity, LSB/*g*; tolerance ±10 %.
    pub const fn lsb_per_g(&self) -> u16 {
        let right = 256 >> (self.range.code() + 10 - self.bits());
        match self.justify {
            Justify::Right => right,
            Justify::Left => right << (16 - self.bits()),
        }
    }

    pub(crate) const fn register(&self) -> u8 {
        let full = match self.resolution {
            Resolution::TenBits => 0,
            Resolution::Full => DATA_FORMAT_FULL_RES,
        };
        let left = match self.justify {
            Justify::Right => 0,
            Justify::Left => DATA_FORMAT_JUSTIFY,
        };
        full | left | self.range.code()
    }
}

/// Output data rate; the bandwidth is half of it. The actual rate deviates from the nominal one by several
/// percent; measure it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Rate {
    /// 6.25 Hz.
    Hz6_25,
    /// 12.5 Hz.
    Hz12_5,
    /// 25 Hz.
    Hz25,
    /// 50 Hz.
    Hz50,
    /// 100 Hz, the rate after power-on.
    Hz100,
    /// 200 Hz.
    Hz200,
    /// 400 Hz.
    Hz400,
    /// 800 Hz.
    Hz800,
    /// 1600 Hz: a sample's lowest bit is always 0 at full resolution and at ±2 *g*.
    Hz1600,
    /// 3200 Hz, likewise.
    Hz3200,
}

impl Rate {
    /// All of them, slow to fast.
    pub const ALL: [Self; 10] = [
        Self::Hz6_25,
        Self::Hz12_5,
        Self::Hz25,
        Self::Hz50,
        Self::Hz100,
        Self::Hz200,
        Self::Hz400,
        Self::Hz800,
        Self::Hz1600,
        Self::Hz3200,
    ];

    /// Register BW_RATE.
    pub(crate) fn register(self, low_power: bool) -> u8 {
        self.code() | if low_power { BW_RATE_LOW_POWER } else { 0 }
    }

    /// Its code in BW_RATE: 0x06..=0x0F.
    pub(crate) const fn code(self) -> u8 {
        0x06 + self as u8
    }

    /// Nominal time between two samples, ns, exactly.
    pub const fn period_ns(self) -> u32 {
        312_500 << (0x0F - self.code())
    }

    /// Whether low-power mode saves power at this rate: 12.5 to 400 Hz.
    pub const fn has_low_power(self) -> bool {
        matches!(self.code(), 0x07..=0x0C)
    }
}

/// Mode of the FIFO.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Fifo {
    /// No FIFO: the data registers hold the newest sample.
    Bypass,
    /// Holds the newest 32 samples; a new sample overwrites the oldest in a full FIFO and sets
    /// [`Interrupts::OVERRUN`].
    Stream {
        /// [`Interrupts::WATERMARK`] is active from this number of samples on, 1..=31.
        watermark: u8,
    },
}

impl Fifo {
    pub(crate) fn register(self) -> u8 {
        match self {
            Self::Bypass => 0,
            Self::Stream { watermark } => FIFO_CTL_STREAM | watermark.clamp(1, 31),
        }
    }
}

/// A set of the chip's interrupts: the bits of INT_ENABLE, INT_MAP and INT_SOURCE.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Interrupts(pub u8);

impl Interrupts {
    /// None of them.
    pub const NONE: Self = Self(0);
    /// A new sample is available.
    pub const DATA_READY: Self = Self(1 << 7);
    /// The FIFO level has reached the watermark.
    pub const WATERMARK: Self = Self(1 << 1);
    /// A sample was lost; cleared by reading data.
    pub const OVERRUN: Self = Self(1);

    /// Both sets.
    #[must_use]
    pub const fn with(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    /// Whether all of `other` are in it.
    pub const fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }
}

/// Configuration of the chip.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Setup {
    /// Format of a sample.
    pub format: DataFormat,
    /// Output data rate.
    pub rate: Rate,
    /// Low-power mode, with more noise. It has an effect only where [`Rate::has_low_power`].
    pub low_power: bool,
    /// Mode of the FIFO.
    pub fifo: Fifo,
    /// Interrupts enabled on the pins, active high.
    pub interrupts: Interrupts,
    /// Those of them on INT2 instead of INT1.
    pub on_int2: Interrupts,
}
