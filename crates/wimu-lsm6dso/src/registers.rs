//! Addresses and bits of the registers that are used (LSM6DSO: DS12140 §8 and §9; LSM6DS3TR-C:
//! DS12110 §10).

pub(crate) const FUNC_CFG_ACCESS: u8 = 0x01;
pub(crate) const FIFO_CTRL1: u8 = 0x07;
pub(crate) const FIFO_CTRL2: u8 = 0x08;
pub(crate) const FIFO_CTRL3: u8 = 0x09;
pub(crate) const FIFO_CTRL4: u8 = 0x0A;
pub(crate) const INT1_CTRL: u8 = 0x0D;
pub(crate) const WHO_AM_I: u8 = 0x0F;
pub(crate) const CTRL1_XL: u8 = 0x10;
pub(crate) const CTRL2_G: u8 = 0x11;
pub(crate) const CTRL3_C: u8 = 0x12;
pub(crate) const CTRL4_C: u8 = 0x13;
pub(crate) const CTRL6_C: u8 = 0x15;
pub(crate) const CTRL7_G: u8 = 0x16;
pub(crate) const CTRL9_XL: u8 = 0x18;
pub(crate) const OUT_TEMP_L: u8 = 0x20;
pub(crate) const FIFO_STATUS1: u8 = 0x3A;
pub(crate) const FIFO_DATA_OUT_TAG: u8 = 0x78;

// Registers of the LSM6DS3TR-C that differ: those of the FIFO are one lower.
pub(crate) const TR_C_FIFO_CTRL1: u8 = 0x06;
pub(crate) const TR_C_FIFO_CTRL2: u8 = 0x07;
pub(crate) const TR_C_FIFO_CTRL3: u8 = 0x08;
pub(crate) const TR_C_FIFO_CTRL5: u8 = 0x0A;
pub(crate) const TR_C_FIFO_DATA_OUT: u8 = 0x3E;
pub(crate) const TR_C_STATUS2_EMPTY: u8 = 1 << 4;
/// Both sensors in the FIFO at its rate (DEC_FIFO_GYRO, DEC_FIFO_XL).
pub(crate) const TR_C_FIFO_CTRL3_BOTH: u8 = 0b001_001;

pub(crate) const FIFO_CTRL4_CONTINUOUS: u8 = 0b110;
pub(crate) const INT1_CTRL_FIFO_TH: u8 = 1 << 3;
pub(crate) const CTRL3_SW_RESET: u8 = 1;
pub(crate) const CTRL3_IF_INC: u8 = 1 << 2;
pub(crate) const CTRL3_BDU: u8 = 1 << 6;
pub(crate) const CTRL4_I2C_DISABLE: u8 = 1 << 2;
/// XL_HM_MODE: high-performance mode of the accelerometer is off.
pub(crate) const CTRL6_LOW_POWER: u8 = 1 << 4;
/// G_HM_MODE: high-performance mode of the gyroscope is off.
pub(crate) const CTRL7_LOW_POWER: u8 = 1 << 7;
/// The register's default value with I3C_disable set.
pub(crate) const CTRL9_I3C_DISABLE: u8 = 0xE0 | 1 << 1;
pub(crate) const FIFO_STATUS2_OVERRUN: u8 = 1 << 6;
pub(crate) const FIFO_STATUS2_OVERRUN_LATCHED: u8 = 1 << 3;
pub(crate) const FIFO_STATUS2_LEVEL: u8 = 0b11;
