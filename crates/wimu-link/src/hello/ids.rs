//! Numbers and names in a [`Hello`](super::Hello).

use core::fmt;

pub(super) const NAME_LENGTH: usize = 15;

/// Numbers of boards in [`Hello::board`](super::Hello::board). Numbers are never reused; 0 is any other; 6 was an nRF52840 DK.
pub mod board {
    /// The simulated board.
    pub const SIMULATED: u16 = 1;
    /// BBC micro:bit v2.
    pub const MICROBIT_V2: u16 = 2;
    /// Raspberry Pi Pico or Pico 2.
    pub const PICO: u16 = 3;
    /// QEMU's mps2-an386.
    pub const QEMU_MPS2: u16 = 4;
    /// STM32F411.
    pub const STM32F411: u16 = 5;
    /// Seeed XIAO nRF52840 Sense.
    pub const XIAO_NRF52840: u16 = 7;
    /// ESP32-C3.
    pub const ESP32C3: u16 = 8;
}

/// Numbers of sensors in [`Hello::sensor`](super::Hello::sensor). Numbers are never reused; 0 is any other.
pub mod sensor {
    /// ST LSM303AGR.
    pub const LSM303AGR: u16 = 1;
    /// Analog Devices ADXL345.
    pub const ADXL345: u16 = 2;
    /// The samples of a recording.
    pub const REPLAY: u16 = 3;
    /// ST LSM6DSO.
    pub const LSM6DSO: u16 = 4;
    /// ST LSM6DS3TR-C.
    pub const LSM6DS3TR_C: u16 = 5;
    /// InvenSense MPU-6050, MPU-6500 and MPU-9250, and parts that are sold as such.
    pub const MPU6050: u16 = 6;
    /// TDK ICM-42688-P.
    pub const ICM42688: u16 = 7;

    /// The sensor's name.
    pub const fn name(number: u16) -> &'static str {
        match number {
            LSM303AGR => "LSM303AGR",
            ADXL345 => "ADXL345",
            REPLAY => "of a recording",
            LSM6DSO => "LSM6DSO",
            LSM6DS3TR_C => "LSM6DS3TR-C",
            MPU6050 => "MPU-6050",
            ICM42688 => "ICM-42688",
            _ => "unknown",
        }
    }

    /// Whether the number identifies a model of accelerometer, with its ranges, axes and sensitivities.
    pub const fn is_one_model(number: u16) -> bool {
        number != 0 && number != REPLAY
    }
}

