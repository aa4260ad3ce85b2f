//! Alignment of a sensor with its body: temperature, and the push that tells ahead.

use wimu_host::alignment::{AlignOptions, alignment};
use wimu_host::calibration::{Calibration, CalibrationReport};
use wimu_host::problem::Outcome;
use wimu_host::recording::{Quantity, Recording, Selection, Sink, TrackInfo, Unit};
use wimu_model::{
    CentiCelsius, ErrorModel, ErrorTerms, ParameterSet, Sensitivity, SpecificForceMps2,
    TemperatureTerms,
};

/// A sensor whose bias goes with the temperature by 1 and 2 mg/K.
fn warm() -> ParameterSet {
    let temperature = TemperatureTerms {
        reference_c: 28.0,
        bias_mps2_per_k: [0.01, -0.02, 0.01],
        ..TemperatureTerms::default()
    };
    let terms = ErrorTerms { bias_mps2: [0.1, 0.2, -0.1], temperature, ..ErrorTerms::default() };
    ParameterSet {
        model: ErrorModel::new(terms).unwrap(),
        ..ParameterSet::uncalibrated(2, Sensitivity::from_lsb_per_g(16384.0).unwrap())
    }
}

/// Two rests at 5 °C of a sensor in body axes, its z and then its x up; the temperature in every
/// tenth row only, where it is known.
fn cold(told: bool) -> Recording {
    let mut recording = Recording::new("cold");
    let lsb_mps2 = warm().sensitivity.mps2_per_lsb();
    let counts = Unit::Counts { si_per_lsb: Some(lsb_mps2) };
    let force = recording.track(TrackInfo::new("cold", Quantity::SpecificForce, counts));
    let celsius = TrackInfo::new("cold", Quantity::Temperature, Unit::Si);
    let celsius = recording.track(celsius);
    for k in 0..1100_u32 {
        let turned = (f64::from(k) * 0.01 - 5.0).clamp(0.0, 1.0) * std::f64::consts::FRAC_PI_2;
        let rough = 0.005 * (f64::from(k) * 2.4).sin();
        let up = [turned.sin(), 0.0, turned.cos()].map(|up| 9.80665 * up + rough);
        let at = Some(CentiCelsius::from_celsius(5.0));
        let sensed = warm().model.distort(SpecificForceMps2(up), at);
        let time_ns = i64::from(k) * 10_000_000;
        recording.row(force, time_ns, &sensed.0.map(|axis| axis / lsb_mps2));
        if told && k % 10 == 3 {
            recording.row(celsius, time_ns, &[5.0]);
        }
    }
    recording
}

fn quaternion(report: &CalibrationReport) -> Option<[f64; 4]> {
    report.parameters.map(|set| set.alignment.quaternion())
}

fn aligned(data: &Recording, set: &ParameterSet, options: &AlignOptions) -> CalibrationReport {
    let calibration = Calibration::held(set);
    alignment(&data.samples(Selection::default()).unwrap(), &calibration, options).unwrap()
}

#[test]
fn the_temperature_of_the_rests_is_taken_out() {
    let options = AlignOptions {
        up: ["z", "x"].map(|axis| axis.parse().unwrap()).to_vec(),
        rests: None,
        forward: false,
        placement_sd_rad: 0.003,
    };
    let off_deg = |report: &CalibrationReport| {
        let [_, x, y, z] = quaternion(report).unwrap();
        [x, y, z].map(|half| (2.0 * half).to_degrees().abs())
    };
    let report = aligned(&cold(true), &warm(), &options);
    assert!(off_deg(&report).iter().all(|off| *off < 0.02), "{:?}", off_deg(&report));
    assert_eq!(report.outcome, Outcome::default());

    // Without a thermometer it cannot be, and that is said.
    let report = aligned(&cold(false), &warm(), &options);
    let findings = &report.outcome.findings;
    assert!(findings.iter().any(|f| f.text.contains("28.0 °C")), "{findings:?}");
    assert!(
        quaternion(&report).is_none() || off_deg(&report).iter().any(|off| *off > 0.5),
        "{report}"
    );
}

/// A level rest, a push along the body's x of a whole sine, the same rest, and then, where it is
/// turned, the body's x up; in body axes.
fn pushed(peak: f64, seconds: f64, stands: [f64; 2], turned: bool) -> Recording {
    let [before, after] = stands;
    let turns_at = before + seconds + after;
    let length = turns_at + if turned { 4.0 } else { 0.0 };
    let mut recording = Recording::new("pushed");
    let lsb_mps2 = warm().sensitivity.mps2_per_lsb();
    let counts = Unit::Counts { si_per_lsb: Some(lsb_mps2) };
    let force = recording.track(TrackInfo::new("pushed", Quantity::SpecificForce, counts));
    for k in 0..(100.0 * length) as u32 {
        let t = f64::from(k) * 0.01;
        let u = ((t - before) / seconds).clamp(0.0, 1.0);
        let turn = (t - turns_at).clamp(0.0, 1.0) * std::f64::consts::FRAC_PI_2;
        let rough = 0.01 * (f64::from(k) * 2.4).sin();
        let ahead = peak * (std::f64::consts::TAU * u).sin();
        let up = [turn.sin(), 0.0, turn.cos()].map(|up| 9.80665 * up + rough);
        let time_ns = i64::from(k) * 10_000_000;
        let output = [up[0] + ahead, up[1], up[2]].map(|axis| axis / lsb_mps2);
        recording.row(force, time_ns, &output);
    }
    recording
}

#[test]
fn a_push_gentle_or_brisk_tells_ahead() {
    let set = ParameterSet::uncalibrated(2, Sensitivity::from_lsb_per_g(16384.0).unwrap());
    for peak in [0.3, 1.7, 5.0] {
        for seconds in [0.5, 2.0, 4.0] {
            // Of 5 cm or less nothing is told.
            if peak * seconds * seconds / std::f64::consts::TAU < 0.06 {
                continue;
            }
            for (stands, turned) in
                [([3.0, 3.0], false), ([3.0, 6.0], false), ([6.0, 2.5], false), ([3.0, 4.0], true)]
            {
                let up = if turned { "z,x" } else { "z" };
                let mut options = AlignOptions {
                    up: up.split(',').map(|axis| axis.parse().unwrap()).collect(),
                    rests: None,
                    forward: true,
                    placement_sd_rad: 0.02,
                };
                let data = pushed(peak, seconds, stands, turned);
                let report = aligned(&data, &set, &options);
                let case = format!("{peak} m/s² {seconds} s {stands:?} {turned}: {report}");
                let [w, x, y, z] = quaternion(&report).expect(&case);
                let off = [x, y, z].map(|half| (2.0 * half).to_degrees().abs());
                assert!(w > 0.9 && off.iter().all(|off| *off < 1.0), "{case}");
                // As it says itself where it is told which the first is.
                if !turned {
                    options.rests = Some(vec![0]);
                    let told = aligned(&data, &set, &options);
                    assert_eq!(quaternion(&told), quaternion(&report), "{told}");
                }
            }
        }
    }
}
