//! The LSM303AGR.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::rc::Rc;

use embassy_futures::block_on;
use embedded_hal_async::i2c::{ErrorKind, NoAcknowledgeSource};
use embedded_hal_mock::eh1::i2c::{Mock, Transaction};
use wimu_link::message::Resolution;
use wimu_model::{CentiCelsius, Counts, DeviceTimeUs, MagneticFieldNt};
use wimu_node::sensor::{Batch, SensorFault, Surroundings};
use wimu_node::{FifoSensor, InertialSensor};
use wimu_sensors::Lsm303agr;

use crate::bench::{Clock, Line, plan};

const ACCELEROMETER: u8 = 0x19;
const MAGNETOMETER: u8 = 0x1E;

fn write(bytes: &[u8]) -> Transaction {
    Transaction::write(ACCELEROMETER, bytes.to_vec())
}

fn read(register: u8, values: &[u8]) -> Transaction {
    Transaction::write_read(ACCELEROMETER, vec![register | 0x80], values.to_vec())
}

/// FIFO_SRC: level above the watermark, overrun, empty; level, samples.
fn source(value: u8) -> Transaction {
    read(0x2F, &[value])
}

/// `count` samples in one burst, which count from `first` on.
fn burst(first: i16, count: i16) -> Transaction {
    let samples = (first..first + count).flat_map(|k| [k, -k, 0x40]);
    let bytes: Vec<u8> = samples.flat_map(i16::to_le_bytes).collect();
    read(0x28, &bytes)
}

fn counts(first: i16, count: i16) -> Vec<Counts> {
    (first..first + count).map(|k| Counts([k, -k, 0x40])).collect()
}

struct Bench {
    sensor: FifoSensor<Lsm303agr<Mock>, Line, Clock>,
    clock: Clock,
    rises: Rc<RefCell<VecDeque<u64>>>,
}

/// Runs `use_it` on a chip whose bus sees exactly `expected`.
fn on_bus<R>(expected: &[Transaction], use_it: impl AsyncFnOnce(&mut Bench) -> R) -> R {
    let mut bus = Mock::new(expected);
    let clock = Clock::default();
    let rises = Rc::<RefCell<VecDeque<u64>>>::default();
    let mut bench = Bench {
        sensor: FifoSensor::new(Lsm303agr::new(bus.clone()), Line(rises.clone()), clock.clone()),
        clock,
        rises,
    };
    let result = block_on(use_it(&mut bench));
    bus.done();
    result
}

/// What configuring sends, of which three registers depend on the plan.
fn configured(ctrl1: u8, ctrl4: u8, fifo: u8) -> Vec<Transaction> {
    vec![
        read(0x0F, &[0x33]),
        write(&[0x20, 0x07]),
        write(&[0x2E, 0x00]),
        write(&[0x1F, 0xC0]),
        write(&[0xA1, 0x00, 0x04, ctrl4, 0x40, 0x00]),
        write(&[0x2E, fifo]),
        Transaction::write(MAGNETOMETER, vec![0xE0, 0x80, 0x00, 0x10]),
        write(&[0x20, ctrl1]),
    ]
}

/// At 400 Hz, ± 2 g: the line rises for 16 samples, every 40 ms.
fn at_400_hz(then: &[Transaction]) -> Vec<Transaction> {
    [&configured(0x77, 0x88, 0x8F), then].concat()
}

async fn start(bench: &mut Bench) {
    let outcome = bench.sensor.configure(&plan::<Lsm303agr<Mock>>(400, 2, Resolution::High)).await;
    assert_eq!(outcome, Ok(()));
}

/// The next samples, announced by the line at `rose` and read at `now`.
async fn next(bench: &mut Bench, rose: u64, now: u64) -> (Batch, Vec<Counts>) {
    bench.rises.borrow_mut().push_back(rose);
    bench.clock.0.set(now);
    let mut counts = [Counts::default(); 32];
    let batch = bench.sensor.next(&mut counts).await.expect("they wait");
    (batch, counts[..batch.count].to_vec())
}

#[test]
fn every_plan_has_its_registers() {
    use Resolution::{High, LowPower, Normal};
    for (rate_hz, range_g, resolution, ctrl1, ctrl4, fifo) in [
        (1, 2, High, 0x17, 0x88, 0x80),
        (10, 4, High, 0x27, 0x98, 0x80),
        (25, 8, Normal, 0x37, 0xA0, 0x80),
        (50, 16, Normal, 0x47, 0xB0, 0x81),
        (100, 2, LowPower, 0x5F, 0x80, 0x83),
        (200, 2, High, 0x67, 0x88, 0x87),
        (400, 2, High, 0x77, 0x88, 0x8F),
        (1344, 2, High, 0x97, 0x88, 0x8F),
    ] {
        let plan = plan::<Lsm303agr<Mock>>(rate_hz, range_g, resolution);
        let expected = configured(ctrl1, ctrl4, fifo);
        let outcome = on_bus(&expected, async |bench| bench.sensor.configure(&plan).await);
        assert_eq!(outcome, Ok(()), "{plan:?}");
    }
}

#[test]
fn another_chip_at_the_address_is_named_and_left_alone() {
    let outcome = on_bus(&[read(0x0F, &[0xE5])], async |bench| {
        let plan = plan::<Lsm303agr<Mock>>(100, 2, Resolution::High);
        bench.sensor.configure(&plan).await
    });
    let wrong = SensorFault::WrongIdentity { expected: 0x33, found: 0xE5 };
    assert_eq!(outcome, Err(wrong));
}

