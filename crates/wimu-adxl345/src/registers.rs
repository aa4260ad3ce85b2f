//! Addresses and bits of the registers that are used (ADXL345 datasheet, revision G).

pub(crate) const DEVID: u8 = 0x00;
pub(crate) const OFSX: u8 = 0x1E;
pub(crate) const OFSY: u8 = 0x1F;
pub(crate) const OFSZ: u8 = 0x20;
pub(crate) const BW_RATE: u8 = 0x2C;
pub(crate) const POWER_CTL: u8 = 0x2D;
pub(crate) const INT_ENABLE: u8 = 0x2E;
pub(crate) const INT_MAP: u8 = 0x2F;
pub(crate) const INT_SOURCE: u8 = 0x30;
pub(crate) const DATA_FORMAT: u8 = 0x31;
pub(crate) const DATAX0: u8 = 0x32;
pub(crate) const FIFO_CTL: u8 = 0x38;
pub(crate) const FIFO_STATUS: u8 = 0x39;

pub(crate) const BW_RATE_LOW_POWER: u8 = 1 << 4;
pub(crate) const POWER_CTL_MEASURE: u8 = 1 << 3;
pub(crate) const DATA_FORMAT_FULL_RES: u8 = 1 << 3;
pub(crate) const DATA_FORMAT_JUSTIFY: u8 = 1 << 2;
pub(crate) const FIFO_CTL_STREAM: u8 = 0b10 << 6;
pub(crate) const FIFO_STATUS_ENTRIES: u8 = 0x3F;
