//! Every register access, against mock buses.

use embassy_futures::block_on;
use embedded_hal_async::i2c::{ErrorKind, NoAcknowledgeSource};
use embedded_hal_mock::eh1::delay::NoopDelay;
use embedded_hal_mock::eh1::i2c::{Mock, Transaction};
use embedded_hal_mock::eh1::spi;
use wimu_lsm6dso::{
    AccelerationRange, Address, AngularRateRange, Error, I2cBus, Lsm6dso, Power, Rate, Setup,
    SpiBus,
};

const AT: u8 = 0x6A;

pub(crate) fn write(register: u8, value: u8) -> Transaction {
    Transaction::write(AT, vec![register, value])
}

pub(crate) fn read(register: u8, values: &[u8]) -> Transaction {
    Transaction::write_read(AT, vec![register], values.to_vec())
}

/// Runs `use_it` on a chip whose bus sees exactly `expected`.
pub(crate) fn on_bus<R>(
    expected: &[Transaction],
    use_it: impl AsyncFnOnce(&mut Lsm6dso<I2cBus<Mock>>) -> R,
) -> R {
    let mut sensor = Lsm6dso::new(I2cBus { i2c: Mock::new(expected), address: Address::Low });
    let result = block_on(use_it(&mut sensor));
    sensor.release().i2c.done();
    result
}

const SETUP: Setup = Setup {
    acceleration: AccelerationRange::G16,
    angular_rate: AngularRateRange::Dps125,
    rate: Rate::Hz52,
    power: Power::Low,
    watermark: 200,
};

#[test]
fn the_identity_is_register_0x0f() {
    let checked = on_bus(&[read(0x0F, &[0x6C])], async |sensor| sensor.check_identity().await);
    assert_eq!(checked, Ok(()));
}

#[test]
fn another_chip_is_named() {
    let checked = on_bus(&[read(0x0F, &[0x6B])], async |sensor| sensor.check_identity().await);
    let error = checked.expect_err("0x6b is no LSM6DSO");
    assert_eq!(error, Error::WrongIdentity { expected: 0x6C, found: 0x6B });
    assert!(error.to_string().contains("0x6b"), "{error}");
}

#[test]
fn a_missing_chip_and_a_failing_bus_are_different_errors() {
    let nack = ErrorKind::NoAcknowledge(NoAcknowledgeSource::Address);
    let nack_of_data = ErrorKind::NoAcknowledge(NoAcknowledgeSource::Data);
    for (error, expected) in [
        (nack, Error::NotAnswering),
        (nack_of_data, Error::Bus(nack_of_data)),
        (ErrorKind::Bus, Error::Bus(ErrorKind::Bus)),
    ] {
        let answer = [read(0x0F, &[0]).with_error(error)];
        let checked = on_bus(&answer, async |sensor| sensor.check_identity().await);
        assert_eq!(checked, Err(expected));
        assert!(!expected.to_string().is_empty());
    }
}

#[test]
fn the_other_address_is_0x6b() {
    let i2c = Mock::new(&[Transaction::write_read(0x6B, vec![0x0F], vec![0x6C])]);
    let address = Address::High;
    let mut sensor = Lsm6dso::new(I2cBus { i2c, address });
    assert_eq!(block_on(sensor.check_identity()), Ok(()));
    sensor.release().i2c.done();
}

#[test]
fn spi_reads_set_bit_7_and_writes_do_not() {
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
    expected.extend(read(0x0F, &[0xFF]));
    expected.extend(write(0x01, 0x00));
    expected.extend(write(0x12, 0x05));
    expected.extend(read(0x12, &[0x04]));
    expected.extend(write(0x18, 0xE2));
    expected.extend(write(0x12, 0x44));
    // The I²C interface is turned off.
    expected.extend(write(0x13, 0x04));
    let settings = [
        (0x07, 0x90),
        (0x08, 0x01),
        (0x09, 0x33),
        (0x15, 0x10),
        (0x16, 0x80),
        (0x0D, 0x08),
        (0x10, 0x34),
        (0x11, 0x32),
        (0x0A, 0x06),
    ];
    for (register, value) in settings {
        expected.extend(write(register, value));
    }
    let mut sensor = Lsm6dso::new(SpiBus(spi::Mock::new(&expected)));
    assert_eq!(block_on(sensor.check_identity()), Ok(()));
    let absent = block_on(sensor.check_identity());
    assert_eq!(absent, Err(Error::NotAnswering));
    let started = block_on(sensor.start(&SETUP, &mut NoopDelay::new()));
    assert_eq!(started, Ok(()));
    sensor.release().0.done();
}