#[test]
fn one_burst_reads_all_that_wait_and_the_line_gives_the_time_of_the_newest() {
    // More have come since the line rose than it waits for.
    let then = [source(0x90), burst(0, 16), source(0x92), burst(16, 16), burst(32, 2)];
    on_bus(&at_400_hz(&then), async |bench| {
        start(bench).await;
        let (batch, read) = next(bench, 41_000, 41_300).await;
        assert_eq!(read, counts(0, 16));
        let on_time = Batch::new(16, DeviceTimeUs(41_000)).queued();
        assert_eq!(batch, on_time);
        let (batch, read) = next(bench, 81_000, 86_100).await;
        assert_eq!(read, counts(16, 18));
        assert_eq!(batch.last_time, DeviceTimeUs(86_000));
    });
}

#[test]
fn of_a_full_fifo_the_oldest_sample_is_left_out_since_it_may_be_torn() {
    let then = [source(0xDF), burst(-1, 1), source(0x9F), burst(0, 16), burst(16, 15)];
    on_bus(&at_400_hz(&then), async |bench| {
        start(bench).await;
        bench.rises.borrow_mut().extend([41_000, 41_000]);
        bench.clock.0.set(141_000);
        let mut read = [Counts::default(); 32];
        let batch = bench.sensor.next(&mut read).await.expect("they wait");
        assert_eq!(read[..batch.count], counts(0, 31));
        assert!(batch.overrun && batch.queued);
        // An edge long ago gives no time: the newest sample is within the last period.
        assert_eq!(batch.last_time, DeviceTimeUs(139_750));
    });
}

#[test]
fn thirty_one_that_wait_are_all_of_them() {
    let then = [source(0x9F), burst(0, 16), burst(16, 15)];
    on_bus(&at_400_hz(&then), async |bench| {
        start(bench).await;
        let (batch, read) = next(bench, 41_000, 79_000).await;
        assert_eq!(read, counts(0, 31));
        assert_eq!((batch.overrun, batch.last_time.0), (false, 78_500));
    });
}

#[test]
fn a_line_that_another_chip_holds_is_not_believed() {
    let then = [source(0x90), burst(0, 16), source(0x0A), source(0x90), burst(16, 16)];
    on_bus(&at_400_hz(&then), async |bench| {
        start(bench).await;
        next(bench, 41_000, 41_300).await;
        // Held down since 55 ms; asked when ten wait, and again when six more should.
        bench.rises.borrow_mut().push_back(55_000);
        let (batch, read) = next(bench, 55_000, 66_000).await;
        assert_eq!((read, bench.clock.0.get()), (counts(16, 16), 81_000));
        // Where they are expected, 40 ms after those before.
        assert_eq!(batch.last_time, DeviceTimeUs(81_000));
    });
}

#[test]
fn without_the_line_samples_come_late_and_without_samples_it_says_so() {
    let then = [source(0x9B), burst(0, 16), burst(16, 11), source(0x20)];
    on_bus(&at_400_hz(&then), async |bench| {
        start(bench).await;
        let mut counts = [Counts::default(); 32];
        let batch = bench.sensor.next(&mut counts).await.expect("they wait");
        assert_eq!((batch.count, bench.clock.0.get()), (27, 67_500));
        let nothing = bench.sensor.next(&mut counts).await;
        assert_eq!(nothing, Err(SensorFault::NoData));
    });
}

#[test]
fn a_transfer_that_fails_says_how() {
    let no_address = ErrorKind::NoAcknowledge(NoAcknowledgeSource::Address);
    let midway = ErrorKind::NoAcknowledge(NoAcknowledgeSource::Data);
    for (error, fault) in [
        (no_address, SensorFault::NotAnswering),
        (midway, SensorFault::Transfer),
        (ErrorKind::Bus, SensorFault::Transfer),
    ] {
        let then = [source(0x90), burst(0, 16).with_error(error)];
        on_bus(&at_400_hz(&then), async |bench| {
            start(bench).await;
            bench.rises.borrow_mut().push_back(41_000);
            let mut counts = [Counts::default(); 32];
            assert_eq!(bench.sensor.next(&mut counts).await, Err(fault));
        });
    }
}

#[test]
fn a_magnetometer_that_has_not_measured_yet_has_no_field() {
    let magnetometer = |register, bytes: &[u8]| {
        Transaction::write_read(MAGNETOMETER, vec![register], bytes.to_vec())
    };
    let expected = [
        magnetometer(0xE7, &[0x07]),
        read(0x0C, &[0x00, 0xFF]),
        magnetometer(0xE7, &[0x0F]),
        magnetometer(0xE8, &[0x01, 0x00, 0xFE, 0xFF, 0x00, 0x01]),
        read(0x0C, &[0x80, 0x02]),
        magnetometer(0xE8, &[0, 0, 0, 0, 0, 0]),
        read(0x0C, &[0x00, 0x00]),
    ];
    let around = |magnetic_field: Option<[i32; 3]>, centi| Surroundings {
        magnetic_field: magnetic_field.map(MagneticFieldNt),
        temperature: Some(CentiCelsius(centi)),
    };
    on_bus(&expected, async |bench| {
        let seen = [
            bench.sensor.surroundings().await,
            bench.sensor.surroundings().await,
            bench.sensor.surroundings().await,
        ];
        let expected = [
            around(None, 2400),
            around(Some([150, -300, 38_400]), 2750),
            around(Some([0; 3]), 2500),
        ];
        assert_eq!(seen, expected.map(Ok));
    });
}
