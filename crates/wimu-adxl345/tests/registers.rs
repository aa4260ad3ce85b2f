//! Every register access, against a mock bus.

use embassy_futures::block_on;
use embedded_hal_async::i2c::{ErrorKind, NoAcknowledgeSource};
use embedded_hal_mock::eh1::i2c::{Mock, Transaction};
use embedded_hal_mock::eh1::spi::{Mock as SpiMock, Transaction as SpiTransaction};
use wimu_adxl345::{
    Address, Adxl345, DataFormat, Error, Fifo, I2cBus, Interrupts, Justify, Range, Rate,
    Resolution, Setup, SpiBus,
};

const AT: u8 = 0x53;

fn write(register: u8, value: u8) -> Transaction {
    Transaction::write(AT, vec![register, value])
}

fn read(register: u8, values: &[u8]) -> Transaction {
    Transaction::write_read(AT, vec![register], values.to_vec())
}

/// Runs `use_it` on a chip whose bus sees exactly `expected`.
fn on_bus<R>(
    expected: &[Transaction],
    use_it: impl AsyncFnOnce(&mut Adxl345<I2cBus<Mock>>) -> R,
) -> R {
    let (i2c, address) = (Mock::new(expected), Address::Low);
    let mut sensor = Adxl345::new(I2cBus { i2c, address });
    let result = block_on(use_it(&mut sensor));
    sensor.release().i2c.done();
    result
}

#[test]
fn the_identity_is_register_0() {
    let checked = on_bus(&[read(0x00, &[0xE5])], async |sensor| sensor.check_identity().await);
    assert_eq!(checked, Ok(()));
}

#[test]
fn another_chip_at_the_address_is_named() {
    let checked = on_bus(&[read(0x00, &[0x33])], async |sensor| sensor.check_identity().await);
    let error = checked.expect_err("0x33 is no ADXL345");
    assert_eq!(error, Error::WrongIdentity { expected: 0xE5, found: 0x33 });
    assert!(error.to_string().contains("0x33"), "{error}");
}

#[test]
fn the_other_address_is_0x1d() {
    let expected = [Transaction::write_read(0x1D, vec![0x00], vec![0xE5])];
    let (i2c, address) = (Mock::new(&expected), Address::High);
    let mut sensor = Adxl345::new(I2cBus { i2c, address });
    assert_eq!(block_on(sensor.check_identity()), Ok(()));
    sensor.release().i2c.done();
}

#[test]
fn a_sample_is_one_burst_of_six_bytes_low_byte_first() {
    let burst = [0x34, 0x12, 0xFF, 0xFF, 0x00, 0x80];
    let sample = on_bus(&[read(0x32, &burst)], async |sensor| sensor.sample().await);
    assert_eq!(sample, Ok([0x1234, -1, i16::MIN]));
}

const SETUP: Setup = Setup {
    format: DataFormat { range: Range::G16, resolution: Resolution::Full, justify: Justify::Left },
    rate: Rate::Hz100,
    low_power: true,
    fifo: Fifo::Stream { watermark: 8 },
    interrupts: Interrupts::WATERMARK.with(Interrupts::OVERRUN),
    on_int2: Interrupts::OVERRUN,
};

/// What a start with [`SETUP`] writes, with these contents of DATA_FORMAT, BW_RATE and FIFO_CTL.
fn started(format: u8, rate: u8, fifo: u8) -> [Transaction; 11] {
    [
        write(0x2D, 0x00),
        write(0x1E, 0x00),
        write(0x1F, 0x00),
        write(0x20, 0x00),
        write(0x31, format),
        write(0x2C, rate),
        write(0x38, 0x00),
        write(0x38, fifo),
        write(0x2F, 0x01),
        write(0x2E, 0x03),
        write(0x2D, 0x08),
    ]
}

#[test]
fn a_start_sets_everything_in_standby_and_measures_last() {
    for (watermark, code) in [(8, 0x88), (0, 0x81), (99, 0x9F)] {
        let setup = Setup { fifo: Fifo::Stream { watermark }, ..SETUP };
        let expected = started(0x0F, 0x1A, code);
        let outcome = on_bus(&expected, async |sensor| sensor.start(&setup).await);
        assert_eq!(outcome, Ok(()));
    }
    let (setup, expected) = (SETUP, started(0x0F, 0x1A, 0x88));
    // Nobody answers half-way: nothing more is written, and it does not measure.
    let mut failing = expected[..5].to_vec();
    failing[4] = write(0x31, 0x0F).with_error(ErrorKind::Bus);
    let outcome = on_bus(&failing, async |sensor| sensor.start(&setup).await);
    assert_eq!(outcome, Err(Error::Bus(ErrorKind::Bus)));
}

