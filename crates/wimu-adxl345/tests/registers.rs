//! Every register access, against a mock bus.

use embassy_futures::block_on;
use embedded_hal_async::i2c::{ErrorKind, NoAcknowledgeSource};
use embedded_hal_mock::eh1::delay::NoopDelay;
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
    let id = on_bus(&[read(0x00, &[0xE5])], async |sensor| sensor.device_id().await);
    assert_eq!(id, Ok(0xE5));
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

#[test]
fn measuring_starts_and_stops() {
    let expected = [write(0x2D, 0x08), write(0x2D, 0x00)];
    let outcome = on_bus(&expected, async |sensor| {
        sensor.measure().await?;
        sensor.standby().await
    });
    assert_eq!(outcome, Ok(()));
}

#[test]
fn a_start_sets_everything_in_standby_and_measures_last() {
    let setup = Setup {
        format: DataFormat {
            range: Range::G16,
            resolution: Resolution::Full,
            justify: Justify::Left,
        },
        rate: Rate::Hz100,
        low_power: true,
        fifo: Fifo::Stream { watermark: 8 },
        interrupts: Interrupts::WATERMARK.with(Interrupts::OVERRUN),
        on_int2: Interrupts::OVERRUN,
    };
    let expected = [
        write(0x2D, 0x00),
        write(0x1E, 0x00),
        write(0x1F, 0x00),
        write(0x20, 0x00),
        write(0x31, 0x0F),
        write(0x2C, 0x1A),
        write(0x38, 0x00),
        write(0x38, 0x88),
        write(0x2F, 0x01),
        write(0x2E, 0x03),
        write(0x2D, 0x08),
    ];
    let outcome = on_bus(&expected, async |sensor| sensor.start(&setup).await);
    assert_eq!(outcome, Ok(()));
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
        let outcome =
            on_bus(&[write(0x31, code)], async |sensor| sensor.set_data_format(format).await);
        assert_eq!(outcome, Ok(()), "{format:?}");
        assert_eq!((format.bits(), format.lsb_per_g()), (bits, lsb_per_g), "{format:?}");
    }
}

#[test]
fn every_rate_has_its_code_and_period() {
    let hz = [6.25, 12.5, 25.0, 50.0, 100.0, 200.0, 400.0, 800.0, 1600.0, 3200.0];
    for ((rate, hz), code) in Rate::ALL.into_iter().zip(hz).zip(0x06..) {
        let expected = [write(0x2C, code), write(0x2C, code | 0x10)];
        let outcome = on_bus(&expected, async |sensor| {
            sensor.set_rate(rate, false).await?;
            sensor.set_rate(rate, true).await
        });
        assert_eq!(outcome, Ok(()), "{rate:?}");
        assert_eq!(f64::from(rate.period_ns()), 1e9 / hz);
        assert_eq!(rate.has_low_power(), (12.5..=400.0).contains(&hz), "{rate:?}");
    }
}

#[test]
fn the_bus_bounds_the_rate_as_the_datasheet_recommends() {
    for (bus_hz, fastest) in [
        (400_000, Some(Rate::Hz800)),
        (200_000, Some(Rate::Hz400)),
        (100_000, Some(Rate::Hz200)),
        (99_999, Some(Rate::Hz100)),
        (4_000_000, Some(Rate::Hz3200)),
        (1_000, None),
    ] {
        assert_eq!(Rate::fastest_on_i2c(bus_hz), fastest, "{bus_hz}");
    }
}

#[test]
fn setting_the_fifo_empties_it_first() {
    for (fifo, code) in [
        (Fifo::Stream { watermark: 16 }, 0x90),
        (Fifo::Stream { watermark: 0 }, 0x81),
        (Fifo::Stream { watermark: 99 }, 0x9F),
        (Fifo::UntilFull { watermark: 31 }, 0x5F),
    ] {
        let expected = [write(0x38, 0x00), write(0x38, code)];
        let outcome = on_bus(&expected, async |sensor| sensor.set_fifo(fifo).await);
        assert_eq!(outcome, Ok(()), "{fifo:?}");
    }
    let outcome = on_bus(&[write(0x38, 0x00)], async |sensor| sensor.set_fifo(Fifo::Bypass).await);
    assert_eq!(outcome, Ok(()));
}

