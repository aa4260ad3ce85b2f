//! Golden vectors of batches that only version 2 has: six axes, 20 bits, further sensors.

use std::num::NonZeroU8;

use wimu_link::batch::{self, Layout, Sample, Stream};
use wimu_link::{Batch, Kind};
use wimu_model::{AngularRateQ20, Counts, DeviceTimeUs, SpecificForceQ16, WideCounts};

use crate::vectors::Vectors;

/// All axes of a sample, and how it is described.
struct Expected {
    axes: Vec<Vec<i32>>,
    stream: Stream,
    is_wide: bool,
    layout: Layout,
}

fn add<S: Sample>(vectors: &mut Vectors, layout: Layout, what: &str, samples: &[S]) -> Expected {
    let axes: Vec<Vec<i32>> =
        samples.iter().map(|sample| (0..S::AXES).map(|axis| sample.axis(axis)).collect()).collect();
    let Layout { sensor, every } = layout;
    vectors.add(
        format!("sensor {sensor}, every {every}, sequence 0x12345678, time 0x9abcdef012 µs, {what}: {axes:?}"),
        |line| batch::encode_with(layout, 0x1234_5678, DeviceTimeUs(0x9a_bcde_f012), samples, line),
    );
    Expected { axes, stream: S::STREAM, is_wide: S::WIDE, layout }
}

#[test]
fn inertial_batches_are_as_they_were() {
    let of = |sensor| Layout { sensor, ..Layout::default() };
    let third = Layout { sensor: 0, every: NonZeroU8::new(3).unwrap() };
    let rest: Vec<_> = (0..16_i16)
        .map(|k| {
            (
                Counts([k * 7 % 23 - 11, k * 5 % 19 - 300, 16384 + k * 11 % 17]),
                Counts([k % 3 - 1, 40 + k * 5 % 4, -9 - k * 3 % 5]),
            )
        })
        .collect();
    let justified: Vec<_> = rest
        .iter()
        .take(6)
        .map(|(force, rate)| (Counts(force.0.map(|v| v / 2 * 2)), Counts(rate.0.map(|v| v << 4))))
        .collect();
    let turning: Vec<_> = (0..8_i16)
        .map(|k| (Counts([50 * k, -k, 8192]), Counts([-700 * k, 9000 + 3 * k * k, k % 2])))
        .collect();
    let wide: Vec<_> =
        (0..5_i32).map(|k| WideCounts([262_144 + 3 * k, -500_000 + k * k, 100 - 7 * k])).collect();
    let ends = [[-524_288, 524_287, 1], [524_287, -524_288, -1]].map(WideCounts);
    let six_wide: Vec<_> =
        wide.iter().map(|&force| (force, WideCounts(force.0.map(|v| -v / 16)))).collect();
    let corrected: Vec<_> = (0..4_i32)
        .map(|k| {
            (
                SpecificForceQ16([k * 4001, -70_000 + k * 13, 642_688 - k]),
                AngularRateQ20([1 << 20, -k * 500, k % 2]),
            )
        })
        .collect();
    let far: Vec<_> = [[-32768, 32767, 0], [1, -1, 160]].map(Counts).into();

    let mut vectors = Vectors::new("inertial", Kind::Inertial);
    let v = &mut vectors;
    let all = [
        add(v, of(0), "raw, six axes at rest", &rest),
        add(v, of(0), "raw, six axes, shifted by 1 and 4 bits", &justified),
        add(v, of(0), "raw, six axes, rotating", &turning),
        add(v, of(1), "raw, six axes, one sample", &rest[..1]),
        add(v, third, "raw, six axes, decimated", &rest[..4]),
        add(v, of(0), "raw, three axes of 20 bits", &wide),
        add(v, of(0), "raw, three axes of 20 bits, ends of the range", &ends),
        add(v, of(7), "raw, six axes of 20 bits", &six_wide),
        add(v, of(2), "raw, three axes of another sensor", &far),
        add(v, of(0), "corrected, six axes", &corrected),
    ];
    for (body, expected) in vectors.check().iter().zip(all) {
        let batch = Batch::decode(Kind::Inertial, body).unwrap();
        assert_eq!((batch.sequence_low(), batch.time_low()), (0x5678, 0xde_f012));
        assert_eq!(batch.sensor(), expected.layout.sensor);
        assert_eq!(batch.every(), expected.layout.every.get());
        assert_eq!((batch.stream(), batch.is_wide()), (expected.stream, expected.is_wide));
        let mut found: Vec<Vec<i32>> = batch.samples().iter().map(|axes| axes.to_vec()).collect();
        for (found, rate) in found.iter_mut().zip(batch.angular_rates()) {
            found.extend(rate);
        }
        assert_eq!(found, expected.axes);
    }
}