#[test]
fn every_format_has_its_code_bits_and_sensitivity() {
    use Justify::{Left, Right};
    use Resolution::{Full, TenBits};
    let table = [
        (Range::G2, TenBits, Right, 0x00, 10, 256),
        (Range::G4, TenBits, Right, 0x01, 10, 128),
        (Range::G8, TenBits, Right, 0x02, 10, 64),
        (Range::G16, TenBits, Right, 0x03, 10, 32),
        (Range::G2, Full, Right, 0x08, 10, 256),
        (Range::G4, Full, Right, 0x09, 11, 256),
        (Range::G8, Full, Right, 0x0A, 12, 256),
        (Range::G16, Full, Right, 0x0B, 13, 256),
        (Range::G2, Full, Left, 0x0C, 10, 16384),
        (Range::G4, Full, Left, 0x0D, 11, 8192),
        (Range::G8, Full, Left, 0x0E, 12, 4096),
        (Range::G16, Full, Left, 0x0F, 13, 2048),
        (Range::G16, TenBits, Left, 0x07, 10, 2048),
    ];
    for (range, resolution, justify, code, bits, lsb_per_g) in table {
        let format = DataFormat { range, resolution, justify };
        let expected = started(code, 0x1A, 0x88);
        let setup = Setup { format, ..SETUP };
        let outcome = on_bus(&expected, async |sensor| sensor.start(&setup).await);
        assert_eq!(outcome, Ok(()), "{format:?}");
        assert_eq!((format.bits(), format.lsb_per_g()), (bits, lsb_per_g), "{format:?}");
    }
}

#[test]
fn every_rate_has_its_code_and_period() {
    let hz = [6.25, 12.5, 25.0, 50.0, 100.0, 200.0, 400.0, 800.0, 1600.0, 3200.0];
    for ((rate, hz), code) in Rate::ALL.into_iter().zip(hz).zip(0x06..) {
        for (low_power, bit) in [(false, 0), (true, 0x10)] {
            let expected = started(0x0F, code | bit, 0x88);
            let setup = Setup { rate, low_power, ..SETUP };
            let outcome = on_bus(&expected, async |sensor| sensor.start(&setup).await);
            assert_eq!(outcome, Ok(()), "{rate:?}");
        }
        assert_eq!(f64::from(rate.period_ns()), 1e9 / hz);
        assert_eq!(rate.has_low_power(), (12.5..=400.0).contains(&hz), "{rate:?}");
    }
}

#[test]
fn the_level_leaves_the_trigger_bit_out() {
    let level = on_bus(&[read(0x39, &[0x80 | 33])], async |sensor| sensor.fifo_level().await);
    assert_eq!(level.map(|level| level.samples), Ok(33));
}

#[test]
fn active_interrupts_are_those_of_register_0x30() {
    let both = Interrupts::WATERMARK.with(Interrupts::OVERRUN);
    let happened = on_bus(&[read(0x30, &[0x83])], async |sensor| sensor.interrupts().await);
    let happened = happened.expect("the bus works");
    assert!(happened.contains(both) && happened.contains(Interrupts::DATA_READY));
}

#[test]
fn a_bus_that_fails_says_how() {
    let nobody = ErrorKind::NoAcknowledge(NoAcknowledgeSource::Address);
    let expected = [read(0x32, &[0; 6]).with_error(nobody)];
    let outcome = on_bus(&expected, async |sensor| sensor.sample().await);
    let error = outcome.expect_err("nobody answers");
    assert_eq!(error, Error::NotAnswering);
    assert!(error.to_string().contains("address"), "{error}");
    let expected = [read(0x32, &[0; 6]).with_error(ErrorKind::ArbitrationLoss)];
    let outcome = on_bus(&expected, async |sensor| sensor.sample().await);
    let error = outcome.expect_err("the transfer failed");
    assert!(error.to_string().contains("ArbitrationLoss"), "{error}");
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
    let expected = [
        read(0x80, &[0xE5]),
        read(0xB9, &[1]),
        read(0xF2, &[1, 0, 2, 0, 0xFF, 0xFF]),
        read(0x80, &[0xFF]),
    ]
    .concat();
    let mut sensor = Adxl345::new(SpiBus(SpiMock::new(&expected)));
    let outcome = block_on(async {
        sensor.check_identity().await?;
        let level = sensor.fifo_level().await?.samples;
        let sample = sensor.sample().await?;
        let absent = sensor.check_identity().await;
        Ok::<_, Error<_>>((level, sample, absent))
    });
    sensor.release().0.done();
    assert_eq!(outcome, Ok((1, [1, 2, -1], Err(Error::NotAnswering))));
}
