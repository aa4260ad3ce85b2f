//! The ADXL345.

use embassy_futures::block_on;
use embedded_hal_async::i2c::ErrorKind;
use embedded_hal_mock::eh1::i2c::{Mock, Transaction};
use embedded_hal_mock::eh1::spi::{Mock as SpiMock, Transaction as SpiTransaction};
use wimu_link::message::Resolution::{self, High, LowPower, Normal};
use wimu_model::Counts;
use wimu_node::sensor::SensorFault;
use wimu_node::{FifoChip, FifoLevel, FifoSensor, InertialSensor};
use wimu_sensors::{Adxl345, I2cBus, SpiBus};

use crate::bench::{Clock, Line, on_i2c, plan};

type Chip = Adxl345<I2cBus<Mock>>;
const AT: u8 = Chip::ADDRESS;

fn write(register: u8, value: u8) -> Transaction {
    Transaction::write(AT, vec![register, value])
}

fn read(register: u8, values: &[u8]) -> Transaction {
    Transaction::write_read(AT, vec![register], values.to_vec())
}

/// What a start writes, with these contents of DATA_FORMAT, BW_RATE and FIFO_CTL.
fn started(format: u8, rate: u8, fifo: u8) -> [Transaction; 12] {
    [
        read(0x00, &[0xE5]),
        write(0x2D, 0x00),
        write(0x1E, 0x00),
        write(0x1F, 0x00),
        write(0x20, 0x00),
        write(0x31, format),
        write(0x2C, rate),
        write(0x38, 0x00),
        write(0x38, fifo),
        write(0x2F, 0x00),
        write(0x2E, 0x02),
        write(0x2D, 0x08),
    ]
}

fn configured(
    rate_hz: u16,
    range_g: u8,
    resolution: Resolution,
    expected: &[Transaction],
) -> Result<(), SensorFault> {
    let plan = plan::<Chip>(rate_hz, range_g, resolution);
    on_i2c(AT, expected, async |bus| {
        let line = Line(Default::default());
        FifoSensor::new(Adxl345::new(bus), line, Clock::default()).configure(&plan).await
    })
}

#[test]
fn a_start_sets_everything_in_standby_and_measures_last() {
    for (hz, g, resolution, format, rate, fifo, full_scale) in [
        (25, 2, High, 0x0C, 0x08, 0x81, 0x7FC0),
        (50, 4, High, 0x0D, 0x09, 0x82, 0x7FE0),
        (100, 8, High, 0x0E, 0x0A, 0x84, 0x7FF0),
        (200, 16, High, 0x0F, 0x0B, 0x88, 0x7FF8),
        (400, 16, Normal, 0x07, 0x0C, 0x90, 0x7FC0),
        (400, 2, LowPower, 0x0C, 0x1C, 0x90, 0x7FC0),
        (800, 2, Normal, 0x04, 0x0D, 0x90, 0x7FC0),
    ] {
        let plan = plan::<Chip>(hz, g, resolution).sensor;
        assert_eq!(plan.full_scale, full_scale, "±{g} g, {resolution}");
        let lsb_per_g = plan.accelerometer.sensitivity().lsb_per_g();
        assert_eq!(
            (lsb_per_g, plan.period.0),
            (32768.0 / f64::from(g), 1_000_000_000 / u32::from(hz))
        );
        assert_eq!(configured(hz, g, resolution, &started(format, rate, fifo)), Ok(()));
    }
    // Nobody answers half-way: nothing more is written, and it does not measure.
    let mut failing = started(0x0F, 0x0A, 0x84)[..6].to_vec();
    failing[5] = write(0x31, 0x0F).with_error(ErrorKind::Bus);
    assert_eq!(configured(100, 16, High, &failing), Err(SensorFault::Transfer));
    let wrong = SensorFault::WrongIdentity { expected: 0xE5, found: 0x33 };
    assert_eq!(configured(100, 16, High, &[read(0x00, &[0x33])]), Err(wrong));
}

#[test]
fn a_sample_is_one_burst_low_byte_first_and_the_level_has_no_trigger_bit() {
    let burst = [0x34, 0x12, 0xFF, 0xFF, 0x00, 0x80];
    let expected =
        [read(0x39, &[0x80 | 1]), read(0x32, &burst), read(0x39, &[33]), read(0x30, &[0x83])];
    on_i2c(AT, &expected, async |bus| {
        let mut chip = Adxl345::new(bus);
        let level = |samples, overrun| Ok(FifoLevel { samples, overrun });
        assert_eq!(chip.level().await, level(1, false));
        let mut sample = [Counts::default()];
        chip.read(&mut sample).await.expect("the bus works");
        assert_eq!(sample, [Counts([0x1234, -1, i16::MIN])]);
        assert_eq!(chip.level().await, level(33, true));
    });
}

#[test]
fn on_spi_a_read_has_its_bits_and_the_fifo_its_delay() {
    let read = |command: u8, values: &[u8]| {
        vec![
            SpiTransaction::transaction_start(),
            SpiTransaction::delay(5_000),
            SpiTransaction::write_vec(vec![command]),
            SpiTransaction::read_vec(values.to_vec()),
            SpiTransaction::transaction_end(),
        ]
    };
    let expected =
        [read(0xB9, &[1]), read(0xF2, &[1, 0, 2, 0, 0xFF, 0xFF]), read(0x80, &[0xFF])].concat();
    let mut mock = SpiMock::new(&expected);
    let mut chip = Adxl345::new(SpiBus(mock.clone()));
    block_on(async {
        assert_eq!(chip.level().await, Ok(FifoLevel { samples: 1, overrun: false }));
        let mut sample = [Counts::default()];
        chip.read(&mut sample).await.expect("the bus works");
        assert_eq!(sample, [Counts([1, 2, -1])]);
        let mut sensor = FifoSensor::new(chip, Line(Default::default()), Clock::default());
        let absent = sensor.configure(&plan::<Chip>(100, 2, High)).await;
        assert_eq!(absent, Err(SensorFault::NotAnswering));
    });
    mock.done();
}