#[test]
fn a_start_resets_the_chip_and_writes_every_setting() {
    let expected = [
        write(0x01, 0x00),
        write(0x12, 0x05),
        read(0x12, &[0x05]),
        read(0x12, &[0x04]),
        write(0x18, 0xE2),
        write(0x12, 0x44),
        write(0x07, 0x02),
        write(0x08, 0x00),
        write(0x09, 0xAA),
        write(0x15, 0x00),
        write(0x16, 0x00),
        write(0x0D, 0x08),
        write(0x10, 0xAC),
        write(0x11, 0xAC),
        write(0x0A, 0x06),
    ];
    let setup = Setup {
        acceleration: AccelerationRange::G8,
        angular_rate: AngularRateRange::Dps2000,
        rate: Rate::Hz6664,
        power: Power::High,
        watermark: 0,
    };
    let started =
        on_bus(&expected, async |sensor| sensor.start(&setup, &mut NoopDelay::new()).await);
    assert_eq!(started, Ok(()));
}

#[test]
fn a_reset_that_does_not_end_is_an_error() {
    let mut expected = vec![write(0x01, 0x00), write(0x12, 0x05)];
    expected.extend((0..100).map(|_| read(0x12, &[0x05])));
    let outcome = on_bus(&expected, async |sensor| sensor.reset(&mut NoopDelay::new()).await);
    assert_eq!(outcome, Err(Error::ResetTimeout));
}

#[test]
fn rates_are_one_period_times_powers_of_two() {
    let periods: Vec<u32> = Rate::ALL.iter().map(|rate| rate.period_ns()).collect();
    assert_eq!(periods[0], 76_800_000);
    assert_eq!(periods[9], 150_000);
    assert!(periods.windows(2).all(|pair| pair[0] == 2 * pair[1]));
    let saving = Rate::ALL.iter().filter(|rate| rate.has_low_power());
    assert_eq!(saving.count(), 5);
}

#[test]
fn sensitivities_are_those_of_the_datasheet() {
    assert_eq!(AccelerationRange::G2.ug_per_lsb(), 61);
    assert_eq!(AccelerationRange::G16.ug_per_lsb(), 488);
    assert_eq!(AngularRateRange::Dps125.udps_per_lsb(), 4_375);
    assert_eq!(AngularRateRange::Dps2000.udps_per_lsb(), 70_000);
}

#[test]
fn the_fifo_level_has_ten_bits_and_two_overrun_flags() {
    for (bytes, samples_left, overrun) in [
        ([0x34, 0x81], 0x9A, false),
        ([0x00, 0xE2], 0x100, true),
        ([0x05, 0x08], 2, true),
        // 511 words became 512 between the two bytes.
        ([0xFF, 0x02], 256, false),
    ] {
        let batch = on_bus(&[read(0x3A, &bytes)], async |sensor| sensor.read(&mut []).await);
        let batch = batch.expect("the bus works");
        assert_eq!((batch.samples_left, batch.overrun), (samples_left, overrun));
    }
    // An SPI bus without a chip.
    let absent = [read(0x3A, &[0xFF, 0xFF])];
    let absent = on_bus(&absent, async |sensor| sensor.read(&mut []).await);
    assert_eq!(absent, Err(Error::NotAnswering));
}

#[test]
fn the_temperature_is_signed() {
    let lsb = on_bus(&[read(0x20, &[0x00, 0xFF])], async |sensor| sensor.temperature().await);
    assert_eq!(lsb, Ok(-256));
}