#[test]
fn the_level_leaves_the_trigger_bit_out() {
    let level = on_bus(&[read(0x39, &[0x80 | 33])], async |sensor| sensor.fifo_level().await);
    assert_eq!(level.map(|level| level.samples), Ok(33));
}

#[test]
fn interrupts_are_mapped_before_they_are_enabled() {
    let both = Interrupts::WATERMARK.with(Interrupts::OVERRUN);
    let expected = [write(0x2F, 0x01), write(0x2E, 0x03), read(0x30, &[0x83])];
    let happened = on_bus(&expected, async |sensor| {
        sensor.set_interrupts(both, Interrupts::OVERRUN).await?;
        sensor.interrupts().await
    });
    let happened = happened.expect("the bus works");
    assert!(happened.contains(both) && happened.contains(Interrupts::DATA_READY));
}

#[test]
fn offsets_are_twos_complement() {
    let expected = [write(0x1E, 0x01), write(0x1F, 0xFF), write(0x20, 0x80)];
    let outcome = on_bus(&expected, async |sensor| sensor.set_offset([1, -1, -128]).await);
    assert_eq!(outcome, Ok(()));
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
    let write = vec![
        SpiTransaction::transaction_start(),
        SpiTransaction::write_vec(vec![0x2D, 0x08]),
        SpiTransaction::transaction_end(),
    ];
    let expected = [
        read(0x80, &[0xE5]),
        write,
        read(0xB9, &[1]),
        read(0xF2, &[1, 0, 2, 0, 0xFF, 0xFF]),
        read(0x80, &[0xFF]),
    ]
    .concat();
    let mut sensor = Adxl345::new(SpiBus(SpiMock::new(&expected)));
    let outcome = block_on(async {
        sensor.check_identity().await?;
        sensor.measure().await?;
        let level = sensor.fifo_level().await?.samples;
        let sample = sensor.sample().await?;
        let absent = sensor.check_identity().await;
        Ok::<_, Error<_>>((level, sample, absent))
    });
    sensor.release().0.done();
    assert_eq!(outcome, Ok((1, [1, 2, -1], Err(Error::NotAnswering))));
}

#[test]
fn the_self_test_is_the_shift_of_the_means() {
    let bytes = |[x, y, z]: [i16; 3]| -> Vec<u8> {
        [x, y, z].iter().flat_map(|axis| axis.to_le_bytes()).collect()
    };
    let mut expected = vec![
        write(0x2D, 0x00),
        write(0x2F, 0x00),
        write(0x2E, 0x00),
        write(0x38, 0x00),
        write(0x2C, 0x0A),
        write(0x31, 0x0B),
        write(0x2D, 0x08),
    ];
    for k in 0..10 {
        // Noise that cancels.
        expected.push(read(0x32, &bytes([10 + k % 2, -(k % 2), 256])));
    }
    expected.push(write(0x31, 0x8B));
    expected.extend((0..10).map(|_| read(0x32, &bytes([310, -290, 700]))));
    expected.extend([write(0x31, 0x0B), write(0x2D, 0x00)]);
    let outcome = on_bus(&expected, async |sensor| sensor.self_test(&mut NoopDelay::new()).await);
    let test = outcome.expect("the bus works");
    assert_eq!(test.shift, [300, -290, 444]);
    assert_eq!(test.passed(2500), [true; 3]);
}

#[test]
fn self_test_limits_follow_the_supply() {
    use wimu_adxl345::SelfTest;
    let shift = |shift| SelfTest { shift };
    // Datasheet: 0.2 g (50 LSB) at 2.5 V is 1.77 times as much at 3.3 V.
    assert_eq!(shift([50, -50, 75]).passed(2500), [true; 3]);
    assert_eq!(shift([50, -50, 75]).passed(3300), [false; 3]);
    assert_eq!(shift([89, -89, 111]).passed(3300), [true; 3]);
    // A broken axis, and one of the wrong sign.
    assert_eq!(shift([0, 300, 300]).passed(2500), [false, false, true]);
    // In between, and beyond the table.
    assert_eq!(shift([70, -70, 93]).passed(2900), [true; 3]);
    assert_eq!(shift([68, -68, 91]).passed(2900), [false; 3]);
    assert_eq!(shift([120, -120, 140]).passed(5000), [true; 3]);
}
