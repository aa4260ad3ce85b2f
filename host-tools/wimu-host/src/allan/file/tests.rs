use super::*;

/// Noise at 100 Hz with jitter of the times; a gap at the end of a block, and two in others.
#[test]
fn blocks_are_measured_as_one_series() {
    let at = [BLOCK - 50, BLOCK + 100, 2 * BLOCK];
    let mut state = 1_u64;
    let mut uniform = || {
        state =
            state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
    };
    let info = TrackInfo::new("a", Quantity::SpecificForce, crate::recording::Unit::Si);
    let mut meter = TrackMeter::new(None);
    let mut whole = AllanVariance::new(100.0);
    let mut missing_ns = 0;
    for row in 0..5 * BLOCK / 2 {
        let value = [0, 1, 2].map(|axis| 0.01 * uniform() + [0.0, 0.0, 9.8][axis]);
        if at.contains(&row) {
            missing_ns += 3_000_000_000;
            whole.gap();
        }
        whole.push(value);
        let time_ns = 10_000_000 * row as i64 + missing_ns + (1e6 * uniform()) as i64;
        meter.take(&info, time_ns, &value);
    }
    let (rate_hz, source) = meter.finish(&info).unwrap();
    assert!((rate_hz - 100.0).abs() < 1e-4, "{rate_hz}");
    assert_eq!(source, RateSource::Times);
    assert_eq!(meter.gaps.0, at.len());
    assert!((meter.gaps.1 - 9.0).abs() < 0.01, "{:?}", meter.gaps);
    let [found, expected] = [&meter.allan, &whole].map(|allan| allan.result().unwrap());
    for (found, expected) in found.iter().zip(&expected) {
        let [found, expected] = [found, expected].map(|axis| axis.velocity_random_walk.value);
        assert!((found / expected - 1.0).abs() < 1e-5, "{found} {expected}");
    }
}
