//! The registers of the LSM6DSO.

use embassy_futures::block_on;
use embedded_hal_async::i2c::{ErrorKind, NoAcknowledgeSource};
use embedded_hal_mock::eh1::i2c::{Mock, Transaction};
use embedded_hal_mock::eh1::spi;
use wimu_link::message::Resolution::{self, High, LowPower};
use wimu_model::CentiCelsius;
use wimu_node::sensor::SensorFault;
use wimu_node::{FifoChip, FifoLevel, FifoSensor, InertialSensor};
use wimu_sensors::{I2cBus, Lsm6dso, SpiBus};

use crate::bench::{Clock, Line, on_i2c, plan};

pub type Chip = Lsm6dso<I2cBus<Mock>>;
const AT: u8 = Chip::ADDRESS;

pub fn write(register: u8, value: u8) -> Transaction {
    Transaction::write(AT, vec![register, value])
}

pub fn read(register: u8, values: &[u8]) -> Transaction {
    Transaction::write_read(AT, vec![register], values.to_vec())
}

/// Runs `use_it` on a chip whose bus sees exactly `expected`.
pub fn on_bus<R>(expected: &[Transaction], use_it: impl AsyncFnOnce(&mut Chip) -> R) -> R {
    on_i2c(AT, expected, async |bus| use_it(&mut Lsm6dso::new(bus)).await)
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
        FifoSensor::new(Chip::new(bus), line, Clock::default()).configure(&plan).await
    })
}

/// What a start writes after the reset: watermark, words; rates of the FIFO; low power of both; CTRL1_XL, CTRL2_G.
fn started([watermark, rates, low_xl, low_g, xl, g]: [u8; 6]) -> Vec<(u8, u8)> {
    vec![
        (0x07, watermark),
        (0x08, 0x00),
        (0x09, rates),
        (0x15, low_xl),
        (0x16, low_g),
        (0x0D, 0x08),
        (0x10, xl),
        (0x11, g),
        (0x0A, 0x06),
    ]
}

#[test]
fn a_start_resets_the_chip_and_writes_every_setting() {
    for (hz, g, resolution, values) in [
        (13, 2, High, [2, 0x11, 0, 0, 0x10, 0x1C]),
        (52, 16, LowPower, [4, 0x33, 0x10, 0x80, 0x34, 0x3C]),
        (208, 4, High, [16, 0x55, 0, 0, 0x58, 0x5C]),
        (1666, 8, High, [32, 0x88, 0, 0, 0x8C, 0x8C]),
    ] {
        let mut expected = vec![
            read(0x0F, &[0x6C]),
            write(0x01, 0x00),
            write(0x12, 0x05),
            read(0x12, &[0x05]),
            read(0x12, &[0x04]),
            write(0x18, 0xE2),
            write(0x12, 0x44),
        ];
        expected
            .extend(started(values).into_iter().map(|(register, value)| write(register, value)));
        assert_eq!(configured(hz, g, resolution, &expected), Ok(()), "{hz} Hz");
    }
}

#[test]
fn what_is_wrong_at_the_start_is_named() {
    let nack = ErrorKind::NoAcknowledge(NoAcknowledgeSource::Address);
    let nack_of_data = ErrorKind::NoAcknowledge(NoAcknowledgeSource::Data);
    let identity = || read(0x0F, &[0x6C]);
    let mut resets = vec![identity(), write(0x01, 0x00), write(0x12, 0x05)];
    resets.extend((0..100).map(|_| read(0x12, &[0x05])));
    for (expected, fault) in [
        (vec![identity().with_error(nack)], SensorFault::NotAnswering),
        (vec![identity().with_error(nack_of_data)], SensorFault::Transfer),
        (vec![read(0x0F, &[0xFF])], SensorFault::NotAnswering),
        (vec![read(0x0F, &[0x6B])], SensorFault::WrongIdentity { expected: 0x6C, found: 0x6B }),
        (resets, SensorFault::Transfer),
    ] {
        assert_eq!(configured(104, 2, High, &expected), Err(fault));
    }
}

#[test]
fn spi_reads_set_bit_7_and_the_i2c_interface_is_turned_off() {
    use spi::Transaction as T;
    let read = |register: u8, values: &[u8]| {
        [
            T::transaction_start(),
            T::write_vec(vec![register | 0x80]),
            T::read_vec(values.to_vec()),
            T::transaction_end(),
        ]
    };
    let write = |register: u8, value: u8| {
        [T::transaction_start(), T::write_vec(vec![register, value]), T::transaction_end()]
    };
    let mut expected = Vec::new();
    expected.extend(read(0x0F, &[0x6C]));
    expected.extend(write(0x01, 0x00));
    expected.extend(write(0x12, 0x05));
    expected.extend(read(0x12, &[0x04]));
    for (register, value) in [(0x18, 0xE2), (0x12, 0x44), (0x13, 0x04)] {
        expected.extend(write(register, value));
    }
    for (register, value) in started([4, 0x33, 0x10, 0x80, 0x34, 0x3C]) {
        expected.extend(write(register, value));
    }
    let mut mock = spi::Mock::new(&expected);
    let chip = Lsm6dso::<_>::new(SpiBus(mock.clone()));
    let mut sensor = FifoSensor::new(chip, Line(Default::default()), Clock::default());
    assert_eq!(block_on(sensor.configure(&plan::<Chip>(52, 16, LowPower))), Ok(()));
    mock.done();
}

#[test]
fn periods_and_sensitivities_are_those_of_the_datasheet() {
    for (hz, period_ns) in [(13, 76_800_000), (208, 4_800_000), (1666, 600_000)] {
        assert_eq!(plan::<Chip>(hz, 2, High).sensor.period.0, period_ns);
    }
    for (g, ug_per_lsb) in [(2, 61.0), (4, 122.0), (8, 244.0), (16, 488.0)] {
        let sensor = plan::<Chip>(104, g, High).sensor;
        assert_eq!(sensor.accelerometer.sensitivity().lsb_per_g(), 1e6 / ug_per_lsb);
        let rad_s_per_lsb = sensor.gyroscope.expect("it has one").rad_s_per_lsb();
        assert!((rad_s_per_lsb.to_degrees() - 0.07).abs() < 1e-12);
    }
}

#[test]
fn the_fifo_level_has_ten_bits_and_two_overrun_flags() {
    for (bytes, samples, overrun) in [
        ([0x34, 0x81], 0x9A, false),
        ([0x00, 0xE2], 0x100, true),
        ([0x05, 0x08], 2, true),
        // 511 words became 512 between the two bytes.
        ([0xFF, 0x02], 256, false),
    ] {
        let level = on_bus(&[read(0x3A, &bytes)], async |chip| chip.level().await);
        assert_eq!(level, Ok(FifoLevel { samples, overrun }));
    }
    // An SPI bus without a chip.
    let absent = on_bus(&[read(0x3A, &[0xFF, 0xFF])], async |chip| chip.level().await);
    assert_eq!(absent, Err(SensorFault::NotAnswering));
}

#[test]
fn the_temperature_is_signed() {
    let around = on_bus(&[read(0x20, &[0x00, 0xE0])], async |chip| chip.surroundings().await);
    assert_eq!(around.map(|around| around.temperature), Ok(Some(CentiCelsius(-700))));
}