/// An enum that travels as a number of one byte. A number that this crate does not know is kept.
macro_rules! numbered {
    (
        $(#[$attribute:meta])*
        $name:ident, other: $other:literal {
            $($(#[$doc:meta])* $variant:ident = $number:literal, $text:literal;)+
        }
    ) => {
        $(#[$attribute])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        #[cfg_attr(feature = "defmt", derive(defmt::Format))]
        pub enum $name {
            $($(#[$doc])* $variant,)+
            /// A number that this crate does not know.
            Other(u8),
        }

        impl $name {
            /// Its number on the wire.
            pub const fn number(self) -> u8 {
                match self {
                    $(Self::$variant => $number,)+
                    Self::Other(number) => number,
                }
            }

            pub(super) const fn from_number(number: u8) -> Self {
                match number {
                    $($number => Self::$variant,)+
                    other => Self::Other(other),
                }
            }
        }

        impl fmt::Display for $name {
            fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
                match self {
                    $(Self::$variant => out.write_str($text),)+
                    Self::Other(number) => write!(out, concat!($other, " {}"), number),
                }
            }
        }
    };
}

numbered! {
    /// The role of a link. An unknown role has no more rights than a radio.
    LinkRole, other: "role" {
        /// A cable, number 1: using it takes physical access to the device.
        Cable = 1, "cable";
        /// A radio, number 2: anyone in range can use it.
        Wireless = 2, "wireless";
    }
}

numbered! {
    /// Who may write on a link.
    WriteAccess, other: "access" {
        /// Number 0: anyone, without a signature.
        Open = 0, "open";
        /// Number 1: only requests signed with the device's key; no writes while the device has no key.
        Key = 1, "key";
        /// Number 2: no writes. If the stored key is readable, a new key signed with it is still accepted
        /// over the cable.
        Locked = 2, "locked";
    }
}

numbered! {
    /// Why a device last started.
    ResetReason, other: "reason" {
        /// The device does not know: number 0.
        Unknown = 0, "unknown";
        /// Power-on: number 1.
        PowerOn = 1, "power on";
        /// The reset pin or button: number 2.
        Pin = 2, "reset pin";
        /// A watchdog: number 3.
        Watchdog = 3, "watchdog";
        /// A reset by the firmware: number 4.
        Software = 4, "software";
        /// A low supply voltage: number 5.
        BrownOut = 5, "brown-out";
        /// A processor fault or a panic: number 6.
        Fault = 6, "fault";
    }
}

/// The capabilities of a device, a set of bits; unknown bits are kept.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Capabilities(pub u32);

impl Capabilities {
    /// An accelerometer.
    pub const ACCELEROMETER: Self = Self(1);
    /// A magnetometer.
    pub const MAGNETOMETER: Self = Self(1 << 1);
    /// A thermometer.
    pub const TEMPERATURE: Self = Self(1 << 2);
    /// Sample times are those of the sensor's data-ready signal, not of the read.
    pub const DATA_READY: Self = Self(1 << 3);
    /// Parameters and settings survive a restart.
    pub const STORE: Self = Self(1 << 4);
    /// A gyroscope.
    pub const GYROSCOPE: Self = Self(1 << 5);
    /// The following functions are listed. Firmware that does not list them has all of them:
    /// [`offers`](Self::offers).
    pub const LISTED: Self = Self(1 << 6);
    /// Accepts parameters and corrects samples.
    pub const CORRECTION: Self = Self(1 << 7);
    /// Computes velocity, position and attitude.
    pub const NAVIGATION: Self = Self(1 << 8);
    /// Sets the heading from a calibrated magnetometer.
    pub const HEADING: Self = Self(1 << 9);
    /// Accepts a key and signed requests.
    pub const AUTHENTICATION: Self = Self(1 << 10);
    /// The rate of its wireless link's serial line can be set.
    pub const LINE_RATES: Self = Self(1 << 11);
    /// Samples are read at intervals of the device's timer: their times vary by half a sample period of the sensor.
    pub const POLLED: Self = Self(1 << 12);

    /// Both sets.
    #[must_use]
    pub const fn with(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    /// This set less all of `other`.
    #[must_use]
    pub const fn without(self, other: Self) -> Self {
        Self(self.0 & !other.0)
    }

    /// Whether the device has these functions, or does not list any.
    pub const fn offers(self, functions: Self) -> bool {
        !self.contains(Self::LISTED) || self.contains(functions)
    }

    /// Whether all of `other` are there.
    pub const fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }
}

/// A short name: 0 to 15 characters of printable ASCII.
#[derive(Clone, Copy, Default, PartialEq, Eq, Hash)]
pub struct Name {
    pub(super) length: u8,
    pub(super) bytes: [u8; NAME_LENGTH],
}

impl Name {
    /// The first 15 bytes of `text`; what is not printable ASCII becomes `?`.
    pub const fn new(text: &str) -> Self {
        Self::from_bytes(text.as_bytes())
    }

    /// The first 15 of `text`; what is not printable ASCII becomes `?`.
    pub const fn from_bytes(text: &[u8]) -> Self {
        let mut bytes = [0; NAME_LENGTH];
        let mut rest = text;
        let mut length = 0;
        while let Some((&byte, tail)) = rest.split_first()
            && length < NAME_LENGTH
        {
            bytes[length] = if byte == b' ' || byte.is_ascii_graphic() { byte } else { b'?' };
            length += 1;
            rest = tail;
        }
        Self { length: length as u8, bytes }
    }

    /// The name.
    pub fn as_str(&self) -> &str {
        core::str::from_utf8(self.as_bytes()).unwrap_or_default()
    }

    /// The name's characters.
    pub fn as_bytes(&self) -> &[u8] {
        let length = usize::from(self.length);
        self.bytes.get(..length).unwrap_or_default()
    }
}

impl fmt::Debug for Name {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Debug::fmt(self.as_str(), out)
    }
}

impl fmt::Display for Name {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.pad(self.as_str())
    }
}

#[cfg(feature = "defmt")]
impl defmt::Format for Name {
    fn format(&self, out: defmt::Formatter<'_>) {
        defmt::write!(out, "{=str}", self.as_str());
    }
}

/// Where the firmware stopped.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Fault {
    /// Address of the instruction.
    pub address: u32,
    /// Its kind.
    pub kind: Name,
}

impl Fault {
    /// A panic at `address` in a function that was called at `caller`. The caller is written in hexadecimal after the
    /// kind, as the wire has one address: `panic 0001a2b4`.
    pub fn panic([address, caller]: [u32; 2]) -> Self {
        let mut kind = *b"panic 00000000";
        for (place, digit) in kind.iter_mut().rev().zip(0..8) {
            let value = (caller >> (4 * digit) & 0xF) as u8;
            *place = if value < 10 { b'0' + value } else { b'a' + value - 10 };
        }
        Self { address, kind: Name::from_bytes(&kind) }
    }

    /// A fault of the processor at the instruction at `address`.
    pub const fn processor(kind: &str, address: u32) -> Self {
        Self { address, kind: Name::new(kind) }
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "{} at {:#010x}", self.kind, self.address)
    }
}

/// A part of a device: its number and its name.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Part {
    /// A number of [`board`] or [`sensor`]; 0 without a number. May be unknown to this crate.
    pub number: u16,
    /// Its name for display.
    pub name: Name,
}

impl Part {
    /// A part with a number and a name.
    pub const fn new(number: u16, name: &str) -> Self {
        Self { number, name: Name::new(name) }
    }
}
