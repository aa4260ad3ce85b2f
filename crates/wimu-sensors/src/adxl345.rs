//! The ADXL345 (accelerometer; datasheet, revision G).

use wimu_link::hello::{Capabilities, Part, sensor};
use wimu_link::message::{Resolution, Settings};
use wimu_model::Counts;
use wimu_node::sensor::SensorFault;
use wimu_node::{FifoChip, FifoLevel, FifoRead, Range, Rate, Setup, Timer};

use crate::bus::{Bus, Registers, SpiRead};

const DEVID: u8 = 0x00;
const OFSX: u8 = 0x1E;
const OFSY: u8 = 0x1F;
const OFSZ: u8 = 0x20;
const BW_RATE: u8 = 0x2C;
const POWER_CTL: u8 = 0x2D;
const INT_ENABLE: u8 = 0x2E;
const INT_MAP: u8 = 0x2F;
const INT_SOURCE: u8 = 0x30;
const DATA_FORMAT: u8 = 0x31;
const DATAX0: u8 = 0x32;
const FIFO_CTL: u8 = 0x38;
const FIFO_STATUS: u8 = 0x39;

const IDENTITY: u8 = 0xE5;
const BW_RATE_LOW_POWER: u8 = 1 << 4;
const POWER_CTL_MEASURE: u8 = 1 << 3;
const DATA_FORMAT_FULL_RES: u8 = 1 << 3;
const DATA_FORMAT_LEFT: u8 = 1 << 2;
const FIFO_CTL_STREAM: u8 = 0b10 << 6;
const FIFO_STATUS_ENTRIES: u8 = 0x3F;
const WATERMARK: u8 = 1 << 1;
const OVERRUN: u8 = 1;

/// A sample is read in one burst. The delay is the minimum time between reading a sample and the next access to
/// the FIFO (datasheet, "Retrieving data from FIFO").
const SPI: SpiRead = SpiRead { multiple: 0x40, delay_ns: 5_000 };

/// Left-justified counts have this scale in both resolutions.
static RANGES: [Range; 4] = Range::four([0, 1, 2, 3], [16384.0, 8192.0, 4096.0, 2048.0]);

/// Rates that are whole numbers of Hz, up to the fastest on a bus of 400 kHz.
static RATES: [Rate; 6] = [
    Rate::new(25, 0x08, 40_000_000, true),
    Rate::new(50, 0x09, 20_000_000, true),
    Rate::new(100, 0x0A, 10_000_000, true),
    Rate::new(200, 0x0B, 5_000_000, true),
    Rate::new(400, 0x0C, 2_500_000, true),
    Rate::new(800, 0x0D, 1_250_000, false),
];

/// An ADXL345 on I²C, up to 400 kHz, or SPI, mode 3 up to 5 MHz, with its INT1 line.
#[derive(Debug)]
pub struct Adxl345<B> {
    registers: Registers<B>,
}

impl<B: Bus> Adxl345<B> {
    /// Address with the pin SDO low, as on most breakout boards; 0x1D with it high.
    pub const ADDRESS: u8 = 0x53;

    /// A chip on `bus`; nothing is sent yet.
    pub fn new(bus: B) -> Self {
        Self { registers: Registers { bus, spi: SPI } }
    }
}

/// Whether counts have 10 bits at every range, not 10 to 13.
fn has_ten_bits(resolution: Resolution) -> bool {
    resolution == Resolution::Normal
}

impl<B: Bus> FifoChip for Adxl345<B> {
    type Sample = Counts;
    const PART: Part = Part::new(sensor::ADXL345, "ADXL345");
    const CAPABILITIES: Capabilities = Capabilities::ACCELEROMETER;
    const RANGES: &'static [Range] = &RANGES;
    const RATES: &'static [Rate] = &RATES;
    const DEPTH: u16 = 32;
    /// On an I²C bus of 400 kHz, and on an SPI bus of 1 MHz.
    const TRANSFER_US: u64 = if B::I2C { 240 } else { 65 };

    /// The largest digit, left-justified.
    fn full_scale(settings: &Settings, range: u8) -> i32 {
        let bits = if has_ten_bits(settings.resolution) { 10 } else { 10 + range };
        (i16::MAX >> (16 - bits) << (16 - bits)).into()
    }

    async fn start(&mut self, setup: &Setup, _: &impl Timer) -> Result<(), SensorFault> {
        let full = if has_ten_bits(setup.resolution) { 0 } else { DATA_FORMAT_FULL_RES };
        let low_power = setup.resolution == Resolution::LowPower;
        let power = if low_power { BW_RATE_LOW_POWER } else { 0 };
        self.registers.check_identity(DEVID, IDENTITY).await?;
        let registers = [
            (POWER_CTL, 0),
            (OFSX, 0),
            (OFSY, 0),
            (OFSZ, 0),
            (DATA_FORMAT, full | DATA_FORMAT_LEFT | setup.range),
            (BW_RATE, setup.rate.code | power),
            (FIFO_CTL, 0),
            (FIFO_CTL, FIFO_CTL_STREAM | setup.watermark as u8),
            (INT_MAP, 0),
            (INT_ENABLE, WATERMARK),
            (POWER_CTL, POWER_CTL_MEASURE),
        ];
        self.registers.write_all(&registers).await
    }

    /// 32 in the FIFO, and one at the filter's output.
    async fn level(&mut self) -> Result<FifoLevel, SensorFault> {
        let samples = self.registers.read_one(FIFO_STATUS).await? & FIFO_STATUS_ENTRIES;
        let samples = u16::from(samples);
        let overrun =
            samples >= Self::DEPTH && self.registers.read_one(INT_SOURCE).await? & OVERRUN != 0;
        Ok(FifoLevel { samples, overrun })
    }

    /// Makes room, so that no sample is overwritten while the others are read.
    async fn repair(&mut self) -> Result<bool, SensorFault> {
        self.read(&mut [Counts::default(); 8]).await?;
        Ok(true)
    }

    /// Each burst removes a sample from the FIFO.
    async fn read(&mut self, samples: &mut [Counts]) -> Result<FifoRead, SensorFault> {
        for sample in &mut *samples {
            let mut bytes = [0; 6];
            self.registers.read(DATAX0, &mut bytes).await?;
            let [x0, x1, y0, y1, z0, z1] = bytes;
            *sample = Counts([[x0, x1], [y0, y1], [z0, z1]].map(i16::from_le_bytes));
        }
        Ok(FifoRead { count: samples.len(), lost: false })
    }
}
